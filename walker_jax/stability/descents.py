"""The nearest failure to a state, in more dimensions than can be searched ray by ray.

Rays in random directions find some failures. From the nearest of these, descents follow the
boundary: the nearest point of a flat boundary lies along its normal. Each descent ends at a local
minimum of the distance, and the least minimum is the answer.
"""

import math

import numpy as np
from jaxtyping import Float

from walker_jax.stability.rays import (
    DENSE,
    FINE,
    Fails,
    Gradient,
    bisect,
    first_failures,
    first_on_ray,
    scan,
    spread_directions,
    turned_rays,
)

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


def descend_to_failure(
    fails: Fails,
    basis: Float[np.ndarray, "rank size"],
    gradient: Gradient,
    count: int = DENSE,
    roughly_fails: Fails | None = None,
) -> Float[np.ndarray, " size"]:
    """Find a short failing vector in the span of an orthonormal basis, by descents.

    Arguments and errors are those of `rays.nearest_failure`.
    """
    rank = len(basis)
    random = spread_directions(rank, math.ceil(SHARE * count))
    rays = np.concatenate([np.eye(rank), -np.eye(rank), random])
    first = scan(roughly_fails or fails, rays @ basis, RADII)
    nearest = first.argsort()[:DESCENTS]
    rays, lengths = rays[nearest], first[nearest]
    rays, lengths = rays[np.isfinite(lengths)], lengths[np.isfinite(lengths)]
    lengths = shorten(fails, rays @ basis, 1.01 * lengths)  # `roughly_fails` may err
    going = np.isfinite(lengths)
    for _ in range(STEPS):
        if not going.any():
            break
        tried, reached = turn(fails, gradient, basis, rays[going], lengths[going])
        change = 1 - reached / lengths[going]
        rays[going], lengths[going] = tried, reached
        going[going] = change > SETTLED
    return first_on_ray(fails, rays[lengths.argmin()] @ basis, lengths.min())


def turn(
    fails: Fails,
    gradient: Gradient,
    basis: Float[np.ndarray, "rank size"],
    rays: Float[np.ndarray, "n rank"],
    lengths: Float[np.ndarray, " n"],
    halvings: int = FINE,
) -> tuple[Float[np.ndarray, "n rank"], Float[np.ndarray, " n"]]:
    """Take one step of each descent, to the shortest of some rays towards the normal."""
    tried = turned_rays(gradient, basis, rays, lengths, TURNS)
    flat = tried.reshape(-1, rays.shape[1]) @ basis
    reached = shorten(fails, flat, np.repeat(lengths, len(TURNS)), halvings)
    reached = reached.reshape(len(rays), -1)
    reached[:, 0] = np.minimum(reached[:, 0], lengths)  # that ray is the present one
    best = reached.argmin(axis=1)
    row = np.arange(len(rays))
    return tried[row, best], reached[row, best]


def shorten(
    fails: Fails,
    rays: Float[np.ndarray, "n size"],
    lengths: Float[np.ndarray, " n"],
    halvings: int = FINE,
) -> Float[np.ndarray, " n"]:
    """Find the first failure on each ray up to its own length; infinite where there is none."""
    first = first_failures(fails, rays, 0.0, lengths, NEARER)
    return bisect(fails, rays, first, lengths / NEARER, halvings)
