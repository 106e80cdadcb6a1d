"""Poses of walkers on their slope.

Walkers walk to the right, and slopes descend to the right, by their own angle.
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

from walker_jax.figures.layout import figure_legend, figure_title, new_panels, write_beside
from walker_jax.figures.style import BASINS, INK, SMALL, TITLE, failure_words
from walker_jax.figures.text import walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, failures_of

SWING = BASINS[1]
"""Colour of the swing leg; the stance leg is in ink."""
GROUND, SOIL = "#6b6b6b", "#ececec"
"""Colours of the line of the slope, and of the soil below it."""
SHORTEST = 0.9
"""Share of its length to which a swing leg is shortened above the ground; beyond, it is turned."""
HIP_HEIGHT = 0.045
"""Least height of the hip above the ground, in legs: the radius of its disc in a film."""
SHARES = (0, 0.2, 0.4, 0.6, 0.8, 1)
"""Shares of a stride at which its poses are drawn."""


def step(data: xr.Dataset) -> Figure:
    """Draw one stride, in six poses from heel strike to heel strike.

    Figure 1 of Schwab and Wisse (2001), which names the parts of the model.

    `data` is what `walker_jax.motion` returns. Its first stride is drawn.
    """
    check_dataset(data, "walk")
    own = data.isel(frame=data["stride"].values == 0)
    figure, panels = new_panels(9, 6.4, 2, 3, sharex=True, sharey=True)
    size, last = leg_size(data), own.sizes["frame"] - 1
    shown = own.isel(frame=[round(share * last) for share in SHARES])
    places = np.concatenate([shown[name].values[:, 0] for name in ("stance", "hip", "swing")])
    left = min(-0.62 * size, places.min() - 0.1 * size)  # farther where the walker falls
    right = max(0.62 * size, places.max() + 0.1 * size)
    outcome, ending = int(data["outcome"][0]), "just before heel strike"
    if outcome != Outcome.STRIDE:
        ending = failure_words(outcome, failures_of(data))
    for k, ax in enumerate(panels):
        pose = shown.isel(frame=k)
        draw_ground(ax, data)
        draw_pose(ax, pose)
        if k == 1:
            write_part_names(ax, pose)
        note = {0: "just after heel strike", len(SHARES) - 1: ending}.get(k, "")
        ax.set_title(f"time {float(pose['time']):.2f}", fontsize="medium", **TITLE)
        ax.set_title(note, loc="right", fontsize=SMALL)
        ax.set(xlim=(left, right), ylim=(-0.16 * size, 1.22 * size), aspect="equal")
        ax.set_axis_off()
    for name, colour in (("stance", INK), ("swing", SWING)):
        panels[-1].plot([], [], color=colour, lw=3, label=f"{name} leg")
    figure_legend(panels)
    figure_title(figure, f"{walker_title(data)}: one stride, times in √(l/g)")
    return figure


def draw_ground(ax: Axes, data: xr.Dataset) -> None:
    """Draw the visible part of the slope, with a mark at every half of a leg.

    Rough ground is drawn as steps, whose heights change half way between footholds, at marks.
    """
    slope, size = float(data.attrs["walker_slope"]), leg_size(data)
    far = size * np.ceil(2 + np.abs(data["hip"].values[:, 0]).max() / size)
    if "footholds" in data:
        along, height = data["footholds"].values.T
        at, tops = (along[1:] + along[:-1]) / 2, np.maximum(height[1:], height[:-1])
        x, y = np.concatenate([[-far], at.repeat(2), [far]]), height.repeat(2)
    else:
        at = np.arange(-far, far, 0.5 * size)
        tops, x, y = 0 * at, np.array([-far, far]), np.zeros(2)
    line = np.stack([x, y], axis=1)
    deep = [[far, y.min() - far], [-far, y.min() - far]]
    ax.add_patch(Polygon(to_level(np.concatenate([line, deep]), slope), fc=SOIL, ec="none"))
    ax.plot(*to_level(line, slope).T, color=GROUND, lw=1.2, zorder=1)
    ends = [np.stack([at, tops - drop], axis=1) for drop in (0, 0.05 * size)]
    marks = [*to_level(np.stack(ends, axis=1), slope)]
    ax.add_collection(LineCollection(marks, colors=GROUND, lw=1, zorder=1))


def leg_size(data: xr.Dataset) -> float:
    """Return the length from the hip to the sole."""
    return data.attrs["leg_length"] + data.attrs["foot_radius"]


def draw_pose(ax: Axes, pose: xr.Dataset) -> list[Line2D]:
    """Draw hip, legs and feet of one frame. Returns the lines."""
    slope, radius = (float(pose.attrs[name]) for name in ("walker_slope", "foot_radius"))
    lines: list[Line2D] = []

    def draw(places: Float[np.ndarray, "n 2"], *sign: str, **look: Any) -> None:
        """Draw places along the slope and normal to it."""
        lines.extend(ax.plot(*to_level(places, slope).T, *sign, **look))

    angles = {"stance": float(pose["theta"]), "swing": float(pose["theta"] - pose["phi"])}
    if "swing_knee" in pose and "knee" in pose:
        angles["swing"] -= float(pose["knee"])
    hip, floor = pose["hip"].values, 0.0
    if "footholds" in pose:  # at the one that is nearest to the swing foot
        along, height = pose["footholds"].values.T
        floor = float(height[np.abs(along - pose["swing"].values[0]).argmin()])
    hip = np.array([hip[0], max(hip[1], floor + HIP_HEIGHT * leg_size(pose))])
    joints = [pose[name].values for name in ("swing_knee", "swing") if name in pose]
    swing, turned = above_ground(np.stack([hip, *joints]), floor, radius)
    angles["swing"] += turned
    legs = {"stance": np.stack([hip, pose["stance"].values]), "swing": swing}
    for name, colour, order in (("stance", INK, 3), ("swing", SWING, 4)):
        leg, end, bone = legs[name], legs[name][-1], {"color": colour, "lw": 3, "zorder": order}
        joint = {"color": colour, "mec": "white", "zorder": order + 2}
        draw(leg, solid_capstyle="round", **bone)
        if radius:
            down = lambda turn: np.stack([np.sin(turn), -np.cos(turn)], axis=-1)
            draw(end + radius * down(angles[name] + np.linspace(-0.6, 0.6, 40)), **bone)
            draw(np.stack([end, end + radius * down(angles[name])]), **bone)
        else:
            draw(leg[-1:], "o", ms=6, **joint)
        if len(leg) > 2:
            draw(leg[1:-1], "o", ms=7, **joint)
    draw(hip[None], "o", color=INK, mec="white", mew=1.2, ms=14, zorder=7)
    return lines


def above_ground(
    leg: Float[np.ndarray, "joints 2"], floor: float, radius: float
) -> tuple[Float[np.ndarray, "joints 2"], float]:
    """Return a swing leg as it is drawn, from hip to centre of the foot's arc, and its turn.

    Models let the swing leg pass through the ground. There it is drawn shorter; where it would be
    much shorter, as in falls, it is also turned outwards, until its foot lies on the ground.
    """
    places = (leg - leg[0]) @ np.array([1, 1j])  # from the hip
    end, deepest = complex(places[-1]), floor + radius - leg[0, 1]
    if end.imag >= deepest:
        return leg, 0.0
    deepest = min(deepest, 0.0)
    change = complex(deepest / end.imag)
    if change.real < SHORTEST:
        along = np.sqrt((SHORTEST * abs(end)) ** 2 - deepest**2)
        change = complex(np.copysign(along, end.real), deepest) / end
    moved = places * change
    joints = leg[0] + np.stack([moved.real, moved.imag], axis=1)
    return np.maximum(joints, [-np.inf, floor]), float(np.angle(change))


def to_level(places: Float[np.ndarray, "*n 2"], slope: float) -> Float[np.ndarray, "*n 2"]:
    """Turn places along the slope and normal to it until the horizontal is level."""
    c, s = np.cos(slope), np.sin(slope)
    return places @ np.array([[c, -s], [s, c]])


def write_part_names(ax: Axes, pose: xr.Dataset) -> None:
    """Write the names of the parts of the model beside one of its poses."""
    slope = float(pose.attrs["walker_slope"])
    foot, hip = (to_level(pose[name].values, slope) for name in ("stance", "hip"))
    theta, phi = float(pose["theta"]), float(pose["phi"])
    leg, length, radius = leg_size(pose), pose.attrs["leg_length"], pose.attrs["foot_radius"]
    up = to_level(np.array([0.0, 0.9 * length]), slope)
    ax.plot(*np.stack([foot, foot + up]).T, color=GROUND, lw=0.8, ls=(0, (5, 4)), zorder=2)
    upright, down = 90 - np.degrees(slope), 270 - np.degrees(slope)
    hanging = down + np.degrees(theta - phi)
    for middle, size, begin, end, symbol, away in (
        (foot, 0.72, upright, upright + np.degrees(theta), r"$\theta$", (13, -3)),
        (hip, 0.5, hanging, down + np.degrees(theta), r"$\phi$", (2, -10)),
    ):
        wide, half = 2 * size * length, np.radians((begin + end) / 2)
        x, y = middle
        ax.add_patch(Arc((x, y), wide, wide, theta1=begin, theta2=end, lw=1, zorder=8))
        at = middle + wide / 2 * np.array([np.cos(half), np.sin(half)])
        write_beside(ax, symbol, at, away, ha="center", va="center", fontsize="large")
    # The paper's model has legs without mass, and point feet.
    paper = radius == 0 and "swing_knee" not in pose
    for words, place, shift in (
        ("hip" + ", mass $M$" * paper, hip, (13, 6)),
        ("foot" + ", mass $m$" * paper, foot - [0, radius], (9, -13)),
        ("leg" + ", length $l$" * paper, (foot + hip) / 2, (10, 0)),
    ):
        write_beside(ax, words, place, shift, va="center")
    write_beside(ax, f"slope $\\gamma$ = {slope:g}", (-0.6 * leg, -0.13 * leg), (0, 0))
    look: Any = {"arrowprops": {"arrowstyle": "->"}, "ha": "center", "fontsize": "large"}
    ax.annotate("$g$", (0.9, 0.45), (0.9, 0.67), "axes fraction", "axes fraction", **look)
