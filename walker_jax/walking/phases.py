"""The phases of a stride before its last, the swing.

A phase ends with its event. The next one begins after the impact, or the release, that belongs to
it. What may happen before the event is, in this order:

- the walker falls, or the swing foot comes down in front of the stance foot, where it must not
  (`BENT_KNEE`), on ground that may be higher by a step: whichever is first, as in the swing; an
  event before all of them counts;
- after the impact of the event the walker has fallen, as where the stance leg stops (`BACKWARD`).

The ground would have to pull (`RUNNING`) at the start, or in any phase of a stride that reaches
heel strike, as in strides of one phase. A phase whose event is due as it begins is over at once.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from walker_jax.integrators.roots import first_upcrossing, interior_minimum, negate
from walker_jax.integrators.solvers import MAX_STEPS, Method, Real, solver_for, zero_at
from walker_jax.integrators.taylor import with_fast_sincos
from walker_jax.walkers.model import Phase, Scalar, State, Walker
from walker_jax.walking.falls import (
    fall_of,
    has_fallen,
    has_own_falls,
    has_own_is_ahead,
    makes_step,
    watched_falls,
)
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.swing import (
    Broken,
    breaks,
    broken_at,
    conditions_of,
    equations,
    is_broken,
    may_break,
    speed_of,
    stop_within,
    swing,
)


class Arrival(NamedTuple):
    """Where the phases of a stride, or all of its motion, have led."""

    state: Any
    """The state in which the next phase begins; after the swing, that before heel strike."""
    time: Scalar
    """Since the start of the stride."""
    verdict: Int[Array, ""]
    """Before the swing `UNDECIDED`, after it `STRIDE`, unless the walker falls."""
    broken: Broken
    """Which conditions have been broken; first, whether the ground would have had to pull."""


def follow_to_heel_strike(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    tolerance: Real,
    *,
    launched: bool = False,
) -> Arrival:
    """All phases of a stride, from a state of the first one; nothing to do unless `UNDECIDED`."""
    last = follow_to_swing(walker, start, verdict, tolerance)
    state, time, verdict, broken = swing(
        walker, last.state, last.verdict, tolerance, launched=launched
    )
    return Arrival(state, last.time + time, verdict, merge_broken(last.broken, broken))


def follow_to_swing(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    tolerance: Real,
    step: Scalar | None = None,
) -> Arrival:
    """All phases of a stride before the swing, if there are any.

    Without any, tension at the start has been looked at already (`begin_stride`).
    """
    if not walker.phases():
        broken = broken_at(walker, start)
        del broken[int(Outcome.RUNNING)]
        return Arrival(start, zero_at(start), verdict, broken)
    return follow_phases(walker, start, verdict, tolerance, step)[-1]


def follow_phases(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    tolerance: Real,
    step: Scalar | None = None,
) -> list[Arrival]:
    """The end of each phase before the swing, after its impact."""
    phases = walker.phases()
    state, time, ends = start, zero_at(start), []
    over = is_over(phases[0], start, tolerance)
    verdict, broken = begin_phase(phases[0], state, time, over, verdict)
    for phase, following in zip(phases, (*phases[1:], walker), strict=True):
        verdict = jnp.where((verdict == Outcome.UNDECIDED) & over, Outcome.STRIDE, verdict)
        arrival, lasted, verdict, more = follow_phase(
            phase, state, verdict.astype(jnp.int8), tolerance, step
        )
        ended = verdict == Outcome.STRIDE
        at_end = jax.tree.map(lambda flag, o=~over & ended: flag & o, broken_at(phase, arrival))
        broken = merge_broken(broken, merge_broken(more, at_end))
        state, time = with_fast_sincos(lambda phase, s: phase.end(s))(phase, arrival), time + lasted
        verdict = jnp.where(ended, fall_of(walker, state), verdict)
        over = jnp.asarray(False)
        if isinstance(following, Phase):
            over = is_over(following, state, tolerance)
        verdict, more = begin_phase(following, state, time, over, verdict)
        broken = merge_broken(broken, more)
        ends.append(Arrival(state, time, verdict, broken))
    return ends


def begin_phase(
    phase: Phase | Walker,
    state: Any,
    time: Scalar,
    over: Bool[Array, ""],
    verdict: Int[Array, ""],
) -> tuple[Int[Array, ""], Broken]:
    """The verdict, and the conditions that are broken, as a phase begins that is not `over`.

    Tension at the start of the stride ends it. Later on the walker may yet fall otherwise.
    """
    starts = (verdict == Outcome.UNDECIDED) & ~over
    broken = jax.tree.map(lambda flag: flag & starts, broken_at(phase, state))
    pulled = broken[Outcome.RUNNING] & (time == 0)
    return jnp.where(pulled, Outcome.RUNNING, verdict).astype(jnp.int8), broken


def merge_broken(one: Broken, other: Broken) -> Broken:
    """Conditions broken in either of two parts of a stride."""
    never = jnp.asarray(False)
    return {key: one.get(key, never) | other.get(key, never) for key in sorted({*one, *other})}


def is_over(phase: Phase, state: Any, tolerance: Real) -> Bool[Array, ""]:
    """Whether a phase's event is due as it begins: it does not fall below zero first."""
    method = Method(equations(phase), solver_for(state), tolerance)
    value, rate, curvature = method.series(phase.event, state, 2)
    falls = (rate < 0) | ((rate == 0) & (curvature < 0))
    return (value > 0) | ((value == 0) & ~falls)


