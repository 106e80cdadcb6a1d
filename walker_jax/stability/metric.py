"""The metric in which disturbances are measured, and the directions that they may have.

A search for the nearest failure has its own coordinates y, in which a disturbance has the Euclidean
length |y|. A metric converts them to disturbances of the section.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_precision, short
from walker_jax.identity import FunctionByCode
from walker_jax.systems.system import System

SOLVING_STEPS = 60
"""Newton steps to find the length of a disturbance from its size. One or two suffice where sizes
are a power of lengths, as for every norm."""
SOLVED = 1e-13
"""Largest relative error of the size of a disturbance."""
SYMMETRIC = 1e-12
"""Largest relative difference of a symmetric matrix from its transpose."""

State = Float[np.ndarray, " section"]
Points = Float[np.ndarray, "n section"]
Sizes = Float[np.ndarray, " n"]

DistanceFunction = Callable[[Float[Array, " section"], Float[Array, " section"]], Array]
"""The size of a disturbance, given a state of the gait and the disturbance; written with JAX."""


class LinearMetric(NamedTuple):
    """Sizes sqrt(d^T M d) of disturbances d = y @ root, for M = (root^T root)^-1."""

    root: Float[np.ndarray, "section section"]
    basis: Float[np.ndarray, "rank section"]
    """An orthonormal basis of the coordinates y of the allowed disturbances."""

    def disturbance(self, state: State, y: Points) -> Points:
        """Return the disturbances of a state with the coordinates y."""
        return y @ self.root

    def pull_back(self, state: State, y: Points, gradient: Points) -> Points:
        """Convert gradients along the section to gradients along y."""
        return gradient @ self.root.T

    def size(self, state: State, disturbed: Points) -> Sizes:
        """Return the sizes of disturbances of a state."""
        return np.linalg.norm(np.linalg.solve(self.root.T, (disturbed - state).T), axis=0)


class CurvedMetric(NamedTuple):
    """Sizes by a function that grows along every ray; disturbances are parallel to y."""

    distance: DistanceFunction
    basis: Float[np.ndarray, "rank section"]

    def disturbance(self, state: State, y: Points) -> Points:
        """Return the disturbances along y of size |y|: r u, with u = y / |y| and f(r u) = |y|.

        Raises `ComputationFailed` where the function does not grow along a ray.
        """
        if len(y) == 0:
            return y
        size = np.linalg.norm(y, axis=1)
        unit = y / np.where(size > 0, size, 1)[:, None]
        length, error = self.lengths(state, unit, np.where(size > 0, size, 1))
        if not np.max(error, initial=0) < SOLVED:
            worst = unit[int(np.argmax(np.where(np.isnan(error), np.inf, error)))]
            raise ComputationFailed(
                f"no disturbance of every size found along {worst.tolist()}: the metric must grow "
                "from zero along every ray from the gait"
            )
        return np.where(size > 0, length, 0)[:, None] * unit

    def lengths(self, state: State, unit: Points, size: Sizes) -> tuple[Sizes, Sizes]:
        """Call `solve_lengths` on a power of two of rays, to compile few programs."""
        number = np.minimum(np.arange(1 << max(0, len(size) - 1).bit_length()), len(size) - 1)
        found = solve_lengths(
            FunctionByCode(self.distance), jnp.asarray(state), unit[number], size[number]
        )
        length, error = (np.asarray(one)[: len(size)] for one in found)
        return length, error

    def pull_back(self, state: State, y: Points, gradient: Points) -> Points:
        """Convert gradients along r u, with |u| = 1 and f(r u) = |y|, to gradients along y.

        dr = (d|y| - r f' du) / (f' u), and du is the part of dy across u, over |y|.
        """
        size = np.linalg.norm(y, axis=1, keepdims=True)
        unit, d = y / size, self.disturbance(state, y)
        length = np.linalg.norm(d, axis=1, keepdims=True)
        slopes = np.asarray(
            gradients(FunctionByCode(self.distance), jnp.asarray(state), jnp.asarray(d))
        )
        growth = np.sum(slopes * unit, axis=1, keepdims=True)
        along = np.sum(gradient * unit, axis=1, keepdims=True) / growth
        across = (gradient - along * slopes) * length / size
        across -= np.sum(across * unit, axis=1, keepdims=True) * unit
        return along * unit + across

    def size(self, state: State, disturbed: Points) -> Sizes:
        """Return the sizes of disturbances of a state."""
        d = jnp.asarray(disturbed - state)
        return np.asarray(jax.vmap(self.distance, (None, 0))(jnp.asarray(state), d))


@partial(jax.jit, static_argnums=0)
def solve_lengths(
    distance: DistanceFunction,
    state: Float[Array, " section"],
    unit: Float[Array, "n section"],
    size: Float[Array, " n"],
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Solve f(r u) = size for lengths r, by Newton's iteration on log f as a function of log r.

    Returns the lengths and the errors of log f.
    """

    def solve(u, target):
        def error_at(length):
            along = lambda one: distance(state, one * u)
            value, slope = jax.jvp(along, (length,), (jnp.ones_like(length),))
            return jnp.log(target / value), length * slope / value

        def unsolved(carry):
            _, error, count = carry
            return ~(jnp.abs(error) < SOLVED) & (count < SOLVING_STEPS)

        def advance(carry):
            length, _, count = carry
            error, power = error_at(length)
            length = length * jnp.exp(jnp.clip(error / power, -3, 3))
            return length, error_at(length)[0], count + 1

        first = target, jnp.full_like(target, jnp.inf), jnp.zeros((), jnp.int32)
        length, error, _ = jax.lax.while_loop(unsolved, advance, first)
        return length, jnp.abs(error)

    return jax.vmap(solve)(unit, size)


