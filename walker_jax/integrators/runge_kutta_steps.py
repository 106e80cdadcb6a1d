"""Steps by explicit Runge-Kutta methods of diffrax, each with a polynomial as accurate as itself.

These methods bound the error at the end of a step; their steps may be long against the polynomial
within. So a step counts only if that error is within the tolerance too: the defect p'(t) - f(p(t))
of the interpolation p, and the error of the polynomials of functions, such as guards, along it.
"""

from collections.abc import Callable
from functools import reduce
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from walker_jax.integrators.expansion import without_derivatives
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import Real, Scalar, derivative_of
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.step_lengths import DERIVATIVE_TOLERANCE, StepLimits
from walker_jax.integrators.taylor import (
    VectorField,
    evaluate_series,
    function_series,
    is_list,
    with_zeros,
)

if TYPE_CHECKING:
    import diffrax

INTERPOLATION_ORDER = 6
"""Order of the polynomial that represents an interpolation; diffrax has none higher."""
NODES = (1 - np.cos(np.pi * np.arange(INTERPOLATION_ORDER + 1) / INTERPOLATION_ORDER)) / 2
"""Fractions of a step at which the interpolation is evaluated to fit the polynomial."""
DEFECT_AT = 0.2, 0.6
"""Fractions of a step at which the defect of the interpolation is evaluated. It vanishes at the
ends; here, neither t^2 (1 - t)^2 nor t^2 (1 - t)^2 (1 - 2 t), the usual errors, has rate zero."""
EXPANSION_AT = 0.5, 1.0
"""Fractions of a step at which the polynomial of a function is compared with the function."""
UNRESOLVED = 0.15
"""Largest third difference of a condition over quarters of a step, in units of its range there. It
is 0.19 for a cubic whose two extrema are the ends of the step, and larger if they are within."""


def controller_of(tolerance: Real, longest: Real | None) -> "diffrax.PIDController":
    """Return the control of steps: the largest of all errors is within the tolerance."""
    import diffrax
    import optimistix

    return diffrax.PIDController(
        rtol=tolerance, atol=tolerance, norm=optimistix.max_norm, dtmax=longest
    )


def units_of(limits: StepLimits) -> PyTree | None:
    """Return units of the variables: their scales; zero for those of relative errors, else one."""
    if limits.scales is not None or limits.proportional is None:
        return limits.scales
    return jax.tree.map(lambda own: jnp.where(own, 0.0, 1.0), limits.proportional)


def in_units_of(scales: PyTree | None, state: PyTree) -> PyTree:
    """Return a state, or errors of it, in units of the scales of its variables, if they are given.

    Errors in these units are relative to a variable, or to its scale.
    """
    if scales is None:
        return state
    least = lambda x: float(jnp.finfo(x.dtype).tiny) ** 0.5
    return jax.tree.map(lambda x, scale: x / jnp.maximum(scale, least(x)), state, scales)


def fit_polynomial(length: Scalar, values: Float[Array, " nodes"]) -> list[Scalar]:
    """Fit the polynomial in 0 <= t <= length with these values at t = `NODES` length."""
    changes, unit, found = values - values[0], jnp.ones_like(length), [values[0]]
    for row in np.linalg.inv(np.vander(NODES, increasing=True))[1:]:
        unit = unit * length
        whole = sum(float(part) * change for part, change in zip(row, changes, strict=True))
        found.append(whole / unit)
    return found


def interpolate(solver: Any, length: Scalar, dense: dict, order: int) -> PyTree[list]:
    """Return the interpolation of a step as a polynomial, with zeros up to the order.

    An interpolation is linear in the stages, and exact if they are equal. So it is fitted to their
    differences from the first, which are small: p(0) = y and p'(0) = f(y) are exact.
    """
    bends = jax.tree.map(lambda k: k - k[0], dense["k"])
    weights = np.asarray(solver.tableau.b_sol)
    last = jax.tree.map(lambda k: jnp.tensordot(jnp.asarray(weights, k.dtype), k, 1), bends)
    first = jax.tree.map(jnp.zeros_like, last)
    inside = solver.interpolation_cls(
        t0=jnp.zeros_like(length), t1=length, y0=first, y1=last, k=bends
    ).evaluate
    values = jax.vmap(inside)(length * jnp.asarray(NODES, length.dtype))

    def complete(start, stages, values):
        _, slope, *others = fit_polynomial(length, values)
        rest = [jnp.zeros_like(slope)] * (order - INTERPOLATION_ORDER)
        return [start, slope + stages[0] / length, *others, *rest]

    return jax.tree.map(complete, dense["y0"], dense["k"], values)


