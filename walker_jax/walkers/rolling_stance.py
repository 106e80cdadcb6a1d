"""A walker in space on its stance disc: its state, equations of motion and contact force."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.integrators.power_balance import ConstrainedPower
from walker_jax.kernels.scalars import unroll
from walker_jax.walkers.model import Scalar

Vector = Float[Array, " 3"]


class SpatialState(NamedTuple):
    """Places, angles (rad) and rates of a walker on its left leg, or their time derivatives.

    Walkers on the right leg are seen in a mirror. The axes of the slope are x, down it, y, to the
    left, and z, normal to it.
    """

    x: Scalar
    """Contact of the stance disc, relative to the start of the stride."""
    y: Scalar
    yaw: Scalar
    """Rotation of the axle about z, positive to the left."""
    lean: Scalar
    """Rotation of the axle about the direction of walking: positive to the side of the swing leg,
    negative to the side of the stance leg."""
    theta: Scalar
    """Angle of the stance leg about the axle, positive before mid-stance."""
    phi: Scalar
    """Angle between the legs, from the stance leg to the swing leg."""
    yawdot: Scalar
    leandot: Scalar
    thetadot: Scalar
    phidot: Scalar


class Momenta(NamedTuple):
    """Momenta of both legs, and the vectors they consist of, in the axle's frame."""

    whole: Vector
    """Angular momentum of both legs about the contact."""
    swing: Vector
    """Angular momentum of the swing leg about the hip."""
    linear: Vector
    """Momentum of both legs."""
    linear_swing: Vector
    """Momentum of the swing leg."""
    hip: Vector
    """Velocity of the hip."""
    arms: Vector
    """Sum of the arms of the two centres of mass, from the contact."""
    arm: Vector
    """Arm of the swing leg's centre of mass, from the hip."""
    frame: Vector
    """Angular velocity of the axle's frame."""
    lean: list[Scalar]
    """Cosine and sine of the lean."""

    def scalars(self) -> list[Scalar]:
        """Return all entries, one after the other."""
        return [entry for field in self for entry in field]

    @classmethod
    def of(cls, scalars: list[Scalar]) -> "Momenta":
        """Make the momenta from all entries."""
        vectors = [jnp.stack(scalars[i : i + 3]) for i in range(0, 24, 3)]
        return cls._make([*vectors, scalars[24:]])


