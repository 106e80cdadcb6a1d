"""A mode of a hybrid system, followed to the guard that ends it.

`diffrax.diffeqsolve` makes steps as long as their method chooses (`step_loop`), until a step may
end the mode, by cheap bounds: that is its `Event`. Such a step is searched for the first admitted
rise of a guard; if there is none, diffrax goes on from there.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.hybrid.beginnings import begins_on_its_lower_side
from walker_jax.hybrid.crossings import Crossing, first_rise, may_rise
from walker_jax.hybrid.misses import (
    Misses,
    StepRecord,
    add_misses,
    dip_between,
    find_least,
    no_misses,
    with_rates,
)
from walker_jax.hybrid.modes import Condition, Guard, Mode, has_ended, value_at
from walker_jax.hybrid.modes_in_reverse import (
    carried_of,
    decided_of,
    find_in_reverse,
    find_measured_in_reverse,
)
from walker_jax.integrators.integrator import Memory, Method, zero_at
from walker_jax.integrators.roots import Scalar, derivative_of
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor import function_series, is_list
from walker_jax.kernels.reverse import Writer, reversing, zero_where_unused

FIRST_ORDER = 6
"""Order to which guards are expanded in every step, to exclude a rise. If that does not exclude
one, they are expanded in full."""
NO_GUARD, NOT_FOLLOWED = -1, -2
"""In place of a guard's number: none has ended the mode, or it was not followed."""
Violated = dict[str, Bool[Array, ""]]
"""Whether each condition was violated, by the failure to which it leads."""


class End(NamedTuple):
    """The end of a mode."""

    state: Any
    """State at the event, with its derivatives; without an event, where the integration gave up."""
    time: Scalar
    """Time since the start of the mode."""
    guard: Int[Array, ""]
    """Number of the guard that ended it. For an early exit it is the number of all guards; without
    an end, `NO_GUARD` or `NOT_FOLLOWED`."""
    violated: Violated
    """Conditions that were violated, at both ends of the mode too."""
    misses: Any
    """`Misses` of a mode that is measured, else None."""


class Step(NamedTuple):
    """A step of the integration."""

    start: Any
    end: Any
    time: Scalar
    """Time at its start."""
    length: Scalar
    below: list[Bool[Array, ""]]
    """Whether each guard is below zero at the start of the step."""
    ends_below: list[Bool[Array, ""]]
    """Whether it is at its end."""
    watched: list[tuple[tuple, tuple]]
    """Value and rate of each watched condition at both ends, unless the mode is measured."""
    quiet: Bool[Array, ""]
    """Whether the step certainly ends nothing."""
    memory: Memory
    """The method's memory, passed from step to step."""


class Unfinished(NamedTuple):
    """A mode up to some instant."""

    last: Step
    arrival: Any
    time: Scalar
    """Time of the event."""
    guard: Int[Array, ""]
    count: Int[Array, ""]
    violated: Violated
    misses: Misses | None


def follow_mode(
    mode: Mode,
    start: Any,
    going: Bool[Array, ""],
    method: Method,
    *,
    risen: Int[Array, ""] | None = None,
    measured: bool = False,
) -> End:
    """Follow a mode from a state to its end; do nothing unless `going`.

    Derivatives of the arrival are exact, of any order; past a kink of the equations, to the third.
    A guard that has just `risen` as the mode begins ends it there, with the derivatives of that
    event. If `measured`, every step is searched, and its misses are recorded.
    """
    in_reverse = reversing.value and method.is_series
    if in_reverse:
        method = method.in_reverse()
    find = partial(find_event, mode, going=going, method=method, risen=risen, measured=measured)
    go_on = lambda state: state
    if not in_reverse:
        last, _ = find(start)
    elif measured:
        rated, begun = begin_following(mode, start, going, method, measured)
        follow, guards = partial(follow_measured, rated, method), partial(along, rated)
        last = find_measured_in_reverse(rated, method, find, follow, guards, begun)
    else:
        last, go_on = find_in_reverse(mode, find, start, method)
    surface = partial(value_of_guard, mode, last.guard, surface=True)
    arrive = lambda state: method.refine_event(surface, go_on(state))
    refined, delay = zero_where_unused(arrive, last.arrival)
    ended = has_ended(mode, last.guard)
    keep = lambda new, old: jnp.where(ended, new, old)
    arrival = jax.tree.map(keep, refined, last.arrival)
    violated = dict(last.violated)
    for condition in mode.conditions:
        if condition.least_at_ends:  # others were evaluated as the arrival was found
            violated[condition.leads_to] |= going & condition.is_negative(arrival)
    time = last.time + keep(delay, zero_at(start))
    return End(arrival, time, last.guard, violated, last.misses)


