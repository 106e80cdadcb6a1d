"""Viability: from which states some choice of actions keeps a system from failing.

A controller chooses an action before each stride, as values of parameters within limits. The states
from which some choice keeps it going for ever are the viability kernel (Aubin 1991), outside of
which no controller can prevent a failure. States from which some choice leads into a target, such
as the basin of a gait, within n strides are n-step capturable (Koolen and others 2012,
International Journal of Robotics Research 31:1094-1113). The share of actions that keep a state
viable is the measure of robustness of Heim and Sprowitz (2019, IEEE Transactions on Robotics
35:939-952).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Bool, Float, Int, Int32

from walker_jax.basins.memory import check_grid
from walker_jax.basins.methods import cell_map
from walker_jax.basins.schema import describe
from walker_jax.basins.volumes import grid_of
from walker_jax.cellmaps import cell_image, resolve
from walker_jax.checks import WrongUse, array, check_kind, check_precision, refuses_tracers, short
from walker_jax.control.actions import Actions, read_actions
from walker_jax.controlled_maps import (
    Boxes,
    Points,
    best_action,
    count_safe,
    find_capture,
    find_viable,
    unavoidable_failure,
)
from walker_jax.execution.progress import track
from walker_jax.execution.tiles import map_cells, order_of_cells
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.systems.outcomes import Outcome, failures_of, name_of_outcome
from walker_jax.systems.system import System
from walker_jax.walking.stride import stride

BYTES_PER_IMAGE = 5
"""Memory for each cell and action, without bounds."""


@refuses_tracers()
def viable(
    walker: System,
    grid: Grid,
    actions: Mapping[str, Any],
    *,
    target: Bool[np.ndarray, "*shape"] | None = None,
    bounds: bool = True,
    tolerance: float | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """The viability kernel of a system on a grid, and what leads to its gait.

    Before each stride a controller chooses an action, one of all combinations. To leave the grid
    counts as a failure.

    **Arguments:**

    - `walker`: any walker or other system, such as one of `systems`.
    - `grid`: of its section, whole.
    - `actions`: by the name of a parameter, a tuple (low, high, count) for so many values with both
      ends, or a list of values; of several parameters all combinations. The system's own values are
      one more action, the last, unless they are among these.
    - `target`: whether each cell belongs to the target. By default those whose centres converge to
      an attractor of `walker` as it is, by cell mapping: its passive basin.
    - `bounds`: whether to bound the kernel by what cells do as a whole. A stride is made from the
      corners of each cell too. The box around their images, widened by how far that of the centre
      is from the mean of theirs, holds the image of the cell to second order in its size. An
      `inner` cell has an action whose box lies in inner cells. An `outer` cell has an action that
      makes a stride from a corner or the centre, with a box that meets an outer cell.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show a progress bar on a terminal.

    **Returns** a data set over the grid's axes:

    - `viable`: whether some choice of actions keeps the walker on the grid for ever, cell by cell;
    - `inner`, `outer`: bounds on that, with `bounds`;
    - `safe_actions`: how many actions keep it viable;
    - `lasting`: the most strides that any choice makes from a cell that is not viable, else -1;
    - `failure`: the `Outcome` in which the longest of these walks ends, 0 where it is viable;
    - `capture`: the fewest strides into the target, 0 within it, -1 where none lead there;
    - `action`: the number of one that leads there soonest, or, where none does, keeps it viable;
      of several, the one that leads to the cell with the most safe actions; -1 in the target, where
      the system is left alone, and where there is none;

    and over `action_number` the values of each parameter, by its name. Attributes: `area` of the
    kernel in the state's coordinates, `inner_area` and `outer_area`, and `target_area`.

    Raises `ValueError` for a grid that does not fit the section, or is a slice, or that this
    machine has not the memory for, for actions that are none, and for a target of another shape.
    """
    check_kind("walker", walker, System)
    d = grid_axes(grid)
    if d < len(walker.section) == grid.coordinates:
        raise WrongUse("grid must be of all coordinates of the section, not a slice", of="grid")
    choice = read_actions(walker, actions)
    check_kind("bounds", bounds, bool)
    m = len(choice.values)
    each = (BYTES_PER_IMAGE + (2 + 8 * d) * bounds) * m + 25 + bounds * 20 * d * (2**d + 1)
    check_grid(walker, grid, "cell-map", each, kind="viability")
    for name in {*grid.names} & {*choice.names}:
        raise WrongUse(f"grid must not have an axis called {name}, as an action is: rename it")
    dtype = jnp.asarray(0.0).dtype
    check_precision(dtype)
    integrator = integrator_of(dtype, tolerance)
    chosen = (
        find_passive_basin(walker, grid, integrator)
        if target is None
        else read_target(target, grid)
    )
    points, boxes = map_actions(walker, grid, choice, integrator, bounds, progress)
    lasting = find_viable(points)
    kernel = lasting < 0
    capture, safe = find_capture(points, chosen), count_safe(points, kernel)
    # The soonest into the target; and of these, the one with most room for others after it.
    soonest = np.where(capture < 0, 0, capture.max() + 1 - capture).astype(np.int64)
    action = best_action(points, (len(choice.values) + 1) * soonest + safe)
    found = {
        "viable": kernel,
        "safe_actions": safe,
        "lasting": lasting,
        "failure": unavoidable_failure(points, lasting),
        "capture": capture,
        "action": np.where((kernel | (capture > 0)) & ~chosen, action, -1).astype(np.int32),
    }
    found |= {name: find_viable(one) < 0 for name, one in boxes.items()}
    return to_dataset(walker, grid, choice, found, chosen, float(integrator.tolerance))


def grid_axes(grid: Any) -> int:
    """The number of axes of a grid, checked to be one."""
    check_kind("grid", grid, Grid)
    return len(grid.names)


def read_target(target: Any, grid: Grid) -> Bool[np.ndarray, " n"]:
    """A target, checked, as a row."""
    values = array("target", target)
    if values.dtype != bool or values.shape != grid.shape:
        raise WrongUse(
            f"target must be True or False for each cell, of shape {grid.shape}, not "
            f"{short(target) if values.dtype != bool else values.shape}"
        )
    return values.ravel()


def find_passive_basin(
    walker: System, grid: Grid, integrator: Integrator
) -> Bool[np.ndarray, " n"]:
    """Cells that converge to an attractor without a choice of actions, by cell mapping."""
    return resolve(cell_map(walker, grid, integrator), sinks=len(Outcome)).attractor >= 0


class Arrivals(NamedTuple):
    """Where an action takes starts: centres of cells, or their corners."""

    place: Float[np.ndarray, "n d"]
    """On each axis, in cells from the grid's lower end; of strides that were made."""
    made: Bool[np.ndarray, " n"]
    image: Int32[np.ndarray, " n"]
    """The cell, or the sink."""


