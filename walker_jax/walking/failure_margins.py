"""By how much a stride misses each way to fail.

A margin is a smooth function of start and parameters that is positive where the walker passes, and
zero on the boundary to a failure. The first failure on a stride's way decides its outcome: its
margin is negative; those of what was passed before are positive; what never came up has NaN.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.checks import refuses_tracers
from walker_jax.integrators.roots import (
    Instant,
    bracketed_newton,
    derivative_of,
    differentiable_zero,
    first_upcrossing,
    interior_minimum,
    negate,
    polynomial_jet,
)
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.solvers import (
    MAX_STEPS,
    Real,
    evaluate_series,
    series_order,
    taylor_step,
)
from walker_jax.integrators.taylor import function_series, with_fast_sincos
from walker_jax.kernels import by_kernel
from walker_jax.walkers.model import Scalar, State, Walker, toppling_rate
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.outcomes import Outcome, Stride
from walker_jax.walking.stepping import begin_stride, end_stride, on_section, prepare
from walker_jax.walking.swing import equations, minimum_of, normal_force


class Margins(NamedTuple):
    """A stride, and by how much it misses each way to fail."""

    stride: Stride
    backward: Float[Array, "*cells"]
    """Speed where the stance leg is slowest, as thetadot^2 / 2; where it stops, minus what is
    missing, (thetaddot / rate)^2 / 2 with the rate of toppling. Of an inverted pendulum, both
    are the energy above that at the top, thetadot^2 / 2 + cos(theta - slope) - 1. After an impact
    that turns the next stance leg back, minus thetadot^2 / 2 of that."""
    forward: Float[Array, "*cells"]
    """How far the swing leg passes the contact, -h at the turning point of its swing; or how far
    ahead of the stance foot it comes down, -theta at heel strike, where that is less. In a fall,
    the greatest of these: minus by how much the foot is too low where it turns, or minus the theta
    at which it scuffs. If it does neither, -h where the foot is ahead and rises most slowly, or
    where the legs pass each other, or where the stance leg is down, whichever there is first in
    this order."""
    running: Float[Array, "*cells"]
    """The least contact force Q_v up to heel strike; or that at the start, where it is negative."""
    stopping: Float[Array, "*cells"]
    """Velocity v of the trailing foot after the impact."""


def margins(
    walker: Walker, x: Float[ArrayLike, " coordinates"], *, tolerance: Real | None = None
) -> Margins:
    """One stride, as `stride` makes it, and its margins.

    Arguments and errors are those of `stride`. Derivatives of the first order are right.
    Margins are smooth except where the instant that determines them jumps.
    """
    return follow_margins(*prepare(walker, x, tolerance))


@refuses_tracers("within them use jax.vmap(lambda x: wj.margins(walker, x))(xs)")
def margins_of_many(
    walker: Walker,
    xs: Float[ArrayLike, "n coordinates"],
    *,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Margins:
    """`margins` for each of n starts, and one walker or n, as in `strides`; NumPy arrays."""
    return for_each_start(follow_margins, walker, xs, tolerance, progress)


def failure_margin(found: Margins) -> Scalar:
    """The margin of the failure that ended a stride, NaN for none; no batch axis."""
    ways = {
        Outcome.BACKWARD: found.backward,
        Outcome.FORWARD: found.forward,
        Outcome.RUNNING: found.running,
        Outcome.STOPPED: found.stopping,
    }
    by = jnp.full_like(found.backward, jnp.nan)
    for outcome, margin in ways.items():
        by = jnp.where(found.stride.outcome == outcome, margin, by)
    return by


class MarginState(NamedTuple):
    """An unfinished stride, with its margins so far."""

    state: State
    time: Scalar
    verdict: Array
    count: Array
    backward: Scalar
    """Infinite until the stance leg has been slowest."""
    dip: Scalar
    """How far the foot has come past the contact since it last came up; minus infinity if not."""
    missed: Scalar
    """The forward margin if the walker falls from here; minus infinity if there was no chance."""
    slowest: Scalar
    """-h where the foot rose most slowly; minus infinity if it has not."""
    otherwise: Scalar
    """-h where the legs first passed each other, or the stance leg was down before that; minus
    infinity if neither has been."""
    running: Scalar
    arrival: State
    """That at heel strike, if there is one."""
    below: Array
    """Whether h < 0: decided once for the end of a step and the start of the next."""


@by_kernel
def follow_margins(
    walker: Walker, x: Float[Array, " coordinates"], tolerance: Float[Array, ""]
) -> Margins:
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    field = equations(walker)
    order = series_order(start)
    rate = with_fast_sincos(toppling_rate)(walker)

    def contact_force(state: State) -> Scalar:
        return with_fast_sincos(lambda walker, state: walker.contact_force(state)[1])(walker, state)

    def undecided(now: MarginState):
        going = (now.verdict == Outcome.UNDECIDED) & (now.count < MAX_STEPS)
        return going & jnp.isfinite(now.time)

    def advance(now: MarginState) -> MarginState:
        series, length = taylor_step(field, now.state, order, tolerance, walker.contact)
        after = evaluate_series(series, length)
        h = function_series(walker.contact, series)
        jet = polynomial_jet(h)
        turn = interior_minimum(jet, length)
        below = with_fast_sincos(is_below)(walker, after)
        crossed, when = first_upcrossing(jet, length, (now.below, below))
        when = differentiable_zero(h, when)
        arrival = evaluate_series(series, when)
        ahead = (arrival.theta < 0) & (arrival.theta > -np.pi / 2) & (arrival.thetadot < 0)
        strikes = crossed & ahead
        stopped, down = after.thetadot >= 0, after.theta <= -np.pi / 2
        fallen = stopped | down
        if on_section(walker, x):
            fallen |= ~below & with_fast_sincos(lambda w, s: w.past_contact(s))(walker, after)
        verdict = jnp.where(stopped, Outcome.BACKWARD, Outcome.FORWARD)
        verdict = jnp.where(fallen, verdict, Outcome.UNDECIDED)
        verdict = jnp.where(strikes, Outcome.STRIDE, verdict).astype(jnp.int8)

        # the foot
        depth = -evaluate_polynomial(h, turn.time)
        is_ahead = evaluate_polynomial(series.phi, turn.time) < 0
        dip = jnp.where(turn.exists & (depth > 0), jnp.maximum(now.dip, depth), now.dip)
        missed = jnp.where(
            turn.exists & (depth <= 0) & is_ahead, jnp.maximum(now.missed, depth), now.missed
        )
        scuffs = crossed & (arrival.theta >= 0)
        missed = jnp.where(scuffs, jnp.maximum(missed, -arrival.theta), missed)
        hdot = derivative_of(h)
        slow = interior_minimum(polynomial_jet(hdot), length)
        when_slow = differentiable_zero(
            derivative_of(hdot), slow.time
        )  # where h itself goes on changing
        rising = slow.exists & (evaluate_polynomial(hdot, when_slow) > 0)
        rising &= evaluate_polynomial(series.phi, when_slow) < 0
        slowest = jnp.maximum(now.slowest, -evaluate_polynomial(h, when_slow))
        slowest = jnp.where(rising, slowest, now.slowest)
        passes, passing = upcrossing([-c for c in series.phi], length)
        lands, landing = upcrossing(
            [-np.pi / 2 - series.theta[0], *(-c for c in series.theta[1:])], length
        )
        unknown = now.otherwise == -jnp.inf
        otherwise = jnp.where(lands & unknown, -evaluate_polynomial(h, landing), now.otherwise)
        otherwise = jnp.where(passes & unknown, -evaluate_polynomial(h, passing), otherwise)

        # the stance leg
        speed = derivative_of(series.theta)
        slowing = interior_minimum(negate(polynomial_jet(speed)), length)
        until = jnp.where(strikes, when, length)
        counts = slowing.exists & (slowing.time < until)
        left = evaluate_polynomial(speed, slowing.time) ** 2 / 2
        backward = jnp.where(counts, jnp.minimum(now.backward, left), now.backward)
        _, stop = upcrossing(speed, length)
        missing = -((evaluate_polynomial(derivative_of(speed), stop) / rate) ** 2) / 2
        backward = jnp.where(verdict == Outcome.BACKWARD, missing, backward)

        # the force
        running = now.running
        if not walker.force_least_at_ends:
            other = jax.tree.map(lambda a, b: jnp.where(strikes, a, b), arrival, after)
            at, value = minimum_of(
                normal_force,
                walker,
                now.state,
                other,
                lambda t: evaluate_series(series, t),
                until,
                resolution=1e-9,
            )
            value = jnp.where(
                jnp.isfinite(value), contact_force(evaluate_series(series, at)), value
            )
            running = jnp.minimum(running, value)
        return MarginState(
            after,
            now.time + jnp.where(strikes, when, length),
            verdict,
            now.count + 1,
            backward,
            jnp.where(scuffs, -jnp.inf, dip),
            missed,
            slowest,
            otherwise,
            running,
            arrival,
            below,
        )

    first = MarginState(
        state=start,
        time=jnp.zeros_like(rate),
        verdict=verdict,
        count=jnp.asarray(0),
        backward=jnp.full_like(rate, jnp.inf),
        dip=jnp.full_like(rate, -jnp.inf),
        missed=jnp.full_like(rate, -jnp.inf),
        slowest=jnp.full_like(rate, -jnp.inf),
        otherwise=jnp.full_like(rate, -jnp.inf),
        running=contact_force(start),
        arrival=start,
        below=with_fast_sincos(is_below)(walker, start),
    )
    last = lax.while_loop(undecided, advance, first)
    stride = with_fast_sincos(end_stride)(
        walker, last.arrival, last.time, last.verdict, {int(Outcome.RUNNING): last.running < 0}
    )
    return Margins(stride, *with_fast_sincos(margins_from)(walker, first, last, stride.outcome))


def is_below(walker: Walker, state: State) -> Bool[Array, ""]:
    return walker.contact(state) < 0


def margins_from(
    walker: Walker, first: MarginState, last: MarginState, outcome: Array
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """The margins, in their order, from what was seen during a stride."""
    (_, lift), after = walker.impact(last.arrival)
    following = walker.exchange_legs(after).thetadot
    struck = last.verdict == Outcome.STRIDE
    strode, none = outcome == Outcome.STRIDE, jnp.full_like(lift, jnp.nan)
    start = first.state

    if walker.inverted_pendulum:
        slope = vars(walker)["slope"]
        energy = start.thetadot**2 / 2 + jnp.cos(start.theta - slope) - 1
        backward = jnp.where(start.theta > slope, energy, none)
    else:
        backward = jnp.where(strode, jnp.minimum(last.backward, following**2 / 2), last.backward)
        backward = jnp.where(jnp.isfinite(backward), backward, none)
    turned_back = struck & (outcome == Outcome.BACKWARD)
    backward = jnp.where(turned_back, -(following**2) / 2, backward)
    backward = jnp.where(first.verdict == Outcome.BACKWARD, -(start.thetadot**2) / 2, backward)

    ahead = -last.arrival.theta
    passed = jnp.where(last.dip > 0, jnp.minimum(last.dip, ahead), ahead)
    otherwise = jnp.where(last.slowest > -jnp.inf, last.slowest, last.otherwise)
    missed = jnp.where(last.missed > -jnp.inf, last.missed, -jnp.abs(otherwise))
    forward = jnp.where(struck, passed, jnp.where(outcome == Outcome.FORWARD, missed, none))

    pulled = first.verdict == Outcome.RUNNING
    force = jnp.minimum(last.running, walker.contact_force(last.arrival)[1])
    running = jnp.where(struck, force, jnp.where(pulled, first.running, none))
    landed = struck & (outcome != Outcome.RUNNING)
    stopping = jnp.where(landed, lift, none)

    began = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED)
    keep = lambda margin, came: jnp.where(began & came, margin, none)
    return (
        keep(backward, ~pulled),
        keep(forward, ~pulled),
        keep(running, True),
        keep(stopping, True),
    )


def upcrossing(series: list[Scalar], length: Scalar) -> Instant:
    """Where a polynomial is zero that is negative at the start of a step, and not at its end."""
    fixed, length = lax.stop_gradient((series, length))
    exists = (fixed[0] < 0) & (evaluate_polynomial(fixed, length) >= 0)
    slope = derivative_of(fixed)
    jet = lambda t: (evaluate_polynomial(fixed, t), evaluate_polynomial(slope, t))
    zero = jnp.zeros_like(length)
    return Instant(
        exists,
        differentiable_zero(series, bracketed_newton(jet, zero, jnp.where(exists, length, zero))),
    )
