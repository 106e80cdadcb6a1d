"""The basin of attraction on fine grids, of which only cells on a boundary are followed.

A coarse grid is followed directly. Then every cell that has a neighbour of another fate is cut into
2 x 2 (2 x 2 x 2), and the parts are followed; the parts of all others inherit. Where parts show a
boundary to cells that inherited, those are followed too, and so on: a tail that is found
anywhere is followed to its end. Random starts among the cells that inherited find others, which are
followed too. A second set of random starts corrects the area, and gives its standard error.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.mapper import Labels, Mapper
from walker_jax.basins.memory import check_grid
from walker_jax.basins.methods import mapper_of_grid
from walker_jax.basins.schema import Basins, to_dataset
from walker_jax.checks import check_precision, check_whole, refuses_tracers
from walker_jax.grids import Grid
from walker_jax.integrators.solvers import default_tolerance
from walker_jax.walkers.model import Walker
from walker_jax.walking.outcomes import Outcome

BYTES_PER_REFINED_CELL = 40
"""Memory at its peak, for each cell of the finest grid."""
FINEST = 30
"""Levels, at most: cells are numbered in 32 bits."""
SPREAD = 1 / 12
"""Variance that a cell beside one of another fate brings to the area, in cells. A part f of it in
the basin brings f (1 - f), 1/6 on average; half of these cells or more have no part in both."""


@refuses_tracers("area_gradient gives derivatives of a basin's area")
def refine(
    walker: Walker,
    grid: Grid,
    levels: int,
    *,
    strides: int = 200,
    check: int = 500_000,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Fate of every cell of a grid that is 2^levels times as fine along each axis.

    On the finest level a cell's fate is that of a random point in it, so that the area of cells on
    the boundary is right on average.

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: the coarse grid, or slice, to start from. Its cells should be smaller than what the
      basin's parts are apart.
    - `levels`: how many times cells are cut; none gives the coarse grid.
    - `strides`: how many of them a walker is followed for.
    - `check`: starts drawn among the cells that inherited their fate, twice.
    - `seed`: of what is drawn.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show progress bars on a terminal.

    **Returns** a data set over the finest grid like that of `basin`, by direct iteration, and

    - `total_area`: of all attractors together, corrected by the check, and its standard error
      `total_area_error`, NaN where nothing is checked;
    - over the levels, `followed`: cells that were followed, and `boundary`: cells that have a
      neighbour of another fate;
    - `checked`, `mistaken`: starts of the second check, and those that fall where their cell
      walks, or the other way round; `strides_made`: in all.

    `strides` are counted for cells that were followed, and 0 for others. Memory is that of the
    finest grid; strides are made for its boundary alone. `ValueError` as for `basin`.
    """
    found = refine_cells(
        walker,
        grid,
        levels,
        strides=strides,
        check=check,
        seed=seed,
        tolerance=tolerance,
        progress=progress,
    )
    settings = {
        "method": "direct, refined",
        "strides": strides,
        "tolerance": found.mapper.tolerance,
        "seed": seed,
    }
    basins = Basins(
        found.fate.ravel(),
        found.attractor.ravel(),
        found.strides.ravel(),
        found.mapper.attractors,
    ).sorted()
    data = to_dataset(walker, found.grid, basins, settings)
    data["total_area"], data["total_area_error"] = found.area, found.area_error
    data["followed"] = "level", np.array(found.followed)
    data["boundary"] = "level", np.array(found.boundary)
    data["checked"], data["mistaken"] = found.checked, found.mistaken
    data["strides_made"] = found.total_strides
    return data


class Refined(NamedTuple):
    """What `refine` finds, as arrays over the finest grid."""

    grid: Grid
    fate: Int[np.ndarray, "*shape"]
    attractor: Int[np.ndarray, "*shape"]
    strides: Int[np.ndarray, "*shape"]
    mapper: Mapper
    """To the attractors that were found."""
    area: float
    area_error: float
    followed: list[int]
    boundary: list[int]
    checked: int
    mistaken: int
    total_strides: int


