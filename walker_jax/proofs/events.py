"""Events on the way: guards proved not to rise, the heel strike enclosed in time.

A mode's last guard is the strike. Over a piece of a step the strike is out of the question where
its value keeps its sign or falls, or where one of the functions that admit it is negative; where
the value rises throughout the piece, it has one zero there at most. Such pieces may only be the
last ones before the strike, or be followed by one where the value is negative throughout.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
from jax import lax

from walker_jax.integrators.taylor import function_series
from walker_jax.proofs.enclosures import (
    BALLS,
    Enclosure,
    Space,
    choose,
    exactly,
    library,
    outward,
)
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.flows import Flow, Step, flow_at, map_enclosures, polynomial

PIECES = 4
"""Parts of a step, over each of which guards are looked at."""
TIME = Space(1, 2)
"""Polynomials of the time in a piece, so that functions of several numbers that move together are
enclosed well; the starts of a box only widen them."""
BISECTIONS, NEWTON_STEPS = 10, 4


class Measures(NamedTuple):
    """The functions of a mode, in a state."""

    falls: list
    """The values of all guards but the last."""
    strike: Any
    rate: Any
    """The time derivative of the strike's value."""
    admits: list
    conditions: list


def measure(walker, state) -> Measures:
    mode = walker.modes()[-1]
    *falls, strike = mode.guards
    rates = mode.rates(state)
    value, rate = jax.jvp(strike.value, (state,), (rates,))
    return Measures(
        [one.value(state) for one in falls],
        value,
        rate,
        [one(state) for one in (*strike.admits, *strike.admits_at_rise)],
        [one.value(state) for one in mode.conditions],
    )


class Watch(NamedTuple):
    """The way so far, by proof."""

    no_rise: Any
    """No strike."""
    rising: Any
    """The strike's value rises since some time, before which it was negative: it may be zero."""
    clear: Any
    """No fall, and all conditions hold."""


def watch_step(walker, step: Step, watch: Watch, end) -> Watch:
    """The proofs for a step, up to some time."""
    plain = step._replace(series=Flow(step.series.state), rest=Flow(step.rest.state))

    def look(i, watch):
        middle, half = (2 * i + 1) * (end / (2 * PIECES)), end * (0.5 / PIECES + 1e-14)
        time = Enclosure([middle, half, None], 0.0, TIME)
        found = evaluate(measure, walker, flow_at(plain, time, ranges=True).state)
        return watch_piece(found, watch)

    if library(end) is jax.numpy:
        return lax.fori_loop(0, PIECES, look, watch)
    for i in range(PIECES):
        watch = look(i, watch)
    return watch


def watch_piece(found: Measures, watch: Watch) -> Watch:
    below, above = found.strike.upper < 0, found.strike.lower > 0
    excluded = below | above | (found.rate.upper < 0)
    for one in found.admits:
        excluded = excluded | (one.upper < 0)
    rises = found.rate.lower > 0
    no_rise = watch.no_rise & choose(watch.rising, below | rises, excluded | rises)
    rising = choose(watch.rising, ~below, ~excluded & rises)
    clear = watch.clear
    for one in found.falls:
        clear = clear & (one.upper < 0)
    for one in found.conditions:
        clear = clear & (one.lower >= 0)
    return Watch(no_rise, rising, clear)


@cache
def strike_series():
    """The coefficients of the strike's value along a motion."""
    return lambda walker, series: function_series(walker.modes()[-1].guards[-1].value, series)


class Strike(NamedTuple):
    """The strike in a step."""

    flow: Flow
    """There, before the impact."""
    latest: Any
    """A time of the step after which it is not."""
    proved: Any


def guess_strike(walker, step: Step) -> tuple[list[Enclosure], Any, Any, Any]:
    """The series of the strike's value; whether the middle of the box strikes well within the step,
    and when; and whether it does so soon after the step. Nothing is proved here."""
    series = evaluate(strike_series(), walker, step.series.state)
    middle = [one.middle for one in series]
    h = step.length

    def value(t):
        result = middle[-1] + 0.0 * t
        for c in middle[-2::-1]:
            result = result * t + c
        return result

    def rate(t):
        result = (len(middle) - 1) * middle[-1] + 0.0 * t
        for k in range(len(middle) - 2, 0, -1):
            result = result * t + k * middle[k]
        return result

    ahead = map_enclosures(lambda one: exactly(one.middle, BALLS), walker)
    admitted = lambda t: (
        evaluate(
            measure,
            ahead,
            map_enclosures(lambda one: exactly(one.middle, BALLS), at_middle(step, t)),
        ).admits
    )
    admits = True
    for one in admitted(h):
        admits = admits & (one.middle > 0)
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
        time = time - value(time) / rate(time)
    return series, within, choose(within, time, h / 2), soon


def at_middle(step: Step, t):
    """The state of the middle of a box at a time, not proved."""
    middle = step._replace(
        series=Flow(
            jax.tree.map(
                lambda c: [exactly(one.middle, BALLS) for one in c],
                step.series.state,
                is_leaf=lambda x: isinstance(x, list),
            )
        ),
        rest=Flow(step.rest.state),
    )
    return flow_at(middle, exactly(t, BALLS)).state


def enclose_strike(walker, step: Step, series: list[Enclosure], guess) -> Strike:
    """The strike as a function of the start: Newton's iteration on a polynomial, then a proof.

    The value at the time T(u) is some r(u). Where its rate is at least d > 0 over the times between
    T(u) - e and T(u) + e, and |r(u)| <= d e, its only zero there is within |r(u)| / d of T(u).
    """
    space = series[0].space
    slope = total_rate(series, guess)
    time = dense(exactly(guess, space))
    for _ in range(max(space.degree, 1) + 1):
        off = polynomial(series, time)
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


def total_rate(series: list[Enclosure], time):
    """The rate of a series of the middle, not proved."""
    result = 0.0
    for k in range(len(series) - 1, 0, -1):
        result = result * time + k * series[k].middle
    return result


def without_radius(one: Enclosure) -> Enclosure:
    return Enclosure(one.terms, 0.0, one.space)


def dense(one: Enclosure) -> Enclosure:
    """The same with all terms as numbers."""
    shape = one.middle
    filled = [0.0 * shape if t is None else t + 0.0 * shape for t in one.terms]
    return Enclosure(filled, one.radius + 0.0 * shape, one.space)
