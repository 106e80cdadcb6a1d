"""Taylor series of solutions, and of functions of these, against known ones."""

import inspect
from fractions import Fraction
from functools import partial
from math import factorial

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor import function_series, solution_series
from walker_jax.kernels import kernel

ORDER = 7


def expected_series(solution, order=ORDER):
    """Taylor coefficients at t = 0 of a function of mpmath numbers, rounded to float64."""
    with mpmath.workdps(40):
        return [float(c) for c in mpmath.taylor(solution, 0, order)]


def assert_series(series, expected, rtol=1e-13):
    """Equal coefficients, to rounding of the largest: others may have cancelled."""
    atol = rtol * np.max(np.abs(expected))
    np.testing.assert_allclose(np.stack(series), expected, rtol=rtol, atol=atol)


def solved_series(vector_field, start, order=ORDER):
    """By a kernel, which takes less to compile."""
    return kernel(lambda y: solution_series(vector_field, y, order))(start)


# Series of solutions: y' = f(y), y(0), y(t)

EQUATIONS = {
    "constant": (lambda y: jnp.full_like(y, 3.0), 1.0, lambda t: 1 + 3 * t),
    "rest": (lambda y: jnp.zeros_like(y), 2.0, lambda t: mpmath.mpf(2)),
    "itself": (lambda y: y, 1.0, mpmath.exp),
    "neg-sub": (lambda y: -(y - 2.0), 1.0, lambda t: 2 - mpmath.exp(-t)),
    "constant-minus": (lambda y: 2.0 - y, 1.0, lambda t: 2 - mpmath.exp(-t)),
    "mul": (lambda y: 1 + y * y, 0.0, mpmath.tan),
    "square": (lambda y: jnp.square(y), 1.0, lambda t: 1 / (1 - t)),
    "div": (lambda y: 1 / y, 1.0, lambda t: mpmath.sqrt(1 + 2 * t)),
    "quotient": (lambda y: y / (1 + y), 1.0, lambda t: mpmath.lambertw(mpmath.exp(1 + t)).real),
    "divided-by-constant": (lambda y: y / 3, 1.0, lambda t: mpmath.exp(t / 3)),
    "cube": (lambda y: y**3, 1.0, lambda t: 1 / mpmath.sqrt(1 - 2 * t)),
    "negative-power": (lambda y: y**-2, 1.0, lambda t: mpmath.cbrt(1 + 3 * t)),
    "real-power": (lambda y: y**1.5, 1.0, lambda t: (1 - t / 2) ** -2),
    "sqrt": (lambda y: jnp.sqrt(y), 1.0, lambda t: (1 + t / 2) ** 2),
    "rsqrt": (lambda y: lax.rsqrt(y), 1.0, lambda t: mpmath.cbrt(1 + 1.5 * t) ** 2),
    "exp": (lambda y: jnp.exp(-y), 0.0, lambda t: mpmath.log(1 + t)),
    "log": (lambda y: y * jnp.log(y), 2.0, lambda t: mpmath.exp(mpmath.log(2) * mpmath.exp(t))),
    "expm1": (jnp.expm1, 0.5, lambda t: -mpmath.log(1 - mpmath.exp(t) * -mpmath.expm1(-0.5))),
    "tanh": (jnp.tanh, 1.0, lambda t: mpmath.asinh(mpmath.sinh(1) * mpmath.exp(t))),
    "sin": (jnp.sin, 1.0, lambda t: 2 * mpmath.atan(mpmath.tan(0.5) * mpmath.exp(t))),
    "cos": (jnp.cos, 0.0, lambda t: 2 * mpmath.atan(mpmath.tanh(t / 2))),
    "sin-of-constant": (lambda y: y * jnp.sin(jnp.full_like(y, np.pi / 2)), 1.0, mpmath.exp),
    "where-true": (lambda y: jnp.where(y > 0, y, -y), 1.0, mpmath.exp),
    "where-false": (lambda y: jnp.where(y < 0, -y, 1 + y**2), 0.0, mpmath.tan),
    "select-by-constant": (lambda y: lax.select(jnp.array(False), -y, y), 1.0, mpmath.exp),
    "abs": (jnp.abs, 1.0, mpmath.exp),
    "maximum": (lambda y: jnp.maximum(y, 0.5), 1.0, mpmath.exp),
    "jit": (jax.jit(lambda y: jax.jit(jnp.square)(y) + 1), 0.0, mpmath.tan),
    "custom-jvp": (jax.nn.relu, 1.0, mpmath.exp),
    "loop-over-constants": (
        lambda y: y * lax.fori_loop(0, 3, lambda i, x: x + 1.0, jnp.array(-2.0)),
        1.0,
        mpmath.exp,
    ),
}


