"""Pictures of proved basins."""

from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch

from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import BASINS, INK
from walker_jax.figures.text import walker_title
from walker_jax.storage.schema import check_dataset

FATES = {
    1: ("walks for ever", BASINS[0]),
    0: ("open", INK),
    -1: ("falls", "0.85"),
}
"""Words and colour of a cell, by what is proved of it."""
EDGE = 64
"""Number of points along the border of the trap, and of the disc proved."""


def proof(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the cells that are proved to walk for ever, or to fall, the trap, and the disc proved.

    **Arguments:**

    - `data`: what `walker_jax.prove_basin` returns. The first axis is drawn along the x axis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "proof")
    ax = axes_for(ax, style, 7, 5.4)
    low, high = data["lower"].values, data["upper"].values
    width = (high - low) / data["count"].values / 2.0 ** data["level"].values[:, None]
    corner = low + data["place"].values * width
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    patches = []
    for fate, (words, colour) in FATES.items():
        some = data["proved"].values == fate
        if some.any():
            corners = corner[some, None] + square * width[some, None]
            ax.add_collection(PolyCollection([*corners], facecolors=colour, linewidths=0))
            patches.append(Patch(color=colour, label=words))
    trap = round_trap(data, np.linalg.inv(data["trap_factor"].values.T) * float(data["trap_size"]))
    curves = {"trap": (trap, "-")}
    if data.attrs["radius"]:
        around = round_trap(data, np.eye(len(low)) * data.attrs["radius"])
        curves[f"starts within {data.attrs['radius']:.7g} of the gait"] = around, "--"
    marks = []
    for words, (curve, dashes) in curves.items():
        ax.plot(*curve.T, color="white", lw=1.8)
        marks += ax.plot(*curve.T, dashes, color=INK, lw=0.9, label=words)
    gait = round_trap(data, np.zeros((len(low), len(low))))[:1]
    marks += ax.plot(*gait.T, "o", ls="", ms=4, color=INK, mec="white", label="gait")
    seen = np.concatenate([low[None], high[None], trap])
    beyond = 0.03 * np.ptp(seen, axis=0)
    (left, bottom), (right, top) = seen.min(axis=0) - beyond, seen.max(axis=0) + beyond
    ax.set(xlim=(left, right), ylim=(bottom, top))
    x, y = data["axis"].values.tolist()
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=proof_note(data),
        x=x,
        y=y,
        legend=[*patches, *marks],
    )


def round_trap(data: xr.Dataset, shape: np.ndarray) -> np.ndarray:
    """Return points along the axes of the ellipse `centre + shape · circle` of states."""
    turn = np.linspace(0, 2 * np.pi, EDGE)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    states = data["trap_centre"].values[:, None] + shape @ circle
    return np.linalg.solve(data["shear"].values, states).T


def proof_note(data: xr.Dataset) -> str:
    """State the theorem, or the bounds on the area."""
    if data.attrs["all_walk"] and data.attrs["radius"]:
        return f"proved: all starts within {data.attrs['radius']:.7g} walk for ever"
    low, high = data.attrs["area_lower"], data.attrs["area_upper"]
    return f"proved: an area between {low:.6g} and {high:.6g} walks for ever"
