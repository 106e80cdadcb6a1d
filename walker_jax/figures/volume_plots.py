"""Pictures of basins of attraction in three dimensions."""

from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from walker_jax.basins.volumes import slice_basin
from walker_jax.figures.layout import figure_legend, figure_title, finish, new_figure
from walker_jax.figures.regions import (
    attractor_mark,
    attractor_name,
    cycle_of,
    extent_of,
    paint,
    patch_of,
    place_states,
    regions_of,
    show_image,
)
from walker_jax.figures.style import BASINS, INK, MARKERS, OTHERS, SMALL, TITLE
from walker_jax.figures.text import SYMBOLS, coordinate_value, volume_note, walker_title
from walker_jax.storage.schema import check_dataset

AZIMUTH, ELEVATION = -60.0, 25.0
"""View of the surface (degrees)."""
LIGHT = (-0.5, 0.6, 0.62)
"""Direction of the light: to the right, up, and towards the viewer."""
AMBIENT = 0.4
"""Share of ambient light."""
PALE = 0.25
"""Share of white in the colours of surfaces."""
PIXELS = 900
"""Most pixels of the picture of the surface along each side."""
BLUR = 1.3
"""Pixels over which the surface of cells is smoothed."""
SOLID = 0.5
"""Share of pixels with cells near by from which on a surface is opaque. A part of a basin thinner
than a cell has only scattered cells."""
TAILS = 0.002
"""Largest share of the cells at either end of each axis that may be outside the picture."""
MARGIN = 0.05
"""Margin around the basin, as a share of its extent."""


def volume(data: xr.Dataset) -> Figure:
    """Draw the basin of attraction in three dimensions: slices, and its surface.

    Three slices, each along two axes of the grid, go through the first state of the attractor with
    the largest basin. The fourth picture shows the surface of all basins in parallel projection,
    lit from above. Colours are those of `basin`. All pictures show the part of the grid that has
    basins.

    **Arguments:**

    - `data`: what `walker_jax.refine` returns over three dimensions.

    **Returns** the figure, of 10 by 9 inches. Raises `ValueError` for another data set.
    """
    check_dataset(data, "refined volume")
    sizes, names = data["cells"].values, tuple(data["axis"].values.tolist())
    large = [i for i in np.argsort(-sizes, kind="stable")[: len(BASINS)].tolist() if sizes[i] > 0]
    places, colours = walking_places(data, large)
    window = window_of(data, places)
    centre = np.mean(window, axis=1)
    if large:
        (centre,) = place_states(data, cycle_of(data, large[0])[:1], names)

    figure = new_figure(10, 9)
    panels = [figure.add_subplot(2, 2, k + 1) for k in range(3)]
    patches, marks = {}, []
    for ax, hidden in zip(panels, (2, 1, 0), strict=True):
        low, high = (float(data[names[hidden]][end]) for end in (0, -1))
        at = float(np.clip(centre[hidden], low, high))
        plane = slice_basin(data, names[hidden], at)
        x, y = (name for name in names if name != names[hidden])
        regions = regions_of(plane, large)
        patches |= {region.words: patch_of(region) for region in regions}
        show_image(ax, paint(regions, plane["fate"].shape), extent_of(plane, x, y))
        marks = [
            attractor_mark(
                ax,
                place_states(data, cycle_of(data, number), (x, y)),
                marker,
                attractor_name(data, int(data["period"][number]), cycle_of(data, number)),
            )
            for number, marker in zip(large, MARKERS, strict=False)
        ]
        ax.set(xlim=window[names.index(x)], ylim=window[names.index(y)])
        at_place = coordinate_value(names[hidden], float(plane[names[hidden]]))
        finish(ax, {}, title=f"Slice at {at_place}", x=x, y=y)
    draw_surface(figure.add_subplot(2, 2, 4), names, window, places, colours)
    figure_title(figure, walker_title(data))
    figure_legend(figure, [*marks, *patches.values()], volume_note(data))
    return figure


