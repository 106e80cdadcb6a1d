"""Maps of the plane whose gaits, multipliers and basins are known in closed form.

x -> c + (k + |x - c|^2 / R^2) (x - c) with a turn: the point c attracts all starts nearer than
R sqrt(1 - k), and every other start leaves. All of c, k and R are linear in the weights.
"""

import jax.numpy as jnp
import numpy as np

import walker_jax as wj

COUNT = 20
"""Weights of each map: enough for derivatives in reverse."""
MIX = np.random.default_rng(3).uniform(-1, 1, (4, COUNT)) * np.array(
    [[0.02], [0.02], [0.01], [0.1]]
)
"""Changes of both coordinates of c, of k and of R by the weights."""
AT_ZERO = np.array([0.1, -0.05, 0.4, 1.0])


def parts(w):
    """Return c, k and R."""
    x, y, k, radius = jnp.asarray(AT_ZERO) + jnp.asarray(MIX) @ w
    return jnp.stack([x, y]), k, radius


def advance(x, w):
    c, k, radius = parts(w)
    away = x - c
    turned = jnp.stack([0.6 * away[0] - 0.8 * away[1], 0.8 * away[0] + 0.6 * away[1]])
    return c + (k + jnp.sum(away**2) / radius**2) * turned


def room(x, w):
    """Vanishes at the distance 2 R from c, beyond which a start is not feasible."""
    c, _, radius = parts(w)
    return 2 * radius - jnp.sqrt(jnp.sum((x - c) ** 2))


def disc(w) -> wj.Map:
    axes = {"x": (-1.5, 1.5, 5), "y": (-1.5, 1.5, 5)}
    parameters = {"w": jnp.asarray(w)}
    return wj.Map(advance, ("x", "y"), parameters=parameters, feasible=room, region=axes)


def area(w):
    _, k, radius = parts(w)
    return np.pi * radius**2 * (1 - k)
