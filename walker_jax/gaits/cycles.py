"""Gaits as cycles of strides: their equations, solution and Floquet multipliers."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from walker_jax.checks import WrongUse, check_kind
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.systems.outcomes import nan_unless
from walker_jax.systems.system import System
from walker_jax.walking.stride import follow_stride

MAX_RESIDUAL = {jnp.dtype("float64"): 1e-10, jnp.dtype("float32"): 1e-4}
"""Largest residual of a gait: above the rounding errors of a stride, below the distance between two
gaits."""
SAME_STATE_DISTANCE = {jnp.dtype("float64"): 1e-8, jnp.dtype("float32"): 1e-3}
"""States closer than this in every coordinate count as one: a hundred times the largest residual
in float64, ten times in float32."""
MAX_SEARCH_STEPS = 40
"""Newton steps of a search. Near a gait the iteration converges quadratically, in a few steps; a
search that takes more than this is far from any gait."""


class Gait(NamedTuple):
    """A cycle of strides, or the end of a search that found none."""

    states: Float[Array | np.ndarray, "period section"]
    """Start of each stride."""
    multipliers: Complex[Array | np.ndarray, " section"]
    """Floquet multipliers: eigenvalues of the Jacobian of the cycle, the largest first."""
    step_times: Float[Array | np.ndarray, " period"]
    """Duration of each stride, in the unit of time."""
    stable: Bool[Array | np.ndarray, ""]
    """Whether this is a gait with all multipliers inside the unit circle."""
    residual: Float[Array | np.ndarray, ""]
    """Largest distance, in any coordinate, from the end of a stride to the next state."""
    found: Bool[Array | np.ndarray, ""]
    """Whether this is a gait of its period and no shorter one, repeated by a walk over the period.

    It is false if the residual exceeds rounding, or if rounding errors could move the states
    noticeably, as they do within about 1e-9 of a bifurcation with a multiplier of 1.
    """

    @property
    def return_strides(self) -> Float[Array, ""]:
        """Characteristic return time, in strides, in which small disturbances shrink by a factor e.

        -period / log |largest multiplier|; infinite if the gait is not stable, NaN if not found.
        """
        rate = -jnp.log(jnp.abs(self.multipliers[0])) / len(self.states)
        return jnp.where(rate <= 0, jnp.inf, 1 / jnp.where(rate <= 0, 1, rate))


def check_found(gait: Any) -> None:
    """Refuse anything that is not a gait, including the result of a failed search."""
    check_kind("gait", gait, Gait)
    if not gait.found:
        raise WrongUse(
            "gait must be one that was found, not the end of a failed search: give find_gait "
            "another guess"
        )


def check_cycle(
    states: Float[np.ndarray, "period section"],
    ends: Float[np.ndarray, "period section"],
    within: float,
) -> None:
    """Raise `WrongUse` if strides from a gait's states end elsewhere, as for another walker."""
    miss = np.abs(ends - np.roll(states, -1, axis=0)).max()
    if not miss < within:
        raise WrongUse(
            f"gait must be one of this walker, whose strides miss it by {miss:.2g}: find_gait "
            "gives one"
        )


def cycle_distance(
    one: Float[np.ndarray, "period section"], other: Float[np.ndarray, "other section"]
) -> float:
    """Return the largest difference of a coordinate of two cycles; infinite for different periods.

    The cycles are rotated so that it is smallest. It is 0 for two cycles without a state.
    """
    if one.shape != other.shape:
        return np.inf
    turned = (np.roll(other, shift, axis=0) for shift in range(len(other)))
    return min((float(np.abs(one - cycle).max()) for cycle in turned), default=0.0)


def clear_values(gait: Gait) -> Gait:
    """Return a failed search with NaN for its states, multipliers and step times."""
    states, multipliers, times = (np.full_like(x, np.nan) for x in gait[:3])
    return gait._replace(states=states, multipliers=multipliers, step_times=times)


