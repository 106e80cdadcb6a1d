"""Motion on a stance foot, which the ground holds, by the general method.

The generalised coordinates are q = (u, v, ...), with u and v the coordinates of the foot along and
normal to the ground. The others are those of a state, which holds their rates after them.
"""

from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.integrators.power_balance import VirtualPower
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.equations import solve_motion
from walker_jax.multibody.linear import block, factorise, solve_factored
from walker_jax.multibody.system import System, mass_matrix, virtual_power


@runtime_checkable
class HasSystem(Protocol):
    """A walker or another system, whose parameters form this pytree."""

    def system(self) -> System:
        """Masses, the transfer function x = F(q) to their places, (1), and forces, (6)."""
        ...


class SingleSupport(VirtualPower):
    """The equations of motion (2) of a walker whose stance foot is on the ground: u = v = 0."""

    walker: HasSystem

    def transfer(self, q):
        flat = lambda walker, q: list(walker.system().transfer(stance_coordinates(q)))
        return unroll(flat)(self.walker, q)

    def virtual_power(self, q, qdot, acceleration):
        def flat(walker, q, qdot, acceleration):
            return list(
                virtual_power(
                    walker.system(),
                    stance_coordinates(q),
                    stance_coordinates(qdot),
                    jnp.stack(acceleration),
                )[2:]
            )

        return unroll(flat)(self.walker, q, qdot, acceleration)

    def factorise(self, q):
        def flat(walker, q):
            matrix = mass_matrix(walker.system(), stance_coordinates(q))
            return factorise(block(matrix, range(2, 2 + len(q))))

        return unroll(flat)(self.walker, q)

    def solve(self, factors, right):
        return solve_factored(factors, right)


def stance_coordinates(legs: list[Scalar]) -> Float[Array, " q"]:
    """Return q = (u, v, theta, phi) from (theta, phi), the stance foot at the origin.

    It also converts rates. For a phase, it returns q from the phase's coordinates.
    """
    zero = jnp.zeros_like(legs[0])
    return jnp.stack([zero, zero, *legs])


def coordinates_and_rates(state: Any) -> tuple[Float[Array, " q"], Float[Array, " q"]]:
    """Return q and its rates."""
    numbers = jax.tree.leaves(state)
    half = len(numbers) // 2
    return stance_coordinates(numbers[:half]), stance_coordinates(numbers[half:])


@jax.jit
def accelerations_and_forces(walker: HasSystem, state: Any) -> tuple[list[Scalar], list[Scalar]]:
    """Compute accelerations on the stance foot, and the forces that hold u and v, (4)."""

    def equations(walker, state):
        q, qdot = coordinates_and_rates(state)
        accelerations, forces = solve_motion(walker.system(), q, qdot, held=(0, 1))
        return list(accelerations), list(forces)

    return unroll(equations)(walker, state)


def normal_force(walker: HasSystem, state: Any) -> Scalar:
    """Return the normal force of the ground on the stance foot."""
    return accelerations_and_forces(walker, state)[1][1]


def leg(angle: Real) -> Float[Array, " 2"]:
    """Return the direction from foot to hip of a leg at an angle from the normal of the slope."""
    return jnp.stack([-jnp.sin(angle), jnp.cos(angle)])
