"""Pictures of walkers in motion: poses on the slope, leg angles, the trajectory over a basin.

Walkers walk to the right, and slopes go down to the right, by their own angle.
"""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Polygon

from walker_jax.figures.basin_maps import basin
from walker_jax.figures.regions import notable_attractors, painted, regions_of, show
from walker_jax.figures.style import (
    BASINS,
    BELOW,
    FAILURES,
    INK,
    WORDS,
    along,
    counted,
    ends,
    place_legend,
    title,
    write_title,
)
from walker_jax.walking.outcomes import Outcome

SWING = BASINS[1]
"""Colour of the swing leg; the stance leg is in ink."""
GROUND, SOIL = "#6b6b6b", "#ececec"
SHARES = (0, 0.2, 0.4, 0.6, 0.8, 1)
"""Of a stride, at which its poses are drawn."""
PATH = "#f2b632"
"""Colour of the way over a basin, seen on dark and on pale ground."""


def step(data: xr.Dataset) -> Figure:
    """One stride, in six poses from heel strike to heel strike.

    Figure 1 of Schwab and Wisse (2001), which names what the model consists of.

    **Arguments:**

    - `data`: what `walker_jax.motion` returns. Its first stride is drawn.

    **Returns** a figure of 9 by 6.4 inches.
    """
    own = data.isel(frame=data["stride"].values == 0)
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True).flat
    last, size = own.sizes["frame"] - 1, leg_of(data)
    strides = data["outcome"].values[0] == Outcome.STRIDE
    ending = "just before heel strike" if strides else FAILURES[Outcome(int(data["outcome"][0]))][2]
    for k, (ax, share) in enumerate(zip(panels, SHARES, strict=True)):
        pose = own.isel(frame=round(share * last))
        draw_ground(ax, data)
        draw_pose(ax, pose)
        if k == 1:
            name_parts(ax, pose)
        when = f"time {float(pose['time']):.2f}"
        note = {0: "just after heel strike", len(SHARES) - 1: ending}.get(k, "")
        ax.set_title(when, loc="left", fontsize=10, fontweight="bold")
        ax.set_title(note, loc="right", fontsize=WORDS)
        ax.set(xlim=(-0.62 * size, 0.62 * size), ylim=(-0.16 * size, 1.22 * size), aspect="equal")
        ax.set_axis_off()
    legs = [
        Line2D([], [], color=INK, lw=3, label="stance leg"),
        Line2D([], [], color=SWING, lw=3, label="swing leg"),
    ]
    figure.legend(handles=legs, loc="outside lower left", ncols=2, frameon=False, fontsize=WORDS)
    words = f"{title(data)}: one stride, times in √(l/g)"
    figure.suptitle(words, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure


def draw_ground(ax: Axes, data: xr.Dataset) -> None:
    """The slope, as far as can be seen, with a mark at every half of a leg."""
    slope, size = float(data.attrs["walker_slope"]), leg_of(data)
    far = np.ceil(2 + np.abs(data["hip"].values[:, 0]).max() / size)
    away = size * np.array([[-far, 0.0], [far, 0.0], [far, -far], [-far, -far]])
    ax.add_patch(Polygon(turned(away, slope), fc=SOIL, ec="none", zorder=0))
    ax.plot(*turned(away[:2], slope).T, color=GROUND, lw=1.2, zorder=1)
    marks = [[[at, 0.0], [at, -0.05 * size]] for at in np.arange(-far, far, 0.5) * size]
    marks = [turned(np.array(mark), slope) for mark in marks]
    ax.add_collection(LineCollection(marks, colors=GROUND, lw=1, zorder=1))


def leg_of(data: xr.Dataset) -> float:
    """From the hip to the sole."""
    return data.attrs["leg_length"] + data.attrs["foot_radius"]


def draw_pose(ax: Axes, pose: xr.Dataset) -> list[Line2D]:
    """Hip, legs and feet of one frame. Returns the lines."""
    slope, radius = (float(pose.attrs[name]) for name in ("walker_slope", "foot_radius"))
    hip = pose["hip"].values
    lines: list[Line2D] = []
    angles = {"stance": float(pose["theta"]), "swing": float(pose["theta"] - pose["phi"])}
    for name, colour, order in (("stance", INK, 3), ("swing", SWING, 4)):
        end = pose[name].values
        leg = turned(np.stack([hip, end]), slope)
        lines += ax.plot(*leg.T, color=colour, lw=3, solid_capstyle="round", zorder=order)
        if radius:
            way = angles[name] + np.linspace(-0.6, 0.6, 40)
            arc = end + radius * np.stack([np.sin(way), -np.cos(way)], axis=1)
            lines += ax.plot(*turned(arc, slope).T, color=colour, lw=3, zorder=order)
            sole = np.stack(
                [end, end + radius * np.array([np.sin(angles[name]), -np.cos(angles[name])])]
            )
            lines += ax.plot(*turned(sole, slope).T, color=colour, lw=3, zorder=order)
        else:
            lines += ax.plot(*leg[1:].T, "o", color=colour, mec="white", ms=6, zorder=order + 2)
    at = turned(hip[None], slope)
    return [*lines, *ax.plot(*at.T, "o", color=INK, mec="white", mew=1.2, ms=14, zorder=7)]


def turned(places: Float[np.ndarray, "n 2"], slope: float) -> Float[np.ndarray, "n 2"]:
    """Places along the slope and normal to it, as they are seen, the horizontal level."""
    c, s = np.cos(slope), np.sin(slope)
    return places @ np.array([[c, -s], [s, c]])


def name_parts(ax: Axes, pose: xr.Dataset) -> None:
    """The names of what the model consists of, beside one of its poses."""
    slope = float(pose.attrs["walker_slope"])
    foot, hip = (turned(pose[name].values[None], slope)[0] for name in ("stance", "hip"))
    theta, phi = float(pose["theta"]), float(pose["phi"])
    leg = leg_of(pose)
    up = turned(np.array([[0.0, 0.9 * leg]]), slope)[0]
    ax.plot(*np.stack([foot, foot + up]).T, color=GROUND, lw=0.8, ls=(0, (5, 4)), zorder=2)
    upright, down = 90 - np.degrees(slope), 270 - np.degrees(slope)
    hanging = down + np.degrees(theta - phi)
    for middle, size, begin, end, text, away in (
        (foot, 0.72, upright, upright + np.degrees(theta), r"$\theta$", (13, -3)),
        (hip, 0.5, hanging, down + np.degrees(theta), r"$\phi$", (2, -10)),
    ):
        wide = 2 * size * leg
        ax.add_patch(Arc(middle, wide, wide, theta1=begin, theta2=end, lw=1, zorder=8))
        way = np.radians((begin + end) / 2)
        at = middle + size * leg * np.array([np.cos(way), np.sin(way)])
        centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 12}
        ax.annotate(text, at, away, textcoords="offset points", **centred)
    words = (
        (hip, (13, 6), "hip, mass $M$"),
        (foot, (9, -13), "foot, mass $m$"),
        ((foot + hip) / 2, (10, 0), "leg, length $l$"),
    )
    for place, shift, text in words:
        ax.annotate(text, place, shift, textcoords="offset points", va="center", fontsize=WORDS)
    ax.annotate(f"slope $\\gamma$ = {slope:g}", (-0.6 * leg, -0.13 * leg), fontsize=WORDS)
    head, tail = (0.5 * leg, 0.45 * leg), (0.5 * leg, 0.75 * leg)
    ax.annotate("$g$", head, tail, ha="center", fontsize=12, arrowprops={"arrowstyle": "->"})


