"""The fractal dimension of a basin's boundary."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.basins.attractor_search import survey
from walker_jax.basins.computation import check_grid
from walker_jax.basins.runs import flat_index
from walker_jax.checks import check_precision, numbers, refuses_tracers
from walker_jax.execution.progress import bar
from walker_jax.fractals.dimensions import (
    Uncertainty,
    sort_distances,
    uncertainty_exponent,
)
from walker_jax.grids import Grid, edge
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.system import System
from walker_jax.walkers.model import is_planar

DISTANCES = 10.0 ** np.linspace(-6, -3.5, 11)
"""Distances of starts whose fates are compared, as shares of the lengths of a grid's axes."""
PAIRS = 50_000
"""Number of starts for each distance."""
DISTANCES_IN_SPACE, PAIRS_IN_SPACE = 10.0 ** np.linspace(-4, -2.5, 6), 4_000
"""Distances and starts in `robustness` of walkers in space. There are twenty-three times fewer
starts, as each stride takes eleven times as long. At these distances some tens of starts are
uncertain, and the distances are shorter than a cell of the default slice."""


def comparisons(walker: System) -> dict[str, Any]:
    """Return the distances and pairs with which `robustness` compares starts of a walker."""
    if is_planar(walker):
        return {"distances": DISTANCES, "pairs": PAIRS}
    return {"distances": DISTANCES_IN_SPACE, "pairs": PAIRS_IN_SPACE}


@refuses_tracers()
def boundary_dimension(
    walker: System,
    grid: Grid,
    *,
    distances: Sequence[Any] | ArrayLike = DISTANCES,
    pairs: int = PAIRS,
    strides: int = 200,
    confidence: float = 0.95,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
) -> Uncertainty:
    """Estimate the dimension of the basins' boundary in a region, by the uncertainty exponent.

    A start is uncertain at a distance if a walker at that distance, on either side in a random
    direction, converges to another attractor, or to none. Starts are drawn from the cells with a
    neighbour that converges to another attractor, or to none; elsewhere hardly any are uncertain.

    ```python
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 100))
    wj.boundary_dimension(walker, grid, pairs=2000).value
    ```

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: region or slice, in cells larger than the distances.
    - `distances`: as shares of the lengths of the grid's axes.
    - `pairs`: number of starts for each distance.
    - `strides`: number of strides for which a walker is followed.
    - `confidence`, `seed`: of the interval, and of random numbers.
    - `tolerance`, `progress`: as in `refine`.

    **Returns** an `Uncertainty`, NaN where all cells converge to one attractor, or none. All
    failures count as one fate here.

    Raises `ValueError` as `basin` and `uncertainty_exponent` do.
    """
    check_grid(walker, grid, "direct")
    apart = sort_distances(numbers("distances", distances), pairs)
    dtype = jnp.result_type(float)
    check_precision(dtype, "boundary_dimension, which compares starts 1e-6 apart,")
    integrator = integrator_of(dtype, tolerance)

    shape = np.array(grid.shape)
    with bar("dimension of the boundary", progress, len(apart) + 1) as update:
        centres = grid.centres(np.arange(grid.size))
        labels, mapper, _ = survey(walker, centres, integrator, strides, boxes=True)
        update(1)
        on_edge = np.argwhere(edge(labels.attractor.reshape(grid.shape)))
        if len(on_edge) == 0:
            return Uncertainty(np.nan, np.nan, np.nan, np.nan, np.zeros(0), np.zeros(0))
        done = count(2)

        def label_of(share: Float[np.ndarray, "n axes"]) -> Int[np.ndarray, " n"]:
            order = np.argsort(flat_index((share * shape).astype(int).T, grid.shape))
            labels = mapper(grid.points_at(share[order]))  # fastest among neighbours
            found = np.empty_like(labels.attractor)
            found[order] = labels.attractor
            update(next(done))
            return found

        def draw(rng: np.random.Generator, n: int) -> Float[np.ndarray, "n axes"]:
            return (rng.choice(on_edge, n) + rng.uniform(size=(n, len(shape)))) / shape

        return uncertainty_exponent(
            label_of, draw, apart, pairs=pairs, seed=seed, confidence=confidence
        )
