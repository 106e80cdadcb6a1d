"""Verified strides: from an enclosure of starts to one of all next states, or a proved fall.

The section is that of walkers on massless point feet: theta and thetadot just after heel strike. A
box of starts consists of enclosures of both coordinates, which are polynomials in as many variables
as the box has sides. The verdict on a box is that all starts make a stride, and the next states are
enclosed; that all starts fall; or that neither is proved.
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
    array_module,
    choose,
)
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.events import (
    Strike,
    Watch,
    dense,
    dense_like,
    enclose_strike,
    fallen_by,
    guess_strike,
    measure_ranges,
    watch_step,
)
from walker_jax.proofs.flows import (
    ORDER,
    Flow,
    VerifiedStep,
    enclosures_in,
    flow_at,
    map_enclosures,
    ranges_of,
    take_step,
)

GOING, STRIDE, FALL, UNDECIDED = 0, 1, 2, 3
"""Verdicts; `GOING` occurs only within a stride."""
MOST_STEPS = 80
WIDEST = 1.0
"""Limit of the spread of each number of the state; a wider box is given up."""
LEAST_FACTOR = 1 / 64
"""Factor on the suggested step below which a box is given up."""
TOLERANCE = 1e-10
QUARTER_PI = 0.7853981633974482
"""Lower bound on pi / 4."""


class VerifiedStride(NamedTuple):
    """Result of a stride of a box of starts."""

    verdict: Any
    state: tuple
    """Enclosures of the next coordinates, valid if the verdict is `STRIDE`."""
    tangents: tuple
    """Their derivatives along each tangent of the start."""
    steps: Any
    """Number of integration steps."""


class PartialStride(NamedTuple):
    """Stride in progress."""

    flow: Flow
    factor: Any
    """Length of the next step, relative to the suggested one."""
    watch: Watch
    verdict: Any
    landing: tuple
    steps: Any


def start_flow(walker, x: tuple, tangents: tuple) -> Flow:
    """Return the full state just after heel strike, and its tangents."""
    along = lambda tangent: jax.jvp(walker.lift, (x,), (tangent,))[1]
    return Flow(walker.lift(x), tuple(map(along, tangents)))


def land(walker, flow: Flow) -> tuple:
    """Map the state at heel strike to the section.

    A tangent dy delays the strike, where g(y) = 0, by dt = -(dg/dy) dy / (dg/dt). So it changes the
    state at the strike by dy + f dt, for the vector field f.

    **Returns** the speed at which the trailing foot lifts, the next point of the section, and its
    derivatives along the tangents.
    """
    value = walker.modes()["swing"].guards[-1].value
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
    """Return whether all points of an enclosure are feasible starts of a stride."""
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
    """Enclose the next states of all starts of a box.

    **Arguments:**

    - `walker`: has enclosures as its parameters.
    - `x`: enclosures of theta (rad) and thetadot, of JAX or NumPy arrays.
    - `tangents`: directions, of two enclosures each; the next state is differentiated along them
      over the whole box.
    - `order`, `tolerance`: the order of the remainder, and the size of terms that sets the length
      of steps; no proof rests on the latter.
    - `align`: takes the state at the start of a step, without tangents, and returns one that
      encloses it.
    """
    x = dense(x[0]), dense(x[1])
    flow = map_enclosures(dense_like(x[0]), evaluate(start_flow, walker, x, tangents))
    number = x[0].midpoint
    yes = number == number
    parameters = ranges_of(walker)
    landing = evaluate(land, walker, flow)
    start = PartialStride(
        flow,
        0.0 * number + 1.0,
        Watch(yes, ~yes, yes),
        as_int32(choose(is_feasible(x), GOING, UNDECIDED)),
        map_enclosures(dense_like(x[0]), landing[1:]),
        as_int32(0 * number),
    )
    advance = partial(advance_stride, walker, parameters, (order, tolerance, align))
    if array_module(number) is jnp:
        last = lax.while_loop(lambda one: one.verdict == GOING, advance, start)
    else:
        last = start
        with np.errstate(all="ignore"):
            while np.any(last.verdict == GOING):
                step = partial(choose, last.verdict == GOING)
                last = jax.tree.map(step, advance(last), last)
    state, tangents = last.landing
    return VerifiedStride(last.verdict, state, tangents, last.steps)


def as_int32(value):
    return array_module(value).asarray(value, "int32")


def advance_stride(walker, parameters, method: tuple, now: PartialStride) -> PartialStride:
    """Take one more step, or go to the strike if the step holds it."""
    order, tolerance, align = method
    begun = now.flow._replace(state=align(now.flow.state))
    step = take_step(walker, begun, now.factor, order=order, tolerance=tolerance)
    series, last, guess, soon = guess_strike(walker, step)
    strike = enclose_strike(walker, step, series, guess)
    length = choose(soon, 0.6 * step.length, step.length)
    end = choose(last, strike.latest, length)
    watch = watch_step(parameters, step, now.watch, end)
    struck, landing = land_from(walker, parameters, strike, watch)
    flow = flow_at(step, length)
    # a guard has risen, with no strike before
    fallen = fallen_by(measure_ranges(parameters, flow)) & ~watch.rising
    wide = is_wide(flow)
    verdict = choose(fallen, FALL, choose(wide, UNDECIDED, GOING))
    verdict = choose(last, choose(struck, STRIDE, UNDECIDED), verdict)
    verdict = choose(watch.no_strike, verdict, UNDECIDED)
    late = now.steps + 1 >= MOST_STEPS
    verdict = choose(late & (verdict == GOING), UNDECIDED, verdict)
    short = choose(late | (now.factor < LEAST_FACTOR), UNDECIDED, GOING)
    verdict = as_int32(choose(step.proved, verdict, short))
    fill = dense_like(now.flow.state[0])
    keep = lambda new, old: jax.tree.map(
        lambda a, b: choose(step.proved, a, b), map_enclosures(fill, new), old
    )
    watch = jax.tree.map(lambda a, b: choose(step.proved, a, b), watch, now.watch)
    factor = next_factor(now.factor, step)
    steps = now.steps + 1
    return PartialStride(
        keep(flow, now.flow), factor, watch, verdict, keep(landing, now.landing), steps
    )


def is_wide(flow: Flow) -> Any:
    """Return whether a number of the state has too large a spread to go on."""
    wide = False
    for one in enclosures_in(flow.state):
        wide = wide | ~(one.spread < WIDEST)
    return wide


def next_factor(factor, step: VerifiedStep) -> Any:
    """Return the factor on the next step: half of it after one that is not proved."""
    return choose(step.proved, choose(factor < 1, factor * 2, 1.0), factor / 2)


def land_from(walker, parameters, strike: Strike, watch: Watch) -> tuple[Any, tuple]:
    """Return whether a strike provably ends a stride, and the enclosed landing.

    It does so if no strike and no fall came before, if all conditions held until then, and if it is
    admitted, lifts the trailing foot and leads to a feasible start.
    """
    lift, x, tangents = evaluate(land, walker, strike.flow)
    proved = strike.proved & watch.no_strike & watch.clear & (lift.lower > 0) & is_feasible(x)
    for one in measure_ranges(parameters, strike.flow).admits:
        proved = proved & (one.lower > 0)
    return proved, (x, tangents)
