"""Pictures of basins of attraction."""

import math
from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from walker_jax.basins.cell_classes import along_axis
from walker_jax.checks import WrongUse
from walker_jax.figures import layout, regions, text
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish, new_panels
from walker_jax.figures.style import INK, TITLE
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

PANELS = 6
"""Most slices in a picture of a basin of three dimensions."""


def basin(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw what `walker_jax.basin` returns over two dimensions: basins, and the ways to fall.

    Figures 2 (plain axes) and 4 (sheared axes) of Schwab and Wisse (2001). The first dimension is
    drawn along the x axis. Each fate has a pale colour and each basin a dark one. Basins of a few
    cells share a colour, and so do artefacts of cell mapping. A region is labelled where it has
    room, and in the legend otherwise, with the number of its cells. Dots are the attractors of the
    large basins.
    """
    ax = begin(ax, style, data, "basin")
    check_plane(data["fate"])
    large, axes = regions.largest(data), regions.axes_of(data)
    found = regions.draw_regions(ax, data, large)
    free, share, patches = np.ones(data["fate"].shape, bool), share_drawn(data), []
    for dots, marker, name in regions.attractors(data, large):
        inside = any(ax.viewLim.contains(*dot) for dot in dots)
        where = "" if inside else " (outside the picture)"
        regions.mark_attractor(ax, dots, marker, name + where)
        regions.keep_clear(ax, free, dots)
    for region in found:
        named = style.get("labels", True) and regions.draw_label(ax, region, free)
        if not named or region.counted:
            patches.append(regions.counted_patch(region, share))
    if "origin" in data.attrs:
        ax.yaxis.get_offset_text().set_x(-0.1)  # put the offset in its usual place
    note = text.basin_note(data) + place_note(data, axes)
    x, y = ("offset of " * bool(middle_of(data, one)) + text.axis_label(one) for one in axes)
    return finish(ax, style, text.walker_title(data), note, x=x, y=y, legend=patches)


def check_plane(fate: xr.DataArray) -> None:
    """Raise `WrongUse` for fates that are not over two dimensions, with two cells along each."""
    if fate.ndim != 2 or min(fate.shape) < 2:
        others = [name for name in fate.dims if name not in ("theta", "thetadot", "sum")]
        hint = ""
        if fate.ndim == 3 and len(others) == 1:
            hint = f": take a slice, data.isel({others[0]}=0), or draw several, basin_slices(data)"
        raise WrongUse(
            f"data must have a fate over 2 x 2 cells or more, not {dict(fate.sizes)}{hint}"
        )


def zoomed_basin(data: xr.Dataset, around: xr.Dataset) -> Figure:
    """Draw a narrow window of a basin, and beside it the basin with the window's place.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns on `Grid.zoom`, over two dimensions.
    - `around`: the same on the whole grid.
    """
    check_dataset(data, "basin")
    if "origin" not in data.attrs:
        raise WrongUse("data must be of a window, as Grid.zoom makes them, and have its origin")
    figure, (left, right) = new_panels(13, 5.8, 1, 2)
    basin(around, left)
    origin = np.asarray(data.attrs["origin"])[None]
    (place,) = regions.place_states(around, origin)
    arrow: Any = {"arrowstyle": "->", "color": INK, "lw": 1.4}
    box = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8}
    left.annotate("window", place, (24, 34), "data", "offset points", arrow, bbox=box)
    basin(data, right, title="Window")
    return figure


def basin_slices(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.basin` returns over three dimensions, in slices across the last.

    Colours are as in `basin`. Up to six slices are evenly spaced. Each attractor is drawn in the
    slice nearest to it.
    """
    check_dataset(data, "basin")
    fate = data["fate"]
    if fate.ndim != 3 or min(fate.shape[:2]) < 2:
        raise WrongUse(
            f"data must have a fate over 2 x 2 x 1 cells or more, not {dict(fate.sizes)}"
        )
    x, y, z = regions.axes_of(data)
    depths = data[z].values
    chosen = np.linspace(0, len(depths), 2 * min(len(depths), PANELS) + 1)[1::2].astype(int)
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    size = 3.1 * columns + 0.6, 2.7 * rows + 1.5
    figure, panels = new_panels(*size, rows, columns, sharex=True, sharey=True)
    large = regions.largest(data)
    found = regions.regions_of(data, large)
    image = regions.paint(found, fate.shape)
    for ax, index in zip(panels, chosen, strict=False):
        regions.show_image(ax, image[:, :, index], fate)
        ax.set_title(text.coordinate_value(z, float(depths[index])), fontsize="medium")
    for dots, marker, name in regions.attractors(data, large):
        for place in dots:
            ax = panels[int(np.abs(depths[chosen] - place[2]).argmin())]
            regions.mark_attractor(ax, place[None, :2], marker, name)
    layout.name_outer_axes(panels, len(chosen), x, y)
    patches = [regions.counted_patch(region, share_drawn(data)) for region in found]
    layout.figure_title(figure, text.walker_title(data))
    layout.figure_legend(panels, patches, text.basin_note(data))
    return figure


def basins_in_a_row(data: xr.Dataset) -> Figure:
    """Draw basins of attraction at several slopes, side by side, with colours as in `basin`.

    Figure 7 of Schwab and Wisse (2001). `data` is of the kind "basins over slopes", over two axes
    of the section.
    """
    check_dataset(data, "basins over slopes")
    slopes, (_, x, y) = data["slope"].values.tolist(), regions.axes_of(data)
    rows = -(-len(slopes) // 3)
    figure, panels = new_panels(10, 3 * rows + 0.9, rows, 3, sharex=True, sharey=True)
    basin = data["attractor"].values >= 0
    found, images = regions.paint_one_basin(data, data["fate"].values, basin)
    areas = data["area"].values.tolist()
    for ax, slope, cells, area in zip(panels, slopes, images, areas, strict=False):
        regions.show_image(ax, cells, data["fate"][0])
        ax.set_title(f"slope {slope:g} rad", **TITLE, fontsize="medium", pad=16)
        note = text.area_phrase(data, area) if area > 0 else "no basin of attraction"
        layout.write_beside(ax, note, (0, 1), (0, 5), xycoords="axes fraction")
    layout.name_outer_axes(panels, len(slopes), x, y)
    layout.figure_legend(panels, map(regions.patch_of, found))
    return figure


def thin(data: xr.Dataset, most: int = 2000) -> xr.Dataset:
    """Return at most `most` rows and columns of a large basin: enough for a picture."""
    over = {dim: -(-size // most) for dim, size in data["fate"].sizes.items()}
    thinned = data.isel({dim: slice(step // 2, None, step) for dim, step in over.items()})
    whole = data.attrs.get("shape", list(data["fate"].shape))  # it may be thinned already
    return thinned.assign_attrs(shape=whole, thinned=share_drawn(data) * math.prod(over.values()))


def place_note(data: xr.Dataset, axes: tuple[str, ...]) -> str:
    """Return a line with the middle of the picture, to all digits, if its axes have offsets."""
    middle = {axis: middle_of(data, axis) for axis in axes}
    if not any(middle.values()):
        return ""
    values = [text.coordinate_value(axis, value, ".17g") for axis, value in middle.items()]
    return f"\naround {', '.join(values)}"


def middle_of(data: xr.Dataset, axis: str) -> float:
    """Return the value from which offsets along an axis are measured; 0 if it has none."""
    if "origin" not in data.attrs:
        return 0.0
    origin = np.asarray(data.attrs["origin"])[None]
    return float(along_axis(origin, names_in(data, "section"), axis).item())


def share_drawn(data: xr.Dataset) -> int:
    """Return the number of cells of the whole basin that each cell of the data stands for."""
    return int(data.attrs.get("thinned", 1))