@pytest.fixture(scope="module")
def solved():
    """The series of all equations, expanded as one system to compile once."""

    def rates(state):
        return {name: vector_field(state[name]) for name, (vector_field, _, _) in EQUATIONS.items()}

    starts = {name: jnp.array(start) for name, (_, start, _) in EQUATIONS.items()}
    return solved_series(rates, starts)


@pytest.mark.parametrize("name", EQUATIONS)
def test_series_of_a_solution_known_in_closed_form(name, solved):
    assert_series(solved[name], expected_series(EQUATIONS[name][2]))


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.integers(-8, 8)] * 4))
def test_series_of_riccati_equations_equals_exact_fractions(numbers):
    """y' = a + b y + c y^2 by Cauchy products of fractions."""
    a, b, c, start = [Fraction(n, 4) for n in numbers]
    y = [start]
    for k in range(ORDER):
        square = sum(y[j] * y[k - j] for j in range(k + 1))
        y.append(((a if k == 0 else 0) + b * y[k] + c * square) / (k + 1))
    series = riccati_series(*(jnp.array(float(v)) for v in (a, b, c, start)))
    sizes = np.abs(np.array(y, float)) + 1  # terms of this size may have cancelled
    np.testing.assert_array_less(np.abs(np.stack(series) - np.array(y, float)), 1e-12 * sizes**2)


@jax.jit
def riccati_series(a, b, c, start):
    return solution_series(lambda y: a + b * y + c * y**2, start, ORDER)


def test_series_of_a_pendulum_is_that_of_its_elliptic_function():
    """theta'' = -sin theta from rest: sin(theta / 2) = k cd(t), k = sin(theta(0) / 2)."""
    start = {"angle": jnp.array(2.0), "rate": jnp.array(0.0)}

    def swing(state):
        return {"angle": state["rate"], "rate": -jnp.sin(state["angle"])}

    def angle(t):
        k = mpmath.sin(1)
        return 2 * mpmath.asin(k * mpmath.ellipfun("cd", t, k=k))

    series = solved_series(swing, start, 12)
    assert set(series) == {"angle", "rate"}
    expected = expected_series(angle, 13)
    assert_series(series["angle"], expected[:-1])
    assert_series(series["rate"], [(k + 1) * expected[k + 1] for k in range(13)])


def test_series_of_an_order_higher_than_in_use():
    """Odd and even orders, of squares, products, quotients and sines that all vary."""
    order = 14
    k, since = 0.8, 0.7  # theta'' = -sin theta with a rate: sin(theta / 2) = k sn(t + since)
    swing = lambda t: 2 * mpmath.asin(k * mpmath.ellipfun("sn", t + since, k=k))
    solutions = {
        "square": lambda t: mpmath.tan(t + 0.3),
        "product": lambda t: 1 / (1 + mpmath.exp(-t - 0.4)),
        "quotient": lambda t: mpmath.lambertw(mpmath.exp(1 + 4 * t)).real,
        "angle": swing,
    }

    def rates(y):
        return {
            "square": 1 + y["square"] ** 2,
            "product": y["product"] * (1 - y["product"]),
            "quotient": 4 * y["quotient"] / (1 + y["quotient"]),
            "angle": y["rate"],
            "rate": -jnp.sin(y["angle"]),
            "along": -jnp.cos(y["angle"]) * y["rate"],  # the rate's own rate
        }

    expected = {name: expected_series(one, order + 2) for name, one in solutions.items()}
    expected["rate"] = [(k + 1) * c for k, c in enumerate(expected["angle"][1:])]
    expected["along"] = [(k + 1) * c for k, c in enumerate(expected["rate"][1:])]
    start = {name: jnp.array(one[0]) for name, one in expected.items()}
    series = inspect.unwrap(solution_series)(rates, start, order)
    for name, coefficients in series.items():
        assert_series(coefficients, expected[name][: order + 1])
        assert np.abs(expected[name][: order + 1]).min() > 1e-8  # so that none goes unseen


