"""Edge tracking along the boundary between two labels, by a map that keeps labels.

Bisection brings two points on both sides of the boundary together. The map moves both; they stay on
both sides, and part along the unstable direction. Bisection brings them together again. So they
move along the boundary to what attracts within it (Battelino and others 1988, Physica D 32, 296;
Skufca, Yorke and Eckhardt 2006, Physical Review Letters 96, 174101). This module knows nothing of
walkers.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.checks import ComputationFailed

POINTS = 33
"""Number of points of a segment that are labelled at once; the next segment joins two
neighbours."""
TOGETHER = 1e-13
"""Largest distance, in every coordinate, of two points brought together: some hundred rounding
errors."""
TORN = 1e-4
"""Distance of their images from which on the map has torn them apart. It has then stretched their
distance a billion times, which only a discontinuity does."""
REPEATED = 1e-6
"""Distance at which a path that repeats itself may have come to a cycle, from which Newton's
iteration converges. Each time that the path has not, the distance becomes a tenth."""

LabelOf = Callable[[Float[np.ndarray, "n d"]], Int[np.ndarray, " n"]]
Map = Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, "n d"]]


class Track(NamedTuple):
    """The path of an edge along a boundary."""

    path: Float[np.ndarray, "n d"]
    """Points of the boundary, each near the image of the previous one."""
    sides: Float[np.ndarray, "2 d"]
    """The last two points, one on each side."""
    labels: tuple[int, int]
    """Their labels."""
    period: int
    """Points after which the path repeats itself; 0 where it does not."""
    torn: bool
    """Whether the map tears the last two points apart, or has no image of one of them."""


def follow_edge(
    image: Map,
    label_of: LabelOf,
    a: Float[np.ndarray, " d"],
    b: Float[np.ndarray, " d"],
    *,
    rounds: int,
    longest: int,
    is_cycle: Callable[[Float[np.ndarray, "period d"]], bool] = lambda points: True,
) -> Track:
    """Follow the boundary between two points of different labels.

    The path ends where it repeats itself after at most `longest` points and `is_cycle` confirms
    these. Confirmation is needed because a cycle that attracts slowly along the boundary makes a
    path repeat itself far away. The path also ends where the map tears the two points apart, or
    after `rounds` rounds. Raises `ComputationFailed` where rounding gives both images one label.
    """
    path, pair, within = [], np.stack([a, b]), REPEATED
    for _ in range(rounds):
        pair, labels = bring_together(label_of, pair)
        path.append(pair.mean(axis=0))
        back = [np.abs(path[-1] - one).max() for one in path[-2 : -2 - longest : -1]]
        repeated = np.flatnonzero(np.array(back) < within)
        if repeated.size:
            period = int(repeated[0]) + 1
            if is_cycle(np.array(path[-period:])):
                return Track(np.array(path), pair, labels, period, torn=False)
            within /= 10
        images = image(pair)
        if not np.abs(images[1] - images[0]).max() < TORN:  # True also for NaN
            return Track(np.array(path), pair, labels, 0, torn=True)
        pair = images
    return Track(np.array(path), pair, labels, 0, torn=False)


def bring_together(
    label_of: LabelOf, pair: Float[np.ndarray, "2 d"]
) -> tuple[Float[np.ndarray, "2 d"], tuple[int, int]]:
    """Return two points on both sides of the boundary on a segment, and their labels.

    Of several changes of label it takes the first one between the labels of the two ends. If there
    is none, another label lies in between everywhere; it then takes the first change from the label
    of the first end.
    """
    share = np.linspace(0, 1, POINTS)[:, None]
    while True:
        points = (1 - share) * pair[0] + share * pair[1]
        labels = label_of(points)
        first, last = int(labels[0]), int(labels[-1])
        if first == last:
            raise ComputationFailed(
                f"both ends have one label, {first}: no boundary to follow at {pair[0].tolist()}"
            )
        at = first_change(labels, first, last)
        pair = points[at : at + 2]
        if np.abs(pair[1] - pair[0]).max() < TOGETHER:
            return pair, (int(labels[at]), int(labels[at + 1]))


def first_change(labels: Int[np.ndarray, " n"], first: int, last: int) -> int:
    """Return the first change from the first label to the last; without one, to any label."""
    leaves: Bool[np.ndarray, " n-1"] = (labels[:-1] == first) & (labels[1:] != first)
    direct = leaves & (labels[1:] == last)
    return int((direct if direct.any() else leaves).argmax())
