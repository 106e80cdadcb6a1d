"""The area of the basin over parameters of a walker."""

from typing import Unpack

import xarray as xr
from matplotlib.axes import Axes

from walker_jax.basins.cell_classes import has_known_units
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, figure_of, finish, padded_limits
from walker_jax.figures.style import BASINS
from walker_jax.figures.text import (
    AREA_LABEL,
    VOLUME_LABEL,
    join_phrases,
    parameter_values,
    walker_title,
)
from walker_jax.storage.schema import check_dataset


def sweep(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the area or volume of the basin over one or two parameters; over one, with its error.

    **Arguments:**

    - `data`: what `walker_jax.sweep` returns. Parameters after the second are at their first
      values.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.8 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "sweep")
    ax = axes_for(ax, style, 7, 4.8)
    area, error = data["total_area"], data["total_area_error"]
    others = [str(name) for name in area.dims[2:]]
    first = dict.fromkeys(others, 0)
    area, error = area.isel(first), error.isel(first)
    x = str(area.dims[0])
    words = VOLUME_LABEL if data["fate"].ndim == data["total_area"].ndim + 3 else AREA_LABEL
    words = words if has_known_units(data) else words.partition(" (")[0]
    if area.ndim == 1:
        ax.errorbar(data[x], area, error, fmt="o-", ms=5, color=BASINS[0], capsize=3)
        y, bars = words, []
        ax.set_xlim(padded_limits(data[x].values))
        ax.set_ylim(0, 1.05 * float((area + error.fillna(0)).fillna(0).max()) or None)
    else:
        y = str(area.dims[1])
        image = ax.pcolormesh(data[x], data[y], area.T, cmap="viridis", rasterized=True)
        bar = figure_of(ax).colorbar(image, ax=ax)
        bar.set_label(words)
        bars = [bar.ax]
        if min(area.shape) > 1:  # cells at the ends reach beyond the values
            ax.set(xlim=data[x].values[[0, -1]], ylim=data[y].values[[0, -1]])
    fixed = parameter_values({name: float(data[name][0]) for name in others})
    shape = " × ".join(map(str, data["total_area"].shape))
    failed = int(data["failed"].sum())
    failures = [f"{failed} failed"] if failed else []
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=join_phrases([f"{shape} basins", *fixed, *failures]),
        x=x,
        y=y,
        beside=bars,
    )
