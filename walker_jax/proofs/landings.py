"""All heel strikes that a box of starts may make, where it is open which of them do.

Next to a boundary some starts of a box strike and others fall. Of such a box this says less than a
verified stride does, and it is enough to prove that none of it walks: each of its starts that makes
a stride lands in the box that is returned. No start is asked to be feasible, to push the ground or
to lift its trailing foot; those that do not do so make no stride.

Over a piece of a step no strike can be where its value keeps its sign or falls, where it is not
admitted, or where all of the box has fallen before. The other pieces may hold one at any time.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
from jax import lax

from walker_jax.proofs.enclosures import Enclosure, choose, exactly, greatest, least
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.events import TIME, Measures, dense, measure
from walker_jax.proofs.flows import (
    ORDER,
    Flow,
    Step,
    flow_at,
    map_enclosures,
    numbers_of,
    step_from,
)
from walker_jax.proofs.strides import (
    FALL,
    GOING,
    LEAST_FACTOR,
    MOST_STEPS,
    TOLERANCE,
    UNDECIDED,
    WIDEST,
    begin,
    dense_like,
    land,
    whole,
)

PARTLY = 5
"""A verdict beside those of strides: starts of the box that make a stride land in the next box."""
PIECES = 16
"""Parts of a step: when a strike may be is known to these."""
FARTHEST = 4.0
"""Bounds of where starts land are below it, or nothing is known."""


class Reach(NamedTuple):
    """Where starts may land: bounds of a theta + b thetadot and of a thetadot - b theta. The low
    ones are above the high ones before there is any strike."""

    axis: tuple
    """a and b: the direction in which the first landings move with the time of the strike."""
    low: tuple
    high: tuple


class Falling(NamedTuple):
    """A box on its way, until all of it has fallen."""

    flow: Flow
    factor: Any
    reach: Reach
    verdict: Any
    steps: Any


def enclose_landings(walker, x: tuple[Enclosure, Enclosure]) -> tuple[Any, Reach]:
    """Where the starts of a box land that make a stride.

    **Returns** the verdict and bounds: `FALL` if there is no strike, `PARTLY` if all of them are
    within the bounds, and `UNDECIDED` if neither is proved.
    """
    x = dense(x[0]), dense(x[1])
    number = x[0].middle
    fill = dense_like(x[0])
    flow = map_enclosures(fill, evaluate(begin, walker, x, ()))
    parameters = map_enclosures(lambda one: one.range(), walker)
    bounds = lambda value: (value + 0.0 * number, value + 0.0 * number)
    fallen = fallen_by(measure_ranges(parameters, flow))
    start = Falling(
        flow,
        0.0 * number + 1.0,
        Reach(bounds(1.0), bounds(2 * FARTHEST), bounds(-2 * FARTHEST)),
        whole(choose(fallen, FALL, GOING)),
        whole(0 * number),
    )
    going = lambda now: now.verdict == GOING
    last = lax.while_loop(going, partial(advance, walker, parameters, fill), start)
    strikes = last.reach.low[0] <= last.reach.high[0]
    return whole(choose((last.verdict == FALL) & strikes, PARTLY, last.verdict)), last.reach


def measure_ranges(parameters, flow: Flow) -> Measures:
    return evaluate(measure, parameters, map_enclosures(lambda one: one.range(), flow.state))


def fallen_by(found: Measures) -> Any:
    """Whether a guard is above zero in all states: where a stride begins it is below."""
    fallen = False
    for one in found.falls:
        fallen = fallen | (one.lower > 0)
    return fallen


def advance(walker, parameters, fill, now: Falling) -> Falling:
    """One more step. A strike in it ends nothing, as other starts go on."""
    step = step_from(walker, now.flow, now.factor, order=ORDER, tolerance=TOLERANCE)
    first, last = pieces_of_strikes(parameters, step, now.steps == 0)
    landings = landings_between(parameters, step, first, last)
    reach, known = joined(now.reach, landings, first <= last)
    flow = flow_at(step, step.length)
    wide = ~known
    for one in numbers_of(flow.state):
        wide = wide | ~(one.spread < WIDEST)
    late = now.steps + 1 >= MOST_STEPS
    fallen = fallen_by(measure_ranges(parameters, flow))
    verdict = choose(wide, UNDECIDED, choose(fallen, FALL, choose(late, UNDECIDED, GOING)))
    short = choose(late | (now.factor < LEAST_FACTOR), UNDECIDED, GOING)
    keep = lambda new, old: jax.tree.map(lambda a, b: choose(step.held, a, b), new, old)
    return Falling(
        keep(map_enclosures(fill, flow), now.flow),
        choose(step.held, choose(now.factor < 1, now.factor * 2, 1.0), now.factor / 2),
        keep(reach, now.reach),
        whole(choose(step.held, verdict, short)),
        now.steps + 1,
    )


def time_between(low, high) -> Enclosure:
    """A time between two, as a polynomial."""
    return Enclosure(
        [(low + high) / 2, (high - low) * (0.5 + 1e-14) + 1e-14 * high, None], 0.0, TIME
    )


def pieces_of_strikes(parameters, step: Step, at_start) -> tuple:
    """The first piece of a step that may hold a strike, and the last one; in the other order, there
    is none.

    A stride starts at zero of the strike's value: while it rises from there, it does not come back.
    """

    def look(i, known):
        first, last = known
        time = time_between(i * (step.length / PIECES), (i + 1) * (step.length / PIECES))
        found = evaluate(measure, parameters, flow_at(step, time, ranges=True).state)
        none = (found.strike.upper < 0) | (found.strike.lower > 0) | (found.rate.upper < 0)
        none = none | fallen_by(found) | (at_start & (i == 0) & (found.rate.lower > 0))
        for one in found.admits:
            none = none | (one.upper < 0)
        here = zero + i
        return choose(none, first, least(first, here)), choose(none, last, greatest(last, here))

    zero = 0.0 * step.length
    return lax.fori_loop(0, PIECES, look, (zero + PIECES, zero - 1))


def landings_between(parameters, step: Step, first, last) -> tuple[Enclosure, Enclosure]:
    """Where strikes lead in pieces of a step."""
    length = step.length / PIECES
    time = time_between(first * length, (last + 1) * length)
    return evaluate(land, parameters, flow_at(step, time, ranges=True))[1]


def joined(reach: Reach, landing: tuple, any_strike) -> tuple[Reach, Any]:
    """Bounds of all landings so far, and whether they are numbers."""
    theta, thetadot = landing
    is_first = reach.low[0] > reach.high[0]
    axis = tuple(
        choose(is_first, one, old)
        for one, old in zip((theta.terms[1], thetadot.terms[1]), reach.axis, strict=True)
    )
    a, b = (exactly(one, TIME) for one in axis)
    found = a * theta + b * thetadot, a * thetadot - b * theta
    within = True
    for one in found:
        within = within & (one.lower > -FARTHEST) & (one.upper < FARTHEST)
    take = lambda best, old, new: choose(any_strike, best(old, new), old)
    low = tuple(take(least, old, one.lower) for old, one in zip(reach.low, found, strict=True))
    high = tuple(take(greatest, old, one.upper) for old, one in zip(reach.high, found, strict=True))
    axis = tuple(take(lambda old, new: new, *both) for both in zip(reach.axis, axis, strict=True))
    return Reach(axis, low, high), ~any_strike | within
