"""Where walkers that start close to the gaits end after thousands of strides."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.checks import WrongUse, check_whole, numbers, refuses_tracers
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.arclength import corrected
from walker_jax.gaits.branches import Branch, crossings, double_tolerance
from walker_jax.gaits.derivatives import some
from walker_jax.gaits.requests import together
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter, with_parameter
from walker_jax.walking.iteration import stacked
from walker_jax.walking.iteration import strides as many_strides
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.stepping import follow_stride

RECENT = 64
"""States of an orbit that are recorded, and the longest period that is recognised."""
ROUND = 64
"""Strides in a call, after which walkers that fell are left behind."""
BESIDE = 1e-6
"""Distance from a gait, in the first coordinate, at which walkers start.

Stable ones draw them in: their basins are no wider than this where they are born. From unstable
ones they leave for what attracts them.
"""
SAME = 1e-6
"""Distance, in every coordinate, at which an orbit has come back."""


@refuses_tracers()
def attractors(
    walker: Walker,
    parameter: str,
    values: Float[ArrayLike, " values"],
    starts: Float[ArrayLike, "..."],
    *,
    strides: int = 1000,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> xr.Dataset:
    """What walkers come to at each of many values of a parameter, from many starts.

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of the one that changes.
    - `values`: of the parameter.
    - `starts`: points of the section for each value, of shape (values, starts, section).
    - `strides`: for which every walker is followed before its states are recorded.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: what to call the work in a progress bar, shown on a terminal only.

    **Returns** a data set over `value` and `start`: `fate`, the `Outcome` of the stride at which a
    walker fails, `STRIDE` where it does not; `strides` before that; `orbit`, the `RECENT` states
    that follow, NaN after a failure; and `period` of that orbit, 0 where none up to `RECENT` shows.
    """
    values, starts = numbers("values", values), numbers("starts", starts)
    if values.ndim != 1:
        raise WrongUse(f"values must be one row of numbers, not of shape {values.shape}")
    check_parameter(walker, parameter, *values)
    tolerance = double_tolerance(tolerance)
    if starts.ndim != 3 or starts.shape[::2] != (len(values), len(walker.section)):
        shape = f"({len(values)}, starts, {len(walker.section)})"
        raise WrongUse(f"starts must have shape {shape}, not {starts.shape}")
    check_whole("strides", strides)
    n, m, size = starts.shape
    walkers = with_parameter(walker, parameter, np.repeat(values, m))
    x, fate, count = persist(walkers, starts.reshape(-1, size), strides, tolerance, progress)
    orbit = np.full((n * m, RECENT, size), np.nan)
    left = np.flatnonzero(fate == Outcome.STRIDE)
    x = x[left]
    for i in range(RECENT):
        orbit[left, i] = x
        ends = many_strides(some(walkers, left), x, tolerance=tolerance)
        alive = ends.outcome == Outcome.STRIDE
        fate[left] = ends.outcome
        count[left] += alive
        left, x = left[alive], ends.state[alive]
    misses = np.abs(orbit[:, :-1] - orbit[:, -1:]).max(axis=2)[:, ::-1] < SAME
    period = np.where(misses.any(axis=1), misses.argmax(axis=1) + 1, 0)
    over = ("value", "start")
    return xr.Dataset(
        {
            "fate": (over, fate.reshape(n, m)),
            "strides": (over, count.reshape(n, m)),
            "period": (over, period.reshape(n, m)),
            "orbit": ((*over, "recent", "coordinate"), orbit.reshape(n, m, RECENT, size)),
        },
        coords={"value": values},
        attrs={"parameter": parameter, "section": list(walker.section), "strides": strides},
    )


def persist(
    walker: Walker,
    x: Float[np.ndarray, "n section"],
    limit: int,
    tolerance: Real,
    progress: str | None = None,
) -> tuple[Float[np.ndarray, "n section"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Where walkers are after `limit` strides, the outcome of their last, and how many they made.

    Those that fall are left behind every `ROUND` strides. The walker's parameters may be arrays.
    """
    x, walkers = x.copy(), stacked(walker, len(x), x.dtype)
    fate, count = np.zeros(len(x), np.int8), np.zeros(len(x), np.int32)
    left = np.arange(len(x))
    for done in range(0, limit, ROUND):
        more = min(ROUND, limit - done)
        shared = jnp.asarray(tolerance, x.dtype), np.int32(more)
        cells = some(walkers, left), x[left]
        label = progress and f"{progress}: stride {done}, {len(left)} walkers"
        x[left], fate[left], made = map_cells(persist_cell, (shared, cells), progress=label)
        count[left] += made
        left = left[fate[left] == Outcome.STRIDE]
        if len(left) == 0:
            break
    return x, fate, count


def persist_cell(shared, cell):
    """State after a number of strides, outcome of the last and how many of them were made."""
    tolerance, limit = shared
    walker, x = cell

    def going(carry):
        _, outcome, count = carry
        return (outcome == Outcome.STRIDE) & (count < limit)

    def advance(carry):
        x, _, count = carry
        result = follow_stride(walker, x, tolerance)
        made = result.outcome == Outcome.STRIDE
        return jnp.where(made, result.state, x), result.outcome, count + made.astype(count.dtype)

    outcome = jnp.asarray(Outcome.STRIDE, jnp.int8)
    return lax.while_loop(going, advance, (x, outcome, jnp.zeros((), jnp.int32)))


def starts_near(
    walker: Walker,
    parameter: str,
    branches: Sequence[Branch],
    values: Float[np.ndarray, " values"],
    tolerance: Real,
) -> Float[np.ndarray, "values starts section"]:
    """Starts beside the gaits of branches, for each value; NaN to make up their number."""
    guesses = [
        (i, cycle)
        for i, value in enumerate(values)
        for branch in branches
        for cycle in crossings(branch, value)
    ]
    tasks = [corrected(float(values[i]), cycle, None, 1.0) for i, cycle in guesses]
    rows: list[list[np.ndarray]] = [[] for _ in values]
    for (i, _), point in zip(guesses, together(walker, parameter, tasks, tolerance), strict=True):
        if point is not None:
            rows[i].append(point.cycle[0] + BESIDE * np.eye(1, point.cycle.shape[1])[0])
    starts = np.full((len(values), max(map(len, rows)), len(walker.section)), np.nan)
    for i, row in enumerate(rows):
        if row:
            starts[i, : len(row)] = row
    return starts
