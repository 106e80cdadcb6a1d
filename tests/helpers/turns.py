"""A function, and its cells by a loop or unrolled."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from walker_jax.kernels import kernel

TURNS = 2


def turn(a, x, y):
    return y * a - jnp.sin(y) * x[0] + x[1] ** 2 * 0.1


def turns(x):
    return jnp.where(x[0] > 0.3, TURNS, TURNS - 1)


def results(a, x, y, count):
    return jnp.stack([y, x[0] * a]), y * x[1], count, y > 0.5


@kernel
def by_loop(a, x):
    """A vector, a number, an integer and a truth value of a number and a vector."""
    going = lambda carry: carry[1] < turns(x)
    advance = lambda carry: (turn(a, x, carry[0]), carry[1] + 1)
    return results(a, x, *lax.while_loop(going, advance, (x[0] + x[1], jnp.asarray(0))))


def unrolled(a, x):
    """The same of JAX alone, in whose derivatives no loop is."""
    y = x[0] + x[1]
    for k in range(TURNS):
        y = jnp.where(k < turns(x), turn(a, x, y), y)
    return results(a, x, y, turns(x))


A, X = jnp.asarray(0.9), jnp.asarray([0.35, 0.4])
RNG = np.random.default_rng(0)
AS, XS = jnp.asarray(RNG.random(7)), jnp.asarray(RNG.random((9, 2)))
BOTH = 0, 1
MANY = jnp.asarray(RNG.normal(size=(3, 500, 2)))


def real(function):
    return lambda a, x: function(a, x)[:2]


def number(function):
    """One number, in which all real results have a part."""

    def single(a, x):
        y, z = function(a, x)[:2]
        return jnp.sum(y**2) * z + y[1]

    return single


def assert_same(found, expected, rtol=1e-12, atol=1e-13):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)
