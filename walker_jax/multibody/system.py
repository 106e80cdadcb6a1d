"""A system of masses: their places, mass matrix, forces and energies."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.kernels.scalars import unroll

Coordinates = Float[Array, " q"]


class System(eqx.Module):
    """Masses, their positions, and the forces on them.

    **Arguments:**

    - `transfer`: F, from q to x, of shape (x,).
    - `masses`: one for each entry of x, the diagonal of M in (5): the mass of a point for each of
      its coordinates, the moment of inertia of a planar body for its angle. None negative. Or M
      itself, symmetric, as bodies in space need it (`space`).
    - `forces`: f, applied to the masses, of the shape of x. Constant, as gravity is.
    - `generalised_forces`: Q, dual to q, as a function of (q, qdot): springs, dampers, motors.
      By default there is none.
    """

    transfer: Callable[[Coordinates], Float[Array, " x"]]
    masses: Float[Array, " x"] | Float[Array, "x x"]
    forces: Float[Array, " x"]
    generalised_forces: Callable[[Coordinates, Coordinates], Coordinates] | None = None

    def __check_init__(self):
        if not isinstance(self.masses, Tracer):
            masses = np.asarray(self.masses)
            if masses.ndim == 2:
                if not (np.isfinite(masses).all() and (masses == masses.T).all()):
                    raise WrongUse(f"masses must be a symmetric matrix, not {masses.tolist()}")
                return
            if not (np.isfinite(masses) & (masses >= 0)).all():
                raise WrongUse(f"masses must be finite and not negative, not {masses.tolist()}")


def mass_matrix(system: System, q: Coordinates) -> Float[Array, "q q"]:
    """Compute the reduced mass matrix, F,q^T M F,q, (10)."""
    slopes = jacobian(system.transfer, q)
    return slopes.T @ times_masses(system, slopes)


def times_masses(system: System, values: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the product of M with a vector or a matrix."""
    masses = system.masses.astype(values.dtype)
    if masses.ndim == 2:
        return masses @ values
    return masses.reshape(-1, *(1,) * (values.ndim - 1)) * values


def reduced_force(system: System, q: Coordinates, qdot: Coordinates) -> Coordinates:
    """Compute the reduced force, F,q^T (f - M F,qq qdot qdot) + Q, (10)."""
    return virtual_power(system, q, qdot, convective_acceleration(system.transfer, q, qdot))


def virtual_power(
    system: System, q: Coordinates, qdot: Coordinates, acceleration: Float[Array, " x"]
) -> Coordinates:
    """Compute F,q^T [f - M xddot] + Q, (2): zero for every coordinate that is free to move."""
    # Unrolling computes equal terms of F only once, and their products with the balance too.
    _, transposed = jax.vjp(unroll(system.transfer), q)
    (power,) = transposed(system.forces.astype(q.dtype) - times_masses(system, acceleration))
    if system.generalised_forces is not None:
        power = power + system.generalised_forces(q, qdot)
    return power


def jacobian(function: Callable, q: Coordinates) -> Float[Array, "x q"]:
    """Compute F,q, column by column."""
    along = lambda direction: velocity(function, q, direction)
    if isinstance(q, Tracer):  # F is traced once for all directions
        along = jax.jit(along, inline=True)
    directions = np.eye(len(q), dtype=q.dtype)
    return jnp.stack([along(direction) for direction in directions], axis=1)


def velocity(function: Callable, q: Coordinates, qdot) -> Float[Array, "..."]:
    """Compute xdot = F,q qdot, (3)."""
    return jax.jvp(function, (q,), (jnp.asarray(qdot),))[1]


def convective_acceleration(
    function: Callable, q: Coordinates, qdot: Coordinates
) -> Float[Array, " x"]:
    """Compute F,qq qdot qdot, the part of the acceleration due to velocities alone, (3)."""
    return jax.jvp(lambda q: velocity(function, q, qdot), (q,), (qdot,))[1]


def kinetic_energy(system: System, q: Coordinates, qdot: Coordinates) -> Float[Array, ""]:
    """Compute xdot^T M xdot / 2."""
    xdot = velocity(system.transfer, q, qdot)
    return jnp.sum(xdot * times_masses(system, xdot)) / 2


def potential_energy(system: System, q: Coordinates) -> Float[Array, ""]:
    """Compute -f^T x, for the applied forces alone; zero at x = 0."""
    return -jnp.sum(system.forces * system.transfer(q))


def check_state(system: System, q: Coordinates, qdot: Coordinates) -> None:
    if q.ndim != 1 or qdot.shape != q.shape:
        raise WrongUse(f"q and qdot must have one shape (n,), not {q.shape} and {qdot.shape}")
    x = jax.eval_shape(system.transfer, q)
    if not x.shape == system.masses.shape[:1] == system.forces.shape:
        raise WrongUse(
            f"masses and forces must have the shape of F(q), {x.shape}, not "
            f"{system.masses.shape} and {system.forces.shape}"
        )
    if system.generalised_forces is not None:
        Q = jax.eval_shape(system.generalised_forces, q, qdot)
        if Q.shape != q.shape:
            raise WrongUse(f"generalised_forces must have the shape of q, {q.shape}, not {Q.shape}")
