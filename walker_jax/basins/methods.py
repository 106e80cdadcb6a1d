"""Cell mapping and direct iteration of a grid, at once in memory or piece by piece into a store."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Int

from walker_jax import storage
from walker_jax.basins.attractor import Attractor, in_order, seen, sorted_numbers
from walker_jax.basins.attractor_search import (
    PATIENCE,
    complete,
    mapper_of_scouts,
    scouts_among,
    survey,
)
from walker_jax.basins.labels import LONGEST_PERIOD, Label
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.narrow_windows import follow_window
from walker_jax.basins.own_labels import OwnLabel, label_ends
from walker_jax.basins.schema import (
    ARRAYS,
    Basins,
    CellCycles,
    add_attractors,
    arrays_to_compute,
    constant_array,
    count_at_border,
    describe,
    request_of,
)
from walker_jax.cellmaps import CellMap, cell_image, resolve
from walker_jax.execution.pieces import Work
from walker_jax.execution.tiles import map_cells, order_of_cells
from walker_jax.execution.workers import Compute
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import OUTCOMES, Outcome
from walker_jax.systems.system import System
from walker_jax.walking.stride import stride

PIECE = 2**20
"""Cells of a piece of a store, up to twice as many, or all of a smaller grid."""


Read = Callable[[str, int], np.ndarray]
"""Returns the values of an array over a piece."""


class Block(NamedTuple):
    """A block of a grid, with consecutive cells."""

    first: int
    shape: tuple[int, ...]

    @property
    def cells(self) -> slice:
        return slice(self.first, self.first + math.prod(self.shape))


class Finished(NamedTuple):
    """The attractors of a basin in pieces, and the values known only at the end."""

    attractors: list[Attractor]
    cell_cycles: CellCycles | None
    pieces: Iterator[dict[str, np.ndarray]]


@dataclass(frozen=True)
class Method:
    """A way to compute the basins of a grid in pieces."""

    walker: System
    grid: Grid
    settings: dict
    integrator: Integrator


class CellMapping(Method):
    """Cell mapping: pieces of the map, then the labels of all cells at the end."""

    def arrays(self) -> dict[str, xr.Variable]:
        """Return the arrays that are stored until the end, besides those of the result."""
        return {"image": constant_array(self.grid, -1, np.int32)}

    def notes(self) -> dict:
        """Return the results that are computed and stored before all pieces."""
        return {}

    def piece(self, notes: dict, block: Block, *, progress: bool = False) -> dict[str, np.ndarray]:
        """Compute the values of arrays over a piece."""
        image = cell_map(self.walker, self.grid, self.integrator, block, progress=progress)
        return {"image": image}

    def finish(self, notes: dict, blocks: Sequence[Block], read: Read) -> Finished:
        """Return the attractors, and the remaining values of each piece."""
        image = np.empty(self.grid.size, np.int32)
        for i, block in enumerate(blocks):
            image[block.cells] = read("image", i).ravel()
        ends = resolve(image, sinks=OUTCOMES)
        attractors, number, counts = attractors_of_cycles(
            self.walker, self.grid, ends, self.integrator
        )
        number = np.append(number, np.int32(-1))

        def pieces() -> Iterator[dict[str, np.ndarray]]:
            for own in (ends.part(block.cells) for block in blocks):
                fate = np.maximum(own.sink, Outcome.STRIDE).astype(np.int8)
                yield {"fate": fate, "attractor": number[own.attractor], "strides": own.steps}

        return Finished(attractors, counts, pieces())


@dataclass(frozen=True)
class DirectIteration(Method):
    """Direct iteration: cycles of scouts before all pieces, then those of the remaining walkers."""

    label: OwnLabel | None = None
    """A user's own label of the end of each walk, in place of attractors."""

    def arrays(self) -> dict[str, xr.Variable]:
        """Return the arrays that are stored until the end, besides those of the result."""
        dtype = jnp.result_type(float)
        return {
            "ends": constant_array(self.grid, np.nan, dtype, None, "coordinate"),
            "reached": constant_array(self.grid, -1, np.int32),
        }

    def notes(self) -> dict:
        """Return the cycles that scouts find in the grid that is followed after some strides."""
        if self.label is not None:
            return {"cycles": []}
        scouts = self.window[0].centres(scouts_among(self.grid.size))
        found = mapper_of_scouts(self.walker, scouts, self.integrator, self.settings["strides"])
        return {"cycles": [one.states.tolist() for one in found.attractors]}

    @cached_property
    def window(self) -> tuple[Grid, int]:
        """The grid that is followed, and the strides made up to there."""
        return follow_window(self.walker, self.grid, self.integrator, self.settings["strides"])

    def mapper(self, notes: dict) -> Mapper:
        """Return the mapper to the stored cycles, for walkers that have come to the window."""
        dtype = jnp.result_type(float)
        known = [Attractor(np.array(states, dtype)) for states in notes["cycles"]]
        strides = self.settings["strides"] - self.window[1]
        return Mapper(self.walker, known, self.integrator, strides)

    def piece(self, notes: dict, block: Block, *, progress: bool = False) -> dict[str, np.ndarray]:
        """Compute the values of arrays over a piece; `ends` are states of walkers that remain.

        The numbers of the attractors that walkers have `reached` change at the end.
        """
        window, made = self.window
        labels = map_block(self.mapper(notes), window, block, progress=progress)
        labels.state[~labels.undecided] = np.nan
        found = {"fate": labels.fate, "strides": labels.strides + np.int32(made)}
        return found | {"reached": labels.attractor, "ends": labels.state}

    def finish(self, notes: dict, blocks: Sequence[Block], read: Read) -> Finished:
        """Return the attractors, and the remaining values of each piece."""
        (window, made), remaining, ends, cells = self.window, [], [], []
        for i, block in enumerate(blocks):
            x = read("ends", i).reshape(-1, self.grid.coordinates)
            remaining.append(np.flatnonzero(np.isfinite(x[:, 0])))
            ends.append(x[remaining[-1]])
            cells.append(block.first + remaining[-1])
        starts, x = window.centres(np.concatenate(cells)), np.concatenate(ends)
        if self.label is None:
            mapper, count = self.mapper(notes), len(x)
            unknown = np.full(count, -1, np.int32), np.full(count, mapper.strides, np.int32)
            rest = complete(mapper, starts, Label(np.zeros(count, np.int8), *unknown, x))
            attractors, number = in_order(seen(rest.mapper.attractors, rest.labels.attractor))
            late, strides = number[rest.labels.attractor], rest.labels.strides + made
        else:
            attractors, late = label_ends(self.label, self.walker, x, self.integrator)
            number, strides = np.full(1, -1, np.int32), np.full(len(x), self.settings["strides"])
        parts = np.cumsum([len(mine) for mine in remaining])[:-1]
        each = zip(remaining, np.split(late, parts), np.split(strides, parts), strict=True)

        def pieces() -> Iterator[dict[str, np.ndarray]]:
            for i, (mine, reached, count) in enumerate(each):
                attractor, strides = number[read("reached", i).ravel()], read("strides", i).ravel()
                attractor[mine], strides[mine] = reached, count
                yield {"attractor": attractor, "strides": strides}

        return Finished(attractors, None, pieces())


