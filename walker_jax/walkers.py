"""Walkers: bipeds of two straight legs, one like the other, that go down a slope with no motor.

Conventions, those of Schwab and Wisse (2001), whose equation numbers stand below. Gravity is 1.
The unit of mass and that of length are the user's; where a walker has no parameter for them, they
are the hip's mass and the leg's length. Times are in sqrt(unit of length / gravity), angles in rad:

- `slope`: of the ground, downwards in the direction of walking;
- `theta`: of the stance leg, from the normal of the slope, positive before mid-stance;
- `phi`: between the legs, from the stance leg to the swing leg.

A stride begins just after heel strike, on the Poincaré section, with both feet on the slope
(phi = 2 theta), and ends at the next heel strike.

A walker of your own derives from `HeavyLegWalker`, and says where its masses are and where its
swing foot meets the ground: equations of motion, contact forces and impact follow (`multibody`).
"""

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple, TypeGuard, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax import multibody
from walker_jax.cells import Grid
from walker_jax.checks import WrongUse, short
from walker_jax.kernels import by_kernel
from walker_jax.kernels.scalars import unrolled
from walker_jax.multibody import System
from walker_jax.taylor import VirtualPower

Scalar = Float[Array, ""]


class State(NamedTuple):
    """Angles (rad) and rates (rad per unit of time) of the two legs, or their time derivatives."""

    theta: Scalar
    phi: Scalar
    thetadot: Scalar
    phidot: Scalar


class Walker(eqx.Module):
    """What a stride needs to know of a walker. Its fields are its parameters, scalars all."""

    section: ClassVar[tuple[str, ...]]
    """Names of the coordinates of the Poincaré section."""
    force_least_at_ends: ClassVar[bool] = False
    """Whether Q_v, over a stride, is least at the start or at heel strike, so that a stride need
    not look at it in between."""
    inverted_pendulum: ClassVar[bool] = False
    """Whether thetaddot = sin(theta - slope): the hip does not feel the swing leg."""

    def __init_subclass__(cls, **kwargs):
        """Reset what is known of the walkers that this class derives from, but not of it.

        What `KNOWN_OF` lists has been shown for the methods named there. Where a class defines one
        of these anew, and does not say that it still holds, the default of `Walker` holds.
        """
        super().__init_subclass__(**kwargs)
        for name, methods in KNOWN_OF.items():
            said = next(i for i, base in enumerate(cls.__mro__) if name in vars(base))
            if any(method in vars(base) for base in cls.__mro__[:said] for method in methods):
                setattr(cls, name, vars(Walker)[name])

    def __repr__(self):
        """The parameters' values, as far as each is one number; else their types and shapes."""
        shown = (f"{name}={displayed(value)}" for name, value in vars(self).items())
        return f"{type(self).__name__}({', '.join(shown)})"

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> State:
        """The full state of a point of the section."""

    @abc.abstractmethod
    def project(self, state: State) -> Float[Array, " section"]:
        """The point of the section of a state just after heel strike."""

    @abc.abstractmethod
    def feasible(self, x: Float[Array, " section"]) -> Bool[Array, ""]:
        """Whether a stride can begin at x."""

    def gait_region(self) -> Grid:
        """The part of the section where the states of gaits lie, in cells to search from.

        By default starts with the speed that takes the stance leg about to its dead point. Rates
        are counted in that of toppling. Along phidot, whatever legs may do.
        """
        dtype = jnp.asarray(0.0).dtype
        walker = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), self)
        rate, widest = float(toppling_rate(walker)), 0.6
        if len(self.section) == 2:
            axes = {"theta": (0, widest, 100), "sum": (-widest, 0.5 * widest, 600)}
            return Grid(axes, np.array([[1, 0], [-rate, rate]]))
        axes = {
            "theta": (0, widest, 30),
            "sum": (-widest, 0.5 * widest, 50),
            "turn": (-widest, 0.5 * widest, 16),
        }
        return Grid(axes, np.array([[1, 0, 0], [-rate, rate, 0], [0, 0, rate]]))

    @abc.abstractmethod
    def vector_field(self, state: State) -> State:
        """Time derivative of the state during a stride.

        It may have kinks, such as the limits of a torque: a step of the integration ends where one
        is. Where it jumps within a stride, or just behind its end, the outcome is `UNDECIDED`.
        """

    @abc.abstractmethod
    def contact_force(self, state: State) -> tuple[Scalar, Scalar]:
        """Force (Q_u, Q_v) of the ground on the stance foot, along and normal to the slope."""

    def driven_by_gravity(self) -> bool:
        """Whether gravity alone does work on the walker, so that a step loses what the slope gives.

        By default that is not known.
        """
        return False

    def past_contact(self, state: State) -> Bool[Array, ""]:
        """Whether h > 0 can only grow from here, so that no heel strike follows.

        It spares a walker that falls after a start on the section the rest of its fall: an outcome
        may not depend on it. By default that is never known.
        """
        return jnp.zeros_like(state.theta, bool)

    @abc.abstractmethod
    def impact(self, state: State) -> tuple[tuple[Scalar, Scalar], State]:
        """Velocity (u, v) of the trailing foot and the state, legs not yet exchanged, after impact.

        The state is that at heel strike, before the impact.
        """

    def contact(self, state: State) -> Scalar:
        """Contact coordinate h = phi - 2 theta: zero when both feet are on the slope.

        It rises at heel strike. Ahead of the stance foot the swing foot is above the ground where
        h < 0. A stride looks at it at the ends of integration steps, and takes it to turn once at
        most within one.
        """
        return state.phi - 2 * state.theta

    @abc.abstractmethod
    def clearance(self, state: State) -> Scalar:
        """Height of the swing foot above the slope, in the unit of length."""

    @abc.abstractmethod
    def reach(self, state: State) -> Scalar:
        """How far the swing foot is ahead of the stance foot, along the slope, in that unit."""

    def exchange_legs(self, state: State) -> State:
        """The state with the swing leg as the new stance leg, (21) and its time derivative."""
        theta, phi, thetadot, phidot = state
        return State(theta - phi, -phi, thetadot - phidot, -phidot)


