"""Events at the same instant: a particle that flies into a corner, in closed form."""

from itertools import combinations
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj

ACCELERATION = np.array([1.0, -0.3])
LOSS, TIME = np.array([0.9, 0.7]), 3.0


class Particle(NamedTuple):
    place: Any
    velocity: Any
    clock: Any


class Corner(wj.HybridSystem):
    """A particle that bounces once on each of two walls, in any order, and is seen at a time."""

    section = "x", "y", "u", "v"

    def lift(self, x):
        return Particle(x[:2], x[2:], 0 * x[0])

    def project(self, state):
        return jnp.concatenate([state.place, state.velocity])

    def modes(self):
        def field(y):
            return Particle(y.velocity, ACCELERATION + 0 * y.place, jnp.ones_like(y.clock))

        def bounce(i):
            turn = np.where(np.arange(2) == i, -LOSS, 1)
            return lambda y: y._replace(velocity=y.velocity * turn)

        def mode(done):
            left = [i for i in range(2) if i not in done]
            to = lambda i: str(sorted((*done, i)))
            walls = [wj.Guard(lambda y, i=i: y.place[i], to(i), reset=bounce(i)) for i in left]
            ends = [] if left else [wj.Guard(lambda y: y.clock - TIME, wj.SECTION)]
            return wj.Mode(field, (*walls, *ends))

        sets = [done for n in range(3) for done in combinations(range(2), n)]
        return {str([*done]): mode(done) for done in sets}


def time_to_wall(x):
    """The time at which each coordinate is zero: x + u t + a t^2 / 2 = 0."""
    place, velocity = x[:2], x[2:]
    return -2 * place / (velocity + jnp.sqrt(velocity**2 - 2 * ACCELERATION * place))


def seen(x):
    """The particle at the end: each coordinate bounces on its own."""
    at = time_to_wall(x)
    velocity, left = -LOSS * (x[2:] + ACCELERATION * at), TIME - at
    place = velocity * left + ACCELERATION * left**2 / 2
    return jnp.concatenate([place, velocity + ACCELERATION * left])


def starts():
    """Starts from which both walls are met at the same instant, to rounding."""
    rng = np.random.default_rng(1)
    velocity, time = rng.uniform(0.5, 1, (12, 2)), rng.uniform(0.5, 1, (12, 1))
    return jnp.array(np.hstack([-velocity * time - ACCELERATION * time**2 / 2, velocity]))


def test_both_events_are_passed_whichever_is_met_first():
    """It is first by rounding."""
    x = starts()
    made = wj.strides(Corner(), x)
    assert (made.outcome == wj.Outcome.STRIDE).all()
    np.testing.assert_allclose(made.time, TIME, rtol=1e-14)
    np.testing.assert_allclose(made.state, jax.vmap(seen)(x), atol=1e-12)


@pytest.mark.parametrize(
    ("derivative", "atol"),
    [
        pytest.param(jax.jacfwd, 1e-11, id="forward"),
        pytest.param(jax.jacrev, 1e-11, id="reverse", marks=pytest.mark.slow),
        pytest.param(
            lambda f: jax.jacfwd(jax.jacfwd(f)), 1e-10, id="second", marks=pytest.mark.slow
        ),
    ],
)
def test_derivatives_are_those_of_both_events(derivative, atol):
    found = jax.jit(jax.vmap(derivative(lambda x: wj.stride(Corner(), x).state)))(starts())
    np.testing.assert_allclose(found, jax.vmap(derivative(seen))(starts()), atol=atol)


@pytest.mark.slow
def test_runge_kutta_steps_pass_both_events():
    made = wj.strides(Corner(), starts(), solver=diffrax.Bosh3(), tolerance=1e-9)
    assert (made.outcome == wj.Outcome.STRIDE).all()
    np.testing.assert_allclose(made.state, jax.vmap(seen)(starts()), atol=1e-8)


@pytest.mark.slow
def test_derivatives_by_runge_kutta_pass_both_events():
    end = lambda x: wj.stride(Corner(), x, solver=diffrax.Tsit5(), tolerance=1e-9).state
    x = starts()[:3]
    found = jax.jit(jax.vmap(jax.jacfwd(end)))(x)
    np.testing.assert_allclose(found, jax.vmap(jax.jacfwd(seen))(x), atol=1e-7)
