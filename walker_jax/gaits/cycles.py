"""Gaits as cycles of strides: their equations, solution and Floquet multipliers."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from walker_jax.checks import WrongUse, check_kind
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.gait_tables import gait_table
from walker_jax.gaits.implicit_roots import find_root
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.kernels.primitive import vary_together
from walker_jax.systems.angles import Turns, difference, turn_to, turns_of
from walker_jax.systems.outcomes import nan_unless
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walkers.parameters import as_tangent, parameter_directions
from walker_jax.walking.iteration import broadcast_parameters
from walker_jax.walking.stride import follow_stride

MAX_RESIDUAL = {jnp.dtype("float64"): 1e-10, jnp.dtype("float32"): 1e-4}
"""Largest residual of a gait: above the rounding errors of a stride, below the distance between two
gaits."""
SAME_STATE_DISTANCE = {jnp.dtype("float64"): 1e-8, jnp.dtype("float32"): 1e-3}
"""States closer than this in every coordinate count as one."""
MAX_SEARCH_STEPS = 40
"""Newton steps of a search: a few do near a gait, where it converges quadratically."""
FEW_STRIDES = 128
"""Most strides for which all columns are computed at once: a second call would cost more."""


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
    _repr_html_ = gait_table

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
    walker: System,
    states: Float[np.ndarray, "period section"],
    ends: Float[np.ndarray, "period section"],
    within: float,
) -> None:
    """Raise `WrongUse` if strides from a gait's states end elsewhere, as for another walker."""
    miss = np.abs(difference(ends, np.roll(states, -1, axis=0), turns_of(walker))).max()
    if not miss < within:
        raise WrongUse(
            f"gait must be one of this walker, whose strides miss it by {miss:.2g}: find_gait "
            "gives one"
        )


def cycle_distance(
    one: Float[np.ndarray, "period section"],
    other: Float[np.ndarray, "other section"],
    turns: Turns = None,
) -> float:
    """Return the largest difference of a coordinate of two cycles; infinite for different periods.

    The cycles are rotated so that it is smallest. It is 0 for two cycles without a state.
    """
    if one.shape != other.shape:
        return np.inf
    turned = (np.roll(other, shift, axis=0) for shift in range(len(other)))
    apart = (np.abs(difference(one, cycle, turns)) for cycle in turned)
    return min((float(each.max()) for each in apart), default=0.0)


@jax.jit
def solve_cycle(
    walker: System, states: Float[Array, "period section"], integrator: Integrator
) -> Gait:
    """Find a gait by Newton's iteration on all states of a cycle."""
    walker, states, integrator = vary_together((walker, states, integrator))
    dtype, turns = states.dtype, turns_of(walker)
    mismatch = lambda states: cycle_mismatch(states, (walker, integrator))
    states = find_root(mismatch, states, MAX_SEARCH_STEPS)
    apply = lambda states: apply_strides(walker, states, integrator)
    (ends, times), derivative = jax.linearize(apply, states)
    basis, _ = vary_together((jnp.eye(states.shape[1], dtype=dtype), states))
    apply_jacobian = lambda direction: derivative(jnp.broadcast_to(direction, states.shape))[0]
    jacobian = basis
    for factor in jax.vmap(apply_jacobian, out_axes=2)(basis):
        jacobian = factor @ jacobian
    multipliers = eigenvalues(jacobian)
    multipliers = multipliers[jnp.lexsort((-multipliers.imag, -jnp.abs(multipliers)))]
    residual = largest(jnp.abs(difference(ends, jnp.roll(states, -1, axis=0), turns)))
    found = (residual < MAX_RESIDUAL[dtype]) & ~has_shorter_period(states, turns)
    unit, _ = vary_together((jnp.eye(states.size, dtype=dtype).reshape(-1, *states.shape), states))
    rows = jax.vmap(lambda change: derivative(change)[0] - jnp.roll(change, -1, axis=0))(unit)
    found &= (
        estimate_error(residual, rows.reshape(states.size, -1)) < SAME_STATE_DISTANCE[dtype] / 10
    )
    return Gait(
        states=nan_unless(found, turn_to(states, jnp.roll(ends, 1, axis=0), turns)),
        multipliers=nan_unless(found, multipliers),
        step_times=nan_unless(found, times),
        stable=found & (jnp.abs(multipliers[0]) < 1),
        residual=residual,
        found=found,
    )


