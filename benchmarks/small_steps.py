"""Strides of all walkers against an integration by small steps that knows nothing of guards.

The reference makes Runge-Kutta steps of fourth order and constant length, with Hermite's cubic in
between. It finds events by signs at the ends and in the middle of each step, and bisects them. It
shares a walker's own methods with the package (equations, contact, impact, falls, conditions), but
no integration and no search. Walkers and starts are those of `events.py`. If two events fall into
half a step, or one occurs just as it is admitted, the stride counts as undecided. A different
outcome is computed again with steps a tenth as long, and then counts as near a boundary if a start
within 1e-7 has it too.

Per family: strides; those with a heel strike; undecided ones; different outcomes; those near a
boundary; the largest difference of states, and that of 99.9 per cent; time.

    family                  made      to strike, undecided, differ, near, largest, 99.9 %, time
    simplest               100000 strides   9%     0   0   0   6e-09  6e-11   23 s
    spring                 100000 strides  67%   215   0   0   9e-08  2e-08   14 s
    point-foot             100000 strides   6%     0   0   0   1e-10  5e-11   20 s
    powered                100000 strides  51%    31   0   0   2e-08  2e-09   18 s
    round-foot             100000 strides  22%     3   0   0   2e-09  3e-10   28 s
    upper-body             100000 strides  12%     0   0   0   5e-10  1e-10   40 s
    kneed                  100000 strides  42%   195   0   0   3e-08  5e-09   35 s
    powered-point-foot     100000 strides  42%    15   0   0   1e-07  1e-08   25 s
    powered-round-foot     100000 strides  55%    12   0   0   2e-09  3e-10   21 s
    powered-upper-body     100000 strides  54%     4   0   0   3e-09  3e-10   36 s
    spatial                100000 strides  37%    16   0   0   8e-08  1e-08   43 s

    python benchmarks/small_steps.py [STRIDES [FAMILY ...]]
"""

import sys
import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from events import ALL, starts
from jax import lax

import walker_jax as wj
from walker_jax.execution.tiles import map_cells
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Outcome

jax.config.update("jax_enable_x64", True)
STEP, LONGEST, NEAR, AT_ONCE = 0.004, 60.0, 1e-7, 20_000
UNCLEAR = 100
"""An outcome that small steps do not decide."""
SOON = 0.01
"""Part of a step after which an event that is zero at first has risen or fallen. A knee that is
pressed against its lock for a part of a step, and would then bend, is locked."""


def along(y: Any, rates: Any, h: Any) -> Any:
    return jax.tree.map(lambda value, rate: value + h * rate, y, rates)


def runge_kutta(field: Any, y: Any, h: Any) -> Any:
    one = field(y)
    two = field(along(y, one, h / 2))
    three = field(along(y, two, h / 2))
    four = field(along(y, three, h))
    mean = lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6
    return along(y, jax.tree.map(mean, one, two, three, four), h)


def hermite(field: Any, y: Any, end: Any, h: Any, s: Any) -> Any:
    """The state after a part s of a step."""

    def cubic(a, b, rate, last):
        chord, left = b - a, 1 - s
        return a + s * (chord + left * (left * (h * rate - chord) - s * (h * last - chord)))

    return jax.tree.map(cubic, y, end, field(y), field(end))


def functions_of(walker: Any, part: Any) -> Any:
    """The functions that end a part of a stride, those that admit each end, and its conditions."""
    last = part is walker

    def look(y):
        falls = walker.falls(y)
        values, admits = list(falls.values()), [jnp.ones_like(y.theta)] * len(falls)
        codes = [int(Outcome[name]) for name in falls]
        if last:
            values, admits = [*values, walker.contact(y)], [*admits, walker.is_ahead(y)]
        else:
            if (height := part.clearance(y)) is not None:
                values = [*values, -height]
                admits = [*admits, jnp.minimum(walker.is_ahead(y), part.reach(y))]
                codes = [*codes, int(Outcome.BENT_KNEE)]
            values, admits = [*values, part.event(y)], [*admits, jnp.ones_like(y.theta)]
        holds = {int(Outcome[name]): one(y) for name, one in part.conditions().items()}
        holds = {int(Outcome.RUNNING): part.contact_force(y)[1]} | holds
        return values, admits, holds, [*codes, int(Outcome.STRIDE)]

    return look


