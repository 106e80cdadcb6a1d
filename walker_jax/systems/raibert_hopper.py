"""A hopper with a motor in series with its spring, controlled as Raibert's machines were."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

STIFFNESS = Parameter("stiffness", "of the leg", "weight/length", 25.0)
DAMPING = Parameter("damping", "of the leg", "mass/time", 0.8, closed=True)
THRUST = Parameter("thrust", "by which the motor lengthens the leg", "length", 0.06)
RATE = Parameter("thrust_rate", "at which the motor lengthens the leg", "length/time", 1.0)
STANCE = Parameter("stance_time", "that places the foot", "time", 0.7, closed=True)
GAIN = Parameter("gain", "of the speed's error, that places the foot", "time", 0.1, -np.inf)
DESIRED = Parameter("desired_speed", "forward", "length/time", 1.0, -np.inf)


class Hopper(NamedTuple):
    """Place of the mass from the foot or apex, its velocity, and the motor's length; or rates."""

    x: Any
    y: Any
    vx: Any
    vy: Any
    length: Any


class RaibertHopper(HybridSystem):
    """A mass that hops on a massless leg, from one apex to the next.

    Mass, gravity and the leg's rest length are 1. The foot lands ahead of the mass by
    speed stance_time / 2 + gain (speed - desired_speed). The leg is a spring with a damper, in
    series with a motor. From the time at which the leg is shortest, the motor lengthens by `thrust`
    at `thrust_rate`. The foot leaves the ground where its force vanishes, perhaps before the motor
    has stopped. In flight the motor returns (Raibert, Brown and Chepponis 1984, International
    Journal of Robotics Research 3(2), 75-92; Raibert 1986, Legged Robots That Balance).

    A stride is `FORWARD` if the mass comes down to the ground, and `STOPPED` if the leg shortens
    again, or the mass moves downward as the foot leaves. A start is feasible above the height of
    landing.
    """

    stiffness: Real = STIFFNESS.field()
    damping: Real = DAMPING.field()
    thrust: Real = THRUST.field()
    thrust_rate: Real = RATE.field()
    stance_time: Real = STANCE.field()
    gain: Real = GAIN.field()
    desired_speed: Real = DESIRED.field()

    section = "apex", "speed"

    def lift(self, x):
        zero = jnp.zeros_like(x[0])
        return Hopper(zero, x[0], x[1], zero, zero)

    def project(self, state):
        return jnp.stack([state.y, state.vx])

    def step(self, speed: Any) -> Any:
        """Return the distance by which the foot lands ahead of the mass."""
        return speed * self.stance_time / 2 + self.gain * (speed - self.desired_speed)

    def feasible(self, x):
        return super().feasible(x) & (self.margin(x) > 0)

    def margin(self, x):
        height = 1 - self.step(x[1]) ** 2  # squared, at which the leg lands
        return jnp.minimum(jnp.minimum(x[0], height), x[0] ** 2 - height)

    def modes(self):
        leg = lambda y: jnp.sqrt(y.x**2 + y.y**2)
        rate = lambda y: (y.x * y.vx + y.y * y.vy) / leg(y)
        force = lambda y: self.stiffness * (1 + y.length - leg(y)) - self.damping * rate(y)

        def fly(y: Hopper) -> Hopper:
            zero = jnp.zeros_like(y.x)
            return Hopper(y.vx, y.vy, zero, zero - 1, zero)

        def stand(motor: Any):
            def field(y: Hopper) -> Hopper:
                push = force(y) / leg(y)
                return Hopper(y.vx, y.vy, push * y.x, push * y.y - 1, motor + 0 * y.length)

            return field

        def energy(y: Hopper) -> Any:
            return (y.vx**2 + y.vy**2) / 2 + y.y

        def with_spring(y: Hopper) -> Any:
            return energy(y) + self.stiffness * (1 + y.length - leg(y)) ** 2 / 2

        height = lambda y: jnp.sqrt(1 - self.step(y.vx) ** 2)
        put_down = lambda y: y._replace(x=-self.step(y.vx))
        returns = lambda y: y._replace(length=0 * y.length)
        lands = Guard(lambda y: height(y) - y.y, "compression", reset=put_down)
        falls = Guard(lambda y: -y.y, "FORWARD")
        shortest = Guard(rate, "thrust")
        shortens = Guard(lambda y: -rate(y), "STOPPED")
        sinks = Guard(lambda y: -force(y), "STOPPED", (lambda y: -y.vy,))
        leaves = Guard(lambda y: -force(y), "rise", (lambda y: y.vy,), reset=returns)
        is_long = Guard(lambda y: y.length - self.thrust, "extension")
        still, drive = stand(0), stand(self.thrust_rate)
        return {
            "fall": Mode(fly, (lands,), energy=energy),
            "compression": Mode(still, (falls, shortest), energy=with_spring),
            "thrust": Mode(drive, (falls, shortens, sinks, leaves, is_long), energy=with_spring),
            "extension": Mode(still, (falls, shortens, sinks, leaves), energy=with_spring),
            "rise": Mode(fly, (Guard(lambda y: -y.vy, SECTION),), energy=energy),
        }

    def gait_region(self):
        speed = float(self.desired_speed)
        return Grid.plain(apex=(1, 2, 8), speed=(speed - 0.6, speed + 0.4, 8))
