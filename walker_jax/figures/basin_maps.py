"""Pictures of basins of attraction."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from walker_jax.checks import WrongUse
from walker_jax.figures.branch_plots import GAITS
from walker_jax.figures.curves import cascade, draw_curve, refined
from walker_jax.figures.labels import draw_label, keep_clear
from walker_jax.figures.regions import (
    Region,
    attractor_name,
    entry,
    failures,
    notable_attractors,
    painted,
    regions_of,
    show,
    slices_of,
)
from walker_jax.figures.style import (
    AREA,
    ASTRAY,
    AXIS_LABELS,
    BASINS,
    BELOW,
    HIGHEST,
    INK,
    LINE,
    MARKERS,
    MEASURES,
    SOLID,
    SYMBOLS,
    TITLE,
    WORDS,
    along,
    area_of_basin,
    check,
    drawn,
    ends,
    listed,
    named,
    place_legend,
    subtitle,
    title,
    valued,
    write_title,
)
from walker_jax.walking.outcomes import Outcome

PANELS = 6
"""Slices in a picture of a basin of three dimensions, at most."""


def basin(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The basin of attraction and the ways to fall around it, over a grid of two dimensions.

    Figures 2 (plain axes) and 4 (sheared ones) of Schwab and Wisse (2001). Each fate has a pale
    colour and each basin a dark one. The basins of a few cells share a colour, and so do artefacts
    of cell mapping. A region is labelled where there is room in it, and in the legend otherwise,
    with the number of its cells. Dots are the attractors of the large basins.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns. The first dimension is drawn along the x axis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.

    **Returns** the axes. Raises `ValueError` for a data set that is not of two dimensions, with
    two cells or more along each.
    """
    if "fate" not in data or data["fate"].ndim != 2 or min(data["fate"].shape) < 2:
        dimensions = dict(data["fate"].sizes) if "fate" in data else "no fate"
        instead = slices_of(data)
        raise WrongUse(f"data must have a fate over 2 x 2 cells or more, not {dimensions}{instead}")
    data = data.assign_coords(coordinate=data.attrs["section"])
    fate = data["fate"]
    if ax is None:
        ax = Figure(figsize=(7, 5.4), layout="constrained").add_subplot()

    notable = notable_attractors(data)
    regions = regions_of(data, notable)
    image = painted(regions, fate.shape)
    x, y = map(str, fate.dims)
    extent = (*ends(data[x].values), *ends(data[y].values))
    show(ax, image, extent)

    free, share = np.ones(fate.shape, bool), drawn(data)
    marks, patches = [], []
    for number, marker in zip(notable, MARKERS, strict=False):
        cycle = data["states"].sel(number=number).dropna("phase")
        dots = np.column_stack([along(cycle, x), along(cycle, y)])
        inside = (dots >= extent[::2]) & (dots <= extent[1::2])
        name = attractor_name(int(data["period"].sel(number=number)), cycle)
        marks += ax.plot(
            *dots.T,
            marker,
            color=INK,
            markeredgecolor="white",
            markeredgewidth=1.2,
            markersize=7.5,
            label=name if inside.all(axis=1).any() else f"{name} (not in the picture)",
        )
        keep_clear(free, dots, extent)
    for region in regions:
        if not draw_label(ax, region, free, extent) or region.counted:
            patches.append(Patch(fc=region.colour, ec=INK, lw=0.5, label=entry(region, share)))
    place_legend(ax, marks, BELOW, columns=1)
    place_legend(ax, patches, BELOW + LINE * len(marks), columns=2)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    note, name = subtitle(data), title(data)
    size, pad = (10.5 if "\n" in name else 12), 22 + 12 * note.count("\n")
    ax.set_title(name, loc="left", fontsize=size, fontweight="bold", pad=pad)
    ax.annotate(note, (0, 1), (0, 7), "axes fraction", "offset points", fontsize=9.5)
    return ax


