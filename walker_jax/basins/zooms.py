"""Zooms into the boundary between fates: ever narrower windows around one of its points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.basins.attractor_search import label_and_find, sample_indices, survey
from walker_jax.basins.computation import check_grid
from walker_jax.basins.edge_states import check_state
from walker_jax.basins.edge_tracking import HALVINGS
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.narrow_windows import follow_window
from walker_jax.basins.schema import describe
from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_number,
    check_precision,
    check_whole,
    refuses_tracers,
)
from walker_jax.execution.progress import track
from walker_jax.grids import Grid, edge, steps_around
from walker_jax.integrators.integrator import integrator_of
from walker_jax.segments import close_in
from walker_jax.systems.system import System, check_single

MOST_FRAMES = 100_000
"""Most windows of a zoom: an hour of film."""


@refuses_tracers()
def boundary_point(
    walker: System,
    grid: Grid,
    near: Float[ArrayLike, " section"] | Sequence[Any] | None = None,
    *,
    strides: int = 500,
    tolerance: float | None = None,
) -> Float[np.ndarray, " section"]:
    """Find a point of the boundary between two fates, to the last digit of float64.

    The grid is followed directly. Among its cells beside one of another fate or attractor, the
    nearest to a point is taken. Bisection between the two centres continues until no number lies
    between.

    ```python
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 100))
    point = wj.boundary_point(walker, grid, near=(0.2, -0.2))
    ```

    **Arguments:**

    - `walker`, `grid`: as in `basin`, by direct iteration.
    - `near`: a point of the section, by default the middle of the grid; distances are in cells.
    - `strides`, `tolerance`: as in `basin`.

    Raises `ValueError` as `basin` does; `ComputationFailed` where all cells have one fate.
    """
    check_grid(walker, grid, "direct")
    point = None if near is None else check_state(walker, "near", near)
    mapper = checked_mapper(walker, grid, strides, tolerance, "boundary_point, to the last digit,")
    return find_boundary_point(mapper, grid, point)


def checked_mapper(
    walker: System, grid: Grid, strides: int, tolerance: float | None, needed_by: str
) -> Mapper:
    """Check other arguments; return the mapper to a grid's attractors, with capture boxes."""
    check_single(walker)
    dtype = jnp.result_type(float)
    check_precision(dtype, needed_by)
    starts = grid.centres(sample_indices(grid.size))
    return survey(walker, starts, integrator_of(dtype, tolerance), strides, boxes=True).mapper


def find_boundary_point(
    mapper: Mapper, grid: Grid, near: Float[np.ndarray, " section"] | None = None
) -> Float[np.ndarray, " section"]:
    """Find `boundary_point`, by a mapper."""
    labels, mapper, _ = label_and_find(mapper, grid.centres(np.arange(grid.size)))
    label = labels.number.reshape(grid.shape)
    on_edge = np.argwhere(edge(label))
    if len(on_edge) == 0:
        raise ComputationFailed(
            "all cells of the grid have one fate: it holds no boundary; take a wider or a finer one"
        )
    shape = np.array(grid.shape)
    middle = (shape - 1) / 2 if near is None else grid.place(near)
    cell = on_edge[np.linalg.norm(on_edge - middle, axis=1).argmin()]
    beside = cell + steps_around(len(cell))
    beside = beside[((beside >= 0) & (beside < shape)).all(axis=1)]
    other = beside[(label[tuple(beside.T)] != label[tuple(cell)]).argmax()]
    ends = grid.points_at((np.stack([cell, other]) + 0.5) / shape)
    return close_in(lambda x: mapper(x).number, ends, 0.0, HALVINGS).ends[0, 1]


@refuses_tracers()
def zoom(
    walker: System,
    grid: Grid,
    factor: float | int,
    centre: Float[ArrayLike, " section"] | Sequence[Any] | None = None,
    *,
    frames: int = 120,
    strides: int = 500,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Compute the fates in ever narrower windows of a grid, down to 1 / `factor`, for a film.

    ```python
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.04, 0.01, 40))
    data = wj.zoom(walker, grid, 1e4, frames=5)
    ```

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: the size of the first window, of two dimensions or more, and the cells of each.
    - `factor`: by which the last window is narrower than the first; successive windows narrow by
      one ratio.
    - `centre`: point of the section in the middle of all windows, by default a `boundary_point`.
    - `frames`: number of windows.
    - `strides`, `tolerance`: as in `basin`.
    - `progress`: whether to show a progress bar on a terminal, after a second.

    **Returns** a data set of `fate` and `attractor` over `frame` and the grid's axes, whose
    coordinates are those of the last window times its factor. Over `frame` alone it has `factor`,
    and `ahead`, the strides by which the centre was followed before all starts were.

    Raises `ValueError` as `basin` does, also for windows narrower than float64 resolves.
    """
    check_number("factor", factor)
    if not 1 <= factor < np.inf:
        raise WrongUse(f"factor must be 1 or more, and finite, not {factor}")
    check_whole("frames", frames, 2, MOST_FRAMES)
    check_grid(walker, grid, "direct", kind="zoom")
    middle = None if centre is None else check_state(walker, "centre", centre)
    mapper = checked_mapper(walker, grid, strides, tolerance, "zoom, into the last digits,")
    middle = find_boundary_point(mapper, grid) if middle is None else middle
    factors = factor ** np.linspace(0, 1, frames)
    windows = [grid.zoom(middle, one) for one in factors.tolist()]
    # The last window first: it may be too narrow.
    ahead_of = [follow_window(walker, one, mapper.integrator, strides) for one in windows[::-1]]
    cells = np.arange(grid.size)
    fate, attractor, ahead = [], [], []
    for followed, made in track(ahead_of[::-1], "windows", progress):
        left = mapper._replace(strides=strides - made)
        found, mapper, _ = label_and_find(left, followed.centres(cells))  # frames share its numbers
        fate.append(found.fate.reshape(grid.shape))
        attractor.append(found.attractor.reshape(grid.shape))
        ahead.append(made)
    settings = {
        "method": "direct",
        "strides": strides,
        "tolerance": float(mapper.integrator.tolerance),
    }
    about = describe(walker, windows[0], settings)
    dims = "frame", *grid.names
    return about.assign(
        fate=(dims, np.array(fate)),
        attractor=(dims, np.array(attractor, np.int32)),
        factor=("frame", factors),
        ahead=("frame", np.array(ahead, np.int32)),
    ).assign_attrs(origin=middle.tolist())
