"""Long arrays in memory: the results of JAX, by programs of one length for any width."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from test_kernels import of_both, run

from walker_jax.kernels import compiled, kernel, store, why_not
from walker_jax.kernels.compiled import source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive

RNG = np.random.default_rng(0)
CELLS = 11
W, U, BIAS = RNG.normal(size=(21, 3)), RNG.normal(size=(18, 21)) / 5, RNG.normal(size=21)
POINTS = RNG.normal(size=(CELLS, 3))


def layer(x, dtype=None):
    """A long vector that depends on the cell."""
    return jnp.asarray(W, dtype) @ x + jnp.asarray(BIAS, dtype)


def assert_near(function, *cells, shared=(), tolerance=1e-14):
    found, expected = of_both(function, *cells, shared=shared)
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        np.testing.assert_allclose(one, other, tolerance, tolerance)


@pytest.fixture(params=[128, pytest.param(256, marks=pytest.mark.slow), 512])
def registers(request, monkeypatch):
    """Vectors of this many bits."""
    monkeypatch.setattr(compiled, "register_bits", lambda: request.param)


@pytest.mark.parametrize(
    ("registers", "dtype"),
    [
        (128, np.float32),
        (512, np.float64),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in [(128, np.float64), (512, np.float32), (256, np.float32), (256, np.float64)]
        ),
    ],
    indirect=["registers"],
)
def test_products(dtype, registers):
    a, b = RNG.normal(size=(2, 19, 3)).astype(dtype), RNG.normal(size=(17, 5, 3)).astype(dtype)
    w, u = W.astype(dtype), U.astype(dtype)

    def function(given, each, x):
        h = jnp.tanh(jnp.asarray(w) @ x)
        return [
            h,
            jnp.asarray(u) @ h,
            h @ jnp.asarray(u).T,
            given @ x,
            x @ given.T,
            each @ h,
            each.T @ (each @ h),
            jnp.asarray(a) @ jnp.stack([x, 2 * x], 1),
            jnp.einsum("ijk,k->ji", jnp.asarray(b), x),
            jnp.einsum("ijk,ljk->il", jnp.asarray(b), jnp.asarray(b)[:4] * x),
            jnp.einsum("bk,bk->b", each[:, :18], jnp.asarray(u)[:, :18] * h[0]),
            h @ h,
        ]

    given = RNG.normal(size=(300, 3)).astype(dtype)  # many numbers, which all cells share
    each = RNG.normal(size=(CELLS, 18, 21)).astype(dtype)
    x = POINTS.astype(dtype)
    tolerance = 1e-13 if dtype == np.float64 else 2e-5
    assert_near(function, each, x, shared=(given,), tolerance=tolerance)
    assert_near(function, np.stack([given] * CELLS), each, x, tolerance=tolerance)


def test_entries(registers):
    def function(x):
        h = layer(x)
        n = jnp.round(h * 3).astype(jnp.int32)
        return [
            *(f(h) for f in (jnp.sin, jnp.exp, jnp.abs, jnp.sign, jnp.isfinite, jax.nn.sigmoid)),
            *(f(h) for f in (jax.nn.relu, jax.nn.softplus, jax.nn.gelu, jax.nn.swish)),
            h * 0.0 + 1.0,
            h * jnp.ones(21) - x[0],
            h * jnp.where(jnp.arange(21) % 3 == 0, x[1], BIAS),
            jnp.where(h > x[0], h, -h),
            jnp.where(x[0] > 0, h, -h),
            jnp.where((n > 2) | (n < -2), n, n // 2),
            jnp.clip(h, -1, x[0] + 3) ** 3,
            lax.integer_pow(h, -2),
            h.astype(jnp.float32),
            h[:, None] * h[None, :4] - jnp.arange(4.0),
            jnp.broadcast_to(x[0], 20) / (2 + jnp.cos(jnp.arange(20.0) * x[1])),
        ]

    assert_near(function, POINTS)


def test_the_hyperbolic_tangent_of_long_arrays():
    """Within 3 units of the last digit, by mpmath's at 60 digits; also where it is NaN or 1."""
    sizes = 10.0 ** RNG.uniform(-300, 3, 300), RNG.uniform(0, 1, 500), RNG.uniform(0, 25, 500)
    x = np.concatenate([*sizes, [0.0, np.inf, np.nan, 1e-320]])
    x = np.stack([x, -x], 1)
    ones = np.ones((20, 2))

    def function(y):
        both = jnp.broadcast_to(y[:, None], (2, 20)) + 0 * (jnp.asarray(ones) @ y)
        return jnp.tanh(jnp.where(jnp.isfinite(y[0]), both, y[:, None]))[:, 3]

    found = run(function, x)
    with mpmath.workdps(60):
        exact = [float(mpmath.tanh(mpmath.mpf(one))) for one in x.ravel().tolist()]
    np.testing.assert_allclose(found.ravel(), exact, rtol=3 * np.finfo(float).eps, atol=0)


def test_moves():
    def function(x):
        h = layer(x)
        grid = h.reshape(3, 7)
        return [
            grid.T,
            grid.T.reshape(21),
            grid[::2, 1:6:2],
            grid[::-1, ::-1].ravel(),
            h[5],
            h[2:19].reshape(17, 1)[:, 0],
            jnp.stack([h, h * 2, jnp.zeros(21), jnp.full(21, x[0])]),
            jnp.stack([h, -h], axis=1),
            jnp.concatenate([x, h, jnp.arange(4.0), h[:2]]),
            jnp.concatenate([grid, grid[:, :2]], axis=1),
            jnp.split(h, [2, 19]),
            jnp.pad(h, (1, 2), constant_values=x[0]),
            jnp.roll(h, 3),
            h.at[jnp.array([3, 4])].set(x[:2]),
        ]

    assert_near(function, POINTS)


