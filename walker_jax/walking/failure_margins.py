"""Margins by which a stride misses each way to fail.

A margin is a smooth function of start and parameters. It is positive where the walker passes, and
zero on the boundary to a failure. The guards and conditions of the modes of a stride define it, for
all systems alike (`hybrid.misses`):

- for a fall that does not happen, it is the greatest value of its guard, up to the end of the
  stride and just after its impact; for a heel strike that happens, by how little it happened;
- for a fall that happens, it is the least change that would have prevented it: the rate at which
  its guard rises, or the miss of an earlier heel strike;
- for a condition, it is its least value.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import Integrator, zero_at
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import Outcome, Stride, nan_unless
from walker_jax.systems.system import System, apply_map
from walker_jax.walkers.ground import LOWER
from walker_jax.walking.guards import Numbers
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.starts import as_floating, during_stride, on_section, prepare
from walker_jax.walking.stride import (
    Course,
    ModeResult,
    end_course,
    follow_graph,
    modes_from,
    start_course,
)

WAYS = {one.name: one.margin for one in Outcome if one.margin}
"""The words for the margins of failures that all systems share."""


class Margins(NamedTuple):
    """A stride, and the margins by which it misses each way to fail; NaN where none applies.

    A failure's own margin is negative. Margins of falls that did not happen before it are positive,
    and margins of conditions are known where there was a heel strike. Those of shared failures are
    attributes too, by the word for the margin (`Outcome.margin`), such as `backward`.
    """

    stride: Stride
    failed: Float[Array, "*cells"]
    """The margin of the failure that ended the stride; NaN if none did."""
    by_name: dict[str, Float[Array, "*cells"]]
    """The margin of each failure to which a guard or a condition of the system leads, by its name,
    such as "FORWARD" or one of `System.failures`."""

    def __getattr__(self, word: str) -> Float[Array, "*cells"]:
        """Return the margin of a shared failure by its word; NaN where nothing leads to it."""
        for name, known in WAYS.items():
            if word == known:
                return self.by_name.get(name, jnp.full_like(self.failed, jnp.nan))
        raise AttributeError(f"margins have no {word!r}, only {', '.join(WAYS.values())}")

    @property
    def own(self) -> Float[Array, "*cells"]:
        """The least margin of the system's own `failures`."""
        own = [value for name, value in self.by_name.items() if name not in Outcome.__members__]
        return reduce(jnp.fmin, own, jnp.full_like(self.failed, jnp.nan))