def test_series_of_a_walker_like_system_of_equations():
    """A pair (sin, cos) of the same angle: u = tan, w = sec of t from u' = w^2, w' = u w."""
    start = (jnp.array(0.0), jnp.array(1.0))
    u, w = solution_series(lambda y: (y[1] * y[1], y[0] * y[1]), start, ORDER)
    assert_series(u, expected_series(mpmath.tan))
    assert_series(w, expected_series(mpmath.sec))


A = np.array([[0.0, 1.0, -0.5], [2.0, 0.25, 1.0], [-1.0, 0.5, 0.0]])


def there_and_back(y):
    """The same vector, through sums, indices, updates and Fourier coefficients."""
    turn = np.array([1, 2, 0])
    y = jnp.diff(jnp.cumsum(y), prepend=0.0)
    y = jnp.ones(3).at[turn].set(y[turn])
    y = jnp.zeros(3).at[turn].add(y[turn])
    y = lax.dynamic_update_slice(jnp.ones(5), y, [1])
    return jnp.fft.ifft(jnp.fft.fft(lax.dynamic_slice(y, [1], (3,)))).real


SAME_LINEAR_SYSTEM = {
    "matmul": lambda y: A @ y,
    "dot-of-both": lambda y: jnp.matmul(y[None], jnp.asarray(A.T))[0],
    "stack-of-elements": lambda y: jnp.stack([(A[i] * y).sum() for i in range(3)]),
    "unpacking": lambda y: jnp.array([row[0] * y[0] + row[1] * y[1] + row[2] * y[2] for row in A]),
    "slices": lambda y: jnp.concatenate([A[:1] @ y, A[1:, :2] @ y[:2] + A[1:, 2] * y[2:]]),
    "broadcast-sum": lambda y: jnp.sum(A * y[None, :], axis=1),
    "transpose-reshape": lambda y: (A.T * y[:, None]).T.reshape(9).reshape(3, 3).sum(1),
    "reversed": lambda y: A[:, ::-1] @ y[::-1],
    "pad": lambda y: jnp.pad(A[:2] @ y, (0, 1)) + jnp.pad(A[2:] @ y, (2, 0)),
    "jit-vmap": lambda y: jax.jit(jax.vmap(lambda row: row @ y))(jnp.asarray(A)),
    "jvp": lambda y: jax.jvp(lambda y: jnp.asarray(A) @ y, (y,), (y,))[1],
    "there-and-back": lambda y: there_and_back(A @ y),
    "checkpoint": jax.checkpoint(lambda y: A @ y),
}


def test_series_of_a_linear_system_is_the_matrix_exponential():
    start = np.array([1.0, -2.0, 0.5])
    expected = [start]
    for k in range(ORDER):
        expected.append(A @ expected[-1] / (k + 1))

    def rates(state):
        return {name: SAME_LINEAR_SYSTEM[name](y) for name, y in state.items()}

    starts = dict.fromkeys(SAME_LINEAR_SYSTEM, jnp.array(start))
    complex_ones = {"there-and-back": starts.pop("there-and-back")}  # of which no kernel is made
    complex_ones = jax.jit(lambda y: solution_series(rates, y, ORDER))(complex_ones)
    found = solved_series(rates, starts) | complex_ones
    assert found.keys() == SAME_LINEAR_SYSTEM.keys()
    for series in found.values():
        assert_series(series, expected)


def test_products_of_two_vectors_that_both_vary():
    """y' = -y (y . y): its norm r follows r' = -r^3, so y = y(0) / sqrt(1 + 2 r(0)^2 t)."""
    start = np.array([0.6, -0.8])
    series = solved_series(lambda y: -y * (y @ y), jnp.array(start))
    expected = expected_series(lambda t: 1 / mpmath.sqrt(1 + 2 * t))
    assert_series(series, np.outer(expected, start))