def iterate_newton(
    walker: System,
    cycles: Float[np.ndarray, "n period section"],
    integrator: Integrator,
    steps: int = MAX_SEARCH_STEPS,
) -> Gait:
    """Iterate Newton's method from n guesses of cycles; the first axis of each field is n.

    The walker's parameters may be arrays of n. A search ends once its residual is rounding, or a
    state makes no stride.
    """
    (n, period, size), turns = cycles.shape, turns_of(walker)
    cycles = cycles.copy()
    best = Gait(
        states=cycles.copy(),
        multipliers=np.full((n, size), np.nan, np.result_type(cycles, np.complex64)),
        step_times=np.full((n, period), np.nan, cycles.dtype),
        stable=np.zeros(n, bool),
        residual=np.full(n, np.nan, cycles.dtype),
        found=np.zeros(n, bool),
    )
    jacobians = np.full((n, period, size, size), np.nan, cycles.dtype)
    active = np.flatnonzero(np.isfinite(cycles).all(axis=(1, 2)))
    rounding = 10 * float(np.finfo(cycles.dtype).eps)
    for _ in range(steps):
        local = linearise(select(walker, active), cycles[active], integrator)
        mismatch = difference(local.state, np.roll(cycles[active], -1, axis=1), turns)
        residual = np.abs(mismatch).max(axis=(1, 2))
        # near rounding errors a step no longer reduces the residual
        better = ~(residual >= best.residual[active]) & np.isfinite(residual)
        improved = active[better]
        ends = np.roll(local.state[better], 1, axis=1)
        best.states[improved] = turn_to(cycles[improved], ends, turns)
        best.residual[improved] = residual[better]
        best.step_times[improved] = local.time[better]
        jacobians[improved] = local.jacobian[better]
        close = best.residual[active] < MAX_RESIDUAL[cycles.dtype]
        ended = (residual <= rounding) | (~better & close)
        going = np.isfinite(residual) & ~ended
        active, mismatch, jacobian = active[going], mismatch[going], local.jacobian[going]
        if len(active) == 0:
            break
        step = solve_linear_systems(cycle_matrices(jacobian), -mismatch.reshape(len(active), -1))
        cycles[active] += step.reshape(len(active), period, size)
    known = np.flatnonzero(np.isfinite(best.residual))
    best.multipliers[known] = find_multipliers(multiply_jacobians(jacobians[known]))
    near = (best.residual < MAX_RESIDUAL[cycles.dtype]) & ~has_shorter_period(best.states, turns)
    with np.errstate(divide="ignore"):
        error = estimate_error(best.residual[near], cycle_matrices(jacobians[near]))
    best.found[near] = error < SAME_STATE_DISTANCE[cycles.dtype] / 10
    best.stable[:] = best.found & (np.abs(best.multipliers[:, 0]) < 1)
    return best


class Linearisation(NamedTuple):
    """Strides from n cycles of states, with the derivatives of their ends."""

    state: Float[np.ndarray, "n period section"]
    """Ends of the strides; NaN where one fails."""
    time: Float[np.ndarray, "n period"]
    """Durations of the strides, in the unit of time."""
    jacobian: Float[np.ndarray, "n period section section"]
    """Jacobian J of each stride: derivatives of its end by its start; NaN where it fails."""
    by_parameter: Float[np.ndarray, "n period section"]
    """Derivatives of the ends by the parameter; zero if none is given."""
    of_time: Float[np.ndarray, "n period columns"]
    """Derivatives of the durations by the coordinates of the start, then by the parameter."""