def refine_cells(
    walker: Walker,
    grid: Grid,
    levels: int,
    *,
    strides: int,
    check: int,
    seed: int,
    tolerance: float | None,
    progress: bool = False,
    by_centres: bool = False,
) -> Refined:
    """The work of `refine`. Cells of the finest grid may have the fates of their centres."""
    check_grid(walker, grid, "direct")
    check_whole("levels", levels, 0, FINEST)
    check_whole("check", check, 0)
    check_whole("strides", strides)
    check_whole("seed", seed, 0)
    dtype = jnp.asarray(0.0).dtype
    check_precision(dtype)
    tolerance = float(default_tolerance(dtype, tolerance))
    finest = finer(grid, levels)
    check_grid(walker, finest, "direct", BYTES_PER_REFINED_CELL)
    mapper = with_capture_boxes(mapper_of_grid(walker, grid, tolerance, strides))
    label = "cells" if progress else None
    cells = RefinedCells(grid, levels, by_centres, mapper, np.random.default_rng(seed), label)
    followed, boundary = [], []
    on_edge = np.ones(grid.shape, bool)
    for level in range(levels + 1):
        if level:
            cells.subdivide()
            on_edge = cut(on_edge)
        cells.follow(level, np.flatnonzero(on_edge))
        on_edge = edge(labels(cells.fate, cells.attractor))
        followed.append(int(np.count_nonzero(cells.depth == level)))
        boundary.append(int(np.count_nonzero(on_edge)))

    # What a first check finds is followed to its end; a second one tells how much is left. Shares
    # are those of least variance, (mistakes + 1) (size / count)^2 summed over the levels.
    drawn, excess, _ = cells.compare(cells.inherited() ** (2 / 3), check)
    mistakes = np.bincount(cells.depth.ravel()[drawn[excess != 0]], minlength=levels)
    cells.follow(levels, np.unique(drawn[excess != 0]))
    shares = cells.inherited() ** (2 / 3) * (mistakes + 1) ** (1 / 3)
    drawn, excess, counts = cells.compare(shares, check)
    depth = cells.depth.ravel()[drawn]
    mistakes = np.bincount(depth[excess != 0], minlength=levels)

    weight = cells.inherited() / np.maximum(counts, 1)
    missing = (weight * np.bincount(depth, excess, minlength=levels)).sum()
    area = ((cells.attractor >= 0).sum() + missing) * finest.cell_area
    mixed = edge((cells.attractor >= 0).astype(np.int8)).sum()
    # as if there were one mistake more than were found, lest none be taken for certainty
    variance = mixed * SPREAD + ((mistakes + 1) * weight**2).sum()
    variance = np.nan if check == 0 and levels else variance * finest.cell_area**2
    return Refined(
        grid=finest,
        fate=cells.fate,
        attractor=cells.attractor,
        strides=cells.strides,
        mapper=cells.mapper,
        area=float(area),
        area_error=float(np.sqrt(variance)),
        followed=followed,
        boundary=boundary,
        checked=len(drawn),
        mistaken=int(mistakes.sum()),
        total_strides=cells.total_strides,
    )


