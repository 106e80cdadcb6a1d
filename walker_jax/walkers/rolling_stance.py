"""A walker in space on its stance disc: its state, equations of motion and contact force."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.integrators.taylor import ConstrainedPower
from walker_jax.kernels.scalars import unroll
from walker_jax.walkers.model import Scalar

Vector = Float[Array, " 3"]


class SpatialState(NamedTuple):
    """Places, angles (rad) and rates of a walker on its left leg, or their time derivatives.

    Walkers on the right leg are seen in a mirror. The axes of the slope are x, down it, y, to the
    left, and z, normal to it.
    """

    x: Scalar
    """Contact of the stance disc: since the start of the stride."""
    y: Scalar
    yaw: Scalar
    """Of the axle about z: positive to the left."""
    lean: Scalar
    """Of the axle about the direction of walking: positive to the right, the side of the swing leg,
    negative to the side of the stance leg."""
    theta: Scalar
    """Of the stance leg about the axle, positive before mid-stance."""
    phi: Scalar
    """Between the legs, from the stance leg to the swing leg."""
    yawdot: Scalar
    leandot: Scalar
    thetadot: Scalar
    phidot: Scalar


class RollingStance(ConstrainedPower):
    """The equations of motion on the stance disc, which rolls, of x, y, yaw, lean, theta, phi.

    They are those of `multibody.ConstrainedMotion`, in vectors along the axle's frame, in which
    arms do not depend on yaw and lean. With Omega the frame's angular velocity, those of the legs
    are omega_i = Omega + (their rates) e_2. The stance leg turns about its contact, and the swing
    leg's centre of mass at arms b from the hip that is at arms a from the contact:

        v_1 = omega_1 x c,    v_2 = omega_1 x a + omega_2 x b.

    The momenta are m v_1, m v_2, and the angular momenta h_i of the legs. The power of a force F_i
    and a moment N_i on each leg is omega_1 (c x F_1 + a x F_2 + N_1) + omega_2 (b x F_2 + N_2).
    """

    walker: Any
    """A `SpatialWalker`."""

    @property
    def independent(self):
        return 2, 3, 4, 5

    def rates(self, q, u):
        """The contact moves along the disc by what the leg has turned about the axle."""
        rolled = -self.walker.disc_radius * u[2]
        return [rolled * jnp.cos(q[2]), rolled * jnp.sin(q[2]), *u]

    def arms(self, lean_and_legs: list) -> tuple[Vector, Vector, Vector, list]:
        """c, a and b; and the frames of the legs, by their cosines and sines."""
        walker = self.walker
        _, theta, phi = lean_and_legs
        radius, shank = walker.disc_radius, walker.leg_length - walker.disc_radius
        legs = [(jnp.cos(angle), jnp.sin(angle)) for angle in (-theta, phi - theta)]

        def along(leg, forward, left, up):
            c, s = leg
            return jnp.stack([c * forward + s * up, left, c * up - s * forward])

        zero, sole = jnp.zeros_like(theta), jnp.stack([0 * radius, 0 * radius, radius])
        forward, outward, up = walker.com_forward, walker.com_outward, walker.com_height - radius
        stance = along(legs[0], forward, outward, up) + sole
        hip = along(legs[0], zero, zero, shank) + sole
        swing = along(legs[1], forward, -walker.hip_width - outward, up - shank)
        return stance, hip, swing, legs

    def momentum(self, q, u):
        def flat(self, q, u):
            return list(jnp.concatenate(self.momenta(q[3:], *self.turning(q[3], u))))

        return unroll(flat)(self, q, u)

    def turning(self, lean: Scalar, u: list) -> tuple[Vector, ...]:
        """Omega, omega_1, omega_2."""
        yawdot, leandot, thetadot, phidot = u
        along, up = yawdot * jnp.sin(lean), yawdot * jnp.cos(lean)
        turns = along, along - thetadot, along + (phidot - thetadot)
        return tuple(jnp.stack([leandot, turn, up]) for turn in turns)

    def momenta(self, legs: list, frame, *turning) -> list[Vector]:
        """m v_1, h_1, m v_2, h_2."""
        stance, hip, swing, frames = self.arms(legs)
        first, second = turning
        velocities = cross(first, stance), cross(first, hip) + cross(second, swing)
        found = []
        for side, v, omega, (c, s) in zip((1.0, -1.0), velocities, turning, frames, strict=True):
            within = jnp.stack([c * omega[0] - s * omega[2], omega[1], s * omega[0] + c * omega[2]])
            h = self.walker.inertia(side) @ within
            found += [
                self.walker.leg_mass * v,
                jnp.stack([c * h[0] + s * h[2], h[1], c * h[2] - s * h[0]]),
            ]
        return found

    def moments(self, legs: list, balance: list[Vector]) -> list[Scalar]:
        """The power of forces and moments F_1, N_1, F_2, N_2 at unit rate of each of u."""
        stance, hip, swing, _ = self.arms(legs)
        force_1, moment_1, force_2, moment_2 = balance
        first = cross(stance, force_1) + cross(hip, force_2) + moment_1
        second = cross(swing, force_2) + moment_2
        along, sideways, up = first + second
        yaw = sideways * jnp.sin(legs[0]) + up * jnp.cos(legs[0])
        return [yaw, along, -sideways, second[1]]

    def balance_of_forces(self, q: list, u: list, momentum_rates: list) -> list:
        """F_1, N_1, F_2, N_2: weights less the rates of the momenta, in the axle's frame."""
        yaw, lean = q[2:4]
        frame, *turning = self.turning(lean, u)
        momenta = self.momenta(q[3:], frame, *turning)
        changes = [jnp.stack(momentum_rates[i : i + 3]) for i in range(0, 12, 3)]
        down, down_slope = -jnp.cos(self.walker.slope), jnp.sin(self.walker.slope)
        across = -down_slope * jnp.sin(yaw)
        c, s = jnp.cos(lean), jnp.sin(lean)
        gravity = jnp.stack(
            [down_slope * jnp.cos(yaw), c * across + s * down, c * down - s * across]
        )
        weight = self.walker.leg_mass * gravity
        none = jnp.zeros_like(weight)
        return [
            force - change - cross(frame, momentum)
            for force, change, momentum in zip(
                (weight, none, weight, none), changes, momenta, strict=True
            )
        ]

    def power(self, q, u, momentum_rates):
        flat = lambda self, q, u, rates: self.moments(q[3:], self.balance_of_forces(q, u, rates))
        return unroll(flat)(self, q, u, momentum_rates)

    def factorise(self, q):
        def flat(self, q):
            columns = []
            for one in np.eye(4):
                u = [jnp.asarray(entry, q[0].dtype) for entry in one]
                momenta = self.momenta(q[3:], *self.turning(q[3], u))
                columns.append(self.moments(q[3:], momenta))
            return multibody.factorise(columns)

        return unroll(flat)(self, q)

    def solve(self, factors, right):
        return multibody.solve_factored(factors, right)


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product, with no more products than it has."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


@jax.jit
def contact_forces(walker: Any, state: Any) -> list[Scalar]:
    """Of the ground on the stance disc, down the slope and normal to it: what the balance lacks."""
    q, u = list(state[:6]), list(state[6:])
    rates = list(RollingStance(walker)(state))

    def flat(walker, q, u, qdot, udot):
        motion = RollingStance(walker)
        _, changes = jax.jvp(motion.momentum, (q, u), (qdot, udot))
        stance, _, swing, _ = motion.balance_of_forces(q, u, changes)
        forward, left, up = -(stance + swing)
        yaw, c, s = q[2], jnp.cos(q[3]), jnp.sin(q[3])
        along = jnp.cos(yaw) * forward - jnp.sin(yaw) * (c * left - s * up)
        return [along, s * left + c * up]

    return unroll(flat)(walker, q, u, rates[:6], rates[6:])
