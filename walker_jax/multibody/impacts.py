"""Impacts: contacts that close at an instant, (15) to (17)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.integrators.roots import Real
from walker_jax.multibody.constraints import RateConstraints, rate_matrix
from walker_jax.multibody.linear import block, check_pivots, factorise, solve_factored
from walker_jax.multibody.system import Coordinates, System, check_state, jacobian, mass_matrix


class Impact(NamedTuple):
    """Velocities after an impact, and its impulses."""

    velocities: Coordinates
    """Time derivative of q after the impact."""
    impulses: Float[Array, " g"]
    """Impulses of the contact on the system, dual to the contact function."""


def impact(
    system: System,
    contact: Callable[[Coordinates], Float[Array, " g"]] | None,
    q: Coordinates,
    qdot: Coordinates,
    *,
    restitution: Real = 0.0,
    constraints: RateConstraints | None = None,
) -> Impact:
    """Compute velocities after an impact, and its impulses, from (17).

    A contact closes where its contact function g(q), (11), becomes zero. All coordinates are free,
    and positions do not change. With rho the impulses of the contact on the system,

        [F,q^T M F,q] qdot+ = [F,q^T M F,q] qdot- + g,q^T rho,    (15)
        g,q qdot+ = -e g,q qdot-.                                 (16)

    (15) is printed with the opposite sign of rho; the sign here is that of (19). Inserting qdot+
    from the first in the second gives g,q [F,q^T M F,q]^-1 g,q^T rho = -(1 + e) g,q qdot-.

    **Arguments:**

    - `system`: any. The forces on it have no effect.
    - `contact`: g, from q to shape (g,): all contacts that close at the same time. Earlier contacts
      are released, unless they are among them. None for constraints on rates alone.
    - `q`, `qdot`: coordinates, and rates before the impact.
    - `restitution`: e, from 0, no bounce, to 1, no loss of energy.
    - `constraints`: on rates, which hold from the impact on too, such as those of a disc that
      starts to roll: their A stands below g,q, and their impulses after those of g.

    Raises `ValueError` as `solve_motion` does, also if contacts depend on each other, and for a
    restitution that is not between 0 and 1. Under a JAX transformation, results are NaN instead.
    """
    check_state(system, q, qdot)
    if contact is None and constraints is None:
        raise WrongUse("contact must be given where there are no constraints, not None")
    if contact is not None and len(shape := jax.eval_shape(contact, q).shape) != 1:
        raise WrongUse(f"contact must return an array of shape (g,), not {shape}")
    if not isinstance(restitution, Tracer) and not 0 <= restitution <= 1:
        raise WrongUse(f"restitution must lie between 0 and 1, not be {restitution}")
    matrix = mass_matrix(system, q)
    closing_rates = [] if contact is None else [jacobian(contact, q)]
    closing_rates += [] if constraints is None else [rate_matrix(constraints, q, qdot)]
    directions = jnp.concatenate(closing_rates)
    factors, count = factorise(block(matrix, range(len(q)))), len(directions)
    # Changes of the rates by a unit impulse at each contact, [F,q^T M F,q]^-1 g,q^T.
    responses = jnp.stack([jnp.stack(solve_factored(factors, list(one))) for one in directions])
    inertia = directions @ responses.T
    e = jnp.asarray(restitution, q.dtype)
    closing = (1 + jnp.where((e >= 0) & (e <= 1), e, jnp.nan)) * (directions @ qdot)
    impulses = jnp.stack(solve_factored(factorise(block(inertia, range(count))), list(-closing)))
    check_pivots("mass matrix", matrix, range(len(q)), "coordinate q", q)
    check_pivots("inverse inertia of the contacts", inertia, range(count), "contact g", q)
    return Impact(qdot + responses.T @ impulses, impulses)


def push(system: System, q: Coordinates, qdot: Coordinates, impulse: Coordinates) -> Coordinates:
    """Return rates after an impulse dual to q, (15): [F,q^T M F,q] (qdot+ - qdot-) = impulse.

    All coordinates are free. NaN where the mass matrix is singular or ill-conditioned
    (`WORST_PIVOT`).
    """
    factors = factorise(block(mass_matrix(system, q), range(len(q))))
    return qdot + jnp.stack(solve_factored(factors, list(impulse)))
