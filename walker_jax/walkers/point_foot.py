"""The walker with masses at its point feet."""

import equinox as eqx
import jax.numpy as jnp

from walker_jax.multibody import System
from walker_jax.walkers.abstract_point_foot import AbstractPointFootWalker, gait_strip
from walker_jax.walkers.masses import MultibodyWalker, gravity, leg, rises_ever_faster
from walker_jax.walkers.model import STEP, Scalar, shown_by
from walker_jax.walkers.parameter_table import FOOT_MASS, SLOPE


class PointFootWalker(AbstractPointFootWalker, MultibodyWalker):
    """A mass at the hip, and one at each foot: the paper's own model before its limit.

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `foot_mass`: beta, the mass of a foot relative to that of the hip, above 0.

    Raises `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)
    foot_mass: Scalar = eqx.field(converter=FOOT_MASS.convert, default=FOOT_MASS.default)

    def past_contact(self, state):
        return rises_ever_faster(self, state)

    def system(self):
        """(1), (5) and (6)."""

        def transfer(q):
            foot, theta, phi = q[:2], q[2], q[3]
            hip = foot + leg(theta)
            return jnp.concatenate([foot, hip, hip - leg(theta - phi)])

        beta, hip = self.foot_mass, jnp.ones_like(self.foot_mass)
        masses = jnp.stack([beta, beta, hip, hip, beta, beta])
        return System(transfer, masses, gravity(self.slope, masses))

    def swing_foot(self, q):
        """(11)."""
        return q[:2] + leg(q[2]) - leg(q[2] - q[3])

    @shown_by(*STEP)
    def gait_region(self):
        return gait_strip(self.slope)
