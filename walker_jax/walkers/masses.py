"""Walkers with masses of any kind, by the general method (`multibody`).

Derive your own walker from `HeavyLegWalker` (`walkers.heavy_legs`). It defines the places of its
masses and the point where its swing foot meets the ground: equations of motion, contact forces and
impact follow.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax import multibody
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.multibody.single_support import (
    SingleSupport,
    accelerations_and_forces,
    coordinates_and_rates,
    stance_coordinates,
)
from walker_jax.multibody.single_support import leg as leg
from walker_jax.walkers.model import DRIVE, Phase, Scalar, State, Walker, shown_by


class MultibodyMotion(eqx.Module):
    """Motion of a system of masses on the stance foot, by the general method.

    The generalised coordinates are q = (u, v, theta, phi) and those of joints, or (u, v) and those
    of a phase's state. u and v are the stance foot's coordinates along and normal to the slope:
    zero on the ground, and held there.
    """

    @abc.abstractmethod
    def system(self) -> System:
        """Masses, the transfer function x = F(q) to their places, (1), and forces, (6)."""

    @abc.abstractmethod
    def contacts(self, q: Float[Array, " q"]) -> Float[Array, " g"]:
        """The contact function g(q), (11), of the impact at the end of the motion."""

    def push_off_impulse(self, q: Float[Array, " q"]) -> Float[Array, " q"] | None:
        """Impulse dual to q on the walker just before the impact; by default there is none."""
        return None

    def vector_field(self, state):
        """(4), with u and v held."""
        return SingleSupport(self)(state)

    def equations(self):
        """(2), unless there is another vector field."""
        own = type(self).vector_field is not MultibodyMotion.vector_field
        return self.vector_field if own else SingleSupport(self)

    def contact_force(self, state):
        """The forces dual to u and v that hold them, (4)."""
        _, forces = accelerations_and_forces(self, state)
        return forces[0], forces[1]

    def energy(self, state: Any) -> Scalar:
        """Kinetic energy, and potential energy of gravity with the stance foot at the origin."""
        q, qdot = coordinates_and_rates(state)
        system = self.system()
        return multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)


def masses_struck(
    motion: MultibodyMotion, state: Any, impulse: Float[Array, " 2"], arm: tuple[Scalar, Scalar]
) -> Any:
    """Return a state after an impulse P at the hip: rates change by M^{-1} (d hip / dq)^T P."""
    count = len(state) // 2
    angles, rates = state[:count], state[count:]
    torque = arm[0] * impulse[0] + arm[1] * impulse[1]
    turns = tuple(range(2, 2 + count))
    q = stance_coordinates([*angles])
    factors = multibody.factorise(multibody.block(multibody.mass_matrix(motion.system(), q), turns))
    changes = multibody.solve_factored(factors, [torque, *[jnp.zeros_like(torque)] * (count - 1)])
    return type(state)(*angles, *(rate + by for rate, by in zip(rates, changes, strict=True)))


class MultibodyWalker(MultibodyMotion, Walker):
    """Walkers whose equations follow from the places of their masses, by the general method.

    The foot that stood is free at heel strike.
    """

    @abc.abstractmethod
    def swing_foot(self, q: Float[Array, " q"]) -> Float[Array, " 2"]:
        """The swing foot's coordinates, as (u, v) are the stance foot's, (11)."""

    def contacts(self, q):
        return self.swing_foot(q)

    def struck(self, state, impulse, arm):
        """Phases of its own may have other masses."""
        return None if self.phases() else masses_struck(self, state, impulse, arm)

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        """True while there are no generalised forces, and `forces` are those of gravity."""
        system, slope = self.system(), vars(self)["slope"]
        count = len(system.masses)
        weights = (gravity(slope, system.masses, turns) for turns in range(count % 2, count + 1, 2))
        falls = any(np.allclose(system.forces, weight, rtol=1e-6, atol=0) for weight in weights)
        return system.generalised_forces is None and falls

    def impact(self, state):
        """(17), without restitution."""
        (u, v, *rates), _ = rates_and_impulses(self, state)
        return (u, v), self.state(*state[: len(rates)], *rates)

    def impulse(self, state: State) -> tuple[Scalar, Scalar]:
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (17)."""
        _, (rho_x, rho_y) = rates_and_impulses(self, state)
        return rho_x, rho_y


