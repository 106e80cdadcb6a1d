"""The stability of a gait and the area of its basin, over the slope."""

from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from walker_jax.figures.branch_plots import HIGHEST, draw_multiplier
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import BASINS, INK, SOLID
from walker_jax.figures.text import AREA_LABEL, RADIUS
from walker_jax.gaits.curves import cascade_curves
from walker_jax.storage.schema import check_dataset


def stability_and_area(
    gaits: xr.Dataset, areas: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the gait's largest multiplier and the area of the basin against the slope.

    Figure 8 of Schwab and Wisse (2001).

    **Arguments:**

    - `gaits`: what `walker_jax.bifurcation_diagram` returns, over the slope.
    - `areas`: of the kind "areas over slopes".
    - `ax`: where to draw; by default, on a new figure of 8 by 4.8 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes of the multiplier, which share their place with those of the area. Raises
    `ValueError` for other data sets.
    """
    check_dataset(gaits, "gait branches")
    check_dataset(areas, "areas over slopes")
    ax = axes_for(ax, style, 8, 4.8)
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    slopes = areas["slope"].values
    for curve in cascade_curves(gaits)[:1]:
        draw_multiplier(ax, curve)
    ax.set(xlim=(0, 1.02 * slopes.max()), ylim=(0, HIGHEST))
    other = ax.twinx()
    known = np.isfinite(areas["area"].values)
    points = other.plot(
        *(slopes, areas["mapped_area"], "s"),
        color=BASINS[1],
        ms=5,
        mfc="none",
        label="area, cell mapping",
    )
    if known.any():
        points += other.plot(
            *(slopes[known], areas["area"].values[known], "-o"),
            color=BASINS[0],
            ms=3,
            label="area, refined (error below the width of the line)",
        )
    other.set_ylim(0)
    other.set_ylabel(AREA_LABEL, color=BASINS[0])
    line = Line2D([], [], color=INK, **SOLID, label=f"{RADIUS}; dashed: unstable")
    return finish(
        ax,
        style,
        title="Stability of the gait, and area of its basin",
        note="SimplestWalker",
        x="slope",
        y=RADIUS,
        legend=[line, *points],
        beside=[other],
    )
