"""Duffing's oscillator with two wells, observed once per period of the force."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter


class Forced(NamedTuple):
    """Position, velocity, and time since the start of a period; or their rates."""

    x: Any
    v: Any
    time: Any


class DuffingOscillator(HybridSystem):
    """x'' + damping x' - x + x^3 = force cos(frequency t), observed once per period of the force.

    Guckenheimer and Holmes (1983), Nonlinear Oscillations, section 2.2. A stride never fails.
    """

    damping: Real = Parameter("damping", "of the rate", "", 0.15, closed=True).field()
    force: Real = Parameter("force", "amplitude of the force", "", 0.245, -np.inf).field()
    frequency: Real = Parameter("frequency", "of the force", "", 1.0).field()

    section = ("x", "v")

    def lift(self, x):
        return Forced(x[0], x[1], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([state.x, state.v])

    def modes(self):
        def field(y: Forced) -> Forced:
            push = self.force * jnp.cos(self.frequency * y.time)
            return Forced(y.v, y.x - y.x**3 - self.damping * y.v + push, jnp.ones_like(y.time))

        period = Guard(lambda y: self.frequency * y.time - 2 * np.pi, SECTION)
        return {"period": Mode(field, (period,))}

    def gait_region(self):
        return Grid.plain(x=(-2, 2, 40), v=(-2, 2, 40))