def test_a_matrix_by_itself_whose_coefficients_do_not_commute():
    """Y' = Y Y + B, by Cauchy products."""
    B = np.array([[0.0, 1.0, 0.0], [0.0, 0.5, 2.0], [1.0, 0.0, 0.0]])
    Y = [A]
    for k in range(ORDER):
        square = np.sum([Y[j] @ Y[k - j] for j in range(k + 1)], axis=0)
        Y.append((square + B if k == 0 else square) / (k + 1))
    assert_series(solved_series(lambda Y: Y @ Y + B, jnp.array(A)), Y)


UNKNOWN = {
    "lgamma": lax.lgamma,
    "scan": lambda y: lax.fori_loop(0, 129, lambda i, x: x * y, y),
    "while": lambda y: lax.while_loop(lambda x: x < 9.0, lambda x: 2 * x, y),
    "sort": lambda y: jnp.sort(jnp.stack([y, -y]))[0],
    "eigh": lambda y: jnp.linalg.eigvalsh(jnp.eye(2) * y)[0],
}


def test_series_at_places_out_of_bounds_are_constants():
    places = jnp.array([5, 1])
    field = lambda y: y * y.at[places].get(mode="fill", fill_value=7.0)
    found = solution_series(field, jnp.array([0.1, 0.7]), 4)
    # y0' = 7 y0, y1' = y1^2
    expected = [[0.1 * 7**k / factorial(k), 0.7 ** (k + 1)] for k in range(5)]
    np.testing.assert_allclose(np.stack(found), expected, rtol=1e-13)


def test_a_function_put_in_the_place_of_its_entry_has_no_series():
    field = lambda y: y.at[0].apply(jnp.sin)
    with pytest.raises(NotImplementedError, match="scatter with a function"):
        solution_series(field, jnp.array([0.1, 0.7]), 4)


INSTEAD = {
    "scan": "loops of at most 128 turns",
    "while": "lax.fori_loop between two numbers",
    "sort": "jnp.maximum and jnp.where",
    "eigh": "jnp.linalg.solve",
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_a_primitive_without_a_series_is_named(name):
    with pytest.raises(
        NotImplementedError, match=f"'{name}'.*{INSTEAD.get(name, '')}.*Runge-Kutta"
    ):
        solution_series(UNKNOWN[name], jnp.array(1.0), 3)


def test_series_in_float32():
    def rate(y):
        return jnp.sin(y) + jnp.exp(-y) / (1 + y**2)

    low = solved_series(rate, jnp.array(0.5, jnp.float32))
    assert {c.dtype for c in low} == {jnp.dtype("float32")}
    assert_series(low, solved_series(rate, jnp.array(0.5)), rtol=3e-7)


def test_series_differentiates_and_batches():
    """d/dy(0) of the series of y = y(0) / (1 - y(0) t): coefficients y(0)^(k+1)."""
    starts = jnp.linspace(-0.9, 0.9, 7)
    series = jax.jit(jax.vmap(jax.jacfwd(lambda y: solution_series(jnp.square, y, ORDER))))(starts)
    for k, derivative in enumerate(series):
        np.testing.assert_allclose(derivative, (k + 1) * starts**k, rtol=1e-13)


@pytest.mark.parametrize("times", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_derivatives_of_a_series_by_what_a_closure_holds(times):
    """y' = a y^2 has the coefficients a^k y(0)^(k+1)."""

    def coefficients(a, y):
        return jnp.stack(solution_series(lambda y: a * jnp.square(y), y, ORDER))

    def expected(a, y):
        return jnp.stack([a**k * y ** (k + 1) for k in range(ORDER + 1)])

    found = []
    for function in (coefficients, expected):
        for _ in range(times):
            function = jax.jacfwd(function, argnums=(0, 1))
        found.append(jax.tree.leaves(jax.jit(function)(0.7, 1.3)))
    np.testing.assert_allclose(*found, rtol=1e-13)


def test_derivatives_of_a_series_with_sines():
    """tan(y / 2) = tan(y(0) / 2) exp(a t) for y' = a sin(y): dy/dy(0) = sin(y) / sin(y(0))."""
    a, start = 0.7, 1.3
    series = lambda a, y: jnp.stack(solution_series(lambda y: a * jnp.sin(y), y, ORDER))
    y = lambda t: 2 * mpmath.atan(mpmath.tan(mpmath.mpf(start) / 2) * mpmath.exp(a * t))
    expected = (
        expected_series(lambda t: t * mpmath.sin(y(t))),
        expected_series(lambda t: mpmath.sin(y(t)) / mpmath.sin(start)),
    )
    for jacobian in (jax.jacfwd, jax.jacrev):
        for found, exact in zip(jax.jit(jacobian(series, (0, 1)))(a, start), expected, strict=True):
            assert_series(found, exact)


@jax.custom_vjp
def by_own_rule(x):
    return jnp.sin(x)


by_own_rule.defvjp(lambda x: (jnp.sin(x), x), lambda x, ct: (ct * jnp.cos(x),))
NOT_SMOOTH = {
    "a real power at zero": (lambda y: y**2.0 + 1, lambda y: y * y + 1, 0.0),
    "a rule for reverse mode": (by_own_rule, jnp.sin, 0.7),
    "a branch": (lambda y: jnp.where(y > 0, y * y, -y), lambda y: y * y, 0.7),
    "another type": (lambda y: y * (y > 0).astype(y.dtype), lambda y: y, 0.7),
}


@pytest.mark.parametrize("name", NOT_SMOOTH)
@pytest.mark.parametrize(
    "transform", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow), jax.hessian]
)
def test_derivatives_where_operations_are_not_smooth(name, transform):
    field, same, start = NOT_SMOOTH[name]
    series = lambda f: jax.jit(transform(lambda y: jnp.stack(solution_series(f, y, ORDER))))
    found, expected = series(field)(start), series(same)(start)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-15)


