"""Pictures of walking on rough ground."""

from typing import Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from walker_jax.figures.layout import DrawnAxes, Style, axes_for, figure_of, finish
from walker_jax.figures.text import walker_title
from walker_jax.storage.schema import check_dataset

PIXELS, PARTS = 120, 8
"""Pixels of the picture along each side; parts of a cell along each edge, to avoid stripes."""
FAINTEST = 1e-6
"""Chance, relative to the largest one, below which a pixel is empty."""


def metastability(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the quasi-stationary distribution: where walks that still last are on the section.

    The axes are theta and theta + thetadot, as for basins; on rough ground the third direction is
    summed over. Colours show chance on a logarithmic scale.

    **Arguments:**

    - `data`: what `walker_jax.steps_to_fall` by cells returns.
    - `ax`: where to draw; by default, on a new figure of 6.4 by 5.2 inches.
    - `style`: which words to draw, as in `Style`.

    Raises `ValueError` for another data set.
    """
    check_dataset(data, "metastable walking")
    ax = axes_for(ax, style, 6.4, 5.2)
    edges, chance = data["edges"].values, data["chance"].values
    seen = chance > FAINTEST * chance.max()
    shares = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    parts = np.stack(np.meshgrid(*[shares] * len(edges)), axis=-1).reshape(-1, len(edges)) @ edges
    points = data["centre"].values[seen][:, None] + parts
    theta, thetadot = points[..., 0].ravel(), points[..., 1].ravel()
    weights = np.repeat(chance[seen] / len(parts), len(parts))
    sums, *edges = np.histogram2d(theta, theta + thetadot, PIXELS, weights=weights)
    highest = sums.max()
    image = ax.pcolormesh(
        *edges,
        np.ma.masked_less(sums.T, FAINTEST * highest),
        norm=LogNorm(FAINTEST * highest, highest),
        cmap="viridis_r",
        rasterized=True,
    )
    mean, error = float(data["mean_strides"]), 1.96 * float(data["mean_strides_error"])
    bar = figure_of(ax).colorbar(image, ax=ax)
    bar.set_label("chance of each pixel")
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=f"a fall after {mean:,.4g} ± {error:,.2g} strides on average",
        x="theta",
        y="sum",
        beside=[bar.ax],
    )
