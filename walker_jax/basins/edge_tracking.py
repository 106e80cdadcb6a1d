"""Edge tracking: along the boundary between two labels, by a map that keeps labels.

Two points on both sides of the boundary are brought together by bisection. The map moves both; they
stay on both sides, and part along what is unstable. So they are brought together again, and move
along the boundary to what attracts within it (Battelino and others 1988, Physica D 32, 296; Skufca,
Yorke and Eckhardt 2006, Physical Review Letters 96, 174101). This file knows no walker.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.checks import ComputationFailed

POINTS = 33
"""Points of a segment that are labelled at once; the next segment is between two neighbours."""
TOGETHER = 1e-13
"""Distance, in every coordinate, of two points on both sides: some hundred rounding errors."""
TORN = 1e-4
"""Distance of their images from which on the map has torn them apart: it amplifies a billion times,
as it does only where it is not continuous."""
REPEATED = 1e-6
"""Distance at which an edge that repeats itself may have come to a cycle, from which Newton's
iteration converges; a tenth of it each time that it had not."""

LabelOf = Callable[[Float[np.ndarray, "n d"]], Int[np.ndarray, " n"]]
Map = Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, "n d"]]


class Track(NamedTuple):
    """A boundary that was followed."""

    path: Float[np.ndarray, "n d"]
    """Points of the boundary, each near the image of the one before."""
    sides: Float[np.ndarray, "2 d"]
    """The last two points, on both sides."""
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

    Ends where the path repeats itself after at most `longest` points, if `is_cycle` of these: it
    repeats itself far from a cycle that attracts slowly along the boundary. Else ends where the map
    tears the two apart, or after a number of rounds. Raises `ComputationFailed` where rounding
    gives both images one label.
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
        if not np.abs(images[1] - images[0]).max() < TORN:  # nor where one is NaN
            return Track(np.array(path), pair, labels, 0, torn=True)
        pair = images
    return Track(np.array(path), pair, labels, 0, torn=False)


def bring_together(
    label_of: LabelOf, pair: Float[np.ndarray, "2 d"]
) -> tuple[Float[np.ndarray, "2 d"], tuple[int, int]]:
    """Two points on both sides of the boundary on a segment, and their labels.

    Of several changes of label it takes the first between those of the two ends. Where there is
    none, as another label is in between everywhere, it takes the first change from that of the
    first end.
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
    """Where labels change from the first to the last; else, where they leave the first."""
    leaves: Bool[np.ndarray, " n-1"] = (labels[:-1] == first) & (labels[1:] != first)
    direct = leaves & (labels[1:] == last)
    return int((direct if direct.any() else leaves).argmax())
