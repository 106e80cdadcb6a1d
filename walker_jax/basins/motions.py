"""Motions without a period: which of many walks share one.

A walk on such a motion visits a cloud of points. Two walks share the motion if the points of each
lie about as near to the cloud of the other as the points of that cloud to each other. Distances
are in extents of the clouds, coordinate by coordinate.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

APART = 4.0
"""Typical distances between the points of a cloud, beyond which a walk is not on its motion. Two
walks on one motion are about one such distance apart."""
RESOLUTION = 1e-3
"""Least such distance, in extents: walks that settle slowly are as far from their motion, and the
points of a cycle too long to be recognised lie on each other."""
LEAST_EXTENT = 0.01
"""Least extent of clouds in a coordinate: along others walks may still be settling."""
SPARSE = slice(None, None, 16)
"""Points of a long walk whose distances are computed: enough for a median."""

Points = Float[Any, "points section"]


class Clouds(NamedTuple):
    """The clouds of several motions, for the distances of walks from them."""

    points: Float[Any, "points clouds section"]
    """In extents."""
    extent: Float[Any, " section"]
    reach: Float[Any, " clouds"]
    """Distance within which a walk is on each motion."""


def clouds_of(points: Sequence[Points]) -> Clouds:
    """Return the clouds of motions with their reach; arrays of JAX or of NumPy, as the points."""
    return compare_clouds(points)[0]


def compare_clouds(points: Sequence[Points]) -> tuple[Clouds, Float[Any, "clouds states clouds"]]:
    """Return clouds, and the distances of some points of each from all of them."""
    xp = points[0].__array_namespace__()
    clouds, count = xp.stack(points, axis=1), len(points)
    extent = xp.maximum(clouds.max(axis=(0, 1)) - clouds.min(axis=(0, 1)), LEAST_EXTENT)
    clouds = clouds / extent
    states = xp.moveaxis(clouds[SPARSE], 1, 0).reshape(-1, len(extent))
    nearest, second = (one.reshape(count, -1, count) for one in two_nearest(clouds, states))
    own = second[np.arange(count), :, np.arange(count)]  # each point is nearest to itself
    reach = xp.maximum(APART * xp.median(own, axis=1), RESOLUTION)
    return Clouds(clouds, extent, reach), nearest


def two_nearest(
    clouds: Float[Any, "points clouds section"], x: Float[Any, "n section"]
) -> tuple[Float[Any, "n clouds"], Float[Any, "n clouds"]]:
    """Return the distances of states from the nearest point of each cloud, and from the second.

    A state that is not finite has none.
    """
    if isinstance(x, np.ndarray):
        from scipy.spatial import KDTree  # which only motions without a period need

        found, known = np.full((2, len(x), clouds.shape[1]), np.nan), np.isfinite(x).all(axis=1)
        for i, cloud in enumerate(np.moveaxis(clouds, 1, 0)):
            found[:, known, i] = KDTree(cloud).query(x[known], k=2)[0].T
        return found[0], found[1]
    return jax.vmap(partial(two_nearest_to, clouds))(x)


def two_nearest_to(
    clouds: Float[Array, "points clouds section"], x: Float[Array, " section"]
) -> tuple[Float[Array, " clouds"], Float[Array, " clouds"]]:
    """Return the distances of one state from the nearest points of each cloud."""

    clouds = jnp.asarray(clouds)

    def nearer(i: Int[Array, ""], least: tuple) -> tuple:
        apart = jnp.sum((clouds[i] - x) ** 2, axis=1)
        first, second = least
        return jnp.minimum(first, apart), jnp.minimum(second, jnp.maximum(first, apart))

    far = jnp.full(clouds.shape[1], jnp.inf, x.dtype)
    first, second = lax.fori_loop(0, len(clouds), nearer, (far, far))
    return jnp.sqrt(first), jnp.sqrt(second)


def distances_from(
    clouds: Clouds, walks: Float[Any, "*n states section"]
) -> Float[Any, "*n clouds"]:
    """Return the median distance of each walk's states from each cloud; NaN does not count."""
    states = (walks / clouds.extent).reshape(-1, walks.shape[-1])
    nearest, _ = two_nearest(clouds.points, states)
    found = nearest.reshape(*walks.shape[:-1], clouds.points.shape[1])
    return walks.__array_namespace__().nanmedian(found, axis=-2)


def nearest_motion(
    clouds: Clouds, walks: Float[Any, "*n states section"]
) -> tuple[Int[Any, "*n"], Bool[Any, "*n"]]:
    """Return the nearest motion of each walk, and whether the walk is within its reach."""
    distances = distances_from(clouds, walks)
    return distances.argmin(axis=-1).astype(np.int32), (distances <= clouds.reach).any(axis=-1)


def is_same_motion(one: Points, other: Points) -> bool:
    """Return whether two long walks are on one motion: each within the reach of the other."""
    clouds, distances = compare_clouds([one, other])
    return bool((np.median(distances, axis=1) <= clouds.reach).all())


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