def map_actions(
    walker: System,
    grid: Grid,
    actions: Actions,
    integrator: Integrator,
    bounds: bool,
    progress: bool,
) -> tuple[Points, dict[str, Boxes]]:
    """The images of all cells by all actions; and the boxes of `inner` and `outer` bounds."""
    n, m, d = grid.size, len(actions.values), len(grid.names)
    points = Points(np.empty((n, m), np.int32))
    shape = (n, m, d) if bounds else (0, 0, d)
    low, high = (np.empty(shape, np.min_scalar_type(-max(grid.shape))) for _ in range(2))
    whole, some = np.empty(shape[:2], bool), np.empty(shape[:2], bool)
    corners = grid_of_corners(grid)
    for number in track(range(m), "actions", progress, m):
        acting = actions.of(walker, number)
        centres = take_strides(acting, grid, grid, integrator)
        points.image[:, number] = centres.image
        if bounds:
            around = take_strides(acting, corners, grid, integrator)
            box = box_around(grid, centres, around)
            low[:, number], high[:, number], whole[:, number], some[:, number] = box
    if not bounds:
        return points, {}
    return points, {
        "inner": Boxes(low, high, whole, grid.shape, every=True),
        "outer": Boxes(low, high, some, grid.shape, every=False),
    }


def grid_of_corners(grid: Grid) -> Grid:
    """A grid whose cells have the corners of another one's for their centres."""
    ends = zip(grid.names, grid.lower, grid.upper, grid.spacing / 2, grid.shape, strict=True)
    axes = {name: (low - half, high + half, count + 1) for name, low, high, half, count in ends}
    return Grid(axes, grid.shear, grid.origin)


def take_strides(acting: System, starts: Grid, grid: Grid, integrator: Integrator) -> Arrivals:
    """Where strides from the centres of one grid arrive on another."""
    order = order_of_cells(starts.shape)
    found = map_cells(take_stride, ((acting, starts, grid, integrator), order))
    back = np.empty_like(order)
    back[order] = np.arange(len(order), dtype=order.dtype)
    return Arrivals(*(values[back] for values in found))


