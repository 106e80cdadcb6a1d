"""A kernel's program leaves out equations that no result depends on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.extend.core import jaxpr_as_fun

from walker_jax.kernels.jaxprs import equations_in
from walker_jax.kernels.unused import without_unused


def names_in(closed) -> list[str]:
    return [equation.primitive.name for equation in equations_in(closed.jaxpr)]


def double_until(limit, x, y):
    """Return x doubled until it exceeds a limit; of its companions some are needed for that."""

    def turn(carry):
        x, step, by, turns, sines = carry
        return x + step, step * by, by, turns + 1, jnp.sin(sines) + y

    return lax.while_loop(lambda carry: carry[0] < limit, turn, (x, x, 2 * x / x, 0, x))


@jax.jit
def inside(x):
    found, _, _, turns, sines = double_until(100.0, x, jnp.exp(x))
    return found, turns, jnp.cos(sines)


CASES = {  # function, primitives that are left out, primitives that are not
    "what is carried for itself alone": (
        lambda x: double_until(100.0, x, jnp.exp(x))[0],
        {"sin", "exp"},
        {"mul", "div"},
    ),
    "what only the condition needs": (
        lambda x: double_until(100.0, x, jnp.exp(x))[3],
        {"sin", "exp"},
        {"mul", "div"},
    ),
    "what is carried and used": (
        lambda x: double_until(100.0, x, jnp.exp(x))[4],
        set(),
        {"sin", "exp", "mul", "div"},
    ),
    "a loop": (lambda x: (double_until(100.0, x, x), x + 1)[1], {"while", "mul"}, {"add"}),
    "in a call": (lambda x: inside(x)[0], {"sin", "exp", "cos"}, {"while", "mul"}),
    "in a loop": (
        lambda x: lax.fori_loop(0, 3, lambda i, c: (inside(c[0])[0], c[1] * c[0]), (x, x))[0],
        {"sin", "exp", "cos"},
        {"while", "mul"},
    ),
    "a derivative": (
        lambda x: jax.jvp(lambda x: double_until(100.0, x, jnp.exp(x))[0], (x,), (1.0,))[1],
        {"sin", "exp", "cos"},
        {"mul"},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_not_used_is_left_out(name):
    function, without, within = CASES[name]
    closed = jax.make_jaxpr(function)(1.5)
    pruned = without_unused(closed)
    assert without.isdisjoint(names_in(pruned)) and within.issubset(names_in(pruned))
    assert not without or not without.isdisjoint(names_in(closed))
    for x in 1.5, 3.0, 200.0:
        found = jax.jit(jaxpr_as_fun(pruned))(x)
        np.testing.assert_array_equal(found, [function(x)])


def test_effects_and_arguments_are_kept():
    def show(x, y):
        lax.while_loop(lambda i: i < 2, lambda i: (jax.debug.print("{}", i), i + 1)[1], 0)
        return x

    closed = jax.make_jaxpr(show)(1.0, 2.0)
    pruned = without_unused(closed)
    assert names_in(pruned) == names_in(closed) and len(pruned.jaxpr.invars) == 2
