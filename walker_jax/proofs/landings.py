"""Bounds on all heel strikes that the starts of a box may make, if it is open which of them do.

Next to a boundary some starts of a box strike and others fall. The result for such a box is weaker
than a verified stride: each of its starts that makes a stride lands in the box that is returned.
That is enough to prove that none of them walks. It is not checked that starts are feasible, push
the ground and lift the trailing foot: those that do not do so make no stride.

A piece of a step holds no strike if throughout it the value of the strike keeps its sign or falls,
if no strike is admitted, or if all of the box has fallen. Any other piece may hold a strike at any
time.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
from jax import lax

from walker_jax.proofs.enclosures import Enclosure, choose, exactly, greatest, least
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.events import TIME, dense, dense_like, fallen_by, measure, measure_ranges
from walker_jax.proofs.flows import (
    ORDER,
    Flow,
    VerifiedStep,
    flow_at,
    map_enclosures,
    ranges_of,
    take_step,
)
from walker_jax.proofs.strides import (
    FALL,
    GOING,
    LEAST_FACTOR,
    MOST_STEPS,
    TOLERANCE,
    UNDECIDED,
    as_int32,
    is_wide,
    land,
    next_factor,
    start_flow,
)

PARTLY = 5
"""Verdict beside those of strides: the starts that make a stride land in the next box."""
LANDING_PIECES = 16
"""Number of pieces of a step; the times of strikes are resolved to one piece."""
ROOM = 1e-14
"""Part of a time by which an interval of times is widened, for rounding."""
FARTHEST = 4.0
"""Limit of the bounds on landings; a box that exceeds it is undecided."""


class LandingBounds(NamedTuple):
    """Bounds on landings: on a theta + b thetadot, and on a thetadot - b theta.

    As long as no strike is found, `low` is above `high`.
    """

    axis: tuple
    """(a, b), the direction in which the first landings move with the time of the strike."""
    low: tuple
    high: tuple


class LandingSearch(NamedTuple):
    """State of the loop that follows a box until all of it has fallen."""

    flow: Flow
    factor: Any
    bounds: LandingBounds
    verdict: Any
    steps: Any


def enclose_landings(walker, x: tuple[Enclosure, Enclosure]) -> tuple[Any, LandingBounds]:
    """Enclose the landings of those starts of a box that make a stride.

    **Returns** the verdict and bounds: `FALL` if there is no strike, `PARTLY` if all strikes land
    within the bounds, and `UNDECIDED` if neither is proved.
    """
    x = dense(x[0]), dense(x[1])
    number = x[0].midpoint
    fill = dense_like(x[0])
    flow = map_enclosures(fill, evaluate(start_flow, walker, x, ()))
    parameters = ranges_of(walker)
    both = lambda value: (value + 0.0 * number, value + 0.0 * number)
    fallen = fallen_by(measure_ranges(parameters, flow))
    start = LandingSearch(
        flow,
        0.0 * number + 1.0,
        LandingBounds(both(1.0), both(2 * FARTHEST), both(-2 * FARTHEST)),
        as_int32(choose(fallen, FALL, GOING)),
        as_int32(0 * number),
    )
    going = lambda now: now.verdict == GOING
    last = lax.while_loop(going, partial(advance_landings, walker, parameters, fill), start)
    strikes = last.bounds.low[0] <= last.bounds.high[0]
    return as_int32(choose((last.verdict == FALL) & strikes, PARTLY, last.verdict)), last.bounds


def advance_landings(walker, parameters, fill, now: LandingSearch) -> LandingSearch:
    """Take one more step. A strike in it ends nothing, as other starts go on."""
    step = take_step(walker, now.flow, now.factor, order=ORDER, tolerance=TOLERANCE)
    first, last = find_strike_pieces(parameters, step, now.steps == 0)
    landings = landings_between(parameters, step, first, last)
    bounds, known = join_landings(now.bounds, landings, first <= last)
    flow = flow_at(step, step.length)
    wide = ~known | is_wide(flow)
    late = now.steps + 1 >= MOST_STEPS
    fallen = fallen_by(measure_ranges(parameters, flow))
    verdict = choose(wide, UNDECIDED, choose(fallen, FALL, choose(late, UNDECIDED, GOING)))
    short = choose(late | (now.factor < LEAST_FACTOR), UNDECIDED, GOING)
    keep = lambda new, old: jax.tree.map(lambda a, b: choose(step.proved, a, b), new, old)
    return LandingSearch(
        keep(map_enclosures(fill, flow), now.flow),
        next_factor(now.factor, step),
        keep(bounds, now.bounds),
        as_int32(choose(step.proved, verdict, short)),
        now.steps + 1,
    )


def time_between(low, high) -> Enclosure:
    """Return all times between two, as a polynomial."""
    half = (high - low) * (0.5 + ROOM) + ROOM * high
    return Enclosure([(low + high) / 2, half, None], 0.0, TIME)


def find_strike_pieces(parameters, step: VerifiedStep, at_start) -> tuple:
    """Find the first and the last piece of a step that may hold a strike.

    If there is none, the first comes after the last. A stride starts with the strike's value at
    zero; if the value rises throughout the first piece, it does not return to zero there.
    """

    def look_in_piece(i, known):
        first, last = known
        time = time_between(
            i * (step.length / LANDING_PIECES), (i + 1) * (step.length / LANDING_PIECES)
        )
        found = evaluate(measure, parameters, flow_at(step, time, ranges=True).state)
        none = (found.strike.upper < 0) | (found.strike.lower > 0) | (found.rate.upper < 0)
        none = none | fallen_by(found) | (at_start & (i == 0) & (found.rate.lower > 0))
        for one in found.admits:
            none = none | (one.upper < 0)
        here = zero + i
        return choose(none, first, least(first, here)), choose(none, last, greatest(last, here))

    zero = 0.0 * step.length
    return lax.fori_loop(0, LANDING_PIECES, look_in_piece, (zero + LANDING_PIECES, zero - 1))


def landings_between(parameters, step: VerifiedStep, first, last) -> tuple[Enclosure, Enclosure]:
    """Enclose the landings of all strikes from the first to the last piece of a step."""
    length = step.length / LANDING_PIECES
    time = time_between(first * length, (last + 1) * length)
    return evaluate(land, parameters, flow_at(step, time, ranges=True))[1]


def join_landings(bounds: LandingBounds, landing: tuple, any_strike) -> tuple[LandingBounds, Any]:
    """Return bounds on all landings so far, and whether those of this step are below `FARTHEST`."""
    theta, thetadot = landing
    is_first = bounds.low[0] > bounds.high[0]
    axis = tuple(
        choose(is_first, one, old)
        for one, old in zip((theta.terms[1], thetadot.terms[1]), bounds.axis, strict=True)
    )
    a, b = (exactly(one, TIME) for one in axis)
    found = a * theta + b * thetadot, a * thetadot - b * theta
    within = True
    for one in found:
        within = within & (one.lower > -FARTHEST) & (one.upper < FARTHEST)
    take = lambda best, old, new: choose(any_strike, best(old, new), old)
    low = tuple(take(least, old, one.lower) for old, one in zip(bounds.low, found, strict=True))
    high = tuple(
        take(greatest, old, one.upper) for old, one in zip(bounds.high, found, strict=True)
    )
    axis = tuple(take(lambda old, new: new, *both) for both in zip(bounds.axis, axis, strict=True))
    return LandingBounds(axis, low, high), ~any_strike | within
