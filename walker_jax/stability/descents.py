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
    Fails,
    Gradient,
    bisect_nearest,
    first_failures,
    first_on_ray,
    nearest_rays,
    scan,
    spread_directions,
    turned_rays,
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
TURNS = np.array([0.0, 0.25, 0.5, 1.0, 1.6])
"""Shares, tried in each step, of the step to the nearest point of a flat boundary."""
NEARER = 16
"""Distances that a step tries on each ray, up to the present one: there may be nearer failures."""
SETTLED = 1e-10
"""Relative change of the length in a step below which a descent ends."""


def nearest_failure(
    fails: Fails,
    basis: Float[np.ndarray, "rank size"],
    gradient: Gradient,
    count: int = DENSE,
    roughly_fails: Fails | None = None,
) -> Float[np.ndarray, " size"]:
    """Find the shortest failing vector in the span of an orthonormal basis.

    The origin must not fail. `gradient`, at failing points just beyond the boundary, is normal to
    it, or NaN. Rays are chosen by `count` directions in a plane, and by `roughly_fails`, if given,
    which may be faster than `fails`. Raises `ComputationFailed` where nothing fails.
    """
    find = nearest_rays if len(basis) <= LARGEST_SPAN else random_rays
    rays, rough = find(roughly_fails or fails, basis, count)
    rays, rough = rays[:DESCENTS], rough[:DESCENTS]
    lengths = shorten(fails, rays[:, None] @ basis, 1.01 * rough)[:, 0]
    lengths = np.where(np.isfinite(lengths), lengths, rough)
    rays, lengths = descend(fails, basis, gradient, rays, lengths, SETTLED)
    return first_on_ray(fails, rays[0] @ basis, lengths[0])


def random_rays(
    fails: Fails, basis: Float[np.ndarray, "rank size"], count: int
) -> tuple[Float[np.ndarray, "n rank"], Float[np.ndarray, " n"]]:
    """Find rays along and against the basis, and in random directions, that fail; nearest first."""
    rank = len(basis)
    random = spread_directions(rank, math.ceil(SHARE * count))
    rays = np.concatenate([np.eye(rank), -np.eye(rank), random])
    first = scan(fails, rays @ basis, RADII)
    nearest = first.argsort()[: np.isfinite(first).sum()]
    return rays[nearest], first[nearest]


def descend(
    fails: Fails,
    basis: Float[np.ndarray, "rank size"],
    gradient: Gradient,
    rays: Float[np.ndarray, "n rank"],
    lengths: Float[np.ndarray, " n"],
    settled: float,
    halvings: int = FINE,
    same: float = 0.0,
) -> tuple[Float[np.ndarray, "m rank"], Float[np.ndarray, " m"]]:
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


def follows_another(
    rays: Float[np.ndarray, "n size"], lengths: Float[np.ndarray, " n"], same: float
) -> Bool[np.ndarray, " n"]:
    """Mark rays within an angle of a shorter one, or of an earlier one of the same length."""
    close = np.linalg.norm(rays[:, None] - rays, axis=2) < same
    before = np.tri(len(rays), k=-1, dtype=bool)
    shorter = (lengths < lengths[:, None]) | (before & (lengths == lengths[:, None]))
    return (close & shorter).any(axis=1)


def turn(
    fails: Fails,
    gradient: Gradient,
    basis: Float[np.ndarray, "rank size"],
    rays: Float[np.ndarray, "n rank"],
    lengths: Float[np.ndarray, " n"],
    halvings: int,
) -> tuple[Float[np.ndarray, "n rank"], Float[np.ndarray, " n"]]:
    """Take one step of each descent, to the shortest of some rays towards the normal."""
    tried = turned_rays(gradient, basis, rays, lengths, TURNS)
    reached = shorten(fails, tried @ basis, lengths, halvings)
    reached[:, 0] = np.minimum(reached[:, 0], lengths)  # that ray is the present one
    return tried[np.arange(len(rays)), reached.argmin(axis=1)], reached.min(axis=1)


def shorten(
    fails: Fails,
    rays: Float[np.ndarray, "n m size"],
    lengths: Float[np.ndarray, " n"],
    halvings: int = FINE,
) -> Float[np.ndarray, "n m"]:
    """Find the first failure on each of m rays up to one length; infinite where there is none.

    Only the shortest of the m is exact.
    """
    flat = rays.reshape(-1, rays.shape[2])
    first = first_failures(fails, flat, 0.0, np.repeat(lengths, rays.shape[1]), NEARER)
    gaps = lengths[:, None] / NEARER
    return bisect_nearest(fails, rays, first.reshape(rays.shape[:2]), gaps, lengths, halvings)
