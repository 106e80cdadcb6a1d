"""The nearest failure along rays from a state."""

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.checks import ComputationFailed
from walker_jax.segments import Segments, narrow

RAYS, RADII = 720, 128
"""Directions in two dimensions, and distances along each, of the first scan."""
PARTS = 8
"""Parts of these distances, tried outwards up to the first in which anything fails."""
DENSE, SHELL = 16 * RAYS, 64
"""Directions of the second scan, and its distances up to the nearest failure."""
KEPT = 0.01
"""Largest relative excess over the nearest failure's distance for which a ray is kept."""
ARC, CLOSER = 2000 / DENSE, 16
"""Share of directions that get a fan of their own, and the directions of such a fan."""
FAN = 61
"""Directions of a fan around one of the nearest rays."""
CANDIDATES = 128 / DENSE
"""Largest number of local minima of the distance that are refined, as a share of directions."""
ZOOMS, NARROWER = 3, 0.25
"""Number of times that fans are narrowed, and the ratio of their widths."""
ZOOM_DEPTH, ZOOM_DISTANCES = 0.015, 10
"""Share of the nearest distance by which the first fan reaches below it, and distances along each
ray. Narrower fans hold nearer failures by less: depth and `KEPT` narrow with them."""
COARSE, FINE = 12, 34
"""Halvings between two points on a ray: to compare rays, and for the final distance."""
AT_ONCE, MOST_HALVINGS = 32, 4
"""Points in a call that takes hardly longer than one of a few points, and most halvings in it."""

Points = Float[np.ndarray, "n size"]
Rays = Float[np.ndarray, "n rank"]
"""Unit vectors by their components along a basis."""
Basis = Float[np.ndarray, "rank size"]
Lengths = Float[np.ndarray, " n"]
Chosen = tuple[Float[np.ndarray, "m rank"], Float[np.ndarray, " m"]]
"""Some of n rays, and their lengths."""
Fails = Callable[[Points], Bool[np.ndarray, " n"]]
Gradient = Callable[[Points], Points]


def nearest_rays(fails: Fails, basis: Basis, count: int) -> tuple[Rays, Lengths]:
    """Find directions of the local minima of the distance to failures, and these distances."""
    rank = len(basis)
    rays = spread_directions(rank, RAYS)
    first = scan(fails, rays @ basis, RADII, PARTS)
    # Closer rays, then closer distances: a nearer failure may lie between those of the first scan.
    # If the next distances miss a finger that is already known, the known distance is kept.
    dense = spread_directions(rank, count)
    near = keep_nearest(fails, dense, basis, 0.0, 1.01 * first.min(), SHELL)
    rays, first = near if near[1].size else (rays[np.isfinite(first)], first[np.isfinite(first)])
    near = keep_nearest(fails, dense, basis, 0.9 * first.min(), 1.01 * first.min(), SHELL)
    rays, first = near if near[1].size else (rays, first)
    width, candidates = spacing(rank, count), math.ceil(CANDIDATES * count)
    if rank > 1:  # more of them wherever the boundary is about as near
        arc = rays[first.argsort()[: math.ceil(ARC * count)]]
        arc = np.concatenate([fan(ray, width, CLOSER) for ray in arc])
        near = keep_nearest(fails, arc, basis, 0.98 * first.min(), 1.003 * first.min(), 32)
        rays, first = near if near[1].size else (rays, first)
    width = 4 * width / CLOSER
    minima = local_minima(rays, first, width, candidates)
    best, lengths = rays[minima], first[minima]
    for zoom in NARROWER ** np.arange(ZOOMS if rank > 1 else 0):
        nearest, kept = lengths.min(), KEPT * zoom
        fans = best[lengths <= (1 + kept) * nearest]
        fans = np.concatenate([fan(ray, width * zoom, FAN) for ray in fans])
        # The nearest failures of a fan lie slightly before those of the wider one.
        low, high = (1 - ZOOM_DEPTH * zoom) * nearest, (1 + kept) * nearest
        rays, first = keep_nearest(fails, fans, basis, low, high, ZOOM_DISTANCES, kept)
        if first.size:
            minima = local_minima(rays, first, width * zoom, candidates)
            best, lengths = rays[minima], first[minima]
    return best, lengths


def scan(fails: Fails, rays: Points, count: int, parts: int = 1) -> Lengths:
    """Find the first failure along each ray, within a reach of at most four times the nearest.

    With several `parts` of the reach, only failures in the part of the nearest are found. Raises
    `ComputationFailed` where nothing fails up to a length of a thousand.
    """
    reach = 0.1
    while True:
        for part in np.split(np.linspace(0.0, reach, count + 1)[1:], parts):
            first = first_of(fails, rays, np.broadcast_to(part, (len(rays), len(part))))
            if np.isfinite(first).any():
                break
        if np.isinf(first).all():
            if reach > 1e3:
                raise ComputationFailed(
                    "no failure found: the walker returns to its gait from all disturbances tried, "
                    f"of a size up to {reach:g}"
                )
            reach *= 4
        elif first.min() < reach / 4:
            reach = 2 * first.min()
        else:
            return first


