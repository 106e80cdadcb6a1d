"""Pictures of nested sets: how large basins are, and how large they could be."""

from collections.abc import Mapping
from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from walker_jax.basins.cell_classes import CellClass
from walker_jax.basins.volumes import grid_of
from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.regions import Region, extent_of, paint, patch_of, show_image
from walker_jax.figures.style import INK
from walker_jax.figures.text import walker_title
from walker_jax.figures.viability_plots import actions_in_words, draw_boundary, middle_plane
from walker_jax.storage.schema import check_dataset

MOST_STRIDES = 3
"""Fewest strides with one colour for them and all higher numbers."""
SHADES = [to_hex(one) for one in colormaps["cividis"]([0.0, 0.45, 0.7, 0.88, 1.0])]
COLOURS = [*SHADES, "#f4f4f4"]
"""Colours, dark to light: the target, cells 1, 2 and more strides from it, viable cells that do not
lead there, and all others."""
LINES = [("#d55e00", 1.3, "-"), (INK, 1.0, (0, (4, 1.5))), ("#56b4e9", 1.2, (0, (1, 1.2)))]
"""Colours, widths and kinds of the lines around basins, in turn."""


def capturability(
    data: xr.Dataset,
    basins: Mapping[str, xr.Dataset] | None = None,
    ax: Axes | None = None,
    **style: Unpack[Style],
) -> DrawnAxes:
    """Draw how large the basin could be: n-step capturable states within the viability kernel.

    Cells are coloured by the fewest strides into the target, darker for fewer. Then come viable
    cells from which no actions lead there; the lightest cells are bound to fail under these
    actions. Lines surround basins. The legend has areas: each of all cells up to that colour.

    **Arguments:**

    - `data`: what `walker_jax.viable` returns. The first dimension is drawn along the x axis; of
      three dimensions, the slice in the middle is drawn.
    - `basins`: up to three data sets of `walker_jax.basin` on the same grid, by name, such as those
      of walkers with feedback or with a `Policy`.
    - `ax`: where to draw; by default, on a new figure of 3.5 by 4.4 inches, a column of a paper.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set that is not of two or three dimensions,
    with two cells or more along the first two, and for too many basins or basins on another grid.
    """
    check_dataset(data, "viability")
    plane, place = middle_plane(data)
    around = read_basins(data, {} if basins is None else basins)
    ax = axes_for(ax, style, 3.5, 4.4)
    x, y = map(str, plane["viable"].dims)
    extent = extent_of(plane, x, y)
    regions = regions_of_capture(plane, areas_of_capture(data))
    show_image(ax, paint(regions, plane["viable"].shape), extent)
    lines = []
    for (words, basin), look in zip(around.items(), LINES, strict=False):
        cells, _ = middle_plane(basin, "attractor")
        named = f"{words}: {sum(basin.attrs['area']):.3g}", *look
        lines += draw_boundary(ax, named, cells["attractor"].values >= 0, extent)
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=f"{actions_in_words(data)}{place}",
        x=x,
        y=y,
        legend=[*map(patch_of, regions), *lines],
    )


def regions_of_capture(data: xr.Dataset, areas: list[str]) -> list[Region]:
    """Return the sets of cells that `areas` names, each without those before, and all others."""
    capture, viable = data["capture"].values, data["viable"].values
    sets = [capture == n for n in range(MOST_STRIDES)]
    sets += [capture >= MOST_STRIDES, viable & (capture < 0), ~viable & (capture < 0)]
    return [
        Region(CellClass(cells), colour, "", words)
        for cells, colour, words in zip(sets, COLOURS, areas, strict=True)
        if words
    ]


def areas_of_capture(data: xr.Dataset) -> list[str]:
    """Label each set with its area, those before included; empty for a set without cells."""
    capture, viable = data["capture"].values, data["viable"].values
    most, cell = int(capture.max()), grid_of(data).cell_area
    area = lambda cells: f"{cells.sum() * cell:.3g}"
    within = lambda n: (capture >= 0) & (capture <= n)
    words = [f"target: {area(capture == 0)}"]
    words += [f"{count_strides(n)}: {area(within(n))}" for n in range(1, MOST_STRIDES)]
    words += [f"up to {count_strides(most)}: {area(within(most))}", f"viable: {area(viable)}"]
    sizes = [(capture == n).any() for n in range(MOST_STRIDES)]
    sizes += [most >= MOST_STRIDES, (viable & (capture < 0)).any()]
    known = [one if any_cells else "" for one, any_cells in zip(words, sizes, strict=True)]
    return [*known, "bound to fail"]


def count_strides(n: int) -> str:
    return f"{n} stride{'s' * (n > 1)}"


def read_basins(data: xr.Dataset, basins: Mapping[str, xr.Dataset]) -> Mapping[str, xr.Dataset]:
    """Return basins on the grid of a kernel, checked."""
    check_kind("basins", basins, Mapping)
    if len(basins) > len(LINES):
        raise WrongUse(f"basins must be {len(LINES)} at most, not {len(basins)}")
    shape = data["viable"].sizes
    for words, basin in basins.items():
        check_kind("basins", basin, xr.Dataset)
        check_dataset(basin, "basin")
        if basin["attractor"].sizes != shape:
            found = dict(basin["attractor"].sizes)
            raise WrongUse(
                f"basins must be on the grid of data, {dict(shape)}, not {short(words)} on {found}"
            )
        for name in shape:
            if not np.allclose(basin[name].values, data[name].values, rtol=1e-9, atol=1e-12):
                raise WrongUse(f"basins must be on the grid of data, unlike {short(words)}")
    return basins
