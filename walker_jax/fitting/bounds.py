"""Bounds of parameters, kept by a change of variables, so that the search itself has none."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

AT_BOUND = 1e-6
"""A value is at its bound where it moves so little with the variable of the search, relative to
half the distance of two bounds."""


class Bounds(NamedTuple):
    """Ends of intervals, infinite for none."""

    low: Float[Any, " parameters"]
    high: Float[Any, " parameters"]


@jax.jit
def from_free(u: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return values within their bounds from any real numbers.

    u without bounds, low - 1 + sqrt(1 + u^2) above one, high + 1 - sqrt(1 + u^2) below one, and
    low + (high - low) (1 + sin u) / 2 between two: nowhere so flat that a search is lost there
    (James and Roos 1975, Computer Physics Communications 10, 343-367).
    """
    low, high, has_low, has_high = known(bounds)
    above = jnp.sqrt(1 + u**2) - 1
    value = jnp.where(has_low, low + above, jnp.where(has_high, high - above, u))
    return jnp.where(has_low & has_high, low + (high - low) * (1 + jnp.sin(u)) / 2, value)


@jax.jit
def slopes(u: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return the derivatives of `from_free`, each by its own number."""
    return jax.jvp(lambda at: from_free(at, bounds), (u,), (jnp.ones_like(u),))[1]


def moving(
    u: Float[Array, " parameters"], bounds: Bounds
) -> tuple[Float[np.ndarray, " parameters"], Bool[np.ndarray, " parameters"]]:
    """Return the slopes, 1 at bounds, and whether each value is away from its bounds."""
    rates = np.asarray(slopes(u, bounds))
    both = np.isfinite(bounds.low) & np.isfinite(bounds.high)
    with np.errstate(invalid="ignore"):
        widths = np.where(both, np.subtract(bounds.high, bounds.low) / 2, 1.0)
    away = np.abs(rates) > AT_BOUND * widths
    return np.where(away, rates, 1.0), away


@jax.jit
def to_free(values: Float[Array, " parameters"], bounds: Bounds) -> Float[Array, " parameters"]:
    """Return the inverse of `from_free`."""
    low, high, has_low, has_high = known(bounds)
    above = jnp.where(has_low, values - low, jnp.where(has_high, high - values, 0))
    u = jnp.where(has_low | has_high, jnp.sqrt(above * (above + 2)), values)
    share = jnp.where(has_low & has_high, (values - low) / (high - low), 0.5)
    return jnp.where(has_low & has_high, jnp.arcsin(2 * share - 1), u)


def known(bounds: Bounds) -> tuple[Any, Any, Any, Any]:
    """Return bounds as finite numbers, and where there are any."""
    has_low, has_high = jnp.isfinite(bounds.low), jnp.isfinite(bounds.high)
    low, high = jnp.where(has_low, bounds.low, 0), jnp.where(has_high, bounds.high, 1)
    return low, high, has_low, has_high
