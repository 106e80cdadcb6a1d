"""Motions without a period: which of many walks share one.

A walk on such a motion visits a cloud of points. Two walks share the motion if the points of each
lie about as near to the cloud of the other as the points of that cloud to each other. Distances
are in extents of the clouds, coordinate by coordinate.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

APART = 4.0
"""Typical distances between the points of a cloud, beyond which a walk is not on its motion. Two
walks on one motion are about one such distance apart."""
RESOLUTION = 1e-3
"""Least such distance, in extents: walks that settle slowly are as far from their motion, and the
points of a cycle too long to be recognised lie on each other."""
LEAST_EXTENT = 0.01
"""Least extent of clouds in a coordinate: along others walks may still be settling."""
WALKS_AT_ONCE = 2**16
"""Number of walks whose distances are computed together, which bounds the memory."""
SPARSE = slice(None, None, 16)
"""Points of a long walk whose distances are computed: enough for a median."""

Points = Float[np.ndarray, "points section"]


class Clouds:
    """The clouds of several motions, for the distances of walks from them."""

    def __init__(self, clouds: Sequence[Points]):
        from scipy.spatial import KDTree

        self.extent = np.maximum(np.ptp(np.concatenate(clouds), axis=0), LEAST_EXTENT)
        self.trees = [KDTree(cloud / self.extent) for cloud in clouds]
        self.reach = np.array([self.reach_of(tree) for tree in self.trees])
        """Distance within which a walk is on each motion."""

    @staticmethod
    def reach_of(tree) -> float:
        """Return the reach of a cloud, from the distances of its points to their neighbours."""
        apart = tree.query(tree.data[SPARSE], k=2)[0][:, 1]
        return max(APART * float(np.median(apart)), RESOLUTION)

    def distances(
        self, walks: Float[np.ndarray, "n states section"]
    ) -> Float[np.ndarray, "n clouds"]:
        """Return the median distance of each walk's states from each cloud; NaN does not count."""
        found = np.empty((len(walks), len(self.trees)))
        for first in range(0, len(walks), WALKS_AT_ONCE):
            part = walks[first : first + WALKS_AT_ONCE] / self.extent
            known = np.isfinite(part).all(axis=2)
            each = np.full(known.shape, np.nan)
            for i, tree in enumerate(self.trees):
                each[known] = tree.query(part[known])[0]
                found[first : first + WALKS_AT_ONCE, i] = np.nanmedian(each, axis=1)
        return found

    def nearest(
        self, walks: Float[np.ndarray, "n states section"]
    ) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Return the nearest motion of each walk, and whether the walk is within its reach."""
        distances = self.distances(walks)
        return distances.argmin(axis=1), np.any(distances <= self.reach, axis=1)


def is_same_motion(one: Points, other: Points) -> bool:
    """Return whether two long walks are on one motion: each within the reach of the other."""
    clouds = Clouds([one, other])
    apart = clouds.distances(np.stack([one[SPARSE], other[SPARSE]]))
    return bool((apart <= clouds.reach).all())


def distinct_motions(
    walks: Float[np.ndarray, "n points section"], known: Sequence[Points], most: int
) -> list[Points]:
    """Return one walk of each motion that is not among the known ones, at most `most`."""
    left, new = [*walks], []
    for cloud in known:
        left = [walk for walk in left if not is_same_motion(walk, cloud)]
    while left and len(new) < most:
        new.append(left[0])
        left = [walk for walk in left[1:] if not is_same_motion(walk, new[-1])]
    return new
