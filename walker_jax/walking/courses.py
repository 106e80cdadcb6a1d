"""The course of a stride through the modes of a system, from mode to mode to the section.

A mode is entered in the state to which a guard of another one was reset. It is over at once if a
fall or a guard that leads on is due by then. All lanes of a batch pass all modes; those that have
not entered a mode wait until the others have left it.

Conditions, such as a contact force that would have to pull (`RUNNING`), count in strides that reach
the section. A stride that starts in tension is over at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from walker_jax.hybrid.beginnings import Due, is_due
from walker_jax.hybrid.following import NO_GUARD, End, Violated, follow_mode
from walker_jax.hybrid.graphs import (
    check_one_kind,
    check_state,
    entered_again,
    in_order,
    kind_of,
    kinds_of_states,
    suit_state,
)
from walker_jax.hybrid.modes import SECTION, Guard, Mode, ends_at_once
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrals import WithIntegrals
from walker_jax.integrators.integrator import Integrator, Method, zero_at
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.step_lengths import StepLimits, has_sharp_features
from walker_jax.kernels.reverse import with_transposed_turns, zero_where_unused
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import Outcome, Stride, make_stride

MOST_PASSES = 1000
"""A stride whose modes are entered again is `UNDECIDED` after so many passes through them."""
Verdict = Int[Array, ""]
"""The number of an `Outcome`."""
Numbers = Mapping[str, int]
"""The number of each failure, by its name."""


class Entry(NamedTuple):
    """A mode, or the section, as a course reaches it."""

    reached: Bool[Array, ""]
    state: Any


class Part(NamedTuple):
    """A mode on a course."""

    name: str
    mode: Mode
    start: Any
    time: Scalar
    """Time since the start of the stride."""
    reached: Bool[Array, ""]
    begun: Verdict
    """The failure with which the mode began; `UNDECIDED` if it did not fail."""
    followed: Bool[Array, ""]
    """Whether it was followed: not if it was over as it began."""
    taken: Int[Array, ""]
    """The number of the guard that ended it, at once or later; negative if none did."""
    passed: Bool[Array, ""]
    """Whether the stride went on from it, to another mode or to the section."""
    end: End


class Course(NamedTuple):
    """A stride as far as it has been followed."""

    entries: dict[str, Entry]
    """Modes that it may have reached and that are still to be followed, and the section."""
    time: Scalar
    """Time since the start of the stride."""
    verdict: Verdict
    """`UNDECIDED` while it goes on, `STRIDE` on the section, or a failure."""
    held: Verdict
    """On the section, the failure if something did not hold where the last guard rose; `STRIDE` if
    all did."""
    violated: Violated
    """Conditions that were violated, by the failure's name."""
    parts: tuple[Part, ...] = ()
    """The modes that have been followed; none if modes can be entered again."""


def begin_course(name: str, state: Any, feasible: Bool[Array, ""]) -> Course:
    """Return the course of a stride that begins in a mode; it is over unless it is `feasible`."""
    check_state(name, state)
    zero, stride = zero_at(state), jnp.asarray(Outcome.STRIDE, jnp.int8)
    verdict = jnp.where(feasible, Outcome.UNDECIDED, Outcome.OUTSIDE).astype(jnp.int8)
    return Course({name: Entry(jnp.asarray(True), state)}, zero, verdict, stride, {})


def follow_graph(
    system: HybridSystem, modes: Mapping[str, Mode], begun: Course, integrator: Integrator
) -> Course:
    """Follow modes from the first one to the section, or to a failure."""
    return fold_parts(system, modes, begun, integrator, lambda known, _: known, ())[0]


def fold_parts(
    system: HybridSystem,
    modes: Mapping[str, Mode],
    begun: Course,
    integrator: Integrator,
    fold: Callable[[Any, Part], Any],
    known: Any,
    *,
    measured: bool = False,
) -> tuple[Course, Any]:
    """Follow modes as `follow_graph` does; also return known = fold(known, part) after each part.

    If `measured`, the parts have their misses.
    """
    again = entered_again(modes)
    if not again:
        course = follow_modes(system, modes, begun, integrator, measured)
        return course, reduce(fold, course.parts, known)
    first, *_ = modes
    kinds = kinds_of_states(modes, begun.entries[first].state)
    never = jnp.asarray(False)
    empty = lambda name: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), kinds[name])
    begun_in = [*dict.fromkeys((first, *again))]
    waiting = {name: Entry(never, empty(name)) for name in (*begun_in, SECTION)}
    violated = dict.fromkeys((one.leads_to for m in modes.values() for one in m.conditions), never)
    course = begun._replace(entries=waiting | begun.entries, violated=violated)

    def goes_on(carry):
        (course, _), passes = carry
        reached = [course.entries[name].reached for name in begun_in]
        going = course.verdict == Outcome.UNDECIDED
        return going & reduce(jnp.logical_or, reached) & (passes < MOST_PASSES)

    def follow(carry):
        course, known = carry
        found = follow_modes(system, modes, course, integrator, measured, again)
        known = reduce(fold, found.parts, known)
        return found._replace(entries=waiting | found.entries, parts=()), known

    def find(start, writer):
        def make(carry):
            now, passes, tapes = carry
            tapes = tapes if writer is None else writer.put(tapes, passes, now)
            return follow(now), passes + 1, tapes

        begun = start, jnp.asarray(0), writer and writer.tapes
        end, passes, tapes = lax.while_loop(lambda now: goes_on(now[:2]), make, begun)
        return end, passes, (), tapes

    return with_transposed_turns(
        find, lambda _: (), lambda carry, _: follow(carry), (course, known)
    )[0]


