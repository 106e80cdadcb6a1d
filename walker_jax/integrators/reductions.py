"""Largest entries, where some may be NaN."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def largest(
    values: Float[Array, "..."], axis: int | tuple[int, ...] | None = None
) -> Float[Array, "..."]:
    """Return the largest entry along axes, NaN if one is NaN, as `jnp.max` should.

    On a CPU `jnp.max` over each of thousands of rows loses NaN (jax 0.10.2), and is -inf if all
    entries are. Sums, `jnp.any` and `jnp.argmax` lose none.
    """
    if values.ndim == 0:
        return values
    return jnp.where(jnp.any(jnp.isnan(values), axis), jnp.nan, jnp.max(values, axis))