def test_derivatives_beside_whole_numbers_and_nothing():
    def speed(y):
        state = {"x": y, "clock": y, "none": None}
        rates = lambda state: {"x": jnp.sin(state["x"]), "clock": 1, "none": None}
        return solution_series(rates, state, 3)["x"][1]

    assert jax.grad(speed)(0.7) == pytest.approx(np.cos(0.7))


# Series of functions of a solution


def test_series_of_a_function_of_known_series():
    """Several results of (exp(t), tan(t))."""
    expected_exp, expected_tan = expected_series(mpmath.exp), expected_series(mpmath.tan)
    known = {"a": [jnp.array(c) for c in expected_exp], "b": [jnp.array(c) for c in expected_tan]}

    def function(y):
        return y["a"] * jnp.sin(y["b"]), jnp.log(y["a"]) - y["b"], jnp.ones(())

    product, difference, one = function_series(function, known)
    assert_series(product, expected_series(lambda t: mpmath.exp(t) * mpmath.sin(mpmath.tan(t))))
    assert_series(difference, expected_series(lambda t: t - mpmath.tan(t)))
    assert_series(one, [1.0] + [0.0] * ORDER)


INNER = (0.8, 0.5, -0.6, 0.0, 0.4)
"""Coefficients of x(t) from t on."""
SECOND = (1.5, -0.7, 0.3, 0.2)
"""Those of a second operand, y(t)."""
LARGE = (1.1, 1.7, 4.0)
SMALL = (-0.6, 0.1, 0.5)
BOTH = (-1.3, 0.4, 2.0)


# A primitive from jax 0.12 on.
polynomial = getattr(lax, "polynomial", lambda x, c: c[0] + c[1] * x + c[2] * x**2)


