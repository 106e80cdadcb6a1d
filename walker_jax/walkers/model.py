"""A walker: its state, its section, its equations, and its known properties.

Conventions and equation numbers are those of Schwab and Wisse (2001). Gravity is 1. The units of
mass and length are the user's; where a walker has no parameter for them, they are the hip's mass
and the leg's length. Times are in sqrt(unit of length / gravity), angles in rad:

- `slope`: of the ground, downwards in the direction of walking;
- `theta`: of the stance leg, from the normal of the slope, positive before mid-stance;
- `phi`: between the legs, from the stance leg to the swing leg.

A stride begins just after heel strike, on the Poincaré section, with both feet on the slope
(phi = 2 theta), and ends at the next heel strike.
"""

import abc
from collections.abc import Callable
from functools import wraps
from typing import Any, ClassVar, TypeGuard, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse, check_kind
from walker_jax.fingerprints import keep_files_of
from walker_jax.grids import Grid, axes_around
from walker_jax.hybrid.modes import SECTION, Condition, EarlyExit, Guard, Mode
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import VectorField
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.systems.trees import in_dtype, settle
from walker_jax.walkers.full_states import check_lands_on_section, check_motion
from walker_jax.walkers.ground import raise_ground
from walker_jax.walkers.parameters import SLOPE
from walker_jax.walkers.phase import (
    Conditions,
    Phase,
    State,
    fall_guards,
    home_of,
    is_planar,
    legs,
    mode_of,
    some_state,
)
from walker_jax.walkers.pictures import picture_of_legs

LEAST_SCUFF = {jnp.dtype("float64"): 1e-9, jnp.dtype("float32"): 1e-5}
"""Depth, in legs, from which on a foot counts as below the ground: less is rounding, where it
touches."""