class RefinedCells:
    """The labels of all cells of ever finer grids, and on which level each cell was followed."""

    def __init__(
        self,
        grid: Grid,
        levels: int,
        by_centres: bool,
        mapper: Mapper,
        rng: np.random.Generator,
        progress: str | None,
    ):
        """On the finest of the levels a cell's label may be that of its centre, too."""
        self.grid, self.levels, self.by_centres = grid, levels, by_centres
        self.mapper, self.rng, self.progress = mapper, rng, progress
        self.total_strides = 0
        self.fate, self.attractor = np.zeros(grid.shape, np.int8), np.full(grid.shape, -1, np.int16)
        self.strides, self.depth = np.zeros(grid.shape, np.int32), np.full(grid.shape, -1, np.int8)

    def subdivide(self) -> None:
        """Cut all cells in two along each axis; the parts inherit labels."""
        self.fate, self.attractor, self.depth = map(cut, (self.fate, self.attractor, self.depth))
        self.strides = np.zeros(self.fate.shape, np.int32)

    def map(self, level: int, cells: Int[np.ndarray, " n"], *, anywhere: bool) -> Labels:
        """The labels of cells of a level, by their centres or by points anywhere in them."""
        grid = finer(self.grid, level)
        places = np.stack(np.unravel_index(cells, grid.shape), axis=1)
        within = self.rng.uniform(size=places.shape) if anywhere else 0.5
        x = grid.points_at((places + within) / np.array(grid.shape))
        found, self.mapper = self.mapper.label_all(x, progress=self.progress)
        self.total_strides += found.total_strides
        return found

    def follow(self, level: int, cells: Int[np.ndarray, " n"]) -> None:
        """Follow cells, and then those beside them where that shows a boundary, until none is."""
        fate, attractor, depth = self.fate.ravel(), self.attractor.ravel(), self.depth.ravel()
        while cells.size:
            anywhere = level == self.levels and not self.by_centres
            found = self.map(level, cells, anywhere=anywhere)
            fate[cells], attractor[cells], depth[cells] = found.fate, found.attractor, level
            self.strides.ravel()[cells] = found.strides
            beside = neighbours(cells, self.depth.shape)
            own = labels(fate[cells], attractor[cells])[:, None]
            unlike = labels(fate[beside], attractor[beside]) != own
            cells = np.unique(beside[unlike & (depth[beside] < level)])

    def inherited(self) -> Float[np.ndarray, " levels"]:
        """How many cells inherited their labels from each level."""
        counts = np.bincount(self.depth.ravel(), minlength=self.levels + 1)
        return counts[: self.levels].astype(float)

    def compare(
        self, shares: Float[np.ndarray, " levels"], check: int
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " levels"]]:
        """Random points in cells that inherited, against the labels of these.

        Returns the cells; 1 where the point walks and the cell does not, -1 where the cell does
        alone, else 0; and how many cells are of each level.
        """
        counts = np.floor(check * shares / max(shares.sum(), 1)).astype(int)
        counts = np.maximum(counts, (shares > 0) & (check > 0))
        of_level = [np.flatnonzero(self.depth == level) for level in range(self.levels)]
        drawn = [self.rng.choice(cells, n) for cells, n in zip(of_level, counts, strict=True) if n]
        cells = np.concatenate([np.zeros(0, int), *drawn])
        walks = self.map(self.levels, cells, anywhere=True).converged
        return cells, walks.astype(int) - (self.attractor.ravel()[cells] >= 0), counts


def finer(grid: Grid, level: int) -> Grid:
    """The grid with its cells cut in two along each axis, `level` times over."""
    ends = zip(grid.names, grid.lower, grid.upper, grid.shape, strict=True)
    axes = {name: (low, high, count * 2**level) for name, low, high, count in ends}
    return Grid(axes, grid.shear, grid.origin, grid.fixed)


def cut(values: np.ndarray) -> np.ndarray:
    """What cells have, for the parts of cells cut in two along each axis."""
    for axis in range(values.ndim):
        values = np.repeat(values, 2, axis=axis)
    return values


def labels(
    fate: Int[np.ndarray, "*shape"], attractor: Int[np.ndarray, "*shape"]
) -> Int[np.ndarray, "*shape"]:
    """One number for the fate and the attractor of each cell."""
    return np.where(attractor >= 0, len(Outcome) + attractor, fate)


def edge(label: Int[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
    """Whether a cell has a neighbour, corners included, with another label."""
    most, least = label, label
    for axis in range(label.ndim):
        most = among_neighbours(np.maximum, most, axis)
        least = among_neighbours(np.minimum, least, axis)
    return most != least


def neighbours(cells: Int[np.ndarray, " n"], shape: tuple[int, ...]) -> Int[np.ndarray, "n m"]:
    """Indices of each cell's neighbours, corners included, and itself, which the border repeats."""
    steps = np.indices((3,) * len(shape)).reshape(len(shape), -1) - 1
    index = np.stack(np.unravel_index(cells, shape))[:, :, None] + steps[:, None]
    return np.asarray(np.ravel_multi_index(tuple(index), shape, mode="clip"))


def among_neighbours(pick: np.ufunc, values: np.ndarray, axis: int) -> np.ndarray:
    """The largest, or least, of each value and its two neighbours along an axis."""
    picked = values.copy()
    here, there = (np.moveaxis(array, axis, 0) for array in (picked, values))
    pick(here[1:], there[:-1], out=here[1:])
    pick(here[:-1], there[1:], out=here[:-1])
    return picked
