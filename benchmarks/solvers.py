"""Strides by each solver and tolerance against small steps: how many are wrong?

The reference is that of `small_steps.py`, which shares no integration and no search with the
package; for systems that are no walkers it follows their modes, guards and conditions in the same
way. A stride is wrong if its outcome differs, and no start within the solver's accuracy has it; or
if its state or its time are farther off than those of such starts are from each other. That
accuracy is 100 times the tolerance, and at least 1e-7, which is the reference's. Undecided strides
are counted apart: a method of low order gives up where it would need more than 20 000 steps.

Per family and solver, for the tolerances 1e-6, 1e-9 and 1e-12: strides that are undecided; of
another outcome; and of another state or time. Ralston's method was run for the first three families
only, and not all families were. In the two strides of the runner that count as off, no event is
missed: the largest errors of all its strides at 1e-6 are 3e-6 by Dopri5 and 4e-5 by Bosh3.

    bouncing-ball       series      200      0    0    0      0    0    0      0    0    0
    bouncing-ball       Dopri8      200      0    0    0      0    0    0      0    0    0
    bouncing-ball       Tsit5       200      0    0    0      0    0    0      0    0    0
    bouncing-ball       Dopri5      200      0    0    0      0    0    0      0    0    0
    bouncing-ball       Bosh3       200      0    0    0      0    0    0      0    0    0
    bouncing-ball       Ralston     200      0    0    0    174    0    0    191    0    0
    runner              series      200      0    0    0      0    0    0      0    0    0
    runner              Dopri8      200      0    0    0      0    0    0      0    0    0
    runner              Tsit5       200      0    0    0      0    0    0      0    0    0
    runner              Dopri5      200      0    0    1      0    0    0      0    0    0
    runner              Bosh3       200      0    0    1      0    0    0      0    0    0
    runner              Ralston     200      0    0    0    109    0    0    109    0    0
    impact-oscillator   series      200      0    0    0      0    0    0      0    0    0
    impact-oscillator   Dopri8      200      0    0    0      0    0    0      0    0    0
    impact-oscillator   Tsit5       200      0    0    0      0    0    0      0    0    0
    impact-oscillator   Dopri5      200      0    0    0      0    0    0      0    0    0
    impact-oscillator   Bosh3       200      0    0    0      0    0    0      0    0    0
    impact-oscillator   Ralston     200      0    0    0    194    0    0    200    0    0
    duffing             series      200      0    0    0      0    0    0      0    0    0
    duffing             Dopri8      200      0    0    0      0    0    0      0    0    0
    duffing             Tsit5       200      0    0    0      0    0    0      0    0    0
    duffing             Dopri5      200      0    0    0      0    0    0      0    0    0
    duffing             Bosh3       200      0    0    0      0    0    0    131    0    0
    torso-wheel         series      200      0    0    0      0    0    0      0    0    0
    torso-wheel         Dopri8      200      0    0    0      0    0    0      0    0    0
    torso-wheel         Tsit5       200      0    0    0      0    0    0      0    0    0
    torso-wheel         Dopri5      200      0    0    0      0    0    0      0    0    0
    torso-wheel         Bosh3       200      0    0    0      0    0    0      0    0    0
    switched-compass    series      200      0    0    0      0    0    0      0    0    0
    switched-compass    Dopri8      200      0    0    0      0    0    0      0    0    0
    switched-compass    Tsit5       200      0    0    0      0    0    0      0    0    0
    switched-compass    Dopri5      200      0    0    0      0    0    0      0    0    0
    switched-compass    Bosh3       200      0    0    0      0    0    0      0    0    0
    simplest            series      200      0    0    0      0    0    0      0    0    0
    simplest            Dopri8      200      0    0    0      0    0    0      0    0    0
    simplest            Tsit5       200      0    0    0      0    0    0      0    0    0
    simplest            Dopri5      200      0    0    0      0    0    0      0    0    0
    simplest            Bosh3       200      0    0    0      0    0    0      0    0    0
    kneed               series      200      0    0    0      0    0    0      0    0    0
    kneed               Dopri8      200      0    0    0      0    0    0      0    0    0
    kneed               Tsit5       200      0    0    0      0    0    0      0    0    0
    kneed               Dopri5      200      0    0    0      0    0    0      0    0    0
    kneed               Bosh3       200      0    0    0      0    0    0      0    0    0
    round-foot          series      200      0    0    0      0    0    0      0    0    0
    round-foot          Dopri8      200      0    0    0      0    0    0      0    0    0
    round-foot          Tsit5       200      0    0    0      0    0    0      0    0    0
    round-foot          Dopri5      200      0    0    0      0    0    0      0    0    0
    round-foot          Bosh3       200      0    0    0      0    0    0      0    0    0
    powered             series      200      0    0    0      0    0    0      0    0    0
    powered             Dopri8      200      0    0    0      0    0    0      0    0    0
    powered             Tsit5       200      0    0    0      0    0    0      0    0    0
    powered             Dopri5      200      0    0    0      0    0    0      0    0    0
    powered             Bosh3       200      0    0    0      0    0    0     16    0    0
    upper-body          series      200      0    0    0      0    0    0      0    0    0
    upper-body          Dopri8      200      0    0    0      0    0    0      0    0    0
    upper-body          Tsit5       200      0    0    0      0    0    0      0    0    0
    upper-body          Dopri5      200      0    0    0      0    0    0      0    0    0
    upper-body          Bosh3       200      0    0    0      0    0    0      0    0    0

    python benchmarks/solvers.py [STRIDES [FAMILY ...]]
"""

