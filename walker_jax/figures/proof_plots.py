"""Pictures of proved basins."""

from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from walker_jax.figures.layout import DrawnAxes, Style, begin, finish, widened
from walker_jax.figures.style import BASINS, INK
from walker_jax.figures.text import walker_title

FATES = {
    1: ("walks for ever", BASINS[0]),
    0: ("open", INK),
    -1: ("falls", "0.85"),
}
"""Words and colour of a cell, by what is proved of it."""
EDGE = 64
"""Number of points along the border of the trap, and of the disc proved."""


def proof(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw what `walker_jax.prove_basin` returns: cells, the gait, the trap, and the disc proved.

    Cells are proved to walk for ever, or to fall, or are open.
    """
    ax = begin(ax, style, data, "proof")
    low, high = data["lower"].values, data["upper"].values
    width = (high - low) / data["count"].values / 2.0 ** data["level"].values[:, None]
    corner = low + data["place"].values * width
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for fate, (words, colour) in FATES.items():
        some = data["proved"].values == fate
        if some.any():
            corners = [*(corner[some, None] + square * width[some, None])]
            cells = PolyCollection(corners, facecolors=colour, linewidths=0, label=words)
            ax.add_collection(cells)
    factor, size = data["trap_factor"].values, float(data["trap_size"])
    curves = {"trap": (ellipse(data, size * np.linalg.inv(factor.T)), "-")}
    if radius := data.attrs["radius"]:
        around = ellipse(data, radius * np.eye(len(low)))
        curves[f"starts within {radius:.7g} of the gait"] = around, "--"
    for words, (curve, dashes) in curves.items():
        ax.plot(*curve.T, color="white", lw=1.8)
        ax.plot(*curve.T, dashes, color=INK, lw=0.9, label=words)
    gait = ellipse(data, np.zeros((len(low), len(low))))[0]
    ax.plot(*gait, "o", ls="", ms=7, color=INK, mec="white", label="gait")
    shown = np.concatenate([[low, high], *(curve for curve, _ in curves.values())])
    across, up = widened(np.stack([shown.min(axis=0), shown.max(axis=0)], axis=1), 0.03)
    x, y = data["axis"].values.tolist()
    # Where distances are those of the section, a disc is round.
    ax.set(xlim=across, ylim=up, aspect="equal" if radius and y != "sum" else "auto")
    note = f"proved: all starts within {radius:.7g} walk for ever"
    if not (data.attrs["all_walk"] and radius):
        low, high = data.attrs["area_lower"], data.attrs["area_upper"]
        note = f"proved: an area between {low:.6g} and {high:.6g} walks for ever"
    return finish(ax, style, walker_title(data), note, x=x, y=y)


def ellipse(data: xr.Dataset, shape: np.ndarray) -> np.ndarray:
    """Return points along the axes of the ellipse `gait + shape · circle` of states."""
    turn = np.linspace(0, 2 * np.pi, EDGE)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    states = data["trap_centre"].values[:, None] + shape @ circle
    return np.linalg.solve(data["shear"].values, states).T
