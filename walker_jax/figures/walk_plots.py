"""Pictures of walks: leg angles over time, and the trajectory in a basin."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from walker_jax.figures import layout, regions
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish
from walker_jax.figures.poses import GROUND, SWING
from walker_jax.figures.style import INK, failure_words
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, failures_of

NEAREST = 1e-6
"""Least margin around the end of a walk, which may stay at one point."""
TRAJECTORY = "#f2b632"
"""Colour of a trajectory in a basin, visible on dark and on pale ground."""
STANCE_LEG: dict[str, Any] = {"color": INK, "lw": 1.8}
SWING_LEG: dict[str, Any] = {"color": SWING, "lw": 1.8, "ls": (0, (1, 1.2))}
SHANK: dict[str, Any] = {"color": SWING, "lw": 0.9}
"""Lines of the angles of the stance leg, of the swing leg or thigh, and of the swing shank."""
NUMBER = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.5}
"""Frame of the number of a start."""


def leg_angles(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the angles of both legs from the normal of the slope, over time.

    Figure 6 of Schwab and Wisse (2001). Thin lines are heel strikes, at which the legs exchange
    roles.

    `data` is what `walker_jax.motion` returns.
    """
    ax = begin(ax, style, data, "walk", 9, 4.2)
    stride, time = data["stride"].values, data["time"].values
    theta, swing = data["theta"].values, (data["theta"] - data["phi"]).values
    legs = [("stance leg", theta, STANCE_LEG), ("swing leg", swing, SWING_LEG)]
    if "knee" in data:
        shank = swing - data["knee"].values
        legs[1:] = [("swing thigh", swing, SWING_LEG), ("swing shank", shank, SHANK)]
    ax.axhline(0, color=GROUND, lw=0.6, zorder=1)
    for number in np.unique(stride).tolist():
        own = stride == number
        if number:
            ax.axvline(time[own][0], color=GROUND, lw=0.6, zorder=1)
        for name, angle, look in legs:
            ax.plot(time[own], angle[own], label=name if number == stride[0] else "", **look)
    if time[-1] > time[0]:
        ax.set_xlim(time[0], time[-1])
    title, y = f"{walker_title(data)}: leg angles", "angle from the normal of the slope (rad)"
    return finish(ax, style, title, course(data), x="time (√(l/g))", y=y)


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
    figure, (whole, close) = layout.new_panels(12, 5.4, 1, 2)
    basin(data, whole)
    x, y = regions.place_states(data, walk["states"].values).T
    half = len(x) // 2
    regions.draw_regions(close, data)
    for dots, marker, _ in regions.attractors(data, regions.largest(data)):
        regions.mark_attractor(close, dots, marker)
    for ax, first, last in ((whole, 0, half), (close, half, len(x))):
        ax.plot(x, y, "-", color=TRAJECTORY, lw=1.2, zorder=5)
        ax.plot(x, y, "o", color=TRAJECTORY, mec=INK, mew=0.8, ms=6, zorder=6)
        for k in range(first, last):
            layout.write_beside(ax, f"{k + 1}", (x[k], y[k]), (8, 7), bbox=NUMBER, zorder=7)
    ends = np.array([[one.min(), one.max()] for one in (x[half:], y[half:])])
    across, up = layout.widened(ends, 0.3, NEAREST)
    close.set(xlim=across, ylim=up)
    note = f"starts {half + 1} to {len(x)}, and the attractor"
    finish(close, {}, "Enlarged", note, x=regions.axes_of(data)[0], y="")
    return figure