import sys
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from events import ALL, starts
from small_steps import (
    NEAR,
    STEP,
    UNCLEAR,
    follow,
    runge_kutta,
    stride_by_small_steps,
)

import walker_jax as wj
from walker_jax.execution.tiles import map_cells
from walker_jax.kernels import kernel
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.outcomes import Outcome

jax.config.update("jax_enable_x64", True)
SOLVERS = {
    "series": None,
    "Dopri8": diffrax.Dopri8(),
    "Tsit5": diffrax.Tsit5(),
    "Dopri5": diffrax.Dopri5(),
    "Bosh3": diffrax.Bosh3(),
    "Ralston": diffrax.Ralston(),
}
TOLERANCES = 1e-6, 1e-9, 1e-12
ACCURACY, BESIDE, OFF = 100, 16, 5
"""Error of a solver over its tolerance; starts within it, for each start; and the largest error of
an end, over the largest difference of the ends of these."""
STEPS = {"five-link-biped": 5e-4, "torso-wheel": 2e-3}
"""Small steps of systems whose unit of time is long."""


def look_at(mode: Any) -> Any:
    """The functions that end a mode, those that admit each end, and its conditions."""

    def look(y):
        least = lambda guard: [one(y) for one in (*guard.admits, *guard.admits_at_rise)]
        values = [guard.value(y) for guard in mode.guards]
        admits = [
            jnp.min(jnp.stack([jnp.ones_like(values[0]), *least(guard)])) for guard in mode.guards
        ]
        holds = {int(one.outcome): one.value(y) for one in mode.conditions}
        return values, admits, holds, [int(guard.leads_to) for guard in mode.guards]

    return look


def fallen_in(mode: Any, y: Any) -> Any:
    outcome = jnp.asarray(int(Outcome.UNDECIDED))
    for guard in reversed(mode.guards):
        if guard.at_once:
            outcome = jnp.where(guard.value(y) >= 0, int(guard.leads_to), outcome)
    return outcome


