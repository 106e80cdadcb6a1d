"""Pictures of robustness."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.checks import WrongUse
from walker_jax.figures import layout, regions
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, begin, finish, write_beside
from walker_jax.figures.style import BASINS, INK, LEVEL, NOTE, failure_words
from walker_jax.figures.text import AREA_LABEL, RADIUS, count_noun, known_label, walker_title
from walker_jax.stability import nearest_starts
from walker_jax.stability.disturbances import LeastDisturbance
from walker_jax.stability.nearest_starts import has_plane_disturbance
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, failures_of

AROUND = 0.75
"""Margin around the curve of the least disturbance, as a share of its width."""
MEASURES = {
    "total_area": (
        *(BASINS[0], "-o", AREA_LABEL),
        *("Area of the basin", "band: twice its standard error"),
    ),
    "least_disturbance": (
        *(BASINS[1], "-s", "least disturbance (rad, time in √(l/g))"),
        *("Least disturbance", "from the gait to the nearest start that does not return to it"),
    ),
    "multiplier": (
        *(INK, "-^", RADIUS, "Largest Floquet multiplier"),
        "of the gait that walkers converge to; numbers are periods above 1",
    ),
}
"""Colour, line and label of each measure of robustness; title and note of its panel."""


def disturbance(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the basin near its gait, and the nearest start from which the walker does not return.

    `data` is what `walker_jax.robustness` returns, over two dimensions, with a gait. The walker
    returns from all starts inside the solid curve. If the nearest start converges to another
    attractor, the nearest one that falls is marked too: none inside the dashed curve falls.
    """
    ax = begin(ax, style, data, "robustness", 5.4, 5.4)
    if not has_plane_disturbance(data):
        raise WrongUse("data must hold the least disturbance of a gait, over two dimensions")
    axes, starts = regions.axes_of(data), nearest_starts.nearest_starts(data)
    gait = data["gait_state"].values
    centres = [gait, *(one.state - one.size * one.direction for one in starts[1:])]
    around = map(nearest_starts.circle, centres, [one.size for one in starts])
    curves = [regions.place_states(data, one) for one in around]
    ends = np.stack([np.min(curves, axis=(0, 1)), np.max(curves, axis=(0, 1))], axis=1)
    limits, window = layout.widened(ends, AROUND), {}
    for name, shown in zip(axes, limits, strict=True):
        first, last = np.searchsorted(data[name].values, shown)
        window[name] = slice(max(0, first - 2), last + 2)  # some cells, however large they are
    found = regions.draw_regions(ax, data.isel(window), regions.largest(data))
    for curve, line in zip(curves, ("-", "--"), strict=False):
        ax.plot(*curve.T, line, color="white", lw=1.6)
    name = regions.attractor_name(data, int(data["gait_period"]), gait[None])
    nearest = [(one.state, start_phrase(one, data), 10.0) for one in starts]
    for (state, words, size), sign in zip([(gait, name, 7.5), *nearest], "oXP", strict=False):
        (place,) = regions.place_states(data, state[None])
        look: Any = {"ms": size, "color": INK, "mec": "white", "label": words}
        ax.plot(*place, sign, ls="", zorder=3, **look)
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.locator_params(nbins=6)
    (x, y), patches, note = axes, map(regions.patch_of, found), distance_phrase(starts)
    return finish(ax, style, "Least disturbance", note, x=x, y=y, legend=patches)


def distance_phrase(starts: list[LeastDisturbance]) -> str:
    """Return the distances of the nearest starts from the gait, in words."""
    nearest, *fall = starts
    if fall:
        farther = f"{fall[0].size:.4g} to a failure"
        return f"from the gait {nearest.size:.4g} to another attractor, {farther}"
    elsewhere = nearest.failure == Outcome.STRIDE
    end = "start that does not return" if elsewhere else "failure"
    return f"{nearest.size:.4g}, from the gait to the nearest {end}"


def start_phrase(start: LeastDisturbance, data: xr.Dataset) -> str:
    """Return the legend of the nearest start that does not return."""
    if start.failure == Outcome.STRIDE:
        return "nearest start that converges to another attractor"
    fails = failure_words(start.failure, failures_of(data))
    strides = count_noun(start.strides, "stride")
    return f"nearest start that {fails} after {strides}"