class MultibodyPhase(MultibodyMotion, Phase):
    """Phases whose equations follow from the places of the masses, by the general method."""

    @abc.abstractmethod
    def closing(self, q: Float[Array, " q"]) -> Float[Array, " g"]:
        """The distance that becomes zero at the end of the phase, and stays zero from then on."""

    def contacts(self, q):
        """The stance foot stays where it is."""
        return jnp.concatenate([q[:2], self.closing(q)])

    def rates_after(self, state: Any) -> list[Scalar]:
        """Rates of the state's coordinates after the impact at its end, (17)."""
        rates, _ = rates_and_impulses(self, state)
        return rates[2:]


def rises_ever_faster(walker: MultibodyWalker, state: State) -> Bool[Array, ""]:
    """Return whether h > 0 rises ever faster, with the swing leg ahead and the stance leg falling.

    The stance leg must also be in compression. In strides from the section it is then too late to
    come down again, and the leg falls on. That is tested, not proved, and excludes walkers that
    rock on their feet, whose leg may turn.
    """
    (_, _, thetaddot, phiddot, *_), (_, Q_v, *_) = accelerations_and_forces(walker, state)
    rising = (state.phi > 2 * state.theta) & (state.phidot > 2 * state.thetadot)
    faster = phiddot > 2 * thetaddot
    falling = (state.phi < 0) & (thetaddot < 0) & (Q_v > 0)
    return rising & faster & falling & (curvature_of_potential(walker) < 0)


@jax.jit
def curvature_of_potential(walker: MultibodyWalker) -> Scalar:
    """Compute V'' by the angle of both legs together, upright; positive if the feet's arcs are so
    large that the walker rocks on them."""

    def curvature(walker):
        system = walker.system()
        energy = lambda angle: multibody.potential_energy(
            system, stance_coordinates([angle, jnp.zeros_like(angle)])
        )
        zero = jnp.zeros_like(vars(walker)["slope"])
        rate = lambda angle: jax.jvp(energy, (angle,), (jnp.ones_like(angle),))[1]
        return jax.jvp(rate, (zero,), (jnp.ones_like(zero),))[1]

    return unroll(curvature)(walker)


@jax.jit
def rates_and_impulses(walker: MultibodyMotion, state: Any) -> tuple[list[Scalar], list[Scalar]]:
    """Compute rates after the impact in which contacts close, and its impulses, (17)."""

    def equations(walker, state):
        q, qdot = coordinates_and_rates(state)
        if (impulse := walker.push_off_impulse(q)) is not None:
            qdot = multibody.push(walker.system(), q, qdot, impulse)
        after = multibody.impact(walker.system(), walker.contacts, q, qdot)
        return list(after.velocities), list(after.impulses)

    return unroll(equations)(walker, state)


def gravity(slope: Scalar, masses: Float[Array, " x"], turns: int = 0) -> Float[Array, " x"]:
    """Return gravity, (6), on points in the plane, whose coordinates precede `turns` angles."""
    points = (len(masses) - turns) // 2
    down = jnp.stack([jnp.sin(slope), -jnp.cos(slope)])
    return masses * jnp.concatenate([*[down] * points, jnp.zeros(turns, masses.dtype)])


def weight(system: System, q: Float[Array, " q"]) -> Scalar:
    """Return the force of gravity on all masses together."""
    along = jnp.stack([jnp.zeros_like(q).at[i].set(1) for i in range(2)])
    sums = [multibody.velocity(system.transfer, q, one) @ system.forces for one in along]
    return jnp.hypot(*sums)
