"""The basin of attraction: the fate of every start in a region of the Poincaré section.

Two methods. Cell mapping (Hsu 1987; Schwab and Wisse 2001, section 4.3) makes one stride from the
centre of every cell, sends each cell to the cell where that ends, and follows the cells. Direct
iteration follows every centre itself, stride by stride. Direct iteration is exact up to its number
of strides; cell mapping costs one stride a cell, and its errors are of the size of a cell. Among
these are cycles of cells where there is no attractor, and several for one attractor. So walkers are
followed from the centres of their cells, to see where each cycle leads.
"""

import math
import os
from collections.abc import Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax import store
from walker_jax.attraction import (
    LONGEST_PERIOD,
    PATIENCE,
    Attractor,
    Basins,
    Followed,
    centres,
    explain,
    follow,
    in_order,
    sample,
    settle,
    spread,
    until_near,
)
from walker_jax.cells import CellMap, Grid, cell_image, resolve
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_precision,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.cluster import computers
from walker_jax.integrate import AnySolver, Real, default_tolerance, solved_by
from walker_jax.progress import tracked
from walker_jax.stride import Outcome, stride
from walker_jax.tiles import map_cells, order_of_cells
from walker_jax.walkers import Walker

METHODS = ("cell-map", "direct")
BYTES_PER_CELL = {"cell-map": 25, "direct": 100}
"""Memory at its peak, for each cell of a grid."""
BYTES_STORED = {"cell-map": 16, "direct": 0}
"""The same where the result goes into a store: of the cell map, when all of it is there."""
PIECE = 2**20
"""Cells of a piece of a store, up to twice as many, or all of a smaller grid."""
NOT_YET = -1
"""The fate of a cell whose piece has not been computed."""


@refuses_tracers("area_gradient gives derivatives of a basin's area")
def basin(
    walker: Walker,
    grid: Grid,
    method: str = "cell-map",
    *,
    strides: int = 200,
    tolerance: float | None = None,
    solver: AnySolver | None = None,
    progress: bool = False,
    out: Path | str | None = None,
    request: dict | None = None,
    overwrite: bool = False,
    cluster: Any = None,
) -> xr.Dataset:
    """Fate of every cell of a grid on the walker's section.

    **Arguments:**

    - `walker`: its parameters are used in float64 if JAX has that turned on.
    - `grid`: its state coordinates are those of the section. It may be a slice.
    - `method`: "cell-map" or "direct"; for a slice, "direct" only.
    - `strides`: how many of them direct iteration follows a walker for.
    - `tolerance`, `solver`: of the integration, as in `stride`. A cluster takes no other solver.
    - `progress`: whether to show a progress bar on a terminal.
    - `out`: a place on disk, a Zarr store, into which the result is written piece by piece, while
      memory holds a piece alone; but the cell map takes 12 bytes for each cell at the end.
      A run that was interrupted is gone on with there, and gives the same to the last bit. Until it
      has ended, cells of missing pieces have a fate of -1. What is returned is read from there when
      it is used.
    - `request`: by what the result is known again there; by default, all that it depends on.
    - `overwrite`: whether to remove another result that stands there.
    - `cluster`: who computes the pieces, as in `walker_jax.cluster.computers`: a number of worker
      processes on this machine, the address of a Dask scheduler, or a Dask client.

    **Returns** a data set over the grid's axes:

    - `fate`: `Outcome` of the stride at which the walker fails; `STRIDE` where it walks for ever
      (cell mapping) or to the last stride (direct);
    - `attractor`: number of the attractor it comes to, -1 for none;
    - `strides`: strides completed before that, or before the failure;

    and over the attractors, numbered by period, then by the angle of their first state (the one
    of the smallest angle), those last that are found only of walkers left at the end: `period` (0
    where the motion does not repeat itself), `states` (NaN after the period), and of the basin
    within the grid `cells` and `area` (rad^2 per unit of time; over three dimensions it is a
    volume). Its attributes say what was computed.

    The attractors of a cell map are those to which walkers come that start at the centres of the
    cells in its cycles. A cycle from most of whose centres they come to one attractor belongs to
    that, with all cells that lead to it. Any other is an `artefact` of the cells: its period and
    states are those of cells and their centres, its cells walk for ever by the map alone, and it
    is numbered after all attractors. Beside `artefact` there are `cycles`, how many cycles of
    cells belong to each, and `falling`, from how many centres of their cells a walker falls.

    Raises `ValueError` for an unknown method, for a grid that does not fit the section or that this
    machine has not the memory for, and for a place where something else stands, that cannot be
    written to, or that another run is writing to.
    """
    if not isinstance(method, str) or method not in METHODS:
        raise WrongUse(f"method must be one of {', '.join(METHODS)}, not {short(method)}")
    strides = check_whole("strides", strides)
    check_grid(walker, grid, method, (BYTES_PER_CELL if out is None else BYTES_STORED)[method])
    dtype = jnp.asarray(0.0).dtype
    check_precision(dtype)
    tolerance = float(default_tolerance(dtype, tolerance))
    limit = {"strides": strides} if method == "direct" else {}
    how = {"method": method, **limit, "tolerance": tolerance}
    if solver is not None:
        how["solver"] = repr(solver)
        if cluster is not None:
            raise WrongUse(f"solver must not be given with a cluster, unlike {solver!r}")
    with solved_by(solver):
        if out is not None:
            return in_pieces(walker, grid, how, Path(out), request, overwrite, cluster, progress)
        if cluster is not None:
            raise WrongUse(f"cluster={cluster!r} computes pieces of a store: out is wanted too")
        if method == "cell-map":
            found = cell_mapping(walker, grid, tolerance, progress)
        else:
            found = direct_iteration(walker, grid, tolerance, strides, progress)
    return labelled(walker, grid, found, how)