def follow(field: Any, look: Any, start: Any, going: Any, step: Any) -> Any:
    """The state and time at the end of a part, the outcome, and what was violated, if going."""
    _, _, holds, codes = look(start)

    def unfinished(carry):
        return carry["on"] & (carry["time"] < LONGEST)

    def advance(carry):
        y = carry["end"]
        end = runge_kutta(field, y, step)
        middle = hermite(field, y, end, step, 0.5)
        seen, outcome, unclear = [look(one) for one in (y, middle, end)], carry["outcome"], False
        found, left = jnp.asarray(False), jnp.zeros_like(step)
        broken = carry["broken"]
        for before, after, at in ((seen[0], seen[1], 0.0), (seen[1], seen[2], 0.5)):
            count = jnp.asarray(0)
            for i, code in enumerate(codes):
                rises = (before[0][i] < 0) & (after[0][i] >= 0) & ~found
                admitted = [one[1][i] > 0 for one in (before, after)]
                unclear |= rises & (admitted[0] != admitted[1])
                rises &= admitted[0] & admitted[1]
                outcome = jnp.where(rises, code, outcome)
                count += rises
            unclear |= count > 1
            left = jnp.where(count > 0, at, left)
            found |= count > 0
            broken = {key: broken[key] | (~found & (after[2][key] < 0)) for key in broken}
        outcome = jnp.where(unclear, UNCLEAR, outcome)
        on = ~found & ~unclear & jnp.isfinite(sum(map(jnp.sum, jax.tree.leaves(end))))
        return {
            "start": y, "end": end, "left": left, "on": on, "outcome": outcome, "broken": broken,
            "time": carry["time"] + step,
        }  # fmt: skip

    begun = {
        "start": start, "end": start, "left": jnp.zeros_like(step), "on": going,
        "outcome": jnp.asarray(int(Outcome.UNDECIDED)), "time": jnp.zeros_like(step),
        "broken": {key: going & (value < 0) for key, value in holds.items()},
    }  # fmt: skip
    last = lax.while_loop(unfinished, advance, begun)
    at = partial(hermite, field, last["start"], last["end"], step)

    def risen(s):
        values, flag = look(at(s))[0], jnp.asarray(False)
        for value, code in zip(values, codes, strict=True):
            flag |= (last["outcome"] == code) & (value >= 0)
        return flag

    def halve(_, ends):
        middle = (ends[0] + ends[1]) / 2
        late = risen(middle)
        return jnp.where(late, ends[0], middle), jnp.where(late, middle, ends[1])

    ended = going & (last["outcome"] != Outcome.UNDECIDED)
    _, high = lax.fori_loop(0, 45, halve, (last["left"], last["left"] + 0.5))
    keep = lambda new, old: jnp.where(ended, new, old)
    state = jax.tree.map(keep, at(high), start)
    values = look(state)[2]
    broken = {key: last["broken"][key] | (ended & (values[key] < 0)) for key in values}
    time = jnp.where(ended, last["time"] - step + high * step, 0)
    return state, time, last["outcome"], broken


def fallen(walker: Any, y: Any) -> Any:
    outcome = jnp.asarray(int(Outcome.UNDECIDED))
    for name, value in reversed(walker.falls(y).items()):
        outcome = jnp.where(value >= 0, int(Outcome[name]), outcome)
    return outcome