Kind = TypeVar("Kind", bound=Walker)
MOTION = ("vector_field", "system")
KNOWN_OF = {
    "force_least_at_ends": (*MOTION, "contact_force"),
    "inverted_pendulum": MOTION,
    "driven_by_gravity": ("vector_field", "impact"),
    "past_contact": (*MOTION, "contact", "swing_foot"),
    "gait_region": (*MOTION, "contact", "swing_foot", "impact", "lift", "project"),
}
"""What may be known of a walker beyond its equations, and the methods that it is known of."""


def moves_like(walker: Walker, kind: type[Kind]) -> TypeGuard[Kind]:
    """Whether a walker moves as one of some kind does, by the same equations."""
    methods = {method for methods in KNOWN_OF.values() for method in methods}
    same = lambda name: getattr(type(walker), name, None) is getattr(kind, name, None)
    return isinstance(walker, kind) and all(map(same, methods))


def displayed(value: Any) -> str:
    """A number as it is; of arrays, and of what JAX traces, the type and shape."""
    if not eqx.is_array_like(value):
        return repr(value)
    single = not isinstance(value, Tracer) and np.shape(value) == ()
    return str(np.asarray(value)[()]) if single else eqx.tree_pformat(value)


class Parameter(NamedTuple):
    """What a parameter of a walker means, and the numbers it may be."""

    name: str
    meaning: str
    unit: str
    default: float
    """Of the command line; and of the constructor, but for the slope."""
    low: float = 0.0
    high: float = np.inf
    closed: bool = False
    """Whether it may be equal to `low`."""

    def checked(self, value: ArrayLike) -> Scalar:
        """The number as an array; `ValueError` for what is none, or not within the bounds."""
        refusal = f"{self.name} must be one real number, not {short(value)}"
        try:
            value = jnp.asarray(value)
        except (TypeError, ValueError, OverflowError):
            raise WrongUse(refusal) from None
        real = jnp.issubdtype(value.dtype, jnp.number) and jnp.isrealobj(value)
        if value.shape != () or not real:
            raise WrongUse(refusal)
        if not jnp.issubdtype(value.dtype, jnp.floating):
            value = value.astype(float)
        if isinstance(value, Tracer):
            return value
        number = np.asarray(value)
        above = number >= self.low if self.closed else number > self.low
        if not (above & (number < self.high)):
            raise WrongUse(f"{self.name} must be {self.bounds()}, not {value}")
        return value

    def bounds(self) -> str:
        """In words."""
        if self.low > -np.inf and self.high < np.inf:
            least = "at least" if self.closed else "above"
            return f"{least} {self.low:g} and below {self.high:g}"
        if self.low > -np.inf:
            return f"finite and {'not negative' if self.closed else f'above {self.low:g}'}"
        return "finite"


