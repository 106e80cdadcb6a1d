"""A quadruped of one body on two springy pairs of legs, which bounds and pronks."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter

STIFFNESS = Parameter("stiffness", "of a pair of legs", "weight/length", 11.0)
INERTIA = Parameter("inertia", "of the body, about its centre", "mass length^2", 0.6)
HIPS = Parameter("hips", "distance of the hips from the centre", "length", 0.85)
REAR = Parameter("rear_angle", "of the rear legs from the ground as they land", "rad", 1.0)
FRONT = Parameter("front_angle", "of the front legs from the ground as they land", "rad", 1.02)
ENERGY = Parameter("energy", "of the body and the legs", "weight length", 3.5)


class Body(NamedTuple):
    """Place of the centre from the apex, pitch, their rates, and the feet; or their rates."""

    x: Any
    y: Any
    pitch: Any
    """Angle of the body from level, positive with the front up."""
    vx: Any
    vy: Any
    rate: Any
    rear: Any
    """Place of the rear feet from the apex, once they have landed."""
    front: Any


class BoundingQuadruped(HybridSystem):
    """A body on two pairs of massless spring legs, from one apex to the next, in the plane.

    Mass, gravity and the rest length of the legs are 1. Each pair is held at its angle in the air,
    lands once, and leaves the ground once, when it has its rest length again. They do so in any
    order, with both pairs on the ground or none in between: if the rear lands first, that is a
    bound; if both land at once, a pronk (Poulakakis, Papadopoulos and Buehler 2006, International
    Journal of Robotics Research 25, 669-687).

    The section is the highest point of the centre in the flight after both pairs have left the
    ground. Its forward speed follows from the `energy`, which is conserved. A stride is `FORWARD`
    if a hip comes down to the ground, and `BACKWARD` if the centre stops moving forward on the
    ground. A start is feasible with all feet above the ground.
    """

    stiffness: Real = STIFFNESS.field()
    inertia: Real = INERTIA.field()
    hips: Real = HIPS.field()
    rear_angle: Real = REAR.field()
    front_angle: Real = FRONT.field()
    energy: Real = ENERGY.field()

    section = "height", "pitch_rate", "pitch"

    def lift(self, x):
        zero, forward = jnp.zeros_like(x[0]), jnp.sqrt(jnp.abs(self.forward_energy(x)))
        return Body(zero, x[0], x[2], forward, zero, x[1], zero, zero)

    def forward_energy(self, x):
        """Return the square of the speed at the apex."""
        return 2 * (self.energy - x[0]) - self.inertia * x[1] ** 2

    def project(self, state):
        return jnp.stack([state.y, state.rate, state.pitch])

    def feasible(self, x):
        return super().feasible(x) & (self.margin(x) > 0)

    def margin(self, x):
        state = self.lift(x)
        feet = [self.hip(state, s)[1] - jnp.sin(self.angle(s)) for s in (-1, 1)]
        return jnp.minimum(jnp.minimum(*feet), self.forward_energy(x))

    def angle(self, side: int) -> Any:
        """Return the angle of landing of the rear pair, of `side` -1, or the front pair, 1."""
        return self.rear_angle if side < 0 else self.front_angle

    def hip(self, y: Body, side: int) -> tuple[Any, Any]:
        """Return the place of the rear hip, of `side` -1, or the front hip, 1."""
        along = side * self.hips
        return y.x + along * jnp.cos(y.pitch), y.y + along * jnp.sin(y.pitch)

    def leg(self, y: Body, side: int) -> tuple[Any, Any, Any]:
        """Return the vector from the feet of a pair to its hip, and its length."""
        x, up = self.hip(y, side)
        along = x - (y.rear if side < 0 else y.front)
        return along, up, jnp.sqrt(along**2 + up**2)

    def modes(self):
        return {
            name: self.mode(rear, front)
            for rear, others in enumerate(NAMES)
            for front, name in enumerate(others)
        }

    def mode(self, rear: int, front: int) -> Mode:
        """Return the mode in which pairs have yet to land (0), stand (1), or have left (2)."""
        stages = {-1: rear, 1: front}
        standing = [side for side, stage in stages.items() if stage == 1]
        stretch = lambda side: lambda y: self.leg(y, side)[2] - 1
        toes = lambda side: lambda y: jnp.sin(self.angle(side)) - self.hip(y, side)[1]

        def field(y: Body) -> Body:
            zero = jnp.zeros_like(y.x)
            along, up, turn = zero, zero - 1, zero
            for side in standing:
                ahead, above, length = self.leg(y, side)
                push = self.stiffness * (1 / length - 1)
                along, up = along + push * ahead, up + push * above
                lever = side * self.hips
                turn += lever * push * (above * jnp.cos(y.pitch) - ahead * jnp.sin(y.pitch))
            return Body(y.vx, y.vy, y.rate, along, up, turn / self.inertia, zero, zero)

        def energy(y: Body) -> Any:
            motion = (y.vx**2 + y.vy**2 + self.inertia * y.rate**2) / 2 + y.y
            return motion + sum(self.stiffness * stretch(side)(y) ** 2 / 2 for side in standing)

        def land(side: int):
            def reset(y: Body) -> Body:
                foot = self.hip(y, side)[0] + jnp.cos(self.angle(side))
                return y._replace(rear=foot) if side < 0 else y._replace(front=foot)

            return reset

        # Feet that have yet to land do so before their hip.
        landed = [side for side, stage in stages.items() if stage > 0]
        guards = [Guard(lambda y, s=s: -self.hip(y, s)[1], "FORWARD") for s in landed]
        guards += [Guard(lambda y: -y.vx, "BACKWARD")] if standing else []
        for side, stage in stages.items():
            after = NAMES[rear + (side < 0)][front + (side > 0)] if stage < 2 else ""
            if stage == 0:
                guards.append(Guard(toes(side), after, reset=land(side)))
            elif stage == 1:
                guards.append(Guard(stretch(side), after))
        if rear == front == 2:
            guards.append(Guard(lambda y: -y.vy, SECTION))
        return Mode(field, tuple(guards), energy=energy)

    def gait_region(self):
        return Grid.plain(height=(0.9, 1.5, 10), pitch_rate=(-1.5, 1.5, 13), pitch=(-0.1, 0.1, 3))


NAMES = (
    ("flight", "on front", "flight after front"),
    ("on rear", "on both", "on rear after front"),
    ("flight after rear", "on front after rear", "last flight"),
)
"""Names of modes, by the stage of the rear pair and of the front pair (`mode`)."""
