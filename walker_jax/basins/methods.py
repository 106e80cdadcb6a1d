"""Cell mapping and direct iteration of a grid, at once in memory or piece by piece into a store."""

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Int

from walker_jax import storage
from walker_jax.basins.attractor import (
    LONGEST_PERIOD,
    PATIENCE,
    Attractor,
    sample,
    sample_indices,
    sorted_numbers,
)
from walker_jax.basins.mapper import Labels, Mapper
from walker_jax.basins.narrow_windows import follow_window
from walker_jax.basins.schema import (
    ARRAYS,
    Basins,
    add_attractors,
    arrays_to_compute,
    constant_array,
    count_at_border,
    describe,
    request_of,
)
from walker_jax.cellmaps import CellMap, cell_image, resolve
from walker_jax.execution.tiles import map_cells, order_of_cells
from walker_jax.execution.workers import missing_pieces, open_workers
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import OUTCOMES, Outcome
from walker_jax.systems.system import System
from walker_jax.walking.stride import stride

PIECE = 2**20
"""Cells of a piece of a store, up to twice as many, or all of a smaller grid."""


class Block(NamedTuple):
    """A block of a grid, with consecutive cells."""

    first: int
    shape: tuple[int, ...]

    @property
    def cells(self) -> slice:
        return slice(self.first, self.first + math.prod(self.shape))


class CellMapping(NamedTuple):
    """Cell mapping: pieces of the map, then the labels of all cells at the end."""

    walker: System
    grid: Grid
    settings: dict
    integrator: Integrator

    def at_once(self, progress: bool = False) -> Basins:
        """Compute all cells in memory."""
        image = cell_map(self.walker, self.grid, self.integrator, progress=progress)
        ends = resolve(image, sinks=OUTCOMES)
        attractors, number = attractors_of_cycles(self.walker, self.grid, ends, self.integrator)
        return Basins(*labels_of_cells(ends, number), attractors)

    def arrays(self) -> dict[str, xr.Variable]:
        """Return the arrays that are stored until the end, besides those of the result."""
        return {"image": constant_array(self.grid, -1, np.int32)}

    def notes(self) -> dict:
        """Return the results that are computed and stored before all pieces."""
        return {}

    def piece(self, notes: dict, block: Block) -> dict[str, np.ndarray]:
        """Compute the values of arrays over a piece."""
        return {"image": cell_map(self.walker, self.grid, self.integrator, block)}

    def finish(
        self, place: storage.Pieces
    ) -> tuple[list[Attractor], Iterator[dict[str, np.ndarray]]]:
        """Return the attractors, and the remaining values of each piece."""
        ends = resolve(self.image(place), sinks=OUTCOMES)
        attractors, number = attractors_of_cycles(self.walker, self.grid, ends, self.integrator)

        def piece(cells: slice) -> dict[str, np.ndarray]:
            return dict(zip(ARRAYS, labels_of_cells(ends.part(cells), number), strict=True))

        pieces = (piece(block_at(self.grid, place, i).cells) for i in range(place.count))
        return attractors, pieces

    def image(self, place: storage.Pieces) -> Int[np.ndarray, " n"]:
        """Return the cell, or the sink, to which each cell is sent."""
        image = np.empty(self.grid.size, np.int32)
        for i in range(place.count):
            image[block_at(self.grid, place, i).cells] = place.read("image", i).ravel()
        return image


