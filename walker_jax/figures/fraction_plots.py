"""Attractors over a parameter, and the fractions of a region that converge to them."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from walker_jax.figures.layout import figure_legend, figure_title, name_axes
from walker_jax.figures.style import LONGER, OTHERS, PERIODS, TITLE
from walker_jax.figures.text import count_noun, walker_title
from walker_jax.storage.schema import check_dataset

COLOURS = [colour for colour, _ in (*PERIODS, LONGER)]
"""Colours of the attractors, in the order of their numbers, and of all further ones."""


def basin_fractions(data: xr.Dataset) -> Figure:
    """Fractions of the basins over a parameter, stacked, with the attractors above.

    Above, the first coordinate of the attractors at the start of each stride; dotted lines are the
    bifurcations of their branches. Walkers fail from the rest of the region.

    **Arguments:**

    - `data`: what `walker_jax.continue_basins` returns.

    **Returns** the figure, of 7.4 by 6.4 inches. Raises `ValueError` for another data set.
    """
    check_dataset(data, "basin fractions")
    figure = Figure(figsize=(7.4, 6.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    value, count = data["value"].values, data.sizes["attractor"]
    colours = [COLOURS[min(i, len(COLOURS) - 1)] for i in range(count)]
    states = data["states"].isel(coordinate=0).values
    for i, colour in enumerate(colours):
        above.plot(value, states[:, i], "o", ms=2.5, color=colour)
    inside = data["event_value"].values
    for at in inside[(inside >= value[0]) & (inside <= value[-1])].tolist():
        above.axvline(at, color=OTHERS, lw=0.8, ls=":")
    name_axes(above, y=str(data.attrs["section"][0]))
    above.set_title("Attractors", **TITLE)
    fractions = np.nan_to_num(data["fraction"].values)
    draw_steps(below, value, fractions, colours)
    name_axes(below, str(data.attrs["parameter"]))
    below.set_ylabel("fraction of the region")
    below.set(xlim=(value[0], value[-1]), ylim=(0, 1.1 * fractions.sum(axis=1).max() or None))
    below.set_title("Basins", **TITLE)
    periods = data["period"].values.tolist()
    handles = [
        Patch(color=colour, label=f"{i}: " + (f"period {n}" if n else "no period"))
        for i, (colour, n) in enumerate(zip(colours, periods, strict=True))
    ]
    figure_legend(figure, handles, columns=4)
    figure_title(figure, f"{walker_title(data)}, {count_noun(count, 'attractor')}", "large")
    return figure


def draw_steps(ax: Axes, value: np.ndarray, shares: np.ndarray, colours: list[str]) -> None:
    """Stacked shares, constant about each value, halfway to its neighbours."""
    middle = (value[:-1] + value[1:]) / 2
    edges = np.concatenate([value[:1], middle, value[-1:]])
    base = np.zeros(len(value))
    for share, colour in zip(shares.T, colours, strict=True):
        ax.stairs(base + share, edges, baseline=base, fill=True, color=colour)
        base = base + share
