"""Sine and cosine against mpmath, and the fast sines of series."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from compiler_flags import AS_USERS
from jax import lax

from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.series import sincos

# Sine and cosine


def angles(dtype):
    """Angles up to 1e5: at random, of every size, and next to multiples of pi/4."""
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(-1e5, 1e5, 3000)
    sizes = 10 ** rng.uniform(-12, 5, 3000) * rng.choice([-1, 1], 3000)
    multiples = np.arange(-127_000, 127_000, 113) * (np.pi / 4)
    return np.concatenate([anywhere, sizes, multiples, [0.0, 1e5, -1e5]]).astype(dtype)


def sincos_errors(x):
    """Error of each result, and the result, of `sincos` at x, by the code XLA makes for users."""
    results = jax.jit(sincos, compiler_options=AS_USERS)(jnp.asarray(x))
    for function, result in zip((mpmath.sin, mpmath.cos), results, strict=True):
        assert result.dtype == x.dtype
        with mpmath.workdps(40):
            pairs = zip(x.tolist(), np.asarray(result).tolist(), strict=True)
            yield np.array([abs(float(function(a) - r)) for a, r in pairs]), np.asarray(result)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_sincos_is_right_to_the_last_place_of_one(dtype):
    x = angles(dtype)
    for error, _ in sincos_errors(x):
        assert np.max(error) < np.finfo(dtype).eps, x[np.argmax(error)]


@pytest.mark.parametrize(("dtype", "largest"), [(np.float64, 1e5), (np.float32, 4.0)])
def test_sincos_is_right_to_few_units_also_near_its_zeros(dtype, largest):
    x = angles(dtype)
    x = x[np.abs(x) <= largest]
    for error, result in sincos_errors(x):
        units = error / np.spacing(np.abs(result)).astype(float)
        assert np.max(units) < 3, x[np.argmax(units)]


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


# Sines


@jax.jit
def with_sines(x, y):
    inner = jax.jit(lambda z: jnp.cos(z) ** 2 + jnp.sin(z) * jnp.cos(2 * z))
    slope = jax.jvp(jnp.sin, (x,), (y,))[1]
    return {"value": jnp.where(x > 0, inner(x), jnp.sin(y)), "slope": slope, "sign": jnp.sign(x)}


def test_fast_sines_equal_the_function_and_its_derivatives():
    x = jnp.linspace(-5.0, 5.0, 51)
    y = x[::-1] + 0.3
    faster = with_fast_sincos(with_sines)
    assert "sin " not in str(jax.make_jaxpr(faster)(x, y)) + " "
    along = lambda function: jax.jvp(function, (x, y), (y, x))
    (plain, slopes), (fast, fast_slopes) = jax.jit(lambda: (along(with_sines), along(faster)))()
    assert plain.keys() == fast.keys()
    for key in plain:
        np.testing.assert_allclose(fast[key], plain[key], rtol=0, atol=3e-15)
        np.testing.assert_allclose(fast_slopes[key], slopes[key], rtol=0, atol=3e-14)


def test_fast_sines_keep_whole_numbers_and_loops():
    def function(n, x):
        return n + 1, lax.fori_loop(0, 3, lambda i, v: jnp.sin(v), x)

    n, x = map(jnp.asarray, with_fast_sincos(function)(jnp.array(3), jnp.array(0.5)))
    assert n == 4 and n.dtype == jnp.int64
    assert x == pytest.approx(np.sin(np.sin(np.sin(0.5))), rel=1e-15)
