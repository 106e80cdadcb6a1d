"""Points of a boundary nearest to the origin, by Newton's iteration, and the chance to exceed it.

Consider a set of failures in many dimensions, such as sequences of disturbances that topple a
walker. Only the normal of its boundary is known. Along a ray u the boundary is at the distance
r(u), and at the nearest point the normal nu is along the ray. Newton's iteration solves that
condition on the sphere of directions:

    F(u) = nu - u = 0,  nu . u = 1,  dF = -(I - r W) du

with W the curvature of the boundary. The determinant gives the effect of the curvature on the
chance that independent normal numbers of standard deviation sigma lie beyond the boundary (Breitung
1984, J. Eng. Mech. 110:357-366):

    chance = Phi(-r / sigma) / sqrt(det(I - r W)),  as sigma goes to 0
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.stability.descents import JUST_BEYOND, RADII, descend
from walker_jax.stability.rays import Fails, Gradient, Lengths, Points, bisect, scan, tangents

ROUGHLY = 16
"""Bisections of lengths in a descent: to a millionth."""
SAME = 0.02
"""Largest angle between rays of descents to the same point."""
FLAT = 1e-4
"""Relative change of a length in a step below which a descent ends, and Newton's iteration begins.
The angle to the nearest ray is then about the square root of this."""
TURN = 1e-4
"""Angle by which rays are turned for differences; their error is its square."""
REACHES, HALVINGS = 10.0 ** np.arange(-7, -1), 38
"""Relative distances within which the boundary is sought on a turned ray, the smallest first
because failures may be a thin finger; and bisections, down to rounding."""
NEWTON_STEPS, CONVERGED = 12, 1e-10
"""Most steps of Newton's iteration, and the angle between ray and normal at which it ends."""
SHARES = 0.3 ** np.arange(5)
"""Shares of a step, tried in turn until one brings ray and normal closer."""
LARGEST_STEP = 0.1
"""Largest angle by which one step of Newton's iteration turns a ray."""


class NearestPoint(NamedTuple):
    """A point of a boundary that is nearer to the origin than its neighbours."""

    ray: Float[np.ndarray, " size"]
    """Direction of the point, of length one."""
    length: float
    residual: float
    """Angle between the ray and the normal of the boundary."""
    flatness: float
    """det(I - r W): 1 for a flat boundary, less where it bends towards the origin."""


def nearest_minima(
    fails: Fails,
    gradient: Gradient,
    rays: Points,
    most: int,
    known: tuple[int, float] = (0, np.inf),
) -> tuple[Float[np.ndarray, "m size"], Float[np.ndarray, " m"]]:
    """Find local minima of the distance, from the nearest failures on some rays.

    The nearest comes first. `known` is a number of first rays, and a length at which these fail.
    """
    first = scan(fails, rays, RADII)
    count, length = known
    first[:count] = np.minimum(first[:count], length)
    nearest = first.argsort()[: min(most, np.isfinite(first).sum())]
    basis = np.eye(rays.shape[1])
    return descend(fails, basis, gradient, rays[nearest], first[nearest], FLAT, ROUGHLY, SAME)


def solve_nearest(
    fails: Fails, gradient: Gradient, ray: Float[np.ndarray, " size"], length: float
) -> NearestPoint:
    """Find the nearest point of a boundary, by Newton's iteration from a ray close to it.

    The iteration ends where a step brings ray and normal no closer, or differences find no
    boundary.
    """
    lengths, (miss,) = misalignment(fails, gradient, ray[None], length)
    found = float(lengths[0]) if np.isfinite(lengths[0]) else length
    best = NearestPoint(ray, found, float(np.linalg.norm(miss)), np.nan)
    for _ in range(NEWTON_STEPS):
        jacobian = bending(fails, gradient, best)
        if not np.isfinite(jacobian).all():
            break
        flatness = float(np.linalg.det(jacobian))
        best = best._replace(flatness=flatness)
        if best.residual < CONVERGED or not flatness:
            break
        across = tangents(best.ray)
        step = np.linalg.solve(jacobian, across @ miss) @ across
        step *= LARGEST_STEP / max(LARGEST_STEP, np.linalg.norm(step))
        tried = best.ray + SHARES[:, None] * step
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        lengths, misses = misalignment(fails, gradient, tried, best.length)
        residuals = np.linalg.norm(misses, axis=1)
        closer = np.flatnonzero(residuals < best.residual)
        if len(closer) == 0:
            break
        first, miss = closer[0], misses[closer[0]]
        best = NearestPoint(tried[first], float(lengths[first]), float(residuals[first]), flatness)
    return best


def bending(fails: Fails, gradient: Gradient, near: NearestPoint) -> Float[np.ndarray, "rank rank"]:
    """Compute I - r W over the directions across a ray, by central differences."""
    across = tangents(near.ray)
    if len(across) == 0:
        return np.eye(0)
    turned = near.ray + TURN * np.stack([across, -across])
    turned = turned.reshape(-1, len(near.ray)) / np.sqrt(1 + TURN**2)
    _, miss = misalignment(fails, gradient, turned, near.length)
    # Turned rays have other tangents: those along which they were turned are shorter.
    ahead, behind = miss.reshape(2, len(across), -1) @ across.T
    return -((ahead - behind) / (2 * TURN)).T


def misalignment(
    fails: Fails, gradient: Gradient, rays: Points, length: float
) -> tuple[Lengths, Points]:
    """Return the length of each ray up to the boundary, near a known one, and F = nu - u."""
    tried = length * np.stack([1 - REACHES, 1 + REACHES])
    points = tried[..., None] * rays[:, None, None]
    before, after = np.moveaxis(
        fails(points.reshape(-1, rays.shape[1])).reshape(-1, *tried.shape), 1, 0
    )
    crossed = ~before & after
    reach = np.where(crossed.any(axis=1), length * REACHES[crossed.argmax(axis=1)], np.inf)
    with np.errstate(invalid="ignore"):
        lengths = bisect(fails, rays, length + reach, 2 * reach, HALVINGS)
    known = np.isfinite(lengths)
    miss = np.full(rays.shape, np.nan)
    if known.any():
        normals = gradient(JUST_BEYOND * lengths[known, None] * rays[known])
        miss[known] = normals / np.sum(normals * rays[known], axis=1, keepdims=True) - rays[known]
    return lengths, miss
