"""The walker with knees."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.walkers.abstract_round_foot import FOOT_RADIUS
from walker_jax.walkers.heavy_legs import HeavyLegWalker
from walker_jax.walkers.masses import (
    MultibodyPhase,
    gravity,
    leg,
    rises_ever_faster,
    stance_coordinates,
)
from walker_jax.walkers.model import Scalar, State
from walker_jax.walkers.parameters import SLOPE, Parameter
from walker_jax.walkers.round_foot import HIP_MASS

THIGH_MASS = Parameter("thigh_mass", "of each thigh", "mass", 1.0, closed=True)
SHANK_MASS = Parameter("shank_mass", "of each shank", "mass", 0.1)
THIGH_LENGTH = Parameter("thigh_length", "from the hip to the knee", "length", 0.5)
SHANK_LENGTH = Parameter("shank_length", "from the knee to the sole", "length", 0.5)
THIGH_COM = Parameter(
    "thigh_com", "distance of a thigh's centre of mass below the hip", "length", 0.325, -np.inf
)
SHANK_COM = Parameter(
    "shank_com", "distance of a shank's centre of mass below the knee", "length", 0.125, -np.inf
)
THIGH_INERTIA = Parameter(
    "thigh_inertia",
    "of each thigh about its centre of mass",
    "mass length^2",
    0.0,
    closed=True,
)
SHANK_INERTIA = Parameter(
    "shank_inertia",
    "of each shank about its centre of mass",
    "mass length^2",
    0.0,
    closed=True,
)
POINT_FOOT = FOOT_RADIUS._replace(default=0.0)


class BentState(NamedTuple):
    """Angles (rad) and rates of the legs while the swing knee is free, or their derivatives.

    `phi` is between the stance leg and the swing thigh, `knee` from the shank to the thigh: above 0
    where the knee is bent.
    """

    theta: Scalar
    phi: Scalar
    knee: Scalar
    thetadot: Scalar
    phidot: Scalar
    kneedot: Scalar


class KneedWalker(HeavyLegWalker):
    """A walker with knees: a hip, two thighs and two shanks, on feet that are points or roll.

    A stride has two phases. From heel strike to knee strike the knee of the swing leg is free.
    There it locks, by a plastic impact, and stays locked: the leg swings straight until heel
    strike, and then stands. If the knee, released at heel strike, does not bend but presses on its
    stop, it locks at once. Feet are arcs centred on the shanks' lines.

    Mochon and McMahon (1980), McGeer (1990), Hsu Chen (2007).

    **Arguments:** masses in any unit, lengths in any unit L, times then in sqrt(L / gravity).

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `hip_mass`: a point mass at the hip, not negative.
    - `thigh_mass`, `shank_mass`: of each thigh, not negative, and of each shank, above 0.
    - `thigh_length`, `shank_length`: from the hip to the knee, and from there to the sole; above 0.
    - `thigh_com`, `shank_com`: distances of their centres of mass below the hip and the knee.
    - `thigh_inertia`, `shank_inertia`: about these centres, not negative.
    - `foot_radius`: not negative, and less than the length of the leg; 0 for point feet.

    `ValueError` otherwise, and for shanks that nothing keeps from turning: no inertia, and a centre
    of mass at the knee.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)
    hip_mass: Scalar = eqx.field(converter=HIP_MASS.convert, default=HIP_MASS.default)
    thigh_mass: Scalar = eqx.field(converter=THIGH_MASS.convert, default=THIGH_MASS.default)
    shank_mass: Scalar = eqx.field(converter=SHANK_MASS.convert, default=SHANK_MASS.default)
    thigh_length: Scalar = eqx.field(converter=THIGH_LENGTH.convert, default=THIGH_LENGTH.default)
    shank_length: Scalar = eqx.field(converter=SHANK_LENGTH.convert, default=SHANK_LENGTH.default)
    thigh_com: Scalar = eqx.field(converter=THIGH_COM.convert, default=THIGH_COM.default)
    shank_com: Scalar = eqx.field(converter=SHANK_COM.convert, default=SHANK_COM.default)
    thigh_inertia: Scalar = eqx.field(
        converter=THIGH_INERTIA.convert, default=THIGH_INERTIA.default
    )
    shank_inertia: Scalar = eqx.field(
        converter=SHANK_INERTIA.convert, default=SHANK_INERTIA.default
    )
    foot_radius: Scalar = eqx.field(converter=POINT_FOOT.convert, default=POINT_FOOT.default)

    def __check_init__(self):
        values = (self.foot_radius, self.thigh_length, self.shank_length)
        values += (self.shank_inertia, self.shank_com)
        if any(isinstance(value, Tracer) for value in values):
            return
        radius, thigh, shank, inertia, down = map(float, values)
        if radius >= thigh + shank:
            raise WrongUse(
                "foot_radius must be less than thigh_length and shank_length together, "
                f"{thigh + shank:g}, not {radius:g}"
            )
        if inertia == 0 and down == 0:
            raise WrongUse("shank_inertia must be above 0 where shank_com is 0, not 0")

    def phases(self):
        return (FreeKnee(self),)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def joints(self, q: Float[Array, " 5"]) -> tuple[Float[Array, " 2"], ...]:
        """The hip, the swing knee, and the centre of the swing foot's arc."""
        u, v, theta, phi, knee = q
        radius, thigh = self.foot_radius, theta - phi
        length = self.thigh_length + self.shank_length
        hip = jnp.stack([u - radius * theta, v + radius]) + (length - radius) * leg(theta)
        swing_knee = hip - self.thigh_length * leg(thigh)
        return hip, swing_knee, swing_knee - (self.shank_length - radius) * leg(thigh - knee)

    def bent_system(self) -> System:
        """The masses while the knee is free, q = (u, v, theta, phi, knee)."""

        def transfer(q):
            hip, swing_knee, _ = self.joints(q)
            theta, thigh, shank = q[2], q[2] - q[3], q[2] - q[3] - q[4]
            stance_shank = hip - (self.thigh_length + self.shank_com) * leg(theta)
            thighs = [hip - self.thigh_com * leg(angle) for angle in (theta, thigh)]
            swing_shank = swing_knee - self.shank_com * leg(shank)
            angles = jnp.stack([theta, theta, thigh, shank])
            return jnp.concatenate([hip, *thighs, stance_shank, swing_shank, angles])

        M, m, n = self.hip_mass, self.thigh_mass, self.shank_mass
        turning = [self.thigh_inertia, self.shank_inertia]
        masses = jnp.stack([M, M, *[m] * 4, *[n] * 4, *turning, *turning])
        return System(transfer, masses, gravity(self.slope, masses, turns=4))

    def system(self):
        """That of straight legs."""
        bent = self.bent_system()
        return System(lambda q: bent.transfer(straight(q)), bent.masses, bent.forces)

    def bent_swing_foot(self, q: Float[Array, " 5"]) -> Float[Array, " 2"]:
        """(u, v) of the swing foot: of the arc's centre, as if that foot had rolled there."""
        *_, centre = self.joints(q)
        angle, radius = q[2] - q[3] - q[4], self.foot_radius
        return centre + jnp.stack([radius * angle, -radius])

    def swing_foot(self, q):
        return self.bent_swing_foot(straight(q))


