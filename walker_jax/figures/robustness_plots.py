"""Pictures of robustness."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.basins.cell_classes import has_known_units, large_basins
from walker_jax.checks import WrongUse
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.layout import (
    DrawnAxes,
    Style,
    axes_for,
    figure_title,
    finish,
    new_figure,
    padded_limits,
)
from walker_jax.figures.regions import (
    attractor_name,
    extent_of,
    paint,
    patch_of,
    place_states,
    regions_of,
    show_image,
)
from walker_jax.figures.style import BASINS, INK, SMALL, failure_words
from walker_jax.figures.text import AREA_LABEL, RADIUS, count_noun, walker_title
from walker_jax.stability.nearest_starts import (
    NearestStart,
    circle,
    has_plane_disturbance,
    nearest_starts,
)
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, failures_of

WINDOW = 1.25
"""Half the width of the picture of the least disturbance, relative to the width of its curve."""
MEASURES = {
    "total_area": (BASINS[0], "-o", "area of the basin"),
    "least_disturbance": (BASINS[1], "-s", "least disturbance"),
    "multiplier": (INK, "-^", RADIUS),
}
"""Colour, line and words of each measure of robustness."""


def disturbance(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the basin near its gait, and the nearest start from which the walker does not return.

    The walker returns from all starts inside the solid curve. If the nearest start converges to
    another attractor, the nearest one that falls is marked too: none inside the dashed curve falls.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns, over two dimensions, with a gait.
    - `ax`: where to draw; by default, on a new figure of 5.4 by 5.4 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "robustness")
    if not has_plane_disturbance(data):
        raise WrongUse("data must hold the least disturbance of a gait, over two dimensions")
    ax = axes_for(ax, style, 5.4, 5.4)
    axes = x, y = str(data["fate"].dims[0]), str(data["fate"].dims[1])
    starts = nearest_starts(data)
    curves = [place_states(data, circle(one.gait_state, one.distance), axes) for one in starts]
    low, high = np.min(curves, axis=(0, 1)), np.max(curves, axis=(0, 1))
    middle, width = (low + high) / 2, high - low
    limits = np.stack([middle - WINDOW * width, middle + WINDOW * width], axis=1)
    window = {}
    for name, ends in zip(axes, limits, strict=True):
        first, last = np.searchsorted(data[name].values, ends)
        window[name] = slice(max(0, first - 2), last + 2)  # some cells, however large they are
    near = data.isel(window)
    regions = regions_of(near, large_basins(data, len(BASINS)))
    show_image(ax, paint(regions, near["fate"].shape), extent_of(near, x, y))
    for curve, line in zip(curves, ("-", "--"), strict=False):
        ax.plot(*curve.T, line, color="white", lw=1.6)
    gait = data["gait_state"].values
    name = attractor_name(data, int(data["gait_period"]), gait[None])
    signs = [(gait, "o", name)]
    signs += [
        (one.state, sign, start_phrase(one, data)) for one, sign in zip(starts, "XP", strict=False)
    ]
    marks = []
    look: dict[str, Any] = {"ls": "", "mec": "white", "color": INK, "zorder": 3}
    for state, sign, words in signs:
        size = 7.5 if sign == "o" else 10
        marks += ax.plot(
            *place_states(data, state[None], axes).T, sign, ms=size, label=words, **look
        )
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.locator_params(nbins=6)
    return finish(
        ax,
        style,
        title="Least disturbance",
        note=distance_phrase(starts),
        x=x,
        y=y,
        legend=[*marks, *map(patch_of, regions)],
    )


def distance_phrase(starts: list[NearestStart]) -> str:
    """Return the distances of the nearest starts from the gait, in words."""
    nearest, *fall = starts
    if fall:
        farther = f"{fall[0].distance:.4g} to a failure"
        return f"from the gait {nearest.distance:.4g} to another attractor, {farther}"
    elsewhere = nearest.outcome == Outcome.STRIDE
    end = "start that does not return" if elsewhere else "failure"
    return f"{nearest.distance:.4g}, from the gait to the nearest {end}"


def start_phrase(start: NearestStart, data: xr.Dataset) -> str:
    """Return the legend of the nearest start that does not return."""
    if start.outcome == Outcome.STRIDE:
        return "nearest start that converges to another attractor"
    fails = failure_words(start.outcome, failures_of(data))
    strides = count_noun(start.strides, "stride")
    return f"nearest start that {fails} after {strides}"


def robustness(data: xr.Dataset) -> Figure:
    """Draw the basin of a gait, and beside it its least disturbance if it is in the same plane.

    The pictures are `basin` and `disturbance`.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns.

    **Returns** the figure, of 13 by 5.8 inches. Raises `ValueError` as these do.
    """
    check_dataset(data, "basin")
    both = has_plane_disturbance(data)
    figure = new_figure(13 if both else 7, 5.8)
    axes = figure.subplots(1, 2 if both else 1, squeeze=False)[0]
    basin(data, axes[0])
    if both:
        disturbance(data, axes[1])
    return figure


def robustness_measures(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw area of the basin, least disturbance and largest multiplier against a parameter.

    Figure 8 of Schwab and Wisse (2001), with the least disturbance added. Area and disturbance are
    shares of their largest values; the multiplier is drawn as it is. Where one grows, the others
    need not shrink.

    **Arguments:**

    - `data`: what `walker_jax.robustness` over values returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    values, parameter = table_axis(data)
    ax = axes_for(ax, style, 7, 4.6)
    handles: list[Line2D] = []
    for name in ("total_area", "least_disturbance"):
        largest = largest_of(data[name])
        handles += draw_measure(ax, data, name, largest or 1)
        handles[-1].set_label(f"{handles[-1].get_label()} (largest {largest:.4g})")
    draw_band(ax, data, largest_of(data["total_area"]) or 1)
    handles += draw_falls(ax, data, largest_of(data["least_disturbance"]) or 1)
    handles += draw_measure(ax, data, "multiplier")
    ax.set(xlim=padded_limits(values), ylim=(0, 1.05 * max(1, np.nanmax(ax.dataLim.y1))))
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: robustness",
        note="band: twice the standard error of the area; multiplier of the attracting gait",
        x=parameter,
        y="relative to the maximum; multiplier",
        legend=handles,
    )


def boundary_dimension(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the dimension of the boundary of the basin against a parameter, with its interval.

    It is 1 where the boundary is smooth, and larger where it is fractal.

    **Arguments** and errors are those of `robustness_measures`.
    """
    values, parameter = table_axis(data)
    ax = axes_for(ax, style, 7, 4.6)
    low, middle, high = (data[f"dimension{end}"].values for end in ("_low", "", "_high"))
    ax.fill_between(values, low, high, color=BASINS[0], alpha=0.25, lw=0)
    ax.plot(values, middle, "o-", color=BASINS[0], markersize=4)
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    top = np.nanmax([1.2, *high])
    ax.set(xlim=padded_limits(values), ylim=(0.9, 1.05 * top))
    return finish(
        ax,
        style,
        title="Dimension of the basin's boundary",
        note="by the uncertainty exponent, with its 95\u00a0% interval",
        x=parameter,
        y="dimension",
    )