def basin_slices(data: xr.Dataset) -> Figure:
    """The basin of attraction over a grid of three dimensions, in slices across the last.

    Colours as in `basin`. Attractors are drawn in the slice that is nearest to them.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns.

    **Returns** a figure of up to six panels, evenly spaced. Raises `ValueError` for a data set that
    is not of three dimensions, with two cells or more along the first two.
    """
    if "fate" not in data or data["fate"].ndim != 3 or min(data["fate"].shape[:2]) < 2:
        dimensions = dict(data["fate"].sizes) if "fate" in data else "no fate"
        raise WrongUse(f"data must have a fate over 2 x 2 x 1 cells or more, not {dimensions}")
    data = data.assign_coords(coordinate=data.attrs["section"])
    fate = data["fate"]
    x, y, z = map(str, fate.dims)
    depths = data[z].values
    panels = min(PANELS, len(depths))
    chosen = np.round(np.linspace(0, len(depths) - 1, panels + 2)[1:-1]).astype(int)
    chosen = np.unique(chosen) if len(depths) > panels else np.arange(len(depths))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(3.1 * columns + 0.6, 2.7 * rows + 1.5), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)

    notable = notable_attractors(data)
    regions = regions_of(data, notable)
    image = painted(regions, fate.shape)
    extent = (*ends(data[x].values), *ends(data[y].values))
    marks: dict[str, Any] = {}
    for ax, index in zip(grid.flat, chosen, strict=False):
        show(ax, image[:, :, index], extent)
        symbol = SYMBOLS.get(z, z)
        ax.set_title(f"{symbol} = {depths[index]:.4g}".replace("-", "−"), fontsize=10)
    for number, marker in zip(notable, MARKERS, strict=False):
        cycle = data["states"].sel(number=number).dropna("phase")
        name = attractor_name(int(data["period"].sel(number=number)), cycle)
        places = (along(cycle, axis) for axis in (x, y, z))
        for at_x, at_y, at_z in zip(*places, strict=True):
            ax = grid.flat[int(np.abs(depths[chosen] - at_z).argmin())]
            (marks[name],) = ax.plot(
                *(at_x, at_y, marker), color=INK, mec="white", mew=1.2, ms=7, label=name
            )
    for ax in grid.flat[len(chosen) :]:
        ax.set_visible(False)
    grid[0, 0].set(xlim=extent[:2], ylim=extent[2:])
    for index in range(columns):
        grid[-1, index].set_xlabel(AXIS_LABELS.get(x, x), fontsize=WORDS)
    for ax in grid[:, 0]:
        ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=WORDS)
    share = drawn(data)
    patches = [Patch(fc=r.colour, ec=INK, lw=0.5, label=entry(r, share)) for r in regions]
    above = f"{title(data, 34 * columns)}\n{subtitle(data)}"
    figure.suptitle(above, x=0.01, ha="left", fontsize=10.5)
    figure.legend(
        handles=[*marks.values(), *patches],
        loc="outside lower left",
        ncols=2,
        frameon=False,
        fontsize=WORDS,
    )
    return figure


def basins_in_a_row(data: xr.Dataset) -> Figure:
    """Basins of attraction at several slopes, side by side, with colours as in `basin`.

    Figure 7 of Schwab and Wisse (2001).

    **Arguments:**

    - `data`: `fate` and `attractor` over `slope` and two axes of the section, and over `slope` the
      `area` of all basins.

    **Returns** the figure, of three panels in a row.
    """
    slopes, (x, y) = data["slope"].values.tolist(), map(str, data["fate"].dims[1:])
    rows = -(-len(slopes) // 3)
    figure = Figure(figsize=(10, 3 * rows + 0.9), layout="constrained")
    panels = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    fate, attractor = data["fate"].values, data["attractor"].values
    walks = fate == Outcome.STRIDE
    found = [
        Region(walks & (attractor >= 0), BASINS[0], "A", "basin of attraction"),
        Region(walks & (attractor < 0), ASTRAY, "", "walks on, near no attractor"),
        *failures(fate),
    ]
    regions = [region for region in found if region.cells.any()]
    extent = (*ends(data[x].values), *ends(data[y].values))
    image = painted(regions, fate.shape)
    for k, ax in enumerate(panels.flat):
        if k >= len(slopes):
            ax.set_visible(False)
            continue
        show(ax, image[k], extent)
        area = float(data["area"][k])
        note = area_of_basin(area) if area else "no basin of attraction"
        ax.set_title(f"slope {slopes[k]:g} rad", **TITLE | {"fontsize": 10, "pad": 16})
        ax.annotate(note, (0, 1), (0, 5), "axes fraction", "offset points", fontsize=8)
    for ax in panels[-1]:
        ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=WORDS)
    for ax in panels[:, 0]:
        ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=WORDS)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    figure.legend(handles=patches, loc="outside lower left", ncols=3, frameon=False, fontsize=WORDS)
    return figure


