"""Margins of the phases of a stride before its last, the swing (`failure_margins`)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from walker_jax.hybrid.conditions import least_between, value_and_rate
from walker_jax.integrators.roots import (
    Instant,
    Jet,
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
    zero_at,
)
from walker_jax.integrators.taylor import function_series, with_fast_sincos
from walker_jax.walkers.model import Phase, Scalar, Walker, toppling_rate
from walker_jax.walking.falls import (
    distance_to_fall,
    fall_of,
    falls_begin,
    has_fallen,
    has_own_falls,
    missing_slope,
)
from walker_jax.walking.modes import conditions_of, equations, in_front, starts_under
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.phases import begin_phase, is_over

Least = dict[int, Scalar]
"""The least value of each condition, by the outcome where it is negative."""


WAYS = {
    Outcome.BACKWARD: "backward",
    Outcome.FORWARD: "forward",
    Outcome.RUNNING: "running",
    Outcome.STOPPED: "stopping",
    Outcome.BENT_KNEE: "landing",
    Outcome.BUCKLED: "buckling",
    Outcome.SCUFFED: "scuffing",
    Outcome.SIDEWAYS: "sideways",
}
"""The margin of each way to fail."""


class PhaseMargins(NamedTuple):
    """A stride up to some instant before the swing, with its margins so far."""

    state: Any
    time: Scalar
    verdict: Int[Array, ""]
    backward: Scalar
    """Least speed of the stance leg, as thetadot^2 / 2, or minus what is missing; infinite until
    the leg has been slowest."""
    forward: Scalar
    """The greatest value of the phase's event before it fell again; minus infinity if it has not.
    In a fall, that where it has not."""
    landing: Scalar
    """Least height of the foot in front; infinite until it has been least, negative where it comes
    down."""
    fallen: Scalar
    """Of a fall of one's own, as in the swing, with the event in place of h."""
    least: Least


class Unfinished(NamedTuple):
    """A phase up to some instant."""

    so_far: PhaseMargins
    arrival: Any
    """The state at the event."""
    count: Array
    below: Bool[Array, ""]
    """Whether the event is to come: decided once for a step's end and the start of the next."""
    under: Bool[Array, ""]
    """Whether the foot is below the ground, likewise."""
    landed: Bool[Array, ""]
    """Whether the foot has come down. The motion goes on until the foot turns, to measure that."""
    edge: Scalar
    """Where it came down: by how much that is in front, and past theta = 0; negative."""


def follow_phase_margins(
    walker: Walker, start: Any, verdict: Int[Array, ""], tolerance: Real
) -> PhaseMargins:
    """The margins of all phases before the swing, and the state in which it begins."""
    phases, zero = walker.phases(), zero_at(start)
    rate = with_fast_sincos(toppling_rate)(walker)
    infinite = jnp.full_like(zero, jnp.inf)
    over = is_over(phases[0], start, tolerance)
    stopped = verdict == Outcome.BACKWARD
    verdict = begin_phase(phases[0], start, zero, over, verdict)
    now = PhaseMargins(
        start,
        zero,
        verdict,
        jnp.where(stopped, -(start.thetadot**2) / 2, infinite),
        -infinite,
        infinite,
        -distance_to_fall(walker, start),
        least_with(phases[0], start, {}, ~over),
    )
    for phase, following in zip(phases, (*phases[1:], walker), strict=True):
        passed = jnp.where((now.verdict == Outcome.UNDECIDED) & over, Outcome.STRIDE, now.verdict)
        now, arrival = advance_phase(
            phase, now._replace(verdict=passed.astype(jnp.int8)), tolerance, rate
        )
        ended = now.verdict == Outcome.STRIDE
        least = least_with(phase, arrival, now.least, ended & ~over)
        state = with_fast_sincos(lambda phase, s: phase.end(s))(phase, arrival)
        speed, fall = state.thetadot**2 / 2, fall_of(walker, state)
        turned = fall == Outcome.BACKWARD
        backward = jnp.where(turned, -speed, jnp.minimum(now.backward, speed))
        verdict = jnp.where(ended, fall, now.verdict)
        over = jnp.asarray(False)
        if isinstance(following, Phase):
            over = is_over(following, state, tolerance)
        verdict = begin_phase(following, state, now.time, over, verdict)
        now = now._replace(
            state=state,
            verdict=verdict,
            backward=jnp.where(ended, backward, now.backward),
            fallen=jnp.where(ended, -distance_to_fall(walker, state), now.fallen),
            least=least_with(following, state, least, ended & ~over),
        )
    return now