class DirectIteration(NamedTuple):
    """Direct iteration: attractors before all pieces, then those of the remaining walkers."""

    walker: System
    grid: Grid
    settings: dict
    integrator: Integrator

    def at_once(self, progress: bool = False) -> Basins:
        """Compute all cells in memory."""
        window = self.window()
        notes = self.notes_in(*window)
        labels = self.labels(notes, *window, progress=progress)
        labels, mapper = self.mapper(notes).complete_labels(labels)
        attractors = mapper.without_unseen_motion(labels.attractor).attractors
        return Basins(labels.fate, labels.attractor, labels.strides, attractors)

    def arrays(self) -> dict[str, xr.Variable]:
        """Return the arrays that are stored until the end, besides those of the result."""
        dtype = jnp.asarray(0.0).dtype
        return {"ends": constant_array(self.grid, np.nan, dtype, None, "coordinate")}

    def notes(self) -> dict:
        """Return the results that are computed and stored before all pieces."""
        return self.notes_in(*self.window())

    def notes_in(self, window: Grid, made: int) -> dict:
        """Return the attractors of the grid that is followed after some strides."""
        strides = self.settings["strides"] - made
        mapper = mapper_of_grid(self.walker, window, self.integrator, strides)
        found = mapper.with_sorted_attractors().attractors
        as_list = lambda values: None if values is None else values.tolist()
        return {
            "attractors": [[one.period, one.states.tolist(), as_list(one.cloud)] for one in found]
        }

    def window(self) -> tuple[Grid, int]:
        """Return the grid that is followed, and the strides made up to there."""
        return follow_window(self.walker, self.grid, self.integrator, self.settings["strides"])

    def mapper(self, notes: dict, made: int = 0) -> Mapper:
        """Return the mapper to the stored attractors, for walkers that have made some strides."""
        dtype = jnp.asarray(0.0).dtype
        known = [
            Attractor(period, np.array(states, dtype), cloud=cloud and np.array(cloud, dtype))
            for period, states, cloud in notes["attractors"]
        ]
        strides = self.settings["strides"] - made
        return Mapper(self.walker, known, self.integrator, strides)

    def labels(
        self,
        notes: dict,
        window: Grid,
        made: int,
        block: Block | None = None,
        *,
        progress: bool = False,
    ) -> Labels:
        """Follow the centres of the cells of a block, or of all cells, from `window` on."""
        labels = map_block(self.mapper(notes, made), window, block, progress=progress)
        return labels._replace(strides=labels.strides + np.int32(made))

    def piece(self, notes: dict, block: Block) -> dict[str, np.ndarray]:
        """Compute the values of arrays over a piece; `ends` are states of walkers that remain."""
        labels = self.labels(notes, *self.window(), block)
        ends, remaining = np.full_like(labels.states, np.nan), labels.remaining
        ends[remaining] = labels.states[remaining]
        return dict(zip(ARRAYS, labels, strict=False)) | {"ends": ends}

    def finish(
        self, place: storage.Pieces
    ) -> tuple[list[Attractor], Iterator[dict[str, np.ndarray]]]:
        """Return the attractors, and the remaining values of each piece."""
        remaining, ends = [], []
        for i in range(place.count):
            x = place.read("ends", i).reshape(-1, self.grid.coordinates)
            remaining.append(np.flatnonzero(np.isfinite(x[:, 0])))
            ends.append(x[remaining[-1]])
        number, mapper = self.mapper(place.notes).label_remaining(np.concatenate(ends))
        numbers = np.split(number, np.cumsum([len(cells) for cells in remaining])[:-1])

        def pieces():
            for i, (cells, mine) in enumerate(zip(remaining, numbers, strict=True)):
                attractor = place.read("attractor", i).ravel()
                attractor[cells] = mine
                yield {"attractor": attractor}

        return mapper.without_unseen_motion(number).attractors, pieces()


METHODS = {"cell-map": CellMapping, "direct": DirectIteration}


def compute_in_pieces(
    method: CellMapping | DirectIteration,
    out: Path,
    *,
    request: dict | None,
    overwrite: bool,
    cluster: Any,
    progress: bool,
) -> xr.Dataset:
    """Compute `basin` piece by piece into a store.

    A piece is a block of the grid. Results for single cells are written at once. Results that need
    all cells follow when all pieces are there: the ends of the cell map, or the attractors of
    walkers that remain. Either may be repeated, with the same result.
    """
    grid, work = method.grid, method.arrays()
    about = describe(method.walker, grid, method.settings)
    request = request or request_of(about, grid) | {"command": "basin"}
    found = storage.find(out, request, overwrite=overwrite)
    if found is not None:
        return found
    arrays, block = arrays_to_compute(method.walker, grid) | work, block_shape(grid.shape)
    with (
        open_workers(cluster) as each,  # first, as it may fail
        storage.open_pieces(
            out,
            request,
            about,
            arrays,
            block,
            method.notes,
            aside=list(work),
            overwrite=overwrite,
        ) as place,
    ):
        compute, block_of = partial(method.piece, place.notes), partial(block_at, grid, place)
        for i, values in missing_pieces(place, each, compute, block_of, "pieces", progress):
            place.write(i, values, done=True)
        attractors, pieces = method.finish(place)
        cells, at_border = np.zeros(len(attractors), int), 0
        for i, values in enumerate(pieces):
            place.write(i, values)
            reached = values["attractor"]
            cells += np.bincount(reached[reached >= 0], minlength=len(cells))
            at_border += count_at_border(grid, reached, block_at(grid, place, i).first)
        place.finish(add_attractors(about, grid, attractors, cells, at_border))
    return storage.open_dataset(out)


def block_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of a piece along the first axes of a grid; its cells are neighbours.

    One axis is cut into parts of equal length, each of `PIECE` cells or more.
    """
    axis = next(i for i in range(len(shape)) if math.prod(shape[i + 1 :]) <= PIECE)
    parts = max(1, math.prod(shape[axis:]) // PIECE)
    return (*[1] * axis, -(-shape[axis] // parts))


def block_at(grid: Grid, place: storage.Pieces, piece: int) -> Block:
    """Return the cells of a piece."""
    at = place.at(piece)
    start = [one.start for one in at] + [0] * (len(grid.shape) - len(at))
    shape = *(one.stop - one.start for one in at), *grid.shape[len(at) :]
    return Block(int(np.ravel_multi_index(start, grid.shape)), shape)


def order_in_block(
    grid: Grid, block: Block | None
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the order in which to compute the cells of a block: places in it, and indices."""
    first, shape = block or (0, grid.shape)
    order = order_of_cells(shape)
    return order, order + order.dtype.type(first)


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
