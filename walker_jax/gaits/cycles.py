"""A gait as a cycle of strides: its equations, their solution, its multipliers."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.walkers.model import Walker
from walker_jax.walking.stepping import follow_stride

RESIDUAL = {jnp.dtype("float64"): 1e-10, jnp.dtype("float32"): 1e-4}
"""By how much a stride of what is called a gait may miss the next state."""
DISTINCT = {jnp.dtype("float64"): 1e-8, jnp.dtype("float32"): 1e-3}
"""States closer than this, in every coordinate, are one."""
NEWTON_STEPS = 40


class Gait(NamedTuple):
    """A cycle of strides; or what a search that found none ended with."""

    states: Float[Array | np.ndarray, "period section"]
    """Start of each stride."""
    multipliers: Complex[Array | np.ndarray, " section"]
    """Eigenvalues of the Jacobian of the cycle, the largest first."""
    step_times: Float[Array | np.ndarray, " period"]
    """Duration of each stride."""
    stable: Bool[Array | np.ndarray, ""]
    """Whether this is a gait with all multipliers inside the unit circle."""
    residual: Float[Array | np.ndarray, ""]
    """Largest distance, in any coordinate, from the end of a stride to the next state."""
    found: Bool[Array | np.ndarray, ""]
    """Whether this is a gait, of its period and no shorter one; a walk over the period repeats it.

    The residual is rounding, and rounding does not move the states: within about 1e-9 of a
    bifurcation with a multiplier of 1 it does, and nothing is found.
    """


def nowhere(gait: Gait) -> Gait:
    """NaN for what only a gait has."""
    states, multipliers, times = (np.full_like(x, np.nan) for x in gait[:3])
    return gait._replace(states=states, multipliers=multipliers, step_times=times)


@jax.jit
def solve_cycle(
    walker: Walker, states: Float[Array, "period section"], tolerance: Float[Array, ""]
) -> Gait:
    """Newton's iteration on all states of a cycle, and what there is to know of the result."""
    dtype = states.dtype
    accuracy = 500 * float(jnp.finfo(dtype).eps)
    solution = optimistix.root_find(
        mismatch,
        optimistix.Newton(rtol=accuracy, atol=accuracy),
        states,
        args=(walker, tolerance),
        max_steps=NEWTON_STEPS,
        throw=False,
    )
    states = solution.value
    along = lambda states: advance(walker, states, tolerance)
    (ends, times), derivative = jax.linearize(along, states)
    basis = jnp.eye(states.shape[1], dtype=dtype)
    one_by_one = lambda direction: derivative(jnp.broadcast_to(direction, states.shape))[0]
    jacobian = basis
    for factor in jax.vmap(one_by_one, out_axes=2)(basis):
        jacobian = factor @ jacobian
    multipliers = eigenvalues(jacobian)
    multipliers = multipliers[jnp.lexsort((-multipliers.imag, -jnp.abs(multipliers)))]
    residual = jnp.abs(ends - jnp.roll(states, -1, axis=0)).max()
    found = (residual < RESIDUAL[dtype]) & ~repeats(states)
    unit = jnp.eye(states.size, dtype=dtype).reshape(-1, *states.shape)
    rows = jax.vmap(lambda change: derivative(change)[0] - jnp.roll(change, -1, axis=0))(unit)
    found &= uncertainty(residual, rows.reshape(states.size, -1)) < DISTINCT[dtype] / 10
    # Multiplied, so that derivatives are NaN too.
    known = jnp.where(found, 1, jnp.nan).astype(dtype)
    return Gait(
        states=states * known,
        multipliers=multipliers * known.astype(multipliers.dtype),
        step_times=times * known,
        stable=found & (jnp.abs(multipliers[0]) < 1),
        residual=residual,
        found=found,
    )