def test_reductions():
    def function(x):
        h = layer(x)
        grid = jnp.stack([h, jnp.cos(h), -h])
        return [
            jnp.sum(h),
            grid.sum(0),
            grid.sum(1),
            grid.reshape(3, 3, 7).sum((0, 2)),
            grid.max(0),
            grid.min(),
            jnp.prod(jnp.cos(h)),
            jnp.any(h > 2),
            jnp.all(grid > -3, axis=0),
            jnp.argmax(h),
            jnp.cumsum(h),
            jnp.sum(jnp.broadcast_to(x[0], 20)),
        ]

    assert_near(function, POINTS, tolerance=1e-13)


def test_loops_and_branches(registers):
    """Every lane has its own number of turns, and arrays that exchange their places."""

    def function(x, n):
        h, step = layer(x), lambda h: jnp.tanh(jnp.asarray(U.T @ U) @ h + BIAS)

        def turn(state):
            i, a, b = state
            return i + 1, b, step(a)

        count, a, b = lax.while_loop(lambda s: s[0] < n, turn, (jnp.int64(0), h, jnp.zeros(21)))
        turns = lax.scan(lambda h, y: (step(h) + y, h[0]), h, jnp.arange(20.0) * x[0])
        halves = lax.while_loop(
            lambda h: jnp.max(jnp.abs(h)) > 1, lambda h: h / 2, jnp.stack([h, h + x[0]], 1)
        )
        each = jax.vmap(lambda y: lax.while_loop(lambda y: y[0] > 0, lambda y: y - 1, y))
        chosen = lax.cond(n > 4, lambda: step(step(h)), lambda: jnp.ones(21) * 2)
        three = lax.switch(n % 3, [lambda: h, lambda: jnp.zeros(21), lambda: step(h) * h[0]])
        parts = jnp.stack([h, h[::-1] * 3])
        return count, a, b, turns, halves, each(parts), each(h[:, None]), chosen, three

    assert_near(function, POINTS, np.arange(CELLS), tolerance=1e-12)


def test_entries_at_computed_places_and_flags():
    def function(x, i):
        h = layer(x)
        return h[i], h.at[i].set(7.0), jnp.asarray(BIAS)[i] * h[0], h > 0, jnp.searchsorted(BIAS, x)

    assert_near(function, POINTS, np.arange(CELLS) * 2)


@pytest.mark.parametrize("where", ["constants", "operands"])
def test_derivatives(where):
    """By the point and by the weights, of a network that is a constant or an operand."""
    weights = [W, BIAS, U, RNG.normal(size=18)]

    def network(weights, x):
        first, bias, second, last = weights
        return last @ jnp.tanh(second @ jnp.tanh(first @ x + bias))

    if where == "constants":
        made, plain = kernel(lambda x: network(weights, x)), lambda x: network(weights, x)
        ways = jax.jacfwd, jax.grad, jax.hessian
        every = lambda f: jax.jit(jax.vmap(lambda x: [way(f)(x) for way in ways]))(POINTS)
        found, expected = every(made), every(plain)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        ahead = (made(POINTS[0] + [1e-6, 0, 0]) - made(POINTS[0] - [1e-6, 0, 0])) / 2e-6
        np.testing.assert_allclose(found[0][0, 0], ahead, rtol=1e-8)
        return
    made = kernel(network)
    of_bias = lambda f: lambda b, x: f([W, b, U, weights[3]], x)
    found, expected = (
        jax.vmap(jax.jacfwd(of_bias(f)), (None, 0))(BIAS, POINTS) for f in (made, network)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    change = RNG.normal(size=U.shape)

    def along(f):
        of_matrix = lambda x: lambda u: f([W, BIAS, u, weights[3]], x)
        return jax.vmap(lambda x: jax.jvp(of_matrix(x), (U,), (change,)))

    for one, other in zip(along(made)(POINTS), along(network)(POINTS), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)
    many = jnp.stack([U + i for i in range(CELLS)])
    each = lambda f: jax.jit(jax.vmap(lambda u, x: f([W, BIAS, u, weights[3]], x)))(many, POINTS)
    np.testing.assert_allclose(each(made), each(network), rtol=1e-12, atol=1e-13)


def test_programs_are_as_long_for_wide_networks():
    def lines(width):
        w, u = np.ones((width, 3)), np.ones((width, width))
        function = lambda x: jnp.sum(jnp.tanh(jnp.asarray(u) @ jnp.tanh(jnp.asarray(w) @ x)))
        return source_of(jax.make_jaxpr(function)(POINTS[0]), 256)[2].count("\n")

    assert lines(64) == lines(32)


def test_short_arrays_stay_in_registers():
    """So do those of programs for GPUs."""
    small = lambda x: jnp.asarray(W[:15]) @ x
    closed = jax.make_jaxpr(small)(POINTS[0])
    assert "malloc" not in source_of(closed, 256)[2]
    closed = jax.make_jaxpr(layer)(POINTS[0])
    assert "malloc" in source_of(closed, 256)[2] and "malloc" not in source_of(closed, 0)[2]


def test_a_network_that_is_too_large_has_no_kernel(monkeypatch):
    monkeypatch.setattr(store, "MAX_BYTES", 1000)
    message = "arrays of more than 1000 bytes"
    with pytest.raises(UnsupportedPrimitive, match=message):
        run(layer, POINTS)
    assert message in (why_not(lambda x: layer(x) * 2, POINTS[0]) or "")
    np.testing.assert_allclose(jax.vmap(kernel(layer))(POINTS), POINTS @ W.T + BIAS, rtol=1e-14)