@kernel
def system_by_small_steps(system: Any, x: Any, step: Any) -> Any:
    """The next point of the section of a system, the outcome, and the time."""
    y, time = system.lift(x), jnp.zeros_like(step)
    modes, broken = system.modes(), {}
    feasible = jnp.all(jnp.isfinite(x)) & system.feasible(x)
    outcome = jnp.where(feasible, int(Outcome.UNDECIDED), int(Outcome.OUTSIDE))
    at_rest = jnp.asarray(True)
    for mode in modes:
        look, begun = look_at(mode), outcome == Outcome.UNDECIDED
        outcome = jnp.where(begun, fallen_in(mode, y), outcome)
        due = jnp.asarray(False)
        if mode is not modes[-1]:
            last = mode.guards[-1].value
            due = (last(y) >= 0) & (last(runge_kutta(mode.rates, y, step)) >= 0)
        pull = look(y)[2].get(int(Outcome.RUNNING), jnp.ones_like(step))
        outcome = jnp.where(begun & at_rest & ~due & (pull < 0), int(Outcome.RUNNING), outcome)
        on = (outcome == Outcome.UNDECIDED) & ~due
        y, passed, end, violated = follow(mode.rates, look, y, on, step)
        time += passed
        broken = {key: broken.get(key, False) | flag for key, flag in violated.items()} | {
            key: flag for key, flag in broken.items() if key not in violated
        }
        at_rest &= due
        through = (due & (outcome == Outcome.UNDECIDED)) | (on & (end == Outcome.STRIDE))
        outcome = jnp.where(on, end, outcome)
        for one in reversed(mode.at_end):
            outcome = jnp.where(through & ~(one.value(y) > 0), int(one.outcome), outcome)
        through &= (outcome == Outcome.STRIDE) | (outcome == Outcome.UNDECIDED)
        done = Outcome.STRIDE if mode is modes[-1] else Outcome.UNDECIDED
        outcome = jnp.where(through, int(done), outcome)
        y = mode.reset(y)
    struck = fallen_in(modes[0], y)
    struck = jnp.where(struck == Outcome.UNDECIDED, int(Outcome.STRIDE), struck)
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


def survey(name: str, count: int) -> None:
    """One row for each solver."""
    one, xs, small_steps, step = draw(name, count)
    many = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count,)), one)
    ends = lambda w, x: map_cells(small_steps, (w, x, np.float64(step)), (True, True, False))
    beside, rng = {}, np.random.default_rng(5)
    repeated = jax.tree.map(lambda leaf: np.repeat(leaf, BESIDE), many)
    for tolerance in TOLERANCES:
        apart = max(NEAR, ACCURACY * tolerance) * rng.uniform(-1, 1, (count, BESIDE, xs.shape[1]))
        apart[:, 0] = 0
        around = ends(repeated, (xs[:, None] + apart).reshape(-1, xs.shape[1]))
        beside[tolerance] = [np.reshape(one, (count, BESIDE, *one.shape[1:])) for one in around]
    for title, solver in SOLVERS.items():
        cells = []
        for tolerance in TOLERANCES:
            found = wj.strides(many, xs, tolerance=tolerance, solver=solver)
            states, outcomes, times = beside[tolerance]
            unclear = (outcomes == UNCLEAR).any(axis=1)
            undecided = found.outcome == Outcome.UNDECIDED
            same = (outcomes == found.outcome[:, None]).any(axis=1)
            wrong = ~undecided & ~unclear & ~same
            both = ~unclear & (found.outcome == 0) & (outcomes == 0).all(axis=1)
            known = np.concatenate([states, times[..., None]], axis=2)[both]
            made = np.concatenate([found.state, found.time[:, None]], axis=1)[both]
            allowed = NEAR + OFF * np.abs(known - known[:, :1]).max(axis=1)
            off = (np.abs(made - known[:, 0]) > allowed).any(axis=1)
            cells.append(f"{undecided.sum():5} {wrong.sum():4} {off.sum():4}")
        print(f"    {name:20}{title:8} {count:6}  " + "  ".join(cells), flush=True)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    systems = [name for name, kind in SYSTEMS.items() if issubclass(kind, wj.HybridSystem)]
    for family in sys.argv[2:] or [*ALL, *systems]:
        survey(family, number)
