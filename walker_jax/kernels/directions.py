"""Directions of a derivative that are computed at once.

A derivative along several directions is one program, in which `jax.vmap` maps over them. What all
share, such as the steps of an integration, must not depend on one of them.
"""

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool

axes_of_directions = jax.make_user_context(0)
"""Number of axes over which derivatives are being mapped; cells are never mapped within these."""


def holds_along_all(condition: Bool[Array, ""], axes: int) -> Bool[Array, ""]:
    """Return whether a condition holds along the directions of all axes, each of which it feels."""
    for _ in range(axes):  # the innermost axis first
        condition = holds_in_all(condition)
    return condition


@custom_vmap
def holds_in_all(condition: Bool[Array, ""]) -> Bool[Array, ""]:
    """Return the condition; under `jax.vmap`, whether it holds in all elements."""
    return condition


@holds_in_all.def_vmap
def reduce_axis(axis_size, in_batched, condition):
    return jnp.all(condition, axis=0), False
