"""Ascent by many parameters, such as the weights of a network: Adam, by minibatches of starts.

Areas, volumes and basin stability are measured in each step on a coarse grid of their own, which
lies at random: its cells are a batch of starts. So gradients are right on average, and cost little.
Some walkers on the way are measured once more, all on one finer grid, and the best is the optimum.
Other objectives have no batches: each step has their gradient.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.design.area_gradients import AreaSettings, MeasuredArea
from walker_jax.design.climbs import Climb, can_be_climbed, explain_failure
from walker_jax.design.trace import Trace
from walker_jax.grids import Grid
from walker_jax.systems.system import System

CHECKS = 5
"""Walkers on the way that are measured on one grid, beside the first one."""
CHECK_STAGE = 1
"""The stage of climbs by whose settings they are measured."""


class Training(NamedTuple):
    """Settings of an ascent by many parameters."""

    steps: int
    """Most steps of Adam."""
    rate: float
    """Step size: the change of each number in a step, or of its place between bounds, at most."""
    batch: int
    """About how many starts a step has."""


def train(trace: Trace, place: Float[np.ndarray, " parameters"], how: Training) -> Climb:
    """Ascend from a place by steps of Adam, until the time is over or nothing walks any more."""
    import optax  # only here, as it takes a quarter of a second

    problem, random = trace.problem, np.random.default_rng(trace.problem.seed)
    optimiser = optax.adam(how.rate)
    standard = lambda: jax.numpy_dtype_promotion("standard")  # as optax's own arithmetic needs
    with standard():
        state = optimiser.init(jnp.asarray(place))
    allowed, rows = trace.limits.nearest_allowed(place), []
    while allowed is not None and len(rows) <= how.steps:
        grid = problem.grid and batch_grid(problem.grid, how.batch, random)

        def measure(settings: AreaSettings, walker: System, grid=grid) -> MeasuredArea:
            return settings._replace(grid=grid, levels=0, check=0).measure(walker)

        place = allowed
        row = trace.budget.try_in_time(partial(trace.measure_batch, place, measure))
        if row is None or not can_be_climbed(problem, row):
            break
        trace.budget.begin()  # also if it was known
        rows.append(row)
        uphill = problem.sign * row.gradient * problem.scale
        downhill = jnp.asarray(-trace.limits.feasible_direction(place, uphill))
        with standard():
            update, state = optimiser.update(downhill, state)
        allowed = trace.limits.nearest_allowed(problem.within(place + np.asarray(update)))
    if not rows:
        return Climb(None, None, False, explain_failure(trace, place))
    if problem.size:
        some = np.unique(np.linspace(0, len(rows) - 1, CHECKS + 1).round().astype(int))
        order = [some[0], *some[:0:-1]]  # in a hurry the first and the last tell most
        places = [problem.place_of(rows[number].parameters) for number in order]
        check = partial(trace.measure, 0, CHECK_STAGE, value_only=True)
        trace.budget.extend()
        checked = [trace.budget.try_in_time(partial(check, one)) for one in places]
        known = [row for row in checked if row is not None]
        rows = known if len(known) > 1 else [rows[0], rows[-1]]
    return Climb(rows[0], max(rows, key=lambda row: problem.sign * row.value), False)


def batch_grid(grid: Grid, cells: int, random: np.random.Generator) -> Grid:
    """Return a grid over the same region, of about so many cells at most, shifted at random."""
    shrink = min(1.0, (cells / grid.size) ** (1 / len(grid.names)))
    counts = np.maximum(2, np.round(np.asarray(grid.counts) * shrink)).astype(np.int32)
    lower, upper = np.asarray(grid.lower), np.asarray(grid.upper)
    shift = random.uniform(-0.5, 0.5, len(counts)) * (upper - lower) / counts
    fields = lambda one: (one.counts, one.lower, one.upper)
    return eqx.tree_at(fields, grid, (counts, lower + shift, upper + shift))
