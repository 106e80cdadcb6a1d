"""Functions that define some of JAX's primitives by products, and by operations on pairs."""

import operator
from collections.abc import Callable
from functools import reduce

import jax.numpy as jnp
from jax import lax


def by_squaring(x, y: int):
    """Return x^y for an integer y >= 0."""
    if y < 2:
        return x if y else jnp.ones_like(x)
    half = by_squaring(x, y // 2)
    return half * half * x if y % 2 else half * half


def cumulative_product(x, axis: int, reverse: bool):
    return lax.associative_scan(lax.mul, x, axis=axis, reverse=reverse)


def reduce_product(x, axes, **_):
    rows = jnp.moveaxis(x, axes, range(len(axes)))
    rows = rows.reshape(-1, *rows.shape[len(axes) :])
    return reduce(operator.mul, rows, jnp.ones_like(x, shape=rows.shape[1:]))


def reduce_by(operation: Callable) -> Callable:
    """Return the largest or the least entry along axes, pair by pair."""

    def reduce_pairs(x, axes, **_):
        rows = jnp.moveaxis(x, axes, range(len(axes)))
        return reduce(operation, rows.reshape(-1, *rows.shape[len(axes) :]))

    return reduce_pairs
