"""Taylor series of solutions against known ones, and the sines against mpmath."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax

from walker_jax.taylor import evaluate, fast_sines, function_series, sincos, solution_series

ORDER = 9


def expected_series(solution, order=ORDER):
    """Taylor coefficients at t = 0 of a function of mpmath numbers, rounded to float64."""
    with mpmath.workdps(60):
        return [float(c) for c in mpmath.taylor(solution, 0, order)]


def assert_series(series, expected, rtol=1e-13):
    """Equal coefficients; a coefficient that is 0 may be as wrong as its neighbours are large."""
    expected = np.asarray(expected)
    size = np.max(np.abs(expected), axis=0)
    np.testing.assert_allclose(np.stack(series), expected, rtol=rtol, atol=rtol * np.max(size))


# Sine and cosine


def angles(dtype):
    """Angles up to 1e5: at random, of every size, and as close to multiples of pi/4 as dtype has."""
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(-1e5, 1e5, 3000)
    sizes = 10 ** rng.uniform(-12, 5, 3000) * rng.choice([-1, 1], 3000)
    multiples = np.arange(-127_000, 127_000, 113) * (np.pi / 4)
    return np.concatenate([anywhere, sizes, multiples, [0.0, 1e5, -1e5]]).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_sincos_is_right_to_two_units_in_the_last_place(dtype):
    x = angles(dtype)
    results = jax.jit(sincos)(jnp.asarray(x))
    with mpmath.workdps(40):
        # What is left of the exact value after the result, which float64 holds to all its digits.
        errors = [
            [float(f(mpmath.mpf(float(a))) - mpmath.mpf(float(r))) for a, r in zip(x, result)]
            for f, result in zip((mpmath.sin, mpmath.cos), results, strict=True)
        ]
    for result, error in zip(results, errors, strict=True):
        assert result.dtype == dtype
        units = np.abs(error) / np.spacing(np.abs(np.asarray(result))).astype(np.float64)
        assert np.max(units) < 2, x[np.argmax(units)]


def test_sincos_of_other_dtypes_is_that_of_jax():
    x = jnp.asarray([0.5, -3.0], jnp.bfloat16)
    sine, cosine = sincos(x)
    assert sine.dtype == cosine.dtype == jnp.bfloat16
    np.testing.assert_array_equal(sine, jnp.sin(x))
    np.testing.assert_array_equal(cosine, jnp.cos(x))


def test_derivatives_of_sincos_are_one_another_up_to_sign():
    x = jnp.linspace(-20.0, 20.0, 401)

    def derivatives(x):
        first = jax.jacfwd(sincos)
        return first(x), jax.jacfwd(first)(x), jax.grad(lambda x: sincos(x)[0] * sincos(x)[1])(x)

    first, second, of_product = jax.jit(jax.vmap(derivatives))(x)
    s, c = np.sin(x), np.cos(x)
    np.testing.assert_allclose(first, (c, -s), atol=1e-15)
    np.testing.assert_allclose(second, (-s, -c), atol=1e-15)
    np.testing.assert_allclose(of_product, np.cos(2 * x), atol=1e-15)


def test_sincos_of_what_is_not_finite_is_not_a_number():
    assert np.isnan(sincos(jnp.array([np.nan, np.inf, -np.inf]))).all()


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
    "sin-of-constant": (lambda y: y * jnp.sin(0.5 * y**0), 1.0, None),
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
