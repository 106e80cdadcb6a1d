"""The nearest failure to the origin, by descents along the boundary of failures.

In up to three dimensions rays in all directions find the nearest failures; in more, rays in random
directions find some. From the nearest of these, descents follow the boundary: the nearest point of
a flat boundary lies along its normal, to which each step turns a ray. Each descent ends at a local
minimum of the distance, and the least minimum is the answer.
"""

import math

import numpy as np
from jaxtyping import Bool, Float

from walker_jax.stability.rays import (
    DENSE,
    FINE,
    Basis,
    Chosen,
    Fails,
    Gradient,
    Lengths,
    Points,
    Rays,
    bisect,
    bisect_nearest,
    first_failures,
    nearest_rays,
    scan,
    spread_directions,
)

LARGEST_SPAN = 3
"""Most dimensions in which all directions are tried, spread evenly (`rays`)."""
SHARE = 1 / 16
"""Number of random directions, as a share of the number in a plane."""
RADII = 32
"""Distances along each random ray."""
DESCENTS = 12
"""Number of descents, from the nearest failures found: most of them end at the same few minima."""
STEPS = 60
"""Most steps of a descent."""
TURNS = np.array([0.0, 0.125, 0.25, 0.5, 1.0, 2.0])
"""Shares, tried in each step, of the step to the nearest point of a flat boundary."""
NEARER = np.array([*np.arange(1, 16) / 16, 0.999, 0.99925, 0.9995, 0.99975, 1.0])
"""Shares of the present length that a step tries on each ray: there may be nearer failures, and a
thin one is met best where it is widest, at its end."""
GAPS = np.diff(NEARER, prepend=0.0)
"""How far each of them is beyond the one before."""
JUST_BEYOND = 1 + 1e-10
"""Multiple of the length at which normals are computed. On the boundary itself, rounding would
decide how a walk ends."""
FINAL_DISTANCES = 512
"""Distances in the last check that nothing nearer fails in the direction found."""
SETTLED = 1e-14
"""Relative change of the length in a step below which a descent ends: about the error of a length.
The direction is then right to the root of this."""


def nearest_failure(
    fails: Fails,
    basis: Basis,
    gradient: Gradient,
    count: int = DENSE,
    roughly_fails: Fails | None = None,
) -> Float[np.ndarray, " size"]:
    """Find the shortest failing vector in the span of an orthonormal basis.

    The origin must not fail. `gradient`, at failing points just beyond the boundary, is normal to
    it, or NaN. Rays are chosen by `count` directions in a plane, and by `roughly_fails`, if given,
    which may be faster than `fails`; where it is wrong, `fails` decides. Raises
    `ComputationFailed` where nothing fails.
    """
    find = nearest_rays if len(basis) <= LARGEST_SPAN else random_rays
    rays, rough = find(roughly_fails or fails, basis, count)
    rays, rough = rays[:DESCENTS], rough[:DESCENTS]
    lengths = shorten(fails, rays[:, None] @ basis, 1.01 * rough)[:, 0]
    there = fails(rough[:, None] * rays @ basis)  # thin failures lie between the lengths tried
    lengths = np.where(np.isinf(lengths) & there, rough, lengths)
    if np.isinf(lengths).all():
        return nearest_failure(fails, basis, gradient, count)
    rays, lengths = descend(fails, basis, gradient, rays, lengths, SETTLED)
    return first_on_ray(fails, rays[0] @ basis, lengths[0])


def first_on_ray(
    fails: Fails, ray: Float[np.ndarray, " size"], length: float
) -> Float[np.ndarray, " size"]:
    """Find the first failure on a ray that fails at some length, as far as samples show."""
    while True:
        first = first_failures(fails, ray[None], 0.0, (1 - 1e-9) * length, FINAL_DISTANCES)
        if np.isinf(first[0]):
            return length * ray
        length = bisect(fails, ray[None], first, length / FINAL_DISTANCES, FINE)[0]


