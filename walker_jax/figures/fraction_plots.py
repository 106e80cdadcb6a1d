"""Attractors over a parameter, and the fractions of a region that converge to them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from walker_jax.figures.layout import figure_legend, figure_title, name_axes, new_figure
from walker_jax.figures.style import INK, LONGER, OTHERS, PERIODS, TITLE, period_style
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

EVENT: dict[str, Any] = {"color": OTHERS, "lw": 0.8, "ls": ":"}
"""Line style of a bifurcation."""


def basin_fractions(data: xr.Dataset) -> Figure:
    """Draw fractions of the basins over a parameter, stacked, with the attractors above.

    Bars are 95 % intervals.

    The upper panel has the first coordinate of the attractors at the start of each stride; dotted
    lines are the bifurcations of their branches. Walkers fail from the rest of the region.

    **Arguments:**

    - `data`: what `walker_jax.continue_basins` returns.

    **Returns** the figure, of 7.4 by 6.4 inches. Raises `ValueError` for another data set.
    """
    check_dataset(data, "basin fractions")
    figure = new_figure(7.4, 6.4)
    above, below = figure.subplots(2, 1, sharex=True)
    value, count = data["value"].values, data.sizes["attractor"]
    periods = data["period"].values.tolist()
    colours = colours_of(periods)
    states = data["states"].isel(coordinate=0).values
    for i, colour in enumerate(colours):
        above.plot(value, states[:, i], "o", ms=2.5, color=colour)
    events = data["event_value"].values
    inside = (events >= value[0]) & (events <= value[-1])
    for at in events[inside].tolist():
        above.axvline(at, **EVENT)
    name_axes(above, y=names_in(data, "section")[0])
    above.set_title("Attractors", **TITLE)
    fractions = np.nan_to_num(data["fraction"].values)
    ends = np.stack([data[f"fraction_{end}"].values.T for end in ("low", "high")])
    draw_steps(below, value, fractions, ends, colours)
    name_axes(below, str(data.attrs["parameter"]))
    below.set_ylabel("fraction of the region")
    below.set(
        xlim=(value[0], value[-1]), ylim=(0, 1.02 * float(np.nansum(ends[1], axis=0).max()) or None)
    )
    below.set_title("Basins", **TITLE)
    handles: list[Artist] = [
        Patch(color=colour, label=f"{i}: " + (f"period {n}" if n else "no period"))
        for i, (colour, n) in enumerate(zip(colours, periods, strict=True))
    ]
    if inside.any():
        handles.append(Line2D([], [], label="bifurcation", **EVENT))
    figure_legend(figure, handles)
    figure_title(figure, f"{walker_title(data)}, {count_noun(count, 'attractor')}", "large")
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


def draw_steps(
    ax: Axes, value: np.ndarray, shares: np.ndarray, ends: np.ndarray, colours: list[str]
) -> None:
    """Draw stacked shares, constant around each value, halfway to its neighbours.

    Bars at the top of each share are from the lower to the upper one of its `ends`.
    """
    middle = (value[:-1] + value[1:]) / 2
    edges = np.concatenate([value[:1], middle, value[-1:]])
    base = np.zeros(len(value))
    for share, colour in zip(shares.T, colours, strict=True):
        ax.stairs(base + share, edges, baseline=base, fill=True, color=colour)
        base = base + share
    base = np.zeros(len(value))
    for share, low, high in zip(shares.T, *ends, strict=True):
        base, own = base + share, share > 0
        errors = np.maximum([share - low, high - share], 0)[:, own]
        ax.errorbar(value[own], base[own], errors, fmt="none", ecolor=INK, elinewidth=0.8)