def follow_modes(
    system: HybridSystem,
    modes: Mapping[str, Mode],
    course: Course,
    integrator: Integrator,
    measured: bool = False,
    again: list[str] | None = None,
) -> Course:
    """Follow each of some modes once, in order, and leave all others to which they lead.

    If `measured`, the parts have their misses. Modes that a course can enter `again` may have been
    entered from others even where they come first.
    """
    numbers, (first, *_) = failures_by_name(system), modes
    for name in in_order(modes):
        switched: Any = name != first
        if again and name == first:
            switched = (course.time > 0) if name in again else False
        course = follow_one(name, modes, numbers, course, integrator, measured, switched)
    return course


def follow_one(
    name: str,
    modes: Mapping[str, Mode],
    numbers: Numbers,
    course: Course,
    integrator: Integrator,
    measured: bool,
    switched: bool | Bool[Array, ""],
) -> Course:
    """Follow one mode, from where the course enters it to where its guard leads."""
    entry = course.entries[name]
    mode = suit_state(name, modes[name], entry.state)
    method = method_of(mode, entry.state, integrator)
    going = entry.reached & (course.verdict == Outcome.UNDECIDED)
    due, rises = guard_due(mode, numbers, method, entry.state, switched)
    begun = failure_at_start(mode, numbers, entry.state, switched)
    for one in mode.conditions:
        if one.at_start:
            pulled = (course.time == 0) & one.is_negative(entry.state)
            pulled = pulled if due is None else pulled & (due < 0)
            begun = jnp.where(pulled, numbers[one.leads_to], begun)
    begun = begun.astype(jnp.int8)
    fallen = going & (begun != Outcome.UNDECIDED)
    at_once = jnp.asarray(False) if due is None else going & ~fallen & (due >= 0)
    followed = going & ~fallen & ~at_once
    risen = None if due is None else jnp.where(at_once & rises, due, NO_GUARD)
    end = follow_mode(mode, entry.state, followed, method, risen=risen, measured=measured)
    taken = end.guard if due is None else jnp.where(at_once, due, end.guard)
    verdict = jnp.where(fallen, begun, course.verdict)
    if mode.foregone is not None:
        foregone = end.guard == len(mode.guards)
        verdict = jnp.where(foregone, numbers[mode.foregone.leads_to], verdict)
    held, passed = course.held, jnp.asarray(False)
    entries = {of: one for of, one in course.entries.items() if of != name}
    for i, guard in enumerate(mode.guards):
        took = taken == i
        if guard.leads_to in numbers:
            verdict = jnp.where(took, numbers[guard.leads_to], verdict)
            continue
        take = with_fast_sincos(partial(take_guard, guard, numbers))
        holds, state = zero_where_unused(take, end.state)
        if guard.leads_to == SECTION:
            verdict = jnp.where(took, Outcome.STRIDE, verdict)
            held = jnp.where(took, holds, held).astype(jnp.int8)
        else:
            verdict = jnp.where(took & (holds != Outcome.STRIDE), holds, verdict)
            took &= holds == Outcome.STRIDE
        passed |= took & (holds == Outcome.STRIDE)
        known = entries.get(guard.leads_to)
        entries[guard.leads_to] = join(guard.leads_to, known, Entry(took, state))
    violated = either(course.violated, end.violated)
    part = Part(name, mode, entry.state, course.time, going, begun, followed, taken, passed, end)
    parts = *course.parts, part
    verdict = verdict.astype(jnp.int8)
    return Course(entries, course.time + end.time, verdict, held, violated, parts)


def join(name: str, known: Entry | None, other: Entry) -> Entry:
    """Return two ways into a mode as one."""
    if known is None:
        return other
    check_one_kind(name, kind_of(known.state), kind_of(other.state))
    state = jax.tree.map(partial(jnp.where, other.reached), other.state, known.state)
    return Entry(known.reached | other.reached, state)


