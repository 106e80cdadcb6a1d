"""Equations of motion and of impact of a multibody system, from the positions of its masses.

The method is that of Schwab and Wisse (2001, sections 3.1 and 3.2), whose equation numbers are
cited. A system is given by its transfer function x = F(q), from generalised coordinates q to the
coordinates x of its masses: those of point masses in the plane or in space, and the angles of rigid
bodies in the plane, whose masses are moments of inertia. JAX differentiates F.

q, its rates and their dual forces are arrays with one number for each generalised coordinate. Units
are the user's own. Every function is pure and takes one configuration, to be mapped by `jax.vmap`;
over thousands of configurations, `scalars.unroll` makes it fastest.
"""

import operator
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.integrators.solvers import Real
from walker_jax.kernels.scalars import unroll

Coordinates = Float[Array, " q"]
WORST_PIVOT = {jnp.dtype("float64"): 1e-11, jnp.dtype("float32"): 1e-4}
"""Smallest pivot of a mass matrix, relative to its diagonal entry.

The pivot is what is left of a coordinate's inertia once those before it are eliminated. Below this
bound a result would have at most some five correct digits.
"""


class System(eqx.Module):
    """Masses, their positions, and the forces on them.

    **Arguments:**

    - `transfer`: F, from q to x, of shape (x,).
    - `masses`: one for each entry of x, the diagonal of M in (5): the mass of a point for each of
      its coordinates, the moment of inertia of a planar body for its angle. None negative.
    - `forces`: f, applied to the masses, of the shape of x. Constant, as gravity is.
    - `generalised_forces`: Q, dual to q, as a function of (q, qdot): springs, dampers, motors.
      By default there is none.
    """

    transfer: Callable[[Coordinates], Float[Array, " x"]]
    masses: Float[Array, " x"]
    forces: Float[Array, " x"]
    generalised_forces: Callable[[Coordinates, Coordinates], Coordinates] | None = None

    def __check_init__(self):
        if not isinstance(self.masses, Tracer):
            masses = np.asarray(self.masses)
            if not (np.isfinite(masses) & (masses >= 0)).all():
                raise WrongUse(f"masses must be finite and not negative, not {masses.tolist()}")


class Motion(NamedTuple):
    """The solution of the equations of motion for one state."""

    accelerations: Coordinates
    """Second time derivatives of q, zero for held coordinates."""
    forces: Coordinates
    """Constraint forces Q of the held coordinates, dual to q; zero for free ones."""


class Impact(NamedTuple):
    """Velocities after an impact, and its impulses."""

    velocities: Coordinates
    """Time derivative of q after the impact."""
    impulses: Float[Array, " g"]
    """Impulses of the contact on the system, dual to the contact function."""


def mass_matrix(system: System, q: Coordinates) -> Float[Array, "q q"]:
    """The reduced mass matrix, F,q^T M F,q, (10)."""
    slopes = jacobian(system.transfer, q)
    return slopes.T @ (system.masses[:, None].astype(q.dtype) * slopes)


def reduced_force(system: System, q: Coordinates, qdot: Coordinates) -> Coordinates:
    """The reduced force, F,q^T (f - M F,qq qdot qdot) + Q, (10)."""
    return virtual_power(system, q, qdot, convective_acceleration(system.transfer, q, qdot))


def virtual_power(
    system: System, q: Coordinates, qdot: Coordinates, acceleration: Float[Array, " x"]
) -> Coordinates:
    """F,q^T [f - M xddot] + Q, (2): zero for every coordinate that is free to move."""
    # Unrolling computes equal terms of F once, and their products with the balance too.
    _, transposed = jax.vjp(unroll(system.transfer), q)
    masses, forces = system.masses.astype(q.dtype), system.forces.astype(q.dtype)
    (power,) = transposed(forces - masses * acceleration)
    if system.generalised_forces is not None:
        power = power + system.generalised_forces(q, qdot)
    return power


