"""Lengths of Taylor steps that reverse mode transposes.

Forward mode shortens a step until the series of each derivative allow it (`step_lengths`). While
steps are made, reverse mode knows no direction: the step must allow derivatives along all of them.
So two things limit it that the solution itself may not feel, as at rest, or where a network begins
with zeros in its last layer: the rate of one derivative in which all numbers change at once, and
every sharp function within the equations.
"""

import itertools
import math
import operator
from collections.abc import Callable
from functools import partial, reduce
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, PyTree

from walker_jax.integrators.closures import convert_closure
from walker_jax.integrators.expansion import trace
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.integrators.step_lengths import (
    DERIVATIVE_TOLERANCE,
    has_sharp_features,
    is_sharp,
    series_dtype,
    shorten_until,
    sum_of_terms,
)
from walker_jax.integrators.taylor import (
    VectorField,
    evaluate_series,
    function_series,
    grow_both,
    order_of,
    solution_series,
    with_zeros,
)
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES, Interpreter, binding, enter

RATE_ORDER = 5
"""Order of the time derivatives that tell the rate of all derivatives for reverse mode."""
MOST_CHANGED, GOLDEN = 64, 0.618033988749895
"""Most entries of an array that change each by a part of its own, the fraction of a multiple of the
golden ratio."""
AGREEMENT = 10.0
"""Largest difference of a sharp function from its polynomial, relative to 1 or its value, in units
of the tolerance of derivatives. If it holds at the end of a step, derivatives of the integral are
some hundred times as accurate."""


def series_with_sharp_parts(
    field: VectorField, state: PyTree, order: int
) -> tuple[PyTree, tuple[list[Array], ...]]:
    """Return the series of the solution from a state, and of all sharp functions in the field."""
    if not has_sharp_features(field, state):
        return solution_series(field, state, order), ()
    both = with_sharp_parts(field)
    if isinstance(field, PowerBalance):
        series = solution_series(field, state, order)
        return series, function_series(lambda state: both(state)[1], series)
    return grow_both(both, jax.tree.map(jnp.asarray, state), order)


def cut_in_reverse(
    field: VectorField,
    series: PyTree,
    sharp: tuple[list[Array], ...],
    length: Scalar,
    tolerance: Real,
) -> Scalar:
    """Cut a step to what derivatives in all directions allow; constant to derivatives.

    If the derivative in which all numbers change grew at its rate r for ever, its term of order
    n - 1 would be (r h)^(n-1) / (n-1)!, which is at most the tolerance of derivatives.
    """
    order, (series, sharp) = order_of(series), lax.stop_gradient((series, sharp))
    tolerance = DERIVATIVE_TOLERANCE * jnp.asarray(tolerance, length.dtype)
    reach = jnp.exp((jnp.log(tolerance) + math.lgamma(order)) / (order - 1))
    start = evaluate_series(series, jnp.zeros_like(length))
    square = squared_rate(field, start)
    length = jnp.where(square > 0, jnp.minimum(length, reach / jnp.sqrt(square)), length)
    if sharp:
        parts = lambda state: with_sharp_parts(field)(state)[1]
        about = parts, series, sharp, AGREEMENT * tolerance
        length = shorten_until(partial(parts_agree, *about), length)
    return lax.stop_gradient(length)


def squared_rate(field: VectorField, state: PyTree) -> Scalar:
    """Return the square of the rate of a derivative in which all numbers change (`change_all`).

    It is the largest ratio of a time derivative of it to the last but one, of the first few.
    """
    if not isinstance(field, PowerBalance):
        field = convert_closure(field, state)
    grow = lambda field, state: solution_series(field, state, RATE_ORDER)
    series, change = eqx.filter_jvp(grow, (field, state), change_all((field, state)))
    change, square = with_zeros(change, series), jnp.zeros((), series_dtype(series))
    sizes = [sum_of_terms(change, jnp.ones_like(square), [k]) for k in range(RATE_ORDER + 1)]
    for k in range(1, RATE_ORDER - 1):
        least = jnp.where(sizes[k] > 0, sizes[k], jnp.inf)
        square = jnp.maximum(square, (k + 1) * (k + 2) * sizes[k + 2] / least)
    return square


def change_all(tree: PyTree) -> PyTree:
    """Return a direction in which all numbers of a tree change, no two alike.

    An array of many numbers changes in proportion, as its products with a series are known; so one
    of zeros does not change.
    """
    numbers = itertools.count(1)

    def change(x):
        if not eqx.is_inexact_array(x):
            return None
        if x.size > MOST_CHANGED:
            return x
        parts = [1 + next(numbers) * GOLDEN % 1 for _ in range(x.size)]
        return jnp.asarray(parts, x.dtype).reshape(x.shape)

    return lax.stop_gradient(jax.tree.map(change, tree))


def parts_agree(
    parts: Callable[[PyTree], tuple[Array, ...]],
    series: PyTree,
    known: PyTree,
    tolerance: Scalar,
    length: Scalar,
) -> Bool[Array, ""]:
    """Return whether functions of the state agree with their own series at the end of a step."""
    near = [
        jnp.all(
            (jnp.abs(value - expected) <= tolerance * jnp.maximum(1, jnp.abs(value)))
            | ~jnp.isfinite(expected)  # no shorter step makes a series finite
        )
        for value, expected in zip(
            parts(evaluate_series(series, length)), evaluate_series(known, length), strict=True
        )
    ]
    return reduce(operator.and_, near)


def with_sharp_parts(
    function: Callable[[PyTree], PyTree],
) -> Callable[[PyTree], tuple[PyTree, tuple[Array, ...]]]:
    """Return a function with the results of all sharp primitives within it."""

    def evaluate(state):
        closed, shapes = trace(function, state)
        parts = SharpParts([])
        results = parts.interpret(closed, jax.tree.leaves(state))
        return jax.tree.unflatten(jax.tree.structure(shapes), results), tuple(parts.found)

    return evaluate


class SharpParts(Interpreter):
    """Evaluates a function, and finds the results of its sharp primitives."""

    def __init__(self, found: list[Array]):
        self.found = found

    def constant(self, value):
        return value

    def default_rule(self, equation, operands: list) -> list:
        results = binding(equation)(*operands)
        results = results if equation.primitive.multiple_results else [results]
        if is_sharp(equation):
            self.found += results
        return results

    def call(self, equation, operands: list) -> list:
        """Call a function that has derivatives or a series of its own."""
        enter(self, equation, operands)
        return self.default_rule(equation, operands)

    rules: ClassVar = {**CALLS, **dict.fromkeys(CALLS_WITH_DERIVATIVES, call)}
