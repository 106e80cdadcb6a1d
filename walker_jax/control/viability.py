"""Viability: the states from which some choice of actions keeps a system from failing.

A controller chooses an action before each stride: values of parameters within limits. The viability
kernel (Aubin 1991) is the set of states from which some choice keeps the system going for ever; no
controller can prevent a failure outside it. States from which some choice leads within n strides
into a target, such as the basin of a gait, are n-step capturable (Koolen and others 2012,
International Journal of Robotics Research 31:1094-1113). The share of actions that keep a state
viable is the measure of robustness of Heim and Sprowitz (2019, IEEE Transactions on Robotics
35:939-952).
"""

import hashlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool

from walker_jax import storage
from walker_jax.basins.computation import check_grid
from walker_jax.basins.refinement import BYTES_PER_REFINED_CELL, FINEST, finer
from walker_jax.basins.schema import describe, request_of
from walker_jax.basins.volumes import frame_of, grid_of
from walker_jax.cellmaps import resolve
from walker_jax.checks import (
    WrongUse,
    array,
    check_kind,
    check_precision,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.control.actions import read_actions
from walker_jax.control.bounds import narrow, subdivide
from walker_jax.control.images import (
    MappedCells,
    Task,
    bytes_of_cell,
    insert_tile,
    map_in_tiles,
    map_tile,
    tile_shape,
)
from walker_jax.controlled_maps import (
    Points,
    best_action,
    count_safe,
    find_capture,
    find_viable,
    unavoidable_failure,
)
from walker_jax.execution.pieces import Work, complete_store
from walker_jax.execution.workers import Compute, check_cluster, compute_here
from walker_jax.grids import MAX_SIZE, Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.outcomes import OUTCOMES, failures_of, join_names, name_of_outcome
from walker_jax.systems.system import System


@refuses_tracers()
def viable(
    walker: System,
    grid: Grid,
    actions: Mapping[str, Any],
    *,
    target: Bool[np.ndarray, "*shape"] | None = None,
    bounds: bool = True,
    levels: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
    out: Path | str | None = None,
    request: dict | None = None,
    overwrite: bool = False,
    cluster: Any = None,
) -> xr.Dataset:
    """Compute the viability kernel of a system on a grid, and the actions that lead to its gait.

    ```python
    walker = wj.PoweredWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 125))
    wj.viable(walker, grid, {"push_off": (0, 0.1, 17)}).area
    ```

    Before each stride a controller chooses an action, one of all combinations. Leaving the grid
    counts as a failure.

    **Arguments:**

    - `walker`: any walker or other system, such as one of `systems`.
    - `grid`: a grid over its whole section, not a slice.
    - `actions`: values of each parameter by name: a tuple (low, high, count), which includes both
      ends, or a list of values. Several parameters take all combinations. The system's own values
      are added as the last action, unless they are among these.
    - `target`: whether each cell belongs to the target. By default the target is the passive basin:
      the cells whose centres converge to an attractor of `walker` as it is, by cell mapping.
    - `bounds`: whether to bound the kernel by the images of whole cells. A stride is then made from
      the corners of each cell too. A box encloses their images, widened by the distance of the
      centre's image from their mean; it holds the image of the cell to first order in its size. An
      `inner` cell has an action whose box lies in inner cells. An `outer` cell has an action that
      makes a stride from a corner or the centre, with a box that meets an outer cell.
    - `levels`: how many times cells between the bounds are cut in two along each axis, and their
      parts mapped anew.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: whether to show a progress bar on a terminal, after a second.
    - `out`, `request`, `overwrite`, `cluster`: as in `basin`. A piece holds the images of some
      cells by some actions. An interrupted run is resumed from there, with the same result to the
      last bit; strides from parts of cells are made again.

    **Returns** a data set over the axes of the grid, or of a grid 2^levels times as fine along each
    axis, in which all parts of an uncut cell are alike:

    - `viable`: whether some choice of actions keeps the walker on the grid for ever;
    - `inner`, `outer`: bounds on that, with `bounds`;
    - `safe_actions`: how many actions keep a cell viable;
    - `lasting`: the most strides that any choice makes from a cell that is not viable, else -1;
    - `failure`: the `Outcome` that ends the longest of these walks, 0 if the cell is viable;
    - `capture`: the fewest strides into the target, 0 within it, -1 if none lead there;
    - `action`: the number of the action that leads into the target soonest or, if none does, keeps
      the cell viable. Of several, it is the one that leads to the cell with the most safe actions.
      It is -1 in the target, where the system is left alone, and where no such action exists;

    over `action_number`, the values of each parameter, by its name; and with `bounds`, over the
    levels, `mapped`, the number of cells mapped, and the areas within the bounds after each level,
    `level_inner_area` and `level_outer_area`. Attributes: `area` of the kernel in the state's
    coordinates, `inner_area` and `outer_area`, and `target_area`.

    Raises `ValueError` for a grid that does not fit the section, is a slice, or needs more memory
    than this machine has; for invalid actions; for a target of another shape; and for `out` as
    `basin` does.
    """
    check_kind("walker", walker, System)
    check_kind("grid", grid, Grid)
    d = len(grid.names)
    if d < len(walker.section) == grid.coordinates:
        raise WrongUse("grid must be of all coordinates of the section, not a slice", of="grid")
    choice = read_actions(walker, actions)
    check_kind("bounds", bounds, bool)
    levels = check_whole("levels", levels, 0, FINEST)
    if (size := grid.size << d * levels) > MAX_SIZE:
        raise WrongUse(
            f"levels={levels} needs {size} cells, and {MAX_SIZE} is the limit: lower levels"
        )
    if levels and not bounds:
        raise WrongUse(f"levels={levels} narrow bounds: leave bounds=False out")
    each = bytes_of_cell(len(choice.values), d, bounds=bounds)
    check_grid(walker, grid, "cell-map", each, kind="viability")
    finest = finer(grid, levels)
    check_grid(walker, finest, "cell-map", BYTES_PER_REFINED_CELL)
    for name in {*grid.names} & {*choice.names}:
        raise WrongUse(f"grid must not have an axis called {name}, as an action is: rename it")
    dtype = jnp.result_type(float)
    check_precision(dtype)
    task = Task(walker, choice, integrator_of(dtype, tolerance), grid, finest, bounds)
    if target is not None:
        target = subdivide(read_target(target, grid), grid.shape, levels)
    plan = Plan(task, levels, target)
    if out is not None:
        work = work_of(plan, request, progress)
        how = {"overwrite": overwrite, "cluster": cluster, "progress": progress}
        return complete_store(work, Path(out), **how)
    check_cluster(cluster, out)
    cells = map_in_tiles(task, None, compute_here, "strides", progress)
    return plan.answer(cells, compute_here, progress)


def read_target(target: Any, grid: Grid) -> Bool[np.ndarray, " n"]:
    """Return a checked target as a row."""
    values = array("target", target)
    if values.dtype != bool or values.shape != grid.shape:
        raise WrongUse(
            f"target must be True or False for each cell, of shape {grid.shape}, not "
            f"{short(target) if values.dtype != bool else values.shape}"
        )
    return values.ravel()


class Plan(NamedTuple):
    """Everything that is to be computed."""

    task: Task
    levels: int
    target: Bool[np.ndarray, " n"] | None
    """Cells of the finest grid that belong to the target; None for the passive basin."""

    def about(self) -> xr.Dataset:
        """Return the axes of the finest grid, and the settings."""
        walker, choice, integrator, _, grid, _ = self.task
        settings = {"actions": join_names(choice.names), "tolerance": float(integrator.tolerance)}
        columns = zip(choice.names, choice.values.T, strict=True)
        rows = {name: ("action_number", row) for name, row in columns}
        return describe(walker, grid, settings).assign(frame_of(grid) | rows)

    def request(self) -> dict:
        """Return everything the result depends on, by which a stored result is recognised."""
        choice, target = self.task.actions, self.target
        own = {
            "command": "viable",
            "actions": dict(zip(choice.names, choice.values.T.tolist(), strict=True)),
            "bounds": self.task.bounds,
            "levels": self.levels,
            "target": None if target is None else hashlib.sha256(target.tobytes()).hexdigest(),
        }
        return request_of(self.about(), self.task.grid) | own

    def answer(self, cells: MappedCells, each: Compute, progress: bool) -> xr.Dataset:
        """Return the data set, given the images of all cells of the coarse grid."""
        grid, target = self.task.finest, self.target
        if not self.task.bounds:
            found = settle(self.task, Points(cells.image), target)
            return with_areas(self.about(), grid, found)
        map_cells = lambda task, some, label: map_in_tiles(task, some, each, label, progress)
        mixed = narrow(self.task, cells, self.levels, map_cells)
        if target is not None:
            target = mixed.of_parts(target)
        found = settle(self.task, mixed.points, target)
        found = {name: values[mixed.number] for name, values in found.items()}
        inner, outer = np.array(mixed.areas).T
        data = self.about().assign(
            mapped=("level", mixed.mapped),
            level_inner_area=("level", inner),
            level_outer_area=("level", outer),
        )
        return with_areas(data, grid, found | mixed.bounds._asdict())


def settle(
    task: Task, points: Points, target: Bool[np.ndarray, " n"] | None
) -> dict[str, np.ndarray]:
    """Compute the results for each cell from the images of all cells."""
    if target is None:  # cells that converge to an attractor without a choice of actions
        passive = resolve(points.image[:, task.actions.own], sinks=OUTCOMES)
        target = passive.attractor >= 0
    lasting = find_viable(points)
    kernel = lasting < 0
    capture, safe = find_capture(points, target), count_safe(points, kernel)
    # The soonest into the target; of several, the one that leaves most safe actions.
    soonest = np.where(capture < 0, 0, capture.max() + 1 - capture).astype(np.int64)
    action = best_action(points, (len(task.actions.values) + 1) * soonest + safe)
    return {
        "viable": kernel,
        "safe_actions": safe,
        "lasting": lasting,
        "failure": unavoidable_failure(points, lasting),
        "capture": capture,
        "action": np.where((kernel | (capture > 0)) & ~target, action, -1).astype(np.int32),
    }


def with_areas(data: xr.Dataset, grid: Grid, found: dict[str, np.ndarray]) -> xr.Dataset:
    """Add arrays over the grid, and their areas as attributes."""
    areas = {"viable": "area", "inner": "inner_area", "outer": "outer_area"}
    sizes = {areas[name]: found[name].sum() for name in areas if name in found}
    sizes["target_area"] = (found["capture"] == 0).sum()
    data = data.assign_attrs({name: float(n * grid.cell_area) for name, n in sizes.items()})
    return data.assign(
        {name: (grid.names, values.reshape(grid.shape)) for name, values in found.items()}
    )


def work_of(plan: Plan, request: dict | None, progress: bool) -> Work:
    """Return how `viable` is stored: images piece by piece, which are removed at the end.

    Once all images are there, the kernel is computed, with strides from parts of cells.
    """
    task = plan.task
    cells = MappedCells.empty(task, task.grid.size)
    names = {f"stride_{name}": name for name, values in cells._asdict().items() if len(values)}
    dims = "cell", "action_number", "axis"
    nothing = {
        stored: xr.Variable(dims[: one.ndim], np.broadcast_to(one.dtype.type(0), one.shape))
        for stored, name in names.items()
        for one in [getattr(cells, name)]
    }
    tile_of = lambda place, i: tuple((one.start, one.stop) for one in place.at(i))

    def finish(place: storage.Pieces, each: Compute) -> xr.Dataset:
        for i in range(place.count):
            part = {name: place.read(stored, i) for stored, name in names.items()}
            insert_tile(cells, tile_of(place, i), part)
        return plan.answer(cells, each, progress)

    return Work(
        request or plan.request(),
        plan.about(),
        nothing,
        tile_shape(task.grid.size, len(task.actions.values)),
        finish,
        tile_of,
        partial(stored_tile, task, names),
        aside=[*names],
    )


def stored_tile(
    task: Task, names: Mapping[str, str], _notes: dict, tile: Any
) -> dict[str, np.ndarray]:
    """Map a tile, and return the arrays to store by their names in the store."""
    part = map_tile(task, None, tile)
    return {stored: getattr(part, name) for stored, name in names.items()}


def summarise_viability(data: xr.Dataset) -> dict:
    """Summarise the areas of the kernel and of capturable states, and the failures, for JSON."""
    capture, failure = data["capture"].values, data["failure"].values
    cell = grid_of(data).cell_area
    steps = range(1, int(capture.max(initial=0)) + 1)
    codes, counts = np.unique(failure[~data["viable"].values], return_counts=True)
    areas = ("area", "inner_area", "outer_area", "target_area")
    of_level = ("mapped", "level_inner_area", "level_outer_area")
    levels = zip(*(data[name].values.tolist() for name in of_level if name in data), strict=True)
    return {
        "cells": int(capture.size),
        **{name: data.attrs.get(name) for name in areas},
        "levels": [
            dict(zip(("mapped", "inner_area", "outer_area"), one, strict=True)) for one in levels
        ],
        "capturable": [float(((capture >= 0) & (capture <= n)).sum() * cell) for n in steps],
        "failures": {
            name_of_outcome(int(code), failures_of(data)): int(count)
            for code, count in zip(codes, counts, strict=True)
        },
    }
