"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3).

A stride follows the modes of a walker, or of any hybrid system, from guard to guard, to the
section: for a walker its phases and, last, the swing, which ends at heel strike or in a fall. A
mode is entered in the state to which a guard of another one was reset. It is over at once if a
fall or a guard that leads on is due by then. All lanes of a batch pass all modes; those that have
not entered a mode wait until the others have left it.

Conditions, such as a contact force that would have to pull (`RUNNING`), count in strides that reach
the section. A stride that starts in tension is over at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import check_whole
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
from walker_jax.hybrid.modes import SECTION, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import AnySolver, Integrator, zero_at
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.kernels.reverse import with_transposed_turns, zero_where_unused
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name, modes_of
from walker_jax.systems.outcomes import Outcome, Stride, make_stride
from walker_jax.systems.system import System, apply_map
from walker_jax.walking.guards import (
    Numbers,
    Verdict,
    fall_of,
    guard_due,
    method_of,
    take_guard,
)
from walker_jax.walking.starts import (
    check_ground,
    during_stride,
    height_of_step,
    on_section,
    prepare,
)

MOST_PASSES = 1000
"""A stride whose modes are entered again is `UNDECIDED` after so many passes through them."""


def stride(
    walker: System,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    step: Real | None = None,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Stride:
    """Make one stride, S(x), equation (20); for any `System`, the step to its next point.

    ```python
    walker = wj.SimplestWalker(0.004)
    end = wj.stride(walker, (0.2, -0.2))
    end.outcome, end.state, end.time
    ```

    Works under JAX's transformations, in the dtype of x, float32 or float64: `jax.jit`, `jax.vmap`,
    `jax.lax.scan`; `jax.jacfwd`, `jax.grad` and `jax.jacrev`, and derivatives of these. On a CPU
    all of them call machine code (`kernels`), so a jitted `jax.vmap` is as fast as `strides`.

    **Arguments:**

    - `walker`: any walker or other system; derivatives with respect to its parameters are right
      too.
    - `x`: the start, on the walker's section just after heel strike; or a full state
      (theta, phi, thetadot, phidot), for a launch or after a push. A full state is feasible if it
      is finite and the stance leg stands, |theta| < pi/2.
    - `step`: height of the next foothold above the present one, normal to the slope, in the unit of
      length; by default 0. It is negative for a step down, as in `stride(walker, x, step=-0.001)`.
      The swing foot comes down there ahead of the other, with a straight
      knee; if it does not rise that high, the walker falls. Scuffing is judged by the present
      level. The result's state is then a full state, just after heel strike and off the section, as
      one foot is lower. `stride` takes it from there, on a slope through the standing foot.
    - `tolerance`: of one integration step: of its last Taylor terms, relative to the state or its
      rate (`integrators.taylor_steps.step_size`), or of the error that another solver estimates.
      By default 1e-12 in float64 and 1e-6 in float32. A stride amplifies this error, up to 1e5
      times near falling backward.
    - `solver`: one of diffrax's Runge-Kutta methods, such as `diffrax.Dopri8()`, in place
      of the Taylor series. It does not know where a vector field has kinks.

    **Returns** a `Stride`. A failure is an `Outcome`. Raises `ValueError` for a wrong shape or
    dtype, and for a tolerance that the dtype cannot hold.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if step is None:
        return follow_stride(walker, x, integrator)
    return follow_stride(check_ground(walker), x, integrator, height_of_step(step, x.dtype))


@kernel
def follow_stride(
    walker: System,
    x: Float[Array, " coordinates"],
    integrator: Integrator,
    step: Float[Array, ""] | None = None,
) -> Stride:
    """Make one stride; to ground that is higher by `step`, if given, it ends in a full state."""
    walker = during_stride(walker, x)
    if not isinstance(walker, HybridSystem):
        return apply_map(walker, x)
    modes = modes_from(walker, x, step)
    course, _ = follow_graph(walker, modes, start_course(walker, modes, x), integrator)
    made = end_course(walker, modes, course)
    return made if step is None else with_full_state(made, course)


def with_full_state(stride: Stride, course: Course) -> Stride:
    """Return a stride with the full state after its last reset."""
    full = lambda state, *others: make_stride(jnp.stack(jax.tree.leaves(state)), *others)
    return zero_where_unused(full, course.entries[SECTION].state, stride.outcome, stride.time)


class Entry(NamedTuple):
    """A mode, or the section, as a course reaches it."""

    reached: Bool[Array, ""]
    state: Any


class ModeResult(NamedTuple):
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


def modes_from(
    walker: HybridSystem,
    x: Float[Array, " coordinates"],
    step: Scalar | None = None,
    *,
    to_the_end: bool = False,
) -> dict[str, Mode]:
    """Return the modes of the stride from x, on level ground or onto a `step`.

    A launched walker, which did not start on the section, is followed to the end of a fall.
    """
    modes = modes_of(walker, step)
    for mode in modes.values():
        check_whole("most_steps", mode.most_steps)
    launched = not on_section(walker, x)
    if launched or to_the_end:
        modes = {name: one._replace(early_exit=None) for name, one in modes.items()}
    if launched:
        anywhere = lambda one: one._replace(zero_at_start=False)
        first, *_ = modes
        conditions = tuple(map(anywhere, modes[first].conditions))
        modes[first] = modes[first]._replace(conditions=conditions)
    return modes


def start_course(
    walker: HybridSystem, modes: dict[str, Mode], x: Float[Array, " coordinates"]
) -> Course:
    """Return the course of the stride from x, in the first mode."""

    def begin(walker, x):
        start = walker.launch(x)
        return start, jnp.asarray(walker.may_launch(x, start))

    first, *_ = modes
    return begin_course(first, *with_fast_sincos(begin)(walker, x))


def begin_course(name: str, state: Any, feasible: Bool[Array, ""]) -> Course:
    """Return the course of a stride that begins in a mode; it is over unless it is `feasible`."""
    check_state(name, state)
    zero, stride = zero_at(state), jnp.asarray(Outcome.STRIDE, jnp.int8)
    verdict = jnp.where(feasible, Outcome.UNDECIDED, Outcome.OUTSIDE).astype(jnp.int8)
    return Course({name: Entry(jnp.asarray(True), state)}, zero, verdict, stride, {})


def follow_graph(
    system: HybridSystem,
    modes: Mapping[str, Mode],
    begun: Course,
    integrator: Integrator,
    fold: Callable[[Any, ModeResult], Any] = lambda known, _: known,
    known: Any = (),
    *,
    measured: bool = False,
) -> tuple[Course, Any]:
    """Follow modes from the first one to the section, or to a failure.

    Also return what is known after the last part: known = fold(known, part) after each. If
    `measured`, the parts have their misses.
    """
    again = entered_again(modes)
    follow = partial(follow_modes, system, modes, integrator, fold, measured, again)
    if not again:
        return follow(begun, known)
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

    def follow_again(carry):
        course, known = follow(*carry)
        return course._replace(entries=waiting | course.entries), known

    def find(start, writer):
        def make(carry):
            now, passes, tapes = carry
            tapes = tapes if writer is None else writer.put(tapes, passes, now)
            return follow_again(now), passes + 1, tapes

        begun = start, jnp.asarray(0), writer and writer.tapes
        end, passes, tapes = lax.while_loop(lambda now: goes_on(now[:2]), make, begun)
        return end, passes, (), tapes

    return with_transposed_turns(
        find, lambda _: (), lambda carry, _: follow_again(carry), (course, known)
    )[0]


def follow_modes(
    system: HybridSystem,
    modes: Mapping[str, Mode],
    integrator: Integrator,
    fold: Callable[[Any, ModeResult], Any],
    measured: bool,
    again: list[str],
    course: Course,
    known: Any,
) -> tuple[Course, Any]:
    """Follow each of some modes once, in order, and leave all others to which they lead.

    Modes that a course can enter `again` may have been entered from others even where they come
    first.
    """
    numbers, (first, *_) = failures_by_name(system), modes
    for name in in_order(modes):
        switched: Any = name != first
        if again and name == first:
            switched = (course.time > 0) if name in again else False
        course, part = follow_one(name, modes, numbers, course, integrator, measured, switched)
        known = fold(known, part)
    return course, known


def follow_one(
    name: str,
    modes: Mapping[str, Mode],
    numbers: Numbers,
    course: Course,
    integrator: Integrator,
    measured: bool,
    switched: bool | Bool[Array, ""],
) -> tuple[Course, ModeResult]:
    """Follow one mode, from where the course enters it to where its guard leads."""
    entry = course.entries[name]
    mode = suit_state(name, modes[name], entry.state)
    method = method_of(mode, entry.state, integrator)
    going = entry.reached & (course.verdict == Outcome.UNDECIDED)
    due, rises = guard_due(mode, numbers, method, entry.state, switched)
    begun = with_fast_sincos(partial(fall_of, mode, numbers, switched=switched))(entry.state)
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
    if mode.early_exit is not None:
        exited = end.guard == len(mode.guards)
        verdict = jnp.where(exited, numbers[mode.early_exit.leads_to], verdict)
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
    part = ModeResult(
        name, mode, entry.state, course.time, going, begun, followed, taken, passed, end
    )
    verdict = verdict.astype(jnp.int8)
    return Course(entries, course.time + end.time, verdict, held, violated), part


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


def end_course(system: HybridSystem, modes: Mapping[str, Mode], course: Course) -> Stride:
    """Return the stride: its point on the section, unless it failed, and its outcome.

    The next stride, which begins in the first mode, may be over as it begins.
    """
    numbers, (first, *_) = failures_by_name(system), modes.values()

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
    judged = course._replace(entries={})
    return zero_where_unused(with_fast_sincos(judge), system, state, judged)
