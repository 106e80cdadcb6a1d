"""Rigid bodies in space, as masses of the general method.

A body's coordinates x are its centre of mass c and its axes, the columns of the rotation R from the
body's frame. Its points move as c + R s, so with E = integral of s s^T dm = tr(I) / 2 - I, where I
is the matrix of inertia about c in the body's frame, the kinetic energy is that of a constant mass
matrix:

    T = m |cdot|^2 / 2 + tr(Rdot E Rdot^T) / 2.

So angular velocities need no coordinates, and gyroscopic moments follow from R(q) alone. Rotations
are right-handed.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.integrators.roots import Scalar
from walker_jax.multibody.system import Coordinates, System, times_masses, velocity

BODY = 12
"""Coordinates x of one body: its centre of mass and three axes."""
Place = Callable[[Coordinates], Float[Array, " 3"]]
Rotation = Callable[[Coordinates], Float[Array, "3 3"]]


def rotation_about(axis: int, angle: Scalar) -> Float[Array, "3 3"]:
    """Return the rotation by an angle about axis 0, 1 or 2."""
    c, s, one, zero = jnp.cos(angle), jnp.sin(angle), jnp.ones_like(angle), jnp.zeros_like(angle)
    entries = {(axis, axis): one}
    after, last = (axis + 1) % 3, (axis + 2) % 3
    entries |= {(after, after): c, (last, last): c, (after, last): -s, (last, after): s}
    return jnp.stack([jnp.stack([entries.get((i, j), zero) for j in range(3)]) for i in range(3)])


def body_coordinates(
    centre: Float[Array, " 3"], rotation: Float[Array, "3 3"]
) -> Float[Array, " 12"]:
    """Return x of a body: its centre of mass, and its axes one after the other."""
    return jnp.concatenate([centre, rotation.T.reshape(-1)])


def body_masses(
    masses: Sequence[Scalar], inertias: Sequence[Float[Array, "3 3"]]
) -> Float[Array, "x x"]:
    """Return M of rigid bodies, from their masses and matrices of inertia."""
    count = BODY * len(masses)
    zero = jnp.zeros_like(masses[0])
    entries = [[zero] * count for _ in range(count)]
    for number, (mass, inertia) in enumerate(zip(masses, inertias, strict=True)):
        half = (inertia[0, 0] + inertia[1, 1] + inertia[2, 2]) / 2
        first = BODY * number
        for axis in range(3):
            entries[first + axis][first + axis] = mass
            for i in range(3):
                for j in range(3):
                    spread = (half - inertia[i, i]) if i == j else -inertia[min(i, j), max(i, j)]
                    row, column = (first + 3 + 3 * k + axis for k in (i, j))
                    entries[row][column] = spread
    return jnp.stack([jnp.stack(row) for row in entries])


def body_weights(masses: Sequence[Scalar], gravity: Float[Array, " 3"]) -> Float[Array, " x"]:
    """Return forces f of a uniform gravity on bodies."""
    none = jnp.zeros(BODY - 3, gravity.dtype)
    return jnp.concatenate([part for mass in masses for part in (mass * gravity, none)])


def material_velocity(
    centre: Place, rotation: Rotation, point: Place, q: Coordinates, qdot: Coordinates
) -> Float[Array, " 3"]:
    """Compute the velocity of the material point of a body that is now at `point(q)`.

    It is zero for the contact of a body that rolls without slipping.
    """
    arm = rotation(q).T @ (point(q) - centre(q))
    return velocity(lambda q: centre(q) + rotation(q) @ arm, q, qdot)


def angular_velocity(rotation: Rotation, q: Coordinates, qdot: Coordinates) -> Float[Array, " 3"]:
    """Compute omega, with Rdot = [omega x] R."""
    spin = velocity(rotation, q, qdot) @ rotation(q).T
    return jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])


def momentum(system: System, q: Coordinates, qdot: Coordinates) -> Float[Array, " 3"]:
    """Compute the linear momentum of a system that consists of bodies in space."""
    moved = times_masses(system, velocity(system.transfer, q, qdot))
    return moved.reshape(-1, BODY)[:, :3].sum(axis=0)


def angular_momentum(
    system: System, q: Coordinates, qdot: Coordinates, about: Float[Array, " 3"]
) -> Float[Array, " 3"]:
    """Compute the angular momentum about a point of a system that consists of bodies in space."""
    places = system.transfer(q).reshape(-1, BODY // 3, 3).at[:, 0].add(-about)
    moved = times_masses(system, velocity(system.transfer, q, qdot)).reshape(places.shape)
    return jnp.cross(places, moved).sum(axis=(0, 1))