class Walker(HybridSystem):
    """A walker, as strides know it: its fields are its parameters, scalars, and options."""

    spans: ClassVar[dict[str, tuple[float, float]]] = {"slope": SLOPE.span}
    state: ClassVar[type] = State
    """The `NamedTuple` of full states during the swing, with at least the fields of `State`."""
    longest_step: ClassVar[float | None] = None
    """Longest step of the integration, as for a `Mode`."""
    most_steps: ClassVar[int] = 10_000
    """A phase or swing that has not ended after so many integration steps is `UNDECIDED`. A stride
    makes less than a hundred; a walker that rocks on its feet makes all of them."""

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        keep_files_of(cls)

    def __check_init__(self):
        settle(self)
        check_lands_on_section(self)

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> State:
        """Return the full state of a point of the section."""

    @abc.abstractmethod
    def feasible(self, x: Float[Array, " section"]) -> Bool[Array, ""]:
        """Return whether a stride can begin at x.

        For an infeasible start, `walker-jax walk` shows the first line of a walker's own docstring
        here.
        """

    def gait_region(self) -> Grid:
        """Return the part of the section where the states of gaits lie, in cells to search from.

        By default it holds starts whose speed takes the stance leg about to its dead point. Rates
        are in units of the toppling rate. phidot covers any motion of the legs. Joints are at rest
        at 0: a walker whose joints are elsewhere in its gait has its own region.
        """
        dtype = jnp.result_type(float)
        walker = in_dtype(self, dtype, jnp.asarray)
        rate, widest = float(toppling_rate(walker)), 0.6
        axes = {"theta": (0, widest, 100), "sum": (-1.5 * widest, 0.5 * widest, 800)}
        if len(self.section) > 2:
            axes = {
                "theta": (0, widest, 30),
                "sum": (-widest, 0.5 * widest, 50),
                "turn": (-widest, 0.5 * widest, 16),
            }
        return region_of_starts(self, axes, rate)

    def phases(self) -> tuple[Phase, ...]:
        """Return the phases of a stride before its last, the swing; by default there are none."""
        return ()

    def begin(self, state: State) -> Any:
        """Return the state of the first phase, from one on the section."""
        phases = self.phases()
        return phases[0].begin(state) if phases else state

    def full_states(self) -> tuple[type, ...]:
        """Return the kinds of full states: that of the swing, and that of the first phase."""
        if not (phases := self.phases()):
            return (self.state,)
        first = jax.eval_shape(phases[0].begin, some_state(self))
        return self.state, type(first)

    def launch(self, x):
        if x.shape == (len(self.section),):
            start = self.lift(x)
        else:
            start = next(kind for kind in self.full_states() if len(kind._fields) == len(x))(*x)
        if not isinstance(start, self.state):
            return start
        check_motion(self, start)
        return self.begin(start)

    def may_launch(self, x, start):
        """A launched walker stands, and its first phase is not over."""
        if x.shape == (len(self.section),):
            return self.feasible(x)
        feasible = jnp.all(jnp.isfinite(x)) & (jnp.abs(start.theta) < np.pi / 2)
        if phases := self.phases():
            feasible &= phases[0].event(start) <= 0
        return feasible

    def shown(self, state):
        phases = self.phases()
        of_first = not phases or type(state) is self.full_states()[1]
        return state if of_first else phases[0].begin(legs(state))

    def unit_of_time(self):
        """Return the time in which the walker topples, to first order."""
        return 1 / toppling_rate(self)

    def modes(self) -> dict[str, Mode]:
        """Return the modes of a stride, its phases and the swing, built from the other methods.

        The swing ends at heel strike, where the contact coordinate rises through zero with the foot
        ahead, or in a fall. Heel strike leads to the section by the impact and the exchange of
        legs, if the trailing foot lifts. Your own walker may change the modes, for example give the
        swing another guard before its last.
        """
        lifts = Condition(lambda state: self.impact(state)[0][1], Outcome.STOPPED.name)
        strike = Guard(
            self.contact,
            SECTION,
            (self.is_ahead,),
            reset=lambda state: self.exchange_legs(self.impact(state)[1]),
            must_hold=(lifts,),
        )
        over = lambda state: (self.contact(state) > 0) & self.past_contact(state)
        known = is_unchanged(self, home_of(type(self), "past_contact"), *SWING)
        exits = EarlyExit(over, Outcome.FORWARD.name) if known else None
        hooks = ((self, method) for method in GUARD_HOOKS)
        swing = mode_of(self, self, (*fall_guards(self), strike), hooks)._replace(early_exit=exits)
        phases = self.phases()
        names = [*(phase.name() for phase in phases), "swing"]
        if len(set(names)) < len(names):
            raise WrongUse(f"phases of {self.label()} must have different names, not {names}")
        onto = zip(names, phases, names[1:], strict=False)
        return {name: one.mode(next) for name, one, next in onto} | {"swing": swing}

    def modes_on(self, step):
        """In the plane, with a further mode for a foot on its way to lower ground."""
        return raise_ground(self, self.modes(), step) if is_planar(self) else None

    def equations(self) -> VectorField:
        """Return the equations of motion to integrate: the vector field, or a `PowerBalance`."""
        return self.vector_field

    @abc.abstractmethod
    def vector_field(self, state: State) -> State:
        """Return the time derivative of the state during a stride, or its last phase.

        It may have kinks, such as the limits of a torque: a step of the integration ends at a kink.
        Where it jumps within a stride, or just after its end, the outcome is `UNDECIDED`.
        """

    @abc.abstractmethod
    def contact_force(self, state: State) -> tuple[Scalar, Scalar]:
        """Return the force on the stance foot, along and normal to the slope, (Q_u, Q_v)."""

    def past_contact(self, state: Any) -> Bool[Array, ""]:
        """Return whether h > 0 can only grow from here, so that no heel strike follows.

        By this sufficient condition the integration stops once a fall is certain; outcomes must not
        depend on it. By default that is never known. A class that redefines one
        of the methods in `SWING` and not this one does without.
        """
        return jnp.zeros_like(state.theta, bool)

    def conditions(self) -> Conditions:
        """Return functions that must not be negative up to heel strike, besides the force Q_v."""
        return {}

    @abc.abstractmethod
    def impact(self, state: State) -> tuple[tuple[Scalar, Scalar], State]:
        """Return the trailing foot's velocity (u, v) and the state after impact, legs as before.

        The argument is the state at heel strike, before the impact. With the legs exchanged, the
        state after it must be on the section; construction raises `WrongUse` otherwise.
        """

    def push(self, state: State, change: Scalar) -> State:
        """Return the state just after heel strike with thetadot changed by a push forward or back.

        The section's other coordinates stay as they are.
        """
        return state._replace(thetadot=state.thetadot + change)

    def contact(self, state: State) -> Scalar:
        """Return the contact coordinate h = phi - 2 theta: zero when both feet are on the slope.

        It rises at heel strike. A swing foot ahead of the stance foot is above the ground where h <
        0.
        """
        return state.phi - 2 * state.theta

    def is_ahead(self, state: Any) -> Scalar:
        """Return a positive number where the swing foot is ahead: coming down is heel strike.

        Elsewhere coming down is scuffing, which a stride ignores. By default the foot is ahead past
        mid-stance.
        """
        return -state.theta

    def falls(self, state: Any) -> dict[str, Scalar]:
        """Return functions that rise through zero where the walker falls, by name of failure.

        The name is that of an `Outcome`, or of one of the walker's own `failures`. The earliest
        fall counts; at the start of a stride, the first function that is not negative. The default
        is for the plane.
        """
        return {"BACKWARD": state.thetadot, "FORWARD": -np.pi / 2 - state.theta}

    @abc.abstractmethod
    def clearance(self, state: State) -> Scalar:
        """Return the height of the swing foot above the slope, in the unit of length."""

    @abc.abstractmethod
    def reach(self, state: State) -> Scalar:
        """Return the distance of the swing foot ahead of the stance foot, along the slope."""

    def bent_leg(self, state: Any) -> Float[Array, "2 2"] | None:
        """Return the places of the swing knee and of the leg's end, from the hip, for pictures.

        The state is one of the first phase. By default legs are drawn straight.
        """
        return None

    def picture(self) -> Any:
        """In the plane, two legs."""
        return picture_of_legs(self) if is_planar(self) else None

    def struck(
        self, state: Any, impulse: Float[Array, " 2"], arm: tuple[Scalar, Scalar]
    ) -> Any | None:
        """Return a state after an impulse at the hip, along the slope and normal to it.

        `arm` is the derivative of the hip's place by theta. By default it is not known which masses
        move with the hip: None.
        """
        return None

    def in_swing(self) -> "Walker":
        """Return the walker once its phases are over; by default the walker itself."""
        return self

    def step_length(self, x, end):
        """In the plane the step before x: a foot stands, or rolls by the angle of its leg, so the
        state at heel strike gives the length."""
        return self.reach(self.exchange_legs(self.lift(x)))

    def basin_region(self, gait):
        """A window around a gait, in the plane of theta and the sum of theta and thetadot."""
        if (state := gait()) is None:
            return None
        return Grid.sheared(**axes_around(state, ("theta", "sum", *self.section[2:])))

    def exchange_legs(self, state: State) -> State:
        """Return the state with the swing leg as the new stance leg, (21) and its derivative."""
        theta, phi, thetadot, phidot = (getattr(state, name) for name in State._fields)
        return state._replace(
            theta=theta - phi, phi=-phi, thetadot=thetadot - phidot, phidot=-phidot
        )


