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
from jaxtyping import Float

from walker_jax.segments import LabelOf, close_in

HALVINGS = 5
"""Halvings of a segment in one call: 31 points take hardly longer than one."""
TOGETHER = 1e-13
"""Largest distance, in every coordinate, of two points brought together: some hundred rounding
errors."""
TORN = 1e-4
"""Distance of their images from which on the map has torn them apart. It has then stretched their
distance a billion times, which only a discontinuity does."""
REPEATED = 1e-6
"""Distance at which a path that repeats itself may have come to a cycle, from which Newton's
iteration converges. Each time that the path has not, the distance becomes a tenth."""

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
        (pair,), ((first, last),) = close_in(label_of, pair, TOGETHER, HALVINGS)
        labels = int(first), int(last)
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
