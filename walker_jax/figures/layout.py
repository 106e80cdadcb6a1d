"""Places on a picture: its axes, their limits, the title above and the legends below."""

from typing import Literal, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.transforms import offset_copy

from walker_jax.figures.style import AXIS, NOTE, SMALL, TITLE
from walker_jax.figures.text import axis_label

BELOW, LINE = 40, 17
"""How far the legend stands below the axes, and its lines below one another (points)."""


def new_axes(
    width: float | int,
    height: float | int,
    layout: Literal["constrained", "compressed"] = "constrained",
) -> Axes:
    """The axes of a new figure, of a size in inches."""
    return Figure(figsize=(width, height), layout=layout).add_subplot()


def figure_of(ax: Axes) -> Figure:
    """The figure that axes are on."""
    return cast(Figure, ax.get_figure(root=True))


def cell_edges(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """The outer edges of equal cells."""
    half = (centres[-1] - centres[0]) / (len(centres) - 1) / 2
    return float(centres[0] - half), float(centres[-1] + half)


def padded_limits(values: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """The range of values, and a little more; none where there is but one."""
    beyond = 0.03 * np.ptp(values)
    return (values.min() - beyond, values.max() + beyond) if beyond else None


def name_axes(ax: Axes, x: str | None = None, y: str | None = None, size: int = AXIS) -> None:
    """Label axes with coordinates or parameters, or with words of their own."""
    if x is not None:
        ax.set_xlabel(axis_label(x), fontsize=size)
    if y is not None:
        ax.set_ylabel(axis_label(y), fontsize=size)


def write_title(ax: Axes, subject: str, note: str) -> None:
    """A title, and a line or more below it."""
    lines = note.count("\n")
    ax.set_title(subject, **TITLE | {"pad": TITLE["pad"] + 12 * lines})
    ax.annotate(note, (0, 1), (0, 7), "axes fraction", "offset points", fontsize=NOTE)


def place_legend(ax: Axes, handles: list, drop: int, *, columns: int) -> None:
    """A legend at the left, `drop` points below the axes."""
    if handles:
        legend = Legend(
            ax,
            handles,
            [handle.get_label() for handle in handles],
            loc="upper left",
            bbox_to_anchor=(0, 0),
            bbox_transform=offset_copy(ax.transAxes, figure_of(ax), y=-drop, units="points"),
            borderaxespad=0,
            borderpad=0,
            ncols=columns,
            frameon=False,
            fontsize=SMALL,
        )
        ax.add_artist(legend).set_clip_on(False)


def figure_legend(figure: Figure, handles: list, *, columns: int) -> None:
    """A legend at the left, below all axes of a figure."""
    place = "outside lower left"
    figure.legend(handles=handles, loc=place, ncols=columns, frameon=False, fontsize=SMALL)


def figure_title(figure: Figure, title: str, size: int = 14) -> None:
    """A title at the left, above all axes of a figure."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=size, fontweight="bold")
