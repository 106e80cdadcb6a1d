"""The calculations of the paper, each a function that returns a data set."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.basins.computation import basin
from walker_jax.basins.refinement import refine
from walker_jax.basins.windows import default_region
from walker_jax.execution.threads import side_by_side
from walker_jax.gaits.diagrams import bifurcation_diagram
from walker_jax.gaits.search import find_gait
from walker_jax.grids import Grid
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking.movement import motion

EXAMPLE_SLOPE = 0.004
"""Slope of the examples in the paper."""
START = (0.2, -0.21645)
"""The start in Table 1: its theta + thetadot has one digit more than its thetadot."""
CELL = 0.002, 0.0002
"""Widths of the paper's cells, along theta and theta + thetadot."""
CHECK_STARTS = 100_000
"""Random starts that correct each exact area of Figure 8, to less than the width of its line."""
ROW_SLOPES = (0.004, 0.008, 0.012, 0.015, 0.018, 0.02)
"""Slopes of Figure 7. The paper does not print its own."""


class Size(NamedTuple):
    """The extent of the calculations."""

    section: int
    """Cells along each axis of Figure 2."""
    slopes: int
    """Slopes of Figure 8."""
    levels: int | None
    """Levels of refinement for the exact areas of Figure 8; None: areas are omitted."""
    strides: int
    """Strides after which a walker counts as walking, in the search for the loss of walking."""
    shifts: int
    """Shifts of the paper's grid along each axis, to see how the vanishing of the basin depends on
    the places of cells."""


FULL = Size(section=1000, slopes=22, levels=3, strides=3000, shifts=4)
QUICK = Size(section=400, slopes=15, levels=None, strides=3000, shifts=2)


def paper_grid(shift: Sequence[float] | Float[np.ndarray, " 2"] = (0, 0)) -> Grid:
    """Return the grid of Figure 4, 200 x 250 cells, shifted by parts of a cell."""
    left, up = np.multiply(CELL, shift)
    return Grid.sheared(theta=(-left, 0.4 - left, 200), sum=(-0.04 + up, 0.01 + up, 250))


def stride_of_gait(size: Size) -> xr.Dataset:
    """Figure 1: one stride of the gait, at a slope with visibly long steps."""
    walker = SimplestWalker(0.009)
    return motion(walker, find_gait(walker).states[0], 1, step=0.02)


def whole_section(size: Size) -> xr.Dataset:
    """Figure 2: the whole section."""
    n = size.section
    grid = Grid.plain(theta=(0, np.pi / 4, n), thetadot=(-1.2, 0, n))
    return basin(SimplestWalker(EXAMPLE_SLOPE), grid, "direct", progress=False)


def gaits(size: Size) -> xr.Dataset:
    """Figure 3: gaits of period one over the slope, and the loss of walking."""
    return bifurcation_diagram(
        SimplestWalker(EXAMPLE_SLOPE),
        "slope",
        (0.0005, 0.0225),
        period_max=1,
        strides=size.strides,
        scan=2,
        exponents=0,
        progress=False,
    )


def mapped_basin(size: Size) -> xr.Dataset:
    """Figure 4: cell mapping on the paper's own grid."""
    return basin(SimplestWalker(EXAMPLE_SLOPE), paper_grid(), progress=False)


def iterated_basin(size: Size) -> xr.Dataset:
    """Figure 5: the basin of the same cells by direct iteration."""
    return basin(SimplestWalker(EXAMPLE_SLOPE), paper_grid(), "direct", progress=False)


def nine_steps(size: Size) -> xr.Dataset:
    """Table 1 and Figures 5 and 6: nine steps from just inside the basin."""
    return motion(SimplestWalker(EXAMPLE_SLOPE), np.array(START), 9, step=0.02)


def basins_over_slopes(size: Size) -> xr.Dataset:
    """Figure 7: basins at a row of slopes, in a higher window than in Figure 4.

    The basin rises with the slope.
    """
    grid = Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.02, 300))
    basin_at = lambda slope: basin(SimplestWalker(slope), grid, "direct", progress=False)
    found = list(side_by_side(basin_at, ROW_SLOPES))
    kept = [one[["fate", "attractor"]].assign(area=one["area"].sum()) for one in found]
    table = xr.concat(kept, "slope", coords="minimal", compat="override", combine_attrs="drop")
    return table.assign_coords(slope=list(ROW_SLOPES)).assign_attrs(found[0].attrs)


def areas_over_slopes(size: Size) -> xr.Dataset:
    """Figure 8: area of the whole basin over the slope, by the paper's cells and exactly."""
    theta, total = CELL
    grid = Grid.sheared(theta=(0, 392 * theta, 392), sum=(-600 * total, 150 * total, 750))
    at = np.linspace(0.0005, 0.0215, size.slopes).round(6)

    def areas_at(slope: float) -> tuple[float, float, float]:
        walker = SimplestWalker(slope)
        mapped_area = float(basin(walker, grid, progress=False)["area"].sum())
        region = default_region(walker)
        if size.levels is None or region is None:
            return mapped_area, np.nan, np.nan
        fine = refine(walker, region, size.levels, check=CHECK_STARTS, progress=False)
        return mapped_area, float(fine["total_area"]), float(fine["total_area_error"])

    found = zip(*side_by_side(areas_at, at.tolist()), strict=True)
    over = dict(zip(("mapped_area", "area", "area_error"), found, strict=True))
    return xr.Dataset(
        {name: ("slope", np.array(values)) for name, values in over.items()}, {"slope": at}
    )


def surviving_cells(size: Size) -> xr.Dataset:
    """Section 5.2: cells that converge to an attractor by cell mapping, over steep slopes.

    It is computed on the paper's own grid, and on grids shifted by parts of a cell.
    """
    at = np.arange(18, 28) / 1000
    shifts = np.stack(np.divmod(np.arange(size.shifts**2), size.shifts), axis=1) / size.shifts

    def count_at(shift: Float[np.ndarray, " 2"]) -> list[int]:
        basins = [
            basin(SimplestWalker(slope), paper_grid(shift), progress=False) for slope in at.tolist()
        ]
        return [int((one["attractor"] >= 0).sum()) for one in basins]

    cells = list(side_by_side(count_at, shifts))
    return xr.Dataset({"cells": (("shift", "slope"), cells)}, {"slope": at})


def fates_along_line(size: Size) -> xr.Dataset:
    """Section 5.1: fates along the line theta = 0.2 of Figure 4."""
    half = 1e-9
    grid = Grid.sheared(theta=(0.2 - half, 0.2 + half, 1), sum=(-0.04, 0.01, 50_000))
    return basin(SimplestWalker(EXAMPLE_SLOPE), grid, "direct", progress=False).isel(theta=0)


CALCULATIONS: dict[str, Callable[[Size], xr.Dataset]] = {
    "stride": stride_of_gait,
    "section": whole_section,
    "gaits": gaits,
    "cell_mapping": mapped_basin,
    "direct_iteration": iterated_basin,
    "walk": nine_steps,
    "basins": basins_over_slopes,
    "areas": areas_over_slopes,
    "surviving_cells": surviving_cells,
    "line": fates_along_line,
}
"""The calculations by the names of their data sets."""
