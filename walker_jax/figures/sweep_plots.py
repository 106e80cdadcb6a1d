"""Pictures over parameters of a walker: sizes of basins, and the shares that attractors have."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from walker_jax.figures import layout, text
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish
from walker_jax.figures.style import BASINS, INK, LONGER, OTHERS, PERIODS, TITLE, period_style
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

EVENT: dict[str, Any] = {"color": OTHERS, "lw": 0.8, "ls": ":"}
"""Line style of a bifurcation."""


def sweep(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw what `walker_jax.sweep` returns: the basin's area or volume over one or two parameters.

    Over one, with its error. Parameters after the second are at their first values.
    """
    ax = begin(ax, style, data, "sweep", 7, 4.8)
    others = [str(name) for name in data["total_area"].dims[2:]]
    sizes = data[["total_area", "total_area_error"]].isel(dict.fromkeys(others, 0))
    sizes = sizes.sortby(list(sizes["total_area"].dims))  # values may come in any order
    area, error = sizes["total_area"], sizes["total_area_error"]
    solid = data["fate"].ndim == data["total_area"].ndim + 3
    words = text.known_label(data, text.VOLUME_LABEL if solid else text.AREA_LABEL)
    x, y, bar = str(area.dims[0]), words, None
    if area.ndim == 1:
        ax.errorbar(area[x], area, error, fmt="o-", ms=5, color=BASINS[0], capsize=3)
        layout.show_from_zero(ax, area[x].values.astype(float))
    else:
        y = str(area.dims[1])
        image = ax.pcolormesh(area[x], area[y], area.T, cmap="viridis", rasterized=True)
        bar = image, words
        if min(area.shape) > 1:  # cells at the ends reach beyond the values
            ax.set(xlim=area[x].values[[0, -1]], ylim=area[y].values[[0, -1]])
    fixed = text.parameter_values({name: float(data[name][0]) for name in others})
    shape = " × ".join(map(str, data["total_area"].shape))
    failed = int(data["failed"].sum())
    note = text.join_phrases([f"{shape} basins", *fixed, *[f"{failed} failed"] * (failed > 0)])
    return finish(ax, style, text.walker_title(data), note, x=x, y=y, bar=bar)


def basin_fractions(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.continue_basins` returns: fractions of the basins over a parameter.

    Fractions are stacked, with 95 % intervals as bars; walkers fail from the rest of the region.
    The upper panel has the first coordinate of the attractors at the start of each stride; dotted
    lines are the bifurcations of their branches.
    """
    check_dataset(data, "basin fractions")
    figure, (above, below) = layout.new_panels(7.4, 6.4, 2, 1, sharex=True)
    value, periods = data["value"].values, data["period"].values.tolist()
    colours, states = colours_of(periods), data["states"].isel(coordinate=0).values
    for i, colour in enumerate(colours):
        above.plot(value, states[:, i], "o", ms=2.5, color=colour)
    events = data["event_value"].values
    inside = events[(events >= value[0]) & (events <= value[-1])]
    for at in inside.tolist():
        above.axvline(at, **EVENT)
    layout.name_axes(above, y=names_in(data, "section")[0])
    above.set_title("Attractors", **TITLE)
    ends = np.stack([data[f"fraction_{end}"].values.T for end in ("low", "high")])
    draw_stack(below, value, np.nan_to_num(data["fraction"].values), ends, colours)
    layout.name_axes(below, str(data.attrs["parameter"]), "fraction of the region")
    below.set(xlim=value[[0, -1]], ylim=(0, None))
    below.set_title("Basins", **TITLE)
    handles: list[Any] = [
        Patch(color=colour, label=f"{i}: " + (f"period {n}" if n else "no period"))
        for i, (colour, n) in enumerate(zip(colours, periods, strict=True))
    ]
    if len(inside):
        handles.append(Line2D([], [], label="bifurcation", **EVENT))
    layout.figure_legend(figure.axes, handles)
    count = text.count_noun(data.sizes["attractor"], "attractor")
    layout.figure_title(figure, f"{text.walker_title(data)}, {count}")
    return figure


def colours_of(periods: Sequence[int]) -> list[str]:
    """Return a colour for each attractor: the colour of its period for the first one with it.

    The others, and those without a period, take the remaining colours, and then share one.
    """
    first = {period: i for i, period in reversed([*enumerate(periods)]) if period}
    own = {i: period_style(period)[0] for period, i in first.items()}
    left = [colour for colour, _ in PERIODS[1:] if colour not in own.values()]
    others = [i for i in range(len(periods)) if i not in own]
    own |= dict(zip(others, left, strict=False))
    return [own.get(i, LONGER[0]) for i in range(len(periods))]


def draw_stack(
    ax: Axes, value: np.ndarray, shares: np.ndarray, ends: np.ndarray, colours: list[str]
) -> None:
    """Draw stacked shares, constant around each value, halfway to its neighbours.

    Bars at the top of each share are from the lower to the upper one of its `ends`.
    """
    edges = np.concatenate([value[:1], (value[:-1] + value[1:]) / 2, value[-1:]])
    base = np.zeros(len(value))
    for share, low, high, colour in zip(shares.T, *ends, colours, strict=True):
        ax.stairs(base + share, edges, baseline=base, fill=True, color=colour)
        base, own = base + share, share > 0
        errors = np.maximum([share - low, high - share], 0)[:, own]
        look: Any = {"fmt": "none", "ecolor": INK, "elinewidth": 0.8, "zorder": 3}
        ax.errorbar(value[own], base[own], errors, **look)
