"""A ball that bounces on a table that vibrates."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import wrap
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

AMPLITUDE = Parameter("amplitude", "of the table's acceleration", "g", 0.5, closed=True)
RESTITUTION = Parameter("restitution", "at an impact", "", 0.8, high=1)
RESTING = 1e-6
"""Speed away from the table below which a ball sticks to it."""


class Flight(NamedTuple):
    """Height and velocity of a ball, and the phase of the table; or their rates."""

    height: Any
    velocity: Any
    phase: Any


class BouncingBall(HybridSystem):
    """A ball over a table at amplitude sin(phase), from just after one impact to the next.

    The section's `angle` is that phase. The unit of time is 1 / angular frequency of the table.
    Gravity is 1, so the amplitude is the table's largest acceleration in units of gravity. An
    impact multiplies the relative velocity by -restitution. A ball that sticks to the table is
    `OUTSIDE`. The equations are the full ones of Luo and Han (1996, Nonlinear Dynamics 10, 1-18),
    without the approximation for high bounces.
    """

    amplitude: Real = AMPLITUDE.field()
    restitution: Real = RESTITUTION.field()

    section, angles = ("angle", "velocity"), ("angle",)

    def table(self, phase):
        """Return the table's height and velocity."""
        return self.amplitude * jnp.sin(phase), self.amplitude * jnp.cos(phase)

    def lift(self, x):
        return Flight(self.table(x[0])[0], x[1], x[0])

    def project(self, state):
        return jnp.stack([wrap(state.phase), state.velocity])

    def feasible(self, x):
        return self.margin(x) > 0

    def margin(self, x):
        return x[1] - self.table(x[0])[1] - RESTING

    def modes(self):
        field = lambda y: Flight(y.velocity, -jnp.ones_like(y.phase), jnp.ones_like(y.phase))

        def bounce(y: Flight) -> Flight:
            _, moving = self.table(y.phase)
            return y._replace(velocity=moving - self.restitution * (y.velocity - moving))

        lands = Guard(lambda y: self.table(y.phase)[0] - y.height, SECTION, reset=bounce)
        return {"flight": Mode(field, (lands,))}

    def gait_region(self):
        return Grid.plain(angle=(-np.pi, np.pi, 30), velocity=(0, 6, 30))
