"""The simplest walker with a spring in its hip."""

import equinox as eqx
import jax.numpy as jnp

from walker_jax.walkers.abstract_point_foot import (
    AbstractMasslessFootWalker,
    gait_strip,
    rises_past_contact,
)
from walker_jax.walkers.model import DRIVE, STEP, Scalar, State, shown_by
from walker_jax.walkers.parameter_table import HIP_STIFFNESS, SLOPE


class SpringWalker(AbstractMasslessFootWalker):
    """The simplest walker with a torsional spring between its legs, slack when they are parallel.

    A spring of stiffness K exerts the torque -K phi on the swing leg, and the opposite one on the
    stance leg. In the limit of vanishing foot mass m it acts on the swing leg alone, provided that
    K vanishes in proportion: with K = m g l hip_stiffness, (4) divided by m has the limit
    phiddot = sin(phi) (thetadot^2 - cos(theta - slope)) + sin(theta - slope) - hip_stiffness phi.
    The leg then swings like a pendulum whose gravity is larger by a factor 1 + hip_stiffness. The
    spring exerts no impulse, so impact and contact force are as without it. Such a spring makes
    steps shorter and faster (Kuo 2002, J. Biomech. Eng. 124:113-120).

    **Arguments:**

    - `slope`: of the ground (rad), above 0 and below pi/2.
    - `hip_stiffness`: K / (m g l), not negative.

    Raises `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=SLOPE.convert)
    hip_stiffness: Scalar = eqx.field(
        converter=HIP_STIFFNESS.convert, default=HIP_STIFFNESS.default
    )

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        return True

    @shown_by(*STEP)
    def gait_region(self):
        return gait_strip(self.slope, self.hip_stiffness)

    def past_contact(self, state):
        return rises_past_contact(self, state)

    def vector_field(self, state):
        """(7), and the spring."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) + thetaddot
        return State(thetadot, phidot, thetaddot, phiddot - self.hip_stiffness * phi)
