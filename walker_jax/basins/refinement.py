"""The basin of attraction on fine grids, where only cells on a boundary are followed.

A coarse grid is followed directly. Then every cell with a neighbour of another fate is halved along
each axis, and its parts are followed; parts of all other cells inherit their fates. Where parts
show a boundary to cells that inherited, those are followed too, and so on: a tail found anywhere is
followed to its end. Random starts among the cells that inherited find further tails, which are
followed too. A second set of random starts corrects the area, and gives its standard error.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from walker_jax.basins.attractor import seen
from walker_jax.basins.attractor_search import mapper_of_scouts, scouts_among
from walker_jax.basins.computation import BYTES_PER_CELL, check_grid
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.refined_cells import REDRAWN, RefinedCells
from walker_jax.basins.runs import Runs
from walker_jax.basins.schema import (
    Basins,
    add_attractors,
    attributes_of_arrays,
    describe,
    to_dataset,
)
from walker_jax.basins.volumes import frame_of
from walker_jax.checks import MAX_COUNT, check_memory, check_precision, check_whole, refuses_tracers
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.system import System, warn_if_rounded

BYTES_PER_REFINED_CELL = 40
"""Peak memory in bytes, for each cell of the finest grid."""
FINEST = 30
"""Largest number of levels; memory ends far below."""


@refuses_tracers("measure gives derivatives of a basin's area")
def refine(
    walker: System,
    grid: Grid,
    levels: int,
    *,
    strides: int = 200,
    check: int = 500_000,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Compute the basin on a grid 2^levels times as fine, following its boundary only.

    On the finest level a cell's fate is that of a random point in it, so that the area of cells on
    the boundary is right on average.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 100))
    data = wj.refine(wj.SimplestWalker(0.004), grid, levels=2, check=10_000)
    float(data.total_area), float(data.total_area_error)
    ```

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: the coarse grid, or slice, to start from. Its cells should be smaller than the gaps
      between parts of the basin.
    - `levels`: number of times cells are halved along each axis; 0 gives the coarse grid.
    - `strides`: number of strides for which a walker is followed.
    - `check`: starts drawn among the cells that inherited their fate, twice. Up to 20,000 are also
      drawn among the followed cells, to estimate their error.
    - `seed`: of the random numbers.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show progress bars on a terminal, after a second.

    **Returns** a data set over the finest grid like that of `basin`, by direct iteration, and

    - `total_area`: of all attractors together, corrected by the check, and its standard error
      `total_area_error`, NaN where nothing is checked;
    - over the levels, `followed`: cells that were followed, and `boundary`: cells with a neighbour
      of another fate;
    - `checked`, `mistaken`: starts of the second check, and those that fall where their cell walks,
      or the other way round;
    - `strides_made`: the number of all strides.

    `strides` are counted for cells that were followed, and 0 for others. Strides are made for the
    boundary alone; the returned arrays take the memory of the finest grid.

    Over three dimensions areas are volumes, and memory grows with the boundary only: in place of
    arrays over the grid the data set has runs of equal cells, from which `slice_basin` makes arrays
    in two dimensions.

    Raises `ValueError` as `basin` does, and where a level needs more memory than there is.
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
        "tolerance": float(found.mapper.integrator.tolerance),
        "seed": seed,
    }
    data = dataset_of_cells if len(grid.names) < 3 else dataset_of_runs
    data = data(walker, found, settings)
    data["total_area"], data["total_area_error"] = found.area, found.area_error
    data["followed"] = "level", np.array(found.followed)
    data["boundary"] = "level", np.array(found.boundary)
    data["checked"], data["mistaken"] = found.checked, found.mistaken
    data["strides_made"] = found.total_strides
    return data


class Refined(NamedTuple):
    """The result of `refine`."""

    grid: Grid
    """The finest grid."""
    runs: Runs
    """The labels of its cells."""
    cells: Int[np.ndarray, " n"]
    """The cells of the finest grid that were followed, in ascending order."""
    made: Int[np.ndarray, " n"]
    """Strides made from these cells."""
    mapper: Mapper
    """Maps starts to the attractors that were found."""
    area: float
    """Area of all attractors together; over three dimensions a volume."""
    area_error: float
    followed: list[int]
    boundary: list[int]
    checked: int
    mistakes: Int[np.ndarray, " m"]
    """Cells in which the check found a random point with another fate than the cell."""
    missing: Float[np.ndarray, " m"]
    """Number of cells each stands for; negative where the cell walks and the point does not."""
    total_strides: int

    @property
    def mistaken(self) -> int:
        """Number of mistakes the check found."""
        return len(self.mistakes)

    @property
    def attractor(self) -> Int[np.ndarray, "*shape"]:
        """Attractors of all cells; an array over the grid."""
        return self.runs.spread(self.runs.attractor)


def dataset_of_cells(walker: System, found: Refined, settings: dict) -> xr.Dataset:
    """Make the data set of a basin, with arrays over the finest grid."""
    runs, strides = found.runs, np.zeros(found.runs.size, np.int32)
    strides[found.cells] = found.made
    fate = runs.spread(runs.fate).ravel()
    basins = Basins(fate, found.attractor.ravel(), strides, found.mapper.attractors)
    return to_dataset(walker, found.grid, basins.sorted(), settings)


def dataset_of_runs(walker: System, found: Refined, settings: dict) -> xr.Dataset:
    """Make the data set with the runs of cells in place of arrays over the grid."""
    runs = found.runs
    strides = np.zeros(len(runs.first), np.int32)
    basins = Basins(runs.fate, runs.attractor, strides, found.mapper.attractors).sorted()
    walks = basins.attractor >= 0
    cells = np.zeros(len(basins.attractors), int)
    np.add.at(cells, basins.attractor[walks], runs.lengths[walks])
    about = attributes_of_arrays(walker.failures)
    data = describe(walker, found.grid, settings).assign(
        first_cell=("run", runs.first),
        run_fate=("run", basins.fate, about["fate"]),
        run_attractor=("run", basins.attractor, about["attractor"]),
        **frame_of(found.grid),
    )
    at_border = runs.count_at_border(walks)
    return add_attractors(data, found.grid, basins.attractors, cells, at_border)


def refine_cells(
    walker: System,
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
    """Do the work of `refine`. Cells of the finest grid may have the fates of their centres."""
    check_refinement(walker, grid, {"levels": levels, "check": check, "seed": seed}, strides)
    dtype = jnp.result_type(float)
    check_precision(dtype)
    warn_if_rounded(walker)
    integrator = integrator_of(dtype, tolerance)
    finest = check_finest(walker, grid, levels)
    scouts = grid.centres(scouts_among(grid.size))
    mapper = mapper_of_scouts(walker, scouts, integrator, strides, boxes=True)
    label = "cells" if progress else None
    cells = RefinedCells(grid, levels, by_centres, mapper, np.random.default_rng(seed), label)
    followed, boundary = cells.follow_levels()
    drawn, excess, counts = correct_and_estimate(cells, levels, check)
    depth = cells.runs.levels_of(drawn)
    weight = cells.inherited() / np.maximum(counts, 1)
    missing = (weight[depth] * excess)[excess != 0]
    walks_to = cells.runs.attractor
    walks = walks_to >= 0
    area = (cells.runs.lengths[walks].sum() + missing.sum()) * finest.cell_area
    # Searches for an optimum often ask for areas by centres, and need only a rough error.
    measured = not by_centres or len(grid.names) > 2
    variance = cells.measure_variance(min(check, REDRAWN) if measured else 0)
    # One more mistake counts than was found, so that a lack of mistakes is not certainty.
    mistakes = np.bincount(depth[excess != 0], minlength=levels)
    variance += ((mistakes + 1) * weight**2).sum()
    variance = np.nan if check == 0 and levels else variance * finest.cell_area**2
    return Refined(
        grid=finest,
        runs=cells.runs,
        cells=cells.cells,
        made=cells.strides,
        mapper=cells.mapper._replace(attractors=seen(cells.mapper.attractors, walks_to)),
        area=float(area),
        area_error=float(np.sqrt(variance)),
        followed=followed,
        boundary=boundary,
        checked=len(drawn),
        mistakes=drawn[excess != 0],
        missing=missing,
        total_strides=cells.total_strides,
    )


def check_refinement(walker: System, grid: Grid, counts: dict[str, int], strides: int) -> None:
    """Raise `WrongUse` for a grid that does not fit, and for numbers out of range."""
    kind = "refined volume" if len(getattr(grid, "names", ())) == 3 else "refined basin"
    check_grid(walker, grid, "direct", kind=kind)
    for name, count in counts.items():
        check_whole(name, count, 0, FINEST if name == "levels" else MAX_COUNT)
    check_memory_of_starts("check", counts["check"])
    check_whole("strides", strides)


def check_memory_of_starts(name: str, count: int) -> None:
    """Raise `TooLarge` for more starts than this machine's memory holds."""
    needed = count * BYTES_PER_CELL["direct"]
    check_memory(needed, f"{count} starts need", f"lower {name}", of=name)


