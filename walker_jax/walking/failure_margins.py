"""Margins by which a stride misses each way to fail.

A margin is a smooth function of start and parameters. It is positive where the walker passes, and
zero on the boundary to a failure. The guards and conditions of the modes of a stride define it, for
all walkers alike (`hybrid.misses`):

- for a fall that does not happen, it is the greatest value of its guard, up to the end of the
  stride and just after its impact; for a heel strike that happens, by how little it happened;
- for a fall that happens, it is the least change that would have prevented it: the rate at which
  its guard rises, or the miss of an earlier heel strike;
- for a condition, it is its least value.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import Integrator, zero_at
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import OWN, Outcome, Stride
from walker_jax.systems.system import System, apply_map
from walker_jax.walking.courses import Course, Numbers, Part, end_course, follow_modes
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.starts import during_stride, on_section, prepare
from walker_jax.walking.stride import check_entered_once, first_of, modes_from, start_course

WAYS = {
    Outcome.BACKWARD: "backward",
    Outcome.FORWARD: "forward",
    Outcome.RUNNING: "running",
    Outcome.STOPPED: "stopping",
    Outcome.BENT_KNEE: "landing",
    Outcome.BUCKLED: "buckling",
    Outcome.SCUFFED: "scuffing",
    Outcome.SIDEWAYS: "sideways",
    Outcome.OUTSIDE: "outside",
}
"""The margin of each way to fail; that of a system's own failures is `own`."""


class Margins(NamedTuple):
    """A stride, and the margins by which it misses each way to fail; NaN where none applies.

    A failure's own margin is negative. Margins of falls that did not happen before it are positive,
    and margins of conditions are known where there was a heel strike.
    """

    stride: Stride
    backward: Float[Array, "*cells"]
    """In the plane, thetadot^2 / 2 where the stance leg is slowest, after the impact too. In space,
    the least distance of theta from pi/2."""
    forward: Float[Array, "*cells"]
    """The least of three: the depth to which the swing foot passes the contact, -h; how far ahead
    it comes down (`is_ahead`); and how far the leg then is from the ground, theta + pi/2."""
    running: Float[Array, "*cells"]
    """The least contact force Q_v up to heel strike; or that at the start, if it is negative."""
    stopping: Float[Array, "*cells"]
    """Velocity v of the trailing foot after the impact."""
    landing: Float[Array, "*cells"]
    """The least height of a foot in front while it must not come down, as the knee is bent."""
    buckling: Float[Array, "*cells"]
    """The least moment that presses the stance knee on its stop, up to heel strike."""
    scuffing: Float[Array, "*cells"]
    """The least height of the bent leg's foot, up to heel strike. In space, the height at which the
    swing disc turns upwards."""
    sideways: Float[Array, "*cells"]
    """In space, the least of (l^2 - lean^2) / 2l, with l the limit of the lean: near the limit, the
    distance from it."""
    outside: Float[Array, "*cells"]
    """Margin by which the start is feasible, where a system defines it (`System.margin`)."""
    own: Float[Array, "*cells"]
    """The least margin of the system's own `failures`."""


def margins(
    walker: System,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
) -> Margins:
    """Follow one stride, as `stride` does, and measure its margins.

    Arguments and errors are those of `stride`. First derivatives are exact. Margins are smooth
    except where the instant that determines them jumps.

    ```python
    found = wj.margins(wj.SimplestWalker(0.004), (0.2, -0.2))
    found.backward, found.forward  # both positive: the walker makes the stride
    ```
    """
    return follow_margins(*prepare(walker, x, tolerance))


