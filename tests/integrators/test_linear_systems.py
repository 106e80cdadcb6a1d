"""Series of solutions of linear systems and of factorisations, and motions that need them."""

from functools import partial

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from switching import switching_series

import walker_jax as wj
from walker_jax.integrators.taylor import function_series, solution_series
from walker_jax.integrators.taylor_steps import Taylor
from walker_jax.kernels import kernel, why_not

ORDER, SIZE = 6, 4
_numbers = np.random.default_rng(3)
# A pivot of zero at first: without an exchange of rows there is no factorisation.
MATRIX = _numbers.normal(size=(3, SIZE, SIZE)) * (1 - np.eye(SIZE) * [[[1]], [[0]], [[0]]])
RIGHT = _numbers.normal(size=(3, SIZE))
TRIANGLE = MATRIX + 3 * np.eye(SIZE) * [[[1]], [[0]], [[0]]]


def product(a, b):
    """Coefficients of the product of two polynomials of matrices, up to the order."""
    a, b = (np.concatenate([x, np.zeros((ORDER + 1, *x.shape[1:]))]) for x in (a, b))
    return np.stack([sum(a[j] @ b[k - j] for j in range(k + 1)) for k in range(ORDER + 1)])


def padded(a):
    return np.concatenate([a, np.zeros((ORDER + 1 - len(a), *a.shape[1:]))])


DEFINITE = product(MATRIX, MATRIX.swapaxes(1, 2)) + padded(np.eye(SIZE)[None])


def at(coefficients, t):
    return jnp.stack([jnp.asarray(c) * t**k for k, c in enumerate(coefficients)]).sum(0)


def expand(function, compute=kernel):
    """Coefficients of function(t) at t = 0."""
    line = [jnp.array(float(k == 1)) for k in range(ORDER + 1)]
    found = compute(lambda line: function_series(function, line))(line)
    return np.stack(found)


M, B, S, T = (partial(at, one) for one in (MATRIX, RIGHT, DEFINITE, TRIANGLE))
SOLUTIONS = {
    "solve": (lambda t: jnp.linalg.solve(M(t), B(t)[:, None]), MATRIX),
    "inverse": (lambda t: jnp.linalg.inv(M(t)) @ B(t)[:, None], MATRIX),
    "factors": (lambda t: jsl.lu_solve(jsl.lu_factor(M(t)), B(t)[:, None]), MATRIX),
    "constant": (lambda t: jnp.linalg.solve(M(0.0), B(t)[:, None]), MATRIX[:1]),
    "definite": (lambda t: jsl.solve(S(t), B(t)[:, None], assume_a="pos"), DEFINITE),
    "cholesky": (lambda t: jsl.cho_solve(jsl.cho_factor(S(t)), B(t)[:, None]), DEFINITE),
    "lower": (
        lambda t: jsl.solve_triangular(T(t), B(t)[:, None], lower=True),
        np.tril(TRIANGLE),
    ),
    "transposed": (
        lambda t: jsl.solve_triangular(T(t), B(t)[:, None], trans=1),
        np.triu(TRIANGLE).swapaxes(1, 2),
    ),
    "unit": (
        lambda t: jsl.solve_triangular(T(t), B(t)[:, None], unit_diagonal=True),
        np.triu(TRIANGLE, 1) + padded(np.eye(SIZE)[None])[:3],
    ),
}


@pytest.mark.parametrize("name", SOLUTIONS)
def test_series_of_solutions_solve_the_system(name):
    """A(t) x(t) = b(t), coefficient by coefficient, in a kernel."""
    function, matrix = SOLUTIONS[name]
    x = expand(function)
    assert np.abs(x[1:]).max() > 1e-2
    scale = np.abs(matrix).max() * np.abs(x).max()
    expected = padded(RIGHT)[..., None]
    np.testing.assert_allclose(product(matrix, x), expected, rtol=0, atol=1e-13 * scale)


def test_many_systems_at_once_are_each_their_own():
    both = lambda t: jax.vmap(jnp.linalg.solve)(jnp.stack([M(t), S(t)]), jnp.stack([B(t)] * 2))
    x, scale = expand(both)[..., None], 1e-13
    for i, matrix in enumerate((MATRIX, DEFINITE)):
        atol = scale * np.abs(matrix).max() * np.abs(x).max()
        np.testing.assert_allclose(
            product(matrix, x[:, i]), padded(RIGHT)[..., None], rtol=0, atol=atol
        )


@pytest.mark.parametrize("compute", [jax.jit, kernel])
def test_factors_of_a_definite_matrix_multiply_to_it(compute):
    factor = expand(lambda t: jnp.linalg.cholesky(S(t)), compute)
    np.testing.assert_array_equal(factor, np.tril(factor))
    found = product(factor, factor.swapaxes(1, 2))
    np.testing.assert_allclose(found, DEFINITE[: ORDER + 1], rtol=0, atol=1e-12)