def robustness(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.robustness` returns: `basin`, and `disturbance` beside it.

    That is left out where the least disturbance is not in the same plane.
    """
    check_dataset(data, "basin")
    both = has_plane_disturbance(data)
    figure, (ax, *beside) = layout.new_panels(13 if both else 7, 5.8, 1, 1 + both)
    basin(data, ax)
    for other in beside:
        disturbance(data, other)
    return figure


def robustness_measures(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw area of the basin, least disturbance and largest multiplier against a parameter.

    Figure 8 of Schwab and Wisse (2001), with the least disturbance added. `data` is what
    `walker_jax.robustness` over values returns. Area and disturbance are shares of their largest
    values; the multiplier is drawn as it is. Where one grows, the others need not shrink.
    """
    values, parameter = table_axis(data)
    ax = axes_for(ax, style, 7, 4.6)
    for name in ("total_area", "least_disturbance"):
        largest = float(np.nanmax([0.0, *data[name].values]))
        first, *_ = draw_measure(ax, data, values, name, largest or 1)
        first.set_label(f"{first.get_label()} (largest {largest:.4g})")
    draw_measure(ax, data, values, "multiplier")
    layout.show_from_zero(ax, values)
    note = "band: twice the standard error of the area; multiplier of the attracting gait"
    title, y = f"{walker_title(data)}: robustness", "relative to the maximum; multiplier"
    return finish(ax, style, title, note, x=parameter, y=y)


def boundary_dimension(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the dimension of the boundary of the basin against a parameter, with its interval.

    It is 1 where the boundary is smooth, and larger where it is fractal. `data` is what
    `walker_jax.robustness` over values returns.
    """
    values, parameter = table_axis(data)
    ax = axes_for(ax, style, 7, 4.6)
    low, middle, high = (data[f"dimension{end}"].values for end in ("_low", "", "_high"))
    ax.fill_between(values, low, high, color=BASINS[0], alpha=0.25, lw=0)
    ax.plot(values, middle, "o-", color=BASINS[0], markersize=4)
    ax.axhline(1, **LEVEL)
    layout.show_from_zero(ax, values)
    ax.set_ylim(0.9, 1.05 * np.nanmax([1.2, *high]))
    note = "by the uncertainty exponent, with its 95\u00a0% interval"
    title = "Dimension of the basin's boundary"
    return finish(ax, style, title, note, x=parameter, y="dimension")


def robustness_table(data: xr.Dataset) -> Figure:
    """Draw area, least disturbance, largest multiplier and boundary dimension, a panel each.

    `data` is what `walker_jax.robustness` over values returns. The last panel is the picture
    `boundary_dimension`. The band around the area is twice its standard error. Where the nearest
    start that does not return converges to another attractor, the nearest one that falls is drawn
    too.
    """
    values, parameter = table_axis(data)
    figure, axes = layout.new_panels(13, 8.4, 2, 2)
    for ax, (name, (_, _, y, title, note)) in zip(axes, MEASURES.items(), strict=False):
        several = len(draw_measure(ax, data, values, name)) > 1
        layout.show_from_zero(ax, values)
        if name == "multiplier":
            draw_periods(ax, data, values)
            ax.axhline(1, **LEVEL)
        else:
            mark_maximum(ax, values, data[name].values, parameter)
        finish(ax, {"legend": several}, title, note, x=parameter, y=known_label(data, y))
    boundary_dimension(data, axes[-1])
    layout.figure_title(figure, f"{walker_title(data)}: robustness")
    return figure


def mark_maximum(ax: Axes, values: np.ndarray, measured: np.ndarray, parameter: str) -> None:
    """Mark the largest value of a measure, where its parameter is, if it is not at an end."""
    top = int(np.nanargmax(np.nan_to_num(measured, nan=-1.0)))
    if 0 < top < len(values) - 1:
        ax.plot([values[top]] * 2, [0, measured[top]], ":", color=INK, lw=1, zorder=1)
        words = f"largest at {parameter.replace('_', ' ')} {values[top]:.4g}"
        write_beside(ax, words, (values[top], 0), (4, 6))


def draw_measure(
    ax: Axes, data: xr.Dataset, values: np.ndarray, name: str, scale: float = 1
) -> list[Line2D]:
    """Draw a measure against the parameter, divided by a scale; return its lines.

    The area has a band of twice its standard error. A least disturbance that leads elsewhere has
    the least one that causes a fall beside it.
    """
    (colour, line, label, *_), middle = MEASURES[name], data[name].values / scale
    lines = ax.plot(values, middle, line, color=colour, label=label.partition(" (")[0])
    if name == "total_area":
        band = 2 * data["total_area_error"].values / scale
        ax.fill_between(values, middle - band, middle + band, color=colour, alpha=0.25, lw=0)
    falls = data["least_fall"].values / scale
    if name == "least_disturbance" and (farther := falls > middle).any():
        words = "least disturbance after which it falls, where that is larger"
        places = values[farther], falls[farther]
        lines += ax.plot(*places, "s", color=colour, mfc="white", label=words)
    return lines


def draw_periods(ax: Axes, data: xr.Dataset, values: np.ndarray) -> None:
    """Write the periods of longer gaits beside their multipliers, below those that are small."""
    multipliers, periods = data["multiplier"].values, data["gait_period"].values
    for x, y, period in zip(values, multipliers, periods, strict=True):
        if period > 1 and np.isfinite(y):
            shift = (0, -16) if y < np.nanmedian(multipliers) else (0, 7)
            write_beside(ax, f"{int(period)}", (x, y), shift, ha="center", fontsize=NOTE)


def table_axis(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], str]:
    """Return the values of a table's parameter, and its name, after a check of the data set."""
    check_dataset(data, "robustness table")
    parameter = str(data["total_area"].dims[0])
    return data[parameter].values, parameter
