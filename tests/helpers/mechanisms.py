"""Small mechanisms, and random states of them."""

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.kernels import kernel
from walker_jax.multibody import System

GRAVITY = 9.81
COUNT = 30


def close(actual, expected, tolerance=1e-12):
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def uniform(seed, *shape, low=-1.0, high=1.0):
    return jnp.asarray(np.random.default_rng(seed).uniform(low, high, shape))


def states(seed, n, rates=4.0):
    """Any angles, and rates on both sides of that at which a pendulum swings."""
    return uniform(seed, COUNT, n, low=-3.1, high=3.1), rates * uniform(seed + 1, COUNT, n)


def each(function, *args):
    """By kernels, which take less to compile."""
    return jax.vmap(kernel(function))(*args)


def hanging(angle):
    return jnp.stack([jnp.sin(angle), -jnp.cos(angle)])


def weights(masses, points=None):
    """Gravity on points in the plane, of which each has two masses; none on what comes after."""
    down = jnp.array([0.0, -GRAVITY])
    points = len(masses) // 2 if points is None else points
    rest = jnp.zeros(len(masses) - 2 * points, masses.dtype)
    return masses * jnp.concatenate([*[down.astype(masses.dtype)] * points, rest])


BARS = dict(m1=1.3, m2=0.7, I1=0.2, I2=0.05, c1=0.4, c2=0.6, l1=0.9)


def two_bars(m1, m2, I1, I2, c1, c2, l1, springs=None):
    """Two rigid bodies on hinges; the angle of the second is from the first."""

    def transfer(q):
        angle = q[0] + q[1]
        second = l1 * hanging(q[0]) + c2 * hanging(angle)
        return jnp.concatenate([c1 * hanging(q[0]), second, jnp.stack([q[0], angle])])

    masses = jnp.array([m1, m1, m2, m2, I1, I2])
    return System(transfer, masses, weights(masses, points=2), springs)
