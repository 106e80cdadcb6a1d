"""Fits to recordings: samples with residuals, correlations of parameters, bands of basins."""

from typing import Unpack

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from walker_jax.checks import WrongUse
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, begin, finish, new_panels
from walker_jax.figures.regions import show_image
from walker_jax.figures.style import BASINS, INK, OTHERS
from walker_jax.figures.text import walker_title
from walker_jax.grids import Grid

SINCE = "time since heel strike"
LEVELS = 0.025, 0.5, 0.975
"""Shares of draws at the edges of the band of a basin, and in its middle: a band of 95 %."""


def fit(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.fit` returns: `fitted_samples`, and `fit_residuals` beside it."""
    figure, (left, right) = new_panels(12, 5, 1, 2)
    fitted_samples(data, left)
    fit_residuals(data, right)
    return figure


def fitted_samples(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw recorded and fitted coordinates over the time since heel strike, all steps in one."""
    ax = begin(ax, style, data, "fit", 6, 5)
    after = draw_columns(ax, data, "recorded")
    for k in range(data.sizes["column"]):
        lines = ax.plot(after.T, data["fitted"].values[..., k].T, lw=0.6, color=INK)
    lines[0].set_label("fitted")
    note = f"{data.sizes['step']} steps, recorded and fitted"
    return finish(ax, style, walker_title(data), note, x=SINCE, y="coordinates")


def fit_residuals(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw recorded less fitted coordinates, in standard deviations of their noise."""
    ax = begin(ax, style, data, "fit", 6, 5)
    draw_columns(ax, data, "residual")
    ax.axhline(0, lw=0.6, color=INK)
    squares, free = data.attrs["sum_of_squares"], data.attrs["degrees_of_freedom"]
    note, y = f"sum of squares {squares:.4g}, {free} degrees of freedom", "residual over the noise"
    return finish(ax, style, "Residuals", note, x=SINCE, y=y)


def draw_columns(ax: Axes, data: xr.Dataset, name: str) -> Float[np.ndarray, "steps samples"]:
    """Draw a variable of all samples as dots, in a colour for each column.

    Returns the times of the samples since heel strike.
    """
    after = (data["time"] - data["begin"]).transpose("step", "sample").values
    for k, column in enumerate(data["column"].values):
        colour = BASINS[k % len(BASINS)]
        ax.plot(after.ravel(), data[name].values[..., k].ravel(), "o", ms=2, color=colour)
        ax.plot([], [], "o", ms=5, color=colour, label=str(column))
    return after


def fit_correlations(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the correlations of the errors of fitted parameters."""
    ax = begin(ax, style, data, "fit", 5, 4.2)
    covariance, names = data["covariance"].values, list(data["parameter"].values)
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore"):
        correlations = covariance / np.outer(errors, errors)
    image = ax.imshow(correlations, cmap="RdBu", vmin=-1, vmax=1)
    for (i, j), value in np.ndenumerate(correlations) if style.get("labels", True) else ():
        colour = "white" if abs(value) > 0.6 else INK
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", color=colour)
    ax.set_xticks(range(len(names)), names)
    ax.set_yticks(range(len(names)), names)
    note, both = f"errors from {data.sizes['step']} steps", "parameter"
    bar = image, "correlation"
    return finish(ax, style, walker_title(data), note, x=both, y=both, bar=bar)


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
    """
    ax = axes_for(ax, style, 7, 5)
    shares = np.asarray(draws, float)
    if shares.ndim != 3 or shares.shape[1:] != tuple(grid.shape) or not len(shares):
        raise WrongUse(f"draws must be of shape (draws, {grid.shape}), not {shares.shape}")
    mean = shares.mean(axis=0)
    (x, y), cells = grid.axes.values(), xr.DataArray(mean, grid.axes, [*grid.axes])
    show_image(ax, np.where(mean > 0, mean, np.nan), cells, cmap="Blues", vmin=0, vmax=1.4)
    for level, color in zip(LEVELS, (OTHERS, INK, OTHERS), strict=True):
        if mean.min() < level < mean.max():
            ax.contour(x, y, mean.T, [level], colors=[color], linewidths=0.8)
    note = f"basin of {len(shares)} walkers: {LEVELS[0]:.1%}, half and {LEVELS[-1]:.1%} of them"
    x, y = grid.axes
    return finish(ax, style, "Basin with its band", note, x=x, y=y)
