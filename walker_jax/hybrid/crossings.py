"""Rises of a polynomial through zero within one step of integration.

A rise is decided on the polynomial of the step, never on its two ends alone. Bounds that cost a few
operations exclude most steps (`may_rise`). They need the first coefficients alone, as those of a
step fall off fast. Otherwise, the zeros are isolated from the left, by lengths that certainly hold
none (`first_rise`). So no dip wider than `HOP` of a step is missed.

The side of zero on which a polynomial begins is passed from step to step, and read from its sign
only at first. So no rise is lost, or counted twice, between two steps by rounding.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import (
    Instant,
    Real,
    Scalar,
    bracketed_newton,
    length_without_zero,
    polynomial_jet,
    shifted,
)
from walker_jax.integrators.series import evaluate_polynomial

HOP = 1e-7
"""Distance, as part of a step, within which two zeros count as one, which is no crossing. In
float32 it is 64 times the dtype's epsilon."""
MOVED = 7
"""Number of coefficients that are moved to the middle of a step; later ones are small."""
ROUNDING = 64
"""Largest rounding error of a value that counts as zero, over the dtype's epsilon."""


@jax.jit
def begins_below(series: list[Scalar], rounding: Real = 0.0) -> Bool[Array, ""]:
    """Return whether a function is below zero at first, or at zero and about to fall.

    A value that differs from zero by `rounding` at most counts as zero.
    """
    value, rate, curvature = series[:3]
    falls = (rate < 0) | ((rate == 0) & (curvature < 0))
    return (value < -rounding) | ((value <= rounding) & falls)


def rounding_of(
    function: Callable[[PyTree], Scalar], state: PyTree, rates: PyTree, tolerance: Real
) -> Scalar:
    """Return a bound of the values of a function in states where it is zero but for errors.

    It is the change of the function if each variable changes by the tolerance, or by `ROUNDING` if
    that is larger, times the largest variable or rate.
    """
    slopes = jax.tree.leaves(with_fast_sincos(jax.grad(function))(state))
    size = lambda tree: [largest(jnp.abs(x)) for x in jax.tree.leaves(tree)]
    scale = functools.reduce(jnp.maximum, [*size(state), *size(rates)])
    part = jnp.maximum(tolerance, ROUNDING * float(jnp.finfo(scale.dtype).eps))
    found = functools.reduce(jnp.add, [jnp.sum(jnp.abs(x)) for x in slopes]) * scale * part
    return lax.stop_gradient(jnp.where(jnp.isfinite(found), found, 0))


@jax.jit
def may_rise(
    value: list[Scalar],
    admits: list[list[Scalar]],
    length: Scalar,
    below: Bool[Array, ""],
    ends_below: Bool[Array, ""],
) -> Bool[Array, ""]:
    """Return whether a function may rise through zero in a step, given its side at both ends.

    It cannot if it is monotone and keeps its side; nor if it has no zero, or only the one at which
    the step begins; nor if one of `admits` is negative throughout. All are given by their first
    coefficients.
    """
    near = comes_near_zero(value, length) & ~leaves_zero(value, length)
    may = (below & ~ends_below) | near
    for one in admits:
        line, rest = about_middle(one, length)
        may &= line[0] + jnp.abs(line[1]) / 2 > -rest.value
    return may


def comes_near_zero(series: list[Scalar], length: Scalar) -> Bool[Array, ""]:
    """Return whether a function may have a zero in a step, other than one change of its side."""
    (middle, change), rest = about_middle(series, length)
    return (jnp.abs(middle) <= jnp.abs(change) / 2 + rest.value) & (jnp.abs(change) <= rest.rate)


class Rest(NamedTuple):
    """A bound on the part of a function that is not linear over a step."""

    value: Scalar
    rate: Scalar
    """Bound on the rate, per length of the step."""


def about_middle(series: list[Scalar], length: Scalar) -> tuple[tuple[Scalar, Scalar], Rest]:
    """Expand a function about the middle of a step: value, linear change, and bounds of the rest.

    The change is over the step, at the rate in the middle. About the middle a term of order k is
    2^k times smaller at the ends than about the start, so the bounds are close. The last two terms
    count twice, for those that are left out: with this length of a step, each term is about a tenth
    of the one before.
    """
    terms, power = [series[0]], length
    for c in series[1:]:
        terms.append(c * power)
        power = power * length
    value, change, *bends = shifted(terms[:MOVED], jnp.asarray(0.5, length.dtype))
    sizes = [*enumerate(map(jnp.abs, terms))][2:]
    rest = Rest(jnp.zeros_like(length), jnp.zeros_like(length))
    for k, size in (*sizes[MOVED - 2 :], *sizes[-2:]):
        rest = Rest(rest.value + size, rest.rate + k * size)
    for k, bend in enumerate(map(jnp.abs, bends), 2):
        rest = Rest(rest.value + bend / 2**k, rest.rate + bend * (k / 2 ** (k - 1)))
    return (value, change), rest


