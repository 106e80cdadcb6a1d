"""Lyapunov exponents over a parameter."""

from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from walker_jax.checks import WrongUse
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import BASINS, INK
from walker_jax.figures.text import walker_title
from walker_jax.storage.schema import check_dataset

DEEPEST = 4.0
"""Depth below zero of the lowest exponent that is drawn, in units of the highest, or of a half if
that is larger: at a superstable gait the lowest exponents have no bound."""


def lyapunov_exponents(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw Lyapunov exponents of the attractor against a parameter, with their error bands.

    Bands are twice the standard error on each side. Walking is chaotic where the first exponent is
    above zero. Nothing is drawn where no walker walks.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set without exponents.
    """
    check_dataset(data, "bifurcation diagram")
    if "exponents" not in data:
        raise WrongUse("data must have exponents: give bifurcation_diagram a number of strides")
    ax = axes_for(ax, style, 7, 4.6)
    value = data["sample_value"].values
    found, errors = data["exponents"].values, data["exponent_errors"].values
    ax.axhline(0, color=INK, lw=0.8, zorder=1)
    handles = []
    for i in range(found.shape[1]):
        colour = BASINS[i % len(BASINS)]
        low, high = found[:, i] - 2 * errors[:, i], found[:, i] + 2 * errors[:, i]
        ax.fill_between(value, low, high, color=colour, alpha=0.3, lw=0, zorder=2)
        handles += ax.plot(value, found[:, i], color=colour, lw=1, label=ordinal(i), zorder=3)
    known = found[np.isfinite(found)]
    if len(known):
        top = max(float(known.max()), 0.05)
        ax.set_ylim(max(float(known.min()), -DEEPEST * max(top, 0.5)) * 1.05, 1.25 * top)
        ax.set_xlim(value.min(), value.max())
    positive = np.flatnonzero(found[:, 0] > 2 * errors[:, 0])
    where = value[positive[0]] if len(positive) else np.nan
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: Lyapunov exponents",
        note=f"the first is above zero from {where:.5f}" if len(positive) else "none is above zero",
        x=str(data.attrs["parameter"]),
        y="exponent (1/stride)",
        legend=handles,
    )


def ordinal(i: int) -> str:
    """Return the place of an exponent, in words."""
    return ("first", "second", "third")[i] if i < 3 else f"{i + 1}th"
