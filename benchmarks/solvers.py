"""Strides by each solver and tolerance against small steps: how many are wrong?

The reference is that of `small_steps.py`, which shares no integration and no search with the
package; for systems that are no walkers it follows their modes, guards and conditions in the same
way. A stride is wrong if its outcome differs, and no start within the solver's accuracy has it; or
if its state or its time are off by more than the tolerance, and farther than those of such starts
are from each other. That accuracy is 100 times the tolerance, and at least 1e-7, which is the
reference's. Undecided strides are counted apart: a method of low order gives up where it would need
more than 20 000 steps.

Per family and solver, for the tolerances 1e-6, 1e-9 and 1e-12: strides that are undecided; of
another outcome; and of another state or time. Bosh3 takes some thousand steps a stride at 1e-12,
and makes a tenth of the strides, in some families. Ralston's method, of second order, gives up on
half of all strides or more at 1e-9 and 1e-12. The strides of the runner that count as off are near
the greatest height of a step, where starts beside them differ less than a solver errs: the errors
of all steps of a stance grow threefold until the apex, to 3e-6 by Dopri5 and to 4e-5 by Bosh3 at
1e-6; they fall with the tolerance, and no event is missed. Small steps leave open at most 0.3 per
cent of the strides of a family, such as those with two events within half a step. A block that
never sticks takes 2 pi for each stride, whatever its start, so no start beside it has a solver's
error of the time, which is that of the velocity over the small force there. The five-link biped,
whose small steps take long, makes 2000 strides by Bosh3.

    bouncing-ball       series   100000      0    0    0      0    0    0      0    0    0
    bouncing-ball       Dopri8   100000      0    0    0      0    0    0      0    0    0
    bouncing-ball       Tsit5    100000      0    0    0      0    0    0      0    0    0
    bouncing-ball       Dopri5   100000      0    0    0      0    0    0      0    0    0
    bouncing-ball       Bosh3     10000      0    0    0      0    0    0      0    0    0
    runner              series   100000      0    0    0      0    0    0      0    0    0
    runner              Dopri8   100000      0    0    0      0    0    0      0    0    0
    runner              Tsit5    100000      0    0    0      0    0    0      0    0    0
    runner              Dopri5   100000      0    0   10      0    0    0      0    0    0
    runner              Bosh3     10000      0    0   15      0    0    0      0    0    0
    impact-oscillator   series   100000      0    0    0      0    0    0      0    0    0
    impact-oscillator   Dopri8   100000      0    0    0      0    0    0      0    0    0
    impact-oscillator   Tsit5    100000      0    0    0      0    0    0      0    0    0
    impact-oscillator   Dopri5   100000      0    0    0      0    0    0      0    0    0
    impact-oscillator   Bosh3     10000      0    0    0      0    0    0      0    0    0
    duffing             series   100000      0    0    0      0    0    0      0    0    0
    duffing             Dopri8   100000      0    0    0      0    0    0      0    0    0
    duffing             Tsit5    100000      0    0    0      0    0    0      0    0    0
    duffing             Dopri5   100000      0    0    0      0    0    0      0    0    0
    duffing             Bosh3     10000      0    0    0      0    0    0      0    0    0
    switched-compass    series   100000      0    0    0      0    0    0      0    0    0
    switched-compass    Dopri8   100000      0    0    0      0    0    0      0    0    0
    switched-compass    Tsit5    100000      0    0    0      0    0    0      0    0    0
    switched-compass    Dopri5   100000      0    0    0      0    0    0      0    0    0
    switched-compass    Bosh3     10000      0    0    0      0    0    0      0    0    0
    torso-wheel         series   100000      0    0    0      0    0    0      0    0    0
    torso-wheel         Dopri8   100000      0    0    0      0    0    0      0    0    0
    torso-wheel         Tsit5    100000      0    0    0      0    0    0      0    0    0
    torso-wheel         Dopri5   100000      0    0    0      0    0    0      0    0    0
    torso-wheel         Bosh3     10000      0    0    0      0    0    0      0    0    0
    simplest            series   100000      0    0    0      0    0    0      0    0    0
    simplest            Dopri8   100000      0    0    0      0    0    0      0    0    0
    simplest            Tsit5    100000      0    0    0      0    0    0      0    0    0
    simplest            Dopri5   100000      0    0    0      0    0    0      0    0    0
    simplest            Bosh3     10000      0    0    0      0    0    0    171    0    0
    spring              series   100000      0    0    0      0    0    0      0    0    0
    spring              Dopri8   100000      0    0    0      0    0    0      0    0    0
    spring              Tsit5    100000      0    0    0      0    0    0      0    0    0
    spring              Dopri5   100000      0    0    0      0    0    0      0    0    0
    spring              Bosh3     10000      0    0    0     33    0    0   8107    0    0
    powered             series   100000      0    0    0      0    0    0      0    0    0
    powered             Dopri8   100000      0    0    0      0    0    0      0    0    0
    powered             Tsit5    100000      0    0    0      0    0    0      0    0    0
    powered             Dopri5   100000      0    0    0      0    0    0      0    0    0
    powered             Bosh3     10000      0    0    0      0    0    0   5497    0    0
    upper-body          series   100000      0    0    0      0    0    0      0    0    0
    upper-body          Dopri8   100000      0    0    0      0    0    0      0    0    0
    upper-body          Tsit5    100000      0    0    0      0    0    0      0    0    0
    upper-body          Dopri5   100000      0    0    0      0    0    0      0    0    0
    upper-body          Bosh3     10000      0    0    0      0    0    0    323    0    0
    point-foot          series   100000      0    0    0      0    0    0      0    0    0
    point-foot          Dopri8   100000      0    0    0      0    0    0      0    0    0
    point-foot          Tsit5    100000      0    0    0      0    0    0      0    0    0
    point-foot          Dopri5   100000      0    0    0      0    0    0      0    0    0
    round-foot          series   100000      0    0    0      0    0    0      0    0    0
    round-foot          Dopri8   100000      0    0    0      0    0    0      0    0    0
    round-foot          Tsit5    100000      0    0    0      0    0    0      0    0    0
    round-foot          Dopri5   100000      0    0    0      0    0    0      0    0    0
    kneed               series   100000      0    0    0      0    0    0      0    0    0
    kneed               Dopri8   100000      0    0    0      0    0    0      0    0    0
    kneed               Tsit5    100000      0    0    0      0    0    0      0    0    0
    kneed               Dopri5   100000      0    0    0      0    0    0      0    0    0
    powered-point-foot  series   100000      0    0    0      0    0    0      0    0    0
    powered-point-foot  Dopri8   100000      0    0    0      0    0    0      0    0    0
    powered-point-foot  Tsit5    100000      0    0    0      0    0    0      0    0    0
    powered-point-foot  Dopri5   100000      0    0    0      0    0    0      0    0    0
    powered-round-foot  series   100000      0    0    0      0    0    0      0    0    0
    powered-round-foot  Dopri8   100000      0    0    0      0    0    0      0    0    0
    powered-round-foot  Tsit5    100000      0    0    0      0    0    0      0    0    0
    powered-round-foot  Dopri5   100000      0    0    0      0    0    0      0    0    0
    powered-upper-body  series   100000      0    0    0      0    0    0      0    0    0
    powered-upper-body  Dopri8   100000      0    0    0      0    0    0      0    0    0
    powered-upper-body  Tsit5    100000      0    0    0      0    0    0      0    0    0
    powered-upper-body  Dopri5   100000      0    0    0      0    0    0      0    0    0
    spatial             series   100000      0    0    0      0    0    0      0    0    0
    spatial             Dopri8   100000      0    0    0      0    0    0      0    0    0
    spatial             Tsit5    100000      0    0    0      0    0    0      0    0    0
    spatial             Dopri5   100000      0    0    0      0    0    0      0    0    0
    spring-biped        series   100000      0    0    0      0    0    0      0    0    0
    spring-biped        Dopri8   100000      0    0    0      0    0    0      0    0    0
    spring-biped        Tsit5    100000      0    0    0      0    0    0      0    0    0
    spring-biped        Dopri5   100000      0    0    0      0    0    0      0    0    0
    quadruped           series   100000      0    0    0      0    0    0      0    0    0
    quadruped           Dopri8   100000      0    0    0      0    0    0      0    0    0
    quadruped           Tsit5    100000      0    0    0      0    0    0      0    0    0
    quadruped           Dopri5   100000      0    0    0      0    0    0      0    0    0
    hopper              series   100000      0    0    0      0    0    0      0    0    0
    hopper              Dopri8   100000      0    0    0      0    0    0      0    0    0
    hopper              Tsit5    100000      0    0    0      0    0    0      0    0    0
    hopper              Dopri5   100000      0    0    0      0    0    0      0    0    0
    stick-slip          series   100000      0    0    0      0    0    0      0    0    0
    stick-slip          Dopri8   100000      0    0  468      0    0    2      0    0    0
    stick-slip          Tsit5    100000      0    0 26233      0    0  271      0    0    0
    stick-slip          Dopri5   100000      0    0 26233      0    0  215      0    0    0
    five-link-biped     series   100000      0    0    0      0    0    0      0    0    0
    five-link-biped     Dopri8   100000      0    0    0      0    0    0      0    0    0
    five-link-biped     Tsit5    100000      0    0    0      0    0    0      0    0    0
    five-link-biped     Dopri5   100000      0    0    0      0    0    0      0    0    0
    five-link-biped     Bosh3      2000      0    0    0      0    0    0      0    0    0

    python benchmarks/solvers.py [STRIDES [FAMILY ...]]
"""