@partial(jax.jit, static_argnums=0)
def gradients(
    distance: DistanceFunction, state: Float[Array, " section"], d: Float[Array, "n section"]
) -> Float[Array, "n section"]:
    """Compute gradients of the size of a disturbance by the disturbance."""
    return jax.vmap(jax.grad(distance, argnums=1), (None, 0))(state, d)


Metric = LinearMetric | CurvedMetric


def metric_of(
    walker: System,
    scale: Sequence[Any] | ArrayLike | None,
    along: Sequence[Any] | ArrayLike | None,
    metric: Sequence[Any] | ArrayLike | DistanceFunction | None = None,
) -> Metric:
    """Make the metric of units of length, a matrix or a function, with the span of `along`.

    Raises `ValueError` for a scale, a matrix or vectors that do not fit the section.
    """
    check_kind("walker", walker, System)
    size = len(walker.section)
    if metric is not None and scale is not None:
        raise WrongUse("scale and metric exclude each other: give one of them")
    unit = np.ones(size) if scale is None else numbers_or_none(scale)
    if unit.shape != (size,) or not np.all(np.isfinite(unit) & (unit > 0)):
        raise WrongUse(f"scale must be {size} positive numbers, not {short(scale)}")
    basis = np.eye(size) if along is None else np.atleast_2d(numbers_or_none(along))
    fits = basis.ndim == 2 and basis.shape[1] == size and bool(np.isfinite(basis).all())
    if not fits or np.linalg.matrix_rank(basis) != len(basis):
        raise WrongUse(f"along must be independent vectors of the section, not {short(along)}")
    if callable(metric):
        check_precision(jnp.result_type(float), "a function as the metric")
        return CurvedMetric(metric, np.linalg.qr(basis.T)[0].T)
    root = np.diag(unit) if metric is None else inverse_root(metric, size)
    return LinearMetric(root, np.linalg.qr(np.linalg.solve(root.T, basis.T))[0].T)


def inverse_root(metric: Any, size: int) -> Float[np.ndarray, "section section"]:
    """Compute the symmetric M^(-1/2) of a symmetric positive definite matrix M."""
    matrix = numbers_or_none(metric)
    fits = matrix.shape == (size, size) and bool(np.isfinite(matrix).all())
    fits = fits and np.allclose(matrix, matrix.T, rtol=SYMMETRIC, atol=0)
    values, vectors = np.linalg.eigh(matrix) if fits else (np.zeros(1), np.zeros((1, 1)))
    if not values.min() > 0:
        raise WrongUse(
            f"metric must be a symmetric positive definite matrix of {size} x {size} numbers, or a "
            f"function, not {short(metric)}"
        )
    return vectors / np.sqrt(values) @ vectors.T


def numbers_or_none(values: Any) -> Float[np.ndarray, "..."]:
    """Return the values as an array of numbers; NaN for other values."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        return np.array(np.nan)
