"""Whether three regions or more have one boundary in common: the Wada property, by merging.

A boundary is Wada if every point of it is a boundary point of all regions. Merge all regions but
one: the boundary between that one and the rest is the same, whichever is left out, if and only if
the boundary is Wada (Daza, Wagemakers and Sanjuan 2018, Scientific Reports 8, 9954). On a grid two
boundaries are the same up to a distance of cells, which a finer grid must bring down: what is not
Wada keeps its distance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import WrongUse, array, check_number, check_whole, refuses_tracers, short

MIN_REGIONS = 3
"""Regions that a boundary can be common to in the sense of Wada: two always have theirs."""
RADIUS = 5.0
"""Cells within which two boundaries count as one by default."""
HALVINGS = 3
"""Coarser grids that are compared by default."""
SHRINKS = 0.75
"""Largest ratio of the mean distances of Wada boundaries on a grid and on one twice as coarse. It
is 0.39 to 0.56 for those of Newton's method, and 0.92 to 1.37 for two curves a few cells apart."""


class Wada(NamedTuple):
    """How far the boundary of each region is from that of each other one, on several grids."""

    labels: Float[np.ndarray, " n"]
    """Of the regions."""
    spacings: Int[np.ndarray, " grids"]
    """Of the points of each grid, in cells of the finest: 1, 2, 4 ..."""
    distances: Float[np.ndarray, "grids n n"]
    """[g, j, k]: of all points of the boundary of region j, how far the farthest is from that of
    region k, in cells of the finest grid; infinite where k has none. NaN where j has none, and on a
    grid whose points miss one of the regions."""
    beyond: Float[np.ndarray, "grids n n"]
    """[g, j, k]: share of the boundary of j farther than the radius from that of k, the radius in
    points of this grid."""
    mean_distances: Float[np.ndarray, "grids n n"]
    """[g, j, k]: the mean where `distances` has the largest."""

    @property
    def wada(self) -> bool:
        """Whether all boundaries are the same within the radius, the closer the finer the grid.

        All regions have a boundary on the finest grid, nowhere farther than the radius from that of
        each other one, and the mean distance is `SHRINKS` of that on the next grid, or less; so it
        is False without a coarser grid. Boundaries that are truly apart keep their distance. Many
        thin regions one beside the other, of a cell or less, are like Wada's on a grid, and so is
        noise: only a finer grid tells.
        """
        if len(self.spacings) == 1 or not (self.beyond[0] == 0).all():
            return False
        finest, coarser = np.fmax.reduce(self.mean_distances[:2], axis=(1, 2))
        return bool(finest <= SHRINKS * coarser)

    @property
    def share(self) -> Float[np.ndarray, " grids"]:
        """The largest share of a boundary that another boundary lacks, on each grid.

        It is zero, or falls towards zero on finer grids, if the boundary is Wada; but also if
        boundaries are merely near each other, as those of thin regions are.
        """
        return np.fmax.reduce(self.beyond, axis=(1, 2))


@refuses_tracers()
def merge_regions(
    labels: Int[np.ndarray | Array, "*cells"],
    radius: float | int = RADIUS,
    *,
    halvings: int = HALVINGS,
) -> Wada:
    """The boundaries of regions, each against all others merged: are they one, as Wada's are?

    A point of the grid is on the boundary of a region if of it and its neighbours, corners
    included, one is in the region and one is in another. Distances are Chebyshev's, the largest of
    the axes. The grids of every second, fourth ... point show how distances and shares go with the
    resolution.

    **Arguments:**

    - `labels`: of `MIN_REGIONS` regions or more, at regularly spaced points; negative where a point
      is in no region.
    - `radius`: distance, in points of a grid, at which boundaries still count as one.
    - `halvings`: how many coarser grids are compared too.

    Raises ValueError for fewer regions, and for grids too small to be made coarser that often.
    """
    labels = array("labels", labels)
    if labels.dtype.kind not in "biuf" or labels.ndim == 0:
        raise WrongUse(f"labels must be numbers on a grid, not {short(labels)}")
    check_radius(radius)
    check_whole("halvings", halvings, 0)
    found = np.unique(labels)
    found = found[found >= 0]
    if len(found) < MIN_REGIONS:
        raise WrongUse(f"labels must be of {MIN_REGIONS} regions or more, not of {len(found)}")
    if min(labels.shape) < 3 * 2**halvings:
        raise WrongUse(
            f"halvings={halvings}: labels must have {3 * 2**halvings} cells or more along each "
            f"axis, not {labels.shape}"
        )
    spacings = 2 ** np.arange(halvings + 1)
    shape = len(spacings), len(found), len(found)
    distances, beyond, means = np.full((3, *shape), np.nan)
    for grid, spacing in enumerate(spacings):
        coarse = labels[(slice(None, None, spacing),) * labels.ndim]
        edges = {
            place: boundary_of(coarse == label, (coarse >= 0) & (coarse != label))
            for place, label in enumerate(found)
            if (coarse == label).any()
        }
        for k, edge in edges.items():
            away = distance_from(edge)
            for j, other in edges.items():
                if other.any():
                    distances[grid, j, k] = spacing * away[other].max()
                    beyond[grid, j, k] = (away[other] > radius).mean()
                    means[grid, j, k] = spacing * away[other].mean()
    return Wada(found.astype(float), spacings, distances, beyond, means)


def check_radius(radius: float | int) -> None:
    """Refuse what is no distance."""
    check_number("radius", radius)
    if not 0 <= radius < np.inf:
        raise WrongUse(f"radius={radius}: must be zero or more, and finite")


def boundary_of(
    inside: Bool[np.ndarray, "*cells"], outside: Bool[np.ndarray, "*cells"]
) -> Bool[np.ndarray, "*cells"]:
    """The points of which, and of their neighbours, some are inside and some outside."""
    from scipy.ndimage import maximum_filter

    return np.logical_and(maximum_filter(inside, 3), maximum_filter(outside, 3))


def distance_from(points: Bool[np.ndarray, "*cells"]) -> Float[np.ndarray, "*cells"]:
    """Chebyshev's distance of each cell from the nearest of some; infinite without any."""
    from scipy.ndimage import distance_transform_cdt

    if not points.any():
        return np.full(points.shape, np.inf)
    return np.asarray(distance_transform_cdt(~points, "chessboard"), float)