class TooLarge(WrongUse, MemoryError):
    """More is asked than this machine has the memory for."""


def check_grid(
    walker: Walker, grid: Grid, method: str, each: int = BYTES_PER_CELL["direct"]
) -> None:
    """Refuse a grid that is not of the walker's section, or too large for this machine's memory."""
    check_kind("walker", walker, Walker)
    check_kind("grid", grid, Grid)
    if grid.coordinates != len(walker.section):
        raise WrongUse(
            f"grid must have the {len(walker.section)} dimensions of the section, "
            f"{', '.join(walker.section)}, not {', '.join((*grid.names, *grid.fixed))}"
        )
    if method == "cell-map" and len(grid.names) < grid.coordinates:
        raise WrongUse(
            f"method must be direct for a slice, {' and '.join(grid.fixed)} fixed, which walkers "
            "leave, not 'cell-map'"
        )
    for place, name in enumerate((*grid.names, *grid.fixed)):
        wrong = name in walker.section and walker.section.index(name) != place
        if wrong or (name in grid.fixed and name not in walker.section):
            raise WrongUse(
                f"grid must name coordinates in the order of the section, {walker.section}, "
                f"not {(*grid.names, *grid.fixed)}"
            )
    needed, memory = grid.size * each, memory_of_machine()
    if needed > memory:
        raise TooLarge(
            f"grid of {grid.size} cells needs {needed / 2**30:.1f} GiB of memory, "
            f"and this machine has {memory / 2**30:.1f} GiB"
        )


