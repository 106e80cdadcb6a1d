"""A stride through its modes, from its start to heel strike: phases, and last the swing.

A phase ends with its event. The next one begins after the impact, or the release, that belongs to
it. After the impact the walker may have fallen, as where the stance leg stops (`BACKWARD`). A phase
whose event is due as it begins is over at once.

Conditions, such as a force that would have to pull (`RUNNING`), count in strides that reach heel
strike; but the stride of a walker that is in tension at its start is over.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from walker_jax.hybrid.crossings import begins_below
from walker_jax.hybrid.following import NO_GUARD, End, Violated, follow_mode
from walker_jax.hybrid.misses import Misses
from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.method import zero_at
from walker_jax.integrators.taylor import with_fast_sincos
from walker_jax.walkers.model import Phase, Scalar, State, Walker
from walker_jax.walking.falls import fall_of
from walker_jax.walking.modes import equations, in_tension, method_of, phase_mode, swing_mode
from walker_jax.walking.outcomes import Outcome


class Part(NamedTuple):
    """A mode of a stride that was followed."""

    mode: Mode
    start: Any
    verdict: Int[Array, ""]
    """As it began; it was followed if that is `UNDECIDED`."""
    end: End
    misses: Misses


class Arrival(NamedTuple):
    """Where the phases of a stride, or all of its motion, have led."""

    state: Any
    """The state in which the next phase begins; after the swing, that before heel strike."""
    time: Scalar
    """Since the start of the stride."""
    verdict: Int[Array, ""]
    """Before the swing `UNDECIDED`, after it `STRIDE`, unless the walker falls."""
    violated: Violated
    """Which conditions were violated, the contact force Q_v >= 0 among them."""
    parts: tuple[Part, ...] = ()
    """Its modes so far, of a stride that is measured."""


def follow_to_heel_strike(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    integrator: Integrator,
    *,
    launched: bool = False,
    measured: bool = False,
) -> Arrival:
    """All phases of a stride, from a state of the first one; nothing to do unless `UNDECIDED`.

    If it is `measured`, the parts of the stride have their misses, and a fall is followed to its
    end.
    """
    last = follow_to_swing(walker, start, verdict, integrator, measured=measured)
    mode = swing_mode(walker, last.state, launched=launched)
    mode = mode._replace(foregone=None) if measured else mode
    return follow_on(mode, last, integrator, measured)


def follow_on(mode: Mode, last: Arrival, integrator: Integrator, measured: bool = False) -> Arrival:
    """A mode from where the one before has led; the verdict is what its guard leads to."""
    going = last.verdict == Outcome.UNDECIDED
    method = method_of(mode, last.state, integrator)
    found = follow_mode(mode, last.state, going, method, measured=measured)
    verdict = jnp.where(found.guard == NO_GUARD, Outcome.UNDECIDED, last.verdict)
    for i, guard in enumerate(mode.guards):
        verdict = jnp.where(found.guard == i, guard.leads_to, verdict)
    if mode.foregone is not None:
        verdict = jnp.where(found.guard == len(mode.guards), mode.foregone.leads_to, verdict)
    violated = merge(last.violated, found.violated)
    parts = last.parts
    if found.misses is not None:
        parts = *parts, Part(mode, last.state, last.verdict, found, found.misses)
    return Arrival(found.state, last.time + found.time, verdict.astype(jnp.int8), violated, parts)


def follow_to_swing(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    integrator: Integrator,
    step: Scalar | None = None,
    measured: bool = False,
) -> Arrival:
    """All phases of a stride before the swing, if there are any."""
    begun = Arrival(start, zero_at(start), verdict, {})
    return [begun, *follow_phases(walker, begun, integrator, step, measured)][-1]


def follow_phases(
    walker: Walker,
    begun: Arrival,
    integrator: Integrator,
    step: Scalar | None = None,
    measured: bool = False,
) -> list[Arrival]:
    """The end of each phase before the swing, after its impact."""
    ends, now = [], begun
    phases = walker.phases()
    for phase in phases:
        over = is_over(phase, now.state, integrator)
        verdict = begin_phase(phase, now.state, now.time, over, now.verdict)
        verdict = jnp.where((verdict == Outcome.UNDECIDED) & over, Outcome.STRIDE, verdict)
        now = now._replace(verdict=verdict.astype(jnp.int8))
        now = follow_on(phase_mode(phase, now.state, step), now, integrator, measured)
        state = with_fast_sincos(lambda phase, s: phase.end(s))(phase, now.state)
        ended = now.verdict == Outcome.STRIDE
        verdict = jnp.where(ended, fall_of(walker, state), now.verdict)
        if phase is phases[-1]:
            verdict = begin_phase(walker, state, now.time, jnp.asarray(False), verdict)
        now = now._replace(state=state, verdict=verdict.astype(jnp.int8))
        ends.append(now)
    return ends


def begin_phase(
    phase: Phase | Walker,
    state: Any,
    time: Scalar,
    over: Bool[Array, ""],
    verdict: Int[Array, ""],
) -> Int[Array, ""]:
    """The verdict as a phase begins that is not `over`: tension at a stride's start ends it."""
    starts = (verdict == Outcome.UNDECIDED) & ~over & (time == 0)
    pulled = starts & with_fast_sincos(in_tension)(phase, state)
    return jnp.where(pulled, Outcome.RUNNING, verdict).astype(jnp.int8)


def merge(one: Violated, other: Violated) -> Violated:
    """Conditions violated in either of two parts of a stride."""
    never = jnp.asarray(False)
    return {key: one.get(key, never) | other.get(key, never) for key in sorted({*one, *other})}


def is_over(phase: Phase, state: Any, integrator: Integrator) -> Bool[Array, ""]:
    """Whether a phase's event is due as it begins: it does not fall below zero first."""
    method = integrator.method(equations(phase), state)
    return ~begins_below(method.series(phase.event, state, 2))


def legs(states: Any) -> State:
    """Angles and rates of the legs, of states of any phase."""
    return State(*(getattr(states, name) for name in State._fields))
