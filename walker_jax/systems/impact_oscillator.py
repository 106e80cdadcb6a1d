"""A forced oscillator that hits a rigid stop."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import wrap
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

LONGEST = 100.0
"""Time without an impact after which the oscillator has `STOPPED` hitting the stop."""
RESTING = 1e-6
"""Speed after an impact below which the oscillator comes to rest, by ever faster impacts."""


class Motion(NamedTuple):
    """Position, velocity, phase of the force, and time since an impact; or their rates."""

    x: Any
    v: Any
    phase: Any
    time: Any


class ImpactOscillator(HybridSystem):
    """x'' + 2 damping x' + x = cos(frequency t) for x < stop, v -> -restitution v at x = stop.

    A stride leads from just after one impact to the next; the angle is frequency t, and v is
    negative. An oscillator that comes to rest on the stop is `OUTSIDE`. Shaw and Holmes (1983,
    Journal of Sound and Vibration 90, 129-155).
    """

    frequency: Real = Parameter("frequency", "of the force", "", 2.5).field()
    stop: Real = Parameter("stop", "place of the stop", "", 0.0, -np.inf).field()
    restitution: Real = Parameter("restitution", "at an impact", "", 0.8, 0, 1).field()
    damping: Real = Parameter("damping", "of the rate", "", 0.0, 0, 1, closed=True).field()

    section, angles = ("angle", "v"), ("angle",)

    def lift(self, x):
        return Motion(self.stop + 0 * x[0], x[1], x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([wrap(state.phase), state.v])

    def feasible(self, x):
        return self.margin(x) > 0

    def margin(self, x):
        return -x[1] - RESTING

    def modes(self):
        def field(y: Motion) -> Motion:
            one = jnp.ones_like(y.time)
            pull = jnp.cos(y.phase) - 2 * self.damping * y.v - y.x
            return Motion(y.v, pull, self.frequency * one, one)

        back = lambda y: y._replace(v=-self.restitution * y.v)
        hits = Guard(lambda y: y.x - self.stop, SECTION, reset=back)
        waits = Guard(lambda y: y.time - LONGEST, "STOPPED")
        return {"free": Mode(field, (waits, hits))}

    def gait_region(self):
        return Grid.plain(angle=(-np.pi, np.pi, 40), v=(-2, 0, 40))
