"""How fine-grained the boundary between regions of different label is: its fractal dimension.

The boundary is that of labels in d dimensions, say which attractor a point goes to. Two methods.
Box counting takes labels on a regular grid: boxes of size s that the boundary passes through number
s^-D. The uncertainty exponent takes any function that labels points: the fraction of points whose
label an error of size eps may change is eps^(d - D). Box counting needs a fine grid; the other only
needs labels at random points, and can look at distances far below any grid's.

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
    check_confidence,
    check_number,
    check_whole,
    numbers,
    refuses_tracers,
    short,
)

SMALLEST_BOX = 4
"""Cells along a side of the smallest box: detail finer than a cell is missing from smaller ones."""
LARGEST_BOX_SHARE = 1 / 4
"""Of the shortest axis, at most: the side of the largest box."""
MIN_BOXES = 30
"""Boxes counted, at least, of the largest size."""
MIN_UNCERTAIN = 10
"""Uncertain points, at least, at a distance that is used."""
MIN_SCALES = 3
"""Sizes or distances, at least, for a fit: with two there is no scatter to tell the error from."""

POINTS_PER_BOX = 16
"""Points in a box that has any, on average and at least, of an information dimension."""
COARSE_OCTAVES = 3
"""Sizes of boxes that are left out of it: half the extent of the points, a quarter, and so on."""


class Dimension(NamedTuple):
    """The dimension of a boundary by counting boxes, or of points, and what it was fitted to."""

    value: float
    """Minus the slope of log(counts) against log(sizes); NaN without boundary enough to count."""
    low: float
    high: float
    """The confidence interval; NaN as the value."""
    sizes: Float[np.ndarray, " k"]
    """Sides of the boxes used, each twice that before; none if the value is NaN."""
    counts: Float[np.ndarray, " k"]
    """Boxes the boundary passes through: the mean over all origins, corrected for the spacing."""


class Uncertainty(NamedTuple):
    """The dimension of a boundary from its uncertainty exponent, and what that was fitted to."""

    value: float
    """The dimension, d - exponent; NaN if fewer than `MIN_SCALES` distances were used."""
    low: float
    high: float
    """The confidence interval of the dimension; NaN as the value."""
    exponent: float
    """The slope of log(fractions) against log(distances); its interval is as wide."""
    distances: Float[np.ndarray, " k"]
    """Those used: where at least `MIN_UNCERTAIN` points were uncertain."""
    fractions: Float[np.ndarray, " k"]
    """Of the points, those that were uncertain."""


@refuses_tracers()
def box_counting(
    labels: Int[np.ndarray | Array, "*cells"], *, spacing: float = 1.0, confidence: float = 0.95
) -> Dimension:
    """The dimension D of the boundary between labels, from the number of boxes it passes through.

    counts ~ sizes^-D

    A box of m = 2^k cells a side has a label at each of its (m + 1)^d corners of cells, those on
    its faces included, and is counted if they are not all the same. Counts are the mean over all
    m^d origins of the boxes, whose centres cover the same part of the array for every size: half
    the largest box is left off at each end of each axis, so axes may have any lengths. That is the
    volume, over m^d, of what is within m / 2 of the boundary in every coordinate: D is
    Minkowski's dimension too.

    Detail between the points of the grid is missed: a fraction c / m of the boxes, for fractals.
    Grids of every second point miss 2 c / m; so counts are extrapolated to a spacing of zero.

    Sizes go in octaves from `SMALLEST_BOX` cells to the largest of which `MIN_BOXES` are counted,
    at most `LARGEST_BOX_SHARE` of the shortest axis. The value is the mean of the slopes between
    successive octaves, and the interval Student's t of these. They show noise, but also a slope
    that drifts or oscillates with the size, which the scatter about one line would hide.

    **Arguments:**

    - `labels`: at regularly spaced points, in any number of dimensions.
    - `spacing`: distance of two neighbouring points, the same along all axes.
    - `confidence`: that the dimension is in the interval.

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
            return Dimension(np.nan, np.nan, np.nan, np.zeros(0), np.zeros(0))
    coarse = mean_box_counts(labels, largest, step=2)
    coarse = np.maximum(coarse, fine / 2)  # a pattern of single cells would have none
    counts = fine**2 / coarse
    slopes = -np.diff(np.log2(counts))
    value = slopes.mean()
    from scipy.special import stdtrit

    half = stdtrit(len(slopes) - 1, upper) * slopes.std(ddof=1) / np.sqrt(len(slopes))
    sizes = spacing * SMALLEST_BOX * 2.0 ** np.arange(len(counts))
    return Dimension(float(value), float(value - half), float(value + half), sizes, counts)


