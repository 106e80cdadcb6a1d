"""Events within a step: guards proved not to rise, and the heel strike enclosed in time.

A mode's last guard is the strike. A piece of a step holds no strike if throughout the piece the
value of the strike keeps its sign or falls, or one of the functions that admit it is negative. If
the value rises throughout, it has at most one zero there. Such rising pieces may only be the last
before the strike, which is then their one zero; or a piece follows where the value is negative
throughout, and then they had no zero.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
from jax import lax

from walker_jax.integrators.taylor import function_series
from walker_jax.proofs.enclosures import (
    BALLS,
    Enclosure,
    Space,
    array_module,
    choose,
    exactly,
    outward,
)
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.flows import (
    Flow,
    VerifiedStep,
    enclose_polynomial,
    flow_at,
    map_enclosures,
    ranges_of,
)

PIECES = 4
"""Number of pieces of a step; guards are enclosed over each."""
TIME = Space(1, 2)
"""Space of polynomials in the time within a piece. They closely enclose functions of numbers that
move together; the spread of the starts only adds to the radius."""
BISECTIONS, NEWTON_STEPS = 10, 4


class Measures(NamedTuple):
    """Values of a mode's functions in a state."""

    falls: list
    """Values of all guards but the last."""
    strike: Any
    """Value of the last guard."""
    rate: Any
    """Time derivative of the strike's value."""
    admits: list
    conditions: list


def measure(walker, state) -> Measures:
    """Evaluate guards, functions that admit the strike, and conditions of the last mode."""
    mode = walker.modes()["swing"]
    *falls, strike = mode.guards
    rates = mode.rates(state)
    value, rate = jax.jvp(strike.value, (state,), (rates,))
    return Measures(
        [one.value(state) for one in falls],
        value,
        rate,
        [one(state) for one in strike.admits],
        [one.value(state) for one in mode.conditions],
    )


def measure_ranges(parameters, flow: Flow) -> Measures:
    """Return the range of each function over all states of a flow."""
    return evaluate(measure, parameters, ranges_of(flow.state))


def fallen_by(found: Measures) -> Any:
    """Return whether all states have fallen: some guard is above zero in all of them.

    As a stride begins, every guard is below zero.
    """
    fallen = False
    for one in found.falls:
        fallen = fallen | (one.lower > 0)
    return fallen


class Watch(NamedTuple):
    """Facts that are proved about the motion so far."""

    no_strike: Any
    """Whether there was no strike, except perhaps one while `rising`."""
    rising: Any
    """Whether the strike's value rises since some time: it may have passed zero since, once."""
    clear: Any
    """Whether there was no fall, and all conditions held."""


def watch_step(walker, step: VerifiedStep, watch: Watch, end) -> Watch:
    """Extend the proved facts over a step, up to the time `end`."""
    plain = step._replace(series=Flow(step.series.state), rest=Flow(step.rest.state))

    def watch_next(i, watch):
        middle, half = (2 * i + 1) * (end / (2 * PIECES)), end * (0.5 / PIECES + 1e-14)
        time = Enclosure([middle, half, None], 0.0, TIME)
        found = evaluate(measure, walker, flow_at(plain, time, ranges=True).state)
        return watch_piece(found, watch)

    if array_module(end) is jax.numpy:
        return lax.fori_loop(0, PIECES, watch_next, watch)
    for i in range(PIECES):
        watch = watch_next(i, watch)
    return watch


def watch_piece(found: Measures, watch: Watch) -> Watch:
    """Extend the proved facts over a piece, given the range of each function there."""
    below, above = found.strike.upper < 0, found.strike.lower > 0
    excluded = below | above | (found.rate.upper < 0)
    for one in found.admits:
        excluded = excluded | (one.upper < 0)
    rises = found.rate.lower > 0
    no_strike = watch.no_strike & choose(watch.rising, below | rises, excluded | rises)
    rising = choose(watch.rising, ~below, ~excluded & rises)
    clear = watch.clear
    for one in found.falls:
        clear = clear & (one.upper < 0)
    for one in found.conditions:
        clear = clear & (one.lower >= 0)
    return Watch(no_strike, rising, clear)


@cache
def strike_series():
    """Return a function that expands the strike's value along a motion in a Taylor series."""
    return lambda walker, series: function_series(walker.modes()["swing"].guards[-1].value, series)


