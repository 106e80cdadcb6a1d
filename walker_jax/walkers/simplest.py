"""The simplest walking model."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.walkers.abstract_point_foot import (
    AbstractMasslessFootWalker,
    gait_strip,
    rises_past_contact,
)
from walker_jax.walkers.model import DRIVE, STEP, Scalar, State, moves_like, shown_by
from walker_jax.walkers.parameter_table import SLOPE


class SimplestWalker(AbstractMasslessFootWalker):
    """The simplest walking model: a mass at the hip, and feet of vanishing mass.

    Garcia, Chatterjee, Ruina and Coleman (1998); Schwab and Wisse (2001).

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2. Raises `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        return True

    @shown_by(*STEP)
    def gait_region(self):
        return gait_strip(self.slope)

    def basin_region(self, gait):
        if not moves_like(self, SimplestWalker):
            return super().basin_region(gait)
        return Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))

    def past_contact(self, state):
        return rises_past_contact(self, state)

    def vector_field(self, state):
        """(7): thetaddot = sin(theta - slope), an inverted pendulum that the swing leg follows."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) + thetaddot
        return State(thetadot, phidot, thetaddot, phiddot)
