"""The search along segments for the place where labels change.

One function halves many segments at once, whatever the labels mean: fates, attractors, or whether a
disturbance topples a walker. It labels all points of several halvings in one call, as a call of a
few points takes hardly longer than one of a single point.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from walker_jax.checks import ComputationFailed

LabelOf = Callable[[Float[np.ndarray, "n d"]], Shaped[np.ndarray, " n"]]
"""Labels of points: whole numbers, or true and false."""


class Segments(NamedTuple):
    """Segments between points of different labels."""

    ends: Float[np.ndarray, "n 2 d"]
    labels: Shaped[np.ndarray, "n 2"]

    def part(self, chosen: Any) -> "Segments":
        """Return some of the segments."""
        return Segments(self.ends[chosen], self.labels[chosen])


def between(label_of: LabelOf, pair: Float[np.ndarray, "2 d"]) -> Segments:
    """Return the segment between two points; raise `ComputationFailed` if they have one label."""
    first, last = label_of(pair).tolist()
    if first == last:
        raise ComputationFailed(
            f"both ends have one label, {first}: no boundary to follow at {pair[0].tolist()}"
        )
    return Segments(pair[None], np.array([[first, last]]))


def narrow(label_of: LabelOf, segments: Segments, halvings: int = 1) -> Segments:
    """Halve segments some times, in one call for all points, around a change of label.

    Of several changes it takes the first one between the labels of the two ends. If there is none,
    another label lies in between everywhere; it then takes the first change from the label of the
    first end. The points are those of single halvings, to the last bit.
    """
    points, (count, _, size) = segments.ends, segments.ends.shape
    for _ in range(halvings):
        finer = np.empty((count, 2 * points.shape[1] - 1, size), points.dtype)
        finer[:, ::2] = points
        finer[:, 1::2] = (points[:, :-1] + points[:, 1:]) / 2
        points = finer
    inner = label_of(points[:, 1:-1].reshape(-1, size)).reshape(count, points.shape[1] - 2)
    first, last = segments.labels[:, :1], segments.labels[:, 1:]
    labels = np.concatenate([first, inner, last], axis=1)
    leaves = (labels[:, :-1] == first) & (labels[:, 1:] != first)
    direct = leaves & (labels[:, 1:] == last)
    at = np.where(direct.any(axis=1), direct.argmax(axis=1), leaves.argmax(axis=1))
    row, pair = np.arange(count)[:, None], at[:, None] + [0, 1]
    return Segments(points[row, pair], labels[row, pair])


def close_in(
    label_of: LabelOf, pair: Float[np.ndarray, "2 d"], within: float, halvings: int
) -> Segments:
    """Narrow the segment between two points until no coordinate differs by `within` or more.

    With 0 it goes on until no number lies between.
    """
    found, before = between(label_of, pair), None
    while before is None or not np.array_equal(found.ends, before):
        if np.abs(np.diff(found.ends, axis=1)).max() < within:
            break
        before, found = found.ends, narrow(label_of, found, halvings)
    return found