import sys
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from events import ALL, starts
from small_steps import (
    NEAR,
    SOON,
    STEP,
    UNCLEAR,
    follow,
    runge_kutta,
    stride_by_small_steps,
)

import walker_jax as wj
from walker_jax.execution.tiles import map_cells
from walker_jax.hybrid.graphs import entered_again, in_order
from walker_jax.hybrid.modes import SECTION
from walker_jax.kernels import kernel
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.hybrid_system import failures_by_name
from walker_jax.systems.outcomes import Outcome

jax.config.update("jax_enable_x64", True)
SOLVERS = {
    "series": None,
    "Dopri8": diffrax.Dopri8(),
    "Tsit5": diffrax.Tsit5(),
    "Dopri5": diffrax.Dopri5(),
}
LOW_ORDER, FEWER = {"Bosh3": diffrax.Bosh3()}, 10
"""A solver that needs some thousand steps for a stride at 1e-12, and the fraction of strides that
it makes."""
TOLERANCES = 1e-6, 1e-9, 1e-12
ACCURACY, BESIDE, OFF = 100, 16, 5
"""Error of a solver over its tolerance; starts within it, for each start whose end differs from the
reference; and the largest error of an end, over the largest difference of the ends of these."""
FINER, EXAMPLES = 10, 3
"""How much finer the reference is computed where a stride is wrong by it; strides shown."""
STEPS = {"five-link-biped": 5e-4, "torso-wheel": 2e-3}
"""Small steps of systems whose unit of time is long."""
PASSES = 4
"""Passes over the modes of a graph in which an edge leads back; what needs more is unclear."""
GUARDS, NONE = 200, -1
"""Code of a mode's first guard, in place of an outcome; others follow; and that of none."""