def linearise(
    walker: System,
    cycles: Float[np.ndarray, "n period section"],
    integrator: Integrator,
    parameter: str | None = None,
) -> Linearisation:
    """Make one stride from each state, with its derivatives; each column is a cell of its own.

    The walker's parameters may be arrays of n. The first column shows which states make a stride.
    The other columns are computed for these alone, unless there are few states.
    """
    size, names = cycles.shape[2], [] if parameter is None else [parameter]
    shared = integrator.in_dtype(cycles.dtype), parameter_directions(walker, names, cycles.dtype)
    directions = np.eye(size + (parameter is not None), size + 1, dtype=cycles.dtype)
    walkers, starts = repeat_cells(walker, cycles, 1)

    def differentiate(columns, which):
        each = lambda leaf: np.repeat(leaf[which], len(columns), axis=0)
        cells = *jax.tree.map(each, (walkers, starts)), np.tile(columns, (len(which), 1))
        (state, time), changes = map_cells(jvp, (shared, cells))
        return state, time, np.column_stack(changes)

    by = np.full((len(starts), len(directions), size + 1), np.nan, cycles.dtype)
    first = len(directions) if len(starts) <= FEW_STRIDES else 1
    state, time, changes = differentiate(directions[:first], np.arange(len(starts)))
    state, time = state[::first], time[::first]
    by[:, :first] = changes.reshape(len(starts), first, size + 1)
    if first < len(directions):
        walking = np.flatnonzero(np.isfinite(state).all(axis=1))
        *_, others = differentiate(directions[1:], walking)
        by[walking, 1:] = others.reshape(len(walking), len(directions) - 1, size + 1)
    shaped = lambda values: values.reshape(*cycles.shape[:2], *values.shape[1:])
    return Linearisation(
        state=shaped(state),
        time=shaped(time),
        jacobian=np.swapaxes(shaped(by[:, :size, :size]), 2, 3),
        by_parameter=shaped(by[:, size, :size]) if parameter else np.zeros_like(cycles),
        of_time=shaped(by[..., size]),
    )


def repeat_cells(
    walker: System, cycles: Float[np.ndarray, "n period section"], columns: int
) -> tuple[System, Float[np.ndarray, "cells section"]]:
    """Repeat the walker and the start of every stride of the cycles, once for each column."""
    n, period, size = cycles.shape
    walkers = broadcast_parameters(walker, n, cycles.dtype)
    return (
        jax.tree.map(lambda leaf: np.repeat(leaf, period * columns, axis=0), walkers),
        np.repeat(cycles.reshape(-1, size), columns, axis=0),
    )


def jvp(shared: tuple[Integrator, System], cell):
    """Return the stride of one cell, and its derivative along a direction (start, parameters)."""
    (integrator, axes), (walker, x, direction) = shared, cell
    tangents = split(axes, walker, x, direction)
    return jax.jvp(partial(timed_stride, integrator), (walker, x), tangents)


def split(axes: System, walker: System, x: Float[Array, " section"], direction: Array):
    """Split a direction into those of the walker and of the start."""
    along = lambda leaf: jnp.sum((leaf.T * direction[x.size :]).T, axis=0)
    return as_tangent(walker, jax.tree.map(along, axes)), direction[: x.size]


def timed_stride(integrator: Integrator, walker: System, x: Float[Array, " section"]):
    result = follow_stride(walker, x, integrator)
    return result.state, result.time


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
    return difference(ends, jnp.roll(states, -1, axis=0), turns_of(walker))


def apply_strides(
    walker: System, states: Float[Array, "n section"], integrator: Integrator
) -> tuple[Float[Array, "n section"], Float[Array, " n"]]:
    """Return the ends of strides, and their durations."""
    return jax.vmap(timed_stride, (None, None, 0))(integrator, walker, states)


def estimate_error(residual, matrix):
    """Bound the distance from the states of a cycle to those of a gait.

    The bound is (residual + rounding) / (smallest singular value of the matrix): the change of the
    solution of the linear equations of Newton's iteration.
    """
    linalg = jnp.linalg if isinstance(matrix, jax.Array) else np.linalg
    smallest = linalg.svd(matrix, compute_uv=False)[..., -1]
    return (residual + 4 * float(jnp.finfo(residual.dtype).eps)) / smallest


def has_shorter_period(states, turns: Turns = None) -> Bool[Array | np.ndarray, "..."]:
    """Return whether cycles, shape (..., period, section), repeat within their period."""
    period, numpy = states.shape[-2], jnp if isinstance(states, jax.Array) else np
    shorter = numpy.zeros(states.shape[:-2], bool)
    for shift in range(1, period):
        if period % shift == 0:
            change = difference(states, numpy.roll(states, shift, axis=-2), turns)
            same = numpy.abs(change) < SAME_STATE_DISTANCE[jnp.dtype(states.dtype)]
            shorter = shorter | same.all(axis=(-2, -1))
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
