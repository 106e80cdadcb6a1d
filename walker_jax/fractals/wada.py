"""The Wada property: whether three regions or more share one boundary.

A boundary is Wada if every point of it is a boundary point of all regions. Merge all regions but
one: the boundary between that region and the rest is the same for every choice of the region if and
only if the boundary is Wada (Daza, Wagemakers and Sanjuan 2018, Scientific Reports 8, 9954). On a
grid, two boundaries agree only up to a distance of some cells. That distance shrinks on finer grids
if the boundary is Wada, and stays otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import WrongUse, array, check_number, check_whole, refuses_tracers, short

MIN_REGIONS = 3
"""Fewest regions for the Wada property: two regions always share their boundary."""
RADIUS = 5.0
"""Default distance, in cells, within which two boundaries count as one."""
HALVINGS = 3
"""Default number of coarser grids to compare."""
SHRINKS = 0.75
"""Largest ratio of the mean distances of a Wada boundary on a grid and on one twice as coarse. It
is 0.39 to 0.56 for basins of Newton's method, and 0.92 to 1.37 for two curves a few cells apart."""
FEW = 0.01
"""Largest share of a Wada boundary beyond the radius of another on the finest grid."""
FALLS = 0.5
"""Least power of the spacing with which the largest distance of a Wada boundary falls, over all
grids. The power is 1 if the same few cells part boundaries on every grid, and 0 if these are truly
apart somewhere."""


class Wada(NamedTuple):
    """Distances between the boundaries of regions, on several grids."""

    labels: Float[np.ndarray, " n"]
    """Labels of the regions."""
    spacings: Int[np.ndarray, " grids"]
    """Spacing of the points of each grid, in cells of the finest: 1, 2, 4 ..."""
    distances: Float[np.ndarray, "grids n n"]
    """[g, j, k]: largest distance of a point on the boundary of region j from the boundary of
    region k, in cells of the finest grid. Infinite where k has no boundary; NaN where j has none,
    and on a grid whose points miss one of the regions."""
    beyond: Float[np.ndarray, "grids n n"]
    """[g, j, k]: share of the boundary of j farther than the radius from that of k. The radius is
    in points of this grid."""
    mean_distances: Float[np.ndarray, "grids n n"]
    """[g, j, k]: the mean distance, where `distances` has the largest."""

    @property
    def wada(self) -> bool:
        """Whether all boundaries agree within the radius, and agree better on the finest grid.

        All regions must have a boundary on the finest grid. The mean distance must be at most
        `SHRINKS` times that on the next grid, so the answer is False without a coarser grid. A
        share `FEW` of the points may be beyond the radius, if the largest distance falls from grid
        to grid. Boundaries that are truly apart keep their distance. Thin regions side by side, a
        cell wide or less, look like a Wada boundary on a grid, and so does noise: only a finer grid
        tells.
        """
        if len(self.spacings) == 1 or not (self.beyond[0] <= FEW).all():  # False for NaN
            return False
        finest, coarser = np.fmax.reduce(self.mean_distances[:2], axis=(1, 2))
        if not finest <= SHRINKS * coarser:
            return False
        largest = np.fmax.reduce(self.distances, axis=(1, 2))
        known = np.isfinite(largest) & (largest > 0)
        if self.share[0] == 0 or known.sum() < 2:
            return bool(self.share[0] == 0)
        power = np.polyfit(np.log(self.spacings[known]), np.log(largest[known]), 1)[0]
        return bool(power >= FALLS)

    @property
    def share(self) -> Float[np.ndarray, " grids"]:
        """The largest share of a boundary that another boundary lacks, on each grid.

        If the boundary is Wada, it is zero or falls towards zero on finer grids. It also falls if
        boundaries are merely close, as those of thin regions are.
        """
        return np.fmax.reduce(self.beyond, axis=(1, 2))


@refuses_tracers()
def merge_regions(
    labels: Int[np.ndarray | Array, "*cells"],
    radius: float | int = RADIUS,
    *,
    halvings: int = HALVINGS,
) -> Wada:
    """Compare the boundary of each region, all others merged, to test the Wada property.

    A point of the grid is on the boundary of a region if one of it and its neighbours, corners
    included, is in the region and another is in a different region. Distances are Chebyshev
    distances, the largest over the axes. Grids of every second, fourth ... point show how distances
    and shares change with the resolution.

    **Arguments:**

    - `labels`: of `MIN_REGIONS` regions or more, at regularly spaced points; negative where a point
      is in no region.
    - `radius`: distance, in points of a grid, at which boundaries still count as one.
    - `halvings`: number of coarser grids that are compared too.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 200))
    data = wj.basin(wj.SimplestWalker(0.004), grid)
    wj.fractals.merge_regions(data.fate.values).wada  # do all fates share one boundary?
    ```

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
    """Raise `WrongUse` unless the radius is a distance."""
    check_number("radius", radius)
    if not 0 <= radius < np.inf:
        raise WrongUse(f"radius={radius}: must be zero or more, and finite")


def boundary_of(
    inside: Bool[np.ndarray, "*cells"], outside: Bool[np.ndarray, "*cells"]
) -> Bool[np.ndarray, "*cells"]:
    """Mark the points where, of the point and its neighbours, one is inside and one outside."""
    from scipy.ndimage import maximum_filter

    return np.logical_and(maximum_filter(inside, 3), maximum_filter(outside, 3))


def distance_from(points: Bool[np.ndarray, "*cells"]) -> Float[np.ndarray, "*cells"]:
    """Return each cell's Chebyshev distance from the nearest point; infinite if there is none."""
    from scipy.ndimage import distance_transform_cdt

    if not points.any():
        return np.full(points.shape, np.inf)
    return np.asarray(distance_transform_cdt(~points, "chessboard"), float)