def look_at(mode: Any, numbers: Any) -> Any:
    """The functions that end a mode, those that admit each end, and its conditions."""

    def look(y):
        least = lambda guard: [one(y) for one in guard.admits]
        values = [guard.value(y) for guard in mode.guards]
        admits = [
            jnp.min(jnp.stack([jnp.ones_like(values[0]), *least(guard)])) for guard in mode.guards
        ]
        holds = {numbers[one.leads_to]: one.value(y) for one in mode.conditions}
        return values, admits, holds, [GUARDS + i for i in range(len(mode.guards))]

    return look


def fallen_in(mode: Any, numbers: Any, y: Any) -> Any:
    outcome = jnp.asarray(int(Outcome.UNDECIDED))
    for guard in reversed(mode.guards):
        if guard.at_once and guard.leads_to in numbers:
            outcome = jnp.where(guard.value(y) >= 0, numbers[guard.leads_to], outcome)
    return outcome


def guard_due(mode: Any, modes: Any, y: Any, step: Any) -> Any:
    """The first guard that leads to a mode and has risen as its own mode begins."""
    due, soon = jnp.asarray(NONE), runge_kutta(mode.rates, y, SOON * step)
    for i, guard in reversed([*enumerate(mode.guards)]):
        if guard.leads_to in modes:
            risen = (guard.value(y) >= 0) & (guard.value(soon) >= 0) & guard.admitted(y)
            due = jnp.where(risen, GUARDS + i, due)
    return due


