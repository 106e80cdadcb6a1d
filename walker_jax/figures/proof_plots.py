"""Pictures of proved basins."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch

from walker_jax.figures.layout import DrawnAxes, Shown, axes_for, dress
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
"""Number of points along the border of the trap."""


def proof(
    data: xr.Dataset,
    ax: Axes | None = None,
    *,
    title: bool | str = True,
    subtitle: bool = True,
    legend: bool = True,
    labels: bool = True,
) -> DrawnAxes:
    """Draw the cells that are proved to walk for ever, or to fall, and the trap.

    **Arguments:**

    - `data`: what `walker_jax.prove_basin` returns. The first axis is drawn along the x axis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.
    - `title`, `subtitle`, `legend`, `labels`: whether to draw these; a string replaces the title.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "proof")
    ax = axes_for(ax, 7, 5.4)
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
    edge = trap_edge(data)
    (line,) = ax.plot(*edge.T, color="white", lw=1.6)
    (line,) = ax.plot(*edge.T, color=INK, lw=0.8, label="trap")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    x, y = data["axis"].values.tolist()
    dress(
        ax,
        Shown(title, subtitle, legend, labels),
        title=walker_title(data),
        note=proof_note(data),
        x=x,
        y=y,
        legends=[([*patches, line], 2)],
    )
    return ax


def trap_edge(data: xr.Dataset) -> np.ndarray:
    """Return points of the trap's border, along the axes."""
    turn = np.linspace(0, 2 * np.pi, EDGE)
    circle = float(data["trap_size"]) * np.stack([np.cos(turn), np.sin(turn)])
    offsets = np.linalg.solve(data["trap_factor"].values.T, circle)
    states = data["trap_centre"].values[:, None] + offsets
    return np.linalg.solve(data["shear"].values, states).T


def proof_note(data: xr.Dataset) -> str:
    """State the theorem, or the bounds on the area."""
    if data.attrs["all_walk"] and data.attrs["radius"]:
        return f"proved: all starts within {data.attrs['radius']:.7g} walk for ever"
    low, high = data.attrs["area_lower"], data.attrs["area_upper"]
    return f"proved: an area between {low:.6g} and {high:.6g} walks for ever"
