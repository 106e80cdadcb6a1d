"""Angles of a section, of which full turns make no difference.

A section is cut open where its angles jump, as from pi to -pi. Two points on both sides of the cut
are near each other, so points are compared after one is turned towards the other.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.integrators.roots import Scalar
from walker_jax.systems.system import System

NEAR = 1e-3
"""Distance (rad) far below a full turn, and above rounding errors in float32."""

Turns = Float[np.ndarray, " section"] | None
"""A full turn of each coordinate: 2 pi for an angle, 0 for others; None if there are no angles."""


def wrap(angle: Scalar) -> Scalar:
    """Return the same angle (rad) between -pi and pi; the derivative is 1."""
    return angle - 2 * np.pi * jnp.round(angle / (2 * np.pi))


def turns_of(system: System) -> Turns:
    """Return a full turn of each coordinate of a system's section."""
    if not system.angles:
        return None
    return np.array([2 * np.pi if name in system.angles else 0.0 for name in system.section])


def turn_to(x: Any, near: Any, turns: Turns) -> Any:
    """Return points x, shape (..., section), with angles within half a turn of those of others."""
    if turns is None:
        return x
    return x - turns.astype(x.dtype) * ((x - near) / (2 * np.pi)).round()


def difference(x: Any, other: Any, turns: Turns) -> Any:
    """Return x - other for points of the section; angles differ by at most half a turn."""
    return turn_to(x, other, turns) - other


def takes_turns_off(function: Callable, x: Float[Array, " section"]) -> Bool[Array, " section"]:
    """Return whether a function takes full turns off each coordinate, as off an angle."""
    again = jax.vmap(function)
    turned = again(x[None] + 2 * np.pi * jnp.eye(len(x), dtype=x.dtype))
    return jnp.all(jnp.abs(turned - again(x[None])) < NEAR, axis=1)