def stop_within(speed: Jet, until: Scalar) -> Instant:
    """Where the stance leg is slowest before a time of a step, if it stands or goes back then."""
    slowest = interior_minimum(negate(speed), until)
    return Instant(slowest.exists & (speed(slowest.time)[0] >= 0), slowest.time)


def least_with(phase: Phase | Walker, state: Any, least: Least, counts: Bool[Array, ""]) -> Least:
    """The least values of conditions, those in a state among them where that counts."""
    found = dict(least)
    for outcome, condition in conditions_of(phase).items():
        value = with_fast_sincos(condition)(state)
        known = found.get(outcome, jnp.full_like(value, jnp.inf))
        found[outcome] = jnp.where(counts, jnp.minimum(known, value), known)
    return {outcome: found[outcome] for outcome in sorted(found)}


def violated_in(walker: Walker, least: Least, arrival: Any) -> dict[int, Bool[Array, ""]]:
    """Which conditions were violated, by their least values, and those at heel strike."""
    at_strike = least_with(walker, arrival, least, jnp.asarray(True))
    return {outcome: value < 0 for outcome, value in at_strike.items()}


def advance_phase(
    phase: Phase, begun: PhaseMargins, tolerance: Real, rate: Scalar
) -> tuple[PhaseMargins, Any]:
    """A phase until its event (`STRIDE`) or a fall, and the state at the event."""
    field, start, walker = equations(phase), begun.state, phase.walker
    order, watched = series_order(start), phase.clearance(start) is not None

    def undecided(now: Unfinished):
        going = (now.so_far.verdict == Outcome.UNDECIDED) & (now.count < MAX_STEPS)
        return going & jnp.isfinite(now.so_far.time)

    def advance(now: Unfinished) -> Unfinished:
        so_far = now.so_far
        others = phase.event, *falls_begin(walker)
        series, length = taylor_step(field, so_far.state, order, tolerance, *others)
        after = evaluate_series(series, length)
        event = function_series(phase.event, series)
        below = with_fast_sincos(lambda p, s: p.event(s) < 0)(phase, after)
        rises, when = first_upcrossing(polynomial_jet(event), length, (now.below, below))
        when = differentiable_zero(event, when)
        arrival = evaluate_series(series, when)
        strikes = rises & ~with_fast_sincos(has_fallen)(walker, arrival)
        fall = fall_of(walker, after)
        stop = length
        if not has_own_falls(walker):
            speed = polynomial_jet(derivative_of(series.theta))
            stops = stop_within(speed, jnp.where(rises, when, length))
            strikes, fall = strikes & ~stops.exists, jnp.where(stops.exists, Outcome.BACKWARD, fall)
            stop = jnp.where(stops.exists, stops.time, length)
        verdict = jnp.where(strikes, Outcome.STRIDE, fall)
        until = jnp.where(strikes, when, length)

        turning = interior_minimum(negate(polynomial_jet(event)), until)
        value = -jnp.abs(evaluate_polynomial(event, turning.time))
        forward = jnp.where(turning.exists, jnp.maximum(so_far.forward, value), so_far.forward)
        unknown = (verdict == Outcome.FORWARD) & (forward == -jnp.inf)
        forward = jnp.where(unknown, -jnp.abs(evaluate_polynomial(event, length)), forward)

        backward = least_speed(series.theta, length, until, so_far.backward)
        _, missing = missing_speed(series.theta, stop, rate)
        backward = jnp.where(verdict == Outcome.BACKWARD, missing, backward)
        fallen = so_far.fallen
        if has_own_falls(walker):
            short = jnp.maximum(-jnp.abs(evaluate_polynomial(event, length)), forward)
            short = jnp.maximum(short, missing_slope(walker, series, length, rate))
            fallen = jnp.where(fall != Outcome.UNDECIDED, short, fallen)

        least = dict(so_far.least)
        end = jax.tree.map(lambda a, b: jnp.where(strikes, a, b), arrival, after)
        between = lambda t: evaluate_series(series, t)
        for outcome, condition in conditions_of(phase).items():
            both = partial(value_and_rate, condition, phase.vector_field)
            at, value = least_between(both, so_far.state, end, between, until, resolution=1e-9)
            there = with_fast_sincos(condition)(evaluate_series(series, at))
            value = jnp.where(jnp.isfinite(value), there, value)
            least[outcome] = jnp.minimum(least[outcome], value)

        landing, landed, edge, under = so_far.landing, now.landed, now.edge, now.under
        if watched:
            height = function_series(phase.clearance, series)
            jet = polynomial_jet(height)
            under = with_fast_sincos(starts_under)(phase, after)
            lowest = interior_minimum(jet, until)
            turn = jnp.where(lowest.exists, lowest.time, until)
            high = evaluate_polynomial(height, turn) > 0
            touches, touch = first_upcrossing(negate(jet), turn, (~now.under, high))
            touch = differentiable_zero(height, touch)
            ground = evaluate_series(series, touch)
            touches &= with_fast_sincos(in_front)(phase, ground) & ~landed
            landed = landed | touches
            ahead = with_fast_sincos(lambda p, s: p.reach(s))(phase, ground)
            in_time = with_fast_sincos(lambda w, s: w.is_ahead(s))(walker, ground)
            edge = jnp.where(touches, jnp.maximum(-in_time, -ahead), edge)
            depth = evaluate_polynomial(height, turn)
            front = with_fast_sincos(in_front)(phase, evaluate_series(series, turn))
            over = lowest.exists | strikes
            passes = over & front & ~landed & (depth > 0)
            landing = jnp.where(passes, jnp.minimum(landing, depth), landing)
            lands = landed & (over | (fall != Outcome.UNDECIDED))
            landing = jnp.where(lands, jnp.maximum(-jnp.abs(depth), edge), landing)
            verdict = jnp.where(landed, Outcome.UNDECIDED, verdict)
            verdict = jnp.where(lands, Outcome.BENT_KNEE, verdict)
        so_far = PhaseMargins(
            after,
            so_far.time + until,
            verdict.astype(jnp.int8),
            backward,
            forward,
            landing,
            fallen,
            least,
        )
        return Unfinished(so_far, arrival, now.count + 1, below, under, landed, edge)

    first = Unfinished(
        begun,
        start,
        jnp.asarray(0),
        jnp.asarray(True),
        with_fast_sincos(starts_under)(phase, start),
        jnp.asarray(False),
        jnp.full_like(rate, -jnp.inf),
    )
    last = lax.while_loop(undecided, advance, first)
    return last.so_far, last.arrival


