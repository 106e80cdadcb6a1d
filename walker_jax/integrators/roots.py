"""Roots and extrema of functions of time within one step of integration.

Results are constant to derivatives, unless the docstring says otherwise. No search jumps over a
root.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from walker_jax.integrators.reductions import largest
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.kernels.products import sum_of_products

Scalar = Float[Array, ""]
Real = Scalar | float
Jet = Callable[[Scalar], tuple[Scalar, Scalar, Scalar]]
"""A function from the time since the start of a step to a value, slope and curvature."""


def polynomial_jet(series: list[Scalar]) -> Jet:
    """Return the value, slope and curvature of a polynomial with these coefficients."""
    series = lax.stop_gradient(series)

    def jet(t):
        value, slope, curvature = series[-1], jnp.zeros_like(t), jnp.zeros_like(t)
        for coefficient in series[-2::-1]:
            curvature = sum_of_products(curvature, t, slope)
            slope = sum_of_products(slope, t, value)
            value = sum_of_products(value, t, coefficient)
        return value, slope, 2 * curvature

    return jet


class Instant(NamedTuple):
    """The time of an event within a step, and whether there is one."""

    exists: Bool[Array, ""]
    time: Scalar


def derivative_of(series: list[Scalar]) -> list[Scalar]:
    """Return the coefficients of a polynomial's derivative."""
    return [k * c for k, c in enumerate(series)][1:]


def differentiable_zero(series: list[Scalar], time: Scalar) -> Scalar:
    """Return the time of a polynomial's zero, with derivatives, by one Newton step."""
    time = lax.stop_gradient(time)
    value, slope = (
        evaluate_polynomial(series, time),
        evaluate_polynomial(derivative_of(series), time),
    )
    slope = lax.stop_gradient(jnp.where(slope == 0, 1.0, slope))
    return time - (value - lax.stop_gradient(value)) / slope


def bracketed_newton(
    function: Callable[[Scalar], tuple[Scalar, Scalar]], low: Scalar, high: Scalar
) -> Scalar:
    """Find the root of a function that is negative at `low` and not at `high`.

    Newton's iteration starts from `high`, on (value, slope); bisection replaces a step that leaves
    the bracket. Every turn shrinks the bracket, so the iteration ends. Returns `high` if it equals
    `low`.
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


def first_zero(
    series: list[Float[Array, "*n"]], length: Scalar, resolution: Scalar
) -> tuple[Scalar, Float[Array, "*n"]]:
    """Find the first zero of a polynomial, or of several in arrays, in 0 <= t <= length.

    **Returns** its time, `length` or more if there is none, and the share of each polynomial in it:
    1 for the one that has it.

    The polynomials are expanded about points that approach the zero from the left. Each advances by
    a length that certainly holds no zero, until that length is less than the resolution. This
    converges like Newton's iteration, but passes no zero. A polynomial that is zero at t = 0 has
    its first zero there, unless it vanishes identically.
    """
    least = lambda steps: -largest(-steps) if steps.ndim else steps

    def unfinished(carry):
        time, steps, *_ = carry
        return (time < length) & (least(steps) > resolution)

    def advance(carry):
        time, steps, *series = carry
        step = least(steps)
        time, series = time + step, shifted(series, jnp.broadcast_to(step, steps.shape))
        return time, length_without_zero(series, length - time), *series

    sign = jnp.where(series[0] < 0, -1, 1).astype(length.dtype)
    series = [sign * c for c in series]
    first = jnp.zeros_like(length), length_without_zero(series, length), *series
    time, steps, *_ = lax.while_loop(unfinished, advance, first)
    share = (steps == least(steps)).astype(length.dtype)
    return time, share / jnp.sum(share)


def length_without_zero(series: list[Scalar], most: Scalar) -> Scalar:
    """Return a length, up to `most`, in which a polynomial that starts positive has no zero.

    p(t) >= p_0 + p_1 t - b t^2, where b most^2 is the sum of the moduli of all later terms at
    t = most.
    """
    value, rate = series[:2]
    later = evaluate_polynomial([jnp.abs(c) for c in series[2:]], most)
    all_of_it = value + (rate - later * most) * most >= 0
    root = jnp.sqrt(rate**2 + 4 * later * value)
    rising = (rate + root) / (2 * jnp.where(later > 0, later, 1))
    falling = 2 * value / jnp.where(root > rate, root - rate, 1)
    bound = jnp.where(rate > 0, rising, falling)
    at_zero = (value <= 0) & ((value != 0) | (rate != 0) | (later != 0))
    return jnp.where(at_zero, 0, jnp.where(all_of_it, most, bound))


def shifted(series: list[Scalar], step: Scalar) -> list[Scalar]:
    """Return the coefficients of p(step + t), by Horner's rule for each order."""
    series = list(series)
    for i in range(len(series) - 1):
        for k in range(len(series) - 2, i - 1, -1):
            series[k] = sum_of_products(step, series[k + 1], series[k])
    return series


def cut_at_switches(switches: list[list[Array]], length: Scalar, behind: Scalar) -> Scalar:
    """Cut a step just behind the first zero of functions given by their series.

    A series may be of several functions, in arrays. The length has the derivatives of that zero,
    since second derivatives depend on where a step ends at a kink.
    """
    for switch in switches:
        zero, share = first_zero(*lax.stop_gradient((switch, length)), behind)
        if share.ndim:
            switch = [jnp.sum(share * c) for c in switch]
        length = jnp.where(
            zero + behind < length, differentiable_zero(switch, zero) + behind, length
        )
    return length
