"""A basin computed and stored piece by piece."""

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Int

from walker_jax import storage
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import explain
from walker_jax.basins.methods import (
    Part,
    attractors_of,
    attractors_of_map,
    cell_map,
    fates,
    follow_part,
)
from walker_jax.basins.schema import (
    ABOUT,
    described,
    not_yet,
    over_grid,
    request_of,
    with_attractors,
)
from walker_jax.cellmaps import resolve
from walker_jax.execution.progress import track
from walker_jax.execution.workers import open_workers
from walker_jax.grids import Grid
from walker_jax.walkers.model import Walker
from walker_jax.walking.outcomes import Outcome

PIECE = 2**20
"""Cells of a piece of a store, up to twice as many, or all of a smaller grid."""


def in_pieces(
    walker: Walker,
    grid: Grid,
    how: dict,
    out: Path,
    request: dict | None,
    overwrite: bool,
    cluster: Any,
    progress: bool,
) -> xr.Dataset:
    """`basin`, computed piece by piece into a store.

    A piece is a block of the grid. What is found of single cells is written at once; what takes
    all of them, where the cell map leads and what walkers come to that are left at the end, follows
    when all pieces are there. Either may be done again, with the same result.
    """
    method = (MappedPieces if how["method"] == "cell-map" else FollowedPieces)(walker, grid, how)
    about, work = described(walker, grid, how), method.arrays()
    request = request or request_of(about, grid) | {"command": "basin"}
    found = storage.find(out, request, overwrite=overwrite)
    if found is not None:
        return found
    options: Any = {"aside": list(work), "overwrite": overwrite}
    arrays, block = not_yet(grid) | work, block_of(grid.shape)
    with (
        open_workers(cluster) as each,  # first, as there may be none
        storage.open_pieces(out, request, about, arrays, block, method.notes, **options) as place,
    ):
        compute = partial(method.piece, place.notes)
        number = {part_of(grid, place, i): i for i in place.missing()}
        found, done = each(compute, [*number]), place.count - len(number)
        for part, values in track(found, "pieces", progress, place.count, done):
            place.write(number[part], values, done=True)
        attractors, pieces = method.finish(place)
        cells = np.zeros(len(attractors), int)
        for i, values in enumerate(pieces):
            place.write(i, values)
            reached = values["attractor"]
            cells += np.bincount(reached[reached >= 0], minlength=len(cells))
        place.finish(with_attractors(about, grid, attractors, cells))
    return storage.open_dataset(out)


class MappedPieces(NamedTuple):
    """Cell mapping: pieces of the map, and the fates of all cells at the end."""

    walker: Walker
    grid: Grid
    how: dict

    def arrays(self) -> dict[str, xr.Variable]:
        return {"image": over_grid(self.grid, -1, np.int32, {})}

    def notes(self) -> dict:
        return {}

    def piece(self, notes: dict, part: Part) -> dict[str, np.ndarray]:
        return {"image": cell_map(self.walker, self.grid, self.how["tolerance"], part)}

    def finish(
        self, place: storage.Pieces
    ) -> tuple[list[Attractor], Iterator[dict[str, np.ndarray]]]:
        """The attractors, and what is still to be written of each piece."""
        ends = resolve(self.image(place), sinks=len(Outcome))
        tolerance = self.how["tolerance"]
        attractors, number = attractors_of_map(self.walker, self.grid, ends, tolerance)

        def piece(cells: slice) -> dict[str, np.ndarray]:
            return dict(zip(ABOUT, fates(ends.part(cells), number), strict=True))

        pieces = (piece(part_of(self.grid, place, i).cells) for i in range(place.count))
        return attractors, pieces

    def image(self, place: storage.Pieces) -> Int[np.ndarray, " n"]:
        """The cell, or the sink, to which each cell is sent."""
        image = np.empty(self.grid.size, np.int32)
        for i in range(place.count):
            image[part_of(self.grid, place, i).cells] = place.read("image", i).ravel()
        return image


class FollowedPieces(NamedTuple):
    """Direct iteration: attractors before all pieces, and at the end those of walkers left."""

    walker: Walker
    grid: Grid
    how: dict

    def arrays(self) -> dict[str, xr.Variable]:
        dtype = jnp.asarray(0.0).dtype
        return {"ends": over_grid(self.grid, np.nan, dtype, {}, "coordinate")}

    def notes(self) -> dict:
        found = attractors_of(self.walker, self.grid, self.how["tolerance"])
        return {"attractors": [[one.period, one.states.tolist()] for one in found]}

    def known(self, notes: dict) -> list[Attractor]:
        dtype = jnp.asarray(0.0).dtype
        return [
            Attractor(period, np.array(states, dtype)) for period, states in notes["attractors"]
        ]

    def piece(self, notes: dict, part: Part) -> dict[str, np.ndarray]:
        tolerance, limit = self.how["tolerance"], self.how["strides"]
        found = follow_part(self.walker, self.grid, tolerance, self.known(notes), limit, part)
        ends = np.full((len(found.fate), self.grid.coordinates), np.nan, found.ends.dtype)
        ends[found.left] = found.ends
        return dict(zip(ABOUT, found, strict=False)) | {"ends": ends}

    def finish(
        self, place: storage.Pieces
    ) -> tuple[list[Attractor], Iterator[dict[str, np.ndarray]]]:
        """The attractors, and what is still to be written of each piece."""
        left, ends = [], []
        for i in range(place.count):
            x = place.read("ends", i).reshape(-1, self.grid.coordinates)
            left.append(np.flatnonzero(np.isfinite(x[:, 0])))  # the others have no end
            ends.append(x[left[-1]])
        known, x = self.known(place.notes), np.concatenate(ends)
        number, attractors = explain(self.walker, x, known, self.how["tolerance"])
        numbers = np.split(number, np.cumsum([len(cells) for cells in left])[:-1])

        def pieces():
            for i, (cells, mine) in enumerate(zip(left, numbers, strict=True)):
                attractor = place.read("attractor", i).ravel()
                attractor[cells] = mine
                yield {"attractor": attractor}

        return attractors, pieces()


def block_of(shape: tuple[int, ...]) -> tuple[int, ...]:
    """How much of each of its first axes is in a piece of a grid, so that its cells are neighbours.

    One axis is cut into as many parts of the same length as have `PIECE` cells or more.
    """
    axis = next(i for i in range(len(shape)) if math.prod(shape[i + 1 :]) <= PIECE)
    parts = max(1, math.prod(shape[axis:]) // PIECE)
    return (*[1] * axis, -(-shape[axis] // parts))


def part_of(grid: Grid, place: storage.Pieces, piece: int) -> Part:
    """The cells of a piece."""
    at = place.at(piece)
    start = [one.start for one in at] + [0] * (len(grid.shape) - len(at))
    shape = *(one.stop - one.start for one in at), *grid.shape[len(at) :]
    return Part(int(np.ravel_multi_index(start, grid.shape)), shape)