class RollingStance(ConstrainedPower):
    """The equations of motion on the rolling stance disc, for x, y, yaw, lean, theta, phi.

    They are those of `multibody.ConstrainedMotion`, in vectors along the axle's frame, in which
    arms do not depend on yaw and lean. With Omega the frame's angular velocity, the legs have
    omega_i = Omega + (their rates) e_2. The stance leg turns about its contact, with its centre of
    mass at c and the hip at a from the contact. The swing leg's centre of mass is at b from the
    hip:

        v_1 = omega_1 x c,    v_hip = omega_1 x a,    v_2 = v_hip + omega_2 x b.

    H is the angular momentum of both legs about the contact, K that of the swing leg about the hip.
    The contact moves at C along the slope, and the hip at v_hip. With p and p_2 the momenta of both
    legs and of the swing leg, and W the weight of a leg,

        H' + Omega x H + C x p = (a + b + c) x W,
        K' + Omega x K + v_hip x p_2 = b x W.

    Of the second equation, the part along the axle counts.
    """

    walker: Any
    """A `SpatialWalker`."""

    @property
    def independent(self):
        return 2, 3, 4, 5

    def rates(self, q, u):
        """Rates of the coordinates: the contact moves along the disc as the leg turns."""
        rolled = self.rolled(u)
        return [rolled * jnp.cos(q[2]), rolled * jnp.sin(q[2]), *u]

    def rolled(self, u: list) -> Scalar:
        """Return the speed of the contact along the slope."""
        return -self.walker.disc_radius * u[2]

    def momentum(self, q, u):
        return unroll(lambda self, q, u: self.momenta(q[3:], u).scalars())(self, q, u)

    def momenta(self, angles: list, u: list) -> Momenta:
        """Compute the momenta from lean, theta and phi, and the rates."""
        walker = self.walker
        lean, theta, phi = angles
        yawdot, leandot, thetadot, phidot = u
        radius, shank = walker.disc_radius, walker.leg_length - walker.disc_radius
        zero = jnp.zeros_like(theta)
        legs = [(jnp.cos(angle), jnp.sin(angle)) for angle in (-theta, phi - theta)]
        tilt = [jnp.cos(lean), jnp.sin(lean)]

        def along(leg, forward, left, up):
            c, s = leg
            return jnp.stack([c * forward + s * up, left, c * up - s * forward])

        sole = jnp.stack([zero, zero, zero + radius])
        forward, outward, up = walker.com_forward, walker.com_outward, walker.com_height - radius
        stance = along(legs[0], forward, outward, up) + sole
        hip = along(legs[0], zero, zero, shank) + sole
        swing = along(legs[1], forward, -walker.hip_width - outward, up - shank)

        turn = yawdot * tilt[1]
        frame = jnp.stack([leandot, turn, yawdot * tilt[0]])
        first, second = (
            jnp.stack([frame[0], turn + spin, frame[2]]) for spin in (-thetadot, phidot - thetadot)
        )
        at_hip = cross(first, hip)
        p_1 = walker.leg_mass * cross(first, stance)
        p_2 = walker.leg_mass * (at_hip + cross(second, swing))
        about_hip = cross(swing, p_2) + self.spin(legs[1], -1.0, second)
        whole = cross(stance, p_1) + cross(hip, p_2) + self.spin(legs[0], 1.0, first) + about_hip
        arms = stance + hip + swing
        return Momenta(whole, about_hip, p_1 + p_2, p_2, at_hip, arms, swing, frame, tilt)

    def spin(self, leg: tuple[Scalar, Scalar], side: float, omega: Vector) -> Vector:
        """Return the angular momentum of a leg about its centre of mass."""
        c, s = leg
        within = jnp.stack([c * omega[0] - s * omega[2], omega[1], s * omega[0] + c * omega[2]])
        h = self.walker.inertia(side) @ within
        return jnp.stack([c * h[0] + s * h[2], h[1], c * h[2] - s * h[0]])

    def weight(self, yaw: Scalar, lean: list[Scalar]) -> Vector:
        """Return the weight of a leg, along the axle's frame."""
        down, down_slope = -jnp.cos(self.walker.slope), jnp.sin(self.walker.slope)
        across, (c, s) = -down_slope * jnp.sin(yaw), lean
        gravity = [down_slope * jnp.cos(yaw), c * across + s * down, c * down - s * across]
        return self.walker.leg_mass * jnp.stack(gravity)

    def power(self, q, u, momentum, momentum_rates):
        def flat(self, q, u, momentum, momentum_rates):
            now, rates = Momenta.of(momentum), Momenta.of(momentum_rates)
            weight = self.weight(q[2], now.lean)
            contact = self.rolled(u)
            zero = jnp.zeros_like(contact)
            carried = jnp.stack([zero, -contact * now.linear[2], contact * now.linear[1]])
            whole = cross(now.arms, weight) - cross(now.frame, now.whole) - carried
            swing = cross(now.arm, weight) - cross(now.frame, now.swing)
            swing = swing - cross(now.hip, now.linear_swing)
            return self.moments(now.lean, whole - rates.whole, swing - rates.swing)

        return unroll(flat)(self, q, u, momentum, momentum_rates)

    def moments(self, lean: list[Scalar], whole: Vector, swing: Vector) -> list[Scalar]:
        """Return the power of moments, on both legs and the swing leg, at unit rate of each u."""
        (c, s), (along, sideways, up) = lean, whole
        return [sideways * s + up * c, along, -sideways, swing[1]]

    def factorise(self, q):
        def flat(self, q):
            columns = []
            for one in np.eye(4):
                u = [jnp.asarray(entry, q[0].dtype) for entry in one]
                found = self.momenta(q[3:], u)
                columns.append(self.moments(found.lean, found.whole, found.swing))
            return multibody.factorise(columns)

        return unroll(flat)(self, q)

    def solve(self, factors, right):
        return multibody.solve_factored(factors, right)


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product, with no more products than it has."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


@jax.jit
def contact_forces(walker: Any, state: Any) -> list[Scalar]:
    """Compute the forces of the ground on the stance disc, down the slope and normal to it."""
    q, u = list(state[:6]), list(state[6:])
    rates = list(RollingStance(walker)(state))

    def flat(walker, q, u, qdot, udot):
        motion = RollingStance(walker)
        now, rates = map(Momenta.of, jax.jvp(motion.momentum, (q, u), (qdot, udot)))
        turning = rates.linear + cross(now.frame, now.linear)
        forward, left, up = turning - 2 * motion.weight(q[2], now.lean)
        yaw, (c, s) = q[2], now.lean
        along = jnp.cos(yaw) * forward - jnp.sin(yaw) * (c * left - s * up)
        return [along, s * left + c * up]

    return unroll(flat)(walker, q, u, rates[:6], rates[6:])
