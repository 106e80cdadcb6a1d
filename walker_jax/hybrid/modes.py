"""Hybrid systems: modes of motion with guards that end them, and conditions that must hold.

A mode has a vector field. Each of its guards is a function of the state; the mode ends at the
earliest admitted rise of a guard through zero. A guard is an edge in a graph of modes: it names
the mode to which it leads, the section, or a failure. It resets the state on the way. Conditions do
not end a mode: it is recorded whether they were violated.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from walker_jax.integrators.expansion import without_derivatives
from walker_jax.integrators.integrator import MOST_STEPS
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import VectorField

Function = Callable[[Any], Scalar]
SECTION = "section"
"""The name of the section, to which guards lead that complete a stride."""
SOON = 1024
"""A time over the dtype's epsilon. A value changes by more than rounding errors in it."""


def value_at(function: Callable[[Any], Array], state: Any) -> Any:
    """Return a function's value in a state, constant to derivatives."""
    return without_derivatives(function, state)(state)


class Condition(NamedTuple):
    """A function of the state that must not be negative, from the start of a mode to its end."""

    value: Function
    leads_to: str
    """The name of the failure where it is violated."""
    at_start: bool = False
    """Whether a stride that begins where it is negative is over at once."""
    least_at_ends: bool = False
    """Whether it is known to be least at the start or at the end of a mode."""
    zero_at_start: bool = False
    """Whether it is zero by definition as the mode starts, so that its sign there is rounding."""
    and_rate: Any = None
    """Function from a state to its value and its rate along the motion, constant to derivatives;
    set while a mode is followed, unless it is least at ends (`misses.with_rates`)."""

    def is_negative(self, state: Any) -> Bool[Array, ""]:
        """Return whether a state violates it."""
        return value_at(self.value, state) < 0


class Guard(NamedTuple):
    """An end of a mode, and an edge to where it leads."""

    value: Function
    """The mode ends where this function rises through zero, from below or, if it falls first, from
    zero."""
    leads_to: str = ""
    """The name of a mode, `SECTION`, or the name of a failure. A guard that leads to a mode and is
    due as its own mode begins ends that at once."""
    admits: tuple[Function, ...] = ()
    """The rise counts where all of these are positive."""
    reset: Callable[[Any], Any] = lambda state: state
    """Function from the state in which the guard has risen to the state in which the next mode
    begins, or to the state on the section."""
    must_hold: tuple[Condition, ...] = ()
    """Functions that must be positive in the state in which the guard has risen, before the reset,
    for the motion to go on: for example the speed at which a foot lifts in an impact."""
    makes_zero: tuple[str, ...] = ()
    """Conditions, by their failures, that are zero by definition where the guard rises, so that
    their sign there is rounding."""
    persists: bool = False
    """Whether two things are known. A value that has risen where it is admitted
    stays above zero to the end of any step; and it turns from falling to rising at most once in a
    step. The two ends of a step then tell whether it has risen within."""
    at_once: bool = False
    """Whether a mode that begins where the value is not negative ends there, by a failure or on the
    section; one that follows another mode does not if the value is zero, to rounding, and falls."""
    measure: Callable[[Scalar], Scalar] = jnp.negative
    """The margin of a value below zero; by default its size."""

    surface: Function | None = None
    """The function whose zero defines the event for derivatives, by default `value`. It differs
    from that where a parameter moves the event, but not `value`."""

    @property
    def always_begins_below(self) -> bool:
        """Whether it is below zero in every mode that is followed, as it ends others at once."""
        return self.at_once and not self.admits

    def admitted(self, state: Any) -> Bool[Array, ""]:
        """Return whether a rise in a state counts."""
        counts = jnp.asarray(True)
        for one in self.admits:
            counts &= value_at(one, state) > 0
        return counts


class EarlyExit(NamedTuple):
    """A sufficient condition for a mode to end in one way: it need not be followed any further."""

    holds: Callable[[Any], Bool[Array, ""]]
    """Whether that is certain in a state; evaluated at the end of each step."""
    leads_to: str
    """The name of a failure."""


class Mode(NamedTuple):
    """Equations of motion, guards and conditions."""

    field: VectorField
    """The time derivative of the state, or a `PowerBalance`."""
    guards: tuple[Guard, ...]
    """The earliest rise ends the mode; of rises at the same time, the first guard's counts."""
    conditions: tuple[Condition, ...] = ()
    early_exit: EarlyExit | None = None
    rates_at: Callable[[Any], Any] | None = None
    """The time derivative of a single state, where `field` is no function."""
    as_smooth: bool = False
    """Whether the guards are known to be as smooth along a solution as the solution itself, such as
    functions of angles that obey equations in their own sines. Steps need not be shorter for them
    then."""
    scales: Any = None
    """Sizes of the variables, a tree like the state. The error of a step is relative to each
    variable, or to its size here if that is larger; by default to the largest variable of all.
    Variables of very different magnitude need it."""
    longest_step: Any = None
    """Longest step of the integration. Features of time that last less than a step, such as a
    short pulse, may else lie between two places where the equations are evaluated."""
    integrals: Mapping[str, Function] = MappingProxyType({})
    """Functions of the state, such as a power, that `integrals` integrates along a stride, by
    name."""
    largest: Mapping[str, Function] = MappingProxyType({})
    """Functions of the state, such as a force, of which `integrals` returns the largest value in a
    stride."""
    energy: Function | None = None
    """The energy of a state, if it is known. Only `explain` uses it, to report its change."""
    most_steps: int = MOST_STEPS
    """A mode that has not ended after so many integration steps is `UNDECIDED`."""

    @property
    def rates(self) -> Callable[[Any], Any]:
        """The time derivative of the state, evaluated at a single state."""
        return self.field if self.rates_at is None else self.rates_at

    def functions(self) -> list[list[Function]]:
        """Return the value of each guard and the functions that admit it."""
        return [[one.value, *one.admits] for one in self.guards]


def has_ended(mode: Mode, guard: Int[Array, ""]) -> Bool[Array, ""]:
    """Return whether the guard with this number, or none, has ended a mode."""
    return (guard >= 0) & (guard < len(mode.guards))


def ends_at_once(
    mode: Mode, guard: Guard, state: Any, switched: bool | Bool[Array, ""]
) -> Bool[Array, ""]:
    """Return whether a guard that acts at once ends a mode that begins in a state.

    A motion that has `switched` to the mode may begin where the value is zero, but for rounding.
    The guard does not end it there if the value falls.
    """
    value = guard.value(state)
    if switched is False:
        return value >= 0
    along = lambda y: jnp.stack(jax.jvp(guard.value, (y,), (mode.rates(y),)))
    start, rate = value_at(along, state)
    falls = start + SOON * float(jnp.finfo(rate.dtype).eps) * rate < 0
    return (value >= 0) & ~(falls & switched)
