"""The walker with an upper body, on round feet."""

import equinox as eqx
import jax.numpy as jnp

from walker_jax.multibody import System
from walker_jax.walkers.abstract_round_foot import AbstractRoundFootWalker
from walker_jax.walkers.masses import gravity, leg, rises_ever_faster
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameter_table import (
    BODY_COM,
    BODY_INERTIA,
    BODY_MASS,
    COM_FROM_HIP,
    COM_OFFSET,
    FOOT_RADIUS,
    LEG_INERTIA,
    LEG_LENGTH,
    LEG_MASS,
    SLOPE,
)


class UpperBodyWalker(AbstractRoundFootWalker):
    """A walker with an upper body that a mechanism at the hip holds midway between the legs.

    The bisecting hip of Wisse, Schwab and van der Helm (2004, Robotica 22:681-688): the angle of
    the body is the mean of those of the legs, theta - phi / 2, at heel strike too. So it adds no
    degree of freedom. Legs and feet are those of the `RoundFootWalker`.

    **Arguments:** units and all other parameters are those of the `RoundFootWalker`.

    - `body_mass`, `body_inertia`: of the upper body, above 0; about its centre of mass, not
      negative.
    - `body_com`: distance of its centre of mass above the hip; negative below it.

    Raises `ValueError` as there.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)
    body_mass: Scalar = eqx.field(converter=BODY_MASS.convert, default=BODY_MASS.default)
    body_inertia: Scalar = eqx.field(converter=BODY_INERTIA.convert, default=BODY_INERTIA.default)
    body_com: Scalar = eqx.field(converter=BODY_COM.convert, default=BODY_COM.default)
    leg_mass: Scalar = eqx.field(converter=LEG_MASS.convert, default=LEG_MASS.default)
    leg_inertia: Scalar = eqx.field(converter=LEG_INERTIA.convert, default=LEG_INERTIA.default)
    leg_length: Scalar = eqx.field(converter=LEG_LENGTH.convert, default=LEG_LENGTH.default)
    com_from_hip: Scalar = eqx.field(converter=COM_FROM_HIP.convert, default=COM_FROM_HIP.default)
    com_offset: Scalar = eqx.field(converter=COM_OFFSET.convert, default=COM_OFFSET.default)
    foot_radius: Scalar = eqx.field(converter=FOOT_RADIUS.convert, default=FOOT_RADIUS.default)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def system(self):
        def transfer(q):
            hip, legs = self.hip_and_legs(q)
            angle = q[2] - q[3] / 2
            return jnp.concatenate([hip + self.body_com * leg(angle), legs, jnp.stack([angle])])

        M, m = self.body_mass, self.leg_mass
        points = [M, M, m, m, m, m]
        masses = jnp.stack([*points, self.leg_inertia, self.leg_inertia, self.body_inertia])
        return System(transfer, masses, gravity(self.slope, masses, turns=3))