def parameters(walker: type[Walker] | Walker) -> tuple[Parameter, ...]:
    """Those of a kind of walker that it describes, in the order of its constructor's arguments."""
    converters = (field.metadata.get("converter") for field in dataclasses.fields(walker))
    described = (getattr(converter, "__self__", None) for converter in converters)
    return tuple(one for one in described if isinstance(one, Parameter))


SLOPE = Parameter("slope", "of the ground", "rad", 0.004, high=np.pi / 2)


@by_kernel
def toppling_rate(walker: Walker) -> Scalar:
    """The rate at which a walker topples, legs together, from rest.

    To first order thetaddot = rate^2 (theta - slope).
    """
    slope = vars(walker)["slope"]
    zero, one = jnp.zeros_like(slope), jnp.ones_like(slope)
    upright, falling = State(slope, zero, zero, zero), State(one, zero, zero, zero)
    _, change = jax.jvp(walker.vector_field, (upright,), (falling,))
    return jnp.sqrt(jnp.abs(change.thetadot))


class PointFeetWalker(Walker):
    """Walkers on point feet, with no mass on the legs but at their ends.

    A foot that stood does not move at once across its leg when it lifts, so phidot after heel
    strike follows from theta and thetadot, and the section has two dimensions.
    """

    section: ClassVar = ("theta", "thetadot")

    def lift(self, x):
        """phi = 2 theta, phidot = (1 - cos 2theta) thetadot, from (22).

        The trailing foot was at rest, and its leg pulls it along itself only: its velocity across
        the leg stays zero. That of the hip across that leg is cos(2 theta) thetadot, so the leg
        turns as fast, thetadot - phidot = cos(2 theta) thetadot, whatever the masses.
        """
        theta, thetadot = x[0], x[1]
        return State(theta, 2 * theta, thetadot, (1 - jnp.cos(2 * theta)) * thetadot)

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot])

    def clearance(self, state):
        return jnp.cos(state.theta) - jnp.cos(state.theta - state.phi)

    def reach(self, state):
        return jnp.sin(state.theta - state.phi) - jnp.sin(state.theta)

    def feasible(self, x):
        """0 < theta < pi/4 and thetadot < 0: beyond pi/4 no impact leaves the walker going on."""
        theta, thetadot = x[0], x[1]
        finite = jnp.isfinite(theta) & jnp.isfinite(thetadot)
        return finite & (theta > 0) & (theta < np.pi / 4) & (thetadot < 0)


