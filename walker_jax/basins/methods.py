"""Cell mapping and direct iteration, for a grid or a part of it."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Int

from walker_jax.basins.attractor import Attractor, sorted_numbers
from walker_jax.basins.attractor_search import (
    LONGEST_PERIOD,
    PATIENCE,
    sample,
    sample_indices,
)
from walker_jax.basins.mapper import Labels, Mapper
from walker_jax.basins.schema import Basins
from walker_jax.cellmaps import CellMap, cell_image, resolve
from walker_jax.execution.tiles import map_cells, order_of_cells
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.stride import stride


class Block(NamedTuple):
    """A block of a grid, with consecutive cells."""

    first: int
    shape: tuple[int, ...]

    @property
    def cells(self) -> slice:
        return slice(self.first, self.first + math.prod(self.shape))


def order_in_block(
    grid: Grid, block: Block | None
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the order in which to compute the cells of a block: places in it, and indices."""
    first, shape = block or (0, grid.shape)
    order = order_of_cells(shape)
    return order, order + order.dtype.type(first)


def cell_mapping(
    walker: System, grid: Grid, integrator: Integrator, progress: bool = False
) -> Basins:
    """Run the simple cell mapping: one stride from each cell's centre, then cells follow cells."""
    ends = resolve(cell_map(walker, grid, integrator, progress=progress), sinks=len(Outcome))
    attractors, number = attractors_of_cycles(walker, grid, ends, integrator)
    return Basins(*labels_of_cells(ends, number), attractors)


def cell_map(
    walker: System,
    grid: Grid,
    integrator: Integrator,
    block: Block | None = None,
    *,
    progress: bool = False,
) -> Int[np.ndarray, " n"]:
    """Return the cell, or the sink, to which a stride takes the centre of each cell of a block."""
    order, cells = order_in_block(grid, block)
    image = np.empty_like(order)
    image[order] = map_cells(
        image_of_cell, ((walker, grid, integrator), cells), progress="strides" if progress else None
    )
    return image


def image_of_cell(shared: tuple[System, Grid, Integrator], index: Int[Array, ""]) -> Int[Array, ""]:
    """Return the cell, or the sink, to which a stride takes the centre of a cell."""
    walker, grid, integrator = shared
    by = {"tolerance": integrator.tolerance, "solver": integrator.solver}
    result = stride(walker, grid.centre(index), **by)
    return cell_image(grid, result.state, result.outcome, leave=Outcome.LEFT_GRID)


def labels_of_cells(
    ends: CellMap, number: Int[np.ndarray, " cycles"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the fate, attractor and strides of cells, from their ends and cycles' attractors."""
    fate = np.maximum(ends.sink, Outcome.STRIDE).astype(np.int8)
    return fate, np.append(number, np.int32(-1))[ends.attractor], ends.steps


def attractors_of_cycles(
    walker: System, grid: Grid, ends: CellMap, integrator: Integrator
) -> tuple[list[Attractor], Int[np.ndarray, " cycles"]]:
    """Find the attractors and artefacts of a cell map, in order, and the owner of each cycle.

    A cycle belongs to an attractor if walkers converge to it from most of its cells' centres.
    """
    if not ends.attractors:
        return [], np.zeros(0, np.int32)
    lengths = np.array([len(cycle) for cycle in ends.attractors])
    x = grid.centres(np.concatenate(ends.attractors))
    mapper = Mapper(walker, [], integrator, PATIENCE * LONGEST_PERIOD)
    labels, mapper = mapper.with_attractors_from(sample(x)).label_all(x)
    cycle = np.repeat(np.arange(len(lengths)), lengths)
    falls = np.bincount(cycle, labels.fallen).astype(int)
    number = np.full(len(lengths), -1, np.int32)
    for i in range(len(mapper.attractors)):
        number[2 * np.bincount(cycle, labels.attractor == i) > lengths] = i
    attractors = [
        one._replace(cycles=int((number == i).sum()), falling=int(falls[number == i].sum()))
        for i, one in enumerate(mapper.attractors)
    ]
    for i in np.flatnonzero(number < 0):
        number[i] = len(attractors)
        attractors.append(Attractor(int(lengths[i]), x[cycle == i], None, 1, int(falls[i]), True))
    order = [i for i in sorted_numbers(attractors) if attractors[i].cycles]
    place = np.zeros(len(attractors), np.int32)
    place[order] = np.arange(len(order))
    return [attractors[i] for i in order], place[number]


def direct_iteration(mapper: Mapper, grid: Grid, progress: bool = False) -> Basins:
    """Follow every centre until it fails, or converges to an attractor.

    The attractors are those of the mapper, then those found from cells that remain at the end.
    """
    labels, mapper = mapper.complete_labels(map_block(mapper, grid, progress=progress))
    return Basins(*labels[:3], mapper.without_unseen_motion(labels.attractor).attractors)


def mapper_of_grid(walker: System, grid: Grid, integrator: Integrator, strides: int) -> Mapper:
    """Return the mapper to the attractors that a sample of a grid's cells converges to."""
    starts = grid.centres(sample_indices(grid.size))
    return Mapper(walker, [], integrator, strides).with_attractors_from(starts)


def map_block(
    mapper: Mapper, grid: Grid, block: Block | None = None, *, progress: bool = False
) -> Labels:
    """Return the labels of the centres of the cells of a block, in the order of the cells."""
    order, cells = order_in_block(grid, block)
    labels = mapper(grid.centres(cells), progress="cells" if progress else None)
    place = np.empty_like(order)
    place[order] = np.arange(order.size, dtype=order.dtype)
    return Labels(*(values[place] for values in labels))
