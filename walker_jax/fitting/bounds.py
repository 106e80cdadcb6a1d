"""Bounds of parameters, kept by a change of variables, so that the search itself has none."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Bounds(NamedTuple):
    """Ends of intervals, infinite for none."""

    low: Float[Any, " parameters"]
    high: Float[Any, " parameters"]


@jax.jit
def from_free(u: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return values within their bounds from any real numbers.

    u without bounds, low + exp(u) above one, high - exp(u) below one, and
    low + (high - low) / (1 + exp(-u)) between two.
    """
    low, high, has_low, has_high = known(bounds)
    grown = jnp.exp(jnp.where(has_low ^ has_high, u, 0))
    value = jnp.where(has_low, low + grown, jnp.where(has_high, high - grown, u))
    return jnp.where(has_low & has_high, low + (high - low) * jax.nn.sigmoid(u), value)


@jax.jit
def slopes(u: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return the derivatives of `from_free`, each by its own number."""
    return jax.jvp(lambda at: from_free(at, bounds), (u,), (jnp.ones_like(u),))[1]


@jax.jit
def to_free(values: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return the inverse of `from_free`."""
    low, high, has_low, has_high = known(bounds)
    one = jnp.ones_like(low)
    above, below = jnp.where(has_low, values - low, one), jnp.where(has_high, high - values, one)
    u = jnp.where(has_low, jnp.log(above), jnp.where(has_high, jnp.log(below), values))
    return jnp.where(has_low & has_high, jnp.log(above) - jnp.log(below), u)


def known(bounds: Bounds) -> tuple[Any, Any, Any, Any]:
    """Return bounds as finite numbers, and where there are any."""
    has_low, has_high = jnp.isfinite(bounds.low), jnp.isfinite(bounds.high)
    low, high = jnp.where(has_low, bounds.low, 0), jnp.where(has_high, bounds.high, 1)
    return low, high, has_low, has_high