def jacobian(function: Callable, q: Coordinates) -> Float[Array, "x q"]:
    """F,q, column by column."""
    directions = np.eye(len(q), dtype=q.dtype)
    return jnp.stack([velocity(function, q, direction) for direction in directions], axis=1)


def velocity(function: Callable, q: Coordinates, qdot) -> Float[Array, " x"]:
    """xdot = F,q qdot, (3)."""
    return jax.jvp(function, (q,), (jnp.asarray(qdot),))[1]


def convective_acceleration(
    function: Callable, q: Coordinates, qdot: Coordinates
) -> Float[Array, " x"]:
    """The part F,qq qdot qdot of the acceleration that velocities alone cause, (3)."""
    return jax.jvp(lambda q: velocity(function, q, qdot), (q,), (qdot,))[1]


def solve_motion(
    system: System, q: Coordinates, qdot: Coordinates, *, held: Sequence[int] = ()
) -> Motion:
    """Solves (4) for the accelerations, and for the forces that hold some coordinates.

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


def impact(
    system: System,
    contact: Callable[[Coordinates], Float[Array, " g"]],
    q: Coordinates,
    qdot: Coordinates,
    *,
    restitution: Real = 0.0,
) -> Impact:
    """Velocities after an impact, and its impulses, from (17).

    A contact closes where its contact function g(q), (11), becomes zero. All coordinates are free,
    and positions do not change. With rho the impulses of the contact on the system,

        [F,q^T M F,q] qdot+ = [F,q^T M F,q] qdot- + g,q^T rho,    (15)
        g,q qdot+ = -e g,q qdot-.                                 (16)

    (15) is printed with the opposite sign of rho; the sign here is that of (19). Inserting qdot+
    from the first in the second gives g,q [F,q^T M F,q]^-1 g,q^T rho = -(1 + e) g,q qdot-.

    **Arguments:**

    - `system`: any. The forces on it have no effect.
    - `contact`: g, from q to shape (g,): all contacts that close at the same time.
    - `q`, `qdot`: coordinates, and rates before the impact.
    - `restitution`: e, from 0, no bounce, to 1, no loss of energy.

    Raises `ValueError` as `solve_motion` does, also if contacts depend on each other, and for a
    restitution that is not between 0 and 1. Under a JAX transformation, results are NaN instead.
    """
    check_state(system, q, qdot)
    if len(shape := jax.eval_shape(contact, q).shape) != 1:
        raise WrongUse(f"contact must return an array of shape (g,), not {shape}")
    if not isinstance(restitution, Tracer) and not 0 <= restitution <= 1:
        raise WrongUse(f"restitution must lie between 0 and 1, not be {restitution}")
    matrix, directions = mass_matrix(system, q), jacobian(contact, q)
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
    """Rates after an impulse dual to q, (15): [F,q^T M F,q] (qdot+ - qdot-) = impulse.

    All coordinates are free. NaN where the mass matrix is singular or ill-conditioned
    (`WORST_PIVOT`).
    """
    factors = factorise(block(mass_matrix(system, q), range(len(q))))
    return qdot + jnp.stack(solve_factored(factors, list(impulse)))


def kinetic_energy(system: System, q: Coordinates, qdot: Coordinates) -> Float[Array, ""]:
    """xdot^T M xdot / 2."""
    return jnp.sum(system.masses.astype(q.dtype) * velocity(system.transfer, q, qdot) ** 2) / 2


def potential_energy(system: System, q: Coordinates) -> Float[Array, ""]:
    """-f^T x, of the applied forces alone; zero at x = 0."""
    return -jnp.sum(system.forces * system.transfer(q))


def block(matrix: Float[Array, "n n"], places: Iterable[int]) -> list[list[Array]]:
    """The submatrix of rows and columns with the same indices."""
    places = list(places)
    return [[matrix[i, j] for j in places] for i in places]


class Factors(NamedTuple):
    """A = L D L^T, with V = L D."""

    L: list[list[Array]]
    """Below the diagonal."""
    V: list[list[Array]]
    """Below the diagonal."""
    inverse: list[Array]
    """1 / D, so that divisions are few: XLA repeats the computation of a shared divisor."""


def factorise(matrix: list[list[Array]]) -> Factors:
    """Factors of a symmetric positive definite matrix, which needs no pivoting.

    NaN if a pivot is too small (`WORST_PIVOT`).
    """
    n = len(matrix)
    factors = Factors([[] for _ in range(n)], [[] for _ in range(n)], [])
    L, V, inverse = factors
    for j in range(n):
        column = [matrix[i][j] - dot(L[j], V[i]) for i in range(j, n)]
        sound = column[0] > WORST_PIVOT[matrix[j][j].dtype] * matrix[j][j]
        inverse.append(jnp.where(sound, 1 / column[0], jnp.nan))
        for i in range(j + 1, n):
            V[i].append(column[i - j])
            L[i].append(column[i - j] * inverse[j])
    return factors


def solve_factored(factors: Factors, right: list[Array]) -> list[Array]:
    """A^-1 b: for two unknowns, two divisions and seven products in all."""
    L, V, inverse = factors
    n, y = len(inverse), []
    for i in range(n):
        y.append(right[i] - dot(L[i], y))
    x: list[Array] = []
    for i in reversed(range(n)):
        x.insert(0, (y[i] - dot([V[k][i] for k in range(i + 1, n)], x)) * inverse[i])
    return x


def dot(a: list[Array], b: list[Array]):
    """The inner product of two lists, up to the length of the shorter one."""
    terms = [x * y for x, y in zip(a, b, strict=False)]
    return sum(terms[1:], terms[0]) if terms else 0.0


def check_pivots(name: str, matrix: Array, places: Iterable[int], what: str, q) -> None:
    """Raises `WrongUse` for a matrix with too small a pivot, unless it is traced."""
    if isinstance(matrix, Tracer) or not np.isfinite(matrix).all():
        return
    places = list(places)
    worst, reduced = WORST_PIVOT[matrix.dtype], np.array(matrix)[np.ix_(places, places)]
    for k, (place, entry) in enumerate(zip(places, np.diag(reduced).copy(), strict=True)):
        pivot = reduced[k, k]
        if not pivot > worst * entry:
            kind = "ill-conditioned" if pivot > 0 else "singular"
            raise WrongUse(
                f"{name} is {kind} at q = {np.asarray(q).tolist()}: {what}[{place}] moves "
                f"{pivot:.3g} of its {entry:.3g} once those before it are given"
            )
        reduced[k + 1 :, k:] -= np.outer(reduced[k + 1 :, k] / pivot, reduced[k, k:])


def check_state(system: System, q: Coordinates, qdot: Coordinates) -> None:
    if q.ndim != 1 or qdot.shape != q.shape:
        raise WrongUse(f"q and qdot must have one shape (n,), not {q.shape} and {qdot.shape}")
    x = jax.eval_shape(system.transfer, q)
    if not x.shape == system.masses.shape == system.forces.shape:
        raise WrongUse(
            f"masses and forces must have the shape of F(q), {x.shape}, not "
            f"{system.masses.shape} and {system.forces.shape}"
        )
    if system.generalised_forces is not None:
        Q = jax.eval_shape(system.generalised_forces, q, qdot)
        if Q.shape != q.shape:
            raise WrongUse(f"generalised forces must have the shape of q, {q.shape}, not {Q.shape}")


def held_coordinates(held: Sequence[int], count: int) -> list[int]:
    """Indices of the held coordinates, counted from 0, sorted and each once."""
    numbers = {operator.index(i) for i in held}
    if any(not -count <= i < count for i in numbers):
        raise WrongUse(f"held must be numbers of {count} coordinates, not {sorted(numbers)}")
    return sorted({i % count for i in numbers})
