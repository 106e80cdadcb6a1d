"""Charts of two parameters: periods of attractors behind curves of bifurcations."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from walker_jax.figures.layout import DrawnAxes, Style, axes_for, cell_edges, finish
from walker_jax.figures.style import INK, PERIODS, SIGNS, SMALL, period_style
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.gaits.charts import NO_GAIT, words_in
from walker_jax.gaits.normal_forms import SUBCRITICAL, criticality
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, names_in

TINTS = 0.05, 0.85, 0.825, 0.7, 0.65, 0.775, 0.55, 0.6
"""Share of each period's colour in the tint of its cells; the rest is white."""
NO_PERIOD, FALLS = "#787878", "#fbe6c0"
"""Colours of cells without a period or with a longer one, and with falls."""
EMPTY: dict[str, Any] = {"facecolor": "white", "hatch": "xxx", "edgecolor": "#b0b0b0"}
"""Cells without a gait: crossed lines, as no further colour is apart from all others."""
CASING = [withStroke(linewidth=3.5, foreground="white")]
"""White on both sides of curves, as cells may have nearly their colour."""
NOT_KNOWN = SIGNS[Outcome.UNDECIDED][0]
"""Colour of cells where the integration gave no answer."""
KINDS: dict[str, dict[str, Any]] = {
    "fold": {"ls": "-", "lw": 2.0},
    "doubling": {"ls": "-", "lw": 1.4},
    "neimark-sacker": {"ls": (0, (5, 2)), "lw": 1.6},
    "branch point": {"ls": (0, (1, 1.5)), "lw": 1.6},
}
"""Line styles of bifurcations."""
WORDS = {
    "fold": "fold",
    "doubling": "period doubling",
    "neimark-sacker": "Neimark-Sacker",
    "branch point": "branch point",
}
CIRCLES: dict[str, Any] = {"marker": "o", "ms": 3, "mfc": "white", "mew": 0.9}
"""Circles along the subcritical part of a curve."""
SPECIAL: dict[str, Any] = {
    "marker": "D",
    "ms": 5.5,
    "mfc": "white",
    "mec": INK,
    "mew": 1.2,
    "ls": "",
}
"""Markers of points of codimension two."""


def chart(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw attractors and curves of bifurcations over two parameters.

    The tint of a cell shows the period of its attractor. The colour of a curve shows the period of
    the gait that bifurcates, and its line style the kind of bifurcation. Circles mark subcritical
    parts. Diamonds are points of codimension two.

    **Arguments:**

    - `data`: what `walker_jax.chart` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.8 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "chart")
    ax = axes_for(ax, style, 7, 5.8)
    axes = data["first"].values, data["second"].values
    periods = draw_cells(ax, data)
    drawn = draw_lines(ax, data)
    draw_special(ax, data, style.get("labels", True))
    ax.set(xlim=cell_edges(axes[0]), ylim=cell_edges(axes[1]))
    first, second = data["parameter"].values.tolist()
    counts = {"curve": data.sizes["line"], "codimension-two point": data.sizes["special"]}
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: {first.replace('_', ' ')} and {second.replace('_', ' ')}",
        note=", ".join(count_noun(n, noun) for noun, n in counts.items() if n),
        x=first,
        y=second,
        legend=[*periods, *drawn],
    )


def tinted(period: int) -> tuple[float, ...]:
    """Return the colour of a period, mixed with white."""
    return tuple(1 - TINTS[period - 1] * (1 - part) for part in to_rgb(period_style(period)[0]))


def draw_cells(ax: Axes, data: xr.Dataset) -> list[Patch]:
    """Colour the cells; return their legend handles."""
    fate, period = data["cell_fate"].values, data["cell_period"].values
    walks = fate == Outcome.STRIDE
    image = np.full((*fate.shape, 3), to_rgb(FALLS))
    undecided = fate == Outcome.UNDECIDED
    image[undecided] = to_rgb(NOT_KNOWN)
    handles = []
    for number in range(1, len(PERIODS) + 1):
        cells = walks & (period == number)
        if cells.any():
            image[cells] = tinted(number)
            handles.append(Patch(fc=tinted(number), ec=INK, lw=0.3, label=f"period {number}"))
    others = walks & ((period == 0) | (period > len(PERIODS)))
    image[others] = to_rgb(NO_PERIOD)
    fails = "falls" if "theta" in names_in(data, "section") else "fails"
    further = (
        ("no or a longer period", others, NO_PERIOD),
        (fails, ~walks & ~undecided & (fate != NO_GAIT), FALLS),
        ("undecided", undecided, NOT_KNOWN),
    )
    for name, cells, colour in further:
        if cells.any():
            handles.append(Patch(fc=colour, ec=INK, lw=0.3, label=name))
    without = fate == NO_GAIT
    edges = [cell_edges(data[name].values) for name in ("first", "second")]
    if without.any():
        corners = [np.linspace(*ends, n + 1) for ends, n in zip(edges, without.shape, strict=True)]
        shown = np.ma.masked_where(~without.T, np.ones(without.T.shape))
        look = {"hatch": EMPTY["hatch"], "edgecolors": EMPTY["edgecolor"], "linewidth": 0}
        ax.pcolor(*corners, shown, cmap=ListedColormap([EMPTY["facecolor"]]), zorder=2, **look)
        handles.append(Patch(**EMPTY, lw=0.3, label="no gait"))
    ax.imshow(
        image.swapaxes(0, 1),
        origin="lower",
        extent=(*edges[0], *edges[1]),
        aspect="auto",
        interpolation="nearest",
        zorder=1,
    )
    return handles


def draw_lines(ax: Axes, data: xr.Dataset) -> list[Line2D]:
    """Draw the curves; return their legend handles."""
    kinds, periods = words_in(data, "line_kind"), data["line_period"].values.tolist()
    seen: set[tuple[str, bool]] = set()
    for number, (kind, period) in enumerate(zip(kinds, periods, strict=True)):
        own = data["curve"].values == number
        x, y = data["curve_value"].values[own].T
        coefficients = data["curve_coefficient"].values[own].tolist()
        subcritical = np.array([criticality(kind, one) == SUBCRITICAL for one in coefficients])
        colour = period_style(period)[0]
        ax.plot(x, y, color=colour, zorder=4, path_effects=CASING, **KINDS[kind])
        if subcritical.any():
            part = x[subcritical], y[subcritical]
            ax.plot(*part, color=colour, ls="", zorder=5, markevery=3, **CIRCLES)
        seen |= {(kind, bool(some)) for some in subcritical.tolist()} | {(kind, False)}
    return [
        Line2D([], [], color=INK, label=WORDS[kind] + ", subcritical" * some, **sign_of(kind, some))
        for kind in KINDS
        for some in (False, True)
        if (kind, some) in seen
    ]


def sign_of(kind: str, subcritical: bool) -> dict[str, Any]:
    """Return the line style of a curve, with circles if it is subcritical."""
    return KINDS[kind] | (CIRCLES if subcritical else {})


def draw_special(ax: Axes, data: xr.Dataset, labels: bool) -> None:
    """Draw the points of codimension two, with their names."""
    values = data["special_value"].values
    ax.plot(*values.T, zorder=7, **SPECIAL)
    names = words_in(data, "special_kind") if labels else []
    middle = data["first"].values.mean()
    for name, (x, y) in zip(names, values.tolist(), strict=labels):
        left = x > middle
        ax.annotate(
            name.removesuffix(" resonance"),
            (x, y),
            (-7 if left else 7, 4),
            textcoords="offset points",
            ha="right" if left else "left",
            fontsize=SMALL,
            zorder=8,
            bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.8},
        )