METHODS = {"cell-map": CellMapping, "direct": DirectIteration}


def label_in_memory(method: CellMapping | DirectIteration, progress: bool = False) -> Basins:
    """Compute the labels of all cells of a grid, in their order, as one piece."""
    grid, notes = method.grid, method.notes()
    whole = Block(0, grid.shape)
    values = method.piece(notes, whole, progress=progress)
    found = method.finish(notes, [whole], lambda name, _: values[name])
    values |= next(found.pieces)
    fate, attractor, strides = (values[name] for name in ARRAYS)
    return Basins(fate, attractor, strides, found.attractors, found.cell_cycles)


def work_of(method: CellMapping | DirectIteration, request: dict | None) -> Work:
    """Return how `basin` is computed piece by piece into a store.

    A piece is a block of the grid. Results for single cells are written at once. Results that need
    all cells follow when all pieces are there: the ends of the cell map, or the attractors of
    walkers that remain.
    """
    grid, aside = method.grid, method.arrays()
    about = describe(method.walker, grid, method.settings)

    def finish(place: storage.Pieces, _: Compute) -> xr.Dataset:
        blocks = [block_at(grid, place, i) for i in range(place.count)]
        attractors, cell_cycles, pieces = method.finish(place.notes, blocks, place.read)
        cells, at_border = np.zeros(len(attractors), int), 0
        for i, (block, values) in enumerate(zip(blocks, pieces, strict=True)):
            place.write(i, values)
            reached = values["attractor"]
            cells += np.bincount(reached[reached >= 0], minlength=len(cells))
            at_border += count_at_border(grid, reached, block.first)
        return add_attractors(about, grid, attractors, cells, at_border, cell_cycles)

    return Work(
        request or request_of(about, grid) | {"command": "basin"},
        about,
        arrays_to_compute(method.walker, grid) | aside,
        block_shape(grid.shape),
        finish,
        partial(block_at, grid),
        method.piece,
        method.notes,
        [*aside],
    )


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


def attractors_of_cycles(
    walker: System, grid: Grid, ends: CellMap, integrator: Integrator
) -> tuple[list[Attractor], Int[np.ndarray, " cycles"], CellCycles]:
    """Find the attractors and artefacts of a cell map, in order, and the owner of each cycle.

    A cycle belongs to an attractor if walkers converge to it from most of its cells' centres.
    """
    lengths = np.array([len(cycle) for cycle in ends.attractors], int)
    cycle, number = np.repeat(np.arange(len(lengths)), lengths), np.full(len(lengths), -1, np.int32)
    x = grid.centres(np.concatenate([np.zeros(0, int), *ends.attractors]))
    labels, mapper, _ = survey(walker, x, integrator, PATIENCE * LONGEST_PERIOD)
    falls = np.bincount(cycle, labels.fallen, len(lengths)).astype(int)
    for i in range(len(mapper.attractors)):
        number[2 * np.bincount(cycle, labels.attractor == i, len(lengths)) > lengths] = i
    real = [i for i in range(len(mapper.attractors)) if (number == i).any()]
    made_up = {i: Attractor(x[cycle == i]) for i in np.flatnonzero(number < 0).tolist()}
    alone = [[*made_up][i] for i in sorted_numbers([*made_up.values()])]
    owned = [*(np.flatnonzero(number == i) for i in real), *([i] for i in alone)]
    for place, cycles in enumerate(owned):
        number[cycles] = place
    counts = CellCycles(
        cycles=np.array([len(cycles) for cycles in owned], np.int32),
        falling=np.array([falls[cycles].sum() for cycles in owned], np.int32),
        artefact=np.arange(len(owned)) >= len(real),
    )
    attractors = [*(mapper.attractors[i] for i in real), *(made_up[i] for i in alone)]
    return attractors, number, counts


def map_block(
    mapper: Mapper, grid: Grid, block: Block | None = None, *, progress: bool = False
) -> Label:
    """Follow the centres of the cells of a block; labels are in the order of the cells."""
    order, cells = order_in_block(grid, block)
    labels = mapper.follow(grid.centres(cells), progress="cells" if progress else None)
    place = np.empty_like(order)
    place[order] = np.arange(order.size, dtype=order.dtype)
    return Label(*(values[place] for values in labels))