def defect_of(field: VectorField, series: PyTree[list], length: Scalar) -> PyTree:
    """Return the largest defect of a step's polynomial, times its length."""
    rates = jax.tree.map(derivative_of, series, is_leaf=is_list)

    def at(part: float) -> PyTree:
        time = part * length
        found, expected = evaluate_series(rates, time), field(evaluate_series(series, time))
        return jax.tree.map(lambda a, b: jnp.abs(a - b) * length, found, expected)

    return jax.tree.map(lambda *sizes: largest(jnp.stack(sizes), 0), *map(at, DEFECT_AT))


@eqx.filter_custom_jvp
def derivative_error(*blocks: tuple[PyTree, PyTree, PyTree]) -> Scalar:
    """Return the largest error of a step's derivatives, relative to each; zero if there are none.

    A block holds the error of a step, its start and its end. The first is that of the solution; JAX
    adds those of its derivatives, whose steps may have to be shorter (`step_lengths`).
    """
    size_of = lambda tree: reduce(jnp.maximum, (largest(jnp.abs(x)) for x in jax.tree.leaves(tree)))
    worst = 0 * size_of(blocks[0][0])
    for error, start, end in blocks[1:]:
        size = DERIVATIVE_TOLERANCE * jnp.maximum(size_of(start), size_of(end))
        worst = jnp.maximum(worst, size_of(error) / jnp.where(size > 0, size, 1))
    return worst


@derivative_error.def_jvp
def vary_error(primals, tangents):
    changes = [with_zeros(*pair) for pair in zip(tangents, primals, strict=True)]
    worst = derivative_error(*primals, *changes)
    return worst, jnp.zeros_like(worst)


def expansion_errors(
    functions: tuple[Callable[[PyTree], Scalar], ...], series: PyTree[list], length: Scalar
) -> list[Scalar]:
    """Return the largest difference of each function g along a step from its polynomial.

    It is in units of 1 + |g|, as errors of the state are in units of 1 + |y|.
    """
    if not functions:
        return []
    every = lambda y: [one(y) for one in functions]
    polynomials, evaluate = function_series(every, series), function_at(every, series)

    def at(part: float) -> Float[Array, " functions"]:
        time = part * length
        expected = jnp.stack([evaluate_polynomial(one, time) for one in polynomials])
        found = jnp.stack(evaluate(evaluate_series(series, time)))
        return jnp.abs(expected - found) / (1 + jnp.abs(found))

    return [*largest(jnp.stack([*map(at, EXPANSION_AT)]), 0)]


def twist_of(function: Callable[[PyTree], Scalar], series: PyTree[list], length: Scalar) -> Scalar:
    """Return the third differences of a function over a step, in units of `UNRESOLVED`.

    Up to 1 the function has no more than one extremum in the step.
    """
    evaluate = function_at(function, series)
    a, b, c, d, e = (evaluate(evaluate_series(series, k / 4 * length)) for k in range(5))
    values = jnp.stack([a, b, c, d, e])
    rounding = 1e3 * float(jnp.finfo(length.dtype).eps) * largest(jnp.abs(values))
    size = UNRESOLVED * (largest(values) + largest(-values) + rounding)
    twist = jnp.maximum(jnp.abs(d - 3 * c + 3 * b - a), jnp.abs(e - 3 * d + 3 * c - b))
    return twist / jnp.where(size > 0, size, 1)


def function_at(function: Callable[[PyTree], PyTree], series: PyTree[list]) -> Callable:
    """Return a function of the state, constant to derivatives."""
    start = jax.tree.map(lambda c: c[0], series, is_leaf=is_list)
    return without_derivatives(function, start)