def correct_and_estimate(
    cells: RefinedCells, levels: int, check: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " levels"]]:
    """Check cells twice: follow what the first check finds, and estimate what is left.

    Returns the cells, the mistake in each, and the number of checks of each level. Shares of the
    levels minimise the variance, the sum of (mistakes + 1) (size / count)^2.
    """
    drawn, excess, differs, _ = cells.compare(cells.inherited() ** (2 / 3), check)
    mistakes = np.bincount(cells.runs.levels_of(drawn[excess != 0]), minlength=levels)
    cells.follow(levels, np.unique(drawn[differs]))
    shares = cells.inherited() ** (2 / 3) * (mistakes + 1) ** (1 / 3)
    drawn, excess, _, counts = cells.compare(shares, check)
    return drawn, excess, counts


def check_finest(walker: System, grid: Grid, levels: int) -> Grid:
    """Return the finest grid; raise `TooLarge` if its arrays exceed this machine's memory.

    Over three dimensions no array has all of its cells.
    """
    finest = finer(grid, levels)
    if len(grid.names) < 3:
        check_grid(walker, finest, "direct", BYTES_PER_REFINED_CELL)
    return finest


def finer(grid: Grid, level: int) -> Grid:
    """Return the grid with its cells halved along each axis, `level` times."""
    ends = zip(grid.names, grid.lower, grid.upper, grid.shape, strict=True)
    axes = {name: (low, high, count * 2**level) for name, low, high, count in ends}
    return Grid(axes, grid.shear, grid.origin, grid.fixed)
