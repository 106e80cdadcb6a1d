"""By how much a stride misses each way to fail.

A margin is a smooth function of start and parameters that is positive where the walker passes, and
zero on the boundary to a failure. The guards and conditions of the modes of a stride define it, for
all walkers alike (`hybrid.misses`):

- a fall that does not happen is missed by the greatest value of its guard, up to the end of the
  stride and just after its impact; a heel strike that does happen by how little it was one;
- a fall that happens has happened by the least of what would have prevented it: by how fast its
  guard rises, or by how much a heel strike was missed before;
- a condition has its least value.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.modes import Guard
from walker_jax.integrators.solvers import Real
from walker_jax.integrators.taylor import with_fast_sincos
from walker_jax.kernels import by_kernel
from walker_jax.walkers.model import Scalar, Walker, is_planar, toppling_rate
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.outcomes import Outcome, Stride
from walker_jax.walking.phases import Arrival, Part, follow_to_heel_strike
from walker_jax.walking.stepping import begin_stride, during_stride, end_stride, on_section, prepare

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


class Margins(NamedTuple):
    """A stride, and by how much it misses each way to fail; NaN for what never came up.

    In a failure its own margin is negative. Those of the falls that did not happen before are
    positive, and those of conditions are known where there was a heel strike.
    """

    stride: Stride
    backward: Float[Array, "*cells"]
    """In the plane, thetadot^2 / 2 where the stance leg is slowest, after the impact too. In space,
    the least distance of theta from pi/2."""
    forward: Float[Array, "*cells"]
    """Of the depth to which the swing foot passes the contact, -h, of how far ahead it comes down
    (`is_ahead`) and of how far the leg then is from the ground, theta + pi/2, the least."""
    running: Float[Array, "*cells"]
    """The least contact force Q_v up to heel strike; or that at the start, where it is negative."""
    stopping: Float[Array, "*cells"]
    """Velocity v of the trailing foot after the impact."""
    landing: Float[Array, "*cells"]
    """The least height of a foot in front while it must not come down, as the knee is bent."""
    buckling: Float[Array, "*cells"]
    """The least moment that presses the stance knee on its stop, up to heel strike."""
    scuffing: Float[Array, "*cells"]
    """The least height of the bent leg's foot, up to heel strike. In space, that at which the swing
    disc turns upwards."""
    sideways: Float[Array, "*cells"]
    """In space: the least distance of the lean from its limits."""


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


@by_kernel
def follow_margins(
    walker: Walker, x: Float[Array, " coordinates"], tolerance: Float[Array, ""]
) -> Margins:
    walker, launched = during_stride(walker, x), not on_section(walker, x)
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    arrival = follow_to_heel_strike(
        walker, start, verdict, tolerance, launched=launched, measured=True
    )
    modes = [part.mode for part in arrival.parts]
    ways = [part[1:] for part in arrival.parts]
    arrival = arrival._replace(parts=())
    stride = with_fast_sincos(end_stride)(walker, arrival)

    def measure(walker, arrival, ways, outcome):
        parts = tuple(Part(mode, *way) for mode, way in zip(modes, ways, strict=True))
        return measure_stride(walker, arrival._replace(parts=parts), outcome)

    return Margins(stride, **with_fast_sincos(measure)(walker, arrival, ways, stride.outcome))


def measure_stride(walker: Walker, arrival: Arrival, outcome: Array) -> dict[str, Scalar]:
    """The margins of a stride that was measured, by name, whose outcome is known."""
    parts, guards = arrival.parts, arrival.parts[-1].mode.guards
    struck = arrival.verdict == Outcome.STRIDE
    (_, lift), after = walker.impact(arrival.state)
    following = walker.exchange_legs(after)
    infinite = jnp.full_like(lift, jnp.inf)

    # falls
    failed = fall_margin(parts, time_scale(walker))
    greatest: dict[int, tuple[Scalar, Guard]] = {}
    for guard in guards[:-1]:
        value = guard.value(following)
        failed = jnp.where(struck & (outcome == guard.leads_to), -guard.measure(-value), failed)
        known = jnp.where(outcome == Outcome.STRIDE, value, -infinite)
        greatest[int(guard.leads_to)] = known, guard
    for part in parts:
        for i, guard in enumerate(part.mode.guards[:-1]):
            known, _ = greatest.get(int(guard.leads_to), (-infinite, guard))
            greatest[int(guard.leads_to)] = jnp.maximum(known, greatest_value(part, i)), guard
    passed = {of: margin_of(guard, value) for of, (value, guard) in greatest.items()}
    forward = int(Outcome.FORWARD)
    passed[forward] = jnp.minimum(passed.get(forward, infinite), strike_margin(parts[-1], struck))

    # conditions
    violated = jnp.asarray(False)
    for of, broken in reversed(arrival.violated.items()):
        least, before = least_value(parts, of)
        value = jnp.where(struck, least, infinite)
        passed[of] = jnp.minimum(passed.get(of, infinite), value)
        ends = struck & broken & (outcome == of)
        failed = jnp.where(ends, jnp.maximum(least, before), failed)
        violated |= broken
    pulled = ~struck & (outcome == Outcome.RUNNING)
    failed = jnp.where(pulled, force_at_start(parts), failed)

    stopped = int(Outcome.STOPPED)
    passed[stopped] = jnp.where(struck & ~violated, lift, passed.get(stopped, infinite))
    failed = jnp.where(struck & (outcome == stopped), lift, failed)

    began = (outcome != Outcome.OUTSIDE) & (outcome != Outcome.UNDECIDED) & ~pulled
    margins = {}
    for way, name in WAYS.items():
        value = passed.get(int(way), infinite)
        value = jnp.where(began & jnp.isfinite(value), value, jnp.nan)
        margins[name] = jnp.where(outcome == way, not_above_zero(failed), value)
    return margins


def time_scale(walker: Walker) -> Scalar:
    """The time in which a walker topples, legs together, to first order."""
    return 1 / toppling_rate(walker) if is_planar(walker) else jnp.sqrt(walker.leg_length)


def fall_margin(parts: tuple[Part, ...], unit: Scalar) -> Scalar:
    """The margin of the fall that ended a stride before heel strike; NaN if none did.

    It is the least of what would have prevented it. The guard of the fall would not have risen if
    its rate were zero: -(rate unit)^2 / 2; or not if that were not admitted. The mode would have
    ended before if its last guard had risen where it missed to, or rises now. A stride that starts
    with a fall, or has one after an impact, has minus the guard's value.
    """
    margin = jnp.full_like(unit, jnp.nan)
    ended = jnp.asarray(True)
    for part in parts:
        guards, state = part.mode.guards, part.end.state
        late = jnp.maximum(part.end.misses.nearest[-1], value_where_admitted(guards[-1], state))
        for i, guard in enumerate(guards[:-1]):
            begins = ended & (part.verdict == guard.leads_to)
            margin = jnp.where(begins, -guard.measure(-guard.value(part.start)), margin)
            _, rate = jax.jvp(guard.value, (state,), (part.mode.rates(state),))
            value = jnp.maximum(-((rate * unit) ** 2) / 2, late)
            for one in (*guard.admits, *guard.admits_at_rise):
                value = jnp.maximum(value, -one(state))
            margin = jnp.where(part.end.guard == i, value, margin)
        ended = (part.end.guard == len(guards) - 1) | (part.verdict == Outcome.STRIDE)
    return margin


def greatest_value(part: Part, i: int) -> Scalar:
    """The greatest value of a guard in a mode that it did not end, both ends included."""
    guard, end = part.mode.guards[i], part.end
    at_end = jnp.where(end.guard == i, -jnp.inf, value_where_admitted(guard, end.state))
    at_ends = jnp.maximum(value_where_admitted(guard, part.start), at_end)
    followed = part.verdict == Outcome.UNDECIDED
    return jnp.where(followed, jnp.maximum(end.misses.nearest[i], at_ends), -jnp.inf)


def value_where_admitted(guard: Guard, state: Any) -> Scalar:
    """The value of a guard that has not risen; minus infinity where it would not be admitted."""
    value = guard.value(state)
    counts = value < 0
    for one in (*guard.admits, *guard.admits_at_rise):
        counts &= one(state) > 0
    return jnp.where(counts, value, -jnp.inf)


def margin_of(guard: Guard, greatest: Scalar) -> Scalar:
    """The margin of a guard that has not risen; infinite if nothing is known of it."""
    known = jnp.isfinite(greatest)
    return jnp.where(known, guard.measure(jnp.where(known, greatest, -1)), jnp.inf)


def strike_margin(swing: Part, struck: Bool[Array, ""]) -> Scalar:
    """By how much the heel strike was one; infinite if there was none.

    It would not have been if the foot had not passed the contact before, or not been ahead; or if
    it came up again at once and had not come down as deep.
    """
    misses, guard = swing.end.misses, swing.mode.guards[-1]
    margin = jnp.where(misses.depth > 0, misses.depth, jnp.inf)
    for one in guard.admits:
        margin = jnp.minimum(margin, one(swing.end.state))
    return jnp.where(struck, jnp.minimum(margin, misses.height), jnp.inf)


def least_value(parts: tuple[Part, ...], of: int) -> tuple[Scalar, Scalar]:
    """The least value of a condition up to heel strike, and the nearest miss before it was broken.

    A miss is that of the last guard of the mode.
    """
    least, before, broken = jnp.inf, -jnp.inf, jnp.asarray(False)
    for part in parts:
        followed = part.verdict == Outcome.UNDECIDED
        for condition in part.mode.conditions:
            if condition.outcome != of:
                continue
            value, ends = part.end.misses.least[of], (part.start, part.end.state)
            for state, is_zero in zip(ends, condition.zero_at_ends, strict=True):
                value = value if is_zero else jnp.minimum(value, condition.value(state))
            least = jnp.where(followed, jnp.minimum(least, value), least)
            before = jnp.where(broken, before, jnp.maximum(before, part.end.misses.before[of]))
            broken |= part.end.violated[of]
    return least, before


def force_at_start(parts: tuple[Part, ...]) -> Scalar:
    """The contact force in the state in which a stride begins to move."""
    force, later = jnp.nan, jnp.asarray(False)
    for part in parts:
        (value,) = [one.value for one in part.mode.conditions if one.outcome == Outcome.RUNNING]
        here = ~later & (part.verdict == Outcome.RUNNING)
        force = jnp.where(here, value(part.start), force)
        later |= here
    return force


def not_above_zero(margin: Scalar) -> Scalar:
    """The margin of what has happened, which only rounding puts above zero; same derivative."""
    return margin - lax.stop_gradient(jnp.maximum(margin, 0))
