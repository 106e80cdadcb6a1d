"""Charts of two parameters: periods of attractors behind curves of bifurcations."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_hex, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from walker_jax.figures import regions
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish, write_beside
from walker_jax.figures.style import INK, PERIODS, SIGNS, period_style
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.gaits.charts import NO_GAIT, words_in
from walker_jax.gaits.normal_forms import SUBCRITICAL, criticality
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
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "fold": ("fold", {"ls": "-", "lw": 2.0}),
    "doubling": ("period doubling", {"ls": "-", "lw": 1.4}),
    "neimark-sacker": ("Neimark-Sacker", {"ls": (0, (5, 2)), "lw": 1.6}),
    "branch point": ("branch point", {"ls": (0, (1, 1.5)), "lw": 1.6}),
}
"""Words and line styles of bifurcations."""
CIRCLES: dict[str, Any] = {"marker": "o", "ms": 3, "mfc": "white", "mew": 0.9}
"""Circles along the subcritical part of a curve."""
SPECIAL: dict[str, Any] = {"marker": "D", "ms": 5.5, "mfc": "white", "mec": INK, "mew": 1.2}
"""Markers of points of codimension two."""
SAME_POINT = 1e-3
"""Distance, as a share of the axes, within which two points of a kind are one."""


def chart(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw what `walker_jax.chart` returns: attractors, and curves of bifurcations.

    The tint of a cell shows the period of its attractor. The colour of a curve shows the period of
    the gait that bifurcates, and its line style the kind of bifurcation. Circles mark subcritical
    parts. Diamonds are points of codimension two.
    """
    ax = begin(ax, style, data, "chart", 7, 5.8)
    handles: list[Any] = [*draw_cells(ax, data), *draw_lines(ax, data)]
    special, middle = special_points(data), float(data["first"].mean())
    box = {"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.8}
    for kind, place in special:
        ax.plot(*place, zorder=7, ls="", **SPECIAL)
        shift, side = ((-7, 4), "right") if place[0] > middle else ((7, 4), "left")
        if style.get("labels", True):
            words = kind.removesuffix(" resonance")
            write_beside(ax, words, place, shift, ha=side, zorder=8, bbox=box)
    x, y = data["parameter"].values.tolist()
    counts = {"curve": data.sizes["line"], "codimension-two point": len(special)}
    title = f"{walker_title(data)}: {x.replace('_', ' ')} and {y.replace('_', ' ')}"
    note = ", ".join(count_noun(n, noun) for noun, n in counts.items() if n)
    return finish(ax, style, title, note, x=x, y=y, legend=handles)


def tinted(period: int) -> str:
    """Return the colour of a period, mixed with white."""
    share, (colour, _) = TINTS[period - 1], period_style(period)
    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return to_hex((red, green, blue))


def draw_cells(ax: Axes, data: xr.Dataset) -> list[Patch]:
    """Colour the cells; return their legend handles."""
    fate, period, most = data["cell_fate"].values, data["cell_period"].values, len(PERIODS)
    walks, undecided, without = (fate == one for one in (0, Outcome.UNDECIDED, NO_GAIT))
    fails = "falls" if "theta" in names_in(data, "section") else "fails"
    kinds = [(f"period {n}", tinted(n), walks & (period == n)) for n in range(1, most + 1)] + [
        ("no or a longer period", NO_PERIOD, walks & ((period == 0) | (period > most))),
        (fails, FALLS, ~walks & ~undecided & ~without),
        ("undecided", NOT_KNOWN, undecided),
    ]
    found = [
        regions.Region(cells, colour, "", words) for words, colour, cells in kinds if cells.any()
    ]
    image = regions.paint(found, fate.shape)
    image[without] = 255
    regions.show_image(ax, image, data["cell_fate"], interpolation="nearest", zorder=1)
    handles = [*map(regions.patch_of, found)]
    if without.any():
        shown = np.ma.masked_where(~without.T, np.ones(without.T.shape))
        look: Any = {"hatch": EMPTY["hatch"], "edgecolors": EMPTY["edgecolor"], "linewidth": 0}
        look |= {"cmap": ListedColormap([EMPTY["facecolor"]]), "shading": "nearest"}
        ax.pcolor(*(data[one] for one in data["cell_fate"].dims), shown, zorder=2, **look)
        handles.append(Patch(**EMPTY, lw=0.5, label="no gait"))
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
        ax.plot(x, y, color=colour, zorder=4, path_effects=CASING, **KINDS[kind][1])
        if subcritical.any():
            part = x[subcritical], y[subcritical]
            ax.plot(*part, color=colour, ls="", zorder=5, markevery=3, **CIRCLES)
        seen |= {(kind, bool(some)) for some in subcritical.tolist()} | {(kind, False)}
    return [
        Line2D([], [], color=INK, label=words + ending, **look | circles)
        for kind, (words, look) in KINDS.items()
        for some, ending, circles in ((False, "", {}), (True, ", subcritical", CIRCLES))
        if (kind, some) in seen
    ]


def special_points(data: xr.Dataset) -> list[tuple[str, np.ndarray]]:
    """Return kinds and places of points of codimension two; one that two curves share, once."""
    apart = SAME_POINT * np.array([np.ptp(data[axis].values) for axis in ("first", "second")])
    found: list[tuple[str, np.ndarray]] = []
    kinds = words_in(data, "special_kind")
    for kind, place in zip(kinds, data["special_value"].values, strict=True):
        if not any(kind == one and (abs(place - at) < apart).all() for one, at in found):
            found.append((kind, place))
    return found
