"""Guards as a mode begins: whether one ends it at once, and on which side of zero each is."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from walker_jax.hybrid.crossings import begins_below, rounding_of
from walker_jax.hybrid.modes import Guard, Mode
from walker_jax.integrators.integrator import Method


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
    if guard.admits or guard.admits_at_rise:
        due &= guard.admitted(start)
    return Due(due, due & (series[0] <= rounding) & (series[1] > rounding))


def begins_on_its_lower_side(guard: Guard, method: Method, start: Any) -> Bool[Array, ""]:
    """Return whether a guard is below zero as a mode begins, or at zero and about to fall.

    One rule serves all methods (`begins_below`), by the series of the solution. A mode that begins
    where a guard is zero has not come there, though by rounding the value may be negative: a stride
    does not end as it leaves the section.
    """
    if guard.always_begins_below:
        return jnp.asarray(True)
    value, *rates = method.series(guard.value, start, 2)
    if not guard.at_once:
        known = lax.stop_gradient(start)
        on_zero = jnp.abs(value) <= rounding_of(guard.value, known, known, 0.0)
        value = jnp.where(on_zero, 0, value)
    return begins_below([value, *rates])
