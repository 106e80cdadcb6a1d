"""Directions of a derivative that are computed at once.

A derivative along several directions is one program, in which `jax.vmap` maps over them under a
named axis. What all share, such as the steps of an integration, must not depend on one of them.
"""

import contextlib
from collections.abc import Iterator

import jax
from jax import lax

axes = jax.make_user_context(())
"""Names of the axes of directions over which a derivative is being mapped."""


@contextlib.contextmanager
def mapped_directions(name: str) -> Iterator[None]:
    """Name an axis of directions while derivatives are traced within `jax.vmap` over it."""
    with axes((*axes.value, name)):
        yield


def least_over_directions(x: jax.Array) -> jax.Array:
    """Return the least of a number's values for all directions; constant to derivatives."""
    for name in axes.value:
        x = lax.pmin(lax.stop_gradient(x), name)
    return x