def find_event(
    mode: Mode,
    start: Any,
    going: Bool[Array, ""],
    method: Method,
    risen: Int[Array, ""] | None,
    measured: bool,
    writer: Writer | None = None,
) -> tuple[Unfinished, list | None]:
    """Find the first event of a mode that begins in a state; return the tapes of a writer too."""
    mode, begun = begin_following(mode, start, going, method, measured)
    if risen is not None:
        begun = begun._replace(guard=jnp.where(risen >= 0, risen, begun.guard))
    return integrate_mode(mode, method, begun, measured=measured, writer=writer)


def integrate_mode(
    mode: Mode,
    method: Method,
    begun: Unfinished,
    *,
    measured: bool,
    writer: Writer | None = None,
) -> tuple[Unfinished, list | None]:
    """Make steps from some instant of a mode to its first event, and find it."""
    from walker_jax.integrators.step_loop import make_steps  # which loads diffrax

    def unfinished(carry):
        now, _ = carry
        finite = jnp.isfinite(now.last.time + now.last.length)
        return (now.guard == NO_GUARD) & (now.count < mode.most_steps) & finite

    def follow(carry):
        now, tapes = carry
        if measured:
            found, seen = follow_measured(mode, method, now)
            if writer is not None:
                known = carried_of(now), decided_of(found, seen)
                tapes = writer.put(tapes, now.count, *known)
            return found, tapes

        def step(carry):
            last, number, tapes = carry
            made = next_step(mode, method, last, violated=now.violated)
            if writer is not None:
                row = (made.start, made.time), made.memory.control
                number, tapes = number + 1, writer.put(tapes, number, *row)
            return made, number, tapes

        # In a batch, lanes that have ended wait here for the others.
        quiet, going = lambda carry: carry[0].quiet, now.guard == NO_GUARD
        first = now.last, writer and now.count, tapes
        (last, _, tapes), count = make_steps(step, first, quiet, going, now.count, mode.most_steps)
        return search_step(mode, method, now._replace(last=last, count=count))[0], tapes

    return lax.while_loop(unfinished, follow, (begun, writer and writer.tapes))


def begin_following(
    mode: Mode, start: Any, going: Bool[Array, ""], method: Method, measured: bool
) -> tuple[Mode, Unfinished]:
    """Return the mode with the rates of its conditions, and its start: a step of no length."""
    if not method.is_series:  # whose steps alone are short enough for the proofs about guards
        mode = mode._replace(guards=tuple(one._replace(persists=False) for one in mode.guards))
    mode, zero = with_rates(mode, start), zero_at(start)
    below = [begins_on_its_lower_side(guard, method, start) for guard in mode.guards]
    violated, known = {one.leads_to: jnp.asarray(False) for one in mode.conditions}, []
    for one in mode.conditions:
        if one.least_at_ends:
            value = value_at(one.value, start)
        else:
            value, rate = one.and_rate(start)
            known.append(((value, rate), (value, rate)))
        if not one.zero_at_start:
            violated[one.leads_to] |= going & (value < 0)
    misses = no_misses(mode, start) if measured else None
    guard = jnp.where(going, NO_GUARD, NOT_FOLLOWED).astype(jnp.int32)
    # All coordinates have derivatives with respect to all others from the start on (`zero_at`).
    nothing = sum(0 * jnp.sum(x) for x in jax.tree.leaves(start))
    start = jax.tree.map(lambda x: x + nothing, start)
    memory, quiet = method.begin(start), jnp.asarray(True)
    first = Step(start, start, zero, zero, below, below, known, quiet, memory)
    return mode, Unfinished(first, start, zero, guard, jnp.asarray(0, int), violated, misses)


def follow_measured(mode: Mode, method: Method, now: Unfinished) -> tuple[Unfinished, StepRecord]:
    """Make a step of a measured mode, and search all of it."""
    last = measured_step(mode, method, now.last)
    return search_step(mode, method, now._replace(last=last, count=now.count + 1))


def next_step(mode: Mode, method: Method, step: Step, *, violated: Violated) -> Step:
    """Make the next step, and say whether it certainly ends nothing."""
    begins, below = step.end, step.ends_below
    series, end, length, memory = method.step(begins, step.memory)
    may, ends = ~jnp.isfinite(length), []
    known = along(mode, jax.tree.map(lambda c: c[: FIRST_ORDER + 1], series, is_leaf=is_list))
    for guard, side, (value, admits) in zip(mode.guards, below, known, strict=True):
        ends.append(side_at_end(guard, method, side, length, end))
        may |= rises_perhaps(guard, Crossing(value, admits, side, ends[-1]), length, end)
    seen = []
    for condition, (_, before) in zip(watched(mode), step.watched, strict=True):
        value, rate = after = condition.and_rate(end)
        turns = ((before[1] < 0) & (rate > 0)) | dip_between(before, after, length).exists
        may |= ((value < 0) | turns) & ~violated[condition.leads_to]
        seen.append((before, after))
    if mode.early_exit is not None:
        may |= value_at(mode.early_exit.holds, end)
    return Step(begins, end, step.time + step.length, length, below, ends, seen, ~may, memory)


