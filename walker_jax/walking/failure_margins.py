"""By how much a stride misses each way to fail.

A margin is a smooth function of start and parameters that is positive where the walker passes, and
zero on the boundary to a failure. The first failure on a stride's way decides its outcome: its
margin is negative; those of what was passed before are positive; what never came up has NaN.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.conditions import least_between, value_and_rate
from walker_jax.integrators.roots import (
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
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walking.falls import (
    distance_to_fall,
    fall_of,
    falls_begin,
    has_fallen,
    has_own_falls,
    makes_step,
    missing_slope,
)
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.margins_in_space import margins_in_space
from walker_jax.walking.modes import conditions_of, equations
from walker_jax.walking.outcomes import Outcome, Stride
from walker_jax.walking.phase_margins import (
    WAYS,
    Least,
    PhaseMargins,
    follow_phase_margins,
    least_speed,
    least_with,
    missing_speed,
    stop_within,
    upcrossing,
    violated_in,
    with_own_failures,
)
from walker_jax.walking.phases import Arrival
from walker_jax.walking.stepping import begin_stride, during_stride, end_stride, on_section, prepare


class Margins(NamedTuple):
    """A stride, and by how much it misses each way to fail."""

    stride: Stride
    backward: Float[Array, "*cells"]
    """Speed where the stance leg is slowest, which uphill may be at heel strike, as thetadot^2 / 2;
    where it stops, minus what is missing, (thetaddot / rate)^2 / 2 with the rate of toppling. Of an
    inverted pendulum, both are the energy above that at the top, thetadot^2 / 2 + cos(theta -
    slope) - 1. Where it stops past theta = 0, uphill, minus |h| there, or what the foot lacked
    to strike before, if that is less. After an impact that turns the next stance leg back, minus
    thetadot^2 / 2 of that."""
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
    landing: Float[Array, "*cells"]
    """Least height of a foot that must not come down, in front while the knee is bent, and where
    the knee strikes. Where it comes down, minus its depth where it turns, or where the knee
    strikes; or minus by how much it came down in front or past theta = 0, where that is less."""
    buckling: Float[Array, "*cells"]
    """The least moment that presses the stance knee on its stop, up to heel strike."""
    scuffing: Float[Array, "*cells"]
    """The least height of the bent leg's foot, up to heel strike. In space, that at which the swing
    disc turns upwards; where it scuffs, minus the angle that the legs lacked to pass each other, if
    that is less."""
    sideways: Float[Array, "*cells"]
    """In space: the least distance of the lean from its limits. In a fall in space, to any side:
    minus the height of the swing disc then; or of the misses of a heel strike the nearest: minus
    the angle that the legs lacked where the disc touched, or minus its depth where it turned."""


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
    by = jnp.full_like(found.backward, jnp.nan)
    for outcome, name in WAYS.items():
        by = jnp.where(found.stride.outcome == outcome, getattr(found, name), by)
    return by


class MarginState(NamedTuple):
    """An unfinished stride, with its margins so far."""

    state: State
    time: Scalar
    verdict: Array
    count: Array
    backward: Scalar
    """Infinite until the stance leg has been slowest."""
    late: Scalar
    """Where the stance leg stops past theta = 0, uphill: -|h|, or by how much the foot missed the
    ground before, which is less; minus infinity if it does not."""
    dip: Scalar
    """How far the foot has come past the contact since it last came up; minus infinity if not."""
    missed: Scalar
    """The forward margin if the walker falls from here; minus infinity if there was no chance."""
    slowest: Scalar
    """-h where the foot rose most slowly; minus infinity if it has not."""
    otherwise: Scalar
    """-h where the legs first passed each other, or the stance leg was down before that; minus
    infinity if neither has been."""
    grazing: Scalar
    """How far below the contact the foot would come at heel strike, if it came up again within
    the step of the integration; infinite if not."""
    fallen: Scalar
    """Of a fall of one's own: minus |h| of a foot that is ahead, what the foot missed before, or
    `missing_slope`, whichever is nearest to zero; infinite if there is none."""
    least: Least
    """Of the conditions, the contact force the first, by outcomes."""
    arrival: State
    """That at heel strike, if there is one."""
    below: Array
    """Whether h < 0: decided once for the end of a step and the start of the next."""


@by_kernel
def follow_margins(
    walker: Walker, x: Float[Array, " coordinates"], tolerance: Float[Array, ""]
) -> Margins:
    if isinstance(walker, SpatialWalker):
        in_space = margins_in_space(walker, x, tolerance)
        return Margins(in_space[0], **in_space[1])
    walker = during_stride(walker, x)
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    field = equations(walker)
    order = series_order(start)
    rate = with_fast_sincos(toppling_rate)(walker)
    before = first_margins(walker, start, verdict, tolerance)
    watched = conditions_of(walker)
    if walker.force_least_at_ends:
        del watched[Outcome.RUNNING]

    def undecided(now: MarginState):
        going = (now.verdict == Outcome.UNDECIDED) & (now.count < MAX_STEPS)
        return going & jnp.isfinite(now.time)

    def advance(now: MarginState) -> MarginState:
        others = walker.contact, *falls_begin(walker)
        series, length = taylor_step(field, now.state, order, tolerance, *others)
        after = evaluate_series(series, length)
        h = function_series(walker.contact, series)
        jet = polynomial_jet(h)
        turn, top = interior_minimum(jet, length), interior_minimum(negate(jet), length)
        below = with_fast_sincos(walker.contact)(after) < 0
        ends_below = jnp.where(top.exists, jet(top.time)[0] < 0, below)
        until = jnp.where(top.exists, top.time, length)
        crossed, when = first_upcrossing(jet, until, (now.below, ends_below))
        when = differentiable_zero(h, jnp.where(crossed, when, length))
        arrival = evaluate_series(series, when)
        strikes = crossed & with_fast_sincos(makes_step)(walker, arrival)
        fall = fall_of(walker, after)
        end = length
        if not (walker.inverted_pendulum or has_own_falls(walker)):
            speed = polynomial_jet(derivative_of(series.theta))
            stops = stop_within(speed, jnp.where(strikes, when, length))
            strikes, fall = strikes & ~stops.exists, jnp.where(stops.exists, Outcome.BACKWARD, fall)
            end = jnp.where(stops.exists, stops.time, length)
        if on_section(walker, x):
            past = ~below & with_fast_sincos(lambda w, s: w.past_contact(s))(walker, after)
            fall = jnp.where(past & (fall == Outcome.UNDECIDED), Outcome.FORWARD, fall)
        verdict = jnp.where(strikes, Outcome.STRIDE, fall).astype(jnp.int8)

        # the foot
        depth = -evaluate_polynomial(h, turn.time)
        is_ahead = evaluate_polynomial(series.phi, turn.time) < 0
        dip = jnp.where(turn.exists & (depth > 0), jnp.maximum(now.dip, depth), now.dip)
        missed = jnp.where(
            turn.exists & (depth <= 0) & is_ahead, jnp.maximum(now.missed, depth), now.missed
        )
        scuffs = crossed & ~with_fast_sincos(lambda w, s: w.is_ahead(s) > 0)(walker, arrival)
        missed = jnp.where(scuffs, jnp.maximum(missed, walker.is_ahead(arrival)), missed)
        short = -evaluate_polynomial(h, top.time)  # the foot comes down so far, and up again
        at_top = evaluate_series(series, top.time)
        hovers = top.exists & (short > 0) & with_fast_sincos(makes_step)(walker, at_top)
        missed = jnp.where(hovers, jnp.maximum(missed, -short), missed)
        grazing = jnp.where(strikes & top.exists, -short, now.grazing)
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
        until = jnp.where(strikes, when, length)
        backward = least_speed(series.theta, length, until, now.backward)
        deceleration = derivative_of(derivative_of(series.theta))
        slowing = strikes & (evaluate_polynomial(deceleration, when) > 0)
        left = jnp.minimum(backward, arrival.thetadot**2 / 2)
        backward = jnp.where(slowing, left, backward)
        stop, missing = missing_speed(series.theta, end, rate)
        turned = verdict == Outcome.BACKWARD
        uphill = turned & (evaluate_polynomial(series.theta, stop) < 0)
        late = jnp.maximum(-jnp.abs(evaluate_polynomial(h, stop)), missed)
        late = jnp.where(uphill, late, now.late)
        backward = jnp.where(turned, jnp.maximum(missing, late), backward)
        fallen = now.fallen
        if has_own_falls(walker):
            coming = jnp.where(
                walker.is_ahead(after) > 0, -jnp.abs(evaluate_polynomial(h, length)), -jnp.inf
            )
            short = jnp.maximum(missing_slope(walker, series, length, rate), missed)
            short = jnp.maximum(short, coming)
            fallen = jnp.where(has_fallen(walker, after), short, fallen)

        # the force
        least = dict(now.least)
        other = jax.tree.map(lambda a, b: jnp.where(strikes, a, b), arrival, after)
        for outcome, condition in watched.items():
            both = partial(value_and_rate, condition, walker.vector_field)
            between = lambda t: evaluate_series(series, t)
            at, value = least_between(both, now.state, other, between, until, resolution=1e-9)
            there = with_fast_sincos(condition)(evaluate_series(series, at))
            value = jnp.where(jnp.isfinite(value), there, value)
            least[outcome] = jnp.minimum(least[outcome], value)
        return MarginState(
            after,
            now.time + jnp.where(strikes, when, length),
            verdict,
            now.count + 1,
            backward,
            late,
            jnp.where(scuffs, -jnp.inf, dip),
            missed,
            slowest,
            otherwise,
            grazing,
            fallen,
            least,
            arrival,
            below,
        )

    infinite = jnp.full_like(rate, jnp.inf)
    first = MarginState(
        state=before.state,
        time=before.time,
        verdict=before.verdict,
        count=jnp.asarray(0),
        backward=before.backward,
        late=-infinite,
        dip=-infinite,
        missed=-infinite,
        slowest=-infinite,
        otherwise=-infinite,
        grazing=infinite,
        fallen=before.fallen,
        least=before.least,
        arrival=before.state,
        below=with_fast_sincos(walker.contact)(before.state) < 0,
    )
    last = lax.while_loop(undecided, advance, first)
    violated = violated_in(walker, last.least, last.arrival)
    end = Arrival(last.arrival, last.time, last.verdict, violated)
    stride = with_fast_sincos(end_stride)(walker, end)
    found = with_fast_sincos(margins_from)(walker, before, last, stride.outcome)
    return Margins(stride, **found)


def first_margins(walker: Walker, start: Any, verdict: Array, tolerance: Scalar) -> PhaseMargins:
    """The margins of all phases before the swing; those at the start, where there is none."""
    if walker.phases():
        return follow_phase_margins(walker, start, verdict, tolerance)
    infinite = jnp.full_like(start.theta, jnp.inf)
    force = with_fast_sincos(lambda s: walker.contact_force(s)[1])(start)
    least = {int(Outcome.RUNNING): force} | least_with(walker, start, {}, jnp.asarray(True))
    stopped = jnp.where(verdict == Outcome.BACKWARD, -(start.thetadot**2) / 2, infinite)
    fallen = -distance_to_fall(walker, start)
    return PhaseMargins(
        start, jnp.zeros_like(infinite), verdict, stopped, -infinite, infinite, fallen, least
    )


def margins_from(
    walker: Walker, before: PhaseMargins, last: MarginState, outcome: Array
) -> dict[str, Scalar]:
    """The margins, by name, from what was seen before the swing and in it."""
    (_, lift), after = walker.impact(last.arrival)
    exchanged = walker.exchange_legs(after)
    following = exchanged.thetadot
    struck = last.verdict == Outcome.STRIDE
    strode, none = outcome == Outcome.STRIDE, jnp.full_like(lift, jnp.nan)
    start = before.state

    if walker.inverted_pendulum and not walker.phases() and not has_own_falls(walker):
        slope = vars(walker)["slope"]
        energy = start.thetadot**2 / 2 + jnp.cos(start.theta - slope) - 1
        energy = jnp.where(struck & (last.arrival.theta > slope), last.backward, energy)
        backward = jnp.where(start.theta > slope, jnp.maximum(energy, last.late), none)
    else:
        backward = jnp.where(strode, jnp.minimum(last.backward, following**2 / 2), last.backward)
        backward = jnp.where(jnp.isfinite(backward), backward, none)
    turned_back = struck & (outcome == Outcome.BACKWARD)
    backward = jnp.where(turned_back, -(following**2) / 2, backward)
    backward = jnp.where(before.verdict == Outcome.BACKWARD, before.backward, backward)

    ahead = jnp.minimum(walker.is_ahead(last.arrival), last.grazing)
    passed = jnp.where(last.dip > 0, jnp.minimum(last.dip, ahead), ahead)
    otherwise = jnp.where(last.slowest > -jnp.inf, last.slowest, last.otherwise)
    missed = jnp.where(last.missed > -jnp.inf, last.missed, -jnp.abs(otherwise))
    missed = jnp.where(before.verdict == Outcome.FORWARD, before.forward, missed)
    forward = jnp.where(struck, passed, jnp.where(outcome == Outcome.FORWARD, missed, none))

    pulled = before.verdict == Outcome.RUNNING
    at_strike = {key: each(last.arrival) for key, each in conditions_of(walker).items()}

    def least(of: Outcome) -> Scalar:
        """The least value of a condition, where it counts."""
        if of not in last.least:
            return none
        value = jnp.minimum(last.least[of], at_strike.get(of, jnp.inf))
        return jnp.where(struck & jnp.isfinite(value), value, none)

    running = jnp.where(pulled, before.least[Outcome.RUNNING], least(Outcome.RUNNING))
    landed = struck & (outcome != Outcome.RUNNING)
    stopping = jnp.where(landed, lift, none)
    landing = jnp.where(jnp.isfinite(before.landing), before.landing, none)

    began = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED)
    keep = lambda margin, came: jnp.where(began & came, margin, none)
    found = {
        "backward": keep(backward, ~pulled),
        "forward": keep(forward, ~pulled),
        "running": keep(running, True),
        "stopping": keep(stopping, True),
        "landing": keep(landing, True),
        "buckling": keep(least(Outcome.BUCKLED), True),
        "scuffing": keep(least(Outcome.SCUFFED), True),
        "sideways": none,
    }
    values = {of: least(Outcome(of)) for of in last.least}
    return with_own_failures(walker, found, exchanged, struck, outcome, last.fallen, values)