def walking_places(
    data: xr.Dataset, large: list[int]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Return the centres of cells that converge, and their colours, by place in `large`."""
    names = data["axis"].values.tolist()
    shape = tuple(data.sizes[name] for name in names)
    first, attractor = data["first_cell"].values, data["run_attractor"].values
    lengths = np.diff(first, append=np.prod(shape))
    walks = attractor >= 0
    begins, lengths = first[walks], lengths[walks]
    offsets = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    index = np.unravel_index(np.repeat(begins, lengths) + offsets, shape)
    places = [data[name].values[place] for name, place in zip(names, index, strict=True)]
    colour = np.full(data.sizes["number"], len(large))
    colour[large] = np.arange(len(large))
    return np.stack(places, axis=1), np.repeat(colour[attractor[walks]], lengths)


def window_of(data: xr.Dataset, places: Float[np.ndarray, "n 3"]) -> list[tuple[float, float]]:
    """Return the range of each axis with basins, without their tails, slightly widened; or all."""
    first, last = data["lower"].values, data["upper"].values
    if len(places) == 0:
        return list(zip(first.tolist(), last.tolist(), strict=True))
    low, high = np.quantile(places, (TAILS, 1 - TAILS), axis=0)
    beyond = MARGIN * (high - low) + (last - first) / 100
    low, high = np.maximum(low - beyond, first), np.minimum(high + beyond, last)
    return list(zip(low.tolist(), high.tolist(), strict=True))


def draw_surface(
    ax: Axes,
    names: tuple[str, ...],
    window: list[tuple[float, float]],
    places: Float[np.ndarray, "n 3"],
    colours: Int[np.ndarray, " n"],
) -> None:
    """Draw the surface of cells in parallel projection, and the edges of the window around it."""
    low, high = np.array(window).T
    view = rotation(AZIMUTH, ELEVATION)
    project = lambda at: (2 * (at - low) / (high - low) - 1) @ view.T
    ax.set(xlim=(-1.75, 1.75), ylim=(-1.7, 1.6), aspect="equal")
    ax.set_title("Surface" if len(places) else "No basin of attraction", **TITLE)
    ax.set_axis_off()
    if len(places) == 0:
        return
    inside = ((places >= low) & (places <= high)).all(axis=1)
    places, colours = places[inside], colours[inside]
    seen = project(places)
    # A pixel is at least as large as a cell's shadow, so that the surface has no holes.
    apart = [np.diff(np.unique(places[:, k])).min(initial=np.inf) for k in range(3)]
    step = 2 * np.array([min(a, b) for a, b in zip(apart, high - low, strict=True)]) / (high - low)
    pixel = max(2 * np.sqrt(3) / PIXELS, 1.3 * float(np.linalg.norm(step)) / np.sqrt(3))
    reach = float(np.sqrt(3)) * 1.02
    count = int(2 * reach / pixel)
    index = ((seen[:, :2] + reach) / pixel).astype(int)
    order = np.argsort(seen[:, 2], kind="stable")  # the nearest last
    depth = np.full((count, count), np.nan)
    colour = np.zeros((count, count), int)
    column, row = index[order].T
    depth[row, column], colour[row, column] = seen[order, 2], colours[order]
    image = shade(depth / pixel, colour)
    extent = (-reach, reach, -reach, reach)
    draw_box(ax, project, low, high, behind=True)
    ax.imshow(image, origin="lower", extent=extent, interpolation="antialiased", zorder=2)
    draw_box(ax, project, low, high, behind=False)
    name_edges(ax, names, project, low, high)
    ax.set(xlim=(-1.75, 1.75), ylim=(-1.7, 1.6), aspect="equal")


def rotation(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Return the directions to the right, up, and towards the viewer, in space, as rows."""
    a, e = np.radians([azimuth, elevation])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    viewer = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return np.stack([right, np.cross(viewer, right), viewer])


def shade(
    depth: Float[np.ndarray, "rows columns"], colour: Int[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "rows columns 4"]:
    """Compute the light that a surface reflects (Lambert), in its colours; clear outside it."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    there = np.isfinite(depth)
    weight = gaussian_filter(there.astype(float), BLUR)
    seen = weight > SOLID / 4
    smooth = gaussian_filter(np.where(there, depth, 0.0), BLUR) / np.maximum(weight, SOLID / 4)
    up, right = np.gradient(np.where(seen, smooth, np.nan))
    normal = -np.nan_to_num(np.stack([right, up]))
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    length = np.sqrt(1 + (normal**2).sum(axis=0))
    lit = np.clip((light[0] * normal[0] + light[1] * normal[1] + light[2]) / length, 0, 1)
    palette = np.array([to_rgb(one) for one in (*BASINS, OTHERS)])
    nearest: Any = distance_transform_edt(~there, return_distances=False, return_indices=True)
    base = palette[np.minimum(colour, len(BASINS))[tuple(nearest)]]
    base = PALE + (1 - PALE) * base  # dark colours would show no shadows
    bright = (AMBIENT + (1 - AMBIENT) * lit)[..., None]
    clear = np.clip(weight / SOLID, 0, 1)[..., None] * seen[..., None]
    return np.concatenate([np.clip(base * bright, 0, 1), clear], axis=-1)


def draw_box(ax: Axes, project, low: np.ndarray, high: np.ndarray, *, behind: bool) -> None:
    """Draw the edges of a box that are behind its content, or those in front of it."""
    corners = np.array(list(product(*zip(low, high, strict=True))))
    at = project(corners)
    hidden = int(at[:, 2].argmin())
    for i, j in product(range(8), repeat=2):
        if i < j and np.count_nonzero(corners[i] != corners[j]) == 1:
            if (hidden in (i, j)) == behind:
                style = {"color": "#bdbdbd", "lw": 0.8, "zorder": 1 if behind else 3}
                ax.plot(*at[[i, j], :2].T, ls=":" if behind else "-", **style)


def name_edges(
    ax: Axes, names: tuple[str, ...], project, low: np.ndarray, high: np.ndarray
) -> None:
    """Name three edges of a box at its outline, and the values at their ends."""
    for k, name in enumerate(names):
        edges = []
        for ends in product((0, 1), repeat=2):
            corner = np.insert(np.array(ends, float), k, 0.0)
            first = low + corner * (high - low)
            last = first.copy()
            last[k] = high[k]
            edges.append(project(np.stack([first, last]))[:, :2])
        # The outermost edge to the lower left; for the vertical axis, to the left.
        lowest = min(edges, key=lambda edge: edge[:, 0].sum() if k == 2 else edge[:, 1].sum())
        middle, (along, up) = lowest.mean(axis=0), lowest[1] - lowest[0]
        outward = np.array([up, -along]) / np.hypot(along, up)
        outward *= np.sign(outward @ middle)  # the box is around the origin
        words: dict[str, Any] = {"ha": "center", "va": "center", "color": INK}
        x, y = middle + 0.3 * outward
        ax.text(x, y, SYMBOLS.get(name, name), fontsize="medium", **words)
        for end, value in zip(lowest, (low[k], high[k]), strict=True):
            x, y = end + 0.17 * outward + 0.25 * (middle - end)
            ax.text(x, y, f"{value:.2f}".replace("-", "−"), fontsize=SMALL, **words)