def take(guard: Any, numbers: Any, y: Any) -> tuple[Any, Any]:
    """The failure of what does not hold as a guard has risen, or none, and the next state."""
    outcome = jnp.asarray(int(Outcome.STRIDE))
    for one in reversed(guard.must_hold):
        outcome = jnp.where(one.value(y) > 0, outcome, numbers[one.leads_to])
    return outcome, guard.reset(y)


@kernel
def system_by_small_steps(system: Any, x: Any, step: Any) -> Any:
    """The next point of the section of a system, the outcome, and the time."""
    modes, numbers, time, broken = system.modes(), failures_by_name(system), 0 * step, {}
    first, start = next(iter(modes)), system.launch(x)
    feasible = jnp.all(jnp.isfinite(x)) & system.may_launch(x, start)
    outcome = jnp.where(feasible, int(Outcome.UNDECIDED), int(Outcome.OUTSIDE))
    entries = {first: (jnp.asarray(True), start)}
    struck = jnp.asarray(int(Outcome.STRIDE))
    for name in in_order(modes) * (PASSES if entered_again(modes) else 1):
        if name not in entries:
            continue
        mode, (reached, y) = modes[name], entries.pop(name)
        on = reached & (outcome == Outcome.UNDECIDED)
        begun, due = fallen_in(mode, numbers, y), guard_due(mode, modes, y, step)
        for one in mode.conditions:
            if one.at_start:
                pulled = (time == 0) & (due == NONE) & (one.value(y) < 0)
                begun = jnp.where(pulled, numbers[one.leads_to], begun)
        outcome = jnp.where(on, begun, outcome)
        on &= begun == Outcome.UNDECIDED
        going = on & (due == NONE)
        y, passed, end, violated = follow(mode.rates, look_at(mode, numbers), y, going, step)
        time += passed
        broken |= {key: broken.get(key, False) | flag for key, flag in violated.items()}
        end = jnp.where(due == NONE, end, due)
        outcome = jnp.where(on & (end == UNCLEAR), UNCLEAR, outcome)
        for i, guard in enumerate(mode.guards):
            took, to = on & (end == GUARDS + i), guard.leads_to
            if to in numbers:
                outcome = jnp.where(took, numbers[to], outcome)
                continue
            held, after = take(guard, numbers, y)
            if to != SECTION:
                outcome = jnp.where(took & (held != Outcome.STRIDE), held, outcome)
            else:  # conditions count before what does not hold at the end of a stride
                outcome = jnp.where(took, int(Outcome.STRIDE), outcome)
                struck = jnp.where(took, held, struck)
            known, other = entries.get(to, (jnp.asarray(False), after))
            after = jax.tree.map(partial(jnp.where, took), after, other)
            entries[to] = known | took, after
    y = entries.pop(SECTION)[1]
    for reached, _ in entries.values():
        outcome = jnp.where(reached & (outcome == Outcome.UNDECIDED), UNCLEAR, outcome)
    fallen = fallen_in(modes[first], numbers, system.begin(y))
    back = (struck == Outcome.STRIDE) & (fallen != Outcome.UNDECIDED)
    struck = jnp.where(back, fallen, struck)
    for key in sorted(broken, reverse=True):
        struck = jnp.where(broken[key], key, struck)
    outcome = jnp.where(outcome == Outcome.STRIDE, struck, outcome)
    made = outcome == Outcome.STRIDE
    return jnp.where(made, system.project(y), jnp.nan), outcome, jnp.where(made, time, jnp.nan)


