"""The walker with knees."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.checks import WrongUse, is_traced
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.systems.system import fields_of
from walker_jax.walkers.heavy_legs import HeavyLegWalker, pendulum_region
from walker_jax.walkers.masses import (
    MultibodyPhase,
    gravity,
    leg,
    masses_struck,
    rises_ever_faster,
    stance_coordinates,
)
from walker_jax.walkers.model import DRIVE, STEP, Scalar, State, least_scuff, shown_by
from walker_jax.walkers.parameter_table import (
    CHECK_LOCK,
    CHECK_SCUFFING,
    HIP_MASS,
    KNEED_SLOPE,
    POINT_FOOT,
    SHANK_COM,
    SHANK_INERTIA,
    SHANK_LENGTH,
    SHANK_MASS,
    THIGH_COM,
    THIGH_INERTIA,
    THIGH_LENGTH,
    THIGH_MASS,
)


class BentState(NamedTuple):
    """Angles (rad) and rates of the legs while the swing knee is free, or their derivatives.

    `phi` is the angle between the stance leg and the swing thigh. `knee` is the angle from the
    shank to the thigh, positive where the knee is bent.
    """

    theta: Scalar
    phi: Scalar
    knee: Scalar
    thetadot: Scalar
    phidot: Scalar
    kneedot: Scalar


class KneedWalker(HeavyLegWalker):
    """A walker with knees: a hip, two thighs and two shanks, on feet that are points or roll.

    A stride has two phases. From heel strike to knee strike the knee of the swing leg is free. At
    knee strike it locks, by a plastic impact, and stays locked: the leg swings straight until heel
    strike, and then stands. If the released knee does not bend at heel strike but presses on its
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
    - `check_lock`: whether a stride fails (`BUCKLED`) where the stance knee is not pressed on its
      stop, so that only a lock keeps it from bending. By default the lock holds it.
    - `check_scuffing`: whether a stride fails (`SCUFFED`) where the foot is below the ground while
      the knee is bent, or as it strikes. By default scuffing is ignored.

    Raises `ValueError` otherwise, and for shanks free to turn: without inertia, and with the centre
    of mass at the knee.
    """

    slope: Scalar = eqx.field(converter=KNEED_SLOPE.convert)
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
    check_lock: bool = eqx.field(static=True, converter=CHECK_LOCK.convert, default=False)
    check_scuffing: bool = eqx.field(static=True, converter=CHECK_SCUFFING.convert, default=False)

    def __check_init__(self):
        values = (self.foot_radius, self.thigh_length, self.shank_length)
        values += (self.shank_inertia, self.shank_com)
        if is_traced(values):
            return
        radius, thigh, shank, inertia, down = map(float, values)
        if radius >= thigh + shank:
            raise WrongUse(
                "foot_radius must be less than thigh_length and shank_length together, "
                f"{thigh + shank:g}, not {radius:g}",
                of="foot_radius thigh_length shank_length",
            )
        if inertia == 0 and down == 0:
            raise WrongUse(
                "shank_inertia must be above 0 where shank_com is 0, not 0",
                of="shank_inertia shank_com",
            )

    def phases(self):
        return (FreeKnee(self),)

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        return True

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    @shown_by(*STEP)
    def gait_region(self):
        return pendulum_region(self, self.thigh_length + self.shank_length)

    def further_gait_region(self):
        """Where feet are large and the slope is steep too, steps are long and fast."""
        axes = {"theta": (0.4, 1.2, 20), "sum": (-0.5, 0.5, 20), "turn": (-2.0, -0.4, 16)}
        return pendulum_region(self, self.thigh_length + self.shank_length, axes)

    def conditions(self):
        if not self.check_lock:
            return {}
        return {"BUCKLED": lambda state: stance_knee_moment(self, begin_bent(state), (4,))}

    def places(self, q: Float[Array, " q"]) -> tuple[Float[Array, " 2"], ...]:
        """Return the hip, the stance knee, the swing knee, and the centre of the swing foot's arc.

        q is (u, v, theta, phi, knee). It may end with the angle of a bent stance knee; theta is
        then that of the thigh.
        """
        u, v, theta, phi, knee = q[:5]
        radius, thigh = self.foot_radius, theta - phi
        shank = theta - q[5] if len(q) > 5 else theta
        below = self.shank_length - radius
        centre = jnp.stack([u - radius * shank, v + radius])
        stance_knee = centre + below * leg(shank)
        # One term for a straight stance leg: a stride takes a twentieth less time.
        hip = stance_knee + self.thigh_length * leg(theta)
        if len(q) == 5:
            hip = centre + (below + self.thigh_length) * leg(theta)
        swing_knee = hip - self.thigh_length * leg(thigh)
        foot = swing_knee - below * leg(thigh - knee)
        return hip, stance_knee, swing_knee, foot

    def bent_system(self) -> System:
        """Return the masses with free knees, for q as `places` takes it."""

        def transfer(q):
            hip, stance_knee, swing_knee, _ = self.places(q)
            theta, thigh, swing_shank = q[2], q[2] - q[3], q[2] - q[3] - q[4]
            stance_shank = theta - q[5] if len(q) > 5 else theta
            thighs = [hip - self.thigh_com * leg(angle) for angle in (theta, thigh)]
            shanks = [
                stance_knee - self.shank_com * leg(stance_shank),
                swing_knee - self.shank_com * leg(swing_shank),
            ]
            angles = jnp.stack([theta, stance_shank, thigh, swing_shank])
            return jnp.concatenate([hip, *thighs, *shanks, angles])

        M, m, n = self.hip_mass, self.thigh_mass, self.shank_mass
        turning = [self.thigh_inertia, self.shank_inertia]
        masses = jnp.stack([M, M, *[m] * 4, *[n] * 4, *turning, *turning])
        return System(transfer, masses, gravity(self.slope, masses, turns=4))

    def struck(self, state, impulse, arm):
        return masses_struck((*self.phases(), self)[0], state, impulse, arm)

    def in_swing(self):
        return LockedWalker(**fields_of(self))

    def bent_leg(self, state):
        hip, _, *leg_below = self.places(stance_coordinates(list(state[:3])))
        return jnp.stack(leg_below) - hip

    def system(self):
        """Return the system with straight legs."""
        bent = self.bent_system()
        return System(lambda q: bent.transfer(straight(q)), bent.masses, bent.forces)

    def bent_swing_foot(self, q: Float[Array, " 5"]) -> Float[Array, " 2"]:
        """Return (u, v) of the swing foot, from its arc's centre, as if it had rolled there."""
        *_, centre = self.places(q)
        angle, radius = q[2] - q[3] - q[4], self.foot_radius
        return centre + jnp.stack([radius * angle, -radius])

    def swing_foot(self, q):
        return self.bent_swing_foot(straight(q))


