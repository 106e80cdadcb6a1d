"""Derivatives by parameters of every shape, of walkers of every kind, by differences and forward.

The torque of the hip is given by an array, a network, a dictionary, or a table of a spline.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import walker_jax as wj
from walker_jax.kernels import transposes

TOLERANCE = 1e-13
"""Of strides. Their derivatives have 100 times as much."""
KNOTS = np.linspace(-1.2, 1.2, 6)
DRAWN = np.random.default_rng(7).normal(size=40)


def by_array(weights, z):
    """An array: a quadratic form."""
    return z @ weights @ z


def by_dictionary(gains, z):
    return gains["pull"] * jnp.sin(z[1]) - gains["drag"] * z[3] + gains["bias"]["both"] @ z[:2]


def by_spline(table, z):
    """A table: values and slopes of a cubic spline at knots. Its second derivative jumps there."""
    width = KNOTS[1] - KNOTS[0]
    i = jnp.clip(jnp.searchsorted(KNOTS, z[1], side="right") - 1, 0, len(KNOTS) - 2)
    t = (z[1] - jnp.asarray(KNOTS)[i]) / width
    values, slopes = table[0], table[1] * width
    left = values[i] * (1 + 2 * t) + slopes[i] * t
    right = values[i + 1] * (3 - 2 * t) + slopes[i + 1] * (t - 1)
    return left * (1 - t) ** 2 + right * t**2


KINDS: dict[str, tuple[Any, Any]] = {
    "array": (by_array, DRAWN[:16].reshape(4, 4)),
    "network": (
        lambda policy, z: policy(z),
        eqx.nn.MLP(4, "scalar", 16, 1, activation=jnp.tanh, key=jax.random.key(1)),
    ),
    "dictionary": (
        by_dictionary,
        {"pull": DRAWN[0], "drag": DRAWN[1], "bias": {"both": DRAWN[2:4]}},
    ),
    "spline": (by_spline, DRAWN[:12].reshape(2, 6)),
}


def with_torque(kind: Any, torque, size: float) -> type:
    """Derive a walker with a torque between its legs, which a field `policy` gives."""

    class ByForces(kind):
        policy: Any = None

        def system(self):
            def force(q, qdot):
                z = jnp.stack([q[2], q[3], qdot[2], qdot[3]])
                return jnp.zeros_like(q).at[3].set(size * torque(self.policy, z))

            passive = super().system()
            where = lambda system: system.generalised_forces
            return eqx.tree_at(where, passive, force, is_leaf=lambda x: x is None)

    class ByRates(kind):
        policy: Any = None

        def vector_field(self, state):
            free = super().vector_field(state)
            z = jnp.stack([state.theta, state.phi, state.thetadot, state.phidot])
            return free._replace(phidot=free.phidot + size * torque(self.policy, z))

    return ByForces if hasattr(kind, "system") else ByRates


WALKERS = {
    "simplest": (wj.SimplestWalker, (0.009,), 0.02, [0.2, -0.2]),
    "point foot": (wj.PointFootWalker, (0.009, 0.1), 0.002, [0.187, -0.207]),
    "powered": (wj.PoweredWalker, (0.009,), 0.02, [0.2, -0.2]),
    "round foot": (wj.RoundFootWalker, (0.01,), 0.002, [0.2, -0.265, -0.046]),
    "kneed": (wj.KneedWalker, (0.05,), 0.002, [0.238, -0.354, -0.333]),
}
"""Walkers, the arguments of their constructors, the size of torques, and a start."""


@pytest.fixture(autouse=True)
def by_adjoint(monkeypatch):
    """Reverse mode by the adjoint, however few numbers there are."""
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)


@pytest.mark.slow  # by default those of a machine of tables are checked, in test_networks.py
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", WALKERS)
def test_derivatives_of_all_walkers_by_all_shapes(name, kind):
    base, given, size, start = WALKERS[name]
    torque, policy = KINDS[kind]
    walker = with_torque(base, torque, size)(*given, policy=policy)
    x = jnp.asarray(start)
    numbers, rebuild = ravel_pytree(eqx.filter(walker.policy, eqx.is_inexact_array_like))

    def number(flat):
        end = wj.stride(
            eqx.tree_at(lambda one: one.policy, walker, rebuild(flat)), x, tolerance=TOLERANCE
        )
        return end.state @ jnp.linspace(0.5, 1, len(x)) + 0.3 * end.time

    assert int(wj.stride(walker, x, tolerance=TOLERANCE).outcome) == wj.Outcome.STRIDE
    back, forward = jax.grad(number)(numbers), jax.jacfwd(number)(numbers)
    scale = np.abs(forward).max()
    assert scale > 1e-5
    np.testing.assert_allclose(back / scale, forward / scale, rtol=0, atol=100 * TOLERANCE)
    step = 1e-3
    moved = numbers + step * np.multiply.outer([-2.0, -1.0, 1.0, 2.0], np.eye(len(numbers)))
    values = jax.vmap(jax.vmap(number))(moved)
    by = np.array([1.0, -8.0, 8.0, -1.0]) @ np.asarray(values) / (12 * step)
    np.testing.assert_allclose(forward / scale, by / scale, rtol=0, atol=1e-7)