@jax.jit
def solve_cycle(
    walker: System, states: Float[Array, "period section"], integrator: Integrator
) -> Gait:
    """Find a gait by Newton's iteration on all states of a cycle."""
    dtype = states.dtype
    accuracy = 500 * float(jnp.finfo(dtype).eps)
    solution = optimistix.root_find(
        cycle_mismatch,
        optimistix.Newton(rtol=accuracy, atol=accuracy),
        states,
        args=(walker, integrator),
        max_steps=MAX_SEARCH_STEPS,
        throw=False,
    )
    states = solution.value
    apply = lambda states: apply_strides(walker, states, integrator)
    (ends, times), derivative = jax.linearize(apply, states)
    basis = jnp.eye(states.shape[1], dtype=dtype)
    apply_jacobian = lambda direction: derivative(jnp.broadcast_to(direction, states.shape))[0]
    jacobian = basis
    for factor in jax.vmap(apply_jacobian, out_axes=2)(basis):
        jacobian = factor @ jacobian
    multipliers = eigenvalues(jacobian)
    multipliers = multipliers[jnp.lexsort((-multipliers.imag, -jnp.abs(multipliers)))]
    residual = jnp.abs(ends - jnp.roll(states, -1, axis=0)).max()
    found = (residual < MAX_RESIDUAL[dtype]) & ~has_shorter_period(states)
    unit = jnp.eye(states.size, dtype=dtype).reshape(-1, *states.shape)
    rows = jax.vmap(lambda change: derivative(change)[0] - jnp.roll(change, -1, axis=0))(unit)
    found &= (
        estimate_error(residual, rows.reshape(states.size, -1)) < SAME_STATE_DISTANCE[dtype] / 10
    )
    return Gait(
        states=nan_unless(found, states),
        multipliers=nan_unless(found, multipliers),
        step_times=nan_unless(found, times),
        stable=found & (jnp.abs(multipliers[0]) < 1),
        residual=residual,
        found=found,
    )


def eigenvalues(matrix: Float[Array, "n n"]) -> Complex[Array, " n"]:
    """Return the eigenvalues of a matrix; distinct ones have derivatives up to the third order.

    LAPACK finds them. They are the roots of the characteristic polynomial (Faddeev and LeVerrier),
    and two Newton steps on it give their dependence on the matrix.
    """
    n = len(matrix)
    minors, coefficients = jnp.zeros_like(matrix), [jnp.ones_like(matrix[0, 0])]
    for k in range(1, n + 1):
        minors = matrix @ minors + coefficients[-1] * jnp.eye(n, dtype=matrix.dtype)
        coefficients.append(-jnp.trace(matrix @ minors) / k)
    slopes = [(n - k) * c for k, c in enumerate(coefficients[:-1])]
    roots = jnp.linalg.eigvals(lax.stop_gradient(matrix))
    lower = lambda terms: [c.astype(roots.dtype) for c in terms[::-1]]
    remainder = lax.stop_gradient(evaluate_polynomial(lower(coefficients), roots))
    for _ in range(2):
        value = evaluate_polynomial(lower(coefficients), roots) - remainder
        roots = roots - value / evaluate_polynomial(lower(slopes), roots)
    return roots


def cycle_mismatch(
    states: Float[Array, "period section"], args: tuple[System, Integrator]
) -> Float[Array, "period section"]:
    """Return S(x_i) - x_{i+1} for the states of a cycle; zero for a gait."""
    walker, integrator = args
    ends, _ = apply_strides(walker, states, integrator)
    return ends - jnp.roll(states, -1, axis=0)


def apply_strides(
    walker: System, states: Float[Array, "n section"], integrator: Integrator
) -> tuple[Float[Array, "n section"], Float[Array, " n"]]:
    """Return the ends of strides, and their durations."""
    ends = jax.vmap(follow_stride, (None, 0, None))(walker, states, integrator)
    return ends.state, ends.time


def estimate_error(residual, matrix):
    """Bound the distance from the states of a cycle to those of a gait.

    The bound is (residual + rounding) / (smallest singular value of the matrix): the change of the
    solution of the linear equations of Newton's iteration.
    """
    linalg = jnp.linalg if isinstance(matrix, jax.Array) else np.linalg
    smallest = linalg.svd(matrix, compute_uv=False)[..., -1]
    return (residual + 4 * float(jnp.finfo(residual.dtype).eps)) / smallest


