"""Pictures of the viability kernel."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.lines import Line2D

from walker_jax.checks import WrongUse
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, figure_of, finish
from walker_jax.figures.regions import (
    Extent,
    extent_of,
    paint,
    patch_of,
    show_image,
    with_failures,
)
from walker_jax.figures.style import INK
from walker_jax.figures.text import coordinate_value, walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import failures_of, names_in

SHADES = ListedColormap(colormaps["cividis_r"](np.linspace(0.2, 1, 256)))
"""Colours of shares of safe actions, darker for more; also readable in grey."""
LINES = {
    "target": ("target", "white", 2.2, "-"),
    "inner": ("inner bound", INK, 0.9, "-"),
    "outer": ("outer bound", INK, 0.9, ":"),
}
"""Boundaries: words, colour, width and kind of their lines."""


def viability(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the viability kernel over a grid and the failures around it; of three axes, a slice.

    Viable cells are shaded by the share of actions that keep them viable. Other cells have the
    colour of the failure that no choice of actions prevents. Lines are the target's boundary and
    the bounds of the kernel.

    **Arguments:**

    - `data`: what `walker_jax.viable` returns. The first dimension is drawn along the x axis; of
      three dimensions, the slice in the middle is drawn.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set that is not of two or three dimensions,
    with two cells or more along the first two.
    """
    check_dataset(data, "viability")
    data, place = middle_plane(data)
    viable = data["viable"]
    ax = axes_for(ax, style, 7, 5.4)
    x, y = map(str, viable.dims)
    extent = extent_of(data, x, y)
    regions = with_failures([], data["failure"].values, failures_of(data))
    image = paint(regions, viable.shape)
    share = data["safe_actions"].values / data.sizes["action_number"]
    scale = ScalarMappable(Normalize(0, max(share.max(), 1 / data.sizes["action_number"])), SHADES)
    kernel = viable.values
    image[kernel] = scale.to_rgba(share[kernel], bytes=True)[:, :3]
    show_image(ax, image, extent)
    drawn = {"target": data["capture"].values == 0}
    drawn |= {name: data[name].values for name in ("inner", "outer") if name in data}
    marks = [
        mark
        for name, cells in drawn.items()
        for mark in draw_boundary(ax, LINES[name], cells, extent)
    ]
    bar = figure_of(ax).colorbar(scale, ax=ax)
    bar.set_label("share of safe actions")
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=f"{viability_note(data)}{place}",
        x=x,
        y=y,
        legend=[*marks, *map(patch_of, regions)],
        beside=[bar.ax],
    )


def middle_plane(data: xr.Dataset, name: str = "viable") -> tuple[xr.Dataset, str]:
    """Return the plane of a data set that is drawn, and its place among three axes."""
    shown = data[name]
    if shown.ndim not in (2, 3) or min(shown.shape[:2]) < 2:
        raise WrongUse(
            f"data must be {name} over 2 x 2 cells or more, not over {dict(shown.sizes)}"
        )
    if shown.ndim == 2:
        return data, ""
    depth, middle = str(shown.dims[2]), shown.shape[2] // 2
    place = f"; slice at {coordinate_value(depth, float(data[depth][middle]))}"
    return data.isel({depth: middle}), place


def draw_boundary(
    ax: Axes,
    line: tuple[str, str, float, Any],
    cells: Bool[np.ndarray, "nx ny"],
    extent: Extent,
) -> list[Line2D]:
    """Draw the line around a set of cells; return its sign in the legend, none without cells."""
    words, colour, width, kind = line
    if not cells.any():
        return []
    left, right, low, high = extent
    around = np.pad(cells, 1).repeat(2, 0).repeat(2, 1)[1:-1, 1:-1]
    xs = np.linspace(left, right, cells.shape[0] + 1).repeat(2)
    ys = np.linspace(low, high, cells.shape[1] + 1).repeat(2)
    style: Any = {"colors": [colour], "linewidths": [width], "linestyles": [kind]}
    ax.contour(xs, ys, around.T.astype(float), levels=[0.5], **style)
    on_white = "0.6" if colour == "white" else colour
    return [Line2D([], [], label=words, color=on_white, lw=width, ls=kind)]


def viability_note(data: xr.Dataset) -> str:
    """Return the actions and the areas, in words."""
    area, target = data.attrs["area"], data.attrs["target_area"]
    words = f"{actions_in_words(data)}: viable {area:.4g}"
    if "inner_area" in data.attrs:
        cut = data.sizes.get("level", 1) - 1
        words += f" ({data.attrs['inner_area']:.4g} to {data.attrs['outer_area']:.4g}"
        words += f", {cut} level{'s' * (cut > 1)} of finer cells)" if cut else ")"
    return f"{words}, target {target:.4g}"


def actions_in_words(data: xr.Dataset) -> str:
    """Return the number of actions, and their ranges, in words."""
    ranges = [
        f"{name.replace('_', ' ')} from {data[name].min():g} to {data[name].max():g}"
        for name in names_in(data, "actions")
    ]
    return f"{data.sizes['action_number']} actions, {' and '.join(ranges)}"
