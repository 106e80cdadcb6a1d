"""Taylor series of motions by their virtual power."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import multibody
from walker_jax.integrators.power_balance import VirtualPower
from walker_jax.integrators.taylor import solution_series
from walker_jax.kernels import kernel
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import SingleSupport


class Chain(VirtualPower):
    """Point masses on rods, each hung from the one before; damped, all angles from the vertical."""

    masses: jax.Array

    def system(self):
        def transfer(q):
            steps = jnp.stack([jnp.sin(q), -jnp.cos(q)], 1)
            return jnp.cumsum(steps, axis=0).ravel()

        masses = jnp.repeat(self.masses, 2)
        down = jnp.tile(jnp.array([0.0, -1.0], masses.dtype), len(self.masses))
        return multibody.System(transfer, masses, masses * down, lambda q, qdot: -0.1 * qdot)

    def transfer(self, q):
        return unroll(lambda chain, q: list(chain.system().transfer(jnp.stack(q))))(self, q)

    def virtual_power(self, q, qdot, acceleration):
        def flat(chain, *vectors):
            return list(multibody.virtual_power(chain.system(), *map(jnp.stack, vectors)))

        return unroll(flat)(self, q, qdot, acceleration)

    def factorise(self, q):
        def flat(chain, q):
            matrix = multibody.mass_matrix(chain.system(), jnp.stack(q))
            return multibody.factorise(multibody.block(matrix, range(len(q))))

        return unroll(flat)(self, q)

    def solve(self, factors, right):
        return multibody.solve_factored(factors, right)

    def explicit(self, state):
        """The time derivative of a state by the accelerations, as any vector field."""

        def flat(chain, q, qdot):
            system, q, qdot = chain.system(), jnp.stack(q), jnp.stack(qdot)
            return list(multibody.solve_motion(system, q, qdot).accelerations)

        q, qdot = state
        return qdot, unroll(flat)(self, q, qdot)


def chain(n, dtype=jnp.float64):
    """Masses, and a state far from equilibrium."""
    masses = jnp.asarray(1 / np.arange(1, n + 1), dtype)
    q, qdot = np.random.default_rng(n).uniform(-1, 1, (2, n))
    return Chain(masses), tuple([jnp.asarray(x, dtype) for x in part] for part in (q, 2 * qdot))


LOW = 6


def series_and_slopes(equations, state, by_series):
    """Coefficients, and their derivatives by all parameters and coordinates at once.

    Not compiled: XLA takes minutes over the accelerations, as it has no loops to make of them.
    """
    expand = inspect.unwrap(solution_series)

    def series(equations, state):
        field = equations if by_series else equations.explicit
        return [jnp.stack(c) for c in all_series(expand(field, state, LOW))]

    ones = jax.tree.map(jnp.ones_like, (equations, state))
    return [jnp.stack(part) for part in jax.jvp(series, (equations, state), ones)]


def all_series(tree):
    """The lists of coefficients, which are the innermost ones."""
    innermost = lambda x: isinstance(x, list) and not isinstance(x[0], list)
    return jax.tree.leaves(tree, is_leaf=innermost)


def test_series_by_virtual_power_is_that_of_the_accelerations():
    """Of a double pendulum; its derivative by masses and start too."""
    results = [series_and_slopes(*chain(2), by_series) for by_series in (True, False)]
    for found, expected in zip(*results, strict=True):
        assert found.shape == (4, LOW + 1) and np.ptp(expected[:, -1]) > 0.1
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


class OfMotion(SingleSupport):
    def explicit(self, state):
        def flat(walker, state):
            zero = jnp.zeros_like(state.theta)
            q = jnp.stack([zero, zero, state.theta, state.phi])
            qdot = jnp.stack([zero, zero, state.thetadot, state.phidot])
            accelerations = multibody.solve_motion(
                walker.system(), q, qdot, held=(0, 1)
            ).accelerations
            return wj.State(state.thetadot, state.phidot, accelerations[2], accelerations[3])

        return unroll(flat)(self.walker, state)


@pytest.mark.slow
def test_series_of_a_walker_by_virtual_power_is_that_of_rates():
    equations = OfMotion(wj.PointFootWalker(0.01, 0.2))
    state = wj.State(*map(jnp.asarray, (0.3, 0.5, -0.4, 0.2)))
    results = [series_and_slopes(equations, state, by_series) for by_series in (True, False)]
    for found, expected in zip(*results, strict=True):
        assert found.shape == (4, LOW + 1) and np.ptp(expected[:, -1]) > 1e-3
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


def test_virtual_power_called_is_the_time_derivative():
    for equations, state in (chain(1), chain(2)):
        found, expected = equations(state), equations.explicit(state)
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_series_by_virtual_power_of_all_orders_begin_alike():
    equations, state = chain(2)
    long = all_series(equations.series(state, LOW))
    for order in range(3):
        short = all_series(equations.series(state, order))
        assert [len(coefficients) for coefficients in short] == [order + 1] * 4
        np.testing.assert_allclose(short, [c[: order + 1] for c in long], rtol=1e-13)


def test_series_by_virtual_power_in_float32():
    """Compiled."""
    expand = kernel(lambda equations, state: solution_series(equations, state, LOW))
    low = jax.tree.leaves(expand(*chain(1, jnp.float32)))
    assert {c.dtype for c in low} == {jnp.dtype("float32")}
    equations, state = chain(1)
    high = jax.tree.leaves(equations.series(state, LOW))
    np.testing.assert_allclose(low, high, rtol=1e-4, atol=1e-5 * np.max(np.abs(high)))
