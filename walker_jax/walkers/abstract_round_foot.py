"""Walkers with two rigid legs on round feet, with any load."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, is_traced
from walker_jax.walkers.heavy_legs import HeavyLegWalker, pendulum_region
from walker_jax.walkers.masses import leg
from walker_jax.walkers.model import Scalar


class AbstractRoundFootWalker(HeavyLegWalker):
    """Two rigid legs, alike, on feet that roll: arcs of a circle, centred on the legs.

    While the coordinate u of a rolling foot is held, the centre of its arc is at
    u - foot_radius theta.
    """

    leg_mass: eqx.AbstractVar[Scalar]
    leg_inertia: eqx.AbstractVar[Scalar]
    leg_length: eqx.AbstractVar[Scalar]
    com_from_hip: eqx.AbstractVar[Scalar]
    com_offset: eqx.AbstractVar[Scalar]
    foot_radius: eqx.AbstractVar[Scalar]

    def __check_init__(self):
        values = (self.foot_radius, self.leg_length, self.leg_inertia, self.com_from_hip)
        if is_traced((*values, self.com_offset)):
            return
        radius, length, inertia, down = map(float, values)
        if radius >= length:
            raise WrongUse(
                f"foot_radius must be less than leg_length {length:g}, not {radius:g}",
                of="foot_radius leg_length",
            )
        if inertia == 0 and down == 0 and float(self.com_offset) == 0:
            raise WrongUse(
                "leg_inertia must be above 0 where com_from_hip and com_offset are 0, not 0",
                of="leg_inertia com_from_hip com_offset",
            )

    def further_gait_region(self):
        """On large feet or steep slopes steps are long, and legs turn fast relative to toppling."""
        axes = {"theta": (0, 1.5, 48), "sum": (-0.6, 0.7, 42), "turn": (-2.2, 0.3, 24)}
        return pendulum_region(self, self.leg_length, axes)

    def hip_and_legs(self, q: Float[Array, " q"]) -> tuple[Float[Array, " 2"], Float[Array, " 6"]]:
        """Return the hip, and the legs' centres of mass and angles."""
        u, v, theta, phi = q[:4]
        radius = self.foot_radius
        centre = jnp.stack([u - radius * theta, v + radius])
        hip = centre + (self.leg_length - radius) * leg(theta)

        def centre_of_mass(angle):
            forward = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
            return hip - self.com_from_hip * leg(angle) + self.com_offset * forward

        swing = theta - phi
        angles = jnp.stack([theta, swing])
        return hip, jnp.concatenate([centre_of_mass(theta), centre_of_mass(swing), angles])

    def swing_foot(self, q):
        """(u, v) of the swing foot: of the arc's centre, as if that foot had rolled there."""
        hip, _ = self.hip_and_legs(q)
        angle, radius = q[2] - q[3], self.foot_radius
        centre = hip - (self.leg_length - radius) * leg(angle)
        return centre + jnp.stack([radius * angle, -radius])
