"""Verified strides: from an enclosure of starts to one of all next states, or a proved fall.

The section is that of walkers on massless point feet, theta and thetadot just after heel strike. A
box of starts is an enclosure of both coordinates, polynomials of as many variables as it has sides.
Each stride ends in a verdict: all of its starts make a stride, and the next states are enclosed;
all of them fall; or neither is proved.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from walker_jax.proofs.enclosures import (
    Enclosure,
    choose,
    library,
)
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.events import (
    Strike,
    Watch,
    dense,
    enclose_strike,
    guess_strike,
    measure,
    watch_step,
)
from walker_jax.proofs.flows import ORDER, Flow, flow_at, map_enclosures, numbers_of, step_from

GOING, STRIDE, FALL, UNDECIDED = 0, 1, 2, 3
"""Verdicts; the first within a stride only."""
MOST_STEPS = 80
WIDEST = 1.0
"""A box wider than this is given up."""
LEAST_FACTOR = 1 / 64
TOLERANCE = 1e-10
QUARTER_PI = 0.7853981633974482
"""Below pi / 4."""


class VerifiedStride(NamedTuple):
    """Where a box of starts leads."""

    verdict: Any
    state: tuple
    """Enclosures of the next coordinates; they hold where the verdict is `STRIDE`."""
    tangents: tuple
    """Their derivatives along each tangent of the start."""
    steps: Any


class Going(NamedTuple):
    """A stride on its way."""

    flow: Flow
    factor: Any
    watch: Watch
    verdict: Any
    landing: tuple
    steps: Any


def begin(walker, x: tuple, tangents: tuple) -> Flow:
    """The full state just after heel strike, and its tangents."""
    along = lambda tangent: jax.jvp(walker.lift, (x,), (tangent,))[1]
    return Flow(walker.lift(x), tuple(map(along, tangents)))


def land(walker, flow: Flow) -> tuple:
    """How fast the trailing foot lifts, the next point of the section, and its derivatives.

    A tangent dy changes the time of the strike, g = 0, by dt = -dg / (dg/dt), and so the state
    there by dy + f dt.
    """
    value = walker.modes()[-1].guards[-1].value
    rates = walker.vector_field(flow.state)
    rate = jax.jvp(value, (flow.state,), (rates,))[1]

    def after(state):
        (_, lift), struck = walker.impact(state)
        following = walker.exchange_legs(struck)
        return lift, tuple(getattr(following, name) for name in walker.section)

    def along(tangent):
        delay = -jax.jvp(value, (flow.state,), (tangent,))[1] / rate
        moved = jax.tree.map(lambda dy, f: dy + f * delay, tangent, rates)
        return jax.jvp(after, (flow.state,), (moved,))[1][1]

    return *after(flow.state), tuple(map(along, flow.tangents))


def is_feasible(x: tuple):
    """Whether all points of an enclosure are starts of a stride."""
    theta, thetadot = x
    return (theta.lower > 0) & (theta.upper < QUARTER_PI) & (thetadot.upper < 0)


def verify_stride(
    walker,
    x: tuple[Enclosure, Enclosure],
    tangents: tuple = (),
    *,
    order: int = ORDER,
    tolerance: float = TOLERANCE,
    align: Callable[[Any], Any] = lambda state: state,
) -> VerifiedStride:
    """The next states of all starts of a box.

    **Arguments:**

    - `walker`: with enclosures as its parameters.
    - `x`: enclosures of theta (rad) and thetadot, of JAX or NumPy arrays.
    - `tangents`: directions, of two enclosures each, in which the next state is differentiated over
      the whole box.
    - `order`, `tolerance`: of the series, and of the terms that are left out, not proved.
    - `align`: from a state at the start of a step, without tangents, to one that encloses it.
    """
    x = dense(x[0]), dense(x[1])
    flow = map_enclosures(dense_like(x[0]), evaluate(begin, walker, x, tangents))
    number = x[0].middle
    yes = number == number
    parameters = map_enclosures(lambda one: one.range(), walker)
    landing = evaluate(land, walker, flow)
    start = Going(
        flow,
        0.0 * number + 1.0,
        Watch(yes, ~yes, yes),
        whole(choose(is_feasible(x), GOING, UNDECIDED)),
        map_enclosures(dense_like(x[0]), landing[1:]),
        whole(0 * number),
    )
    advance = partial(advance_stride, walker, parameters, (order, tolerance, align))
    if library(number) is jnp:
        last = lax.while_loop(lambda one: one.verdict == GOING, advance, start)
    else:
        last = start
        with np.errstate(all="ignore"):
            while np.any(last.verdict == GOING):
                step = partial(choose, last.verdict == GOING)
                last = jax.tree.map(step, advance(last), last)
    state, tangents = last.landing
    return VerifiedStride(last.verdict, state, tangents, last.steps)


def whole(value):
    return library(value).asarray(value, "int32")


def dense_like(model: Enclosure):
    def fill(one: Enclosure) -> Enclosure:
        zero = 0.0 * model.middle
        terms = [zero if t is None else t + zero for t in one.terms]
        return Enclosure(terms, one.radius + zero, one.space)

    return fill


def advance_stride(walker, parameters, method: tuple, now: Going) -> Going:
    """One more step, to the strike if it is in it."""
    order, tolerance, align = method
    begun = now.flow._replace(state=align(now.flow.state))
    step = step_from(walker, begun, now.factor, order=order, tolerance=tolerance)
    series, last, guess, soon = guess_strike(walker, step)
    strike = enclose_strike(walker, step, series, guess)
    length = choose(soon, 0.6 * step.length, step.length)
    end = choose(last, strike.latest, length)
    watch = watch_step(parameters, step, now.watch, end)
    struck, landing = land_from(walker, parameters, strike, watch)
    flow = flow_at(step, length)
    fallen = has_fallen(parameters, flow, watch)
    wide = False
    for one in numbers_of(flow.state):
        wide = wide | ~(one.spread < WIDEST)
    verdict = choose(fallen, FALL, choose(wide, UNDECIDED, GOING))
    verdict = choose(last, choose(struck, STRIDE, UNDECIDED), verdict)
    verdict = choose(watch.no_rise, verdict, UNDECIDED)
    late = now.steps + 1 >= MOST_STEPS
    verdict = choose(late & (verdict == GOING), UNDECIDED, verdict)
    short = choose(late | (now.factor < LEAST_FACTOR), UNDECIDED, GOING)
    verdict = whole(choose(step.held, verdict, short))
    fill = dense_like(now.flow.state[0])
    keep = lambda new, old: jax.tree.map(
        lambda a, b: choose(step.held, a, b), map_enclosures(fill, new), old
    )
    watch = jax.tree.map(lambda a, b: choose(step.held, a, b), watch, now.watch)
    factor = choose(step.held, choose(now.factor < 1, now.factor * 2, 1.0), now.factor / 2)
    return Going(
        keep(flow, now.flow),
        factor,
        watch,
        verdict,
        keep(landing, now.landing),
        now.steps + 1,
    )


def land_from(walker, parameters, strike: Strike, watch: Watch) -> tuple[Any, tuple]:
    """Whether a strike is admitted and leads to a stride, and the point of the section there."""
    lift, x, tangents = evaluate(land, walker, strike.flow)
    there = map_enclosures(lambda one: one.range(), strike.flow.state)
    proved = strike.proved & watch.no_rise & watch.clear & (lift.lower > 0) & is_feasible(x)
    for one in evaluate(measure, parameters, there).admits:
        proved = proved & (one.lower > 0)
    return proved, (x, tangents)


def has_fallen(parameters, flow: Flow, watch: Watch):
    """Whether all of a box has fallen: a guard has risen, and there was no strike before."""
    found = evaluate(measure, parameters, map_enclosures(lambda one: one.range(), flow.state))
    fallen = False
    for one in found.falls:
        fallen = fallen | (one.lower > 0)
    return fallen & watch.no_rise & ~watch.rising