@refuses_tracers("within them use jax.vmap(lambda x: wj.margins(walker, x))(xs)")
def margins_of_many(
    walker: System,
    xs: Float[ArrayLike, "n coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Margins:
    """Compute `margins` for each of n starts, with one walker or n, as in `strides`."""
    return for_each_start(follow_margins, walker, xs, tolerance, progress=progress)


def failure_margin(found: Margins) -> Scalar:
    """Return the margin of the failure that ended a stride, NaN for none; no batch axis."""
    by = jnp.full_like(found.backward, jnp.nan)
    outcome = found.stride.outcome
    for way, name in WAYS.items():
        by = jnp.where(outcome == way, getattr(found, name), by)
    return jnp.where(outcome >= OWN, found.own, by)


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
    check_entered_once(walker, modes, "margins")
    course = follow_modes(walker, modes, start_course(walker, modes, x), integrator, measured=True)
    stride = end_course(walker, first_of(modes), course)
    course_modes, ways = [part.mode for part in course.parts], [part[1:] for part in course.parts]

    def measure(walker, stride, course, ways):
        parts = tuple(Part(mode, *way) for mode, way in zip(course_modes, ways, strict=True))
        course = course._replace(parts=parts)
        known = measure_stride(walker, first_of(modes), course, stride.outcome)
        if walker.margin(x[: len(walker.section)]) is not None:
            led_outside = (stride.outcome == Outcome.OUTSIDE) & walker.feasible(x)
            start = margin_of_start(walker, x)
            known["outside"] = jnp.where(led_outside, known["outside"], start)
        return Margins(stride, **known)

    return with_fast_sincos(measure)(walker, stride, course._replace(parts=()), ways), course


def measure_map(walker: System, x: Float[Array, " section"]) -> Margins:
    """Measure a map: the margin that the system defines is that of the failure that happens."""
    stride, margin = apply_map(walker, x), margin_of_start(walker, x)
    if_failed = lambda failed: jnp.where(failed, margin, jnp.nan)
    ways = {name: if_failed(stride.outcome == way) for way, name in WAYS.items()}
    return Margins(stride, **ways | {"outside": margin, "own": if_failed(stride.outcome >= OWN)})


def margin_of_start(walker: System, x: Float[Array, " coordinates"]) -> Scalar:
    """Return `System.margin`; NaN where there is none."""
    known = walker.margin(x) if on_section(walker, x) else None
    return jnp.sum(x) * jnp.nan if known is None else known


def judged_ends(parts: tuple[Part, ...]) -> list[tuple[str, Bool[Array, ""], Scalar]]:
    """Return what must hold after guards: its failure, whether that is asked, and its value."""
    return [
        (one.leads_to, part.taken == i, one.value(part.end.state))
        for part in parts
        for i, guard in enumerate(part.mode.guards)
        for one in guard.must_hold
    ]


def measure_stride(
    walker: HybridSystem, first: Mode, course: Course, outcome: Array
) -> dict[str, Scalar]:
    """Return the margins of a measured stride of known outcome, by name.

    The next stride begins in the `first` mode.
    """
    parts, numbers = course.parts, failures_by_name(walker)
    struck = course.verdict == Outcome.STRIDE
    infinite = jnp.full_like(course.time, jnp.inf)

    known = [guards_of(part) for part in parts]
    failed = fall_margin(parts, numbers, known, zero_at(parts[0].start) + walker.unit_of_time())
    greatest: dict[str, tuple[Scalar, Guard]] = {}
    following = walker.begin(course.entries[SECTION].state)
    for guard in reversed([one for one in failing(first, numbers) if one.at_once]):
        value = guard.value(following)
        ends = struck & (outcome == numbers[guard.leads_to]) & (value >= 0)
        failed = jnp.where(ends, -guard.measure(-value), failed)
        value = jnp.where(outcome == Outcome.STRIDE, value, -infinite)
        before, _ = greatest.get(guard.leads_to, (-infinite, guard))
        greatest[guard.leads_to] = jnp.maximum(before, value), guard
    for part, each in zip(parts, known, strict=True):
        for i, guard in enumerate(part.mode.guards):
            if guard.leads_to not in numbers:
                continue
            value, _ = greatest.get(guard.leads_to, (-infinite, guard))
            at_end = jnp.where(part.taken == i, -jnp.inf, each.end[i])
            here = jnp.where(part.followed, jnp.maximum(each.before[i], at_end), -jnp.inf)
            greatest[guard.leads_to] = jnp.maximum(value, here), guard
    passed = {of: margin_of(guard, value) for of, (value, guard) in greatest.items()}
    for part, each in zip(parts, known, strict=True):
        if part.mode.guards[-1].leads_to == SECTION:
            lesser(passed, Outcome.FORWARD.name, strike_margin(part, each))

    # conditions
    violated = jnp.asarray(False)
    for of in sorted(course.violated, key=numbers.__getitem__, reverse=True):
        broken = course.violated[of]
        least, before = least_value(parts, of)
        lesser(passed, of, jnp.where(struck, least, infinite))
        ends = struck & broken & (outcome == numbers[of])
        failed = jnp.where(ends, jnp.maximum(least, before), failed)
        violated |= broken
    pulled, force = conditions_at_start(parts, numbers)
    failed = jnp.where(pulled, force, failed)

    # after guards
    least = infinite
    for of, asked, value in judged_ends(parts):
        lesser(passed, of, jnp.where(asked & ~violated & (value > 0), value, infinite))
        ends = asked & (outcome == numbers[of]) & (value <= 0)
        least = jnp.minimum(least, jnp.where(ends, value, infinite))
    failed = jnp.where(jnp.isfinite(least), least, failed)

    began = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED) & ~pulled
    return margins_by_name(walker, passed, failed, began, outcome)


def failing(mode: Mode, numbers: Numbers) -> list[Guard]:
    """Return the guards of a mode that lead to failures."""
    return [guard for guard in mode.guards if guard.leads_to in numbers]


def lesser(margins: dict[str, Scalar], of: str, value: Scalar) -> None:
    """Lower the margin of a failure to a value, if that is smaller."""
    margins[of] = jnp.minimum(margins[of], value) if of in margins else value


def margins_by_name(
    walker: HybridSystem,
    passed: dict[str, Scalar],
    failed: Scalar,
    began: Bool[Array, ""],
    outcome: Int[Array, ""],
) -> dict[str, Scalar]:
    """Return the margins by name, from those of passed failures and that of the failed one.

    They are NaN for failures that the stride cannot have had. If it never `began`, only the margin
    of the failure that happened is known.
    """
    margins = {"own": jnp.full_like(failed, jnp.nan)}
    for of, number in failures_by_name(walker).items():
        if number >= OWN and of not in passed:
            continue
        name = WAYS.get(Outcome(number), "own" if number >= OWN else None)
        if name is None:
            continue
        value = passed.get(of, jnp.full_like(failed, jnp.inf))
        value = jnp.where(began & jnp.isfinite(value), value, jnp.nan)
        value = jnp.where(outcome == number, not_above_zero(failed), value)
        margins[name] = lesser_known(margins[name], value) if name in margins else value
    return margins


def lesser_known(one: Scalar, other: Scalar) -> Scalar:
    """Return the smaller of two margins; either may be NaN."""
    return jnp.where(jnp.isnan(one) | (other < one), other, one)


class Guards(NamedTuple):
    """The guards of a part of a stride, at its two ends; each field has an entry for each guard."""

    start: list[Scalar]
    """Value at the start."""
    before: list[Scalar]
    """Greatest value before the end, where the guard is admitted."""
    end: list[Scalar]
    """Value at the end; minus infinity where the guard is not admitted."""
    rates: list[Scalar]
    """Rate at the end."""
    admits: list[Scalar]
    """Least of the functions that admit the guard at the end; infinite if there are none."""


def guards_of(part: Part) -> Guards:
    def look(state):
        """Return values, and the least of the functions that admit each."""
        values, admits = [], []
        for guard in part.mode.guards:
            values.append(guard.value(state))
            least = jnp.full_like(values[-1], jnp.inf)
            for one in (*guard.admits, *guard.admits_at_rise):
                least = jnp.minimum(least, one(state))
            admits.append(least)
        return values, admits

    def below(values, admits):
        """Return values of guards that are admitted and have not risen."""
        both = zip(values, admits, strict=True)
        return [jnp.where((value < 0) & (admit > 0), value, -jnp.inf) for value, admit in both]

    start, admits = look(part.start)
    before = list(map(jnp.maximum, part.end.misses.nearest, below(start, admits)))
    state = part.end.state
    (end, admits), (rates, _) = jax.jvp(look, (state,), (part.mode.rates(state),))
    return Guards(start, before, below(end, admits), rates, admits)


def fall_margin(
    parts: tuple[Part, ...], numbers: Numbers, guards: list[Guards], unit: Scalar
) -> Scalar:
    """Return the margin of the fall that ended a stride before heel strike; NaN if none did.

    It is the least change that would have prevented the fall. The guard of the fall would not have
    risen if its rate were zero: -(rate unit)^2 / 2; nor if the rise were not admitted. The mode
    would have ended before if a guard that leads on had risen at its nearest miss, or rose now. A
    stride that starts with a fall, or has one after an impact, has minus the guard's value.
    """
    margin = jnp.full_like(unit, jnp.nan)
    for part, known in zip(parts, guards, strict=True):
        late = jnp.full_like(unit, -jnp.inf)
        for i, guard in enumerate(part.mode.guards):
            if guard.leads_to not in numbers:
                late = jnp.maximum(late, jnp.maximum(part.end.misses.nearest[i], known.end[i]))
        for i, guard in enumerate(part.mode.guards):
            if guard.leads_to not in numbers:
                continue
            begins = part.reached & (part.begun == numbers[guard.leads_to])
            margin = jnp.where(begins, -guard.measure(-known.start[i]), margin)
            over = jnp.maximum(-((known.rates[i] * unit) ** 2) / 2, -known.admits[i])
            margin = jnp.where(part.taken == i, jnp.maximum(over, late), margin)
    return margin


def margin_of(guard: Guard, greatest: Scalar) -> Scalar:
    """Return the margin of a guard that has not risen; infinite if nothing is known of it."""
    known = jnp.isfinite(greatest)
    return jnp.where(known, guard.measure(jnp.where(known, greatest, -1)), jnp.inf)


def strike_margin(swing: Part, known: Guards, last: int = -1) -> Scalar:
    """Return the margin by which the last guard, or another of its value, has ended a mode, or inf.

    It would not have happened if the foot had not passed the contact before, or had not been ahead;
    or if the foot came up again at once and had not come down as deep.
    """
    depth, height = swing.end.misses.depth, swing.end.misses.height
    passed = jnp.where(depth > 0, depth, jnp.inf)
    margin = jnp.minimum(jnp.minimum(passed, height), known.admits[last])
    return jnp.where(swing.taken == len(swing.mode.guards) + last, margin, jnp.inf)


def least_value(parts: tuple[Part, ...], of: str) -> tuple[Scalar, Scalar]:
    """Return the least value of a condition up to heel strike, and the miss nearest to zero.

    The miss is one of the last guard of a mode before the condition was violated.
    """
    infinite = zero_at(parts[0].start) + jnp.inf
    least, before, broken = infinite, -infinite, jnp.asarray(False)
    for part in parts:
        for condition in part.mode.conditions:
            if condition.leads_to != of:
                continue
            value, ends = part.end.misses.least[of], (part.start, part.end.state)
            for state, is_zero in zip(ends, condition.zero_at_ends, strict=True):
                value = value if is_zero else jnp.minimum(value, condition.value(state))
            least = jnp.where(part.followed, jnp.minimum(least, value), least)
            before = jnp.where(broken, before, jnp.maximum(before, part.end.misses.before[of]))
            broken |= part.end.violated[of]
    return least, before


def conditions_at_start(
    parts: tuple[Part, ...], numbers: Numbers
) -> tuple[Bool[Array, ""], Scalar]:
    """Return whether a stride is over at once since a condition is negative, and its value then."""
    value, pulled = zero_at(parts[0].start) + jnp.nan, jnp.asarray(False)
    for part in parts:
        for one in part.mode.conditions:
            if one.at_start:
                here = ~pulled & part.reached & (part.begun == numbers[one.leads_to])
                value = jnp.where(here, one.value(part.start), value)
                pulled |= here
    return pulled, value


def not_above_zero(margin: Scalar) -> Scalar:
    """Remove the positive rounding error of a failed margin, and keep the derivative."""
    return margin - lax.stop_gradient(jnp.maximum(margin, 0))