def check_planar(walker: Any) -> Walker:
    """Raise `WrongUse` for walkers in space, where the theory holds in the plane only."""
    check_kind("walker", walker, Walker)
    if not is_planar(walker):
        raise WrongUse(f"walker must be planar, not a {type(walker).__name__}", of="walker")
    return walker


WalkerKind = TypeVar("WalkerKind", bound=Walker)
GUARD_HOOKS = "contact", "clearance", "is_ahead", "falls", "swing_foot"
"""Methods from which the guards of a swing are made."""
EQUATIONS = "vector_field", "equations", "modes", "system"
SWING = (*EQUATIONS, "contact", "swing_foot", "is_ahead", "falls", "contact_force")
"""Methods that say how a walker swings, and where that ends."""
WORK = "vector_field", "modes", "impact", "phases"
DRIVE = (*WORK, "push_off_impulse", "during_stride")
"""Methods that may do work."""
STEP = (*EQUATIONS, "contact", "swing_foot", "impact", "lift", "project")
"""Methods on which the states of gaits depend most."""


def is_unchanged(walker: System, kind: type, *methods: str) -> bool:
    """Return whether a walker has these methods of some class of walkers."""
    same = lambda name: getattr(type(walker), name, None) is getattr(kind, name, None)
    return all(map(same, methods))


def shown_by(*methods: str) -> Callable[[Callable], Any]:
    """Decorate a method that states a fact, shown of its class by some other methods.

    Where a derived class redefines one of these, the base class states the fact.
    """

    def decorate(fact: Callable) -> Callable:
        @wraps(fact)
        def state(walker, *args):
            bases = type(walker).__mro__
            kind = next(base for base in reversed(bases) if getattr(base, name, None) is state)
            if is_unchanged(walker, kind, *methods):
                return fact(walker, *args)
            return getattr(super(kind, walker), name)(*args)

        name = fact.__name__
        return state

    return decorate


def moves_like(walker: System, kind: type[WalkerKind]) -> TypeGuard[WalkerKind]:
    """Return whether a walker moves as one of some kind does, by the same methods."""
    return isinstance(walker, kind) and is_unchanged(walker, kind, *SWING, *DRIVE, *STEP)


def region_of_starts(walker: Walker, axes: dict[str, Any], rate: float) -> Grid:
    """Return starts by theta, the sum of theta and thetadot, and phidot; joints are at rest at 0.

    Rates are in units of `rate`.
    """
    axes = axes | {joint: (-0.5, 0.5, 1) for joint in walker.section[len(axes) :]}
    units = [rate if name.endswith("dot") else 1.0 for name in walker.section]
    shear = np.diag(units)
    shear[1, 0] = -rate
    return Grid(axes, shear)


def least_scuff(length: Scalar) -> Scalar:
    """Return the depth from which on a foot counts as below the ground, for a length of legs."""
    return LEAST_SCUFF[jnp.dtype(jnp.result_type(length))] * length


@kernel
def toppling_rate(walker: Walker) -> Scalar:
    """Compute the rate at which a walker topples, legs together, from rest.

    To first order thetaddot = rate^2 (theta - slope).
    """
    slope = vars(walker)["slope"]
    rest = walker.state(*[jnp.zeros_like(slope)] * len(walker.state._fields))
    upright, falling = rest._replace(theta=slope), rest._replace(theta=jnp.ones_like(slope))
    _, change = jax.jvp(walker.vector_field, (upright,), (falling,))
    return jnp.sqrt(jnp.abs(change.thetadot))
