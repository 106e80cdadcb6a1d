"""Walkers on round feet, with legs of any mass distribution, with and without an upper body."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.multibody import System
from walker_jax.walkers.heavy_legs import HeavyLegWalker
from walker_jax.walkers.masses import gravity, leg, rises_ever_faster
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameters import SLOPE, Parameter

# The parameters of the legs of all walkers with feet in the shape of an arc.
HIP_MASS = Parameter("hip_mass", "at the hip", "mass", 1.0, closed=True)
LEG_MASS = Parameter("leg_mass", "of each leg", "mass", 0.5)
LEG_INERTIA = Parameter(
    "leg_inertia", "of each leg about its centre of mass", "mass length^2", 0.02, closed=True
)
LEG_LENGTH = Parameter("leg_length", "from the hip to the sole", "length", 1.0)
COM_FROM_HIP = Parameter(
    "com_from_hip", "distance of a leg's centre of mass below the hip", "length", 0.5, low=-np.inf
)
COM_OFFSET = Parameter(
    "com_offset", "of a leg's centre of mass before the leg's line", "length", 0.0, low=-np.inf
)
FOOT_RADIUS = Parameter(
    "foot_radius", "of the foot's arc, centred on the leg", "length", 0.2, closed=True
)


class RoundFootWalker(HeavyLegWalker):
    """A hip and two legs with mass and inertia, on feet that roll: arcs centred on the legs.

    Point feet are those of radius zero. With the coordinate u of a foot that rolls held, its arc's
    centre is at u - foot_radius theta.

    **Arguments:** masses in any unit, lengths in any unit L, times then in sqrt(L / gravity).

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `hip_mass`: a point mass at the hip, not negative.
    - `leg_mass`, `leg_inertia`: of each leg, about its centre of mass; above 0, and not negative.
    - `leg_length`: from the hip to the sole, above 0. The arc's centre is at
      leg_length - foot_radius from the hip.
    - `com_from_hip`, `com_offset`: the place of a leg's centre of mass, down the leg and forward.
    - `foot_radius`: not negative, and less than the length of the leg.

    `ValueError` otherwise, and for legs that nothing keeps from turning: no inertia, and a centre
    of mass at the hip.
    """

    slope: Scalar = eqx.field(converter=SLOPE.checked)
    hip_mass: Scalar = eqx.field(converter=HIP_MASS.checked, default=HIP_MASS.default)
    leg_mass: Scalar = eqx.field(converter=LEG_MASS.checked, default=LEG_MASS.default)
    leg_inertia: Scalar = eqx.field(converter=LEG_INERTIA.checked, default=LEG_INERTIA.default)
    leg_length: Scalar = eqx.field(converter=LEG_LENGTH.checked, default=LEG_LENGTH.default)
    com_from_hip: Scalar = eqx.field(converter=COM_FROM_HIP.checked, default=COM_FROM_HIP.default)
    com_offset: Scalar = eqx.field(converter=COM_OFFSET.checked, default=COM_OFFSET.default)
    foot_radius: Scalar = eqx.field(converter=FOOT_RADIUS.checked, default=FOOT_RADIUS.default)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def __check_init__(self):
        check_legs(self)

    def system(self):
        def transfer(q):
            hip, legs = legs_of(self, q)
            return jnp.concatenate([hip, legs])

        M, m, inertia = self.hip_mass, self.leg_mass, self.leg_inertia
        masses = jnp.stack([M, M, m, m, m, m, inertia, inertia])
        return System(transfer, masses, gravity(self.slope, masses, turns=2))

    def swing_foot(self, q):
        return swing_foot_of(self, q)


BODY_MASS = Parameter("body_mass", "of the upper body", "mass", 1.0)
BODY_INERTIA = Parameter(
    "body_inertia", "of the upper body about its centre of mass", "mass length^2", 0.0, closed=True
)
BODY_COM = Parameter(
    "body_com", "distance of the upper body's centre of mass above the hip", "length", 0.1, -np.inf
)


class UpperBodyWalker(HeavyLegWalker):
    """A walker with an upper body that a mechanism at the hip holds midway between the legs.

    The bisecting hip of Wisse, Schwab and van der Helm (2004, Robotica 22:681-688): the angle of
    the body is the mean of those of the legs, theta - phi / 2, at heel strike too. So it adds no
    degree of freedom. Legs and feet are those of the `RoundFootWalker`.

    **Arguments:** units as there, and so are the parameters not listed.

    - `body_mass`, `body_inertia`: of the upper body, about its centre of mass; above 0, and not
      negative.
    - `body_com`: distance of its centre of mass above the hip; below it where negative.

    `ValueError` as there.
    """

    slope: Scalar = eqx.field(converter=SLOPE.checked)
    body_mass: Scalar = eqx.field(converter=BODY_MASS.checked, default=BODY_MASS.default)
    body_inertia: Scalar = eqx.field(converter=BODY_INERTIA.checked, default=BODY_INERTIA.default)
    body_com: Scalar = eqx.field(converter=BODY_COM.checked, default=BODY_COM.default)
    leg_mass: Scalar = eqx.field(converter=LEG_MASS.checked, default=LEG_MASS.default)
    leg_inertia: Scalar = eqx.field(converter=LEG_INERTIA.checked, default=LEG_INERTIA.default)
    leg_length: Scalar = eqx.field(converter=LEG_LENGTH.checked, default=LEG_LENGTH.default)
    com_from_hip: Scalar = eqx.field(converter=COM_FROM_HIP.checked, default=COM_FROM_HIP.default)
    com_offset: Scalar = eqx.field(converter=COM_OFFSET.checked, default=COM_OFFSET.default)
    foot_radius: Scalar = eqx.field(converter=FOOT_RADIUS.checked, default=FOOT_RADIUS.default)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def __check_init__(self):
        check_legs(self)

    def system(self):
        def transfer(q):
            hip, legs = legs_of(self, q)
            angle = q[2] - q[3] / 2
            return jnp.concatenate([hip + self.body_com * leg(angle), legs, jnp.stack([angle])])

        M, m = self.body_mass, self.leg_mass
        points = [M, M, m, m, m, m]
        masses = jnp.stack([*points, self.leg_inertia, self.leg_inertia, self.body_inertia])
        return System(transfer, masses, gravity(self.slope, masses, turns=3))

    def swing_foot(self, q):
        return swing_foot_of(self, q)


LeggedWalker = RoundFootWalker | UpperBodyWalker


def legs_of(
    walker: LeggedWalker, q: Float[Array, " 4"]
) -> tuple[Float[Array, " 2"], Float[Array, " 6"]]:
    """The hip; and the legs' centres of mass and angles."""
    u, v, theta, phi = q
    radius = walker.foot_radius
    centre = jnp.stack([u - radius * theta, v + radius])
    hip = centre + (walker.leg_length - radius) * leg(theta)

    def centre_of_mass(angle):
        forward = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        return hip - walker.com_from_hip * leg(angle) + walker.com_offset * forward

    swing = theta - phi
    angles = jnp.stack([theta, swing])
    return hip, jnp.concatenate([centre_of_mass(theta), centre_of_mass(swing), angles])


def swing_foot_of(walker: LeggedWalker, q: Float[Array, " 4"]) -> Float[Array, " 2"]:
    """(u, v) of the swing foot: of the arc's centre, as if that foot had rolled there."""
    hip, _ = legs_of(walker, q)
    angle, radius = q[2] - q[3], walker.foot_radius
    centre = hip - (walker.leg_length - radius) * leg(angle)
    return centre + jnp.stack([radius * angle, -radius])


def check_legs(walker: LeggedWalker) -> None:
    values = (walker.foot_radius, walker.leg_length, walker.leg_inertia, walker.com_from_hip)
    if any(isinstance(value, Tracer) for value in (*values, walker.com_offset)):
        return
    radius, length, inertia, down = map(float, values)
    if radius >= length:
        raise WrongUse(f"foot_radius must be less than leg_length {length:g}, not {radius:g}")
    if inertia == 0 and down == 0 and float(walker.com_offset) == 0:
        raise WrongUse("leg_inertia must be above 0 where com_from_hip and com_offset are 0, not 0")