class Strike(NamedTuple):
    """Heel strike within a step."""

    flow: Flow
    """State and tangents there, before the impact."""
    latest: Any
    """Time in the step by which the strike has occurred."""
    proved: Any
    """Whether every start has exactly one zero of the strike's value near the time found."""


def guess_strike(walker, step: VerifiedStep) -> tuple[list[Enclosure], Any, Any, Any]:
    """Guess whether the midpoint of a box strikes in a step, and when; nothing is proved.

    **Returns** the series of the strike's value; whether the midpoint strikes well within the step;
    when it does, or half the step; and whether it strikes soon after the step.
    """
    series = evaluate(strike_series(), walker, step.series.state)
    middle = [one.midpoint for one in series]
    h = step.length

    def value(t):
        result = middle[-1] + 0.0 * t
        for c in middle[-2::-1]:
            result = result * t + c
        return result

    there = map_enclosures(midpoint_of, state_at_midpoint(step, h))
    admits = True
    for one in evaluate(measure, map_enclosures(midpoint_of, walker), there).admits:
        admits = admits & (one.midpoint > 0)
    begins = (value(0.0 * h) < 0) & admits
    within = begins & (value(0.85 * h) > 0)
    soon = begins & ~within & (value(1.5 * h) > 0)
    low, high = 0.0 * h, h
    for _ in range(BISECTIONS):
        half = (low + high) / 2
        up = value(half) > 0
        low, high = choose(up, low, half), choose(up, half, high)
    time = (low + high) / 2
    for _ in range(NEWTON_STEPS):
        time = time - value(time) / rate_at_midpoint(series, time)
    return series, within, choose(within, time, h / 2), soon


def state_at_midpoint(step: VerifiedStep, t):
    """Return the state of a box's midpoint at a time, not proved."""
    series = map_enclosures(midpoint_of, step.series.state)
    middle = step._replace(series=Flow(series), rest=Flow(step.rest.state))
    return flow_at(middle, exactly(t, BALLS)).state


def midpoint_of(one: Enclosure) -> Enclosure:
    """Return the midpoint of an enclosure, as an interval."""
    return exactly(one.midpoint, BALLS)


def enclose_strike(walker, step: VerifiedStep, series: list[Enclosure], guess) -> Strike:
    """Enclose the strike as a function of the start: by Newton's iteration, then by a proof.

    The iteration finds a polynomial T(u), about the time of the strike from the start u; no proof
    rests on it. Let r(u) be the strike's value at that time. If its rate is at least d > 0 from
    T(u) - e to T(u) + e, and |r(u)| <= d e, its only zero there is within |r(u)| / d of T(u).
    """
    space = series[0].space
    slope = rate_at_midpoint(series, guess)
    time = dense(exactly(guess, space))
    for _ in range(max(space.degree, 1) + 1):
        off = enclose_polynomial(series, time)
        time = without_radius(time - off * (1 / slope))
    there = flow_at(step, time)
    off = evaluate(measure, walker, there.state).strike.magnitude
    margin = outward(2 * off / abs(slope)) + 2.0**-60
    reach = lambda margin: lambda one, speed: one.widened(outward(speed * margin))
    around = map_enclosures(reach(margin), there, step.speeds)
    rate = evaluate(measure, walker, around.state).rate.lower
    early, latest = time.lower - margin, outward(time.upper + margin)
    inside = (early > 0) & (latest < step.length) & (rate > 0)
    error = outward(off / choose(rate > 0, rate, 1.0))
    return Strike(
        map_enclosures(reach(error), there, step.speeds), latest, inside & (error <= margin)
    )


def rate_at_midpoint(series: list[Enclosure], time):
    """Return the rate of a series of the midpoint at a time, not proved."""
    result = 0.0
    for k in range(len(series) - 1, 0, -1):
        result = result * time + k * series[k].midpoint
    return result


def without_radius(one: Enclosure) -> Enclosure:
    return Enclosure(one.terms, 0.0, one.space)


def dense(one: Enclosure) -> Enclosure:
    """Return the same enclosure with zeros for the terms that are None."""
    return dense_like(one)(one)


def dense_like(model: Enclosure) -> Callable[[Enclosure], Enclosure]:
    """Return `dense` for enclosures of the shape of a model."""

    def fill(one: Enclosure) -> Enclosure:
        zero = 0.0 * model.midpoint
        terms = [zero if t is None else t + zero for t in one.terms]
        return Enclosure(terms, one.radius + zero, one.space)

    return fill
