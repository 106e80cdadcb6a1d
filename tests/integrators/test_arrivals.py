"""Arrivals at an event, by operations that reverse mode transposes, against a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from walker_jax.integrators.arrivals import arrive_by_newton

WAYS = {
    "forward": jax.jacfwd,
    "reverse": jax.jacrev,
    "forward over reverse": lambda f: jax.jacfwd(jax.jacrev(f)),
    "third": lambda f: jax.jacfwd(jax.jacfwd(jax.jacrev(f))),
}


def by_steps(p):
    """Height, velocity and gravity of a body that is at the ground; its arrival there."""
    field = lambda y: (y[1], -p[2])
    (height, velocity), time = arrive_by_newton(lambda y: -y[0], field, (p[0], p[1]))
    return jnp.stack([height, velocity, time])


def by_formula(p):
    """h + v t - g t^2 / 2 = 0, of a body that falls."""
    h, v, g = p
    speed = jnp.sqrt(v**2 + 2 * g * h)
    return jnp.stack([0 * h, -speed, (v + speed) / g])


@pytest.mark.parametrize(
    "way", [pytest.param(one, marks=[pytest.mark.slow] * (one == "third")) for one in WAYS]
)
def test_derivatives_of_an_arrival(way):
    p = jnp.array([0.0, -1.3, 0.7])
    found, expected = (WAYS[way](f)(p) for f in (by_steps, by_formula))
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