def take_stride(
    shared: tuple[System, Grid, Grid, Integrator], index: Int[Array, ""]
) -> tuple[Float[Array, " d"], Bool[Array, ""], Int[Array, ""]]:
    """`Arrivals` of one start."""
    walker, starts, grid, integrator = shared
    by = {"tolerance": integrator.tolerance, "solver": integrator.solver}
    made = stride(walker, starts.centre(index), **by)
    image = cell_image(grid, made.state, made.outcome, leave=Outcome.LEFT_GRID)
    return grid.position(made.state), made.outcome == Outcome.STRIDE, image


def box_around(grid: Grid, centres: Arrivals, corners: Arrivals) -> tuple[np.ndarray, ...]:
    """The box that holds the image of each cell, to second order, and whether each bound counts it.

    Returns its first and last places on each axis. The inner bound counts it if no part of the cell
    fails and all of the box lies on the grid, the outer one if some of it does.
    """
    shape, d = np.array(grid.shape), len(grid.names)
    places = np.where(corners.made[:, None], corners.place, np.nan).reshape(*shape + 1, d)
    around = [
        places[tuple(slice(k, k + count) for k, count in zip(corner, shape, strict=True))]
        for corner in np.ndindex(*(2,) * d)
    ]
    middle = np.where(centres.made[:, None], centres.place, np.nan).reshape(*shape, d)
    ends = np.stack([*around, middle])
    least, most = np.fmin.reduce(ends), np.fmax.reduce(ends)
    whole: Any = np.isfinite(ends).all(axis=(0, -1))
    bend = np.abs(middle - np.mean(around, axis=0))
    # Where a part of a cell fails, how far its image goes is known to the size of that alone.
    bend = np.where(whole[..., None], bend, np.fmax(most - least, 1))
    with np.errstate(invalid="ignore"):
        least, most = np.floor(least - bend), np.floor(most + bend)
        inside = ((least >= 0) & (most < shape)).all(axis=-1)
        touches = ((most >= 0) & (least < shape)).all(axis=-1)
    known = np.isfinite(least).all(axis=-1)
    clip = lambda value: np.clip(np.where(known[..., None], value, 0), 0, shape - 1)
    # The centre's own cell belongs to the box, however its place is rounded.
    image, on_grid = centres.image.reshape(grid.shape), (centres.image < grid.size)
    on_grid = on_grid.reshape(grid.shape)
    held = np.stack(np.unravel_index(np.where(on_grid, image, 0), grid.shape), axis=-1)
    low, high = (
        np.where(on_grid[..., None], end(held, clip(of)), clip(of))
        for end, of in ((np.minimum, least), (np.maximum, most))
    )
    flat = lambda value: value.reshape(grid.size, *value.shape[d:])
    return tuple(map(flat, (low, high, whole & inside & on_grid, (known & touches) | on_grid)))


def to_dataset(
    walker: System,
    grid: Grid,
    actions: Actions,
    found: dict[str, np.ndarray],
    target: Bool[np.ndarray, " n"],
    tolerance: float,
) -> xr.Dataset:
    """All of it over the grid, with areas as attributes."""
    areas = {"viable": "area", "inner": "inner_area", "outer": "outer_area"}
    sizes = {
        called: float(found[name].sum() * grid.cell_area)
        for name, called in areas.items()
        if name in found
    }
    sizes["target_area"] = float(target.sum() * grid.cell_area)
    settings = {"actions": list(actions.names), "tolerance": tolerance, **sizes}
    frame = {
        "axis": ("axis", np.array(grid.names, object)),
        "lower": ("axis", grid.lower),
        "upper": ("axis", grid.upper),
        "shear": (("coordinate", "axis"), grid.shear),
        "origin": ("coordinate", grid.origin),
    }
    data = describe(walker, grid, settings).assign(frame)
    over = {name: (grid.names, values.reshape(grid.shape)) for name, values in found.items()}
    columns = zip(actions.names, actions.values.T, strict=True)
    return data.assign(over).assign({name: ("action_number", row) for name, row in columns})


def summarise_viability(data: xr.Dataset) -> dict:
    """The areas of the kernel and of capturable states, and the failures around it, for JSON."""
    capture, failure = data["capture"].values, data["failure"].values
    cell = grid_of(data).cell_area
    steps = range(1, int(capture.max(initial=0)) + 1)
    codes, counts = np.unique(failure[~data["viable"].values], return_counts=True)
    areas = ("area", "inner_area", "outer_area", "target_area")
    return {
        "cells": int(capture.size),
        **{name: data.attrs.get(name) for name in areas},
        "capturable": [float(((capture >= 0) & (capture <= n)).sum() * cell) for n in steps],
        "failures": {
            name_of_outcome(int(code), failures_of(data)): int(count)
            for code, count in zip(codes, counts, strict=True)
        },
    }
