"""Verified integration steps: Taylor series with a rigorous bound on the remainder.

A step begins in all states of an enclosure at once. While a solution stays in a box, the remainder
of its series is the coefficient of order n somewhere in the box (Lagrange's form, applied to each
number of the state):

    y(t) in sum_{k<n} c_k t^k + [c_n(box)] t^n.

If this set lies inside the box for 0 <= t <= h, no solution can leave the box within the step: it
would have to reach the border first (Corliss and Rihm 1996). The coefficients c_k are polynomials
in the start, so the enclosed solutions from neighbouring starts stay as close as they are.

A flow may carry tangents, which obey the variational equations.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax

from walker_jax.integrators.taylor import grow_series, is_list
from walker_jax.proofs.enclosures import (
    Enclosure,
    as_enclosure,
    ball,
    exactly,
    greatest,
    is_enclosure,
    least,
    outward,
)
from walker_jax.proofs.evaluation import evaluate

ORDER = 12
"""Order of the remainder; the package's integrator has the same order."""
LONGEST_STEP = 1.0
RELATIVE_TOLERANCE = 1e-5
"""Tolerance of a step, relative to the width of the states: wide boxes take longer steps."""
ROOM = 1e-3, 2.0**-40
"""By how much the radii of a box exceed those of the polynomials: a relative and an absolute
part."""


class Flow(NamedTuple):
    """State, and its derivatives along some directions of the start."""

    state: Any
    tangents: tuple = ()


class VerifiedStep(NamedTuple):
    """Solution over one step."""

    series: Flow
    """List of Taylor coefficients of each number."""
    length: Any
    rest: Flow
    """Bound on the coefficient of each number's remainder."""
    speeds: Flow
    """Bound on each number's rate over the step."""
    proved: Any
    """Whether all solutions provably stay in the box; if not, none of the bounds holds."""


def flow_rates(walker, flow: Flow) -> Flow:
    """Return the rates of a state and of its tangents."""
    rates = walker.vector_field(flow.state)
    change = lambda tangent: jax.jvp(walker.vector_field, (flow.state,), (tangent,))[1]
    return Flow(rates, tuple(map(change, flow.tangents)))


@cache
def series_to(order: int) -> Callable:
    """Return a function that expands a flow in a Taylor series up to an order."""
    return lambda walker, flow: grow_series(lambda flow: flow_rates(walker, flow), flow, order)


def map_enclosures(function: Callable, *trees):
    return jax.tree.map(function, *trees, is_leaf=is_enclosure)


def map_series(function: Callable, series, *trees):
    """Apply a function to each number's list of coefficients."""
    return jax.tree.map(function, series, *trees, is_leaf=is_list)


def enclosures_in(tree) -> list:
    return jax.tree.leaves(tree, is_leaf=is_enclosure)


def ranges_of(tree):
    """Return the intervals of all enclosures of a tree."""
    return map_enclosures(lambda one: one.range(), tree)


def take_step(walker, flow: Flow, factor, *, order: int = ORDER, tolerance: float) -> VerifiedStep:
    """Take a verified step from a flow, `factor` times as long as the series suggests."""
    series = evaluate(series_to(order - 1), walker, flow)
    width = greatest_of([one.spread for one in enclosures_in(flow.state)])
    wanted = greatest(tolerance, RELATIVE_TOLERANCE * width)
    length = factor * suggest_length(series.state, wanted)
    time = ball(length / 2, length / 2)
    way = map_series(lambda known: enclose_polynomial([one.range() for one in known], time), series)
    box = map_enclosures(lambda one: one.widened(ROOM[0] * one.radius + ROOM[1]), way)
    last = evaluate(series_to(order), ranges_of(walker), box)
    rest = map_series(lambda coefficients: coefficients[order].magnitude, last)
    speeds = map_series(lambda coefficients: coefficients[1].magnitude, last)
    power = power_bound(length, order)
    stays = lambda one, bound, room: outward(bound * power) < room.radius - one.radius
    proved = True
    for flag in jax.tree.leaves(map_enclosures(stays, way, rest, box)):
        proved = proved & flag
    return VerifiedStep(series, length, rest, speeds, proved)


def power_bound(bound, order: int):
    """Return an upper bound on a power of a nonnegative number."""
    power = bound
    for _ in range(order - 1):
        power = outward(power * bound)
    return power


def suggest_length(series, tolerance):
    """Suggest a step in which the last two terms stay below a tolerance (Jorba and Zou 2005).

    No proof rests on it: any length is sound.
    """
    lists = jax.tree.leaves(series, is_leaf=is_list)
    largest = lambda k: greatest_of([one[k].norm for one in lists])
    scale, last = greatest(largest(0), largest(1)), len(lists[0]) - 1
    lengths = [(tolerance * scale / (largest(k) + 1e-290)) ** (1 / k) for k in (last - 1, last)]
    return least(least(*lengths), LONGEST_STEP)


def greatest_of(values: Sequence):
    first, *others = values
    for value in others:
        first = greatest(first, value)
    return first


def enclose_polynomial(coefficients: list[Enclosure], time: Enclosure) -> Enclosure:
    """Enclose a polynomial's value by Horner's rule."""
    value = coefficients[-1]
    for one in coefficients[-2::-1]:
        value = value * time + one
    return value


def flow_at(step: VerifiedStep, time: Enclosure | Any, *, ranges: bool = False) -> Flow:
    """Enclose the flow at a time of a step, which may depend on the start.

    With `ranges`, the coefficients count as intervals.
    """
    given = time if is_enclosure(time) else exactly(time, enclosures_in(step.series)[0].space)
    order = len(jax.tree.leaves(step.series, is_leaf=is_list)[0])
    power = power_bound(given.magnitude, order)

    def at(coefficients, rest):
        one_space = lambda one: as_enclosure(one.range(), given.space)
        known = map(one_space, coefficients) if ranges else coefficients
        return enclose_polynomial([*known], given).widened(outward(rest * power))

    return map_series(at, step.series, step.rest)