def draw(name: str, count: int) -> tuple[Any, np.ndarray, Any, float]:
    """Systems and starts of a family, its reference, and the length of a small step."""
    rng = np.random.default_rng(11)
    if name in ALL:
        kind, _, ranges = ALL[name]
        drawn = {key: rng.uniform(low, high, count) for key, (low, high) in ranges.items()}
        many = jax.vmap(lambda values: kind(**values))(drawn)
        return many, starts(kind, count, rng), stride_by_small_steps, STEP
    kind: Any = SYSTEMS[name]
    one = kind(slope=0.05) if name == "switched-compass" else kind()
    region = one.gait_region()
    xs = region.points_at(rng.uniform(0, 1, (count, len(region.shape))))
    return one, xs, system_by_small_steps, STEPS.get(name, STEP)


def gather(found: Any) -> tuple[np.ndarray, np.ndarray]:
    """States and times of strides, as columns, and their outcomes."""
    state, outcome, time = found[:3]
    return np.concatenate([state, np.asarray(time)[:, None]], axis=1), np.asarray(outcome)


def survey(name: str, count: int, solvers: dict[str, Any]) -> None:
    """One row for each solver, and the first strides that are wrong."""
    system, xs, small_steps, step = draw(name, count)
    many = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count,)), system)

    def ends(rows, points, step):
        some = jax.tree.map(lambda leaf: leaf[rows], many)
        return gather(map_cells(small_steps, (some, points, np.float64(step)), (True, True, False)))

    alone, outcome = ends(np.arange(count), xs, step)
    rows_of = {title: [] for title in solvers}
    for tolerance in TOLERANCES:
        rng, spread = np.random.default_rng(5), np.zeros_like(alone)
        made = [
            gather(wj.strides(many, xs, tolerance=tolerance, solver=solver))
            for solver in solvers.values()
        ]
        made, codes = map(np.stack, zip(*made, strict=True))
        errors = np.abs(made - alone)
        clear, near = (outcome != UNCLEAR) & (codes != Outcome.UNDECIDED), max(NEAR, tolerance)
        wrong, off = clear & (codes != outcome), clear & (errors > near).any(axis=2)
        for _ in range(BESIDE):
            if not len(rows := np.flatnonzero((wrong | off).any(axis=0))):
                break
            apart = max(near, ACCURACY * tolerance) * rng.uniform(-1, 1, (len(rows), xs.shape[1]))
            end, code = ends(rows, xs[rows] + apart, step)
            spread[rows] = np.maximum(spread[rows], np.abs(end - alone[rows]))
            wrong[:, rows] &= (code != UNCLEAR) & (codes[:, rows] != code)
            off[:, rows] &= (errors[:, rows] > near + OFF * spread[rows]).any(axis=2)
        if len(rows := np.flatnonzero((wrong | off).any(axis=0))):  # the reference more finely
            end, code = ends(rows, xs[rows], step / FINER)
            errors = np.abs(made[:, rows] - end)
            wrong[:, rows] &= (code != UNCLEAR) & (codes[:, rows] != code)
            off[:, rows] &= (errors > near + OFF * spread[rows]).any(axis=2)
        for i, title in enumerate(solvers):
            undecided = codes[i] == Outcome.UNDECIDED
            rows_of[title].append([undecided.sum(), wrong[i].sum(), off[i].sum()])
            for j in np.flatnonzero(wrong[i] | off[i])[:EXAMPLES]:
                one = jax.tree.map(lambda leaf, j=j: float(leaf[j]), many)
                print("       ", title, tolerance, one, xs[j].tolist(), codes[i, j], outcome[j])
                print("           ", made[i, j], alone[j], spread[j])
    for title, rows in rows_of.items():
        cells = "  ".join("{:5} {:4} {:4}".format(*row) for row in rows)
        print(f"    {name:20}{title:8} {count:6}  {cells}", flush=True)
    print(f"    {name:20}{(outcome == UNCLEAR).sum():6} unclear to small steps", flush=True)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    systems = [name for name, kind in SYSTEMS.items() if issubclass(kind, wj.HybridSystem)]
    for family in sys.argv[2:] or [*ALL, *systems]:
        survey(family, number, SOLVERS)
        survey(family, number // FEWER, LOW_ORDER)