def robustness_table(data: xr.Dataset) -> Figure:
    """Draw area, least disturbance, largest multiplier and boundary dimension, a panel each.

    The last is the picture `boundary_dimension`. The band around the area is twice its standard
    error. Where the nearest start that does not return converges to another attractor, the nearest
    one that falls is drawn too.

    **Arguments:**

    - `data`: what `walker_jax.robustness` over values returns.

    **Returns** the figure, of 13 by 8.4 inches. Raises `ValueError` for another data set.
    """
    values, parameter = table_axis(data)
    figure = new_figure(13, 8.4)
    axes = figure.subplots(2, 2)
    known = has_known_units(data)
    units = " (rad, time in √(l/g))" * known
    names = AREA_LABEL if known else MEASURES["total_area"][2], MEASURES["least_disturbance"][2]
    words: dict[str, tuple[str, str, str]] = {
        "total_area": ("Area of the basin", "band: twice its standard error", names[0]),
        "least_disturbance": (
            "Least disturbance",
            "distance from the gait to the nearest start that does not return to it",
            names[1] + units,
        ),
        "multiplier": (
            "Largest Floquet multiplier",
            "of the gait that walkers converge to; numbers are periods above 1",
            RADIUS,
        ),
    }
    for ax, (name, (title, note, y)) in zip(axes.flat, words.items(), strict=False):
        handles = draw_measure(ax, data, name)
        ax.set(xlim=padded_limits(values), ylim=(0, None))
        if name == "total_area":
            draw_band(ax, data)
        elif name == "least_disturbance":
            handles += draw_falls(ax, data)
        else:
            draw_periods(ax, data)
            ax.axhline(1, color=INK, lw=0.8, zorder=1)
        if name != "multiplier":
            mark_maximum(ax, data, name)
        legend = handles if len(handles) > 1 else []
        finish(ax, {}, title=title, note=note, x=parameter, y=y, legend=legend)
    boundary_dimension(data, axes[1, 1])
    figure_title(figure, f"{walker_title(data)}: robustness")
    return figure


