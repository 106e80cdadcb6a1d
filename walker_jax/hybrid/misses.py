"""Misses: how nearly the guards of a mode rose, and its conditions were violated.

A guard misses a rise where its value turns below zero, or turns or rises most slowly above zero,
where it is admitted. It also misses one where it rises through zero and is not admitted. A step of
the integration must be so short that the rate of a value turns at most once in it.

The value of a condition may cost as much as a vector field, as a force does. So it is not expanded
in a series but evaluated where steps end, with its rate. A step has a minimum within it if the rate
is negative at its start and positive at its end, or if the cubic with these values and rates turns
twice in it.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, PyTree

from walker_jax.hybrid.crossings import Crossing
from walker_jax.hybrid.modes import Condition, Guard, Mode
from walker_jax.integrators.expansion import with_fast_sincos, without_derivatives
from walker_jax.integrators.integrator import zero_at
from walker_jax.integrators.roots import (
    Instant,
    Jet,
    Scalar,
    bracketed_newton,
    derivative_of,
    differentiable_zero,
    polynomial_jet,
)
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor import evaluate_series, function_series

FINE, FINEST = 1e-6, 1e-9
"""Resolutions of the time at which a condition is least, as part of a step, to tell its sign and to
find its value. The error of a value is about the square of it."""


class Misses(NamedTuple):
    """Misses within a mode. Its start and its end, where values do not turn, do not count.

    Lists have an entry for each guard.
    """

    nearest: list[Scalar]
    """The greatest miss, negative: the value, or minus the value, where it turned or rose most
    slowly; or the least function that did not admit it. Minus infinity if there was none."""
    depth: list[Scalar]
    """How far a guard turned below zero since it last rose, if it is not always admitted; minus
    infinity if it did not."""
    height: list[Scalar]
    """How far a guard rose, if it fell again within the step in which the mode ended; infinite
    otherwise."""
    least: dict[str, Scalar]
    """The least value of each condition where it turned, by its failure; infinite if it did not."""
    before: dict[str, list[Scalar]]
    """The greatest misses up to the step in which each condition was violated."""


class StepRecord(NamedTuple):
    """A step, up to the end of the mode."""

    start: Any
    series: PyTree[list]
    length: Scalar
    arrival: Any
    until: Scalar
    """Time of the arrival since the start of the step."""
    crossings: list[Crossing]
    """The guards in the whole step."""
    violated: dict[str, Bool[Array, ""]]
    """Whether each condition was violated before the step."""


def no_misses(mode: Mode, start: Any) -> Misses:
    infinite = zero_at(start) + jnp.inf
    least = {one.leads_to: infinite for one in mode.conditions}
    none = [-infinite] * len(mode.guards)
    return Misses(none, none, [infinite] * len(none), least, dict.fromkeys(least, none))


def add_misses(mode: Mode, known: Misses, step: StepRecord) -> Misses:
    """Add the misses of a step to those that are known. All values have their derivatives."""
    found = [turns_in_step(*one, step) for one in zip(mode.guards, step.crossings, strict=True)]
    nearest = list(map(jnp.maximum, known.nearest, [one.miss for one in found]))
    least, before = dict(known.least), {}
    for one in mode.conditions:
        key = one.leads_to
        if not one.least_at_ends:
            least[key] = jnp.minimum(least[key], least_in_step(one, step))
        choose = partial(jnp.where, step.violated[key])
        before[key] = list(map(choose, known.before[key], nearest))
    goes_on, depth = step.until == step.length, []
    for one, deep in zip(found, known.depth, strict=True):
        deepest = jnp.maximum(deep, one.depth)
        depth.append(jnp.where(one.rises & goes_on, -jnp.inf, deepest))
    height = list(map(jnp.minimum, known.height, [one.height for one in found]))
    return Misses(nearest, depth, height, least, before)


class Turns(NamedTuple):
    """A guard in a step."""

    miss: Scalar
    """Its greatest miss, negative; minus infinity if there is none."""
    depth: Scalar
    """How far below zero it turns; minus infinity if it does not."""
    height: Scalar
    """How far it rises beyond the end of the mode, before it falls; infinite if it does not fall.
    Guards that are always admitted have neither depth nor height."""
    rises: Bool[Array, ""]
    refused: Bool[Array, ""]
    """Whether it rises and is not admitted."""
    time: Scalar
    """When it rises, since the start of the step."""


def turns_in_step(guard: Guard, crossing: Crossing, step: StepRecord) -> Turns:
    """Find where a guard turns in a step, and where it rises without being admitted."""
    value = function_series(guard.value, step.series)
    admits = [function_series(one, step.series) for one in (*guard.admits, *guard.admits_at_rise)]

    def admitted(time: Scalar) -> Scalar:
        """Return the least of the functions that admit a rise."""
        least = jnp.full_like(time, jnp.inf)
        for one in admits:
            least = jnp.minimum(least, evaluate_polynomial(one, time))
        return least

    jet = polynomial_jet(value)
    until = lax.stop_gradient(step.until)
    start, end = first_place(value, until), Place(until, *jet(until))
    middle = turn_of_rate(value, start, end)
    top = turn_between(jet, -1, start, middle, end)
    high = evaluate_polynomial(value, top.time)
    misses = top.exists & (high < 0) & (admitted(top.time) > 0)
    miss = jnp.where(misses, high, -jnp.inf)
    if not admits:
        infinite = jnp.full_like(miss, jnp.inf)
        return Turns(miss, -infinite, infinite, jnp.asarray(False), jnp.asarray(False), until)
    low = turn_between(jet, 1, start, middle, end)
    least = evaluate_polynomial(value, low.time)
    misses = low.exists & (least >= 0) & (admitted(low.time) > 0)
    miss = jnp.where(misses, jnp.maximum(miss, -least), miss)
    bend = derivative_of(derivative_of(value))
    time = differentiable_zero(bend, middle.time)  # the value goes on changing there
    above = evaluate_polynomial(value, time)
    slowest = (middle.time < until) & (middle.rate > 0) & (start.rate > middle.rate)
    misses = slowest & (above >= 0) & (admitted(time) > 0)
    miss = jnp.where(misses, jnp.maximum(miss, -above), miss)

    turned = low.exists & (least < 0)
    first = jnp.where(turned, low.time, 0)
    falls = top.exists & (top.time > first)
    last = jnp.where(falls, top.time, until)
    whole = ~falls & (step.until == step.length)
    above_zero = jnp.where(falls, high, end.value) >= 0
    rises = (turned | crossing.below) & jnp.where(whole, ~crossing.ends_below, above_zero)
    time = bracketed_newton(lambda t: jet(t)[:2], jnp.where(rises, first, last), last)
    lacks = admitted(differentiable_zero(value, time))
    refused = rises & (lacks <= 0)
    miss = jnp.where(refused, jnp.maximum(miss, lacks), miss)
    depth = jnp.where(low.exists, -least, -jnp.inf)
    length = lax.stop_gradient(step.length)
    beyond = turn_between(jet, -1, end, end, Place(length, *jet(length)))
    height = jnp.where(beyond.exists, evaluate_polynomial(value, beyond.time), jnp.inf)
    return Turns(miss, depth, height, rises, refused, time)


class Place(NamedTuple):
    """A polynomial at a time of a step, constant to derivatives."""

    time: Scalar
    value: Scalar
    rate: Scalar
    curvature: Scalar


def first_place(series: list[Scalar], time: Scalar) -> Place:
    """Return the start of a step, where the coefficients are known; `time` gives the dtype."""
    value, rate, bend = lax.stop_gradient(series[:3])
    return Place(0 * time, value, rate, 2 * bend)


def turn_of_rate(series: list[Scalar], start: Place, end: Place) -> Place:
    """Return the place where the rate of a polynomial turns in a step; its end if it does not."""
    sign = jnp.where(start.curvature < 0, 1, -1).astype(end.time.dtype)
    turns = sign * jnp.sign(end.curvature) > 0
    rising = polynomial_jet([sign * c for c in derivative_of(derivative_of(series))])
    first = jnp.where(turns, start.time, end.time)
    time = bracketed_newton(lambda t: rising(t)[:2], first, end.time)
    return Place(time, *polynomial_jet(series)(time))


def turn_between(jet: Jet, sign: int, start: Place, middle: Place, end: Place) -> Instant:
    """Find where a function is least in a step, or greatest with `sign` -1.

    Its rate turns at `middle` alone. The time is constant to derivatives: the value does not depend
    on it to first order.
    """
    early = (sign * start.rate < 0) & (sign * middle.rate > 0)
    late = (sign * middle.rate < 0) & (sign * end.rate > 0)
    first = jnp.where(early, start.time, middle.time)
    last = jnp.where(early, middle.time, jnp.where(late, end.time, first))

    def rate_and_slope(time):
        _, rate, curvature = jet(time)
        return sign * rate, sign * curvature

    return Instant(early | late, bracketed_newton(rate_and_slope, first, last))


def least_in_step(condition: Condition, step: StepRecord) -> Scalar:
    """Return the least value of a condition where it turns in a step; infinite if it does not."""
    least = find_least(condition, step)
    there = with_fast_sincos(condition.value)(evaluate_series(step.series, least.time))
    return jnp.where(jnp.isfinite(least.value), there, least.value)


class Least(NamedTuple):
    """A condition in a step, up to the end of the mode; constant to derivatives."""

    time: Scalar
    """The time at which it is least."""
    value: Scalar
    """Its value then; infinite if it does not turn in the step."""
    at_end: Scalar
    """Its value at the end."""


class Dip(NamedTuple):
    """Whether a function turns twice in a step, by the cubic with its values and rates at the ends.

    In parts s of the step, the cubic's rate is r_0 (1 - s)^2 + 2 m s (1 - s) + r_1 s^2, where
    3 (f(1) - f(0)) = r_0 + m + r_1. It changes sign twice if r_0 and r_1 have the same sign, m has
    the other one, and m^2 > r_0 r_1. It turns at s = (r_0 - m) / (r_0 - 2 m + r_1).
    """

    exists: Bool[Array, ""]
    part: Scalar
    """Part of the step between the two turns; a half if there are none."""


def dip_between(before: tuple, after: tuple, length: Scalar) -> Dip:
    """Look for two turns in a step, from values and rates at its ends."""
    (first, rate), (last, final) = before, after
    both = (rate + final) * length
    middle = 3 * (last - first) - both
    falls, rises = rate < 0, final > 0
    opposite = (falls ^ rises) & ((middle < 0) ^ falls)
    exists = opposite & (middle**2 > rate * final * length**2)
    between = (rate * length - middle) / jnp.where(exists, both - 2 * middle, 1)
    return Dip(exists, jnp.where(exists, between, 0.5))


def find_least(
    condition: Condition,
    step: StepRecord,
    *,
    known: tuple[Scalar, Scalar] | None = None,
    sign_alone: bool = False,
) -> Least:
    """Find where a condition is least in a step; its value and rate at the start may be `known`.

    It is least at a root of its rate, bracketed by secants (Illinois) to a part of the step; for
    its `sign_alone`, until the value is not above zero. The loop begins with both ends of the step,
    as a condition is costly: a copy of it for each end would have to be compiled too. If it turns
    twice, the place between is next (`dip_between`).
    """
    resolution, above = (FINE, 0.0) if sign_alone else (FINEST, -np.inf)
    before, series, after, until = lax.stop_gradient(
        (step.start, step.series, step.arrival, jnp.maximum(step.until, 0))
    )
    # A finer resolution would never be reached.
    resolution = max(resolution, 8 * float(jnp.finfo(until.dtype).eps))

    def unfinished(carry):
        turn, (low, high), *_, least = carry
        return (turn < 2) | ((high - low > resolution * until) & (least.value > above))

    def narrow(carry):
        turn, (low, high), (start, below), beyond, between, least = carry
        first, second, inside = turn == 0, turn == 1, turn > 1
        part = jnp.where((turn == 2) & (between > 0), between, below / (below - beyond))
        t = low + (high - low) * jnp.clip(part, 0.01, 0.99)
        choose = lambda start, end, within: jnp.where(first, start, jnp.where(second, end, within))
        state = jax.tree.map(choose, before, after, evaluate_series(series, t))
        value, rate = condition.and_rate(state)
        falling, less = rate < 0, inside & (value < least.value)
        dip = dip_between((start, below), (value, rate), until)
        turns = ((below < 0) & (rate > 0)) | dip.exists
        # The rate at an end that stays counts half as much the next time.
        below, beyond = (
            choose(rate, below, jnp.where(falling, rate, below / 2)),
            choose(beyond, rate, jnp.where(falling, beyond / 2, rate)),
        )
        low = jnp.where(inside & falling, t, low)
        high = choose(high, jnp.where(turns, until, 0), jnp.where(falling, high, t))
        return (
            turn + 1,
            (low, jnp.where(inside & ~((below < 0) & (beyond > 0)), low, high)),
            (jnp.where(first, value, start), below),
            beyond,
            jnp.where(second & dip.exists, dip.part, between),
            Least(
                jnp.where(less, t, least.time),
                jnp.minimum(least.value, jnp.where(inside, value, jnp.inf)),
                jnp.where(second, value, least.at_end),
            ),
        )

    zero, one = jnp.zeros_like(until), jnp.ones_like(until)
    turn = jnp.asarray(int(known is not None), jnp.int32)
    start = (zero, zero) if known is None else lax.stop_gradient(known)
    carry = (turn, (zero, zero), start, one, zero, Least(zero, zero + jnp.inf, zero))
    *_, least = lax.while_loop(unfinished, narrow, carry)
    return least


def with_rates(mode: Mode, start: Any) -> Mode:
    """Return the mode, with the rates of conditions that may be least within it.

    A condition is costly, so all evaluations with its rate share one trace.
    """

    def with_rate(one: Condition) -> Condition:
        both = lambda state: jax.jvp(one.value, (state,), (mode.rates(state),))
        rated = None if one.least_at_ends else without_derivatives(both, start, once=True)
        return one._replace(and_rate=rated)

    return mode._replace(conditions=tuple(map(with_rate, mode.conditions)))
