"""Refined basins of three dimensions, and their slices along the axes of the grid."""

from typing import Any

import numpy as np
import xarray as xr

from walker_jax.basins.attractor import Attractor, all_motions
from walker_jax.basins.runs import Runs, flat_index
from walker_jax.basins.schema import Basins, add_basins
from walker_jax.checks import WrongUse, check_kind, check_number, refuses_tracers, short
from walker_jax.grids import Grid
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import failures_of


@refuses_tracers()
def slice_basin(data: xr.Dataset, axis: str, value: float) -> xr.Dataset:
    """Return the slice of a refined basin of three dimensions at one value of one axis.

    ```python
    grid = wj.Grid.sheared(theta=(0, 1.4, 28), sum=(-1, 0.2, 24), phidot=(-2.5, 1, 28))
    data = wj.refine(wj.RoundFootWalker(0.04), grid, levels=0, check=100)
    plane = wj.slice_basin(data, "phidot", -0.5)
    ```

    **Arguments:**

    - `data`: a data set of `refine` over three dimensions.
    - `axis`: the name of an axis of its grid, such as "phidot".
    - `value`: a value on that axis; the slice consists of the finest cells that hold the value.

    **Returns** a data set like that of `basin` over the other two axes; all its `strides` are 0.
    `cells`, `area` and `at_border` are those of the slice.

    Raises `ValueError` for another data set, for an axis that it does not have, and for a value
    outside the axis.
    """
    check_kind("data", data, xr.Dataset)
    check_dataset(data, "refined volume")
    grid, runs = grid_of(data), runs_of(data)
    if not isinstance(axis, str) or axis not in grid.names:
        raise WrongUse(f"axis must be one of {', '.join(grid.names)}, not {short(axis)}")
    check_number("value", value)
    hidden = grid.names.index(axis)
    low, high, count = (float(ends[hidden]) for ends in (grid.lower, grid.upper, grid.counts))
    if not low <= value < high:
        raise WrongUse(f"value must be on {axis}, from {low:g} to {high:g}, not {value:g}")
    place = min(int((value - low) / (high - low) * count), int(count) - 1)
    others = [k for k in range(len(grid.names)) if k != hidden]
    axes = {grid.names[k]: list(grid.box.values())[k] for k in others}
    centre = float(data[axis][place])
    plane = Grid(axes, grid.shear[:, others], grid.origin + grid.shear[:, hidden] * centre)
    cells = np.insert(np.indices(plane.shape), hidden, place, axis=0)
    run = runs.of_cells(flat_index(cells, grid.shape))
    basins = Basins(
        data["run_fate"].values[run].ravel(),
        data["run_attractor"].values[run].ravel(),
        np.zeros(plane.size, np.int32),
        [
            Attractor(states[:period]) if period else all_motions(states[:1])
            for states, period in zip(data["states"].values, data["period"].values, strict=True)
        ],
    )
    frame = xr.Dataset(coords=plane.axes | {axis: centre}, attrs=data.attrs)
    return add_basins(frame, plane, basins, failures_of(data))


def frame_of(grid: Grid) -> dict[str, Any]:
    """Return the variables of a data set from which `grid_of` makes a grid again."""
    return {
        "axis": ("axis", np.array(grid.names, object)),
        "lower": ("axis", grid.lower),
        "upper": ("axis", grid.upper),
        "shear": (("coordinate", "axis"), grid.shear),
        "origin": ("coordinate", grid.origin),
    }


def grid_of(data: xr.Dataset) -> Grid:
    """Return the grid of a data set that has its frame, such as a refined basin of volumes."""
    names = data["axis"].values.tolist()
    ends = zip(data["lower"].values, data["upper"].values, strict=True)
    axes = {
        name: (float(low), float(high), data.sizes[name])
        for name, (low, high) in zip(names, ends, strict=True)
    }
    return Grid(axes, data["shear"].values, data["origin"].values)


def runs_of(data: xr.Dataset) -> Runs:
    """Return the runs of its cells, for their places only: labels and levels are 0."""
    shape = tuple(data.sizes[name] for name in data["axis"].values.tolist())
    first = data["first_cell"].values
    label = np.zeros(len(first), np.int32)
    return Runs(shape, first, label, label.astype(np.int8))
