"""A block on a spring and a moving belt, which sticks and slips."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter


class Block(NamedTuple):
    """Stretch of the spring and velocity of the block, or their rates."""

    x: Any
    v: Any


class StickSlip(HybridSystem):
    """A block of mass 1 on a spring of stiffness 1 and a belt that moves at a constant speed.

    While the block slips, kinetic friction pulls it towards the speed of the belt:
    x'' = -x + kinetic where it is slower, and x'' = -x - kinetic where it is faster. It sticks
    where it has the belt's speed and static friction holds it, |x| < static. Then it is carried
    along until x = static.

    The section is where the block turns back, x' = 0 and x'' < 0; x is its only coordinate. From
    stick at x = static and slip the block always returns to the same place, so a cycle that sticks
    has the multiplier 0. With d = static - kinetic its period is pi + 2 atan2(speed, d) + 2 d /
    speed. A stride never fails.
    """

    speed: Real = Parameter("speed", "of the belt", "", 0.5).field()
    static: Real = Parameter("static", "largest friction of a block that sticks", "", 1.0).field()
    kinetic: Real = Parameter("kinetic", "friction of a block that slips", "", 0.5).field()

    section = ("x",)

    def lift(self, x):
        return Block(x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return state.x[None]

    def feasible(self, x):
        return super().feasible(x) & (self.margin(x) > 0)

    def margin(self, x):
        return x[0] - self.kinetic

    def modes(self):
        slip = lambda friction: lambda y: Block(y.v, friction - y.x)
        carried = lambda y: Block(self.speed + 0 * y.v, 0 * y.v)
        faster, slower = lambda y: y.v - self.speed, lambda y: self.speed - y.v
        held = lambda y: self.static**2 - y.x**2
        stretched = lambda y: y.x - self.static
        turns = Guard(lambda y: -y.v, SECTION)
        at_speed = lambda y: y._replace(v=self.speed + 0 * y.v)
        sticks = lambda value: Guard(value, "stick", (held,), reset=at_speed)
        breaks = (lambda y: -held(y),)
        return {
            "slower": Mode(
                slip(self.kinetic), (turns, sticks(faster), Guard(faster, "faster", breaks))
            ),
            "stick": Mode(carried, (Guard(stretched, "slower"),)),
            "faster": Mode(slip(-self.kinetic), (sticks(slower), Guard(slower, "slower", breaks))),
        }

    def gait_region(self):
        top = float(self.kinetic + jnp.hypot(self.static - self.kinetic, self.speed))
        return Grid.plain(x=(float(self.kinetic), 2 * top, 60))
