"""Cell mapping and direct iteration, for a grid or for a part of it."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Int

from walker_jax.basins.attractor import Attractor, Basins, Followed, in_order, until_near
from walker_jax.basins.attractor_search import (
    LONGEST_PERIOD,
    PATIENCE,
    centres,
    sample,
    settle,
    spread,
)
from walker_jax.basins.mapper import explain, follow
from walker_jax.cellmaps import CellMap, cell_image, resolve
from walker_jax.execution.tiles import map_cells, order_of_cells
from walker_jax.grids import Grid
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.stepping import stride


def cell_mapping(walker: Walker, grid: Grid, tolerance: float, progress: bool = False) -> Basins:
    """Simple cell mapping: one stride from the centre of each cell, then cells follow cells."""
    ends = resolve(cell_map(walker, grid, tolerance, progress=progress), sinks=len(Outcome))
    attractors, number = attractors_of_map(walker, grid, ends, tolerance)
    return Basins(*fates(ends, number), attractors)


def fates(
    ends: CellMap, number: Int[np.ndarray, " cycles"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `basin` says of cells, given where they end, and the attractor of each cycle."""
    fate = np.maximum(ends.sink, Outcome.STRIDE).astype(np.int8)
    return fate, np.append(number, np.int32(-1))[ends.attractor], ends.steps


def attractors_of_map(
    walker: Walker, grid: Grid, ends: CellMap, tolerance: float
) -> tuple[list[Attractor], Int[np.ndarray, " cycles"]]:
    """The attractors and artefacts of a cell map, in order, and to which each cycle belongs.

    A cycle belongs to an attractor if walkers come to it from most of the centres of its cells.
    """
    if not ends.attractors:
        return [], np.zeros(0, np.int32)
    lengths = np.array([len(cycle) for cycle in ends.attractors])
    x = centres(grid, np.concatenate(ends.attractors).astype(np.int32))
    known = settle(walker, sample(x), tolerance, [])
    found = follow(walker, x, known, tolerance, PATIENCE * LONGEST_PERIOD)
    own = np.repeat(np.arange(len(lengths)), lengths)
    fails = ~np.isin(found.fate, (Outcome.STRIDE, Outcome.UNDECIDED))
    falls = np.bincount(own, fails).astype(int)
    number = np.full(len(lengths), -1, np.int32)
    for i in range(len(found.attractors)):
        number[2 * np.bincount(own, found.attractor == i) > lengths] = i
    attractors = [
        one._replace(cycles=int((number == i).sum()), falling=int(falls[number == i].sum()))
        for i, one in enumerate(found.attractors)
    ]
    for i in np.flatnonzero(number < 0):
        number[i] = len(attractors)
        attractors.append(Attractor(int(lengths[i]), x[own == i], None, 1, int(falls[i]), True))
    order = in_order(attractors)
    return [attractors[i] for i in order], np.argsort(order)[number].astype(np.int32)


class Part(NamedTuple):
    """Cells of a grid that follow one on another: a block of it."""

    first: int
    shape: tuple[int, ...]

    @property
    def cells(self) -> slice:
        return slice(self.first, self.first + math.prod(self.shape))


def cell_map(
    walker: Walker,
    grid: Grid,
    tolerance: float,
    part: Part | None = None,
    *,
    progress: bool = False,
) -> Int[np.ndarray, " n"]:
    """The cell, or the sink, to which a stride takes the centre of each cell of a part."""
    order, cells = cells_of(grid, part)
    image = np.empty_like(order)
    image[order] = map_cells(
        image_of_cell, ((walker, grid, tolerance), cells), progress="strides" if progress else None
    )
    return image


def cells_of(grid: Grid, part: Part | None) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Cells of a part, or of all, in an order to compute them in: places in it, and indices."""
    first, shape = part or (0, grid.shape)
    order = order_of_cells(shape)
    return order, order + order.dtype.type(first)


def image_of_cell(shared: tuple[Walker, Grid, Real], index: Int[Array, ""]) -> Int[Array, ""]:
    """The cell, or the sink, to which a stride takes the centre of a cell."""
    walker, grid, tolerance = shared
    result = stride(walker, grid.centre(index), tolerance=tolerance)
    return cell_image(grid, result.state, result.outcome, leave=Outcome.LEFT_GRID)


def direct_iteration(
    walker: Walker, grid: Grid, tolerance: float, limit: int, progress: bool = False
) -> Basins:
    """Follow every centre for a number of strides, until it fails or comes near an attractor.

    The attractors are those of a sample of the cells, and then of cells that are left at the end.
    """
    attractors = attractors_of(walker, grid, tolerance)
    found = follow_part(walker, grid, tolerance, attractors, limit, progress=progress)
    found.attractor[found.left], attractors = explain(walker, found.ends, attractors, tolerance)
    return Basins(*found[:3], attractors)


def attractors_of(walker: Walker, grid: Grid, tolerance: float) -> list[Attractor]:
    """Those to which walkers come from a sample of the cells, numbered."""
    found = settle(walker, centres(grid, spread(grid.size).astype(np.int32)), tolerance, [])
    return [found[i] for i in in_order(found)]


def follow_part(
    walker: Walker,
    grid: Grid,
    tolerance: float,
    attractors: list[Attractor],
    limit: int,
    part: Part | None = None,
    *,
    progress: bool = False,
) -> Followed:
    """Follow the centres of the cells of a part, and give what became of them in their order."""
    order, cells = cells_of(grid, part)
    found = until_near(walker, centres(grid, cells), attractors, tolerance, limit, progress)
    place = np.empty_like(order)
    place[order] = np.arange(order.size, dtype=order.dtype)
    fate, attractor, count = (values[place] for values in found[:3])
    left = order[found.left]
    sort = np.argsort(left)
    return Followed(fate, attractor, count, left[sort], found.ends[sort])