def leg_angles(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Angles of both legs from the normal of the slope, over time.

    Figure 6 of Schwab and Wisse (2001). Legs exchange roles at heel strikes, the thin lines.

    **Arguments:**

    - `data`: what `walker_jax.motion` returns.
    - `ax`: where to draw; by default, on a new figure of 9 by 4.2 inches.

    **Returns** the axes.
    """
    if ax is None:
        ax = Figure(figsize=(9, 4.2), layout="constrained").add_subplot()
    stride, time = data["stride"].values, data["time"].values
    theta = data["theta"].values
    ax.axhline(0, color=GROUND, lw=0.6, zorder=1)
    for number in np.unique(stride).tolist():
        own = stride == number
        if number:
            ax.axvline(time[own][0], color=GROUND, lw=0.6, zorder=1)
        ax.plot(time[own], theta[own], color=INK, lw=1.8)
        ax.plot(time[own], (theta - data["phi"].values)[own], color=SWING, lw=1.8, ls=(0, (1, 1.2)))
    if time[-1] > time[0]:
        ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time (√(l/g))", fontsize=11)
    ax.set_ylabel("angle from the normal of the slope (rad)", fontsize=11)
    made = int((data["outcome"].values == Outcome.STRIDE).sum())
    write_title(ax, f"{title(data)}: leg angles", f"{counted(made, 'stride')}{failure(data)}")
    legs = [
        Line2D([], [], color=INK, lw=1.8, label="stance leg"),
        Line2D([], [], color=SWING, lw=1.8, ls=(0, (1, 1.2)), label="swing leg"),
    ]
    place_legend(ax, legs, BELOW, columns=2)
    return ax


def failure(data: xr.Dataset) -> str:
    """How a walk ends, if it fails."""
    last = Outcome(int(data["outcome"].values[-1]))
    return "" if last == Outcome.STRIDE else f", then {FAILURES[last][2]}"


def steps_over_basin(data: xr.Dataset, walk: xr.Dataset) -> Figure:
    """A basin of attraction, and the starts of the strides of a walk over it, joined in order.

    Figure 5 of Schwab and Wisse (2001), with an enlargement around the last half of them.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns, over two dimensions.
    - `walk`: what `walker_jax.motion` returns, of the same walker.

    **Returns** a figure of 12 by 5.4 inches. Raises `ValueError` as `figures.basin`.
    """
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    whole, close = figure.subplots(1, 2)
    basin(data, whole)
    x, y = way_over(data, walk["states"].rename(start="phase"))
    half = len(x) // 2
    window = [(values.min(), values.max()) for values in (x[half:], y[half:])]
    window = [(low - 0.3 * (high - low), high + 0.3 * (high - low)) for low, high in window]
    regions = regions_of(data, notable_attractors(data))
    names = map(str, data["fate"].dims)
    (left, right), (low, high) = (ends(data[name].values) for name in names)
    show(close, painted(regions, data["fate"].shape), (left, right, low, high))
    for ax, first, last in ((whole, 0, half), (close, half, len(x))):
        ax.plot(x, y, "-", color=PATH, lw=1.2, zorder=5)
        ax.plot(x, y, "o", color=PATH, mec=INK, mew=0.8, ms=6, zorder=6)
        for k in range(first, last):
            write_number(ax, k + 1, (x[k], y[k]))
    for number in notable_attractors(data):
        cycle = data["states"].sel(number=number)
        dots = way_over(data, cycle)
        close.plot(*dots, "o", color=INK, mec="white", mew=1.2, ms=7.5, zorder=5)
    close.set(xlim=window[0], ylim=window[1])
    close.set_xlabel(whole.get_xlabel(), fontsize=11)
    write_title(close, "Enlarged", f"starts {half + 1} to {len(x)}, and the attractor")
    return figure


def write_number(ax: Axes, number: int, place: tuple[float, float]) -> None:
    """A number beside a dot."""
    frame = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.5}
    ax.annotate(
        f"{number}", place, (8, 7), textcoords="offset points", fontsize=9, bbox=frame, zorder=7
    )


def way_over(
    data: xr.Dataset, states: xr.DataArray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """States along the axes of a basin."""
    states = states.assign_coords(coordinate=data.attrs["section"])
    x, y = (along(states, str(axis)) for axis in data["fate"].dims)
    return x, y
