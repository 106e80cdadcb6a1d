"""Roots and turning points of functions within a step of integration.

All are constants to derivatives, unless said otherwise. None jumps over a root.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from walker_jax.integrators.series import evaluate

Scalar = Float[Array, ""]
Look = Callable[[Scalar], tuple[Scalar, Scalar, Scalar]]
"""Value, slope and curvature at a time since the start of a step."""


def of_polynomial(series: list[Scalar]) -> Look:
    """Those of a polynomial, given by its coefficients."""
    series = lax.stop_gradient(series)

    def look(t):
        value, slope, curvature = series[-1], jnp.zeros_like(t), jnp.zeros_like(t)
        for coefficient in series[-2::-1]:
            curvature = curvature * t + slope
            slope = slope * t + value
            value = value * t + coefficient
        return value, slope, 2 * curvature

    return look


def of_function(function: Callable[[Scalar], Scalar]) -> Look:
    """Those of any function of time."""

    def look(t):
        slope = lambda t: jax.jvp(function, (t,), (jnp.ones_like(t),))
        (value, first), (_, second) = jax.jvp(slope, (t,), (jnp.ones_like(t),))
        return lax.stop_gradient((value, first, second))

    return look


def first_rise(
    look: Look,
    length: Scalar,
    sides: tuple[Bool[Array, ""], Bool[Array, ""]] | None = None,
) -> tuple[Bool[Array, ""], Scalar]:
    """Where a function rises through zero in a step 0 <= t <= length, if it does.

    The step is short enough for it to have one minimum in it at most. It rises through zero if it
    is not negative at the end, but is at the start or at that minimum. `sides` says whether it is
    negative at start and end, where that has been decided; rounding may have the function differ.

    Returns whether it does, and the time (`length` if not).
    """
    length = lax.stop_gradient(length)
    zero = jnp.zeros_like(length)
    (start, start_slope, _), (end, end_slope, _) = look(zero), look(length)
    below, ends_below = (start < 0, end < 0) if sides is None else sides
    turns = ~below & (start_slope < 0) & (end_slope > 0)
    turn = rising_root(lambda t: look(t)[1:], zero, jnp.where(turns, length, zero))
    rises = (below | (turns & (look(turn)[0] < 0))) & ~ends_below
    root = rising_root(lambda t: look(t)[:2], jnp.where(rises, turn, length), length)
    return rises, root


class Instant(NamedTuple):
    """When something happens within a step, if it does."""

    exists: Bool[Array, ""]
    time: Scalar


def least(look: Look, length: Scalar) -> Instant:
    """Where a function that falls at first in a step, and rises at its end, is least.

    To first order the least value does not depend on it.
    """
    length = lax.stop_gradient(length)
    zero = jnp.zeros_like(length)
    exists = (look(zero)[1] < 0) & (look(length)[1] > 0)
    high = jnp.where(exists, length, zero)
    return Instant(exists, rising_root(lambda t: look(t)[1:], zero, high))


def negative(look: Look) -> Look:
    """Of minus a function."""

    def opposite(t):
        value, slope, curvature = look(t)
        return -value, -slope, -curvature

    return opposite


def derivative_of(series: list[Scalar]) -> list[Scalar]:
    """The coefficients of a polynomial's derivative."""
    return [k * c for k, c in enumerate(series)][1:]


def when_zero(series: list[Scalar], time: Scalar) -> Scalar:
    """The time at which a polynomial is zero, with its derivatives: a step of Newton's."""
    time = lax.stop_gradient(time)
    value, slope = evaluate(series, time), evaluate(derivative_of(series), time)
    slope = lax.stop_gradient(jnp.where(slope == 0, 1.0, slope))
    return time - (value - lax.stop_gradient(value)) / slope


def rising_root(
    function: Callable[[Scalar], tuple[Scalar, Scalar]], low: Scalar, high: Scalar
) -> Scalar:
    """Root of a function that is negative at `low` and not at `high`; either where they are equal.

    Newton's iteration from `high` on (value, slope), kept inside the bracket by halving; every
    turn shrinks the bracket, so it ends.
    """
    resolution = 2 * float(jnp.finfo(high.dtype).eps) * jnp.abs(high)

    def unfinished(carry):
        *_, t, previous = carry
        return jnp.abs(t - previous) > resolution

    def iterate(carry):
        low, high, t, _ = carry
        value, slope = function(t)
        low, high = jnp.where(value < 0, t, low), jnp.where(value < 0, high, t)
        newton = t - value / slope
        inside = ((newton > low) & (newton < high)) | (newton == t)
        return low, high, jnp.where(inside, newton, (low + high) / 2), t

    return lax.while_loop(unfinished, iterate, (low, high, high, low))[2]


def first_zero(series: list[Scalar], length: Scalar, resolution: Scalar) -> Scalar:
    """The first zero of a polynomial in 0 <= t <= length; that, or more, where there is none.

    The polynomial is expanded anew, about points that approach the zero from the left by as much as
    is certain to hold none, until that is less than the resolution. It converges as Newton's
    iteration does, but passes no zero. One that is zero at 0 has that zero, unless it vanishes.
    """

    def certain(series: list[Scalar], most: Scalar) -> Scalar:
        """A length, up to `most`, in which a polynomial that is positive at first has no zero.

        p(t) >= p_0 + p_1 t - b t^2, with b such that b most^2 is the sum of the later terms' sizes
        at t = most.
        """
        value, rate = series[:2]
        later = evaluate([jnp.abs(c) for c in series[2:]], most)
        all_of_it = value + (rate - later * most) * most >= 0
        root = jnp.sqrt(rate**2 + 4 * later * value)
        rising = (rate + root) / (2 * jnp.where(later > 0, later, 1))
        falling = 2 * value / jnp.where(root > rate, root - rate, 1)
        bound = jnp.where(rate > 0, rising, falling)
        at_zero = (value <= 0) & ((value != 0) | (rate != 0) | (later != 0))
        return jnp.where(at_zero, 0, jnp.where(all_of_it, most, bound))

    def unfinished(carry):
        time, step, *_ = carry
        return (time < length) & (step > resolution)

    def advance(carry):
        time, step, *series = carry
        for i in range(len(series) - 1):  # p(step + t), by Horner's rule order after order
            for k in range(len(series) - 2, i - 1, -1):
                series[k] = series[k] + step * series[k + 1]
        time = time + step
        return time, certain(series, length - time), *series

    sign = jnp.where(series[0] < 0, -1, 1).astype(length.dtype)
    series = [sign * c for c in series]
    first = jnp.zeros_like(length), certain(series, length), *series
    return lax.while_loop(unfinished, advance, first)[0]
