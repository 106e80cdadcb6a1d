"""Pictures of walking on rough ground."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from walker_jax.figures.layout import figure_title, name_axes
from walker_jax.figures.style import SMALL
from walker_jax.figures.text import walker_title
from walker_jax.storage.schema import check_dataset

PIXELS, PARTS = 120, 8
"""Of the picture along each side; and of a cell along each edge, so that it leaves no stripes."""
FAINTEST = 1e-6
"""Chance, over the largest one, below which a pixel is empty."""


def metastability(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The quasi-stationary distribution: where walks that still last are on the section.

    Over theta and theta + thetadot, as basins are; of rough ground, summed over the third
    direction. Its contours are those of chance, on a logarithmic scale.

    **Arguments:**

    - `data`: what `walker_jax.metastability` returns.
    - `ax`: where to draw, by default on a figure of its own.

    Raises `ValueError` for another data set.
    """
    check_dataset(data, "metastable walking")
    if ax is None:
        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        ax = figure.subplots()
        figure_title(figure, walker_title(data), 12)
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
    name_axes(ax, "theta", "sum")
    mean, error = float(data["mean_strides"]), 1.96 * float(data["mean_strides_error"])
    ax.set_title(f"a fall after {mean:,.4g} ± {error:,.2g} strides on average", fontsize=SMALL)
    bar = ax.figure.colorbar(image, ax=ax)
    bar.set_label("chance that a walk that lasts is here, of each pixel", fontsize=SMALL)
    return ax
