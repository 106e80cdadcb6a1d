"""The walker on round feet, with legs of any mass distribution."""

import equinox as eqx
import jax.numpy as jnp

from walker_jax.multibody import System
from walker_jax.walkers.abstract_round_foot import AbstractRoundFootWalker
from walker_jax.walkers.masses import gravity, rises_ever_faster
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameter_table import (
    COM_FROM_HIP,
    COM_OFFSET,
    FOOT_RADIUS,
    HIP_MASS,
    LEG_INERTIA,
    LEG_LENGTH,
    LEG_MASS,
    SLOPE,
)


class RoundFootWalker(AbstractRoundFootWalker):
    """A hip and two legs with mass and inertia, on feet that roll: arcs centred on the legs.

    A radius of zero makes point feet.

    **Arguments:** masses in any unit, lengths in any unit L, times then in sqrt(L / gravity).

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `hip_mass`: a point mass at the hip, not negative.
    - `leg_mass`, `leg_inertia`: of each leg, above 0; about its centre of mass, not negative.
    - `leg_length`: from the hip to the sole, above 0. The arc's centre is at
      leg_length - foot_radius from the hip.
    - `com_from_hip`, `com_offset`: the place of a leg's centre of mass, down the leg and forward.
    - `foot_radius`: not negative, and less than the length of the leg.

    Raises `ValueError` otherwise, and for legs free to turn: without inertia, and with the centre
    of mass at the hip.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)
    hip_mass: Scalar = eqx.field(converter=HIP_MASS.convert, default=HIP_MASS.default)
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
            return jnp.concatenate([hip, legs])

        M, m, inertia = self.hip_mass, self.leg_mass, self.leg_inertia
        masses = jnp.stack([M, M, m, m, m, m, inertia, inertia])
        return System(transfer, masses, gravity(self.slope, masses, turns=2))
