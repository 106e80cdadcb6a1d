"""Angles of a section, which count no turns."""

import jax.numpy as jnp
import numpy as np

from walker_jax.integrators.roots import Scalar


def wrap(angle: Scalar) -> Scalar:
    """The same angle (rad) between -pi and pi; its derivative is 1."""
    return angle - 2 * np.pi * jnp.round(angle / (2 * np.pi))
