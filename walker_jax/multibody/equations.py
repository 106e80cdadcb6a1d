"""The equations of motion (4), solved for one state."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from walker_jax.checks import WrongUse
from walker_jax.multibody.linear import block, check_pivots, factorise, solve_factored
from walker_jax.multibody.system import Coordinates, System, check_state, mass_matrix, reduced_force


class Motion(NamedTuple):
    """The solution of the equations of motion for one state."""

    accelerations: Coordinates
    """Second time derivatives of q, zero for held coordinates."""
    forces: Coordinates
    """Constraint forces Q of the held coordinates, dual to q; zero for free ones."""


def solve_motion(
    system: System, q: Coordinates, qdot: Coordinates, *, held: Sequence[int] = ()
) -> Motion:
    """Solve (4) for the accelerations, and for the forces that hold some coordinates.

    [F,q^T M F,q] qddot = F,q^T [f - M F,qq qdot qdot] + Q, where held coordinates do not accelerate
    and Q are their constraint forces.

    **Arguments:**

    - `system`: any.
    - `q`, `qdot`: coordinates and rates.
    - `held`: indices of the held coordinates, such as those of a foot on the ground.

    Raises `ValueError`, which names the coordinate, if the mass matrix of the free coordinates is
    singular or ill-conditioned (`WORST_PIVOT`). Under a JAX transformation, which cannot raise, the
    results are NaN instead.
    """
    check_state(system, q, qdot)
    held = held_coordinates(held, len(q))
    free = [i for i in range(len(q)) if i not in held]
    matrix, force = mass_matrix(system, q), reduced_force(system, q, qdot)
    accelerations = [jnp.zeros((), q.dtype)] * len(q)
    solution = solve_factored(factorise(block(matrix, free)), [force[i] for i in free])
    for i, value in zip(free, solution, strict=True):
        accelerations[i] = value
    accelerations = jnp.stack(accelerations)
    holding = matrix @ accelerations - force
    forces = jnp.stack([holding[i] if i in held else jnp.zeros((), q.dtype) for i in range(len(q))])
    check_pivots("mass matrix", matrix, free, "coordinate q", q)
    return Motion(accelerations, forces)


def held_coordinates(held: Sequence[int], count: int) -> list[int]:
    """Return the indices of the held coordinates, counted from 0, sorted and each once."""
    numbers = {operator.index(i) for i in held}
    if any(not -count <= i < count for i in numbers):
        raise WrongUse(f"held must be numbers of {count} coordinates, not {sorted(numbers)}")
    return sorted({i % count for i in numbers})