def eigenvalues(matrix: Float[Array, "n n"]) -> Complex[Array, " n"]:
    """Eigenvalues of a matrix, with derivatives up to the third order where they are distinct.

    Those that LAPACK finds are roots of the characteristic polynomial (Faddeev and LeVerrier), and
    two steps of Newton's say how these depend on the matrix.
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
        miss = evaluate_polynomial(lower(coefficients), roots) - remainder
        roots = roots - miss / evaluate_polynomial(lower(slopes), roots)
    return roots


def mismatch(
    states: Float[Array, "period section"], args: tuple[Walker, Float[Array, ""]]
) -> Float[Array, "period section"]:
    """S(x_i) - x_{i+1} for the states of a cycle; zero for a gait."""
    walker, tolerance = args
    ends, _ = advance(walker, states, tolerance)
    return ends - jnp.roll(states, -1, axis=0)


def advance(
    walker: Walker, states: Float[Array, "n section"], tolerance: Float[Array, ""]
) -> tuple[Float[Array, "n section"], Float[Array, " n"]]:
    """The ends of strides, and their durations."""
    ends = jax.vmap(follow_stride, (None, 0, None))(walker, states, tolerance)
    return ends.state, ends.time


def uncertainty(residual, matrix):
    """How far the states of a cycle may be from those of a gait.

    As far as the residual, and rounding, move the solution of the linear equations that Newton's
    iteration solves: divided by the smallest singular value of their matrix.
    """
    linalg = jnp.linalg if isinstance(matrix, jax.Array) else np.linalg
    smallest = linalg.svd(matrix, compute_uv=False)[..., -1]
    return (residual + 4 * float(jnp.finfo(residual.dtype).eps)) / smallest


def repeats(states) -> Bool[Array | np.ndarray, "..."]:
    """Whether cycles, of shape (..., period, section), repeat themselves within their period."""
    period, numpy = states.shape[-2], jnp if isinstance(states, jax.Array) else np
    shorter = numpy.zeros(states.shape[:-2], bool)
    for shift in range(1, period):
        if period % shift == 0:
            moved = numpy.abs(states - numpy.roll(states, shift, axis=-2)).max(axis=(-2, -1))
            shorter = shorter | (moved < DISTINCT[jnp.dtype(states.dtype)])
    return shorter


def gait_at(gaits: Gait, index: int | np.integer | Bool[np.ndarray, " n"]) -> Gait:
    """One of many gaits, or some of them."""
    return Gait(*(field[index] for field in gaits))


def cyclic(
    jacobians: Float[np.ndarray, "n period section section"], multiplier: float = 1.0
) -> Float[np.ndarray, "n size size"]:
    """The matrices of x -> (J_i x_i - x_{i+1}) over a cycle, with x_{k+1} = multiplier x_1."""
    n, period, size, _ = jacobians.shape
    matrix = np.zeros((n, period, size, period, size), jacobians.dtype)
    for i in range(period):
        following = (i + 1) % period
        matrix[:, i, :, i] += jacobians[:, i]
        matrix[:, i, :, following] -= np.eye(size) * (1.0 if following else multiplier)
    return matrix.reshape(n, period * size, period * size)


def solve(
    matrices: Float[np.ndarray, "n size size"], vectors: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "n size"]:
    """Solutions of many linear systems; of each that is singular, by least squares."""
    solutions = np.empty_like(vectors)
    singular = np.linalg.det(matrices) == 0
    regular, right = matrices[~singular], vectors[..., None]
    solutions[~singular] = np.linalg.solve(regular, right[~singular])[..., 0]
    solutions[singular] = (np.linalg.pinv(matrices[singular]) @ right[singular])[..., 0]
    return solutions


def product(
    jacobians: Float[np.ndarray, "n period section section"],
) -> Float[np.ndarray, "n section section"]:
    """J_k ... J_1, the Jacobians of whole cycles."""
    whole = jacobians[:, 0]
    for i in range(1, jacobians.shape[1]):
        whole = jacobians[:, i] @ whole
    return whole


def multipliers_of(
    whole: Float[np.ndarray, "n section section"],
) -> Complex[np.ndarray, "n section"]:
    """Eigenvalues of the Jacobians of whole cycles, the largest first."""
    values = np.linalg.eigvals(whole)
    values = values.astype(np.result_type(whole, np.complex64))
    return np.take_along_axis(values, largest_first(values), axis=-1)


def largest_first(values: Complex[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    """The order of multipliers along the last axis; of a conjugate pair, the upper one first."""
    return np.lexsort((-np.imag(values), -np.abs(values)), axis=-1)


def distinct(gaits: Gait) -> Gait:
    """The gaits found, each once, from its state of the smallest first coordinate on."""
    chosen = gait_at(gaits, np.asarray(gaits.found))
    states, times = np.asarray(chosen.states), np.asarray(chosen.step_times)
    first = states[..., 0].argmin(axis=1)
    turns = (first[:, None] + np.arange(states.shape[1])) % states.shape[1]
    turned = np.take_along_axis(states, turns[..., None], axis=1)
    chosen = chosen._replace(states=turned, step_times=np.take_along_axis(times, turns, axis=1))
    order = np.argsort(turned[:, 0, 0], kind="stable")
    kept = []
    while len(order):
        kept.append(order[0])
        far = np.abs(turned[order] - turned[order[0]]).max(axis=(1, 2)) > DISTINCT[states.dtype]
        order = order[far]
    return Gait(*(field[kept] for field in chosen))
