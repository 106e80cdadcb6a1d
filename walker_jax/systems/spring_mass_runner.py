"""A runner on a massless spring leg: the spring-loaded inverted pendulum."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

STIFFNESS = Parameter("stiffness", "of the leg", "weight/length", 25.4841997961264)
ANGLE = Parameter("angle", "of the leg from the ground, in flight", "rad", 1.1868238913561442)
ENERGY = Parameter("energy", "at an apex", "weight length", 2.27420998980632)
RETRACTION = Parameter("retraction", "rate of the angle", "rad/unit of time", 0.0, -np.inf)


class Point(NamedTuple):
    """Place of the mass from the foot or apex, its velocity, and time since the apex; or rates."""

    x: Any
    y: Any
    vx: Any
    vy: Any
    time: Any


class SpringMassRunner(HybridSystem):
    """A runner from the apex of one flight to the next; the apex height is the only coordinate.

    Mass, gravity and the leg's rest length are 1. In flight the leg is held at `angle` from the
    ground, which grows at the rate `retraction` from the apex on (Seyfarth, Geyer and Herr 2003,
    Journal of Experimental Biology 206, 2547-2555). `energy` is conserved: it is the same at every
    apex (Geyer, Seyfarth and Blickhan 2005, Journal of Theoretical Biology 232, 315-328).

    A stride is `FORWARD` if the mass reaches the ground, `BACKWARD` if it moves backward at
    lift-off, `STOPPED` if it moves downward there, and `OUTSIDE` below the height of touchdown,
    where no flight ends on a straight leg.
    """

    stiffness: Real = STIFFNESS.field()
    angle: Real = ANGLE.field()
    energy: Real = ENERGY.field()
    retraction: Real = RETRACTION.field()

    section = ("apex",)

    def lift(self, x):
        zero = jnp.zeros_like(x[0])
        return Point(zero, x[0], jnp.sqrt(2 * jnp.abs(self.energy - x[0])), zero, zero)

    def project(self, state):
        return state.y[None]

    def feasible(self, x):
        return (x[0] >= jnp.sin(self.angle)) & (x[0] < self.energy)

    def margin(self, x):
        return jnp.minimum(x[0] - jnp.sin(self.angle), self.energy - x[0])

    def modes(self):
        leg = lambda y: jnp.sqrt(y.x**2 + y.y**2)
        straight = lambda y: leg(y) - 1
        direction = lambda y: self.angle + self.retraction * y.time

        def fly(y: Point) -> Point:
            zero, one = jnp.zeros_like(y.time), jnp.ones_like(y.time)
            return Point(y.vx, y.vy, zero, -one, one)

        def bounce(y: Point) -> Point:
            pull = self.stiffness * (1 - leg(y)) / leg(y)
            return Point(y.vx, y.vy, pull * y.x, pull * y.y - 1, jnp.ones_like(y.time))

        def energy(y: Point) -> Any:
            return (y.vx**2 + y.vy**2) / 2 + y.y

        def with_spring(y: Point) -> Any:
            return energy(y) + self.stiffness * straight(y) ** 2 / 2

        touch = lambda y: y._replace(x=-jnp.cos(direction(y)))
        lands = Guard(lambda y: jnp.sin(direction(y)) - y.y, "stance", reset=touch)
        crashes = Guard(lambda y: -y.y, "FORWARD")
        backward = Guard(straight, "BACKWARD", (lambda y: -y.vx, lambda y: y.vy))
        downward = Guard(straight, "STOPPED", (lambda y: -y.vy,))
        leaves = Guard(straight, "rise", (lambda y: y.vx, lambda y: y.vy))
        return {
            "fall": Mode(fly, (lands,), energy=energy),
            "stance": Mode(bounce, (crashes, backward, downward, leaves), energy=with_spring),
            "rise": Mode(fly, (Guard(lambda y: -y.vy, SECTION),), energy=energy),
        }

    def gait_region(self):
        return Grid.plain(apex=(0, 2.3, 200))
