"""Pictures of robustness."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from walker_jax.checks import WrongUse
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.regions import attractor_name, notable_attractors, painted, regions_of, show
from walker_jax.figures.style import (
    AXIS_LABELS,
    BASINS,
    BELOW,
    FAILURES,
    INK,
    LINE,
    MEASURES,
    WINDOW,
    along,
    counted,
    ends,
    margin,
    place_legend,
    title,
    write_title,
)
from walker_jax.walking.outcomes import Outcome


def disturbance(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The basin close to its gait, and the nearest start from which the walker does not come back.

    All starts inside the curve, which are nearer, come back. Where that start leads to another
    motion, the nearest one that falls is marked too: none inside the dashed curve does.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns, over two dimensions, with a gait.
    - `ax`: where to draw; by default, on a new figure of 5.4 by 5.4 inches.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    if not has_disturbance(data):
        raise WrongUse("data must hold the least disturbance of a gait, over two dimensions")
    data = data.assign_coords(coordinate=data.attrs["section"])
    if ax is None:
        ax = Figure(figsize=(5.4, 5.4), layout="constrained").add_subplot()
    x, y = map(str, data["fate"].dims)
    turn = np.linspace(0, 2 * np.pi, 400)
    section, gait = data["coordinate"], data["gait_state"]

    def circle(middle: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """The points at a distance from a state, in the plane of the picture."""
        around = middle + size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        states = xr.DataArray(around, dims=("phase", "coordinate"), coords={"coordinate": section})
        return along(states, x), along(states, y)

    size, elsewhere = float(data["least_disturbance"]), int(data["failure"]) == Outcome.STRIDE
    curves = [circle(gait.values, size)]
    points = [(data["failing_state"], "X", disturbed(data, "failure", "failing_strides"))]
    nearest = "nearest start that does not come back" if elsewhere else "nearest failure"
    subject = f"{size:.4g}, from the gait to the {nearest}"
    if elsewhere and "least_fall" in data:
        farther = float(data["least_fall"])
        from_state = data["fall_state"] - farther * data["fall_direction"]
        curves.append(circle(from_state.values, farther))
        points.append((data["fall_state"], "P", disturbed(data, "fall_failure", "fall_strides")))
        subject = f"from the gait {size:.4g} to another motion, {farther:.4g} to a failure"
    both = [np.concatenate(axis) for axis in zip(*curves, strict=True)]
    middle, reach = [0.5 * (c.max() + c.min()) for c in both], [np.ptp(c) for c in both]
    limits, window = [], {}
    for name, centre, width in zip((x, y), middle, reach, strict=True):
        axis = data[name].values
        limits.append((centre - WINDOW * width, centre + WINDOW * width))
        first, last = np.searchsorted(axis, limits[-1])
        window[name] = slice(max(0, first - 2), last + 2)  # some cells, however large they are
    near = data.isel(window)
    regions = regions_of(near, notable_attractors(data))
    extent = (*ends(near[x].values), *ends(near[y].values))
    show(ax, painted(regions, near["fate"].shape), extent)
    for curve, style in zip(curves, ("-", "--"), strict=False):
        ax.plot(*curve, style, color="white", lw=1.6)
    name = attractor_name(int(data["gait_period"]), gait.expand_dims("phase"))
    marks = []
    look: dict[str, Any] = {"ls": "", "mec": "white", "color": INK, "zorder": 3}
    for state, sign, words in [(gait, "o", name), *points]:
        at, ms = state.expand_dims("phase"), 7.5 if sign == "o" else 10
        marks += ax.plot(along(at, x), along(at, y), sign, ms=ms, label=words, **look)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    place_legend(ax, marks, BELOW, columns=1)
    place_legend(ax, patches, BELOW + LINE * len(marks), columns=2)
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    ax.locator_params(nbins=6)
    write_title(ax, "Least disturbance", subject)
    return ax


def disturbed(data: xr.Dataset, failure: str, strides: str) -> str:
    """What the legend says of the nearest start that is lost, given the names of how and when."""
    how = Outcome(int(data[failure]))
    if how == Outcome.STRIDE:
        return "nearest start that comes to another motion"
    return f"nearest start that {FAILURES[how][2]} after {counted(int(data[strides]), 'stride')}"


def has_disturbance(data: xr.Dataset) -> bool:
    """Whether a data set holds what `disturbance` draws."""
    known = {"fate", "least_disturbance", "failing_state", "gait_state"} <= set(data)
    if not known or data["fate"].ndim != 2 or data["least_disturbance"].ndim:
        return False
    return len(data.attrs["section"]) == 2 and bool(np.isfinite(data["least_disturbance"]))


def robustness(data: xr.Dataset) -> Figure:
    """The basin of a gait, and beside it its least disturbance where that is in the same plane.

    The pictures `basin` and `disturbance`.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns.

    **Returns** the figure, of 13 by 5.8 inches. Raises `ValueError` as these do.
    """
    both = has_disturbance(data)
    figure = Figure(figsize=(13 if both else 7, 5.8), layout="constrained")
    axes = figure.subplots(1, 2 if both else 1, squeeze=False)[0]
    basin(data, axes[0])
    if both:
        disturbance(data, axes[1])
    return figure


def robustness_measures(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Area of the basin, least disturbance and largest multiplier against a parameter.

    Figure 8 of Schwab and Wisse (2001), and the least disturbance. Area and disturbance are drawn
    as parts of their largest values, the multiplier as it is: where the one grows, the others need
    not shrink.

    **Arguments:**

    - `data`: what `walker_jax.robustness_table` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    values, parameter = table_axis(data)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    area, error = data["total_area"].values, data["total_area_error"].values
    most, farthest = np.max(area), np.nanmax([0.0, *data["least_disturbance"].values])
    kind = MEASURES["total_area"]
    handles = ax.plot(
        values, area / (most or 1), kind[1], color=kind[0], label=f"{kind[2]}, of {most:.4g}"
    )
    wide = 2 * error / (most or 1)
    ax.fill_between(values, area / (most or 1) - wide, area / (most or 1) + wide, color=kind[0])
    colour, sign, words = MEASURES["least_disturbance"]
    part = data["least_disturbance"].values / (farthest or 1)
    handles += ax.plot(values, part, sign, color=colour, label=f"{words}, of {farthest:.4g}")
    falls = data.get("least_fall", data["least_disturbance"]).values
    beyond = falls > data["least_disturbance"].values
    highest = np.max(falls[beyond] / (farthest or 1), initial=1)
    if beyond.any():
        words = "least one from which it falls, where that comes to another motion"
        part = falls[beyond] / farthest
        handles += ax.plot(values[beyond], part, "s", color=colour, mfc="white", label=words)
    colour, sign, words = MEASURES["multiplier"]
    handles += ax.plot(values, data["multiplier"].values, sign, color=colour, label=words)
    ax.set_xlabel(AXIS_LABELS.get(parameter, parameter), fontsize=11)
    ax.set_ylabel("part of the largest; modulus", fontsize=11)
    ax.set(xlim=margin(values), ylim=(0, 1.05 * highest))
    note = "with twice the error of the area; the multiplier is that of the gait walkers come to"
    write_title(ax, f"{title(data)}: robustness", note)
    place_legend(ax, handles, BELOW, columns=1)
    return ax


def boundary_dimension(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The dimension of the boundary of the basin against a parameter, with its interval.

    It is 1 where the boundary is smooth, and above where it is fractal.

    **Arguments** and errors are those of `robustness_measures`.
    """
    values, parameter = table_axis(data)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    low, middle, high = (data[f"dimension{end}"].values for end in ("_low", "", "_high"))
    ax.fill_between(values, low, high, color=BASINS[0], alpha=0.25, lw=0)
    ax.plot(values, middle, "o-", color=BASINS[0], markersize=4)
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    ax.set_xlabel(AXIS_LABELS.get(parameter, parameter), fontsize=11)
    ax.set_ylabel("dimension", fontsize=11)
    top = np.nanmax([1.2, *high])
    ax.set(xlim=margin(values), ylim=(0.9, 1.05 * top))
    note = "by the uncertainty exponent, with its 95 % interval"
    write_title(ax, "Dimension of the basin's boundary", note)
    return ax


def robustness_table(data: xr.Dataset) -> Figure:
    """The pictures `robustness_measures` and `boundary_dimension`, side by side.

    **Arguments:**

    - `data`: what `walker_jax.robustness_table` returns.

    **Returns** the figure, of 13 by 5 inches. Raises `ValueError` as these do.
    """
    figure = Figure(figsize=(13, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    robustness_measures(data, axes[0])
    boundary_dimension(data, axes[1])
    return figure


def table_axis(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], str]:
    """The values of a table's parameter, and its name; `ValueError` for what is no table."""
    dims = data["total_area"].dims if "total_area" in data else ()
    if len(dims) != 1 or "least_disturbance" not in data:
        raise WrongUse("data must be a table of robustness over one parameter")
    return data[dims[0]].values, str(dims[0])