def follow_phase(
    phase: Phase,
    start: Any,
    verdict: Int[Array, ""],
    tolerance: Real,
    step: Scalar | None = None,
    *,
    failing: bool = True,
) -> tuple[Any, Scalar, Int[Array, ""], Broken]:
    """A phase until its event (`STRIDE`) or a fall; nothing to do unless `UNDECIDED`.

    Returns the state at the event, the time since the start of the phase, the verdict, and which
    conditions were broken before the event, the two ends excluded. Unless it is
    `failing`, nothing but the event ends the phase.
    """
    walker, watched = phase.walker, failing and phase.clearance(start) is not None
    ground = () if step is None else (step,)

    def height(state: Any) -> Scalar:
        above = phase.clearance(state)
        assert above is not None
        return above if step is None else above - step

    def rate(function, state: Any) -> Scalar:
        return jax.jvp(function, (state,), (phase.vector_field(state),))[1]

    def turns(function, before: Any, after: Any) -> Bool[Array, ""]:
        """Whether a function may have a minimum in a step."""
        return (rate(function, before) < 0) & (rate(function, after) > 0)

    def fall(state: Any) -> Int[Array, ""]:
        none = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
        return fall_of(walker, state) if failing else none

    def may_end(before: Any, after: Any, side: Bool[Array, " 2"]):
        """Whether a phase may end in a step, from the two ends of the step alone."""
        ends_below, ends_under = phase.event(after) < 0, jnp.asarray(False)
        ends = ~ends_below & (side[0] | turns(phase.event, before, after))
        if failing:
            ends |= has_fallen(walker, after)
        if may_stop:
            ends |= turns(lambda state: -speed_of(state), before, after)
        if watched:
            ends_under = height(after) < 0
            dips = turns(height, before, after)
            rises = turns(lambda state: -height(state), before, after)
            down = jnp.where(side[1], ends_under & rises, ends_under | dips)
            if not has_own_is_ahead(walker):  # which may hold within a step alone
                down &= walker.is_ahead(before) | walker.is_ahead(after)
            ends |= down
        return ends, jnp.stack([ends_below, ends_under])

    def undecided(carry):
        *_, time, verdict, count, _, _ = carry
        return (verdict == Outcome.UNDECIDED) & (count < MAX_STEPS) & jnp.isfinite(time)

    def follow(carry):
        now, _, time, verdict, count, broken, side = carry

        def stop(before: Any, after: Any, side: Bool[Array, " 2"]):
            ends, sides = may_end(before, after, side)
            for outcome, condition in conditions.items():
                ends |= may_break(condition, phase, before, after) & ~broken[outcome]
            return ends, sides

        last, steps = method.follow(now, stop, side=side, time=time)
        (below, under), (ends_below, ends_under) = last.sides
        rises, when = first_upcrossing(
            method.jet(phase.event, last), last.length, (below, ends_below)
        )
        when = jnp.where(rises, method.refine_time(phase.event, last, when), last.length)
        after = lambda time: method.state_at(last, time)
        arrival = after(when)
        lands, landing = jnp.asarray(False), when
        if watched:
            above = method.jet(height, last)
            ends_above = jnp.where(rises, above(when)[0] > 0, ~ends_under)
            lowest = interior_minimum(above, when)  # it may come down and up again
            down = jnp.where(lowest.exists, lowest.time, when)
            ends_above = jnp.where(lowest.exists, above(down)[0] > 0, ends_above)
            touches, landing = first_upcrossing(negate(above), down, (~under, ends_above))
            on_ground = after(landing)
            lands = touches & with_fast_sincos(in_front)(phase, on_ground)
        for outcome, condition in conditions.items():
            more = breaks(condition, phase, last.start, arrival, after, when)
            more |= ~rises & with_fast_sincos(partial(is_broken, condition))(phase, arrival)
            broken = broken | {outcome: broken[outcome] | more}
        arrival, delay = method.refine_event(phase.event, arrival)
        stands = fall(arrival) == Outcome.UNDECIDED
        verdict = jnp.where(rises & stands, Outcome.STRIDE, fall(last.end))
        verdict = jnp.where(lands, Outcome.BENT_KNEE, verdict)
        if may_stop:
            before = jnp.where(lands, landing, when)
            stops = stop_within(method.jet(speed_of, last), before)
            verdict = jnp.where(stops.exists, Outcome.BACKWARD, verdict)
        verdict = verdict.astype(jnp.int8)
        when = jnp.where(verdict == Outcome.STRIDE, when + delay, last.length)
        return last.end, arrival, last.time + when, verdict, count + steps, broken, last.sides[1]

    falls = watched_falls(walker) if failing else ()
    may_stop = failing and not has_own_falls(walker)
    method = Method(equations(phase), solver_for(start), tolerance, (phase.event, *falls))
    conditions = conditions_of(phase) if failing else {}
    broken = {outcome: jnp.asarray(False) for outcome in conditions}
    # It has been negative from the first, where it begins at zero.
    side = jnp.stack([jnp.asarray(True), with_fast_sincos(starts_under)(phase, start, *ground)])
    carry = (start, start, zero_at(start), verdict, jnp.asarray(0), broken, side)
    _, arrival, time, verdict, _, broken, _ = lax.while_loop(undecided, follow, carry)
    return arrival, time, verdict, broken


def starts_under(
    phase: Phase | Walker, state: Any, ground: Scalar | float = 0.0
) -> Bool[Array, ""]:
    """Whether the swing foot is below the ground, of some height."""
    above = phase.clearance(state)
    return jnp.asarray(False) if above is None else above < ground


def legs(states: Any) -> State:
    """Angles and rates of the legs, of states of any phase."""
    return State(*(getattr(states, name) for name in State._fields))


def in_front(phase: Phase, state: Any) -> Bool[Array, ""]:
    """Whether a foot that comes down would take a step: in front, before the walker has fallen."""
    return makes_step(phase.walker, state) & (phase.reach(state) > 0)
