"""Pictures of walks: leg angles over time, and the trajectory in a basin."""

from typing import Unpack

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.basins.cell_classes import large_basins
from walker_jax.figures import regions
from walker_jax.figures.basin_maps import axes_of, basin
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish, new_figure
from walker_jax.figures.poses import GROUND, SWING
from walker_jax.figures.style import BASINS, INK, SMALL, failure_words
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, failures_of

NEAREST = 1e-6
"""Least margin around the end of a walk, which may stay at one point."""
TRAJECTORY = "#f2b632"
"""Colour of a trajectory in a basin, visible on dark and on pale ground."""


def leg_angles(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the angles of both legs from the normal of the slope, over time.

    Figure 6 of Schwab and Wisse (2001). Thin lines are heel strikes, at which the legs exchange
    roles.

    `data` is what `walker_jax.motion` returns.
    """
    check_dataset(data, "walk")
    ax = axes_for(ax, style, 9, 4.2)
    stride, time = data["stride"].values, data["time"].values
    theta = data["theta"].values
    ax.axhline(0, color=GROUND, lw=0.6, zorder=1)
    for number in np.unique(stride).tolist():
        own = stride == number
        if number:
            ax.axvline(time[own][0], color=GROUND, lw=0.6, zorder=1)
        ax.plot(time[own], theta[own], color=INK, lw=1.8)
        ax.plot(time[own], (theta - data["phi"].values)[own], color=SWING, lw=1.8, ls=(0, (1, 1.2)))
        if "knee" in data:
            shank = (theta - data["phi"].values - data["knee"].values)[own]
            ax.plot(time[own], shank, color=SWING, lw=0.9)
    if time[-1] > time[0]:
        ax.set_xlim(time[0], time[-1])
    signs = {"stance leg": (INK, 1.8, "-"), "swing leg": (SWING, 1.8, (0, (1, 1.2)))}
    if "knee" in data:
        signs["swing thigh"] = signs.pop("swing leg")
        signs["swing shank"] = SWING, 0.9, "-"
    legs = [
        Line2D([], [], color=colour, lw=width, ls=dashes, label=name)
        for name, (colour, width, dashes) in signs.items()
    ]
    title, y = f"{walker_title(data)}: leg angles", "angle from the normal of the slope (rad)"
    return finish(ax, style, title, course(data), x="time (√(l/g))", y=y, legend=legs)


def course(data: xr.Dataset) -> str:
    """Say how many strides a walk has, and how it fails, if it does."""
    outcomes = data["outcome"].values
    last = Outcome(int(outcomes[-1]))
    strides = count_noun(len(outcomes) - (last != Outcome.STRIDE), "stride")
    if last == Outcome.STRIDE:
        return strides
    return f"{strides}, then {failure_words(last, failures_of(data))}"


def steps_over_basin(data: xr.Dataset, walk: xr.Dataset) -> Figure:
    """Draw a walk's trajectory in a basin: the starts of its strides, joined in order.

    Figure 5 of Schwab and Wisse (2001), with an enlargement around the last half of the starts.

    `data` is what `walker_jax.basin` returns, over two dimensions, and `walk` what
    `walker_jax.motion` returns for the same walker.
    """
    check_dataset(walk, "walk")
    figure = new_figure(12, 5.4)
    whole, close = figure.subplots(1, 2)
    basin(data, whole)
    x, y = trajectory_in(data, walk).T
    half = len(x) // 2
    axes = axes_of(data)
    regions.draw_regions(close, data)
    for number in large_basins(data, len(BASINS)):
        dots = regions.place_states(data, regions.cycle_of(data, number), axes)
        regions.mark_attractor(close, dots, "o")
    for ax, first, last in ((whole, 0, half), (close, half, len(x))):
        ax.plot(x, y, "-", color=TRAJECTORY, lw=1.2, zorder=5)
        ax.plot(x, y, "o", color=TRAJECTORY, mec=INK, mew=0.8, ms=6, zorder=6)
        for k in range(first, last):
            write_number(ax, k + 1, (x[k], y[k]))
    ends = [np.array([values.min(), values.max()]) for values in (x[half:], y[half:])]
    left, low = (both + max(0.3 * np.ptp(both), NEAREST) * np.array([-1, 1]) for both in ends)
    close.set(xlim=left, ylim=low)
    note = f"starts {half + 1} to {len(x)}, and the attractor"
    finish(close, {}, "Enlarged", note, x=axes[0], y="")
    return figure


def trajectory_in(data: xr.Dataset, walk: xr.Dataset) -> Float[np.ndarray, "n 2"]:
    """Return the starts of the strides of a walk, along the axes of a basin."""
    return regions.place_states(data, walk["states"].values, axes_of(data))


def write_number(ax: Axes, number: int, place: tuple[float, float]) -> None:
    """Write a number beside a dot."""
    frame = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.5}
    style = {"textcoords": "offset points", "fontsize": SMALL, "bbox": frame, "zorder": 7}
    ax.annotate(f"{number}", place, (8, 7), **style)
