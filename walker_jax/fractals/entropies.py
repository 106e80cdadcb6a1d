"""Basin entropy and boundary entropy: how unpredictable labels are on a small scale.

Labels say, for instance, which attractor each point of a region goes to. The region is covered with
boxes. The entropy of the labels in a box is the uncertainty of the label of a point when only its
box is known (Daza, Wagemakers, Georgeot, Guery-Odelin and Sanjuan 2016, Scientific Reports 6,
31416). Entropies are in nats: a box with two labels in equal shares has log 2.
"""

from __future__ import annotations

from itertools import combinations_with_replacement, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int, Real, Shaped

from walker_jax.checks import WrongUse, array, check_whole, refuses_tracers, short

BOX = 5
"""Cells along a side of a box: 25 points in two dimensions, the least that the authors
recommend."""
FINEST = 2, 3
"""Sides of the smallest boxes that tell how the basin entropy grows."""
LEAST_EXCESS = 0.1
"""Least excess of a fractal boundary's dimension. Squares of 5 cells, the worst of smooth pieces
tried, have 0.1; straight lines have 0 or less."""
STEEPEST = 4
"""Largest component of the normals of the planes with which a boundary is compared."""
BLOCKS = 8
"""Parts along each axis, left out in turn for a standard error."""


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
    excess: float
    """Dimension of the boundary beyond that of a plane: the least of two, from boxes of 2 and 3
    cells, and of 3 cells and `side`. The value is proportional to the side to the power d - D (Daza
    and others 2016). The power is compared with the least of planes of any direction on the same
    cells. NaN where fewer than two of 8 parts along each axis have a boundary.
    """
    excess_error: float
    """Its standard error, by a jackknife over parts of the grid; NaN with the excess."""
    fractal: bool
    """Whether the excess is above `LEAST_EXCESS` by two standard errors, from both pairs of boxes.

    Stripes or spots of a cell or less look fractal too: only a finer grid tells. The smallest boxes
    reveal stripes that are wider. A fractal boundary whose detail is rare, or of a dimension hardly
    above that of a plane, may not show.
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
    wj.fractals.basin_entropy(data.fate.values).boundary  # at most log 2 = 0.69, if it is smooth
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
    excesses = dimension_excesses(labels, side)
    least = min(excesses, key=lambda one: one[0] - 2 * one[1], default=(np.nan, np.nan))
    return BasinEntropy(
        float(known.mean()) if known.size else np.nan,
        boundary,
        error,
        known.size,
        mixed.size,
        int((count > 2).sum()),
        *least,
        fractal=least[0] - 2 * least[1] > LEAST_EXCESS,
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


def dimension_excesses(
    labels: Shaped[np.ndarray, "*cells"], side: int
) -> list[tuple[float, float]]:
    """Return by how much a boundary's dimension exceeds a plane's, and the standard errors.

    There is one excess for each pair of successive sides of boxes; boxes of all sides have the same
    places, with a label in each cell of the largest. Empty where the boundary is in one part only.
    """
    sides = sorted({*FINEST, side})
    if min(labels.shape) < sides[-1]:
        return []
    sums, whole = [], entropy_of_boxes(labels, sides[-1])[1] > 0
    for size in sides:
        first = (sides[-1] - size) // 2
        places = tuple(slice(first, first + n - sides[-1] + 1) for n in labels.shape)
        here = entropy_of_boxes(labels, size)[0][places] * whole
        for axis, count in enumerate(here.shape):
            starts = np.unique(np.arange(BLOCKS) * count // BLOCKS)
            here = np.add.reduceat(here, starts, axis=axis)
        sums.append(here.ravel())
    found = []
    for (small, large), entropies in zip(pairwise(sides), pairwise(sums), strict=True):
        parts = np.stack(entropies)[:, entropies[1] > 0]  # a larger box has all labels of a smaller
        count = parts.shape[1]
        all_but_one = parts.sum(axis=1, keepdims=True) - parts
        if count < 2 or not parts[0].any():
            return []
        with np.errstate(divide="ignore"):
            powers = np.log(all_but_one[1] / all_but_one[0]) / np.log(large / small)
        power = np.log(np.divide(*parts.sum(axis=1)[::-1])) / np.log(large / small)
        error = np.sqrt((count - 1) * powers.var())
        found.append((float(power_of_planes(small, large, labels.ndim) - power), float(error)))
    return found


def power_of_planes(small: int, large: int, axes: int) -> float:
    """Return the least power of the side with which the entropy of planes grows between two sides.

    A plane at a random place divides the cells of a box, in the order of their distances from it.
    """
    normals = [
        np.array(one)
        for one in combinations_with_replacement(range(STEEPEST + 1), axes)
        if any(one)
    ]
    ratios = [entropy_of_plane(large, one) / entropy_of_plane(small, one) for one in normals]
    return float(np.log(min(ratios)) / np.log(large / small))


def entropy_of_plane(side: int, normal: Int[np.ndarray, " d"]) -> float:
    """Return the integral of a box's entropy over the places of a plane with this normal."""
    cells = np.indices((side,) * len(normal)).reshape(len(normal), -1)
    distance = np.sort(normal @ cells)
    share = np.arange(1, distance.size) / distance.size
    entropy = -share * np.log(share) - (1 - share) * np.log1p(-share)
    return float(np.sum(np.diff(distance) * entropy))


def box_means(values: Float[np.ndarray, "*cells"], side: int) -> Float[np.ndarray, "*places"]:
    """Compute the mean of whole numbers over each box of `side` cells; the sums are exact."""
    for axis in range(values.ndim):
        values = np.moveaxis(values, axis, 0)
        total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
        values = np.moveaxis(total[side:] - total[:-side], 0, axis)
    return values / side**values.ndim
