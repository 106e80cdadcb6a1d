"""Steps near the zeros of bases of fractional powers, such as depth^1.5 of a contact.

Where a base x approaches zero, the higher derivatives of x^p grow without bound, and so do the
coefficients of the solution. Steps shrink towards such a zero in proportion to its distance, end
just behind it, and grow again. A step may also begin at a zero, as a contact does: there x^p counts
as constant, and the step is short enough for that.
"""

import functools
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, PyTree

from walker_jax.integrators.roots import Real, Scalar, cut_at_switches, derivative_of
from walker_jax.integrators.series import evaluate_polynomial, short_logs
from walker_jax.integrators.step_lengths import largest_coefficient
from walker_jax.integrators.taylor import evaluate_series, is_list, order_of
from walker_jax.kernels.reverse import reversing

SLOPE_TOLERANCE = 100.0
"""Tolerance of the last terms of the slope near a zero, in units of that of the solution. Without
it, a step would not be right to derivatives."""
SHORTEST_START = 0.75
"""A step that begins at a zero need not be shorter than `tolerance` to this power, in units of
|y| / |y'|: even a cube root then changes y by no more than the tolerance."""
AT_ZERO, BEHIND = 256.0, 16.0
"""Distance in time below which a step counts as beginning at a zero, and distance behind it at
which a step ends, in units of the dtype's epsilon and |y| / |y'|."""
FAR, GROWTH = 1000.0, 4.0
"""A jump is as large this many times as far from it; a fractional power grows more than this."""


def step_near_powers(
    field: Callable,
    series: PyTree,
    kinks: list[list[Scalar]],
    bases: list[list[Scalar]],
    length: Scalar,
    tolerance: Real,
    scale: Scalar,
) -> tuple[PyTree[list], Scalar]:
    """Return the series and the length of a step of equations that have fractional powers.

    **Arguments:**

    - `field`, `series`: the equations, and the series of their solution.
    - `bases`, `kinks`: the series of the bases of powers, and of all other switching functions.
    - `length`, `tolerance`, `scale`: the length of the step if the bases are not near zero, the
      tolerance of its last terms, and the |y| to which that is relative.

    The length is NaN if the equations jump, as for other kinks.
    """
    eps = float(jnp.finfo(length.dtype).eps)
    tolerance = jnp.asarray(tolerance, length.dtype)
    unit = scale / jnp.maximum(largest_coefficient(series, 1), eps * scale)
    near = functools.reduce(jnp.logical_or, [may_be_near(one, length) for one in bases])
    series, begins, straight = straighten(series, bases, scale)
    constant = lax.stop_gradient(series)
    seen = partial(departing, begins, straight, AT_ZERO * eps * unit)
    kinks, bases = list(map(seen, kinks)), list(map(seen, bases))
    distance_behind = lambda length: jnp.maximum(tolerance * length, BEHIND * eps * unit)

    def shorten(length):
        length = jnp.minimum(length, steady_length(series, tolerance, scale))
        shortest = jnp.where(begins, tolerance**SHORTEST_START * unit, length)
        length = jnp.where(straight, shortest, length)
        length = halve_until_right(field, constant, length, shortest, tolerance * scale)
        return cut_at_switches(bases, length, distance_behind(length))

    if reversing.value:  # which does not transpose the loop below
        length = lax.cond(near | straight, shorten, lambda length: length, length)
    else:
        # A loop of one turn, as most steps are far from the zeros, and take none.
        _, length = lax.while_loop(
            lambda carry: carry[0],
            lambda carry: (jnp.zeros_like(carry[0]), shorten(carry[1])),
            (near | straight, length),
        )
    if not kinks:
        return series, length
    behind = distance_behind(length)
    length = cut_at_switches(kinks, length, behind)
    # A step that begins at a zero may leave a jump there behind.
    zero = jnp.where(begins, 0, lax.stop_gradient(length) - behind)
    change = lambda distance: difference(field, constant, zero - distance, zero + distance)
    jump = change(behind)
    continuous = change(FAR * behind) > GROWTH * jump
    smooth = (jump <= jnp.sqrt(tolerance) * scale) | continuous
    return series, jnp.where(smooth, length, jnp.nan)