def margins(
    walker: System,
    x: Float[ArrayLike, "*n coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Margins:
    """Follow one stride, as `stride` does, or one from each of n starts, and measure its margins.

    Arguments and errors are those of `stride`; starts in rows, of shape (n, coordinates), are
    followed as by `strides`, on all devices and cores. First derivatives are exact. Margins are
    smooth except where the instant that determines them jumps.

    ```python
    found = wj.margins(wj.SimplestWalker(0.004), (0.2, -0.2))
    found.backward, found.forward  # both positive: the walker makes the stride
    ```
    """
    if as_floating(x).ndim == 2:
        return margins_of_rows(walker, x, tolerance, progress)
    return follow_margins(*prepare(walker, x, tolerance))


@refuses_tracers("within them use jax.vmap(lambda x: wj.margins(walker, x))(x)", called="margins")
def margins_of_rows(
    walker: System, x: Any, tolerance: Real | None, progress: str | None
) -> Margins:
    """Measure the margins of one stride from each row of x, with one walker or n."""
    return for_each_start(follow_margins, walker, x, tolerance, progress=progress, name="x")


@kernel
def follow_margins(walker: System, x: Float[Array, " n"], integrator: Integrator) -> Margins:
    walker = during_stride(walker, x)
    if not isinstance(walker, HybridSystem):
        return measure_map(walker, x)
    return measure_modes(walker, x, modes_from(walker, x, to_the_end=True), integrator)[0]


def measure_modes(
    walker: HybridSystem, x: Float[Array, " n"], modes: dict[str, Mode], integrator: Integrator
) -> tuple[Margins, Course]:
    """Follow modes from x, and return their margins, and their course."""
    begun, (first, *_) = start_course(walker, modes, x), modes.values()
    (start,) = begun.entries.values()
    zero = zero_at(start.state)
    unit, known = zero + walker.unit_of_time(), nothing_measured(walker, modes, zero)
    measure = lambda known, part: with_fast_sincos(partial(add_part, known, part, walker, unit))()
    course, known = follow_graph(walker, modes, begun, integrator, measure, known, measured=True)
    stride = end_course(walker, modes, course)
    found = with_fast_sincos(partial(measure_stride, walker, first, course, known, stride))()
    outside = margin_of_start(walker, x)
    if outside is None:
        return found, course
    # A guard may lead outside too.
    led = (stride.outcome == Outcome.OUTSIDE) & walker.feasible(x)
    outside = jnp.where(led, found.outside, outside)
    failed = jnp.where(stride.outcome == Outcome.OUTSIDE, outside, found.failed)
    return Margins(stride, failed, found.by_name | {"OUTSIDE": outside}), course


def measure_map(walker: System, x: Float[Array, " section"]) -> Margins:
    """Measure a map: the margin that the system defines is that of the failure that happens."""
    stride, margin = apply_map(walker, x), margin_of_start(walker, x)
    nan = jnp.sum(x) * jnp.nan
    margin = nan if margin is None else margin
    numbers = failures_by_name(walker)
    failures = [name for name in numbers if name in WAYS or name in walker.failures]
    by_name = {of: jnp.where(stride.outcome == numbers[of], margin, nan) for of in failures}
    fails = reduce(jnp.logical_or, (stride.outcome == numbers[of] for of in failures))
    return Margins(stride, nan_unless(fails, margin), by_name | {"OUTSIDE": margin})


def margin_of_start(walker: System, x: Float[Array, " coordinates"]) -> Scalar | None:
    """Return `System.margin`; None where there is none."""
    known = walker.margin(x[: len(walker.section)])
    return known if known is None or on_section(walker, x) else jnp.sum(x) * jnp.nan


class Leasts(NamedTuple):
    """Conditions in a stride so far, by their failures."""

    value: dict[str, Scalar]
    """The least value; infinite at first."""
    miss: dict[str, Scalar]
    """The miss nearest to zero of a guard that leads on, before the condition was violated."""
    violated: dict[str, Bool[Array, ""]]


class Measured(NamedTuple):
    """The modes that a stride has passed."""

    passed: dict[str, Scalar]
    """Margins of the falls that did not happen, by failure; infinite where none is known."""
    failed: Scalar
    """The margin of the fall that happened; NaN if none did."""
    pulled: Bool[Array, ""]
    """Whether the stride began with a condition that was violated."""
    conditions: Leasts
    held: dict[str, Scalar]
    """The least of values above zero that had to hold where guards rose, by failure."""
    lost: dict[str, Scalar]
    """The least of the others; infinite if all held."""


def nothing_violated(modes: dict[str, Mode], zero: Scalar) -> Leasts:
    """Return the conditions of modes before the first one begins."""
    names = [*dict.fromkeys(one.leads_to for mode in modes.values() for one in mode.conditions)]
    above, no = zero + jnp.inf, jnp.asarray(False)
    return Leasts(*(dict.fromkeys(names, one) for one in (above, -above, no)))


def nothing_measured(walker: HybridSystem, modes: dict[str, Mode], zero: Scalar) -> Measured:
    """Return the margins of a stride before the first of its modes."""
    numbers, above, every = failures_by_name(walker), zero + jnp.inf, modes.values()
    guards = [guard for mode in every for guard in mode.guards]
    ends = [Outcome.FORWARD.name if one.leads_to == SECTION else one.leads_to for one in guards]
    falls = dict.fromkeys([name for name in ends if name in numbers], above)
    held = dict.fromkeys([one.leads_to for guard in guards for one in guard.must_hold], above)
    conditions = nothing_violated(modes, zero)
    return Measured(falls, above * jnp.nan, jnp.asarray(False), conditions, held, dict(held))


def lower(margins: dict[str, Scalar], of: str, value: Scalar) -> None:
    """Lower the margin of a failure to a value, if that is smaller."""
    margins[of] = jnp.minimum(margins[of], value) if of in margins else value


def add_part(known: Measured, part: ModeResult, walker: HybridSystem, unit: Scalar) -> Measured:
    """Add a measured mode to the margins of the modes before; `unit` is a typical time."""
    numbers, guards = failures_by_name(walker), guards_of(part)
    passed, held, lost = dict(known.passed), dict(known.held), dict(known.lost)
    failed, pulled = fall_margin(part, guards, numbers, unit, known.failed), known.pulled
    for i, one in enumerate(guards):
        took = part.taken == i
        if one.guard.leads_to in numbers:
            greatest = jnp.maximum(one.before, jnp.where(took, -jnp.inf, one.end))
            lower(passed, one.guard.leads_to, guard_margin(one.guard, greatest, part.followed))
        elif one.guard.leads_to in (SECTION, LOWER):
            # A foot that comes down on lower ground has passed the level of the other foot before.
            lower(passed, Outcome.FORWARD.name, strike_margin(part, one, i))
        for held_one in one.guard.must_hold:
            value = held_one.value(part.end.state)
            lower(held, held_one.leads_to, jnp.where(took & (value > 0), value, jnp.inf))
            lower(lost, held_one.leads_to, jnp.where(took & (value <= 0), value, jnp.inf))
    for one in part.mode.conditions:
        if one.at_start:
            here = ~pulled & part.reached & (part.begun == numbers[one.leads_to])
            failed = jnp.where(here, one.value(part.start), failed)
            pulled |= here
    conditions = add_conditions(known.conditions, part, numbers)
    return Measured(passed, failed, pulled, conditions, held, lost)


def measure_stride(
    walker: HybridSystem, first: Mode, course: Course, known: Measured, stride: Stride
) -> Margins:
    """Return the margins of a measured stride. The next stride begins in the `first` mode."""
    numbers, outcome = failures_by_name(walker), stride.outcome
    struck = course.verdict == Outcome.STRIDE
    infinite = jnp.full_like(course.time, jnp.inf)
    passed, failed = dict(known.passed), known.failed
    following = walker.begin(course.entries[SECTION].state)
    for guard in reversed(first.guards):
        if guard.at_once and guard.leads_to in numbers:
            value = guard.value(following)
            ends = struck & (outcome == numbers[guard.leads_to]) & (value >= 0)
            failed = jnp.where(ends, -guard.measure(-value), failed)
            lower(passed, guard.leads_to, guard_margin(guard, value, outcome == Outcome.STRIDE))

    # conditions
    violated = jnp.asarray(False)
    for of in sorted(course.violated, key=numbers.__getitem__, reverse=True):
        broken = course.violated[of]
        least, before = known.conditions.value[of], known.conditions.miss[of]
        lower(passed, of, jnp.where(struck, least, infinite))
        ends = struck & broken & (outcome == numbers[of])
        failed = jnp.where(ends, jnp.maximum(least, before), failed)
        violated |= broken

    # after guards
    least = infinite
    for of, value in known.held.items():
        lower(passed, of, jnp.where(violated, infinite, value))
        ends = outcome == numbers[of]
        least = jnp.minimum(least, jnp.where(ends, known.lost[of], infinite))
    failed = jnp.where(jnp.isfinite(least), least, failed)

    # A failed margin is above zero by rounding alone, which has no part in its derivatives.
    failed -= lax.stop_gradient(jnp.maximum(failed, 0))
    began = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED) & ~known.pulled
    for of, value in passed.items():
        value = jnp.where(began & jnp.isfinite(value), value, jnp.nan)
        passed[of] = jnp.where(outcome == numbers[of], failed, value)
    fails = (outcome != Outcome.STRIDE) & (outcome != Outcome.UNDECIDED)
    return Margins(stride, jnp.where(fails, failed, jnp.nan), passed)


class GuardEnds(NamedTuple):
    """A guard at the two ends of a part of a stride."""

    guard: Guard
    start: Scalar
    """Value at the start."""
    before: Scalar
    """Greatest value before the end, where the guard is admitted."""
    end: Scalar
    """Value at the end; minus infinity where the guard is not admitted."""
    rate: Scalar
    """Rate at the end."""
    admits: Scalar
    """Least of the functions that admit the guard at the end; infinite if there are none."""


def guards_of(part: ModeResult) -> list[GuardEnds]:
    state, found = part.end.state, []
    for guard, nearest in zip(part.mode.guards, part.end.misses.nearest, strict=True):

        def look(state, guard=guard):
            """Return the value, and the least of the functions that admit it."""
            value = guard.value(state)
            least = jnp.full_like(value, jnp.inf)
            for one in guard.admits:
                least = jnp.minimum(least, one(state))
            return value, least

        # A value counts where it is admitted and has not risen.
        below = lambda value, admit: jnp.where((value < 0) & (admit > 0), value, -jnp.inf)
        start, admit = look(part.start)
        (end, admits), (rate, _) = jax.jvp(look, (state,), (part.mode.rates(state),))
        before = jnp.maximum(nearest, below(start, admit))
        found.append(GuardEnds(guard, start, before, below(end, admits), rate, admits))
    return found


def guard_margin(guard: Guard, greatest: Scalar, known: Bool[Array, ""]) -> Scalar:
    """Return the margin of a guard that has not risen; infinite unless its value is `known`."""
    known &= jnp.isfinite(greatest)
    return jnp.where(known, guard.measure(jnp.where(known, greatest, -1)), jnp.inf)


def fall_margin(
    part: ModeResult, known: list[GuardEnds], numbers: Numbers, unit: Scalar, margin: Scalar
) -> Scalar:
    """Return the margin of the fall that ended a part of a stride, or else the given margin.

    It is the least change that would have prevented the fall. The guard of the fall would not have
    risen if its rate were zero: -(rate unit)^2 / 2; nor if the rise were not admitted. The mode
    would have ended before if a guard that leads on had risen at its nearest miss, or rose now. A
    mode that begins with a fall has minus the guard's value.
    """
    late = jnp.full_like(margin, -jnp.inf)
    for one, nearest in zip(known, part.end.misses.nearest, strict=True):
        if one.guard.leads_to not in numbers:
            late = jnp.maximum(late, jnp.maximum(nearest, one.end))
    for i, one in enumerate(known):
        if (of := one.guard.leads_to) not in numbers:
            continue
        begins = part.reached & (part.begun == numbers[of]) & one.guard.at_once & (one.start >= 0)
        due = jnp.fmin(margin, -one.guard.measure(-one.start))  # the least of several
        over = jnp.maximum(-((one.rate * unit) ** 2) / 2, -one.admits)
        margin = jnp.where(begins, due, margin)
        margin = jnp.where(part.taken == i, jnp.maximum(over, late), margin)
    return margin


def strike_margin(part: ModeResult, known: GuardEnds, number: int) -> Scalar:
    """Return the margin by which a guard has ended a mode; infinite if it has not.

    It would not have risen if the foot had not passed the contact before, or had not been ahead; or
    if the foot came up again at once and had not come down as deep.
    """
    depth, height = part.end.misses.depth[number], part.end.misses.height[number]
    passed = jnp.where(depth > 0, depth, jnp.inf)
    margin = jnp.minimum(jnp.minimum(passed, height), known.admits)
    return jnp.where(part.taken == number, margin, jnp.inf)


def add_conditions(known: Leasts, part: ModeResult, numbers: Numbers) -> Leasts:
    """Add the conditions of a measured mode to those of the modes before."""
    values, nearest_misses, violated = map(dict, known)
    misses, guards = part.end.misses, part.mode.guards
    for condition in part.mode.conditions:
        of = condition.leads_to
        value, at_end = misses.least[of], condition.value(part.end.state)
        if not condition.zero_at_start:
            value = jnp.minimum(value, condition.value(part.start))
        for i, guard in enumerate(guards):
            if of in guard.makes_zero:
                at_end = jnp.where(part.taken == i, jnp.inf, at_end)
        value = jnp.minimum(value, at_end)
        values[of] = jnp.where(part.followed, jnp.minimum(values[of], value), values[of])
        for guard, nearest in zip(guards, misses.before[of], strict=True):
            if guard.leads_to not in numbers:
                miss = nearest_misses[of]
                nearest_misses[of] = jnp.where(violated[of], miss, jnp.maximum(miss, nearest))
        violated[of] |= part.end.violated[of]
    return Leasts(values, nearest_misses, violated)