def has_shorter_period(states) -> Bool[Array | np.ndarray, "..."]:
    """Return whether cycles, shape (..., period, section), repeat within their period."""
    period, numpy = states.shape[-2], jnp if isinstance(states, jax.Array) else np
    shorter = numpy.zeros(states.shape[:-2], bool)
    for shift in range(1, period):
        if period % shift == 0:
            change = numpy.abs(states - numpy.roll(states, shift, axis=-2)).max(axis=(-2, -1))
            shorter = shorter | (change < SAME_STATE_DISTANCE[jnp.dtype(states.dtype)])
    return shorter


def gait_at(gaits: Gait, index: int | np.integer | Bool[np.ndarray, " n"]) -> Gait:
    """Select one of many gaits, or some of them."""
    return Gait(*(field[index] for field in gaits))


def cycle_matrices(
    jacobians: Float[np.ndarray, "n period section section"], multiplier: float = 1.0
) -> Float[np.ndarray, "n size size"]:
    """Return the matrices of x -> (J_i x_i - x_{i+1}) over a cycle, x_{k+1} = multiplier x_1."""
    n, period, size, _ = jacobians.shape
    matrix = np.zeros((n, period, size, period, size), jacobians.dtype)
    for i in range(period):
        following = (i + 1) % period
        matrix[:, i, :, i] += jacobians[:, i]
        matrix[:, i, :, following] -= np.eye(size) * (1.0 if following else multiplier)
    return matrix.reshape(n, period * size, period * size)


def solve_linear_systems(
    matrices: Float[np.ndarray, "n size size"], vectors: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "n size"]:
    """Solve many linear systems; singular ones by least squares."""
    solutions = np.empty_like(vectors)
    singular = np.linalg.det(matrices) == 0
    regular, right = matrices[~singular], vectors[..., None]
    solutions[~singular] = np.linalg.solve(regular, right[~singular])[..., 0]
    solutions[singular] = (np.linalg.pinv(matrices[singular]) @ right[singular])[..., 0]
    return solutions


def multiply_jacobians(
    jacobians: Float[np.ndarray, "n period section section"],
) -> Float[np.ndarray, "n section section"]:
    """Return the Jacobians of whole cycles, J_k ... J_1."""
    cycle_jacobians = jacobians[:, 0]
    for i in range(1, jacobians.shape[1]):
        cycle_jacobians = jacobians[:, i] @ cycle_jacobians
    return cycle_jacobians


def find_multipliers(
    cycle_jacobians: Float[np.ndarray, "n section section"],
) -> Complex[np.ndarray, "n section"]:
    """Return the eigenvalues of the Jacobians of whole cycles, the largest first."""
    values = np.linalg.eigvals(cycle_jacobians)
    values = values.astype(np.result_type(cycle_jacobians, np.complex64))
    return np.take_along_axis(values, order_by_modulus(values), axis=-1)


def order_by_modulus(values: Complex[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    """Sort multipliers along the last axis, the upper one of a conjugate pair first: indices."""
    return np.lexsort((-np.imag(values), -np.abs(values)), axis=-1)


def remove_duplicates(gaits: Gait) -> Gait:
    """Return each gait found once, from its state with the smallest first coordinate."""
    found = gait_at(gaits, np.asarray(gaits.found))
    states, times = np.asarray(found.states), np.asarray(found.step_times)
    first = states[..., 0].argmin(axis=1)
    order_in_cycle = (first[:, None] + np.arange(states.shape[1])) % states.shape[1]
    rotated = np.take_along_axis(states, order_in_cycle[..., None], axis=1)
    times = np.take_along_axis(times, order_in_cycle, axis=1)
    found = found._replace(states=rotated, step_times=times)
    order = np.argsort(rotated[:, 0, 0], kind="stable")
    kept = []
    while len(order):
        kept.append(order[0])
        far = (
            np.abs(rotated[order] - rotated[order[0]]).max(axis=(1, 2))
            > SAME_STATE_DISTANCE[states.dtype]
        )
        order = order[far]
    return Gait(*(field[kept] for field in found))
