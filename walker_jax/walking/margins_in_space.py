"""By how much a stride in space misses each way to fail (`failure_margins`).

A stride in space ends where the swing disc touches the slope ahead of the other, or where the
walker has fallen, to a side, forward or backward, whichever is first. So it is lost where the two
are at the same time, where the disc touches just as the legs pass each other, or grazes the slope
before; and as in the plane where the ground would have to pull, or the trailing foot does not lift.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from walker_jax.hybrid.conditions import least_between, value_and_rate
from walker_jax.integrators.roots import (
    differentiable_zero,
    first_upcrossing,
    interior_minimum,
    negate,
    polynomial_jet,
)
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.solvers import (
    MAX_STEPS,
    evaluate_series,
    series_order,
    taylor_step,
    zero_at,
)
from walker_jax.integrators.taylor import function_series, with_fast_sincos
from walker_jax.walkers.model import Scalar, least_scuff
from walker_jax.walkers.rolling_stance import SpatialState
from walker_jax.walkers.spatial import GREATEST_LEAN, SpatialWalker
from walker_jax.walking.falls import (
    distance_to_fall,
    fall_of,
    falls_begin,
    has_fallen,
    has_own_falls,
    missing_slope,
)
from walker_jax.walking.modes import conditions_of, equations
from walker_jax.walking.outcomes import Outcome, Stride
from walker_jax.walking.phase_margins import upcrossing, violated_in, with_own_failures
from walker_jax.walking.phases import Arrival
from walker_jax.walking.stepping import begin_stride, end_stride, on_section


class StrideInSpace(NamedTuple):
    """A stride up to some instant, with what its margins are made of."""

    state: SpatialState
    time: Scalar
    verdict: Int[Array, ""]
    count: Int[Array, ""]
    upright: list[Scalar]
    """Least distances from falls, those of `distances_from_falls`."""
    graze: Scalar
    """The least height at which the swing disc has turned upwards; infinite until it has."""
    miss: Scalar
    """The nearest miss of a heel strike. Where the disc has touched before the legs passed each
    other, minus the angle that they lacked; where it turned ahead, downwards below the slope or
    upwards above it, minus its distance from that. Minus infinity until it has done either."""
    clearing: Scalar
    """The greatest height at which the disc has turned downwards since it last was below the slope;
    minus infinity if it has not."""
    height: Scalar
    """Of the disc above the slope as the walker falls."""
    fallen: Scalar
    """Of a fall of one's own, `missing_slope`, or minus the distance where it is at the start;
    infinite if there is none."""
    least: dict[int, Scalar]
    """The least values of conditions, the contact force the first, by outcomes."""
    arrival: SpatialState
    """That at heel strike, if there is one."""
    below: Bool[Array, ""]
    """Whether h < 0: decided once for the end of a step and the start of the next."""


def distances_from_falls(lean: Any, theta: Any) -> list:
    """Of the lean from both its limits, and of theta from falling backward and forward."""
    return [GREATEST_LEAN - lean, GREATEST_LEAN + lean, np.pi / 2 - theta, np.pi / 2 + theta]


def series_of_distances(series: Any) -> list[list[Scalar]]:
    """Those along the motion."""
    lean, theta = series.lean, series.theta
    signs = zip((-1, 1, -1, 1), (lean, lean, theta, theta), strict=True)
    first = distances_from_falls(lean[0], theta[0])
    return [
        [start, *(sign * c for c in terms[1:])]
        for start, (sign, terms) in zip(first, signs, strict=True)
    ]


def scuffs_by_turns(walker: SpatialWalker) -> bool:
    """Whether the disc must stay above the slope, and is least above it where it turns upwards."""
    return not walker.allow_scuffing and type(walker).conditions is SpatialWalker.conditions


def conditions_on_the_way(walker: SpatialWalker) -> dict[int, Callable[[Any], Scalar]]:
    """Those that are looked at all along the stride, by the outcome where one is broken."""
    found = conditions_of(walker)
    if scuffs_by_turns(walker):
        del found[int(Outcome.SCUFFED)]
    return found


def follow_in_space(
    walker: SpatialWalker,
    start: SpatialState,
    verdict: Int[Array, ""],
    tolerance: Scalar,
    *,
    launched: bool,
) -> StrideInSpace:
    """The stride from a state to its end; nothing to do unless `UNDECIDED`."""
    field, order = equations(walker), series_order(start)

    def undecided(now: StrideInSpace):
        going = (now.verdict == Outcome.UNDECIDED) & (now.count < MAX_STEPS)
        return going & jnp.isfinite(now.time)

    def advance(now: StrideInSpace) -> StrideInSpace:
        others = walker.contact, *falls_begin(walker)
        series, length = taylor_step(field, now.state, order, tolerance, *others)
        after = evaluate_series(series, length)
        h = function_series(walker.contact, series)
        jet = polynomial_jet(h)
        below = with_fast_sincos(walker.contact)(after) < 0
        dip = interior_minimum(negate(jet), length)
        search = jnp.where(dip.exists, dip.time, length)
        sides = now.below, jnp.where(dip.exists, jet(search)[0] < 0, below)
        crossed, when = first_upcrossing(jet, search, sides)
        when = differentiable_zero(h, when)
        arrival = evaluate_series(series, when)
        ahead = walker.is_ahead(arrival) > 0
        strikes = crossed & ahead & ~has_fallen(walker, arrival)
        until = jnp.where(strikes, when, length)
        end = jax.tree.map(lambda a, b: jnp.where(strikes, a, b), arrival, after)

        # the disc
        low, top = interior_minimum(negate(jet), until), interior_minimum(jet, until)
        lowest, highest = (-evaluate_polynomial(h, one.time) for one in (low, top))
        graze = jnp.where(low.exists, jnp.minimum(now.graze, lowest), now.graze)
        in_front = lambda one: one.exists & (walker.is_ahead(evaluate_series(series, one.time)) > 0)
        too_low, too_high = in_front(top) & (highest <= 0), in_front(low) & (lowest > 0)
        miss = jnp.where(too_low, jnp.maximum(now.miss, highest), now.miss)
        miss = jnp.where(too_high, jnp.maximum(miss, -lowest), miss)
        touches = crossed & ~ahead
        miss = jnp.where(touches, jnp.maximum(miss, walker.is_ahead(arrival)), miss)
        clears = top.exists & (highest > 0)
        clearing = jnp.where(clears, jnp.maximum(now.clearing, highest), now.clearing)
        clearing = jnp.where(touches, -jnp.inf, clearing)

        # the legs and the axle
        upright, fall, distances = [], length, series_of_distances(series)
        for known, distance in zip(now.upright, distances, strict=True):
            nearest = interior_minimum(polynomial_jet(distance), until)
            turned = jnp.where(nearest.exists, evaluate_polynomial(distance, nearest.time), known)
            known = jnp.minimum(jnp.minimum(known, turned), evaluate_polynomial(distance, until))
            upright.append(known)
            down = upcrossing([-c for c in distance], length)
            fall = jnp.where(down.exists & (down.time < fall), down.time, fall)
        verdict, fallen = fall_of(walker, after), now.fallen
        if has_own_falls(walker):
            fall, rate = length, 1 / jnp.sqrt(walker.leg_length)
            slope = missing_slope(walker, series, length, rate)
            fallen = jnp.where(verdict != Outcome.UNDECIDED, slope, fallen)

        # the conditions
        least = dict(now.least)
        for outcome, condition in watched.items():
            both = partial(value_and_rate, condition, walker.vector_field)
            between = lambda t: evaluate_series(series, t)
            at, value = least_between(both, now.state, end, between, until, resolution=1e-9)
            there = with_fast_sincos(condition)(evaluate_series(series, at))
            at_end = with_fast_sincos(condition)(end)
            value = jnp.where(jnp.isfinite(value), jnp.minimum(there, at_end), at_end)
            least[outcome] = jnp.minimum(least[outcome], value)
        return StrideInSpace(
            after,
            now.time + until,
            jnp.where(strikes, Outcome.STRIDE, verdict).astype(jnp.int8),
            now.count + 1,
            upright,
            graze,
            miss,
            clearing,
            -evaluate_polynomial(h, fall),
            fallen,
            least,
            arrival,
            below,
        )

    watched = conditions_on_the_way(walker)
    infinite = jnp.full_like(start.theta, jnp.inf)
    first = StrideInSpace(
        state=start,
        time=zero_at(start),
        verdict=verdict,
        count=jnp.asarray(0),
        upright=distances_from_falls(start.lean, start.theta),
        # On the section the disc touches the slope at first.
        graze=-with_fast_sincos(lambda w, s: w.contact(s))(walker, start) if launched else infinite,
        miss=-infinite,
        clearing=-infinite,
        height=infinite,
        fallen=-distance_to_fall(walker, start),
        least={key: with_fast_sincos(each)(start) for key, each in watched.items()},
        arrival=start,
        below=with_fast_sincos(walker.contact)(start) < 0,
    )
    return lax.while_loop(undecided, advance, first)


def margins_in_space(
    walker: SpatialWalker, x: Float[Array, " coordinates"], tolerance: Scalar
) -> tuple[Stride, dict[str, Scalar]]:
    """A stride, and its margins by their names in `Margins`."""
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    last = follow_in_space(walker, start, verdict, tolerance, launched=not on_section(walker, x))
    depth = last.graze + least_scuff(walker.leg_length)
    violated = violated_in(walker, last.least, last.arrival)
    if scuffs_by_turns(walker):
        violated[int(Outcome.SCUFFED)] |= depth < 0
    end = Arrival(last.arrival, last.time, last.verdict, violated)
    stride = with_fast_sincos(end_stride)(walker, end)
    found = with_fast_sincos(margins_at_end)(walker, verdict, last, stride.outcome, depth)
    return stride, found


def margins_at_end(
    walker: SpatialWalker,
    verdict: Int[Array, ""],
    last: StrideInSpace,
    outcome: Int[Array, ""],
    depth: Scalar,
) -> dict[str, Scalar]:
    """The margins of a stride whose start had a verdict, from what was seen of it."""
    (_, lift), after = walker.impact(last.arrival)
    following = walker.exchange_legs(after)
    struck, none = last.verdict == Outcome.STRIDE, jnp.full_like(lift, jnp.nan)
    pulled = verdict == Outcome.RUNNING
    fallen = fall_of(walker, last.state) != Outcome.UNDECIDED
    begun = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED)

    right, left, back, front = last.upright
    _, _, next_back, next_front = distances_from_falls(following.lean, following.theta)
    passed = walker.is_ahead(last.arrival)
    if walker.allow_scuffing:
        clears = jnp.isfinite(last.clearing)
        passed = jnp.where(clears, jnp.minimum(passed, last.clearing), passed)
    missed = jnp.isfinite(last.miss) & (last.height <= 0)
    falling = jnp.maximum(last.miss, jnp.where(missed, -jnp.inf, -jnp.abs(last.height)))
    ways = {
        Outcome.SIDEWAYS: ("sideways", jnp.minimum(right, left)),
        Outcome.BACKWARD: ("backward", jnp.minimum(back, next_back)),
        Outcome.FORWARD: ("forward", jnp.minimum(passed, jnp.minimum(front, next_front))),
    }
    found = {}
    for way, (name, value) in ways.items():
        down = jnp.where(fallen & (verdict == Outcome.UNDECIDED), falling, value)
        found[name] = jnp.where(struck, value, jnp.where(outcome == way, down, none))
    running = jnp.where(struck | pulled, last.least[Outcome.RUNNING], none)
    grazes = jnp.where(jnp.isfinite(last.graze), depth, none)
    scuffing = jnp.where(outcome == Outcome.SCUFFED, jnp.maximum(depth, last.miss), grazes)
    scuffing = jnp.where(struck, scuffing, none) if scuffs_by_turns(walker) else none
    found |= {
        "running": running,
        "stopping": jnp.where(struck & (outcome != Outcome.RUNNING), lift, none),
        "landing": none,
        "buckling": none,
        "scuffing": scuffing,
    }
    fell = jnp.where(verdict == Outcome.UNDECIDED, jnp.maximum(last.fallen, falling), last.fallen)
    found = with_own_failures(walker, found, following, struck, outcome, fell, last.least)
    keep = lambda name, value: jnp.where(begun & (~pulled | (name == "running")), value, none)
    return {name: keep(name, value) for name, value in found.items()}
