"""Sums of long arrays: of a transposed function, gathered; and in a loop, each in its memory."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.extend.core import jaxpr_as_fun
from test_kernels import of_both

from walker_jax.kernels import compiled
from walker_jax.kernels.gathered_sums import with_gathered_sums
from walker_jax.kernels.jaxprs import equations_in
from walker_jax.kernels.running_sums import take_out_sums

RNG = np.random.default_rng(3)
CELLS = 11
W, BIAS, POINTS = RNG.normal(size=(18, 18)) / 4, RNG.normal(size=18), RNG.normal(size=(CELLS, 3))


def deep(weights, bias, x):
    """A network that uses one matrix several times, once in a loop of known length."""
    h = jnp.tanh(jnp.broadcast_to(x[0], 18) + bias)
    for k in range(5):
        h = jnp.tanh(weights @ h + bias * k) * h
    h, _ = lax.scan(lambda h, _: (jax.jit(jnp.tanh)(weights @ h + h) - h * bias, None), h, length=3)
    return jnp.sum(h * x[1])


def gradient():
    weights, bias, x = map(jnp.asarray, (W, BIAS, POINTS[0]))
    return jax.make_jaxpr(jax.grad(deep, (0, 1)))(weights, bias, x), (weights, bias, x)


def test_gathered_sums_are_those_one_by_one():
    closed, given = gradient()
    gathered = with_gathered_sums(closed)
    found, expected = (jaxpr_as_fun(one)(*given) for one in (gathered, closed))
    assert gathered.out_avals == closed.out_avals
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-14)


def test_a_matrix_is_written_once():
    """Its cotangents outside the loop are one product of matrices, not five."""
    closed, _ = gradient()
    shape_of: Any = lambda variable: variable.aval.shape
    count = lambda one: sorted(
        shape_of(equation.invars[0])
        for equation in equations_in(one.jaxpr)
        if equation.primitive.name == "dot_general" and shape_of(equation.outvars[0]) == W.shape
    )
    assert count(closed) == [(18,)] * 6
    assert count(with_gathered_sums(closed)) == [(5, 18), (18,)]


def test_values_that_several_equations_use_are_computed_once():
    outer = lambda a, b: lax.dot_general(a, b, (((), ()), ((), ())))

    def function(a, b):
        total = a * b + a
        return total * total + b, outer(a, b) + outer(b, a), total

    closed = jax.make_jaxpr(function)(BIAS, 2 * BIAS)
    gathered = with_gathered_sums(closed)
    names = [equation.primitive.name for equation in gathered.jaxpr.eqns]
    assert names.count("sum_of_products") == 2
    for one, other in zip(
        jaxpr_as_fun(gathered)(BIAS, 2 * BIAS), function(BIAS, 2 * BIAS), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-15, atol=1e-15)


def test_functions_without_long_products_are_left_alone():
    closed = jax.make_jaxpr(lambda a: a * a + a)(BIAS)
    assert with_gathered_sums(closed) is closed


@pytest.mark.parametrize("bits", [128, 256, 512])
def test_sums_of_loops(bits, monkeypatch):
    """Every lane has its own number of turns; what ended lanes would add is NaN."""
    monkeypatch.setattr(compiled, "register_bits", lambda: bits)

    def function(x, n):
        def turn(now):
            i, h, matrix, column, flat, used, spread = now
            h = jnp.where(i < n, jnp.tanh(jnp.asarray(W) @ h + BIAS * x[0]), jnp.nan)
            pairs = jnp.stack([h, h * x[1], BIAS * h]), jnp.stack([h, BIAS + 0 * h, h * h])
            matrix = matrix + lax.dot_general(*pairs, (((0,), (0,)), ((), ())))
            column = jnp.outer(h, x) + column
            return (
                i + 1,
                h,
                matrix,
                column,
                flat + h,
                used + h * used[0],
                spread + jnp.full(20, h[3]),
            )

        h = jnp.asarray(W[:, :3]) @ x
        zeros = jnp.zeros((18, 18)), jnp.outer(h, x), h, h, jnp.zeros(20)
        return lax.while_loop(lambda now: now[0] < n, turn, (jnp.int64(0), h, *zeros))

    turns = np.arange(CELLS)
    body = [
        equation.params["body_jaxpr"]
        for equation in equations_in(jax.make_jaxpr(function)(POINTS[0], 3).jaxpr)
        if equation.primitive.name == "while"
    ]
    sums = take_out_sums(body[0], len(body[0].in_avals) - 7)[1]
    assert [(one.place, one.product is not None) for one in sums] == [
        (2, True),
        (3, False),
        (4, False),
        (6, False),
    ]
    found, expected = of_both(function, POINTS, turns)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_a_product_alone_is_one_as_before():
    """So a kernel finds that it knows an equal one; several, which are added, are one sum."""
    weights, x = jnp.asarray(W), jnp.asarray(BIAS)
    names = lambda function: [
        equation.primitive.name
        for equation in with_gathered_sums(jax.make_jaxpr(function)(x)).jaxpr.eqns
    ]
    assert names(lambda x: (weights @ x) * x) == ["dot_general", "mul"]
    assert names(lambda x: (weights @ x) * x + x * 2) == ["dot_general", "sum_of_products"]
