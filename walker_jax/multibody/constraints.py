"""Constraints on rates, a(q, qdot) = A(q) qdot = 0, for rolling, sliding on an edge, or holding.

Constraints on coordinates, g(q) = 0, are of this kind too, by their rates: A = g,q. Others are
called nonholonomic. By Jourdain's principle constraint forces have no power in any rates that the
constraints allow. With multipliers lambda, the forces dual to a,

    [F,q^T M F,q] qddot = F,q^T [f - M F,qq qdot qdot] + Q + A^T lambda,
    A qddot = -A,q qdot qdot.

`solve_constrained` solves these for one state. Integrated, they would keep a = 0 to the errors of
the integration; the equations of `independent_rates` keep it to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.multibody.equations import held_coordinates
from walker_jax.multibody.linear import block, check_pivots, factorise, solve_factored
from walker_jax.multibody.system import (
    Coordinates,
    System,
    check_state,
    mass_matrix,
    reduced_force,
)

RateConstraints = Callable[[Coordinates, Coordinates], Float[Array, " a"]]
"""a(q, qdot), linear in the rates, which must be zero."""


class ConstrainedSolution(NamedTuple):
    """The solution of the equations of motion with constraints on rates, for one state."""

    accelerations: Coordinates
    """Second time derivatives of q, zero for held coordinates."""
    forces: Coordinates
    """Constraint forces of the held coordinates, dual to q; zero for free ones."""
    multipliers: Float[Array, " a"]
    """Forces of the constraints on the system, dual to a."""


def rate_matrix(
    constraints: RateConstraints, q: Coordinates, qdot: Coordinates
) -> Float[Array, "a q"]:
    """Return A(q), column by column. Raises `WrongUse` where a is not an array of shape (a,)."""
    if len(shape := jax.eval_shape(constraints, q, qdot).shape) != 1:
        raise WrongUse(f"constraints must return an array of shape (a,), not {shape}")
    directions = np.eye(len(q), dtype=q.dtype)
    return jnp.stack([constraints(q, jnp.asarray(one)) for one in directions], axis=1)


def convective_rates(
    constraints: RateConstraints, q: Coordinates, qdot: Coordinates
) -> Float[Array, " a"]:
    """Return A,q qdot qdot, the part of the time derivative of a without accelerations."""
    return jax.jvp(lambda q: constraints(q, qdot), (q,), (qdot,))[1]


def solve_constrained(
    system: System,
    constraints: RateConstraints,
    q: Coordinates,
    qdot: Coordinates,
    *,
    held: Sequence[int] = (),
) -> ConstrainedSolution:
    """Solve for the accelerations and constraint forces of a system whose rates are constrained.

    **Arguments:**

    - `system`, `q`, `qdot`, `held`: as in `solve_motion`. The rates must obey the constraints.
    - `constraints`: a, from (q, qdot) to shape (a,), linear in qdot.

    Raises `ValueError` as `solve_motion` does, also if constraints depend on each other, or leave
    nothing free. Under a JAX transformation, results are NaN instead.
    """
    check_state(system, q, qdot)
    held = held_coordinates(held, len(q))
    free = [i for i in range(len(q)) if i not in held]
    matrix, force = mass_matrix(system, q), reduced_force(system, q, qdot)
    A = rate_matrix(constraints, q, qdot)
    factors, count = factorise(block(matrix, free)), len(A)
    responses = [solve_factored(factors, [row[i] for i in free]) for row in A]
    unconstrained = solve_factored(factors, [force[i] for i in free])
    along = lambda row, values: sum(row[i] * v for i, v in zip(free, values, strict=True))
    inertia = jnp.stack([jnp.stack([along(row, one) for one in responses]) for row in A])
    missing = convective_rates(constraints, q, qdot)
    right = [-missing[k] - along(A[k], unconstrained) for k in range(count)]
    multipliers = solve_factored(factorise(block(inertia, range(count))), right)
    zero = jnp.zeros((), q.dtype)
    accelerations = [zero] * len(q)
    for place, i in enumerate(free):
        pushed = [multipliers[k] * responses[k][place] for k in range(count)]
        accelerations[i] = sum(pushed, unconstrained[place])
    accelerations, found = jnp.stack(accelerations), jnp.stack(multipliers)
    holding = matrix @ accelerations - force - found @ A
    forces = jnp.stack([holding[i] if i in held else zero for i in range(len(q))])
    check_pivots("mass matrix", matrix, free, "coordinate q", q)
    check_pivots("inverse inertia of the constraints", inertia, range(count), "constraint a", q)
    return ConstrainedSolution(accelerations, forces, found)