def leaves_zero(series: list[Scalar], length: Scalar) -> Bool[Array, ""]:
    """Return whether a polynomial that begins at zero, to rounding, certainly moves away from it.

    It moves in the direction of its first term that does not vanish, provided that c_2 has the same
    direction and outweighs the terms after it.
    """
    falls = (series[1] < 0) | ((series[1] == 0) & (series[2] < 0))
    sign = jnp.where(falls, -1, 1).astype(length.dtype)
    later = evaluate_polynomial(sizes(series)[2:], length) * length**2
    rounding = ROUNDING * float(jnp.finfo(length.dtype).eps) * (jnp.abs(series[1]) * length + later)
    others = later - jnp.abs(series[2]) * length**2
    return (sign * series[0] >= -rounding) & (sign * series[2] * length**2 >= others)


def is_monotone(series: list[Scalar], length: Scalar) -> Bool[Array, ""]:
    """Return whether the rate of a function certainly keeps its sign in a step."""
    rates = [k * size for k, size in enumerate(sizes(series))]
    return rates[1] > evaluate_polynomial(rates[2:], length) * length


def sizes(series: list[Scalar]) -> list[Scalar]:
    """Return the absolute values of coefficients, twice those of the last two nonlinear ones."""
    last = max(2, len(series) - 2)
    return [jnp.abs(c) * (1 if k < last else 2) for k, c in enumerate(series)]


class Crossing(NamedTuple):
    """A guard in a step."""

    value: list[Scalar]
    """The polynomial that may rise through zero."""
    admits: list[list[Scalar]]
    """The rise counts where all of these are positive."""
    below: Bool[Array, ""]
    """Whether it begins below zero."""
    ends_below: Bool[Array, ""]
    """Whether it ends below zero; by rounding, its own sign may differ."""
    wanted: Bool[Array, ""] | bool = True
    """Whether to look for a rise."""


@jax.jit
def first_rise(crossings: list[Crossing], length: Scalar) -> tuple[Int[Array, ""], Scalar]:
    """Find the first admitted rise of several polynomials in a step: its number, and its time.

    The number is -1, and the time infinite, if there is none. One search serves all, one after the
    other. Results are constant to derivatives.
    """
    most = max(len(one.admits) for one in crossings)
    always = [length + 1, *[0 * length] * (len(crossings[0].value) - 1)]
    padded = [
        one._replace(admits=[*one.admits, *[always] * (most - len(one.admits))])
        for one in crossings
    ]

    def look(i, known):
        which, when = known
        choose = lambda *values: values[0] if len(values) == 1 else lax.select_n(i, *values)
        exists, time = rise_of(jax.tree.map(choose, *padded), length)
        earlier = exists & (time < when)
        return jnp.where(earlier, i, which), jnp.where(earlier, time, when)

    nothing = jnp.asarray(-1, jnp.int32), jnp.full_like(length, jnp.inf)
    wanted = functools.reduce(jnp.logical_or, [one.wanted for one in crossings])
    first = jnp.where(wanted, 0, len(crossings))
    return lax.stop_gradient(lax.fori_loop(first, len(crossings), look, nothing))


def rise_of(crossing: Crossing, length: Scalar) -> Instant:
    """Find the first admitted rise of one polynomial.

    If it is monotone, its sides decide. Otherwise it is expanded about points that move to the
    right, each by a length that certainly holds no zero; at a zero, where that length nearly
    vanishes, by `HOP`. The time is constant to derivatives, and `length` if there is no rise.
    """
    value, admits, below, ends_below, wanted = lax.stop_gradient(crossing)
    length = lax.stop_gradient(length)
    eps = float(jnp.finfo(length.dtype).eps)
    hop = max(HOP, 64 * eps) * length

    def admitted(time: Scalar) -> Bool[Array, ""]:
        flag = jnp.isfinite(time)
        for one in admits:
            flag &= evaluate_polynomial(one, time) > 0
        return flag

    def searching(carry):
        time, found, *_ = carry
        return ~found & (time < length)

    def advance(carry):
        time, _, below, *series = carry
        sign = jnp.where(below, -1, 1).astype(length.dtype)
        free = length_without_zero([sign * c for c in series], length - time)
        at_zero = free <= hop / 8
        step = jnp.minimum(jnp.where(at_zero, hop, free), length - time)
        beyond = evaluate_polynomial(series[:4], step) < 0
        # Close to a zero, a step by the free length is a step of Newton's iteration.
        found = at_zero & below & ~beyond & admitted(time + free)
        below = jnp.where(at_zero, beyond, below)
        return jnp.where(found, time, time + step), found, below, *shifted(series, step)

    monotone = is_monotone(value, length)
    first = jnp.where(wanted & ~monotone, 0 * length, length)
    time, found, below, *_ = lax.while_loop(
        searching, advance, (first, jnp.asarray(False), below, *value)
    )
    # The sides decide, if it is monotone or has its last zero at the end of the step.
    left = wanted & ~found & below & ~ends_below
    low = jnp.where(left & monotone, 0, time)
    high = jnp.where(left, length, jnp.minimum(time + hop, length))
    root = bracketed_newton(lambda t: polynomial_jet(value)(t)[:2], low, high)
    exists = found | (left & admitted(root))
    return Instant(exists, jnp.where(exists, root, length))
