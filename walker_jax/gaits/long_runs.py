"""Attractors to which walkers converge in thousands of strides, at many parameter values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.checks import WrongUse, numbers, refuses_tracers
from walker_jax.gaits.branches import Branch, float64_tolerance, interpolate_cycles, solve_at
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome, join_names
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walkers.parameters import check_parameter, with_parameter
from walker_jax.walking.iteration import WalkEnd, iterate, orbits

RECORDED_STATES = 64
"""Recorded states of an orbit; only shorter periods are recognised."""
START_OFFSET = 1e-6
"""Distance from a gait, in the first coordinate, at which walkers start. It is small, so that a
walker converges to a stable gait with a narrow basin, but above rounding errors, so that a walker
leaves an unstable gait and converges to an attractor."""
SETTLED_DISTANCE = 1e-11
"""Distance, in every coordinate, within which a walk that returns to a state has converged to a
cycle, up to rounding errors. A walk that starts at `START_OFFSET` from an unstable gait does not
return that close, unless a multiplier is nearer to 1 than 1e-5."""
SETTLING_STRIDES = 200
"""Strides before a walk is first tested for this; the number doubles for each further test."""
RECURRENCE_DISTANCE = 1e-6
"""Distance, in every coordinate, within which two states of an orbit count as the same; ten
thousand times the largest residual of a gait."""


@refuses_tracers()
def attractors(
    walker: System,
    parameter: str,
    values: Float[ArrayLike, " values"] | Sequence[Any],
    starts: Float[ArrayLike, "..."] | Sequence[Any],
    *,
    strides: int = 1000,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> xr.Dataset:
    """Find the attractors to which walkers converge, at each of many values of a parameter.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    starts = np.tile(wj.find_gait(walker).states, (3, 1, 1))
    wj.attractors(walker, "slope", np.array([0.004, 0.016, 0.018]), starts)["period"]
    ```

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of the parameter that changes.
    - `values`: its values.
    - `starts`: points of the section for each value, of shape (values, starts, section).
    - `strides`: number of strides that every walker makes before its states are recorded.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: label of a progress bar, which is shown on a terminal only.

    **Returns** a data set over `value` and `start`: `fate`, the `Outcome` of the stride at which a
    walker fails, `STRIDE` if it does not; `strides` made before that; `orbit`, the
    `RECORDED_STATES` states that follow, NaN after a failure; and its `period`, 0 if it has none
    that short.
    """
    values, starts = numbers("values", values), numbers("starts", starts)
    if values.ndim != 1:
        raise WrongUse(f"values must be one row of numbers, not of shape {values.shape}")
    check_parameter(walker, parameter, *values)
    integrator = Integrator(float64_tolerance(tolerance))
    if starts.ndim != 3 or starts.shape[::2] != (len(values), len(walker.section)):
        shape = f"({len(values)}, starts, {len(walker.section)})"
        raise WrongUse(f"starts must have shape {shape}, not {starts.shape}")
    n, m, size = starts.shape
    walkers = with_parameter(walker, parameter, np.repeat(values, m))
    found = settle(walkers, starts.reshape(-1, size), strides, integrator, progress)
    fate, count, orbit, period = found
    over = ("value", "start")
    return xr.Dataset(
        {
            "fate": (over, fate.reshape(n, m)),
            "strides": (over, count.reshape(n, m)),
            "period": (over, period.reshape(n, m)),
            "orbit": ((*over, "recent", "coordinate"), orbit.reshape(n, m, RECORDED_STATES, size)),
        },
        coords={"value": values},
        attrs={"parameter": parameter, "section": join_names(walker.section), "strides": strides},
    )


class Settled(NamedTuple):
    """Attractors of n walkers."""

    fate: Int[np.ndarray, " n"]
    """`Outcome` of the stride at which each fails; `STRIDE` if it does not."""
    strides: Int[np.ndarray, " n"]
    """Strides made before that."""
    orbit: Float[np.ndarray, "n recent section"]
    """The last `RECORDED_STATES` states; NaN after a failure."""
    period: Int[np.ndarray, " n"]
    """Period of the recorded states; 0 if they have none that short."""


def settle(
    walkers: System,
    starts: Float[np.ndarray, "n section"],
    strides: int,
    integrator: Integrator,
    progress: str | None = None,
) -> Settled:
    """Find the attractors of n walkers, each with its own parameters, after `strides` strides."""
    end = iterate_to_cycles(walkers, starts, strides, integrator, progress)
    fate, count = end.outcome, end.strides
    orbit = np.full((len(starts), RECORDED_STATES, starts.shape[1]), np.nan)
    left = np.flatnonzero(fate == Outcome.STRIDE)
    states, fate[left] = orbits(select(walkers, left), end.state[left], RECORDED_STATES, integrator)
    orbit[left] = states[:, :RECORDED_STATES]
    count[left] += np.isfinite(states[:, 1:, 0]).sum(axis=1, dtype=count.dtype)
    apart = np.abs(difference(orbit[:, :-1], orbit[:, -1:], turns_of(walkers)))
    recurs = apart.max(axis=2)[:, ::-1] < RECURRENCE_DISTANCE
    period = np.where(recurs.any(axis=1), recurs.argmax(axis=1) + 1, 0)
    return Settled(fate, count, orbit, period)


def iterate_to_cycles(
    walker: System,
    starts: Float[np.ndarray, "n section"],
    limit: int,
    integrator: Integrator,
    progress: str | None = None,
) -> WalkEnd:
    """`iterate` without targets, which skips the strides of walks that have settled on a cycle.

    The end of such a walk, after `limit` strides, follows from its cycle.
    """
    n = len(starts)
    end = WalkEnd(
        starts.copy(), np.zeros(n, np.int8), np.zeros(n, np.int32), np.full(n, -1, np.int32)
    )
    active, made = np.arange(n), 0
    while len(active) and made < limit:
        count = min(max(made, SETTLING_STRIDES), limit - made)
        part = iterate(
            select(walker, active), end.state[active], count, integrator, progress=progress
        )
        end.state[active], end.outcome[active] = part.state, part.outcome
        end.strides[active] += part.strides
        active, made = active[part.outcome == Outcome.STRIDE], made + count
        if made < limit:
            walkers, states = select(walker, active), end.state[active]
            states, _ = orbits(walkers, states, RECORDED_STATES, integrator)
            apart = np.abs(difference(states[:, 1:], states[:, :1], turns_of(walker)))
            returns = apart.max(axis=2) < SETTLED_DISTANCE
            settled = np.flatnonzero(returns.any(axis=1))
            phase = (limit - made) % (returns[settled].argmax(axis=1) + 1)
            end.state[active[settled]] = states[settled, phase]
            end.strides[active[settled]] = limit
            active = np.delete(active, settled)
    return end


def starts_near_gaits(
    walker: System,
    parameter: str,
    branches: Sequence[Branch],
    values: Float[np.ndarray, " values"],
    tolerance: Real,
) -> Float[np.ndarray, "values starts section"]:
    """Return starts near the gaits of branches at each value, padded with NaN to one number."""
    guesses = [
        (i, cycle)
        for i, value in enumerate(values)
        for branch in branches
        for cycle in interpolate_cycles(branch, value)
    ]
    cycles = solve_at(
        walker, parameter, [(float(values[i]), cycle) for i, cycle in guesses], tolerance
    )
    rows: list[list[np.ndarray]] = [[] for _ in values]
    for (i, _), cycle in zip(guesses, cycles, strict=True):
        if cycle is not None:
            rows[i].append(cycle[0] + START_OFFSET * np.eye(1, cycle.shape[1])[0])
    starts = np.full((len(values), max(map(len, rows)), len(walker.section)), np.nan)
    for i, row in enumerate(rows):
        if row:
            starts[i, : len(row)] = row
    return starts