def either(known: Violated, found: Violated) -> Violated:
    """Return whether conditions were violated in either of two parts."""
    both = {name: known[name] | found[name] for name in known if name in found}
    return dict(known) | found | both


def guard_due(
    mode: Mode, numbers: Numbers, method: Method, state: Any, switched: bool | Bool[Array, ""]
) -> tuple[Int[Array, ""] | None, Bool[Array, ""]]:
    """Return the number of the first guard that ends a mode as it begins, but by no failure.

    A guard that leads to a mode is due if it does not begin below zero; one that leads to the
    section only if it acts `at_once`. The number is `NO_GUARD` if none is due, and None if none can
    be. Also returns whether it `rises` just then (`Due`).
    """
    found, rises = None, jnp.asarray(False)
    for i, guard in reversed([*enumerate(mode.guards)]):
        if guard.leads_to in numbers or (guard.leads_to == SECTION and not guard.at_once):
            continue
        due = is_due(mode, guard, method, state)
        if guard.leads_to == SECTION:
            due = Due(ends_at_once(mode, guard, state, switched), due.rises)
        found = jnp.where(due.ends, i, NO_GUARD if found is None else found).astype(jnp.int32)
        rises = jnp.where(due.ends, due.rises, rises)
    return found, rises


def leads_on(guard: Guard, numbers: Numbers) -> bool:
    """Return whether a guard leads to a mode."""
    return guard.leads_to != SECTION and guard.leads_to not in numbers


def failure_at_start(
    mode: Mode, numbers: Numbers, state: Any, switched: bool | Bool[Array, ""] = False
) -> Verdict:
    """Return the failure with which a mode begins; `UNDECIDED` if there is none."""
    return with_fast_sincos(partial(fall_of, mode, numbers, switched=switched))(state)


def fall_of(
    mode: Mode, numbers: Numbers, state: Any, switched: bool | Bool[Array, ""] = False
) -> Verdict:
    """Return the first failure that acts at once and is due; `UNDECIDED` if none is."""
    outcome = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    for guard in reversed(mode.guards):
        if guard.at_once and guard.leads_to in numbers:
            fallen = ends_at_once(mode, guard, state, switched)
            outcome = jnp.where(fallen, numbers[guard.leads_to], outcome).astype(jnp.int8)
    return outcome


def take_guard(guard: Guard, numbers: Numbers, state: Any) -> tuple[Verdict, Any]:
    """Return whether all holds where a guard has risen, and the state after its reset.

    That is `STRIDE`, or the failure of the first thing that does not hold.
    """
    verdict = jnp.asarray(Outcome.STRIDE, jnp.int8)
    for one in reversed(guard.must_hold):
        value = one.value(state)
        fails = jnp.where(jnp.isfinite(value), numbers[one.leads_to], Outcome.UNDECIDED)
        verdict = jnp.where(value > 0, verdict, fails).astype(jnp.int8)
    return verdict, guard.reset(state)


def method_of(mode: Mode, start: Any, integrator: Integrator) -> Method:
    """Return the method that integrates a mode; its steps also end at kinks of guards."""
    functions = tuple(function for guard in mode.functions() for function in guard)
    sharp = tuple(one.value for one in mode.conditions if has_sharp_features(one.value, start))
    watched = sharp if mode.as_smooth else (*functions, *sharp)
    if isinstance(mode.field, WithIntegrals):
        watched = *watched, *mode.field.functions().values()
    conditions = tuple(one.value for one in mode.conditions if not one.least_at_ends)
    limits = StepLimits(mode.scales, mode.longest_step)
    return integrator.method(
        mode.field, start, *functions, watched=watched, conditions=conditions, limits=limits
    )


def end_course(system: HybridSystem, first: Mode, course: Course) -> Stride:
    """Return the stride: its point on the section, unless it failed, and its outcome.

    The next stride, which begins in the `first` mode, may be over as it begins.
    """
    numbers = failures_by_name(system)

    def judge(system, state, course: Course):
        point = system.project(state)
        fallen = fall_of(first, numbers, system.begin(state))
        struck = jnp.where(fallen == Outcome.UNDECIDED, Outcome.STRIDE, fallen)
        struck = jnp.where(jnp.all(jnp.isfinite(point)), struck, Outcome.UNDECIDED)
        struck = jnp.where(course.held == Outcome.STRIDE, struck, course.held)
        for name in sorted(course.violated, key=numbers.__getitem__, reverse=True):
            struck = jnp.where(course.violated[name], numbers[name], struck)
        verdict = jnp.where(course.verdict == Outcome.STRIDE, struck, course.verdict)
        return make_stride(point, verdict.astype(jnp.int8), course.time)

    state = course.entries[SECTION].state
    judged = course._replace(entries={}, parts=())
    return zero_where_unused(with_fast_sincos(judge), system, state, judged)
