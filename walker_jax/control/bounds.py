"""Bounds on the viability kernel, narrowed by finer cells where they differ.

Cells between the bounds, in the outer one but not in the inner one, are cut in two along each axis,
and their parts are mapped anew; and so on, level by level. All other cells are settled. All parts
of an `inner` cell stay viable, as its box lies in viable cells; a cell outside the `outer` bound
has no viable part. So bounds never move apart, and only the kernel's boundary takes further
strides.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int32

from walker_jax.basins.refined_cells import check_level
from walker_jax.basins.refinement import finer
from walker_jax.control.images import MappedCells, Task, bytes_of_cell
from walker_jax.controlled_maps import Points, find_viable
from walker_jax.grids import MAX_SINKS

MapCells = Callable[[Task, Int[np.ndarray, " n"], str], MappedCells]
"""Returns the images of some cells of a task's grid, and labels its progress."""


class Bounds(NamedTuple):
    """Cells of a grid within each bound, in the order of their indices."""

    inner: Bool[np.ndarray, " n"]
    outer: Bool[np.ndarray, " n"]


class Narrowed(NamedTuple):
    """Cells of several sizes that fill the grid, their images, and the bounds."""

    points: Points
    """Images of the cells among each other."""
    number: Int32[np.ndarray, " finest"]
    """Number of the cell that holds each cell of the finest grid."""
    bounds: Bounds
    """Bounds over the finest grid."""
    mapped: list[int]
    """Number of cells mapped, level by level."""
    areas: list[tuple[float, float]]
    """Inner and outer area, level by level."""

    def of_parts(self, chosen: Bool[np.ndarray, " finest"]) -> Bool[np.ndarray, " n"]:
        """Mark the chosen cells, given their chosen parts."""
        found = np.zeros(self.points.shape[0], bool)
        found[self.number] = chosen
        return found


def narrow(task: Task, images: MappedCells, levels: int, map_cells: MapCells) -> Narrowed:
    """Bound the kernel, given the images of all cells of the coarse grid."""
    each = bytes_of_cell(len(task.actions.values), len(task.grid.names), bounds=True)
    grid, cells = task.grid, np.arange(task.grid.size)
    number, bounds = cells.astype(np.int32), Bounds(np.zeros(grid.size, bool), cells >= 0)
    rows, whole, mapped, areas = [images.image], [np.ones(grid.size, bool)], [], []
    for level in range(levels + 1):
        if level:
            is_open = bounds.outer & ~bounds.inner
            whole[-1] = ~is_open[cells]
            number, is_open, *both = (
                subdivide(values, grid.shape) for values in (number, is_open, *bounds)
            )
            grid, cells, bounds = finer(task.grid, level), np.flatnonzero(is_open), Bounds(*both)
            check_level(levels, level, sum(mapped) + len(cells), each)
            number[cells] = sum(mapped) + np.arange(len(cells))
            images = map_cells(task._replace(grid=grid), cells, f"level {level}")
            rows.append(images.image)
            whole.append(np.ones(len(cells), bool))
        bounds = update_bounds(images, grid.shape, cells, bounds)
        mapped.append(len(cells))
        areas.append(tuple(float(one.sum() * grid.cell_area) for one in bounds))
    points, number = join_levels(rows, whole, number) if levels else (Points(*rows), number)
    return Narrowed(points, number, bounds, mapped, areas)


def update_bounds(
    images: MappedCells, shape: tuple[int, ...], cells: Int[np.ndarray, " n"], before: Bounds
) -> Bounds:
    """Return new bounds from the previous ones; only cells with images may change."""
    inner, outer = before.inner.copy(), before.outer.copy()
    for bound, every in ((inner, True), (outer, False)):
        bound[cells] = find_viable(images.boxes(shape, every=every), cells, before.outer) < 0
    return Bounds(inner, outer)


def join_levels(
    rows: list[Int32[np.ndarray, "_cells m"]],
    whole: list[Bool[np.ndarray, " _cells"]],
    number: Int32[np.ndarray, " finest"],
) -> tuple[Points, Int32[np.ndarray, " finest"]]:
    """Return the images, among each other, of the cells of all levels that were not cut.

    At first, images are cells of the finest grid. `number` gives, for each of these, the number of
    the cell that holds it, counting cut cells too. It is returned renumbered, without cut cells.
    """
    kept = np.concatenate(whole)
    number = (np.cumsum(kept, dtype=np.int32) - 1)[number]
    sinks = np.count_nonzero(kept) + np.arange(MAX_SINKS + 1, dtype=np.int32)
    leads = np.append(number, sinks)
    image = [leads[part[chosen]] for part, chosen in zip(rows, whole, strict=True)]
    return Points(np.concatenate(image)), number


def subdivide(values: np.ndarray, shape: tuple[int, ...], levels: int = 1) -> np.ndarray:
    """Repeat the values of a grid's cells for their parts, 2^levels along each axis."""
    values = values.reshape(shape)
    for axis in range(len(shape)):
        values = values.repeat(2**levels, axis)
    return values.ravel()