def memory_of_machine() -> float:
    """Bytes of memory; without bound where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError):  # not a POSIX system
        return float("inf")


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


@refuses_tracers()
def compare_methods(
    walker: Walker, grid: Grid, *, strides: int = 200, tolerance: float | None = None
) -> xr.Dataset:
    """Cell mapping against direct iteration on one grid: where they differ, and what is made up.

    Arguments and errors are those of `basin`.

    **Returns** a data set over the grid's axes with `mapped` and `direct`, whether a cell walks for
    ever by either method; and over the attractors of cell mapping `cells`, `period`, `cycles`,
    `artefact` and `falling`, as `basin` gives them. `direct_attractors` is how many direct
    iteration finds.
    """
    mapped = basin(walker, grid, strides=strides, tolerance=tolerance)
    direct = basin(walker, grid, "direct", strides=strides, tolerance=tolerance)
    walks = {"mapped": mapped["attractor"] >= 0, "direct": direct["attractor"] >= 0}
    found = mapped[["cells", "period", "cycles", "artefact", "falling"]].assign(walks)
    found["direct_attractors"] = direct.sizes["number"]
    return found.assign_attrs(mapped.attrs | {"method": "cell-map against direct"})


def artefacts(data: xr.Dataset) -> Bool[np.ndarray, " number"]:
    """Which attractors of a data set are artefacts of cells; none where it does not tell."""
    return data["artefact"].values if "artefact" in data else np.zeros(data.sizes["number"], bool)


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


def labelled(walker: Walker, grid: Grid, found: Basins, how: dict) -> xr.Dataset:
    """The data set that `basin` returns; `how` it was made is among its attributes."""
    cells = np.bincount(found.attractor[found.attractor >= 0], minlength=len(found.attractors))
    over_grid = {
        name: (grid.names, np.asarray(values).reshape(grid.shape), ABOUT[name])
        for name, values in zip(ABOUT, found, strict=False)
    }
    data = described(walker, grid, how).assign(over_grid)
    return with_attractors(data, grid, found.attractors, cells)


ABOUT: dict[str, dict[str, Any]] = {
    "fate": {
        "flag_values": list(range(len(Outcome))),
        "flag_meanings": " ".join(Outcome.__members__),
    },
    "attractor": {"description": "-1 for none"},
    "strides": {"description": "before the attractor or the failure"},
}
"""Attributes of what there is over a grid."""


def described(walker: Walker, grid: Grid, how: dict) -> xr.Dataset:
    """The axes of a grid, and what is computed over it."""
    about = {
        "walker": type(walker).__name__,
        **{f"walker_{name}": float(value) for name, value in vars(walker).items()},
        **how,
        "section": list(walker.section),
        "version": f"walker-jax {version('walker-jax')}",
    }
    return xr.Dataset(coords=grid.axes | grid.held, attrs=about)


def with_attractors(
    data: xr.Dataset, grid: Grid, attractors: list[Attractor], cells: Int[np.ndarray, " number"]
) -> xr.Dataset:
    """With the attractors, and how many cells come to each."""
    longest = max((len(one.states) for one in attractors), default=0)
    states = np.full((len(attractors), longest, grid.coordinates), np.nan)
    for one, row in zip(attractors, states, strict=True):
        row[: len(one.states)] = one.states
    area = cells * grid.cell_area
    found = {
        "period": ("number", np.array([one.period or 0 for one in attractors], np.int32)),
        "states": (("number", "phase", "coordinate"), states),
        "cells": ("number", cells),
        "area": ("number", area),
    }
    if data.attrs["method"] == "cell-map":
        found |= {
            "artefact": ("number", np.array([one.artefact for one in attractors], bool)),
            "cycles": ("number", np.array([one.cycles for one in attractors], np.int32)),
            "falling": ("number", np.array([one.falling for one in attractors], np.int32)),
        }
    data = data.assign(found).assign_coords(number=np.arange(len(attractors)))
    return data.assign_attrs(area=area.tolist())


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
    found = store.find(out, request, overwrite=overwrite)
    if found is not None:
        return found
    options: Any = {"aside": list(work), "overwrite": overwrite}
    arrays, block = not_yet(grid) | work, block_of(grid.shape)
    with (
        computers(cluster) as each,  # first, as there may be none
        store.pieces(out, request, about, arrays, block, method.notes, **options) as place,
    ):
        compute = partial(method.piece, place.notes)
        number = {part_of(grid, place, i): i for i in place.missing()}
        found, done = each(compute, [*number]), place.count - len(number)
        for part, values in tracked(found, "pieces", progress, place.count, done):
            place.write(number[part], values, done=True)
        attractors, pieces = method.finish(place)
        cells = np.zeros(len(attractors), int)
        for i, values in enumerate(pieces):
            place.write(i, values)
            reached = values["attractor"]
            cells += np.bincount(reached[reached >= 0], minlength=len(cells))
        place.finish(with_attractors(about, grid, attractors, cells))
    return store.opened(out)


def request_of(about: xr.Dataset, grid: Grid) -> dict:
    """All that a basin depends on, by which it is known again."""
    return {
        **{str(name): value for name, value in about.attrs.items()},
        "axes": grid.box,
        "shear": grid.shear.tolist(),
        "origin": grid.origin.tolist(),
        "dtype": str(jnp.asarray(0.0).dtype),
    }


def not_yet(grid: Grid) -> dict[str, xr.Variable]:
    """What there is over a grid before anything is computed."""
    return {
        "fate": over_grid(grid, NOT_YET, np.int8, ABOUT["fate"]),
        "attractor": over_grid(grid, -1, np.int32, ABOUT["attractor"]),
        "strides": over_grid(grid, 0, np.int32, ABOUT["strides"]),
    }


def over_grid(grid: Grid, value: Any, dtype: Any, about: dict, *more: str) -> xr.Variable:
    """An array over a grid, and over the state too, with one value everywhere and no memory."""
    shape = (*grid.shape, *(grid.coordinates for _ in more))
    return xr.Variable((*grid.names, *more), np.broadcast_to(np.array(value, dtype), shape), about)


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
        self, place: store.Pieces
    ) -> tuple[list[Attractor], Iterator[dict[str, np.ndarray]]]:
        """The attractors, and what is still to be written of each piece."""
        ends = resolve(self.image(place), sinks=len(Outcome))
        tolerance = self.how["tolerance"]
        attractors, number = attractors_of_map(self.walker, self.grid, ends, tolerance)

        def piece(cells: slice) -> dict[str, np.ndarray]:
            return dict(zip(ABOUT, fates(ends.part(cells), number), strict=True))

        pieces = (piece(part_of(self.grid, place, i).cells) for i in range(place.count))
        return attractors, pieces

    def image(self, place: store.Pieces) -> Int[np.ndarray, " n"]:
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
        self, place: store.Pieces
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


def part_of(grid: Grid, place: store.Pieces, piece: int) -> Part:
    """The cells of a piece."""
    at = place.at(piece)
    start = [one.start for one in at] + [0] * (len(grid.shape) - len(at))
    shape = *(one.stop - one.start for one in at), *grid.shape[len(at) :]
    return Part(int(np.ravel_multi_index(start, grid.shape)), shape)


def around(state: Float[ArrayLike, " section"], names: tuple[str, ...]) -> dict:
    """Axes of a window around a gait's state; with phidot among them, of a slice there."""
    theta, thetadot, *others = map(float, np.asarray(state))
    middle = theta + thetadot if names[1] == "sum" else thetadot
    below, above = (0.5, 0.3) if "phidot" in names else (0.25, 0.1)
    return {
        "theta": (0.0, 2.5 * theta, 200),
        names[1]: (middle - below * theta, middle + above * theta, 250),
        **({"phidot": others[0]} if "phidot" in names else {}),
    }