@kernel
def stride_by_small_steps(walker: Any, x: Any, step: Any) -> Any:
    """The next point of the section, the outcome, and the time."""
    y, time = walker.lift(x), jnp.zeros_like(step)
    phases = walker.phases()
    y = phases[0].begin(y) if phases else y
    going, broken = walker.feasible(x), {}
    outcome = jnp.where(going, fallen(walker, y), int(Outcome.OUTSIDE))
    at_rest = jnp.asarray(True)  # as long as the stride has not begun to move
    for part in (*phases, walker):
        due = jnp.asarray(False)
        if part is not walker:
            soon = part.event(runge_kutta(part.vector_field, y, SOON * step))
            due = (part.event(y) >= 0) & (soon >= 0)
        pulled = at_rest & ~due & (part.contact_force(y)[1] < 0)
        begun = (outcome == Outcome.UNDECIDED) | (at_rest & (outcome != Outcome.OUTSIDE))
        outcome = jnp.where(pulled & begun, int(Outcome.RUNNING), outcome)
        on = (outcome == Outcome.UNDECIDED) & ~due
        y, passed, end, violated = follow(
            part.vector_field, functions_of(walker, part), y, on, step
        )
        time += passed
        broken = {key: broken.get(key, False) | flag for key, flag in violated.items()} | {
            key: flag for key, flag in broken.items() if key not in violated
        }
        at_rest &= due
        if part is walker:
            outcome = jnp.where(on, end, outcome)
        else:
            through = due & (outcome == Outcome.UNDECIDED) | on & (end == Outcome.STRIDE)
            y = part.end(y)
            after = jnp.where(through, fallen(walker, y), end)
            outcome = jnp.where(on | due & (outcome == Outcome.UNDECIDED), after, outcome)
    (_, lift), after = walker.impact(y)
    following = walker.exchange_legs(after)
    struck = fallen(walker, following)
    struck = jnp.where(struck == Outcome.UNDECIDED, int(Outcome.STRIDE), struck)
    struck = jnp.where(lift > 0, struck, int(Outcome.STOPPED))
    for key in sorted(broken, reverse=True):
        struck = jnp.where(broken[key], key, struck)
    outcome = jnp.where(outcome == Outcome.STRIDE, struck, outcome)
    state = walker.project(following)
    made = outcome == Outcome.STRIDE
    return jnp.where(made, state, jnp.nan), outcome, jnp.where(made, time, jnp.nan)


def survey(name: str, count: int) -> None:
    kind, _, ranges = ALL[name]
    rng, began = np.random.default_rng(11), time.process_time()
    struck = unclear = differ = near = total = 0
    errors, examples = [], []
    while total < count:
        n = min(AT_ONCE, count - total)
        drawn = {key: rng.uniform(low, high, n) for key, (low, high) in ranges.items()}
        walkers = jax.vmap(lambda values, kind=kind: kind(**values))(drawn)
        walkers = jax.tree.map(lambda leaf, n=n: np.broadcast_to(leaf, (n,)), walkers)
        xs = starts(kind, n, rng)
        slow = lambda w, x, h: map_cells(
            stride_by_small_steps, (w, x, np.float64(h)), (True, True, False)
        )
        found, (states, outcomes, _) = wj.strides(walkers, xs), slow(walkers, xs, STEP)
        known = outcomes != UNCLEAR
        unclear += int((~known).sum())
        for i in np.flatnonzero(known & (outcomes != found.outcome)):
            some = jax.tree.map(lambda leaf, i=i: np.repeat(leaf[i], 65), walkers)
            beside = xs[i] + NEAR * rng.uniform(-1, 1, (65, xs.shape[1]))
            beside[0] = xs[i]
            again = slow(some, beside, STEP / 10)[1]
            if found.outcome[i] == again[0]:
                continue
            if found.outcome[i] in again or UNCLEAR in again:
                near += 1
            else:
                differ += 1
                one = jax.tree.map(lambda leaf, i=i: float(leaf[i]), walkers)
                examples.append((one, xs[i].tolist(), found.outcome[i], again[0]))
        both = (found.outcome == 0) & (outcomes == 0)
        struck += int(both.sum())
        errors.append(np.abs(found.state - states)[both].max(axis=1))
        total += n
    error = np.concatenate(errors)
    print(
        f"    {name:20}{total:9} strides {struck / total:4.0%} {unclear:5} {differ:3} {near:3}  "
        f"{error.max():6.0e} {np.quantile(error, 0.999):6.0e} {time.process_time() - began:4.0f} s",
        flush=True,
    )
    for example in examples[:3]:
        print("       ", *example)


if __name__ == "__main__":
    strides = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    for family in sys.argv[2:] or ALL:
        survey(family, strides)
