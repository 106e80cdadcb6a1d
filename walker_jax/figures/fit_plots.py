"""Fits to recordings: samples with residuals, correlations of parameters, bands of basins."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.checks import WrongUse
from walker_jax.figures.layout import (
    DrawnAxes,
    Style,
    axes_for,
    cell_edges,
    figure_of,
    finish,
    new_figure,
)
from walker_jax.figures.style import BASINS, INK, OTHERS
from walker_jax.figures.text import walker_title
from walker_jax.grids import Grid
from walker_jax.storage.schema import check_dataset

SINCE = "time since heel strike"
LEVELS = 0.025, 0.5, 0.975
"""Shares of draws at the edges of the band of a basin, and in its middle: a band of 95 %."""


def fit(data: xr.Dataset) -> Figure:
    """Draw recorded and fitted coordinates over the time since heel strike, and the residuals.

    Steps lie over each other. The pictures are `fitted_samples` and `fit_residuals`.

    **Arguments:**

    - `data`: that of `walker_jax.fit`.

    **Returns** the figure, of 12 by 5 inches. Raises `ValueError` for another data set.
    """
    figure = new_figure(12, 5)
    left, right = figure.subplots(1, 2)
    fitted_samples(data, left)
    fit_residuals(data, right)
    return figure


def fitted_samples(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw recorded and fitted coordinates over the time since heel strike, all steps in one.

    **Arguments:**

    - `data`: that of `walker_jax.fit`.
    - `ax`: where to draw; by default, on a new figure of 6 by 5 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "fit")
    ax = axes_for(ax, style, 6, 5)
    handles, after = draw_columns(ax, data, "recorded")
    for k in range(data.sizes["column"]):
        lines = ax.plot(after.T, data["fitted"].values[..., k].T, lw=0.6, color=INK)
    lines[0].set_label("fitted")
    note = f"{data.sizes['step']} steps, recorded and fitted"
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=note,
        x=SINCE,
        y="coordinates",
        legend=[*handles, lines[0]],
    )


def fit_residuals(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw recorded less fitted coordinates, in standard deviations of their noise.

    **Arguments:**

    - `data`: that of `walker_jax.fit`.
    - `ax`: where to draw; by default, on a new figure of 6 by 5 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "fit")
    ax = axes_for(ax, style, 6, 5)
    handles, _ = draw_columns(ax, data, "residual")
    ax.axhline(0, lw=0.6, color=INK)
    squares, free = data.attrs["sum_of_squares"], data.attrs["degrees_of_freedom"]
    note = f"sum of squares {squares:.4g}, {free} degrees of freedom"
    title, y = "Residuals", "recorded less fitted, over the noise"
    return finish(ax, style, title=title, note=note, x=SINCE, y=y, legend=handles)


def draw_columns(
    ax: Axes, data: xr.Dataset, name: str
) -> tuple[list[Line2D], Float[np.ndarray, "steps samples"]]:
    """Draw a variable of all samples as dots, in a colour for each column.

    Returns the dots, and the times of the samples since heel strike.
    """
    after = (data["time"] - data["begin"]).transpose("step", "sample").values
    handles = []
    for k, column in enumerate(data["column"].values):
        look: Any = {"ms": 2, "color": BASINS[k % len(BASINS)], "label": str(column)}
        handles += ax.plot(after.ravel(), data[name].values[..., k].ravel(), ".", **look)
    return handles, after


def fit_correlations(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the correlations of the errors of fitted parameters.

    **Arguments:**

    - `data`: that of `walker_jax.fit`.
    - `ax`: where to draw; by default, on a new figure of 5 by 4.2 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "fit")
    ax = axes_for(ax, style, 5, 4.2)
    covariance, names = data["covariance"].values, list(data["parameter"].values)
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        correlations = covariance / np.outer(errors, errors)
    image = ax.imshow(correlations, cmap="RdBu", vmin=-1, vmax=1)
    numbers = np.ndenumerate(correlations) if style.get("labels", True) else ()
    for (i, j), value in numbers:
        dark = abs(value) > 0.6
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", color="white" if dark else INK)
    ax.set_xticks(range(len(names)), names)
    ax.set_yticks(range(len(names)), names)
    bar = figure_of(ax).colorbar(image, ax=ax)
    bar.set_label("correlation")
    note, both = f"errors from {data.sizes['step']} steps", "parameter"
    title = walker_title(data)
    return finish(ax, style, title=title, note=note, x=both, y=both, beside=[bar.ax])


def basin_band(
    grid: Grid, draws: ArrayLike, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw a basin with its band: where a share of the walkers that a fit allows walks.

    ```python
    walks = lambda walker: wj.basin(walker, grid, "direct").attractor.values >= 0
    figures.basin_band(grid, wj.propagate(walks, found, draws=100).draws)
    ```

    **Arguments:**

    - `grid`: of two coordinates.
    - `draws`: for each drawn walker, whether each cell is in the basin, 0 or 1.
    - `ax`: where to draw; by default, on a new figure of 7 by 5 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for draws that are not of the grid.
    """
    ax = axes_for(ax, style, 7, 5)
    shares = np.asarray(draws, float)
    if shares.ndim != 3 or shares.shape[1:] != tuple(grid.shape) or not len(shares):
        raise WrongUse(f"draws must be of shape (draws, {grid.shape}), not {shares.shape}")
    mean = shares.mean(axis=0).T
    x, y = grid.axes.values()
    edges = (*cell_edges(np.asarray(x)), *cell_edges(np.asarray(y)))
    ax.imshow(
        np.where(mean > 0, mean, np.nan),
        origin="lower",
        extent=edges,
        aspect="auto",
        cmap="Blues",
        vmin=0,
        vmax=1.4,
    )
    for level, color in zip(LEVELS, (OTHERS, INK, OTHERS), strict=True):
        if mean.min() < level < mean.max():
            ax.contour(x, y, mean, [level], colors=[color], linewidths=0.8)
    names = [*grid.axes]
    note = f"basin of {len(shares)} walkers: {LEVELS[0]:.1%}, half and {LEVELS[-1]:.1%} of them"
    return finish(ax, style, title="Basin with its band", note=note, x=names[0], y=names[1])
