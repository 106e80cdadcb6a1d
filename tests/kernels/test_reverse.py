"""Reverse mode through loops of any number of turns, which a kernel transposes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from walker_jax.kernels import kernel, transposes
from walker_jax.kernels.program import program_of
from walker_jax.kernels.reverse import (
    ROWS,
    reversing,
    with_transposed_turns,
    zero_where_unused,
)

MOST = 3 * ROWS + 5
TURNS = jnp.array([0, 3, ROWS, ROWS + 1, MOST])
XS, A = jnp.linspace(0.1, 1, 10).reshape(5, 2), jnp.array([0.9, 0.95])


def turn(a, x):
    return a * x + 0.1 * jnp.sin(x)


def by_turns(a, x, turns, writes):
    def find(start, writer):
        def following(now):
            i, x, tapes = now
            tapes = writer.put(tapes, i, x) if writer is not None and writes else tapes
            return i + 1, turn(a, x), tapes

        begun = jnp.zeros_like(turns), start, writer and writer.tapes
        _, end, tapes = lax.while_loop(lambda now: now[0] < turns, following, begun)
        return end, turns, (), tapes if writes else None

    return with_transposed_turns(find, lambda x: (), lambda x, _: turn(a, x), x)[0]


@kernel
def by_loop(a, x, turns):
    return by_turns(a, x, turns, True)


@kernel
def by_loop_again(a, x, turns):
    """The same; it is made again in reverse, as it does not write the starts of its turns."""
    return by_turns(a, x, turns, False)


def by_scan(a, x, turns):
    """The same with a known number of turns, of which JAX itself knows the derivatives."""
    step = lambda x, i: (jnp.where(i < turns, turn(a, x), x), None)
    return lax.scan(step, x, jnp.arange(MOST))[0]


@pytest.fixture(autouse=True)
def always(monkeypatch):
    monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", 1)


def loss(function):
    return lambda a, x, turns: (function(a, x, turns) ** 2).sum()


DERIVATIVES = {
    "grad": lambda f: jax.grad(loss(f), (0, 1)),
    "jacrev": lambda f: jax.jacrev(f, (0, 1)),
    "forward over reverse": lambda f: jax.hessian(loss(f), (0, 1)),
    "reverse over reverse": lambda f: jax.grad(
        lambda *args: jax.grad(loss(f))(*args) @ jnp.array([1.0, 2.0]), 1
    ),
}


@pytest.mark.parametrize(
    ("name", "loop"),
    [
        *((name, by_loop) for name in DERIVATIVES),
        ("grad", by_loop_again),
        *(pytest.param(n, by_loop_again, marks=pytest.mark.slow) for n in [*DERIVATIVES][1:]),
    ],
)
def test_turns_are_transposed(name, loop):
    """More turns than a tape has rows, and none, in one vector of cells."""
    found, expected = (
        jax.jit(jax.vmap(DERIVATIVES[name](f), (None, 0, 0)))(A, XS, TURNS) for f in (loop, by_scan)
    )
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-12 * np.abs(b).max())


def test_adjoint_is_machine_code():
    leaves, structure = jax.tree.flatten((A, XS[0], TURNS[0]))
    program, _ = program_of(by_loop, structure, list(map(jax.typeof, leaves)))
    adjoint = program.adjoint((0, 1), (0,))
    assert adjoint is not None and adjoint.compiled is not None


def test_loop_of_a_user_is_differentiated_by_columns():
    """It has no adjoint; reverse mode works as it does for few numbers."""

    @kernel
    def halve(x):
        return lax.while_loop(lambda x: x > 1, lambda x: x / 2, x)

    assert jax.grad(halve)(5.0) == 0.125


def test_unused_results_have_no_part():
    """The root of 0 has an infinite slope, which counts only where the root is used."""

    @kernel
    def root_if(x):
        root = zero_where_unused(lambda x: jnp.sqrt(x), x)
        return jnp.where(x > 0, root, 2 * x)

    np.testing.assert_allclose(jax.vmap(jax.grad(root_if))(jnp.array([0.0, 4.0])), [2, 0.25])


def test_loops_within_derivatives_are_differentiated_by_columns():
    """By a function that makes a derivative of such a loop: it has no adjoint."""

    def slope(f):
        return lambda x: jax.jvp(lambda x: f(A, x, 3), (x,), (jnp.ones(2),))[1].sum()

    found, expected = jax.grad(kernel(slope(by_loop)))(XS[0]), jax.grad(slope(by_scan))(XS[0])
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_faults_are_not_taken_for_a_loop_without_a_transpose():
    @kernel
    def fails(x):
        if reversing.value:
            raise ValueError("a fault of the function")
        return 2 * x

    with pytest.raises(ValueError, match="a fault of the function"):
        jax.grad(fails)(1.0)