def keep_nearest(
    fails: Fails, rays: Rays, basis: Basis, low: float, high: float, count: int, kept: float = KEPT
) -> Chosen:
    """Return the rays whose first failure is among the nearest, and its distance."""
    while True:
        gap = (high - low) / count
        first = first_failures(fails, rays @ basis, low, high, count)
        if low == 0 or first.min() > low + 1.5 * gap:
            break
        low, high = max(0.0, low - count * gap), low + gap  # there may be nearer ones
    near = first < max(first.min() + 1.5 * gap, (1 + kept) * first.min())
    return rays[near], bisect(fails, rays[near] @ basis, first[near], gap, COARSE)


def first_failures(fails: Fails, rays: Points, low: Any, high: Any, count: int) -> Lengths:
    """Return the first failing distance along each ray; infinite where none fails."""
    distances = np.linspace(low, high, count + 1, axis=-1)[..., 1:]
    return first_of(fails, rays, np.broadcast_to(distances, (len(rays), count)))


def first_of(fails: Fails, rays: Points, distances: Float[np.ndarray, "n m"]) -> Lengths:
    """Return the first of increasing distances that fails along each ray; infinite if none does."""
    points = distances[..., None] * rays[:, None]
    failed = fails(points.reshape(-1, rays.shape[1])).reshape(distances.shape)
    found = distances[np.arange(len(rays)), failed.argmax(axis=1)]
    return np.where(failed.any(axis=1), found, np.inf)


def bisect(fails: Fails, rays: Points, high: Lengths, gap: float | Lengths, times: int) -> Lengths:
    """Bisect for distances of the boundary, between failing ones and those a `gap` before.

    Of several boundaries it may find any.
    """
    gaps, least = np.broadcast_to(gap, high.shape), np.full(len(high), np.inf)
    found = bisect_nearest(fails, rays[:, None], high[:, None], gaps[:, None], least, times)
    return np.where(np.isfinite(high), found[:, 0], np.inf)


def bisect_nearest(
    fails: Fails,
    rays: Float[np.ndarray, "n m size"],
    high: Float[np.ndarray, "n m"],
    gap: float | Float[np.ndarray, "n _"],
    least: Lengths | Sequence[float],
    times: int = FINE,
    at_once: int = AT_ONCE,
) -> Float[np.ndarray, "n m"]:
    """Bisect n times m rays as `bisect` does, as far as the nearest of m needs.

    A ray is dropped once it is known to be longer than another of the m, or than the `least`. Few
    rays are halved several times in a call, of about `at_once` points.
    """
    ends = np.stack([high - gap, high], axis=2)[..., None]
    segments = Segments(ends, np.broadcast_to([False, True], (*high.shape, 2)).copy())
    while times:
        below, above = np.moveaxis(segments.ends[..., 0], 2, 0)
        going = below < np.minimum(above.min(axis=1), least)[:, None]
        if not going.any():
            break
        room = math.floor(math.log2(at_once / np.count_nonzero(going) + 1))
        halvings = min(max(1, room), MOST_HALVINGS, times)
        along = np.repeat(rays[going], 2**halvings - 1, axis=0)
        closer = narrow(lambda t, along=along: fails(t * along), segments.part(going), halvings)
        segments.ends[going], segments.labels[going] = closer
        times -= halvings
    return segments.ends[:, :, 1, 0]


def spread_directions(rank: int, count: int) -> Rays:
    """Return evenly spread unit vectors; in three dimensions four times as many as in two.

    In more dimensions they are random, and as many as in two.
    """
    if rank == 1:
        return np.array([[1.0], [-1.0]])
    if rank == 2:
        angles = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if rank > 3:
        x = np.random.default_rng(0).normal(size=(count, rank))
        return x / np.linalg.norm(x, axis=1, keepdims=True)
    # A spiral of equal steps in height on a sphere, turned by the golden angle.
    count *= 4
    height = 1 - (2 * np.arange(count) + 1) / count
    angles, radius = np.pi * (3 - np.sqrt(5)) * np.arange(count), np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=1)


def spacing(rank: int, count: int) -> float:
    """Return the angle between neighbours among `spread_directions`."""
    return 2 * np.pi / count if rank == 2 else float(np.sqrt(np.pi / count))


def fan(direction: Float[np.ndarray, " rank"], width: float, count: int) -> Rays:
    """Return unit vectors within an angle of a direction; the direction is the first of them."""
    across = tangents(direction)
    if len(across) == 1:
        offsets = np.linspace(-1, 1, count - 1)[:, None]
    else:
        angles = np.pi * (3 - np.sqrt(5)) * np.arange(count - 1)
        radius = np.sqrt((np.arange(count - 1) + 0.5) / (count - 1))
        offsets = radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rays = np.concatenate([direction[None], direction + width * offsets @ across])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def tangents(ray: Float[np.ndarray, " size"]) -> Basis:
    """Return unit vectors across a ray and each other."""
    return np.linalg.svd(ray[None])[2][1:]


def local_minima(rays: Rays, lengths: Lengths, angle: float, most: int) -> Int[np.ndarray, " m"]:
    """Return indices of the vectors of smallest length within an angle, the shortest first."""
    order = lengths.argsort()
    rays = rays[order]
    minima = (i for i in range(len(order)) if (rays[:i] @ rays[i] <= np.cos(angle)).all())
    return order[list(islice(minima, most))]