def straighten(
    series: PyTree, bases: list[list[Scalar]], scale: Scalar
) -> tuple[PyTree, Bool[Array, ""], Bool[Array, ""]]:
    """Return a series as a straight line if it begins so near to a zero that it is useless.

    **Returns** the series; whether it begins at the zero of a base; and whether it is a line, as
    it begins there to rounding only, or has coefficients that are not finite.
    """
    eps = float(jnp.finfo(scale.dtype).eps)
    distance = AT_ZERO * eps * scale / jnp.maximum(largest_coefficient(series, 1), eps * scale)
    begins = jnp.asarray(False)
    straight = ~jnp.isfinite(largest_coefficient(series, -1) + largest_coefficient(series, -2))
    for base in lax.stop_gradient(bases):
        moves = functools.reduce(jnp.logical_or, [c != 0 for c in base[1:]])
        at_zero = (jnp.abs(base[0]) <= distance * jnp.abs(base[1])) & moves
        begins |= at_zero
        straight |= at_zero & (base[0] != 0)
    keep_line = partial(first_terms, straight)
    return jax.tree.map(keep_line, series, is_leaf=is_list), begins | straight, straight


def first_terms(straight: Bool[Array, ""], series: list[Array]) -> list[Array]:
    """Return the first two terms of a series if it is `straight`, otherwise all."""
    return [*series[:2], *(jnp.where(straight, 0, one) for one in series[2:])]


def may_be_near(base: list[Scalar], length: Scalar) -> Bool[Array, ""]:
    """Return whether a base may have a zero within two lengths of a step, also in complex time."""
    value, *later = (jnp.abs(lax.stop_gradient(c)) for c in base)
    return ~(value > evaluate_polynomial(later, 2 * length) * 2 * length)


def departing(
    begins: Bool[Array, ""], straight: Bool[Array, ""], distance: Scalar, switch: list[Scalar]
) -> list[Scalar]:
    """Return a switching function without the zero at which a step begins, if it moves away.

    If the step is `straight`, so is the function, and constant if its rate is infinite.
    """
    value, rate, bend = switch[:3]
    rate = jnp.where(straight & ~jnp.isfinite(rate), 0, rate)
    leaves = value * jnp.where(rate == 0, bend, rate) >= 0
    at_zero = begins & (jnp.abs(value) <= distance * jnp.abs(rate)) & leaves
    beyond = float(jnp.finfo(value.dtype).max) ** 0.5
    return first_terms(straight, [jnp.where(at_zero, beyond, value), rate, *switch[2:]])


def steady_length(series: PyTree, tolerance: Scalar, scale: Scalar) -> Scalar:
    """Return the length at which the last terms of the slope reach their tolerance.

    It is the least over k = n-1, n of (tolerance |y| / (k |c_k|))^(1/(k-1)).
    """
    orders = order_of(series) - 1, order_of(series)
    allowed = jnp.log((SLOPE_TOLERANCE * tolerance).astype(jnp.float32))
    logs = short_logs(*(k * largest_coefficient(series, k) / scale for k in orders))
    lengths = [(allowed - log) / (k - 1) for k, log in zip(orders, logs, strict=True)]
    return jnp.exp(jnp.minimum(*lengths)).astype(scale.dtype)


def halve_until_right(
    field: Callable, series: PyTree, length: Scalar, shortest: Scalar, tolerance: Scalar
) -> Scalar:
    """Return a length, halved until the slope at its end is right, or it is the shortest."""
    slopes = jax.tree.map(derivative_of, series, is_leaf=is_list)

    def wrong(length):
        rates, expected = field(evaluate_series(series, length)), evaluate_series(slopes, length)
        miss = largest_coefficient(jax.tree.map(lambda a, b: [a - b], rates, expected), 0)
        return ~(miss <= tolerance) & (length > shortest)

    halve = lambda length: jnp.maximum(length / 2, shortest)
    return lax.while_loop(wrong, halve, lax.stop_gradient(length))


def difference(field: Callable, series: PyTree, before: Scalar, after: Scalar) -> Scalar:
    """Return by how much the equations differ at two times of a step."""
    rates = (field(evaluate_series(series, time)) for time in (before, after))
    return largest_coefficient(jax.tree.map(lambda a, b: [a - b], *rates), 0)
