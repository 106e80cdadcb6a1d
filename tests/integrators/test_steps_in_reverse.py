"""Reverse mode by many numbers, where the motion itself does not feel what derivatives do."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.taylor_steps import Taylor

DECAY = 0.1
NUMBERS = np.arange(1.0, 21.0)


class State(NamedTuple):
    x: Any
    t: Any


class Clocked(wj.HybridSystem):
    """x, followed from time 0 to 1."""

    weights: Any

    section = ("x",)

    def rate(self, x, t):
        raise NotImplementedError

    def modes(self):
        field = lambda y: State(self.rate(*y), jnp.ones_like(y.t))
        return {"follows": Mode(field, (Guard(lambda y: y.t - 1, SECTION),))}

    def lift(self, x):
        return State(x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([state.x])


class Waves(Clocked):
    """Decay, with a weighted sum of waves."""

    parts = staticmethod(lambda t: jnp.sin(4 * NUMBERS * t + 0.3))

    def rate(self, x, t):
        return -DECAY * x + jnp.sum(self.weights * self.parts(t))


class Switches(Waves):
    """Decay, with a weighted sum of switches at different times."""

    parts = staticmethod(lambda t: jnp.tanh(2 * NUMBERS * (t - NUMBERS / 20)))


class Attracted(Clocked):
    """Quick decay to the mean of the weights."""

    def rate(self, x, t):
        return -30 * (x - jnp.mean(self.weights))


@pytest.mark.parametrize("weight", [0.0, 1e-3])
@pytest.mark.parametrize("system", [Waves, pytest.param(Switches, marks=pytest.mark.slow)])
def test_weights_of_functions_that_the_motion_does_not_feel(system, weight):
    """With weights of zero the solution is a slow exponential, whose steps span many waves.

    Derivatives have 100 times the tolerance of the solution.
    """
    x = jnp.array([1.0])
    few = Taylor(8)  # of fewer terms, so quicker to compile
    gradient = jax.grad(lambda weights: wj.stride(system(weights), x, solver=few).state[0])
    found = gradient(jnp.full(NUMBERS.size, weight))
    rates = lambda t: np.exp(-DECAY * (1 - t)) * np.asarray(system.parts(t))
    exact, _ = scipy.integrate.quad_vec(rates, 0, 1, epsabs=1e-13, epsrel=1e-13)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10)


def test_a_state_at_rest_in_a_fast_direction():
    """At its aim x rests, so its series vanishes; a neighbour decays by exp(-30)."""
    end = lambda weights, x: wj.stride(Attracted(weights), x).state[0]
    by_aims, by_start = jax.grad(end, (0, 1))(jnp.ones(NUMBERS.size), jnp.array([1.0]))
    np.testing.assert_allclose(np.sum(by_aims), 1 - np.exp(-30), rtol=1e-11)
    np.testing.assert_allclose(by_start, [np.exp(-30)], rtol=1e-8)