def mark_maximum(ax: Axes, data: xr.Dataset, name: str) -> None:
    """Mark the largest value of a measure, where its parameter is, if it is not at an end."""
    values, parameter = table_axis(data)
    measured = data[name].values
    top = int(np.nanargmax(np.nan_to_num(measured, nan=-1.0)))
    if 0 < top < len(values) - 1:
        low = ax.get_ylim()[0]
        ax.plot([values[top]] * 2, [low, measured[top]], ":", color=INK, lw=1, zorder=1)
        words = f"largest at {parameter.replace('_', ' ')} {values[top]:.4g}"
        place = (values[top], low), (4, 6)
        ax.annotate(words, *place, textcoords="offset points", fontsize=SMALL)


def draw_measure(ax: Axes, data: xr.Dataset, name: str, scale: float = 1) -> list[Line2D]:
    """Draw a measure against the parameter, divided by a scale."""
    colour, style, words = MEASURES[name]
    values, _ = table_axis(data)
    return ax.plot(values, data[name].values / scale, style, color=colour, label=words)


def draw_periods(ax: Axes, data: xr.Dataset) -> None:
    """Write the periods of longer gaits beside their multipliers, below those that are small."""
    values, _ = table_axis(data)
    multipliers, periods = data["multiplier"].values, data["gait_period"].values
    for x, y, period in zip(values, multipliers, periods, strict=True):
        if period > 1 and np.isfinite(y):
            place = (0, -16) if y < np.nanmedian(multipliers) else (0, 7)
            ax.annotate(str(int(period)), (x, y), place, textcoords="offset points", ha="center")


def draw_band(ax: Axes, data: xr.Dataset, scale: float = 1) -> None:
    """Draw a band of twice the standard error around the area."""
    values, _ = table_axis(data)
    middle, band = data["total_area"].values / scale, 2 * data["total_area_error"].values / scale
    colour, *_ = MEASURES["total_area"]
    ax.fill_between(values, middle - band, middle + band, color=colour, alpha=0.25, lw=0)


def draw_falls(ax: Axes, data: xr.Dataset, scale: float = 1) -> list[Line2D]:
    """Draw the least disturbance that causes a fall, where a smaller one leads elsewhere."""
    values, _ = table_axis(data)
    farther = data["least_fall"].values > data["least_disturbance"].values
    if not farther.any():
        return []
    colour, *_ = MEASURES["least_disturbance"]
    words = "least disturbance after which it falls, where that is larger"
    look: dict[str, Any] = {"color": colour, "mfc": "white", "label": words}
    return ax.plot(values[farther], data["least_fall"].values[farther] / scale, "s", **look)


def table_axis(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], str]:
    """Return the values of a table's parameter, and its name, after a check of the data set."""
    check_dataset(data, "robustness table")
    parameter = str(data["total_area"].dims[0])
    return data[parameter].values, parameter


def largest_of(values: xr.DataArray) -> float:
    """Return the largest value; 0 where all are 0 or NaN."""
    return float(np.nanmax([0.0, *values.values]))
