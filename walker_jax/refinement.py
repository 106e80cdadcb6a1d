"""The basin of attraction on fine grids, where only cells on a boundary are worked out.

A coarse grid is followed directly. Then every cell that has a neighbour of another fate is cut into
2 x 2 (2 x 2 x 2), and the parts are followed; the parts of all others inherit. Where parts show a
boundary to cells that inherited, those are followed too, and so on: a tail that has been met
anywhere is followed to its end. What has not been met anywhere is looked for by starts drawn at
random among the cells that inherited: they correct the area, and say how far it can be trusted.
"""

from importlib.metadata import version

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from walker_jax.basin import (
    Basins,
    centres,
    check_grid,
    follow,
    labelled,
    sample,
    settle,
    sort_attractors,
)
from walker_jax.cells import Grid
from walker_jax.integrate import default_tolerance
from walker_jax.stride import Outcome
from walker_jax.walkers import Walker

BYTES_PER_CELL = 40
"""Memory at its peak, for each cell of the finest grid."""
SPREAD = 1 / 12
"""Variance that a cell beside one of another fate brings to the area, in cells. A part f of it in
the basin brings f (1 - f), 1/6 on average; half of these cells or more have no part in both."""


def refine(
    walker: Walker,
    grid: Grid,
    levels: int,
    *,
    strides: int = 200,
    check: int = 100_000,
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
    - `check`: starts drawn among the cells that inherited their fate.
    - `seed`: of what is drawn.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show progress bars on a terminal.

    **Returns** a data set over the finest grid like that of `basin`, by direct iteration, and

    - `total_area`: of all attractors together, corrected by the check, and its standard error
      `total_area_error`;
    - over the levels, `followed`: cells that were followed, and `boundary`: cells that have a
      neighbour of another fate;
    - `checked`, `mistaken`: starts of the check, and those that fall where their cell walks, or the
      other way round; `strides_made`: in all.

    `strides` are counted for cells that were followed, and 0 for others. Memory is that of the
    finest grid; strides are made for its boundary alone. `ValueError` as for `basin`.
    """
    if levels < 0:
        raise ValueError(f"levels must not be negative, not {levels}")
    if check < 0:
        raise ValueError(f"check must not be negative, not {check}")
    if strides < 1:
        raise ValueError(f"strides must be at least 1, not {strides}")
    tolerance = float(default_tolerance(jnp.asarray(0.0).dtype, tolerance))
    finest = finer(grid, levels)
    check_grid(walker, finest, "direct", each=BYTES_PER_CELL)
    rng = np.random.default_rng(seed)
    attractors = settle(
        walker, sample(centres(grid, np.arange(grid.size, dtype=np.int32))), tolerance, []
    )
    made = 0

    def look(grid: Grid, cells: Int[np.ndarray, " n"], *, anywhere: bool) -> Basins:
        """The fates of cells, by their centres or by points anywhere in them."""
        nonlocal attractors, made
        x = centres(grid, cells.astype(np.int32))
        if anywhere:
            u = rng.uniform(-0.5, 0.5, (len(cells), len(grid.names))) * np.asarray(grid.spacing)
            x = x + u @ np.asarray(grid.shear).T
        found = follow(walker, x, attractors, tolerance, strides, progress)
        attractors = found.attractors
        made += int(found.strides.sum() + (found.fate != Outcome.STRIDE).sum())
        return found

    fate, attractor = np.zeros(grid.shape, np.int8), np.full(grid.shape, -1, np.int16)
    known = np.zeros(grid.shape, bool)
    followed, boundary = [], []
    for level in range(levels + 1):
        fine = finer(grid, level)
        wanted = np.ones(grid.shape, bool)
        if level:
            wanted = cut(edge(labels(fate, attractor)))
            fate, attractor = cut(fate), cut(attractor)
        count, known = np.zeros(fine.shape, np.int32), np.zeros(fine.shape, bool)
        while (cells := np.flatnonzero(wanted & ~known)).size:
            found = look(fine, cells, anywhere=level == levels)
            fate.ravel()[cells], attractor.ravel()[cells] = found.fate, found.attractor
            count.ravel()[cells], known.ravel()[cells] = found.strides, True
            wanted = edge(labels(fate, attractor))
        followed.append(int(known.sum()))
        boundary.append(int(edge(labels(fate, attractor)).sum()))

    cell = finest.cell_area
    mixed = edge((attractor >= 0).astype(np.int8)).sum()
    walks = (attractor >= 0).ravel()
    area, variance = walks.sum() * cell, mixed * SPREAD * cell**2
    inherited = np.flatnonzero(~known)
    checked, mistaken = (check if len(inherited) else 0), 0
    if checked:
        cells = inherited[rng.integers(0, len(inherited), checked)]
        found = look(finest, cells, anywhere=True)
        error = (found.attractor >= 0).astype(int) - walks[cells]
        mistaken = int(np.count_nonzero(error))
        whole = len(inherited) * cell
        area += error.mean() * whole
        # as if there were one more than were found, lest none be taken for certainty
        variance += (mistaken + 1) * (whole / checked) ** 2

    basins = Basins(fate.ravel(), attractor.ravel(), count.ravel(), attractors)
    data = labelled(walker, finest, sort_attractors(basins))
    data["total_area"] = float(area)
    data["total_area_error"] = float(np.sqrt(variance))
    data["followed"] = "level", np.array(followed)
    data["boundary"] = "level", np.array(boundary)
    data["checked"], data["mistaken"] = checked, mistaken
    data["strides_made"] = made
    data.attrs = {
        "walker": type(walker).__name__,
        **{f"walker_{name}": float(value) for name, value in vars(walker).items()},
        "method": "direct, refined",
        "strides": strides,
        "tolerance": tolerance,
        "section": list(walker.section),
        "area": data["area"].values.tolist(),
        "seed": seed,
        "version": f"walker-jax {version('walker-jax')}",
    }
    return data


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


def among_neighbours(pick: np.ufunc, values: np.ndarray, axis: int) -> np.ndarray:
    """The largest, or least, of each value and its two neighbours along an axis."""
    picked = values.copy()
    here, there = (np.moveaxis(array, axis, 0) for array in (picked, values))
    pick(here[1:], there[:-1], out=here[1:])
    pick(here[:-1], there[1:], out=here[:-1])
    return picked
