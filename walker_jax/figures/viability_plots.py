"""Pictures of the viability kernel, and of the nested sets within it."""

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, to_hex

from walker_jax.basins.cell_classes import total_area
from walker_jax.basins.volumes import grid_of
from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.figures import regions
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish
from walker_jax.figures.style import INK
from walker_jax.figures.text import coordinate_value, count_noun, walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

SHARES = ListedColormap(colormaps["cividis_r"](np.linspace(0.2, 1, 256)))
"""Colours of shares of safe actions, darker for more; also readable in grey."""
BOUNDS = {
    "target": ("target", "white", 2.2, "-"),
    "inner": ("inner bound", INK, 0.9, "-"),
    "outer": ("outer bound", INK, 0.9, ":"),
}
"""Boundaries: words, colour, width and kind of their lines."""
MOST_STRIDES = 3
"""Fewest strides with one colour for them and all higher numbers."""
COLOURS = [to_hex(one) for one in colormaps["cividis"]([0.0, 0.45, 0.7, 0.88, 1.0])] + ["#f4f4f4"]
"""Colours, dark to light: the target, cells 1, 2 and more strides from it, viable cells that do not
lead there, and all others."""
LINES = [("#d55e00", 1.3, "-"), (INK, 1.0, (0, (4, 1.5))), ("#56b4e9", 1.2, (0, (1, 1.2)))]
"""Colours, widths and kinds of the lines around basins, in turn."""


def viability(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw what `walker_jax.viable` returns: the viability kernel, and the failures around it.

    The first dimension is drawn along the x axis; of three, the slice in the middle is drawn.
    Viable cells are shaded by the share of actions that keep them viable. Other cells have the
    colour of the failure that no choice of actions prevents. Lines are the target's boundary and
    the bounds of the kernel.
    """
    ax = begin(ax, style, data, "viability")
    data, place = middle_plane(data)
    kernel, actions = data["viable"].values, data.sizes["action_number"]
    failing = regions.with_failures([], data, data["failure"].values)
    image = regions.paint(failing, kernel.shape)
    share = data["safe_actions"].values / actions
    scale = ScalarMappable(Normalize(0, max(share.max(), 1 / actions)), SHARES)
    image[kernel] = scale.to_rgba(share[kernel], bytes=True)[:, :3]
    regions.show_image(ax, image, data["viable"])
    drawn = {"target": data["capture"].values == 0}
    drawn |= {name: data[name].values for name in ("inner", "outer") if name in data}
    for name, cells in drawn.items():
        draw_boundary(ax, BOUNDS[name], data, cells)
    bar, patches = (scale, "share of safe actions"), map(regions.patch_of, failing)
    note, (x, y) = viability_note(data) + place, map(str, data["viable"].dims)
    return finish(ax, style, walker_title(data), note, x=x, y=y, legend=patches, bar=bar)


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

    - `data`: what `walker_jax.viable` returns, drawn as by `viability`.
    - `basins`: up to three data sets of `walker_jax.basin` on the same grid, by name, such as those
      of walkers with feedback or with a `Policy`.
    """
    ax = begin(ax, style, data, "viability")
    plane, place = middle_plane(data)
    around = checked_basins(data, {} if basins is None else basins)
    x, y = map(str, plane["viable"].dims)
    found = [
        regions.Region(cells, colour, "", words)
        for cells, colour, words in zip(capture_sets(plane), COLOURS, set_names(data), strict=True)
        if words
    ]
    regions.show_image(ax, regions.paint(found, plane["viable"].shape), plane["viable"])
    for (words, basin), look in zip(around.items(), LINES, strict=False):
        cells, _ = middle_plane(basin, "attractor")
        named = f"{words}: {total_area(basin):.3g}", *look
        draw_boundary(ax, named, plane, cells["attractor"].values >= 0)
    note, patches = actions_in_words(data) + place, map(regions.patch_of, found)
    return finish(ax, style, walker_title(data), note, x=x, y=y, legend=patches)


def capture_sets(data: xr.Dataset) -> list[Bool[np.ndarray, "*shape"]]:
    """Return the cells of the target, of each number of strides, viable ones, and all others."""
    capture, viable = data["capture"].values, data["viable"].values
    sets = [capture == n for n in range(MOST_STRIDES)]
    return [*sets, capture >= MOST_STRIDES, viable & (capture < 0), ~viable & (capture < 0)]


def set_names(data: xr.Dataset) -> list[str]:
    """Name each set with its area, those before included; empty for a set without cells."""
    most, cell = int(data["capture"].max()), grid_of(data).cell_area
    strides = [count_noun(n, "stride") for n in range(1, MOST_STRIDES)]
    names = ["target", *strides, f"up to {count_noun(most, 'stride')}", "viable"]
    *sets, _ = capture_sets(data)
    counts = np.cumsum([cells.sum() for cells in sets])
    counts[-1] = data["viable"].values.sum()  # cells of the target need not be viable
    found = zip(names, counts * cell, sets, strict=True)
    words = [f"{name}: {area:.3g}" if cells.any() else "" for name, area, cells in found]
    return [*words, "bound to fail"]


def checked_basins(data: xr.Dataset, basins: Mapping[str, xr.Dataset]) -> Mapping[str, xr.Dataset]:
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


def middle_plane(data: xr.Dataset, name: str = "viable") -> tuple[xr.Dataset, str]:
    """Return the plane of a data set that is drawn, and its place among three axes."""
    shown = data[name]
    if shown.ndim not in (2, 3) or min(shown.shape[:2]) < 2:
        sizes = dict(shown.sizes)
        raise WrongUse(f"data must be {name} over 2 x 2 cells or more, not over {sizes}")
    if shown.ndim == 2:
        return data, ""
    depth, middle = str(shown.dims[2]), shown.shape[2] // 2
    place = f"; slice at {coordinate_value(depth, float(data[depth][middle]))}"
    return data.isel({depth: middle}), place


def draw_boundary(
    ax: Axes, line: tuple[str, str, float, Any], data: xr.Dataset, cells: Bool[np.ndarray, "nx ny"]
) -> None:
    """Draw the line around a set of cells of a plane, if it has any."""
    words, colour, width, kind = line
    if not cells.any():
        return
    look: Any = {"colors": [colour], "linewidths": [width], "linestyles": [kind]}
    if not cells.all():
        ax.contour(*(data[one] for one in data["viable"].dims), cells.T, levels=[0.5], **look)
    on_white = "0.6" if colour == "white" else colour
    ax.plot([], [], label=words, color=on_white, lw=width, ls=kind)


def viability_note(data: xr.Dataset) -> str:
    """Return the actions and the areas, in words."""
    area, target = data.attrs["area"], data.attrs["target_area"]
    words = f"{actions_in_words(data)}: viable {area:.4g}"
    if "inner_area" in data.attrs:
        cut = data.sizes.get("level", 1) - 1
        words += f" ({data.attrs['inner_area']:.4g} to {data.attrs['outer_area']:.4g}"
        words += f", {count_noun(cut, 'level')} of finer cells)" if cut else ")"
    return f"{words}, target {target:.4g}"


def actions_in_words(data: xr.Dataset) -> str:
    """Return the number of actions, and their ranges, in words."""
    ranges = [
        f"{name.replace('_', ' ')} from {data[name].min():g} to {data[name].max():g}"
        for name in names_in(data, "actions")
    ]
    return f"{data.sizes['action_number']} actions, {' and '.join(ranges)}"
