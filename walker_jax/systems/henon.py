"""The map of Hénon (1976, Communications in Mathematical Physics 50, 69-77)."""

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.integrators.roots import Real
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.parameter import Parameter
from walker_jax.systems.system import System

FARTHEST = 10.0
"""Distance from the origin beyond which a point has escaped: it never comes back."""


class HenonMap(System):
    """x' = 1 - a x^2 + y, y' = b x; points that escape to infinity are `OUTSIDE`."""

    a: Real = Parameter("a", "of the square", "", 1.4, -np.inf).field()
    b: Real = Parameter("b", "by which areas shrink", "", 0.3, -np.inf).field()

    section = ("x", "y")

    def advance(self, x):
        return jnp.stack([1 - self.a * x[0] ** 2 + x[1], self.b * x[0]]), Outcome.STRIDE, 1.0

    def feasible(self, x):
        return self.margin(x) > 0

    def margin(self, x):
        return FARTHEST**2 - jnp.sum(x**2)

    def gait_region(self):
        return Grid.plain(x=(-2, 2, 100), y=(-2, 2, 100))