# Of one operand: the function, the same of mpmath, and where it is expanded.
ELEMENTARY = {
    "acos": (jnp.arccos, mpmath.acos, SMALL),
    "acosh": (jnp.arccosh, mpmath.acosh, (1.6, 2.0, 4.0)),
    "asin": (jnp.arcsin, mpmath.asin, SMALL),
    "asinh": (jnp.arcsinh, mpmath.asinh, BOTH),
    "atan": (jnp.arctan, mpmath.atan, BOTH),
    "atanh": (jnp.arctanh, mpmath.atanh, SMALL),
    "cbrt": (jnp.cbrt, lambda x: mpmath.sign(x) * mpmath.cbrt(abs(x)), (-1.3, 0.7, 2.0)),
    "cos": (jnp.cos, mpmath.cos, BOTH),
    "cosh": (jnp.cosh, mpmath.cosh, BOTH),
    "erf": (lax.erf, mpmath.erf, BOTH),
    "erf_inv": (lambda x: lax.erf(lax.erf_inv(x)), lambda x: x, SMALL),
    "erfc": (lax.erfc, mpmath.erfc, BOTH),
    "exp": (jnp.exp, mpmath.exp, BOTH),
    "exp2": (jnp.exp2, lambda x: mpmath.mpf(2) ** x, BOTH),
    "expm1": (jnp.expm1, mpmath.expm1, (-1.3, 1e-9, 2.0)),
    "log": (jnp.log, mpmath.log, LARGE),
    "log1p": (jnp.log1p, mpmath.log1p, (-0.3, 1e-9, 2.0)),
    "log2": (jnp.log2, lambda x: mpmath.log(x, 2), LARGE),
    "logistic": (lax.logistic, lambda x: 1 / (1 + mpmath.exp(-x)), BOTH),
    "rsqrt": (lax.rsqrt, lambda x: 1 / mpmath.sqrt(x), LARGE),
    "sin": (jnp.sin, mpmath.sin, BOTH),
    "sinh": (jnp.sinh, mpmath.sinh, BOTH),
    "softplus": (jax.nn.softplus, lambda x: mpmath.log1p(mpmath.exp(x)), (-1.3, 0.0, 2.0)),
    "gelu": (
        lambda x: jax.nn.gelu(x, approximate=False),
        lambda x: x * mpmath.erfc(-x / mpmath.sqrt(2)) / 2,
        BOTH,
    ),
    "swish": (jax.nn.swish, lambda x: x / (1 + mpmath.exp(-x)), BOTH),
    "sqrt": (jnp.sqrt, mpmath.sqrt, LARGE),
    "square": (jnp.square, lambda x: x * x, (-1.3, 0.0, 2.0)),
    "tan": (jnp.tan, mpmath.tan, (-0.9, 0.4, 3.0)),
    "tanh": (jnp.tanh, mpmath.tanh, BOTH),
    "slope of atanh": (jax.vmap(jax.grad(jnp.arctanh)), lambda x: 1 / (1 - x * x), SMALL),
    "polynomial": (lambda x: polynomial(x, [1, -0.5, 0.25]), lambda x: 1 - x / 2 + x**2 / 4, BOTH),
    "power 0": (lambda x: lax.integer_pow(x, 0), lambda x: mpmath.mpf(1), (-1.3, 0.0, 2.0)),
    "power 1": (lambda x: lax.integer_pow(x, 1), lambda x: x, (-1.3, 0.0, 2.0)),
    "power 7": (lambda x: lax.integer_pow(x, 7), lambda x: x**7, (-1.3, 0.0, 2.0)),
    "power -3": (lambda x: lax.integer_pow(x, -3), lambda x: x**-3, (-1.3, 0.7, 2.0)),
    "power 4.0": (lambda x: x**4.0, lambda x: x**4, (-1.3, 0.0, 2.0)),
    "power 0.3": (lambda x: x**0.3, lambda x: x ** mpmath.mpf(0.3), LARGE),
    "power -2.0": (lambda x: x**-2.0, lambda x: x**-2, (-1.3, 0.7, 2.0)),
    "whole numbers": (lambda x: lax.pow(x, jnp.array([2, 3, -1])), None, (-1.3, 0.7, 2.0)),
    "exponent": (lambda x: jnp.power(1.7, x), lambda x: mpmath.mpf(1.7) ** x, BOTH),
    "products": (lambda x: jnp.cumprod(x) / jnp.prod(x) * jnp.cumsum(x), None, (1.1, -2.0, 0.8)),
}


# Of two operands x(t) and y(t), the second from y(0) = 1.2 on.
OF_TWO = {
    "atan2": (jnp.arctan2, lambda x, y: mpmath.atan2(x, y), BOTH),
    "logaddexp": (jnp.logaddexp, lambda x, y: mpmath.log(mpmath.exp(x) + mpmath.exp(y)), BOTH),
    "atan2 behind": (lambda x, y: jnp.arctan2(x, -y), lambda x, y: mpmath.atan2(x, -y), LARGE),
    "power": (jnp.power, lambda x, y: x**y, LARGE),
}
LONG = 9


def polynomials(dtype, order=LONG):
    """Coefficients of x(t), but for the first, and of y(t)."""
    both = (INNER, (1.2, *SECOND))
    x, y = ([jnp.full(3, c, dtype) for c in coefficients] for coefficients in both)
    zero = jnp.zeros(3, dtype)
    return x + [zero] * (order - len(x)), y + [zero] * (order + 1 - len(y))