def stability_and_area(gaits: xr.Dataset, sizes: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Modulus of the largest multiplier of the gait, and area of the basin, against the slope.

    Figure 8 of Schwab and Wisse (2001).

    **Arguments:**

    - `gaits`: what `walker_jax.bifurcation_diagram` returns, over the slope.
    - `sizes`: over `slope`, the `mapped_area` by cell mapping, and the `area` by refinement, NaN
      where it is not known.
    - `ax`: where to draw; by default, on a new figure of 8 by 4.8 inches.

    **Returns** the axes, of the multiplier; those of the area share it.
    """
    check(gaits, GAITS)
    if ax is None:
        ax = Figure(figsize=(8, 4.8), layout="constrained").add_subplot()
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    colour, slopes = MEASURES["multiplier"][0], sizes["slope"].values
    for curve in map(refined, cascade(gaits)[:1]):
        draw_curve(ax, curve, np.abs(curve.multipliers).max(axis=1, keepdims=True))
    ax.set(xlim=(0, 1.02 * slopes.max()), ylim=(0, HIGHEST))
    ax.set_xlabel(AXIS_LABELS["slope"], fontsize=11)
    ax.set_ylabel("modulus of the largest multiplier", fontsize=11)
    other = ax.twinx()
    areas = other.plot(
        slopes, sizes["mapped_area"], "s", color=BASINS[1], ms=5, mfc="none", label="cell mapping"
    )
    known = np.isfinite(sizes["area"].values)
    if known.any():
        areas += other.plot(
            *(slopes[known], sizes["area"].values[known], "-o"),
            color=BASINS[0],
            ms=3,
            label="refined, exact to the width of the line",
        )
    other.set_ylim(0)
    other.set_ylabel(AREA, fontsize=11, color=BASINS[0])
    write_title(ax, "Stability of the gait, and area of its basin", "SimplestWalker")
    line = Line2D([], [], color=colour, **SOLID, label="largest multiplier; dashed: unstable")
    place_legend(ax, [line], BELOW, columns=1)
    for handle in areas:
        handle.set_label(f"area, {handle.get_label()}")
    place_legend(ax, areas, BELOW + LINE, columns=2)
    return ax


def sweep(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The area of the basin over one or two parameters, with its standard error over one.

    **Arguments:**

    - `data`: what `walker_jax.sweep` returns. Of three parameters and more, the others are at their
      first values.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.8 inches.

    **Returns** the axes.
    """
    ax = Figure(figsize=(7, 4.8), layout="constrained").add_subplot() if ax is None else ax
    area, error = data["total_area"], data["total_area_error"]
    others = [str(name) for name in area.dims[2:]]
    at = {name: 0 for name in others}
    area, error = area.isel(at), error.isel(at)
    x = str(area.dims[0])
    ax.set_xlabel(named(x), fontsize=11)
    if area.ndim == 1:
        ax.errorbar(data[x], area, error, fmt="o-", color=BASINS[0], capsize=3)
        ax.set_ylabel(AREA, fontsize=11)
        ax.set_ylim(0, 1.1 * float(area.fillna(0).max()) or None)
    else:
        y = str(area.dims[1])
        image = ax.pcolormesh(data[x], data[y], area.T, cmap="viridis", rasterized=True)
        ax.set_ylabel(named(y), fontsize=11)
        bar = ax.figure.colorbar(image, ax=ax)
        bar.set_label(AREA, fontsize=11)
    held = valued({name: float(data[name][0]) for name in others})
    shape = " × ".join(map(str, data["total_area"].shape))
    failed = int(data["failed"].sum())
    note = listed([f"{shape} basins", *held, *([f"{failed} failed"] if failed else [])], 60)
    write_title(ax, title(data), note)
    return ax