class LockedWalker(KneedWalker):
    """A walker with knees that stay straight: a `KneedWalker` from knee strike on."""

    def phases(self):
        return ()

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        return True


def begin_bent(state: State) -> BentState:
    """Return the state with the angle and the rate of a straight knee added."""
    theta, phi, thetadot, phidot = state
    zero = jnp.zeros_like(theta)
    return BentState(theta, phi, zero, thetadot, phidot, zero)


@partial(jax.jit, static_argnums=2)
def stance_knee_moment(
    walker: KneedWalker, state: BentState, locked: tuple[int, ...] = ()
) -> Scalar:
    """Compute the moment that presses the stance knee on its stop; if negative, the knee bends.

    It is the constraint force dual to the angle of the stance knee, (4). Other coordinates may be
    locked.
    """

    def moment(walker, state):
        zero = jnp.zeros_like(state.theta)
        q, qdot = (stance_coordinates([*half, zero]) for half in (state[:3], state[3:]))
        held = (0, 1, *locked, 5)
        return multibody.solve_motion(walker.bent_system(), q, qdot, held=held).forces[5]

    return unroll(moment)(walker, state)


def straight(q: Float[Array, " 4"]) -> Float[Array, " 5"]:
    """Return q of straight legs, with the angle of the knee added."""
    return jnp.concatenate([q, jnp.zeros_like(q[:1])])


class FreeKnee(MultibodyPhase):
    """The phase from heel strike to knee strike: the knee of the swing leg is free.

    The swing foot must not come down in front: a foot that lands on a bent knee does not stand.
    """

    walker: KneedWalker

    def begin(self, state):
        return begin_bent(state)

    def system(self):
        return self.walker.bent_system()

    def conditions(self):
        """The moment of the stance knee, and the height of the foot, if these are checked."""
        walker, found = self.walker, {}
        if walker.check_lock:
            found["BUCKLED"] = lambda state: stance_knee_moment(walker, state)
        if walker.check_scuffing:
            length = walker.thigh_length + walker.shank_length
            found["SCUFFED"] = lambda state: self.clearance(state) + least_scuff(length)
        return found

    def event(self, state):
        return -state.knee

    def closing(self, q):
        return q[4:]

    def end(self, state):
        """The knee locks: the walker keeps its angular momentum about the stance foot, and the
        swing leg its own about the hip."""
        thetadot, phidot, _ = self.rates_after(state)
        return State(state.theta, state.phi, thetadot, phidot)

    def clearance(self, state):
        above = lambda walker, *q: walker.bent_swing_foot(stance_coordinates([*q]))[1]
        return unroll(above)(self.walker, *state[:3])

    def reach(self, state):
        ahead = lambda walker, *q: walker.bent_swing_foot(stance_coordinates([*q]))[0]
        return unroll(ahead)(self.walker, *state[:3])