class MasslessFeetWalker(PointFeetWalker):
    """The limit of vanishing foot mass: the hip does not feel the swing leg."""

    slope: Scalar

    def contact_force(self, state):
        """(8). Of an inverted pendulum, Q_v > 0 over a stride if it is at both its ends.

        For thetadot^2 / 2 + cos(theta - slope) is some constant E, and Q_v has the sign of
        3 cos(theta - slope) - 2 E, which is least at one end of any interval of theta.
        """
        tension = state.thetadot**2 - jnp.cos(state.theta - self.slope)
        return jnp.sin(state.theta) * tension, -jnp.cos(state.theta) * tension

    def impact(self, state):
        """(18), which has 2 theta for phi: the feet may also be at different heights."""
        theta, phi, thetadot, _ = state
        c, s = jnp.cos(phi), jnp.sin(phi)
        foot = -jnp.sin(theta) * c * s * thetadot, jnp.cos(theta) * c * s * thetadot
        return foot, State(theta, phi, c**2 * thetadot, c * (c - 1) * thetadot)

    def impulse(self, state: State) -> tuple[Scalar, Scalar]:
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (19).

        It is along the swing leg, as the paper says below (19), and changes the momentum of the
        hip to that after the impact: so rho_x has the sign of sin(theta) thetadot sin(2 theta),
        not the opposite one that is printed there.
        """
        s = jnp.sin(state.phi) * state.thetadot
        swing = state.theta - state.phi
        return -jnp.sin(swing) * s, jnp.cos(swing) * s


def rises_past_contact(walker: MasslessFeetWalker, state: State) -> Bool[Array, ""]:
    """h > 0 and rising, the swing leg ahead, the stance leg in compression.

    Then h'' = sin(phi) (thetadot^2 - cos(theta - slope)) - sin(theta - slope) > 0, and a spring
    between the legs adds to it: h goes on rising. It is too late to come down again once this has
    ended, by tension or with phi > 0: an experience (tests), not a theorem.
    """
    theta, phi, thetadot, phidot = state
    rising = (phi > 2 * theta) & (phidot > 2 * thetadot)
    return rising & (phi < 0) & (thetadot**2 < jnp.cos(theta - walker.slope))


def strip_of_gaits(slope: ArrayLike) -> Grid:
    """A strip of the section that shrinks like slope^{1/3}, as gaits do (Garcia and others 1998).

    Its upper edge is where walkers begin to fall backward, thetadot = -2 sin((theta - slope) / 2),
    at its widest.
    """
    angle = float(np.asarray(slope))
    widest = min(2 * angle ** (1 / 3), np.pi / 4)
    edge = widest - 2 * np.sin((widest - angle) / 2)
    return Grid.sheared(theta=(0, widest, 100), sum=(-0.15 * widest, edge, 1000))


class SimplestWalker(MasslessFeetWalker):
    """The simplest walking model: a mass at the hip, and feet of vanishing mass.

    Garcia, Chatterjee, Ruina and Coleman (1998); Schwab and Wisse (2001).

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2. `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.checked)

    force_least_at_ends: ClassVar = True
    inverted_pendulum: ClassVar = True

    def driven_by_gravity(self):
        return True

    def gait_region(self):
        return strip_of_gaits(self.slope)

    def past_contact(self, state):
        return rises_past_contact(self, state)

    def vector_field(self, state):
        """(7): thetaddot = sin(theta - slope), an inverted pendulum that the swing leg follows."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) + thetaddot
        return State(thetadot, phidot, thetaddot, phiddot)


HIP_STIFFNESS = Parameter(
    "hip_stiffness", "of a spring between the legs, to foot mass", "g l", 0.0, closed=True
)


class SpringWalker(MasslessFeetWalker):
    """The simplest walker with a torsional spring between its legs, slack when they are parallel.

    A spring of stiffness K exerts the torque -K phi on the swing leg, and the opposite one on the
    stance leg. In the limit of vanishing foot mass m it has an effect on the swing leg alone, and
    there only if K vanishes too, in proportion: with K = m g l hip_stiffness, (4) divided by m has
    the limit phiddot = sin(phi) (thetadot^2 - cos(theta - slope)) + sin(theta - slope)
    - hip_stiffness phi. The leg then swings like a pendulum whose gravity is larger by a factor
    1 + hip_stiffness. The spring exerts no impulse, so impact and contact force are as without it.

    Such a spring makes steps shorter and faster (Kuo 2002, J. Biomech. Eng. 124:113-120).

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `hip_stiffness`: K / (m g l), not negative.

    `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.checked)
    hip_stiffness: Scalar = eqx.field(
        converter=HIP_STIFFNESS.checked, default=HIP_STIFFNESS.default
    )

    force_least_at_ends: ClassVar = True
    inverted_pendulum: ClassVar = True

    def driven_by_gravity(self):
        return True

    def gait_region(self):
        return strip_of_gaits(self.slope)

    def past_contact(self, state):
        return rises_past_contact(self, state)

    def vector_field(self, state):
        """(7), and the spring."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        swing = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) - self.hip_stiffness * phi
        return State(thetadot, phidot, thetaddot, swing + thetaddot)


class MultibodyWalker(Walker):
    """Walkers whose equations follow from where their masses are, by the general method.

    The generalised coordinates are q = (u, v, theta, phi), with u and v those of the stance foot
    along and normal to the slope: zero on the ground, held there between heel strikes, and free at
    heel strike.
    """

    @abc.abstractmethod
    def system(self) -> System:
        """Masses, the transfer function x = F(q) that says where they are, (1), and forces, (6)."""

    @abc.abstractmethod
    def swing_foot(self, q: Float[Array, " 4"]) -> Float[Array, " 2"]:
        """The swing foot's coordinates, those that (u, v) are for the stance foot, (11)."""

    def driven_by_gravity(self):
        """As long as there are no generalised forces, and `forces` are those of gravity."""
        system, slope = self.system(), vars(self)["slope"]
        count = len(system.masses)
        weights = (gravity(slope, system.masses, turns) for turns in range(count % 2, count + 1, 2))
        falls = any(np.allclose(system.forces, weight, rtol=1e-6, atol=0) for weight in weights)
        return system.generalised_forces is None and falls

    def vector_field(self, state):
        """(4), with u and v held."""
        return SingleSupport(self)(state)

    def contact_force(self, state):
        """The forces dual to u and v that hold them, (4)."""
        _, (Q_u, Q_v, _, _) = motion(self, state)
        return Q_u, Q_v

    def impact(self, state):
        """(17), without restitution."""
        (u, v, thetadot, phidot), _ = collision(self, state)
        return (u, v), State(state.theta, state.phi, thetadot, phidot)

    def impulse(self, state: State) -> tuple[Scalar, Scalar]:
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (17)."""
        _, (rho_x, rho_y) = collision(self, state)
        return rho_x, rho_y

    def energy(self, state: State) -> Scalar:
        """Kinetic energy, and potential energy of gravity, the stance foot at the origin."""
        q, qdot = coordinates(state)
        system = self.system()
        return multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)


def rises_ever_faster(walker: MultibodyWalker, state: State) -> Bool[Array, ""]:
    """h > 0 rises ever faster, the swing leg ahead, the stance leg falling, in compression.

    As for the simplest walker it is too late then to come down again: an experience (tests).
    """
    (_, _, thetaddot, phiddot), (_, Q_v, _, _) = motion(walker, state)
    rising = (state.phi > 2 * state.theta) & (state.phidot > 2 * state.thetadot)
    faster = phiddot > 2 * thetaddot
    return rising & faster & (state.phi < 0) & (thetaddot < 0) & (Q_v > 0)


class SingleSupport(VirtualPower):
    """The equations of motion (2) of a walker whose stance foot is on the ground: u = v = 0."""

    walker: MultibodyWalker

    def transfer(self, q):
        flat = lambda walker, q: list(walker.system().transfer(of_feet(q)))
        return unrolled(flat)(self.walker, q)

    def power(self, q, qdot, acceleration):
        def flat(walker, q, qdot, acceleration):
            return list(
                multibody.virtual_power(
                    walker.system(), of_feet(q), of_feet(qdot), jnp.stack(acceleration)
                )[2:]
            )

        return unrolled(flat)(self.walker, q, qdot, acceleration)

    def factorise(self, q):
        def flat(walker, q):
            matrix = multibody.mass_matrix(walker.system(), of_feet(q))
            return multibody.factorise(multibody.block(matrix, (2, 3)))

        return unrolled(flat)(self.walker, q)

    def solve(self, factors, right):
        return multibody.solve(factors, right)


def of_feet(legs: list[Scalar]) -> Float[Array, " 4"]:
    """q = (u, v, theta, phi) from (theta, phi), the stance foot at the origin; or its rates."""
    zero = jnp.zeros_like(legs[0])
    return jnp.stack([zero, zero, *legs])


def coordinates(state: State) -> tuple[Float[Array, " 4"], Float[Array, " 4"]]:
    """q and its rates."""
    return of_feet(list(state[:2])), of_feet(list(state[2:]))


@jax.jit
def motion(walker: MultibodyWalker, state: State) -> tuple[list[Scalar], list[Scalar]]:
    """Accelerations, and the forces that hold u and v, of a walker on its stance foot, (4)."""

    def equations(walker, state):
        q, qdot = coordinates(state)
        accelerations, forces = multibody.motion(walker.system(), q, qdot, held=(0, 1))
        return list(accelerations), list(forces)

    return unrolled(equations)(walker, state)


@jax.jit
def collision(walker: MultibodyWalker, state: State) -> tuple[list[Scalar], list[Scalar]]:
    """Rates after heel strike, and impulses, (17)."""

    def equations(walker, state):
        q, qdot = coordinates(state)
        after = multibody.impact(walker.system(), walker.swing_foot, q, qdot)
        return list(after.velocities), list(after.impulses)

    return unrolled(equations)(walker, state)


def gravity(slope: Scalar, masses: Float[Array, " x"], turns: int = 0) -> Float[Array, " x"]:
    """Gravity, (6), on points in the plane, whose coordinates come before `turns` angles."""
    points = (len(masses) - turns) // 2
    down = jnp.stack([jnp.sin(slope), -jnp.cos(slope)])
    return masses * jnp.concatenate([*[down] * points, jnp.zeros(turns, masses.dtype)])


def leg(angle: Scalar) -> Float[Array, " 2"]:
    """The direction from foot to hip of a leg at an angle from the normal of the slope."""
    return jnp.stack([-jnp.sin(angle), jnp.cos(angle)])


FOOT_MASS = Parameter("foot_mass", "of each foot, to that of the hip", "hip mass", 0.01)


class PointFootWalker(PointFeetWalker, MultibodyWalker):
    """A mass at the hip, and one at each foot: the paper's own model before its limit.

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `foot_mass`: beta, the mass of a foot to that of the hip, above 0.

    `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.checked)
    foot_mass: Scalar = eqx.field(converter=FOOT_MASS.checked, default=FOOT_MASS.default)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def system(self):
        """(1), (5) and (6)."""

        def transfer(q):
            foot, theta, phi = q[:2], q[2], q[3]
            hip = foot + leg(theta)
            return jnp.concatenate([foot, hip, hip - leg(theta - phi)])

        beta, hip = self.foot_mass, jnp.ones_like(self.foot_mass)
        masses = jnp.stack([beta, beta, hip, hip, beta, beta])
        return System(transfer, masses, gravity(self.slope, masses))

    def swing_foot(self, q):
        """(11)."""
        return q[:2] + leg(q[2]) - leg(q[2] - q[3])

    def gait_region(self):
        return strip_of_gaits(self.slope)


class HeavyLegWalker(MultibodyWalker):
    """Walkers with mass anywhere on the legs, whose section has three dimensions.

    What a walker of your own derives from. Its fields are its parameters, scalars, `slope` among
    them. It defines `system` and `swing_foot`. Legs must be alike: with both feet on the slope,
    phi = 2 theta and v = 0 of either.
    """

    slope: Scalar

    section: ClassVar = ("theta", "thetadot", "phidot")

    def __check_init__(self):
        if any(np.shape(leaf) or isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self)):
            return
        foot = swing_foot_at(self, 0.3)
        if isinstance(foot, Tracer):  # of a walker made in a function that JAX transforms
            return
        along, above = np.asarray(foot)
        if not abs(above) <= 1e-5 * abs(along):
            raise WrongUse(
                f"swing_foot of {type(self).__name__} must be on the slope where phi = 2 theta, "
                f"v = 0, but v = {above:.3g} at theta = 0.3"
            )

    def lift(self, x):
        """phi = 2 theta."""
        return State(x[0], 2 * x[0], x[1], x[2])

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot, state.phidot])

    def clearance(self, state):
        above = lambda walker, *legs: walker.swing_foot(of_feet([*legs]))[1]
        return unrolled(above)(self, state.theta, state.phi)

    def reach(self, state):
        """Of feet that roll, how far the walker gets by a step, rolling included."""
        ahead = lambda walker, *legs: walker.swing_foot(of_feet([*legs]))[0]
        return unrolled(ahead)(self, state.theta, state.phi)

    def feasible(self, x):
        """0 < theta < pi/2, thetadot < 0, and the trailing foot lifts: phidot > 2 thetadot."""
        theta, thetadot, phidot = x[0], x[1], x[2]
        finite = jnp.isfinite(theta) & jnp.isfinite(thetadot) & jnp.isfinite(phidot)
        forward = (theta > 0) & (theta < np.pi / 2) & (thetadot < 0)
        return finite & forward & (phidot > 2 * thetadot)


@jax.jit
def swing_foot_at(walker: HeavyLegWalker, theta: Scalar | float) -> Float[Array, " 2"]:
    """(u, v) of the swing foot with legs as at heel strike, phi = 2 theta."""
    theta = jnp.asarray(theta, walker.slope.dtype)
    return walker.swing_foot(of_feet([theta, 2 * theta]))


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


WALKERS: dict[str, type[Walker]] = {
    "simplest": SimplestWalker,
    "spring": SpringWalker,
    "point-foot": PointFootWalker,
    "round-foot": RoundFootWalker,
    "upper-body": UpperBodyWalker,
}
"""The walkers there are, by their names on the command line."""
