"""Pictures of basins of attraction in three dimensions."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from walker_jax.basins.cell_classes import has_known_units
from walker_jax.basins.volumes import runs_of, slice_basin
from walker_jax.figures import layout, regions, text
from walker_jax.figures.style import BASINS, OTHERS, TITLE
from walker_jax.storage.schema import check_dataset

LIGHT = np.array([-0.3, 0.6, -0.74])
"""Direction of the light, along the axes of the grid."""
AMBIENT = 0.45
"""Share of ambient light."""
PALE = 0.25
"""Share of white in the colours of surfaces, as dark colours would show no shadows."""
TAILS = 0.002
"""Largest share of the cells at either end of each axis that may be outside the picture."""
MARGIN = 0.05
"""Margin around the basin, as a share of its extent."""


def volume(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.refine` returns over three dimensions: slices, and its surface.

    Three slices, each along two axes of the grid, go through the first state of the attractor with
    the largest basin. The fourth picture shows the outermost cells of all basins in parallel
    projection. Colours are those of `basin`. All pictures show the part of the grid that has
    basins.
    """
    check_dataset(data, "refined volume")
    sizes, names = data["cells"].values, tuple(data["axis"].values.tolist())
    large = [i for i in np.argsort(-sizes, kind="stable")[: len(BASINS)].tolist() if sizes[i] > 0]
    cells = runs_of(data).spread(data["run_attractor"].values)
    window = window_of(data, cells)
    attractors = [*regions.attractors(data, large, names)]
    centre = attractors[0][0][0] if attractors else window.mean(axis=1)
    figure = layout.new_figure(10, 9)
    panels, patches = [], []
    for panel, (hidden, *shown) in enumerate(((2, 0, 1), (1, 0, 2), (0, 1, 2)), start=1):
        ax, depth = figure.add_subplot(2, 2, panel), names[hidden]
        depths = data[depth].values
        plane = slice_basin(data, depth, float(np.clip(centre[hidden], depths[0], depths[-1])))
        patches += map(regions.patch_of, regions.draw_regions(ax, plane, large))
        for dots, marker, name in attractors:
            regions.mark_attractor(ax, dots[:, shown], marker, name)
        ax.set(xlim=window[shown[0]], ylim=window[shown[1]])
        place = text.coordinate_value(depth, float(plane[depth]))
        x, y = (names[i] for i in shown)
        layout.finish(ax, {"legend": False}, f"Slice at {place}", x=x, y=y)
        panels.append(ax)
    draw_surface(figure, data, cells, large, window)
    layout.figure_title(figure, text.walker_title(data))
    shape = " × ".join(str(data.sizes[name]) for name in names)
    size = text.with_error(float(data["total_area"]), float(data["total_area_error"]))
    unit = " rad³·g/l" if has_known_units(data) else ""
    note = f"direct iteration, refined, on {shape} cells; basin volume {size}{unit}"
    layout.figure_legend(panels, patches, note)
    return figure


def window_of(data: xr.Dataset, cells: np.ndarray) -> Float[np.ndarray, "axis end"]:
    """Return the range of each axis with basins, without their tails, slightly widened; or all."""
    whole = np.stack([data["lower"].values, data["upper"].values], axis=1)
    index = np.nonzero(cells >= 0)
    if len(index[0]) == 0:
        return whole
    names = data["axis"].values.tolist()
    places = [data[name].values[one] for name, one in zip(names, index, strict=True)]
    ends = np.quantile(places, (TAILS, 1 - TAILS), axis=1).T
    least = np.ptp(whole, axis=1, keepdims=True) / 100
    return np.clip(layout.widened(ends, MARGIN, least), whole[:, :1], whole[:, 1:])


def draw_surface(
    figure: Figure, data: xr.Dataset, cells: np.ndarray, large: list[int], window: np.ndarray
) -> None:
    """Draw the outermost cells of basins as squares, in the light that their surface reflects."""
    from scipy.ndimage import binary_erosion, gaussian_filter

    ax: Any = figure.add_subplot(2, 2, 4, projection="3d", proj_type="ortho")
    walks: Any = cells >= 0
    names = data["axis"].values.tolist()
    ax.set_title("Surface" if walks.any() else "No basin of attraction", **TITLE)
    for axis, ends, name in zip("xyz", window, names, strict=True):
        ax.set(**{f"{axis}lim": ends, f"{axis}label": text.SYMBOLS.get(name, name)})
        ax.locator_params(axis=axis, nbins=5)
    outer = walks & (binary_erosion(walks) == 0)
    index = np.nonzero(outer)
    places = np.array([data[name].values[one] for name, one in zip(names, index, strict=True)])
    inside = ((places >= window[:, :1]) & (places <= window[:, 1:])).all(axis=0)
    slopes: Any = np.gradient(gaussian_filter(walks.astype(float), 1))
    normal = np.stack(slopes)[:, outer]
    normal /= np.maximum(np.linalg.norm(normal, axis=0), 1e-12)
    light = AMBIENT + (1 - AMBIENT) * np.abs(LIGHT @ normal)
    palette = np.array([to_rgb(one) for one in (*BASINS[: len(large)], OTHERS)])
    kind = np.full(data.sizes["number"], len(large))
    kind[large] = np.arange(len(large))
    colours = (PALE + (1 - PALE) * palette[kind[cells[outer]]]) * light[:, None]
    shown = max(np.ptp(one[inside]) for one in index) if inside.any() else 1
    size = (150 / (1 + shown)) ** 2  # of a square as large as a cell, in points squared
    look: Any = {"marker": "s", "linewidths": 0, "depthshade": False, "s": size}
    ax.scatter(*places[:, inside], c=colours[inside], **look)