def test_the_determinant_of_a_matrix_of_polynomials_is_one():
    """Of degree 8: its coefficients follow from nine of its values."""
    nodes = np.cos(np.pi * (np.arange(9) + 0.5) / 9)
    values = [np.linalg.det(sum(c * t**k for k, c in enumerate(MATRIX))) for t in nodes]
    expected = np.linalg.solve(np.vander(nodes, increasing=True), values)[: ORDER + 1]
    found = expand(lambda t: jnp.linalg.det(M(t)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_kink_of_the_matrix_is_found():
    """M(t) has a kink at t = 0.3, and so has the solution."""
    kinked = lambda t: jnp.linalg.solve(M(jnp.abs(t - 0.3)), B(t))
    (switch,) = switching_series(kinked, [jnp.array(0.0), jnp.array(1.0)])
    np.testing.assert_allclose(switch, [-0.3, 1.0])


def test_a_singular_matrix_gives_no_numbers_and_no_error():
    singular = lambda t: jnp.linalg.solve(jnp.ones((2, 2)) * (1 + t), jnp.stack([t, 1 + t]))
    assert not np.isfinite(expand(singular, jax.jit)).any()
    assert not np.isfinite(expand(singular)).all()


# A motion: M(q) q'' = h, as robotics writes it


def inertia(q, mass):
    coupling = jnp.cos(q[0] - q[1]) if isinstance(q, jax.Array) else np.cos(q[0] - q[1])
    return [[1 + mass, mass * coupling], [mass * coupling, mass]]


def forces(q, u, mass, sin):
    turning = mass * sin(q[0] - q[1])
    return [-turning * u[1] ** 2 - (1 + mass) * sin(q[0]), turning * u[0] ** 2 - mass * sin(q[1])]


class DoublePendulum(wj.HybridSystem):
    """Two links of length 1 with point masses 1 and `mass` at their ends, for two units of time."""

    mass: jax.Array
    section = ("a", "b")

    def lift(self, x):
        return {"q": x, "u": 0 * x, "time": 0 * x[0]}

    def project(self, state):
        return state["q"]

    def modes(self):
        def field(state):
            q, u = state["q"], state["u"]
            matrix = jnp.stack([jnp.stack(row) for row in inertia(q, self.mass)])
            right = jnp.stack(forces(q, u, self.mass, jnp.sin))
            return {"q": u, "u": jnp.linalg.solve(matrix, right), "time": 1 + 0 * state["time"]}

        return {"flow": wj.Mode(field, (wj.Guard(lambda state: state["time"] - 2.0, wj.SECTION),))}


def by_scipy(start, mass):
    """Where the links are after two units of time; SciPy with small steps."""

    def rates(_, y):
        right = forces(y[:2], y[2:], mass, np.sin)
        return [*y[2:], *np.linalg.solve(inertia(y[:2], mass), right)]

    return solve_ivp(rates, (0, 2), [*start, 0, 0], method="DOP853", rtol=1e-13, atol=1e-13).y[
        :2, -1
    ]


def test_a_double_pendulum_with_a_solve_moves_as_by_scipy():
    start, mass = np.array([1.0, -0.5]), 0.7
    few = Taylor(8)  # of fewer terms, so quicker to compile
    one = lambda mass: wj.stride(DoublePendulum(mass), jnp.asarray(start), solver=few).state
    change, end = jax.jacfwd(lambda mass: [one(mass)] * 2, has_aux=True)(mass)
    np.testing.assert_allclose(end, by_scipy(start, mass), rtol=0, atol=1e-11)
    h = 1e-3
    steps = [by_scipy(start, mass + d) for d in (-2 * h, -h, h, 2 * h)]
    slope = np.array([1, -8, 8, -1]) @ steps / (12 * h)
    np.testing.assert_allclose(change, slope, rtol=0, atol=1e-8)


def test_a_stride_with_a_solve_is_a_kernel():
    """As fast as one with equations solved by hand."""
    assert (
        why_not(lambda m, x: wj.stride(DoublePendulum(m), x), jnp.array(0.7), jnp.ones(2)) is None
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_a_number_may_add_to_a_matrix(sign):
    """The coefficients of a sum are matrices even where one operand alone has one."""
    matrix = jnp.array([[2.0, 0.0], [0.0, 1.0]])

    def field(y):
        shifted = matrix + 0.1 * y[0] if sign > 0 else matrix - 0.1 * y[0]
        return jnp.linalg.solve(shifted, -y)

    series = jax.jit(lambda y: solution_series(field, y, 20))(jnp.ones(2))
    found = np.sum(np.stack(series) * 0.5 ** np.arange(21)[:, None], axis=0)
    rates = lambda t, y: np.linalg.solve(np.asarray(matrix) + sign * 0.1 * y[0], -y)
    exact = solve_ivp(rates, (0, 0.5), [1.0, 1.0], method="DOP853", rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(found, exact.y[:, -1], rtol=1e-11)
