"""A network as the torque of a hip: strides are those of DOP853, and have kernels.

A stride without a kernel would warn, which is an error in the tests.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import expit, ndtr

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.taylor_steps import Taylor

FEW = Taylor(8)
"""Steps by fewer terms than usual, which are quicker to compile."""
RNG = np.random.default_rng(0)
W, U = RNG.normal(size=(16, 4)) / 2, RNG.normal(size=(17, 16)) / 4
BIAS, LAST = RNG.normal(size=16) / 10, RNG.normal(size=17) / 20
STARTS = np.array([[0.2, -0.205], [0.19, -0.2], [0.21, -0.21]])


class State(NamedTuple):
    theta: Any
    phi: Any
    thetadot: Any
    phidot: Any


def swing(y, torque, module):
    """The simplest walker's rates, with a torque on the swing leg."""
    angle = y[0] - 0.009
    fall = module.sin(angle)
    phiddot = module.sin(y[1]) * (y[2] ** 2 - module.cos(angle)) + fall + torque
    return y[2], y[3], fall, phiddot


def walker(activation):
    def torque(y):
        hidden = activation(jnp.asarray(W) @ jnp.stack(y) + BIAS)
        return jnp.asarray(LAST) @ activation(jnp.asarray(U) @ hidden)

    class NetworkWalker(wj.HybridSystem):
        section = ("theta", "thetadot")

        def modes(self):
            field = lambda y: State(*swing(y, torque(y), jnp))
            after = lambda y: self.lift(jnp.stack([-y.theta, jnp.cos(2 * y.theta) * y.thetadot]))
            contact, ahead = lambda y: y.phi - 2 * y.theta, lambda y: -0.3 - y.phi
            return {"swing": Mode(field, (Guard(contact, SECTION, (ahead,), reset=after),))}

        def lift(self, x):
            return State(x[0], 2 * x[0], x[1], (1 - jnp.cos(2 * x[0])) * x[1])

        def project(self, state):
            return jnp.stack([state.theta, state.thetadot])

    return NetworkWalker()


ACTIVATIONS = {
    "tanh": (jnp.tanh, np.tanh),
    "relu": (jax.nn.relu, lambda x: np.maximum(x, 0)),
    "softplus": (jax.nn.softplus, lambda x: np.logaddexp(x, 0)),
    "sigmoid": (jax.nn.sigmoid, expit),
    "exact GELU": (partial(jax.nn.gelu, approximate=False), lambda x: x * ndtr(x)),
    "GELU": (
        jax.nn.gelu,
        lambda x: x / 2 * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3))),
    ),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[] if one == "relu" else [pytest.mark.slow]) for one in ACTIVATIONS],
)
def test_strides_and_their_derivatives(name):
    activation, plain = ACTIVATIONS[name]
    system = walker(activation)
    strides = partial(wj.strides, system, solver=FEW)
    found = strides(STARTS)
    assert np.all(np.asarray(found.outcome) == 0)
    field = lambda t, y: swing(y, LAST @ plain(U @ plain(W @ y + BIAS)), np)
    for (theta, rate), state, time in zip(STARTS, found.state, found.time, strict=True):
        start = [theta, 2 * theta, rate, (1 - np.cos(2 * theta)) * rate]
        solve = partial(solve_ivp, method="DOP853", rtol=1e-12, atol=1e-12, max_step=0.01)
        end = solve(field, (0, float(time)), start).y[:, -1]
        assert abs(end[1] - 2 * end[0]) < 1e-9
        expected = [-end[0], np.cos(2 * end[0]) * end[2]]
        np.testing.assert_allclose(state, expected, atol=1e-9)
    if name not in ("tanh", "relu"):
        return
    slopes = jax.vmap(jax.jacfwd(lambda x: wj.stride(system, x, solver=FEW).state))(STARTS)
    for i in range(2):
        step = np.eye(2)[i] * 1e-5
        ahead, behind = (strides(STARTS + s).state for s in (step, -step))
        change = (np.asarray(ahead) - np.asarray(behind)) / 2e-5
        error = 1e-5 if name == "relu" else 1e-6  # second derivatives jump where there are kinks
        np.testing.assert_allclose(slopes[:, :, i], change, rtol=1e-5, atol=error)


class Clock(NamedTuple):
    place: Any
    time: Any


def test_kinks_of_a_layer_are_found_to_rounding():
    """Of 24 units of ReLU five begin or end on the way, each at a time of its own.

    Their integrals from 0 to 1 are those of pieces of parabolas.
    """
    slopes, shifts, gains = np.random.default_rng(4).normal(size=(3, 24))

    class Layer(wj.HybridSystem):
        section = ("place",)

        def modes(self):
            def field(y):
                units = jax.nn.relu(jnp.asarray(slopes)[:, None] @ y.time[None] + shifts)
                return Clock(jnp.asarray(gains) @ units, jnp.ones_like(y.time))

            return {"all": Mode(field, (Guard(lambda y: y.time - 1, SECTION),))}

        def lift(self, x):
            return Clock(x[0], 0 * x[0])

        def project(self, state):
            return state.place[None]

    kinks = -shifts / slopes
    assert ((kinks > 0) & (kinks < 1)).sum() == 5
    until = lambda t: np.maximum(slopes * t + shifts, 0) ** 2 / (2 * slopes)
    expected = gains @ (until(1.0) - until(0.0))
    found = wj.stride(Layer(), jnp.zeros(1)).state[0]
    np.testing.assert_allclose(found, expected, rtol=1e-13)
