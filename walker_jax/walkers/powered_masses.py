"""Walkers with mass on their legs, a torque in the hip, and push-off from the trailing foot."""

import equinox as eqx
import jax.numpy as jnp

from walker_jax import multibody
from walker_jax.multibody.single_support import coordinates_and_rates
from walker_jax.walkers.masses import MultibodyWalker, leg, weight
from walker_jax.walkers.model import WORK, Scalar, shown_by
from walker_jax.walkers.parameter_table import (
    ANY_SLOPE,
    HIP_ANGLE,
    HIP_DAMPER,
    HIP_SPRING,
    PUSH_OFF,
)
from walker_jax.walkers.point_foot import PointFootWalker
from walker_jax.walkers.round_foot import RoundFootWalker
from walker_jax.walkers.upper_body import UpperBodyWalker


class AbstractPoweredWalker(MultibodyWalker):
    """The motors of a walker with masses, by the general method.

    The hip's torque, dual to phi, is -hip_spring (phi - hip_angle) - hip_damper phidot on the swing
    leg, and the opposite on the stance leg. Push-off is an impulse of the ground on the trailing
    foot just before heel strike, from the foot's point of contact towards the leg's direction.
    Nothing holds that foot then, and the heel strike follows at once, (17). In the limit of
    vanishing foot mass both are those of `PoweredWalker`, with hip_spring = hip_stiffness times the
    mass of a foot.
    """

    slope: Scalar = eqx.field(converter=ANY_SLOPE.convert)
    hip_spring: Scalar = eqx.field(converter=HIP_SPRING.convert, default=HIP_SPRING.default)
    hip_damper: Scalar = eqx.field(converter=HIP_DAMPER.convert, default=HIP_DAMPER.default)
    hip_angle: Scalar = eqx.field(converter=HIP_ANGLE.convert, default=HIP_ANGLE.default)
    push_off: Scalar = eqx.field(converter=PUSH_OFF.convert, default=PUSH_OFF.default)

    def system(self):
        passive = super().system()

        def torque(q, qdot):
            phi = -self.hip_spring * (q[3] - self.hip_angle) - self.hip_damper * qdot[3]
            return jnp.zeros_like(q).at[3].set(phi)

        return eqx.tree_at(
            lambda system: system.generalised_forces, passive, torque, is_leaf=lambda x: x is None
        )

    @shown_by(*WORK)
    def motor_work(self, start, end):
        """Energy gained in the swing, by the hip alone, and in push-off.

        It is unknown with phases: the loss between them would count as work done on the motors.
        """
        if self.phases():
            return None
        system = self.system()
        q, qdot = coordinates_and_rates(end)
        pushed = multibody.push(system, q, qdot, self.push_off_impulse(q))
        gained = multibody.kinetic_energy(system, q, pushed) + multibody.potential_energy(system, q)
        return (gained - self.energy(start)) / weight(system, q)

    def push_off_impulse(self, q):
        """Dual to the foot's (u, v), which move with its point of contact, round or not."""
        return self.push_off * jnp.concatenate([leg(q[2]), jnp.zeros_like(q[2:])])


class PoweredPointFootWalker(AbstractPoweredWalker, PointFootWalker):
    """The `PointFootWalker` with a torque in its hip and push-off.

    **Arguments:** those of the `PointFootWalker`, in units of the hip's mass, and

    - `slope`: of the ground (rad), between -pi/2 and pi/2: level ground and uphill too.
    - `hip_spring`, `hip_damper`: stiffness and damping of the hip, not negative.
    - `hip_angle`: phi at which the spring is slack (rad).
    - `push_off`: impulse along the trailing leg just before heel strike, not negative.

    Raises `ValueError` otherwise.
    """


class PoweredRoundFootWalker(AbstractPoweredWalker, RoundFootWalker):
    """The `RoundFootWalker` with a torque in its hip and push-off.

    **Arguments:** those of the `RoundFootWalker`, and those of the `PoweredPointFootWalker`.
    """


class PoweredUpperBodyWalker(AbstractPoweredWalker, UpperBodyWalker):
    """The `UpperBodyWalker` with a torque in its hip and push-off.

    **Arguments:** those of the `UpperBodyWalker`, and those of the `PoweredPointFootWalker`.
    """
