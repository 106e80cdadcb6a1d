"""Fractal dimension of the boundary between regions of different label.

Labels are given in d dimensions, for example the attractor that each point goes to. There are two
methods. Box counting takes labels on a regular grid: the boundary passes through about s^-D boxes
of size s. The uncertainty exponent takes any function that labels points: an error of size eps may
change the label of a share eps^(d - D) of the points. Box counting needs a fine grid. The
uncertainty exponent needs labels at random points only, and reaches distances far below the spacing
of any grid.

Dimensions are pure numbers; sizes and distances are in the caller's units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from walker_jax.checks import (
    WrongUse,
    array,
    check_number,
    check_whole,
    numbers,
    refuses_tracers,
    short,
)

SMALLEST_BOX = 4
"""Cells along a side of the smallest box: smaller boxes miss detail finer than a cell."""
LARGEST_BOX_SHARE = 1 / 4
"""Largest side of a box, as a share of the shortest axis."""
MIN_BOXES = 30
"""Fewest boxes counted of the largest size."""
MIN_UNCERTAIN = 10
"""Fewest uncertain points at a distance that is used."""
MIN_SCALES = 3
"""Fewest sizes or distances for a fit: two leave no scatter from which to estimate the error."""

POINTS_PER_BOX = 16
"""Fewest points in an occupied box, on average, for an information dimension."""
COARSE_OCTAVES = 3
"""Largest sizes of boxes, left out of an information dimension: half the extent, a quarter ..."""


class Dimension(NamedTuple):
    """The dimension of a boundary or a set of points, and the counts of boxes it was fitted to."""

    value: float
    """Minus the slope of log(counts) against log(sizes); NaN with too little boundary to count."""
    low: float
    high: float
    """Ends of the confidence interval; NaN where the value is NaN."""
    sizes: Float[np.ndarray, " k"]
    """Sides of the boxes used, each twice the one before; empty if the value is NaN."""
    counts: Float[np.ndarray, " k"]
    """Boxes the boundary passes through: the mean over all origins, corrected for the spacing."""


UNKNOWN = Dimension(np.nan, np.nan, np.nan, np.zeros(0), np.zeros(0))
"""The result with too little to count."""


class Uncertainty(NamedTuple):
    """The dimension of a boundary from its uncertainty exponent, and the fitted fractions."""

    value: float
    """The dimension, d - exponent; NaN if fewer than `MIN_SCALES` distances were used."""
    low: float
    high: float
    """Ends of the confidence interval of the dimension; NaN where the value is NaN."""
    exponent: float
    """The slope of log(fractions) against log(distances); its interval is as wide."""
    distances: Float[np.ndarray, " k"]
    """Distances used: those with at least `MIN_UNCERTAIN` uncertain points."""
    fractions: Float[np.ndarray, " k"]
    """Fraction of the points that were uncertain, at each distance."""


@refuses_tracers()
def box_counting(
    labels: Int[np.ndarray | Array, "*cells"], *, spacing: float = 1.0, confidence: float = 0.95
) -> Dimension:
    """Estimate the dimension D of the boundary between labels by counting boxes.

    counts ~ sizes^-D

    A box of m = 2^k cells a side has a label at each of its (m + 1)^d corners of cells, including
    those on its faces. It is counted if the labels differ. Counts are the mean over all m^d origins
    of the boxes. For every size the centres of the boxes cover the same part of the array: half the
    largest box is left off at each end of each axis, so axes may have any lengths. The counts times
    m^d are then the volume within m / 2 of the boundary in every coordinate, so D is the Minkowski
    dimension too.

    Detail between the points of the grid is missed: a fraction c / m of the boxes, for fractals.
    Grids of every second point miss 2 c / m, so counts are extrapolated to a spacing of zero.

    Sizes double from `SMALLEST_BOX` cells to the largest with `MIN_BOXES` boxes counted, at most
    `LARGEST_BOX_SHARE` of the shortest axis. The value is the mean of the slopes between successive
    octaves, with Student's t interval of these slopes. The slopes show noise, and also a drift or
    an oscillation with the size, which the scatter about one line would hide.

    **Arguments:**

    - `labels`: at regularly spaced points, in any number of dimensions.
    - `spacing`: distance of two neighbouring points, the same along all axes.
    - `confidence`: probability that the interval holds the dimension.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 200))
    data = wj.basin(wj.SimplestWalker(0.004), grid)
    wj.fractals.box_counting(data.fate.values).value  # the dimension of the boundary between fates
    ```

    Raises ValueError if labels are not numbers, the array is too small for `MIN_SCALES` sizes, or
    an option is out of range.
    """
    labels = array("labels", labels)
    if labels.dtype.kind not in "biuf":
        raise WrongUse(f"labels must be numbers, not {short(labels)}")
    check_number("spacing", spacing)
    if not 0 < spacing < np.inf:
        raise WrongUse(f"spacing={spacing}: must be positive and finite")
    upper = upper_probability(confidence)
    smallest = SMALLEST_BOX * 2 ** (MIN_SCALES - 1)
    largest = int(min(labels.shape, default=0) * LARGEST_BOX_SHARE)
    if largest < smallest:
        needed = int(smallest / LARGEST_BOX_SHARE)
        raise WrongUse(f"labels: shape {labels.shape}, must be {needed} or more along every axis")

    largest = 2 ** (largest.bit_length() - 1)
    while (fine := mean_box_counts(labels, largest))[-1] < MIN_BOXES:
        largest //= 2
        if largest < smallest:
            return UNKNOWN
    coarse = mean_box_counts(labels, largest, step=2)
    coarse = np.maximum(coarse, fine / 2)  # never zero, as for a pattern of single cells
    counts = fine**2 / coarse
    sizes = spacing * SMALLEST_BOX * 2.0 ** np.arange(len(counts))
    return mean_slope(-np.diff(np.log2(counts)), upper, sizes, counts)


def mean_slope(
    slopes: Float[np.ndarray, " octaves"],
    upper: float,
    sizes: Float[np.ndarray, " k"],
    counts: Float[np.ndarray, " k"],
) -> Dimension:
    """Return the mean of the slopes of octaves as a dimension, with its Student's t interval."""
    from scipy.special import stdtrit

    value = float(slopes.mean())
    half = float(stdtrit(len(slopes) - 1, upper) * slopes.std(ddof=1) / np.sqrt(len(slopes)))
    return Dimension(value, value - half, value + half, sizes, counts)


def mean_box_counts(
    labels: Int[np.ndarray, "*cells"], largest: int, *, step: int = 1
) -> Float[np.ndarray, " k"]:
    """Count the boxes with several labels, of sides `SMALLEST_BOX` to `largest` cells.

    Counts are the mean over all origins of the boxes. Of the labels in a box, every step-th along
    each axis is read.
    """
    low = high = labels
    size, counts = 0, []
    while size < largest:
        shift = max(size, step)  # two boxes join into one of twice the size
        size += shift
        for _ in labels.shape:  # each pass joins along the first axis, then moves it last
            low = np.moveaxis(np.minimum(low[:-shift], low[shift:]), 0, -1)
            high = np.moveaxis(np.maximum(high[:-shift], high[shift:]), 0, -1)
        if size >= SMALLEST_BOX:
            first = (largest - size) // 2
            centred = tuple(slice(first, first + n - largest) for n in labels.shape)
            mixed = np.count_nonzero(low[centred] != high[centred])
            counts.append(mixed / float(size) ** labels.ndim)
    return np.array(counts)


@refuses_tracers()
def information_dimension(
    points: Float[np.ndarray | Array, "n d"], *, confidence: float = 0.95
) -> Dimension:
    """Estimate the information dimension D of a set of points, such as an attractor.

    The entropy of the distribution of points over boxes grows as -D log(size). Boxes divide the
    extent of the points along each axis into 2^k parts. An octave counts as long as occupied boxes
    hold `POINTS_PER_BOX` points on average. The first `COARSE_OCTAVES` are left out: their boxes
    see the shape of the whole. The entropy is corrected for the finite number of points by half the
    number of occupied boxes over the number of points (Miller 1955). The interval is Student's t of
    the slopes between octaves. Kaplan and Yorke conjectured that D of an attractor equals its
    Lyapunov dimension.

    **Returns** a `Dimension`: its counts are exponentials of the entropy, its sizes are in extents
    of the points. It is NaN for too few points.

    ```python
    walk = wj.walk(wj.systems.HenonMap(), (0.1, 0.1), 20_000)
    found = wj.fractals.information_dimension(walk.states[100:])
    found.value, found.low, found.high
    ```

    Raises `ValueError` for an array that is not of finite points, and a confidence out of range.
    """
    points, upper = numbers("points", points), upper_probability(confidence)
    if points.ndim != 2 or not len(points) or not np.isfinite(points).all():
        raise WrongUse(f"points must be finite, of shape (n, d), not of shape {points.shape}")
    extent = np.ptp(points, axis=0)
    points = (points - points.min(axis=0))[:, extent > 0] / extent[extent > 0]
    entropies: list[float] = []
    for octave in range(1, 1 + 62 // max(points.shape[1], 1)):
        cells = np.minimum(points * 2**octave, 2**octave - 1).astype(np.int64)
        boxes = cells @ 2 ** (octave * np.arange(points.shape[1]))
        shares = np.unique(boxes, return_counts=True)[1] / len(points)
        if len(shares) * POINTS_PER_BOX > len(points):
            break
        correction = (len(shares) - 1) / (2 * len(points))
        entropies.append(float(correction - np.sum(shares * np.log(shares))))
    used = np.array(entropies[COARSE_OCTAVES:])
    if len(used) < MIN_SCALES:
        return UNKNOWN
    sizes = 0.5 ** np.arange(COARSE_OCTAVES + 1, len(entropies) + 1)
    return mean_slope(np.diff(used) / np.log(2), upper, sizes, np.exp(used))


@refuses_tracers()
def uncertainty_exponent(
    label_of: Callable[[Float[np.ndarray, "n d"]], Int[np.ndarray | Array, " n"]],
    draw: Callable[[np.random.Generator, int], Float[np.ndarray | Array, "n d"]],
    distances: Float[np.ndarray | Array, " k"],
    *,
    pairs: int = 10_000,
    seed: int = 0,
    confidence: float = 0.95,
) -> Uncertainty:
    """Estimate the dimension D of the boundary from how often a small error changes a label.

    fractions ~ distances^(d - D)

    A point x is uncertain at a distance eps if x + eps u or x - eps u has another label than x,
    with u a random direction (Grebogi, McDonald, Ott and Yorke 1983, Physics Letters A 99, 415).
    Each distance has its own points, so its fraction is an independent binomial. The line is fitted
    by weighted least squares to the logs of the fractions, which have variance (1 - f) / (n f). The
    interval follows from that variance, or from Student's t of the scatter about the line where
    that is wider. The scatter is wider with so many points that the line is not quite straight.

    **Arguments:**

    - `label_of`: a function from points to labels. It is called once for each distance, with three
      times `pairs` points; some of these are outside the region, by up to the distance.
    - `draw`: a function from a generator and a number to that many uniformly random points of the
      region.
    - `distances`: at least `MIN_SCALES`, all different, small beside the region and its large
      features.
    - `pairs`: number of points x for each distance.
    - `seed`: of the generator.
    - `confidence`: probability that the interval holds the dimension.

    ```python
    draw = lambda generator, count: generator.random((count, 2))
    above = lambda points: (points[:, 1] > points[:, 0]).astype(int)
    wj.fractals.uncertainty_exponent(above, draw, (0.003, 0.01, 0.03)).value  # about 1, for a line
    ```

    Raises ValueError if an argument is out of range, or the functions return wrong shapes.
    """
    distances = sort_distances(distances, pairs)
    for name, function in {"label_of": label_of, "draw": draw}.items():
        if not callable(function):
            raise WrongUse(f"{name} must be a function, not a {type(function).__name__}")
    upper = upper_probability(confidence)

    rng = np.random.default_rng(seed)
    hits = np.zeros(len(distances))
    d = 0
    for i, distance in enumerate(distances):
        x = np.asarray(draw(rng, pairs), float)
        if x.ndim != 2 or len(x) != pairs:
            raise WrongUse(f"draw must return shape ({pairs}, d), not {x.shape}")
        d = x.shape[1]
        u = rng.normal(size=x.shape)
        u *= distance / np.linalg.norm(u, axis=1, keepdims=True)
        labels = np.asarray(label_of(np.concatenate([x, x + u, x - u])))
        if labels.shape != (3 * pairs,):
            raise WrongUse(f"label_of must return shape ({3 * pairs},), not {labels.shape}")
        here, *beside = np.split(labels, 3)
        hits[i] = np.count_nonzero((here != beside[0]) | (here != beside[1]))

    used = hits >= MIN_UNCERTAIN
    distances, hits = distances[used], hits[used]
    exponent = half = np.nan
    if len(distances) >= MIN_SCALES:
        exponent, half = fit_power(distances, hits, pairs, upper)
    value = d - exponent
    return Uncertainty(value, value - half, value + half, exponent, distances, hits / pairs)


def sort_distances(
    distances: Float[np.ndarray | Array, " k"], pairs: int
) -> Float[np.ndarray, " k"]:
    """Return the distances, sorted; raise `WrongUse` for distances that cannot be fitted."""
    distances = np.sort(np.atleast_1d(numbers("distances", distances)))
    if distances.ndim != 1 or len(np.unique(distances)) < max(MIN_SCALES, distances.size):
        shown = format_numbers(distances)
        raise WrongUse(f"distances={shown}: must be at least {MIN_SCALES}, all different")
    if not (np.isfinite(distances) & (distances > 0)).all():
        raise WrongUse(f"distances={format_numbers(distances)}: must be positive and finite")
    check_whole("pairs", pairs, MIN_UNCERTAIN)
    return distances


def format_numbers(values: Float[np.ndarray, "..."]) -> str:
    """Format numbers on one line."""
    return np.array2string(values, threshold=6, edgeitems=3, max_line_width=200).replace("\n", " ")


def fit_power(
    x: Float[np.ndarray, " k"], hits: Float[np.ndarray, " k"], tries: int, upper: float
) -> tuple[float, float]:
    """Fit the chance of a hit as a power of x; return the power and half its interval."""
    x = np.log(x)
    seen = np.log((hits + 0.5) / (tries + 1))  # the half makes the log unbiased to first order
    line = seen
    for _ in range(3):  # from the line: weights from the data favour values high by chance
        chance = np.minimum(np.exp(line), 1 - 0.5 / tries)
        weights = tries * chance / (1 - chance)
        deviation = x - np.average(x, weights=weights)
        information = np.sum(weights * deviation**2)
        power = np.sum(weights * deviation * seen) / information
        line = np.average(seen, weights=weights) + power * deviation
    freedom = len(x) - 2
    scatter = np.sqrt(np.sum(weights * (seen - line) ** 2) / freedom)
    from scipy.special import ndtri, stdtrit

    half = max(ndtri(upper), stdtrit(freedom, upper) * scatter) / np.sqrt(information)
    return float(power), float(half)


def upper_probability(confidence: float) -> float:
    """Return the probability below the upper end of a two-sided interval."""
    return (1 + confidence) / 2
