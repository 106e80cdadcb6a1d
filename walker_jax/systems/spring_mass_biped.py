"""A biped on two massless spring legs, which walks and runs."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

STIFFNESS = Parameter("stiffness", "of a leg", "weight/length", 17.838939857288484)
ANGLE = Parameter("angle", "at which a leg lands, from the ground", "rad", 1.2042771838760873)
ENERGY = Parameter("energy", "of the mass and the legs", "weight length", 1.0397553516819571)


class Biped(NamedTuple):
    """Place of the mass from the stance foot, its velocity, and the front foot; or their rates."""

    x: Any
    y: Any
    vx: Any
    vy: Any
    foot: Any
    """Place of the foot in front, from the one behind, while both are on the ground."""


class SpringMassBiped(HybridSystem):
    """A mass on two spring legs, from one mid-stance to the next, in walking or in running.

    Mass, gravity and the rest length of the legs are 1. A leg in the air is held at `angle` from
    the ground, in front of the mass. It lands where the mass comes down to sin(angle), and leaves
    the ground when it has its rest length again. If it lands before the other leg leaves, both
    stand for a while; otherwise the mass flies. So the same system walks and runs (Geyer, Seyfarth
    and Blickhan 2006, Proceedings of the Royal Society B 273, 2861-2867). By default the parameters
    are those of their walker: 80 kg, 1 m, 14 kN/m, 69 degrees and 816 J at g = 9.81 m/s^2.

    The section is mid-stance, with the mass above the foot of the only leg that stands. Its speed
    forward follows from the `energy`, which is conserved. A stride is `FORWARD` if the mass comes
    down to the ground, `BACKWARD` if it turns back or a leg lifts that has just landed, and
    `RUNNING` if a leg leaves the ground before it is upright. A start is feasible below the leg's
    rest length.
    """

    stiffness: Real = STIFFNESS.field()
    angle: Real = ANGLE.field()
    energy: Real = ENERGY.field()

    section = "height", "climb"

    def lift(self, x):
        zero = jnp.zeros_like(x[0])
        forward = jnp.sqrt(jnp.abs(self.forward_energy(x)))
        return Biped(zero, x[0], forward, x[1], zero)

    def forward_energy(self, x):
        """Return the square of the forward speed at mid-stance."""
        return 2 * (self.energy - x[0]) - self.stiffness * (1 - x[0]) ** 2 - x[1] ** 2

    def project(self, state):
        return jnp.stack([state.y, state.vy])

    def feasible(self, x):
        return super().feasible(x) & (self.margin(x) > 0)

    def margin(self, x):
        inside = jnp.minimum(x[0], 1 - x[0])
        return jnp.minimum(inside, self.forward_energy(x))

    def modes(self):
        behind = lambda y: jnp.sqrt(y.x**2 + y.y**2) - 1
        ahead = lambda y: jnp.sqrt((y.x - y.foot) ** 2 + y.y**2) - 1

        def push(y: Biped, foot: Any) -> tuple[Any, Any]:
            """Return the acceleration by a leg on a foot."""
            length = jnp.sqrt((y.x - foot) ** 2 + y.y**2)
            push = self.stiffness * (1 - length) / length
            return push * (y.x - foot), push * y.y

        def motion(*feet):
            def field(y: Biped) -> Biped:
                pushes = [push(y, foot(y)) for foot in feet]
                along, up = (sum(one, jnp.zeros_like(y.x)) for one in zip(*pushes, strict=True))
                return Biped(y.vx, y.vy, along, up - 1, jnp.zeros_like(y.foot))

            return field

        def fly(y: Biped) -> Biped:
            zero = jnp.zeros_like(y.x)
            return Biped(y.vx, y.vy, zero, zero - 1, zero)

        def energy(*legs):
            def total(y: Biped) -> Any:
                springs = sum((leg(y) ** 2 for leg in legs), jnp.zeros_like(y.x))
                return (y.vx**2 + y.vy**2) / 2 + y.y + self.stiffness * springs / 2

            return total

        one, other = (lambda y: 0 * y.x), (lambda y: y.foot)
        reach, height = jnp.cos(self.angle), jnp.sin(self.angle)
        comes_down = lambda y: height - y.y
        on_both = lambda y: y._replace(foot=y.x + reach)
        on_new = lambda y: y._replace(x=-reach + 0 * y.x, foot=0 * y.foot)
        on_front = lambda y: y._replace(x=y.x - y.foot, foot=0 * y.foot)
        falls = Guard(lambda y: -y.y, "FORWARD")
        back = Guard(lambda y: -y.vx, "BACKWARD")
        # At mid-stance a runner is below that height: it comes down there only after going up.
        lands = Guard(comes_down, "double support", (lambda y: y.x,), reset=on_both)
        takes_off = Guard(behind, "flight", (lambda y: y.vy,))
        lands_again = Guard(comes_down, "before mid-stance", (lambda y: -y.vy,), reset=on_new)
        lifts_behind = Guard(behind, "before mid-stance", reset=on_front)
        lifts_ahead = Guard(ahead, "BACKWARD")
        leaves = Guard(behind, "RUNNING")
        upright = Guard(lambda y: y.x, SECTION)
        single, double = motion(one), motion(one, other)
        return {
            "past mid-stance": Mode(single, (falls, back, lands, takes_off), energy=energy(behind)),
            "double support": Mode(
                double, (falls, back, lifts_ahead, lifts_behind), energy=energy(behind, ahead)
            ),
            "flight": Mode(fly, (falls, lands_again), energy=energy()),
            "before mid-stance": Mode(
                single, (falls, back, leaves, upright), energy=energy(behind)
            ),
        }

    def gait_region(self):
        return Grid.plain(height=(0.6, 1, 40), climb=(-0.4, 0.4, 20))
