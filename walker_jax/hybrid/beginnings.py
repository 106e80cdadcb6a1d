"""Guards as a mode begins: whether one ends it at once, and on which side of zero each is."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from walker_jax.hybrid.crossings import begins_below, rounding_of
from walker_jax.hybrid.modes import Guard, Mode
from walker_jax.integrators.integrator import Method, zero_at
from walker_jax.integrators.roots import Scalar

ON_ZERO = 0.5
"""Side of a guard that begins at zero, to rounding. It is below zero then if it falls."""


class Due(NamedTuple):
    """A guard as a mode begins."""

    ends: Bool[Array, ""]
    """Whether the mode is over at once."""
    rises: Bool[Array, ""]
    """Whether the guard rises just then, so that the time until then, zero, has derivatives."""


def is_due(mode: Mode, guard: Guard, method: Method, start: Any) -> Due:
    """Return whether a mode that begins in a state is over at once, by one of its guards.

    The state may be on a guard, but for errors, as the mode before ended there: it may then fall.
    """
    value = guard.value
    known = lax.stop_gradient((start, mode.rates(start)))
    rounding = rounding_of(value, *known, method.tolerance)
    series = method.series(value, start, 2)
    due = ~begins_below(series, rounding)
    if guard.admits:
        due &= guard.admitted(start)
    return Due(due, due & (series[0] <= rounding) & (series[1] > rounding))


def side_at_start(guard: Guard, method: Method, start: Any) -> Scalar:
    """Return the side of zero on which a guard begins; zero if it is read from the first series.

    One rule serves all methods (`begins_below`), by the series of the solution. An interpolation
    is no such series. A mode that begins where a guard is zero has not come there, though by
    rounding the value may be negative: a stride does not end as it leaves the section.
    """
    side = zero_at(start)
    if not guard.at_once:
        known = lax.stop_gradient(start)
        on_zero = jnp.abs(guard.value(known)) <= rounding_of(guard.value, known, known, 0.0)
        side = jnp.where(on_zero, ON_ZERO, side)
    if method.is_series:
        return side
    below = is_below(guard, side, method.series(guard.value, start, 2))
    return jnp.where(below, -1, 1) + zero_at(start)


def is_below(guard: Guard, side: Scalar, value: list[Scalar]) -> Bool[Array, ""]:
    """Return whether a guard is below zero as a step begins, by its side or first value."""
    below = jnp.where(side == 0, begins_below(value), side < 0)
    if guard.at_once:
        return below
    return jnp.where(side == ON_ZERO, begins_below([jnp.zeros_like(side), *value[1:]]), below)