def straight(q: Float[Array, " 4"]) -> Float[Array, " 5"]:
    """q of straight legs, with the angle of the knee."""
    return jnp.concatenate([q, jnp.zeros_like(q[:1])])


class FreeKnee(MultibodyPhase):
    """From heel strike to knee strike: the knee of the swing leg is free.

    The swing foot must not come down in front: a foot that lands on a bent knee does not stand.
    """

    walker: KneedWalker

    def begin(self, state):
        theta, phi, thetadot, phidot = state
        zero = jnp.zeros_like(theta)
        return BentState(theta, phi, zero, thetadot, phidot, zero)

    def system(self):
        return self.walker.bent_system()

    def event(self, state):
        return -state.knee

    def closing(self, q):
        return q[4:]

    def end(self, state):
        """The knee locks: the whole keeps its angular momentum about the stance foot, and the swing
        leg its own about the hip."""
        thetadot, phidot, _ = self.rates_after(state)
        return State(state.theta, state.phi, thetadot, phidot)

    def clearance(self, state):
        above = lambda walker, *q: walker.bent_swing_foot(stance_coordinates([*q]))[1]
        return unroll(above)(self.walker, *state[:3])

    def reach(self, state):
        ahead = lambda walker, *q: walker.bent_swing_foot(stance_coordinates([*q]))[0]
        return unroll(ahead)(self.walker, *state[:3])
