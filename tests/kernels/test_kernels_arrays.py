"""Kernels read computed indices, scans and small factorisations as JAX does."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from test_kernels import assert_same, of_all, run

from walker_jax.kernels.jaxprs import UnsupportedPrimitive

RNG = np.random.default_rng(0)
INDICES = np.arange(-9, 10).astype(np.int32)
"""Indices within an axis of 5, from its end, and beyond either end."""
ARRAYS = RNG.normal(size=(len(INDICES), 5, 2))


def test_parts_at_computed_indices():
    def function(x, i):
        return [
            x[i],
            x[2, i],
            x[i, i],
            x.at[i].get(mode="clip"),
            x.at[i].get(mode="fill", fill_value=7.0),
            x.at[i].get(mode="fill"),
            jnp.round(x).astype(jnp.int32).at[i].get(mode="fill"),
            x[jnp.stack([i, 2 - i, jnp.int32(1)])],
            jnp.take(x, i, axis=0, mode="wrap"),
            jnp.take_along_axis(x, jnp.full((5, 1), i), axis=1, mode="clip"),
            lax.dynamic_slice(x, (i, jnp.int32(0)), (3, 2)),
            lax.dynamic_slice(x, (i, i), (2, 1)),
            lax.dynamic_index_in_dim(x, i, axis=1),
            jax.vmap(lambda row, j: row[j])(x, jnp.arange(5, dtype=jnp.int32) + i),
        ]

    assert_same(function, ARRAYS, INDICES)
    assert_same(lambda x, i: x[i.astype(jnp.uint8)], ARRAYS, np.abs(INDICES))


def test_entries_of_tables_of_known_numbers():
    rng = np.random.default_rng(4)
    rows, flags = rng.normal(size=(300, 2)), rng.random(300) < 0.5
    whole, single = rng.integers(-9, 9, 300), rng.normal(size=300).astype(np.float32)

    def function(x, i):
        return [
            jnp.asarray(rows)[i],
            jnp.asarray(rows).T[1, i] * x[0, 0],
            jnp.asarray(flags)[i],
            jnp.asarray(whole)[i],
            jnp.asarray(single)[i],
            jnp.asarray(rows).at[i].get(mode="fill"),
            lax.dynamic_slice(jnp.asarray(rows), (i, jnp.int32(0)), (1, 2)),
            lax.fori_loop(0, 40, lambda k, y: y + jnp.asarray(rows)[(k * i) % 300, 0], x[0, 0]),
        ]

    indices = np.array([0, 7, 150, 299, 300, 4000, -1, -300, -4000], np.int32)
    assert_same(function, ARRAYS[: len(indices)], indices)


def test_nothing_is_taken_of_an_empty_array():
    assert_same(lambda x, i: [x[0, 0], *x[5:]], ARRAYS, INDICES)


def test_indices_short_of_the_end_of_an_array_have_no_kernel():
    table = np.arange(300.0)
    with pytest.raises(UnsupportedPrimitive, match="int8 indices of an array of 300"):
        run(lambda x, i: jnp.asarray(table)[i] * x, np.ones(3), np.arange(3, dtype=np.int8))


def test_parts_written_at_computed_indices():
    def function(x, i):
        modes = "clip", "drop", "promise_in_bounds"
        inside = jnp.clip(i, 0, 4)
        return [
            x.at[i].set(1.5),
            x.at[i, 1].set(x[0, 0]),
            x.at[2, i].add(3.0),
            *(x.at[inside].multiply(2.0, mode=mode) for mode in modes),
            *(x.at[i].min(0.0, mode=mode) for mode in modes[:2]),
            x.at[i].max(0.0),
            x.at[i].subtract(x[1]),
            # the same place twice
            x.at[jnp.stack([i, i, 2 - i])].add(x[:3]),
            x.at[jnp.stack([i, i])].set(jnp.ones((2, 2)) * jnp.arange(2.0)),
            lax.dynamic_update_slice(x, x[1:3] * 2, (i, jnp.int32(0))),
            lax.dynamic_update_slice(x, x[:1, :1], (i, i)),
            jax.vmap(lambda row, j: row.at[j].set(0.0))(x, jnp.arange(5, dtype=jnp.int32) + i),
        ]

    assert_same(function, ARRAYS, INDICES)


def test_a_loop_through_an_array():
    """Sums of what has come before, kept in a buffer that indices beyond its end leave alone."""

    def function(x, n):
        def turn(state):
            i, buffer = state
            return i + 1, buffer.at[i].set(buffer[i - 1] + x[i], mode="drop")

        return lax.while_loop(lambda state: state[0] < n, turn, (jnp.int64(1), x))[1]

    assert_same(function, ARRAYS[:, :, 0], np.arange(len(ARRAYS)) % 8)


def test_places_in_sorted_arrays():
    x = np.array([-np.inf, -1.0, -0.0, 0.0, 0.5, np.nan, np.inf, 7.0])
    assert_same(lambda x: jnp.searchsorted(jnp.array([-1.0, 0.0, 0.5, 2.0]), x), x)
    assert_same(lambda x: jnp.searchsorted(jnp.array([-1, 0, 3]), x), np.arange(-3, 6))


def test_functions_that_newer_versions_of_jax_call():
    """Up to jax 0.10 their parts stand in the jaxpr itself."""

    def function(x):
        root = lambda f, x: lax.fori_loop(0, 40, lambda i, y: y - f(y) / 3, x)
        return [
            lax.custom_root(lambda y: y + jnp.sin(y) / 2 - x, x, root, lambda g, y: y / g(1.0)),
            jnp.ldexp(x, 3),
            jnp.frexp(x),
            jnp.interp(x, jnp.arange(3.0), jnp.array([1.0, -1.0, 2.0])),
            jnp.digitize(x, jnp.array([0.5, 1.0, 1.5])),
            jnp.nonzero(jnp.stack([x, 0.0 * x, -x]), size=3, fill_value=-1),
            jnp.sinc(x),
            jnp.hypot(x, 2.0),
        ]

    x = np.linspace(-1.1, 2.3, 35)
    assert_same(function, x, ulps=20)
    assert_same(lambda x: jax.grad(lambda x: function(x)[0])(x), x, ulps=20)


@pytest.mark.parametrize("length", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_scans_short_and_long(length):
    """The short one is unrolled. Neither amplifies rounding, nor comes near zero."""
    xs = np.random.default_rng(length).uniform(0.5, 1, size=(length, 2))

    def function(y, n):
        def turn(carry, x):
            total, i = carry
            total = 3 + jnp.sin(total) / 2 + x[0] * y
            return (total, i + n), (total, i, x)

        forth = lax.scan(turn, (y, n), xs)
        back = lax.scan(turn, (y, n), xs, reverse=True)
        counted = lax.fori_loop(0, length, lambda i, z: 3 + jnp.cos(z + i) / 2, y)
        return forth, back, counted

    assert_same(function, np.linspace(-1, 2, 19), np.arange(19), ulps=200)


def test_a_loop_from_either_of_two_numbers():
    """It is unrolled for both."""

    def function(x, first):
        table = jnp.array([0.5, 2.0, -1.0, 3.0])

        def turn(state):
            i, y = state
            return i + 1, jnp.cos(y) * table[i]

        start = jnp.where(first, 0, 1)
        return lax.while_loop(lambda state: state[0] < 4, turn, (start, x))[1]

    x = np.linspace(-2, 3, 33)
    assert_same(function, x, x > 1)
    assert_same(function, x, x > 9)


def test_cumulative_and_extreme_entries():
    x = ARRAYS[:, :, 0].copy()
    x[1, 2] = x[2, 0] = x[2, 4] = np.nan
    x[3] = 1.0

    def function(x):
        return [
            jnp.argmax(x),
            jnp.argmin(x),
            jnp.argmax(jnp.stack([x, -x]), axis=0),
            jnp.cumsum(x),
            jnp.cumprod(x),
            lax.cummax(x, reverse=True),
            lax.cummin(x),
            jnp.select([x > 1, x > 0], [x, 2 * x], -x),
            jax.nn.sigmoid(x),
        ]

    assert_same(function, x, ulps=20)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_next_number(dtype):
    info = np.finfo(dtype)
    least = info.smallest_subnormal
    x = np.array([0, -0.0, 1, -1, least, -least, info.max, np.inf, -np.inf, np.nan, 0.1], dtype)
    x, y = (a.ravel() for a in np.meshgrid(x, x))
    found = run(lambda x, y: jnp.nextafter(x, y), x, y)
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(found, np.nextafter(x, y))


@pytest.mark.parametrize("exponent", [1 / 12, -0.3 / 5, 0.7, -2.3])
def test_powers_of_known_exponents(exponent):
    with np.errstate(all="ignore"):
        x = np.concatenate([10.0 ** RNG.uniform(-320, 308, 300), 1 + 1e-8 * RNG.normal(size=50)])
        normal = (x**exponent > 1e-300) & np.isfinite(x**exponent)
    found = run(lambda x: x**exponent, x[normal])
    with mpmath.workprec(120):
        exact = [mpmath.power(mpmath.mpf(a), mpmath.mpf(exponent)) for a in x[normal].tolist()]
        errors = [float(mpmath.mpf(a) / b - 1) for a, b in zip(found.tolist(), exact, strict=True)]
    assert np.max(np.abs(errors)) < np.finfo(float).eps
    special = np.array([0, -0.0, np.inf, -np.inf, np.nan, -1.0, 1.0])
    assert_same(lambda x: x**exponent, special)
    single = x[normal & (x > 1e-12) & (x < 1e12)].astype(np.float32)
    assert_same(lambda x: x ** np.float32(exponent), single)


MATRICES = RNG.normal(size=(30, 4, 4))
LINEAR_ALGEBRA = {
    "solve": lambda a: jnp.linalg.solve(a, jnp.arange(1.0, 5)),
    "inverse": jnp.linalg.inv,
    "determinant": jnp.linalg.det,
    "lu": lambda a: jax.scipy.linalg.lu_factor(a),
    "wide lu": lambda a: lax.linalg.lu(a[:2]),
    "tall lu": lambda a: lax.linalg.lu(a[:, :2]),
    "qr": lambda a: jnp.linalg.qr(a[:, :3]),
    "raw qr": lambda a: jnp.linalg.qr(a[:, :3], mode="raw"),
    "wide qr": lambda a: jnp.linalg.qr(a[:2]),
    "cholesky": lambda a: jnp.linalg.cholesky(a @ a.T),
    "not positive definite": jnp.linalg.cholesky,
    "upper": lambda a: jax.scipy.linalg.solve_triangular(a, a[0]),
    "lower transposed": lambda a: jax.scipy.linalg.solve_triangular(a, a, trans=1, lower=True),
    "from the right": lambda a: lax.linalg.triangular_solve(a, a, left_side=False, lower=True),
    "unit": lambda a: lax.linalg.triangular_solve(a, a, left_side=True, unit_diagonal=True),
    "batch": lambda a: jnp.linalg.solve(jnp.stack([a, 2 * a]), jnp.ones((2, 4, 1))),
    "derivative": lambda a: jax.jvp(lambda a: jnp.linalg.solve(a, a[0]), (a,), (a * a,))[1],
}


@pytest.fixture(scope="module")
def linear_algebra():
    return of_all(LINEAR_ALGEBRA, MATRICES)


@pytest.mark.parametrize("name", LINEAR_ALGEBRA)
def test_linear_algebra_of_small_matrices(name, linear_algebra):
    found, expected = (jax.tree.leaves(each[name]) for each in linear_algebra)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_long_arrays_with_computed_indices_have_no_kernel():
    with pytest.raises(UnsupportedPrimitive, match="indices of an array of 500"):
        run(lambda x, i: jnp.full(500, x).at[i].set(0.0), np.ones(3), np.arange(3))


def test_a_check_at_run_time_has_no_kernel():
    def function(x):
        jax.debug.callback(lambda x: None, x)
        return jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((), x.dtype), x)

    with pytest.raises(UnsupportedPrimitive, match="callback"):
        run(function, np.ones(3))