def measured_step(mode: Mode, method: Method, step: Step) -> Step:
    """Make the next step, all of which is searched and recorded."""
    _, end, length, memory = method.step(step.end, step.memory)
    sides = zip(mode.guards, step.ends_below, strict=True)
    ends = [side_at_end(guard, method, below, length, end) for guard, below in sides]
    time, quiet = step.time + step.length, jnp.asarray(False)
    return Step(step.end, end, time, length, step.ends_below, ends, step.watched, quiet, memory)


def search_step(mode: Mode, method: Method, now: Unfinished) -> tuple[Unfinished, StepRecord]:
    """Find the first event in the last step, if there is one, and earlier violations."""
    last = now.last
    series = method.series_of(last.start, last.memory)
    crossings, whole = [], along(mode, series)
    sides = zip(last.below, last.ends_below, strict=True)
    for guard, polynomials, side in zip(mode.guards, whole, sides, strict=True):
        one = Crossing(*polynomials, *side)
        may = rises_perhaps(guard, one, last.length, last.end)
        crossings.append(one._replace(wanted=may))
    number, when = first_rise(crossings, last.length)
    until = jnp.minimum(when, last.length)
    event = partial(value_of_guard, mode, number)
    refined = method.refine_time(event, last.start, series, until, last.length)
    until = jnp.where(jnp.isfinite(when), refined, last.length)
    arrival, violated = method.state_at(last.start, series, until), dict(now.violated)
    seen = StepRecord(last.start, series, last.length, arrival, until, crossings, now.violated)
    misses = None if now.misses is None else add_misses(mode, now.misses, seen)
    if mode.early_exit is not None:
        exits = (number == NO_GUARD) & value_at(mode.early_exit.holds, last.end)
        number = jnp.where(exits, len(mode.guards), number)
    if not method.is_series:  # without a time of the event the motion is undecided
        number = jnp.where(jnp.isnan(until), NO_GUARD, number)
        last = last._replace(length=jnp.where(jnp.isnan(until), jnp.nan, last.length))
    for condition, (before, _) in zip(watched(mode), last.watched, strict=True):
        key = condition.leads_to
        if misses is not None:
            least, at_end = misses.least[key], value_at(condition.value, arrival)
        else:
            found = find_least(condition, seen, known=before, sign_alone=True)
            least, at_end = found.value, found.at_end
        for i, guard in enumerate(mode.guards):
            if key in guard.makes_zero:  # to rounding, or to the error of the time
                at_end = jnp.where(number == i, 0, at_end)
        violated[key] |= (least < 0) | (at_end < 0)
    time = last.time + until
    return Unfinished(last, arrival, time, number, now.count, violated, misses), seen


def watched(mode: Mode) -> list[Condition]:
    """Return the conditions that may be violated between the ends of a mode."""
    return [one for one in mode.conditions if not one.least_at_ends]


def along(mode: Mode, series: PyTree) -> list[tuple[list, list[list]]]:
    """Expand each guard's value and the functions that admit it."""
    functions = mode.functions()
    flat = [function for guard in functions for function in guard]
    found = function_series(lambda y: [one(y) for one in flat], lax.stop_gradient(series))
    pairs = []
    for guard in functions:
        (value, *admits), found = found[: len(guard)], found[len(guard) :]
        pairs.append((value, admits))
    return pairs


def side_at_end(
    guard: Guard, method: Method, below: Bool[Array, ""], length: Scalar, end: Any
) -> Bool[Array, ""]:
    """Return whether a guard is below zero at the end of a step that begins below it or not."""
    ends_below = value_at(guard.value, end) < 0
    if method.is_series:
        return ends_below
    return jnp.where(length == 0, below, ends_below)  # a step that is rejected changes no side


def rises_perhaps(guard: Guard, one: Crossing, length: Scalar, end: Any) -> Bool[Array, ""]:
    """Return whether a guard may rise in a step, by cheap bounds."""
    if not guard.persists:
        return may_rise(one.value, one.admits, length, one.below, one.ends_below)
    if guard.always_begins_below:
        return one.below & ~one.ends_below
    slope = evaluate_polynomial(derivative_of(one.value), length)
    rises = ~one.ends_below & (one.below | ((one.value[1] < 0) & (slope > 0)))
    for function, series in zip(guard.admits, one.admits, strict=True):
        rises &= (series[0] > 0) | (value_at(function, end) > 0)
    return rises


def value_of_guard(mode: Mode, number: Int[Array, ""], state: Any, surface: bool = False) -> Scalar:
    """Return the value, or that of the `surface`, of the guard that ended a mode.

    It is that of the first guard if none did.
    """
    of = lambda guard: (surface and guard.surface) or guard.value
    value = of(mode.guards[0])(state)
    for i, guard in enumerate(mode.guards[1:], 1):
        value = jnp.where(number == i, of(guard)(state), value)
    return value