def mean_box_counts(
    labels: Int[np.ndarray, "*cells"], largest: int, *, step: int = 1
) -> Float[np.ndarray, " k"]:
    """Boxes that hold several labels, of sides `SMALLEST_BOX`, twice that ... `largest` cells.

    The mean over all origins of the boxes; of the labels in them, every step-th along each axis.
    """
    low = high = labels
    size, counts = 0, []
    while size < largest:
        shift = max(size, step)  # two boxes make one of twice the size
        size += shift
        for _ in labels.shape:  # each pass joins along the first axis, and puts that last
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
    """The information dimension D of a set of which points are known, such as an attractor.

    The entropy of how the points share out over boxes grows as -D log(size). Boxes divide the
    extent of the points along each axis into 2^k parts. As long as a box with points holds
    `POINTS_PER_BOX` of them on average, its octave counts, but not the first `COARSE_OCTAVES`,
    whose boxes see the shape of the whole. Half a box with points for each point corrects the
    entropy for their finite number (Miller 1955). The interval is Student's t of the slopes between
    octaves. For an attractor the value is that of Kaplan and Yorke, as they conjectured.

    **Returns** a `Dimension`, with the exponential of the entropy for counts, and sizes in
    extents of the points; NaN where there are too few.

    Raises `ValueError` for what are no points, and a confidence out of range.
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
        return Dimension(np.nan, np.nan, np.nan, np.zeros(0), np.zeros(0))
    slopes = np.diff(used) / np.log(2)
    from scipy.special import stdtrit

    half = stdtrit(len(slopes) - 1, upper) * slopes.std(ddof=1) / np.sqrt(len(slopes))
    sizes = 0.5 ** np.arange(COARSE_OCTAVES + 1, len(entropies) + 1)
    value = float(slopes.mean())
    return Dimension(value, value - float(half), value + float(half), sizes, np.exp(used))


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
    """The dimension D of the boundary between labels, from how often a small error changes a label.

    fractions ~ distances^(d - D)

    A point x is uncertain at a distance eps if the label of x + eps u or of x - eps u is not that
    of x, with u a random direction (Grebogi, McDonald, Ott and Yorke 1983, Physics Letters A 99,
    415). Each distance has points of its own, so its fraction is an independent binomial. The line
    is fitted by weighted least squares to the logs of the fractions, which have variance
    (1 - f) / (n f). The interval is that variance's, or Student's t of the scatter about the line
    where that is wider, as it is where the points are so many that the line is not quite straight.

    **Arguments:**

    - `label_of`: labels of points; called once for each distance, with three times `pairs` points,
      of which some are outside the region, by up to the distance.
    - `draw`: that many uniformly random points of the region, from a generator.
    - `distances`: at least `MIN_SCALES`, all different, small beside the region and its large
      features.
    - `pairs`: points x for each distance.
    - `seed`: of the generator.
    - `confidence`: that the dimension is in the interval.

    Raises ValueError if an argument is out of range, or the functions return wrong shapes.
    """
    distances = sort_distances(distances, pairs)
    check_whole("seed", seed, 0)
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
            raise WrongUse(f"draw: must return shape ({pairs}, d), not {x.shape}")
        d = x.shape[1]
        u = rng.normal(size=x.shape)
        u *= distance / np.linalg.norm(u, axis=1, keepdims=True)
        labels = np.asarray(label_of(np.concatenate([x, x + u, x - u])))
        if labels.shape != (3 * pairs,):
            raise WrongUse(f"label_of: must return shape ({3 * pairs},), not {labels.shape}")
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
    """The distances, sorted; ValueError for what `uncertainty_exponent` cannot use."""
    distances = np.sort(np.atleast_1d(numbers("distances", distances)))
    if distances.ndim != 1 or len(np.unique(distances)) < max(MIN_SCALES, distances.size):
        shown = format_numbers(distances)
        raise WrongUse(f"distances={shown}: must be at least {MIN_SCALES}, all different")
    if not (np.isfinite(distances) & (distances > 0)).all():
        raise WrongUse(f"distances={format_numbers(distances)}: must be positive and finite")
    check_whole("pairs", pairs, MIN_UNCERTAIN)
    return distances


def format_numbers(values: Float[np.ndarray, "..."]) -> str:
    """Numbers on one line."""
    return np.array2string(values, threshold=6, edgeitems=3, max_line_width=200).replace("\n", " ")


def fit_power(
    x: Float[np.ndarray, " k"], hits: Float[np.ndarray, " k"], tries: int, upper: float
) -> tuple[float, float]:
    """The power of x that the chance of a hit goes with, and half the width of its interval."""
    x = np.log(x)
    seen = np.log((hits + 0.5) / (tries + 1))  # the half makes the log unbiased to first order
    line = seen
    for _ in range(3):  # weights from the line: those from the data favour what is high by chance
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
    """The probability below the upper end of a two-sided interval."""
    check_confidence(confidence)
    return (1 + confidence) / 2
