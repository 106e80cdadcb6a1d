"""Basin entropy and boundary entropy: how unpredictable labels are on a small scale.

Labels say, for instance, which attractor each point of a region goes to. The region is covered with
boxes. The entropy of the labels in a box is the uncertainty of the label of a point when only its
box is known (Daza, Wagemakers, Georgeot, Guery-Odelin and Sanjuan 2016, Scientific Reports 6,
31416). Entropies are in nats: a box with two labels in equal shares has log 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int, Real, Shaped

from walker_jax.checks import WrongUse, array, check_whole, refuses_tracers, short

BOX = 5
"""Cells along a side of a box: 25 points in two dimensions, the least that the authors
recommend."""


class BasinEntropy(NamedTuple):
    """The entropy of labels in boxes: the mean over all boxes, and over boxes on the boundary."""

    value: float
    """Mean over all boxes: 0 where all labels are the same, at most the log of their number."""
    boundary: float
    """Mean over the boxes with more than one label; NaN without such boxes."""
    boundary_error: float
    """Its standard error, from boxes without common cells; NaN with fewer than two."""
    boxes: int
    """Number of boxes; a box begins at each cell where it fits."""
    mixed: int
    """Number of boxes with more than one label."""
    crowded: int
    """Number of boxes with more than two labels."""
    fractal: bool
    """Whether the boundary entropy exceeds log 2 by two standard errors, in these boxes and in
    boxes of about half the side.

    If at most two smooth pieces met in each box, the mean would be at most log 2. A larger mean
    shows a fractal boundary, provided that smooth pieces are wide beside the boxes. Stripes of a
    cell or less exceed log 2 too; the smaller boxes reveal stripes that are wider. A fractal
    boundary may have a lower entropy.
    """


@refuses_tracers()
def basin_entropy(labels: Real[np.ndarray | Array, "*cells"], side: int = BOX) -> BasinEntropy:
    """Compute the basin entropy of labels on a grid, and the entropy of their boundary.

    S = -sum_k p_k log p_k, averaged over boxes

    with p_k the share of label k among the cells of a box. Boxes begin at every cell, so the mean
    does not depend on the place of the first one.

    **Arguments:**

    - `labels`: at regularly spaced points, in any number of dimensions. A box with a negative label
      or NaN is not counted.
    - `side`: cells along each side of a box.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 200))
    data = wj.basin(wj.SimplestWalker(0.004), grid)
    wj.basin_entropy(data.fate.values).boundary  # log 2 = 0.69 at most, if the boundary is smooth
    ```

    Raises ValueError for labels that are not numbers, and for a box that does not fit.
    """
    labels = array("labels", labels)
    if labels.dtype.kind not in "biuf" or labels.ndim == 0:
        raise WrongUse(f"labels must be numbers on a grid, not {short(labels)}")
    check_whole("side", side, 2)
    if min(labels.shape) < side:
        least = min(labels.shape)
        raise WrongUse(f"side must be at most {least}, that of the labels, not {side}")
    entropy, count = entropy_of_boxes(labels, side)
    known, mixed = entropy[count > 0], entropy[count > 1]
    boundary, error = boundary_entropy(entropy, side)
    half = max(2, (side + 1) // 2)
    smaller = boundary_entropy(entropy_of_boxes(labels, half)[0], half)
    return BasinEntropy(
        float(known.mean()) if known.size else np.nan,
        boundary,
        error,
        known.size,
        mixed.size,
        int((count > 2).sum()),
        all(mean - 2 * spread > np.log(2) for mean, spread in ((boundary, error), smaller)),
    )


def entropy_of_boxes(
    labels: Shaped[np.ndarray, "*cells"], side: int
) -> tuple[Float[np.ndarray, "*places"], Int[np.ndarray, "*places"]]:
    """Return the entropy of the labels in each box, and their number; 0 if a cell has no label."""
    none = ~(labels >= 0)  # NaN is no label either
    whole = box_means(none.astype(float), side) == 0
    entropy, count = np.zeros(whole.shape), np.zeros(whole.shape, int)
    for label in np.unique(labels[~none]):
        share = box_means((labels == label).astype(float), side)
        held = whole & (share > 0)
        entropy[held] -= share[held] * np.log(share[held])
        count += held
    return entropy, count


def boundary_entropy(entropy: Float[np.ndarray, "*places"], side: int) -> tuple[float, float]:
    """Return the mean over boxes with several labels, and its standard error; NaN for too few."""
    mixed = entropy[entropy > 0]
    apart = entropy[(slice(None, None, side),) * entropy.ndim]
    apart = apart[apart > 0]
    error = apart.std(ddof=1) / np.sqrt(apart.size) if apart.size > 1 else np.nan
    return float(mixed.mean()) if mixed.size else np.nan, float(error)


def box_means(values: Float[np.ndarray, "*cells"], side: int) -> Float[np.ndarray, "*places"]:
    """Compute the mean of whole numbers over each box of `side` cells; the sums are exact."""
    for axis in range(values.ndim):
        values = np.moveaxis(values, axis, 0)
        total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
        values = np.moveaxis(total[side:] - total[:-side], 0, axis)
    return values / side**values.ndim
