"""Angles of a section, without full turns."""

import jax.numpy as jnp
import numpy as np

from walker_jax.integrators.roots import Scalar


def wrap(angle: Scalar) -> Scalar:
    """Return the same angle (rad) between -pi and pi; the derivative is 1."""
    return angle - 2 * np.pi * jnp.round(angle / (2 * np.pi))
