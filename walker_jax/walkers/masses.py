"""Walkers with masses of any kind, by the general method (`multibody`).

A walker of your own derives from `HeavyLegWalker` (`walkers.heavy_legs`), and says where its masses
are and where its swing foot meets the ground: equations of motion, contact forces and impact
follow.
"""

import abc

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax import multibody
from walker_jax.integrators.taylor import VirtualPower
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.walkers.model import Scalar, State, Walker


class MultibodyWalker(Walker):
    """Walkers whose equations follow from where their masses are, by the general method.

    The generalised coordinates are q = (u, v, theta, phi), with u and v those of the stance foot
    along and normal to the slope: zero on the ground, held there between heel strikes, and free at
    heel strike.
    """

    @abc.abstractmethod
    def system(self) -> System:
        """Masses, the transfer function x = F(q) that says where they are, (1), and forces, (6)."""

    @abc.abstractmethod
    def swing_foot(self, q: Float[Array, " 4"]) -> Float[Array, " 2"]:
        """The swing foot's coordinates, those that (u, v) are for the stance foot, (11)."""

    def push_off_impulse(self, q: Float[Array, " 4"]) -> Float[Array, " 4"] | None:
        """Impulse dual to q on the walker just before heel strike; by default there is none."""
        return None

    def driven_by_gravity(self):
        """As long as there are no generalised forces, and `forces` are those of gravity."""
        system, slope = self.system(), vars(self)["slope"]
        count = len(system.masses)
        weights = (gravity(slope, system.masses, turns) for turns in range(count % 2, count + 1, 2))
        falls = any(np.allclose(system.forces, weight, rtol=1e-6, atol=0) for weight in weights)
        return system.generalised_forces is None and falls

    def vector_field(self, state):
        """(4), with u and v held."""
        return SingleSupport(self)(state)

    def contact_force(self, state):
        """The forces dual to u and v that hold them, (4)."""
        _, (Q_u, Q_v, _, _) = accelerations_and_forces(self, state)
        return Q_u, Q_v

    def impact(self, state):
        """(17), without restitution."""
        (u, v, thetadot, phidot), _ = rates_and_impulses(self, state)
        return (u, v), State(state.theta, state.phi, thetadot, phidot)

    def impulse(self, state: State) -> tuple[Scalar, Scalar]:
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (17)."""
        _, (rho_x, rho_y) = rates_and_impulses(self, state)
        return rho_x, rho_y

    def energy(self, state: State) -> Scalar:
        """Kinetic energy, and potential energy of gravity, the stance foot at the origin."""
        q, qdot = coordinates_and_rates(state)
        system = self.system()
        return multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)


def rises_ever_faster(walker: MultibodyWalker, state: State) -> Bool[Array, ""]:
    """h > 0 rises ever faster, the swing leg ahead, the stance leg falling, in compression.

    As for the simplest walker it is too late then to come down again: an experience (tests).
    """
    (_, _, thetaddot, phiddot), (_, Q_v, _, _) = accelerations_and_forces(walker, state)
    rising = (state.phi > 2 * state.theta) & (state.phidot > 2 * state.thetadot)
    faster = phiddot > 2 * thetaddot
    return rising & faster & (state.phi < 0) & (thetaddot < 0) & (Q_v > 0)


class SingleSupport(VirtualPower):
    """The equations of motion (2) of a walker whose stance foot is on the ground: u = v = 0."""

    walker: MultibodyWalker

    def transfer(self, q):
        flat = lambda walker, q: list(walker.system().transfer(stance_coordinates(q)))
        return unroll(flat)(self.walker, q)

    def virtual_power(self, q, qdot, acceleration):
        def flat(walker, q, qdot, acceleration):
            return list(
                multibody.virtual_power(
                    walker.system(),
                    stance_coordinates(q),
                    stance_coordinates(qdot),
                    jnp.stack(acceleration),
                )[2:]
            )

        return unroll(flat)(self.walker, q, qdot, acceleration)

    def factorise(self, q):
        def flat(walker, q):
            matrix = multibody.mass_matrix(walker.system(), stance_coordinates(q))
            return multibody.factorise(multibody.block(matrix, (2, 3)))

        return unroll(flat)(self.walker, q)

    def solve(self, factors, right):
        return multibody.solve_factored(factors, right)


def stance_coordinates(legs: list[Scalar]) -> Float[Array, " 4"]:
    """q = (u, v, theta, phi) from (theta, phi), the stance foot at the origin; or its rates."""
    zero = jnp.zeros_like(legs[0])
    return jnp.stack([zero, zero, *legs])


def coordinates_and_rates(state: State) -> tuple[Float[Array, " 4"], Float[Array, " 4"]]:
    """q and its rates."""
    return stance_coordinates(list(state[:2])), stance_coordinates(list(state[2:]))


@jax.jit
def accelerations_and_forces(
    walker: MultibodyWalker, state: State
) -> tuple[list[Scalar], list[Scalar]]:
    """Accelerations, and the forces that hold u and v, of a walker on its stance foot, (4)."""

    def equations(walker, state):
        q, qdot = coordinates_and_rates(state)
        accelerations, forces = multibody.solve_motion(walker.system(), q, qdot, held=(0, 1))
        return list(accelerations), list(forces)

    return unroll(equations)(walker, state)


@jax.jit
def rates_and_impulses(walker: MultibodyWalker, state: State) -> tuple[list[Scalar], list[Scalar]]:
    """Rates after heel strike, and impulses, (17)."""

    def equations(walker, state):
        q, qdot = coordinates_and_rates(state)
        if (impulse := walker.push_off_impulse(q)) is not None:
            qdot = multibody.push(walker.system(), q, qdot, impulse)
        after = multibody.impact(walker.system(), walker.swing_foot, q, qdot)
        return list(after.velocities), list(after.impulses)

    return unroll(equations)(walker, state)


def gravity(slope: Scalar, masses: Float[Array, " x"], turns: int = 0) -> Float[Array, " x"]:
    """Gravity, (6), on points in the plane, whose coordinates come before `turns` angles."""
    points = (len(masses) - turns) // 2
    down = jnp.stack([jnp.sin(slope), -jnp.cos(slope)])
    return masses * jnp.concatenate([*[down] * points, jnp.zeros(turns, masses.dtype)])


def leg(angle: Scalar) -> Float[Array, " 2"]:
    """The direction from foot to hip of a leg at an angle from the normal of the slope."""
    return jnp.stack([-jnp.sin(angle), jnp.cos(angle)])
