"""The parts of a stride before the swing, and the modes made from all parts.

The state, the falls and the conditions of a walker are those of its phases too.
"""

import abc
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp

from walker_jax.checks import WrongUse
from walker_jax.hybrid.modes import Condition, Function, Guard, Mode
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import VectorField
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import SHARED_FAILURES


class State(NamedTuple):
    """Angles (rad) and rates (rad per unit of time) of the two legs, or their time derivatives."""

    theta: Scalar
    phi: Scalar
    thetadot: Scalar
    phidot: Scalar


def legs(states: Any) -> State:
    """Return the angles and rates of the legs, from states of any phase."""
    return State(*(getattr(states, name) for name in State._fields))


Conditions = dict[str, Callable[[Any], Scalar]]
"""Functions of the state, by the name of the failure when one is negative: an `Outcome`, or one of
the walker's own failures."""


class Phase(eqx.Module):
    """A part of a stride before the swing: with its own constraints, and its own state.

    A state is a `NamedTuple` of scalars: the coordinates, then their rates in the same order. The
    angle of the stance leg and its rate are called `theta` and `thetadot` in all states.
    """

    walker: Any
    """The `Walker` that makes the stride."""

    @abc.abstractmethod
    def begin(self, state: State) -> Any:
        """Return its own state at the start of a stride; released parts are at rest."""

    @abc.abstractmethod
    def vector_field(self, state: Any) -> Any:
        """Return the time derivative of the state."""

    @abc.abstractmethod
    def contact_force(self, state: Any) -> tuple[Scalar, Scalar]:
        """Return the force on the stance foot, along and normal to the slope, (Q_u, Q_v)."""

    @abc.abstractmethod
    def event(self, state: Any) -> Scalar:
        """Return a number that is negative in the phase, and rises through zero at its end."""

    @abc.abstractmethod
    def end(self, state: Any) -> Any:
        """Return the state in which the next phase begins: a `State` if that is the swing.

        It follows the impact in which constraints are made, or the release of others.
        """

    def clearance(self, state: Any) -> Scalar | None:
        """Return the height of the swing foot above the slope, if it must not come down here.

        By default it may.
        """
        return None

    def reach(self, state: Any) -> Scalar:
        """Return the distance of the swing foot ahead of the stance foot, along the slope."""
        raise NotImplementedError

    def conditions(self) -> Conditions:
        """Return the conditions of this phase; the walker's own hold in the swing alone."""
        return {}

    def equations(self) -> VectorField:
        """Return the equations of motion to integrate, as for the walker."""
        return self.vector_field

    def name(self) -> str:
        """Return the name of its mode; by default that of the class."""
        return type(self).__name__

    def mode(self, onto: str) -> Mode:
        """Return the phase as a mode of a stride, which its event leads `onto` another one.

        It also ends in a fall, and where the swing foot comes down in front, if it must not.
        """
        walker, guards = self.walker, fall_guards(self.walker)
        may_land = jax.eval_shape(
            lambda state: self.clearance(self.begin(state)), some_state(walker)
        )
        if may_land is not None:
            below = lambda state: -cast("Scalar", self.clearance(state))
            guards.append(Guard(below, Outcome.BENT_KNEE.name, (walker.is_ahead, self.reach)))
        guards.append(Guard(self.event, onto, reset=self.end))
        hooks = *((self, name) for name in ("event", "clearance", "reach")), (walker, "falls")
        hooks = *hooks, (walker, "is_ahead")
        return mode_of(self, walker, guards, hooks)


def mode_of(
    part: Any, walker: Any, guards: Sequence[Guard], hooks: Iterable[tuple[Any, str]]
) -> Mode:
    """Return the mode of a phase, or of the swing, whose guards are made from some methods."""
    return Mode(
        part.equations(),
        tuple(guards),
        conditions_of(part),
        rates_at=part.vector_field,
        as_smooth=all(is_of_package(type(of), method) for of, method in hooks),
        longest_step=walker.longest_step,
        energy=energy_of(part),
        most_steps=walker.most_steps,
    )


def energy_of(part: Any) -> Function | None:
    """Return the method of a walker or a phase that gives its energy, if it has one."""
    energy: Any = getattr(part, "energy", None)
    of_a_state = callable(energy) and len(inspect.signature(energy).parameters) == 1
    return cast("Function", energy) if of_a_state else None


def is_of_package(kind: type, method: str) -> bool:
    """Return whether a method of a class, if it has it, is one of the package's own."""
    home = home_of(kind, method)
    return home is None or home.__module__.startswith("walker_jax.")


def home_of(kind: type, method: str) -> Any:
    """Return the class that defines a method of some class; None if it has no such method."""
    return next((base for base in kind.__mro__ if method in vars(base)), None)


def conditions_of(part: Any) -> tuple[Condition, ...]:
    """Return its conditions; the first is Q_v."""
    force = lambda state: part.contact_force(state)[1]
    pulls = Condition(force, Outcome.RUNNING.name, at_start=True)
    return pulls, *(Condition(one, name) for name, one in part.conditions().items())


def fall_guards(walker: Any) -> list[Guard]:
    """Return the falls of a walker as guards."""
    value = lambda name: lambda state: walker.falls(state)[name]
    kind, guards = type(walker).__name__, []
    for name, shape in jax.eval_shape(walker.falls, some_state(walker)).items():
        if name not in (names := (*walker.failures, *SHARED_FAILURES)):
            raise WrongUse(
                f"falls of {kind} must be named by a failure, one of {', '.join(names)}, "
                f"not {name!r}"
            )
        check_real(f"falls of {kind}: {name}", shape)
        guard = Guard(value(name), name, at_once=True)
        if name == "BACKWARD" and is_planar(walker):
            guard = guard._replace(measure=lambda speed: speed**2 / 2)  # smooth at a dead point
        guards.append(guard)
    return guards


def check_real(label: str, value: jax.ShapeDtypeStruct) -> None:
    """Raise `WrongUse` if a user's own hook returns something else than one real number."""
    if value.shape or not jnp.issubdtype(value.dtype, jnp.floating):
        raise WrongUse(
            f"{label} must be one real number, such as -theta, not {value.dtype} of shape "
            f"{value.shape}"
        )


def some_state(walker: Any) -> Any:
    """Return a full state without values, of the dtype of a walker's parameters."""
    dtype = jnp.result_type(0.0, *jax.tree.leaves(walker))
    number: Any = jax.ShapeDtypeStruct((), dtype)
    return walker.state(*[number] * len(walker.state._fields))


def is_planar(walker: Any) -> bool:
    """Return whether a system is a planar walker: the angles of its legs come first."""
    coordinates = getattr(getattr(walker, "state", None), "_fields", ())
    return coordinates[:2] == State._fields[:2]
