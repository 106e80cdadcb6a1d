"""Verified steps of a solution: Taylor series with a bound on what they leave out.

A step begins in all states of an enclosure at once. While a solution stays in a box, the remainder
of its series is the coefficient of order n somewhere in the box (Lagrange, for each number):

    y(t) in sum_{k<n} c_k t^k + [c_n(box)] t^n.

If all of this, for 0 <= t <= h, lies inside the box, no solution can leave the box within the step:
it would have to be on the border first (Corliss and Rihm 1996). The coefficients c_k are
polynomials in the start, so neighbours stay as near to each other as they are.

A flow may carry tangents, whose equations are the variational ones.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax

from walker_jax.integrators.taylor import grow_series
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
"""Order of the remainder: the package's own."""
LONGEST_STEP = 1.0
PART_LOST = 1e-5
"""Of a wide box, terms of this part of its width may be left out: its steps are longer."""
ROOM = 1e-3, 2.0**-40
"""How much wider than the polynomials a box is, relative to them and at least."""


class Flow(NamedTuple):
    """A state and its derivatives by some coordinates of the start."""

    state: Any
    tangents: tuple = ()


class Step(NamedTuple):
    """The solution over a step."""

    series: Flow
    """The coefficients of each number, in lists."""
    length: Any
    rest: Flow
    """Bounds of each number's last coefficient."""
    speeds: Flow
    """Bounds of the rates over the step."""
    held: Any
    """Whether the box is proved; nothing else holds where it is not."""


def motion(walker, flow: Flow) -> Flow:
    """The rates of a state and of its tangents."""
    rates = walker.vector_field(flow.state)
    change = lambda tangent: jax.jvp(walker.vector_field, (flow.state,), (tangent,))[1]
    return Flow(rates, tuple(map(change, flow.tangents)))


@cache
def series_to(order: int) -> Callable:
    """The Taylor coefficients of a flow, up to an order."""
    return lambda walker, flow: grow_series(lambda flow: motion(walker, flow), flow, order)


def map_enclosures(function: Callable, *trees):
    return jax.tree.map(function, *trees, is_leaf=is_enclosure)


def map_series(function: Callable, series, *trees):
    """A function of each number's list of coefficients."""
    return jax.tree.map(function, series, *trees, is_leaf=lambda x: isinstance(x, list))


def numbers_of(tree) -> list:
    return jax.tree.leaves(tree, is_leaf=is_enclosure)


def interval(one: Enclosure) -> Enclosure:
    return one.range()


def step_from(walker, flow: Flow, factor, *, order: int = ORDER, tolerance: float) -> Step:
    """The step that begins in a flow, `factor` times as long as the series suggests."""
    series = evaluate(series_to(order - 1), walker, flow)
    width = highest([one.spread for one in numbers_of(flow.state)])
    length = factor * step_length(series.state, greatest(tolerance, PART_LOST * width))
    time = ball(length / 2, length / 2)
    way = map_series(lambda known: polynomial([one.range() for one in known], time), series)
    box = map_enclosures(lambda one: one.widened(ROOM[0] * one.radius + ROOM[1]), way)
    parameters = map_enclosures(interval, walker)
    last = evaluate(series_to(order), parameters, box)
    rest = map_series(lambda coefficients: coefficients[order].magnitude, last)
    speeds = map_series(lambda coefficients: coefficients[1].magnitude, last)
    power = power_of(length, order)
    stays = lambda one, bound, room: outward(bound * power) < room.radius - one.radius
    held = True
    for flag in jax.tree.leaves(map_enclosures(stays, way, rest, box)):
        held = held & flag
    return Step(series, length, rest, speeds, held)


def power_of(bound, order: int):
    """At least the power of a number that is not negative."""
    power = bound
    for _ in range(order - 1):
        power = outward(power * bound)
    return power


def step_length(series, tolerance):
    """The step in which the last two terms stay below a tolerance (Jorba and Zou 2005).

    Any number would do: what is proved does not rest on it.
    """
    lists = jax.tree.leaves(series, is_leaf=lambda x: isinstance(x, list))
    largest = lambda k: highest([one[k].norm for one in lists])
    scale, last = greatest(largest(0), largest(1)), len(lists[0]) - 1
    lengths = [(tolerance * scale / (largest(k) + 1e-290)) ** (1 / k) for k in (last - 1, last)]
    return least(least(*lengths), LONGEST_STEP)


def highest(values: Sequence):
    first, *others = values
    for value in others:
        first = greatest(first, value)
    return first


def polynomial(coefficients: list[Enclosure], time: Enclosure) -> Enclosure:
    value = coefficients[-1]
    for one in coefficients[-2::-1]:
        value = value * time + one
    return value


def flow_at(step: Step, time: Enclosure | Any, *, ranges: bool = False) -> Flow:
    """The flow at a time of a step, which may depend on the start; as intervals if `ranges`."""
    given = time if is_enclosure(time) else exactly(time, numbers_of(step.series)[0].space)
    order = len(jax.tree.leaves(step.series, is_leaf=lambda x: isinstance(x, list))[0])
    power = power_of(given.magnitude, order)

    def at(coefficients, rest):
        one_space = lambda one: as_enclosure(one.range(), given.space)
        known = map(one_space, coefficients) if ranges else coefficients
        return polynomial([*known], given).widened(outward(rest * power))

    return map_series(at, step.series, step.rest)