def least_speed(theta: list[Scalar], length: Scalar, until: Scalar, least: Scalar) -> Scalar:
    """The least speed of the stance leg so far, as thetadot^2 / 2; infinite where there is none."""
    speed = derivative_of(theta)
    slowing = interior_minimum(negate(polynomial_jet(speed)), length)
    counts = slowing.exists & (slowing.time < until)
    left = evaluate_polynomial(speed, slowing.time) ** 2 / 2
    return jnp.where(counts, jnp.minimum(least, left), least)


def missing_speed(theta: list[Scalar], length: Scalar, rate: Scalar) -> tuple[Scalar, Scalar]:
    """When the stance leg stops, and minus what is missing there, (thetaddot / rate)^2 / 2."""
    speed = derivative_of(theta)
    _, stop = upcrossing(speed, length)
    return stop, -((evaluate_polynomial(derivative_of(speed), stop) / rate) ** 2) / 2


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


def with_own_failures(
    walker: Walker,
    found: dict[str, Scalar],
    following: Any,
    struck: Bool[Array, ""],
    outcome: Int[Array, ""],
    fallen: Scalar,
    least: Least,
) -> dict[str, Scalar]:
    """Margins, by name, with those of the falls and the conditions that a class defines anew.

    `following` is the state after a heel strike, where the stride has `struck`; `fallen` the margin
    of a fall before, and `least` the least values of conditions.
    """
    own = {}
    if has_own_falls(walker):
        fallen = jnp.where(struck, -distance_to_fall(walker, following), fallen)
        ways = [Outcome[name] for name in walker.falls(following)]
        known = jnp.isfinite(fallen)  # a fall that `past_contact` tells has none of these
        own = {way: jnp.where(known, fallen, found[WAYS[way]]) for way in ways}
    for of in map(Outcome, least):
        if of in WAYS and of != Outcome.RUNNING:
            broken = struck & (least[of] < 0)
            own[of] = jnp.where(broken, least[of], own.get(of, found[WAYS[of]]))
    for of, value in own.items():
        found[WAYS[of]] = jnp.where(outcome == of, value, found[WAYS[of]])
    return found