def random_rays(fails: Fails, basis: Basis, count: int) -> tuple[Rays, Lengths]:
    """Find rays along and against the basis, and in random directions, that fail; nearest first."""
    rank = len(basis)
    random = spread_directions(rank, math.ceil(SHARE * count))
    rays = np.concatenate([np.eye(rank), -np.eye(rank), random])
    first = scan(fails, rays @ basis, RADII)
    nearest = first.argsort()[: np.isfinite(first).sum()]
    return rays[nearest], first[nearest]


def descend(
    fails: Fails,
    basis: Basis,
    gradient: Gradient,
    rays: Rays,
    lengths: Lengths,
    settled: float,
    halvings: int = FINE,
    same: float = 0.0,
) -> Chosen:
    """Follow descents from rays that fail at some lengths; the shortest comes first.

    One that comes within an angle `same` of a shorter one is dropped.
    """
    going = np.isfinite(lengths)
    ended = [(rays[~going], lengths[~going])]
    rays, lengths = rays[going], lengths[going]
    for _ in range(STEPS):
        if len(rays) == 0:
            break
        tried, reached = turn(fails, gradient, basis, rays, lengths, halvings)
        going = reached < (1 - settled) * lengths
        ended.append((tried[~going], reached[~going]))
        going &= ~follows_another(tried, reached, same)
        rays, lengths = tried[going], reached[going]
    rays, lengths = map(np.concatenate, zip(*ended, (rays, lengths), strict=True))
    order = lengths.argsort(kind="stable")
    rays, lengths = rays[order], lengths[order]
    alone = ~follows_another(rays, lengths, same)
    return rays[alone], lengths[alone]


def follows_another(rays: Points, lengths: Lengths, same: float) -> Bool[np.ndarray, " n"]:
    """Mark rays within an angle of a shorter one, or of an earlier one of the same length."""
    close = np.linalg.norm(rays[:, None] - rays, axis=2) < same
    before = np.tri(len(rays), k=-1, dtype=bool)
    shorter = (lengths < lengths[:, None]) | (before & (lengths == lengths[:, None]))
    return (close & shorter).any(axis=1)


def turn(
    fails: Fails, gradient: Gradient, basis: Basis, rays: Rays, lengths: Lengths, halvings: int
) -> tuple[Rays, Lengths]:
    """Take one step of each descent: of some rays towards the normal, keep the shortest."""
    with np.errstate(invalid="ignore", divide="ignore"):  # there may be no gradient
        normal = gradient(JUST_BEYOND * lengths[:, None] * rays @ basis) @ basis.T
        along = normal / np.sum(normal * rays, axis=1, keepdims=True) - rays
    tried = rays[:, None] + TURNS[:, None] * along[:, None]
    tried = np.where(np.isfinite(tried), tried, rays[:, None])
    tried /= np.linalg.norm(tried, axis=2, keepdims=True)
    reached = shorten(fails, tried @ basis, lengths, halvings)
    reached[:, 0] = np.minimum(reached[:, 0], lengths)  # that ray is the present one
    return tried[np.arange(len(rays)), reached.argmin(axis=1)], reached.min(axis=1)


def shorten(
    fails: Fails, rays: Float[np.ndarray, "n m size"], lengths: Lengths, halvings: int = FINE
) -> Float[np.ndarray, "n m"]:
    """Find the first of `NEARER` shares of a length that fails on each of m rays; else infinity.

    Only the shortest of the m is exact.
    """
    points = lengths[:, None, None, None] * NEARER[:, None] * rays[:, :, None]
    failed = fails(points.reshape(-1, rays.shape[2])).reshape(points.shape[:3])
    at = failed.argmax(axis=2)
    first = np.where(failed.any(axis=2), lengths[:, None] * NEARER[at], np.inf)
    return bisect_nearest(fails, rays, first, lengths[:, None] * GAPS[at], lengths, halvings)