def of_elementary_functions(dtype, order=LONG):
    """Series of all of them, with three points of expansion each."""
    inner, second = polynomials(dtype, order)
    starts = {name: jnp.array(of[-1], dtype) for name, of in (ELEMENTARY | OF_TWO).items()}

    def functions(known):
        x, y = known
        one = {name: function(x[name]) for name, (function, *_) in ELEMENTARY.items()}
        return one | {name: function(x[name], y) for name, (function, *_) in OF_TWO.items()}

    return function_series(functions, ({name: [x, *inner] for name, x in starts.items()}, second))


@pytest.fixture(scope="module")
def elementary():
    return jax.jit(of_elementary_functions, static_argnums=0)(float)


def along(x, coefficients=INNER):
    """The polynomial, of mpmath numbers."""
    return lambda t: mpmath.polyval([*reversed(coefficients), x], t)


@pytest.mark.parametrize("name", ELEMENTARY | OF_TWO)
def test_series_of_elementary_functions(name, elementary):
    *_, function, starts = (ELEMENTARY | OF_TWO)[name]
    lines = [along(x) for x in starts]
    y = along(1.2, SECOND)

    def value(i, t):
        if name == "whole numbers":
            return lines[i](t) ** (2, 3, -1)[i]
        if name == "products":
            terms = [line(t) for line in lines]
            return mpmath.fsum(terms[: i + 1]) / mpmath.fprod(terms[i + 1 :])
        return function(lines[i](t), y(t)) if name in OF_TWO else function(lines[i](t))

    for i, start in enumerate(starts):
        expected = expected_series(partial(value, i), LONG)
        found = np.array([c[i] for c in elementary[name]])
        # Numbers of the size of the larger ones before it may have cancelled.
        sizes = np.maximum.accumulate(np.abs(expected))
        assert (np.abs(found - expected) <= 1e-13 * sizes).all(), (start, found, expected)


def test_series_of_elementary_functions_in_float32_are_float32():
    series = jax.eval_shape(lambda: of_elementary_functions(jnp.float32, len(INNER)))
    assert {c.dtype for c in jax.tree.leaves(series)} == {jnp.dtype("float32")}


def test_derivatives_of_a_series_are_series_of_the_derivative():
    """By x_0: of tan, those of 1 + tan^2."""
    _, known = polynomials(float)
    ones = [jnp.ones(3), *[jnp.zeros(3)] * LONG]
    _, slopes = jax.jvp(lambda x: function_series(jnp.tan, x), (known,), (ones,))
    expected = expected_series(lambda t: mpmath.sec(along(1.2, SECOND)(t)) ** 2, LONG)
    assert_series([c[0] for c in slopes], expected)


def test_evaluate_is_the_polynomial():
    coefficients = [3.0, -1.0, 0.5, 2.0]
    t = jnp.linspace(-2, 2, 9)
    expected = np.polyval(coefficients[::-1], t)
    np.testing.assert_allclose(evaluate_polynomial(coefficients, t), expected, rtol=1e-15)
    np.testing.assert_array_equal(evaluate_polynomial([2.0], t), 2.0)


# Sines


def test_series_go_through_stop_gradient():
    series = solution_series(lambda y: jax.lax.stop_gradient(y), jnp.array(1.0), 4)
    np.testing.assert_allclose(np.array(series), [1, 1, 1 / 2, 1 / 6, 1 / 24], rtol=1e-15)
    assert with_fast_sincos(lambda x: jnp.array(True))(jnp.array(1.0)).dtype == bool


def test_a_series_of_a_function_that_holds_a_series():
    """The second coefficient of z exp(z), z = y + t, is (2 + y) exp(y) / 2: a function of y."""

    def second(y):
        rate, zero = jnp.ones_like(y), jnp.zeros_like(y)
        return function_series(lambda z: z * jnp.exp(z), [y, rate, zero])[2]

    start = jnp.float64(0.3)
    found = function_series(second, [start, jnp.float64(1), jnp.float64(0), jnp.float64(0)])
    assert_series(found, expected_series(lambda t: (2.3 + t) * mpmath.exp(0.3 + t) / 2, 3))
