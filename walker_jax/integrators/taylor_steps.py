"""Steps by Taylor series: their order and their length.

Derivatives are taken in forward mode; `kernels.kernel` derives reverse mode from them.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from walker_jax.integrators.fractional_powers import step_near_powers, straighten
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import Real, Scalar, cut_at_switches, derivative_of
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.step_lengths import (
    StepLimits,
    cut_for_function,
    longest_step,
    scale_of,
)
from walker_jax.integrators.steps_in_reverse import cut_in_reverse, series_with_sharp_parts
from walker_jax.integrators.taylor import (
    VectorField,
    evaluate_series,
    is_list,
    power_bases,
    series_of_switches,
    solution_series,
)

SERIES_ORDER = {jnp.dtype("float64"): 14, jnp.dtype("float32"): 8}
"""Order of the series: the fastest, or nearly, at the default tolerance (benchmarks/README.md).

A higher order takes fewer steps, with more work for each.
"""


class Taylor(eqx.Module):
    """The method of Taylor series, of an order."""

    order: int = eqx.field(static=True, default=SERIES_ORDER[jnp.dtype("float64")])


def smooth_step(
    vector_field: VectorField,
    state: PyTree,
    order: int,
    tolerance: Real,
    watched: tuple[Callable[[PyTree], Scalar], ...],
    limits: StepLimits,
) -> tuple[PyTree[list], Scalar]:
    """Return the series of a step from a state, and its length if it meets no kink.

    At the end of the step the last terms of the series reach the tolerance, and those of the
    watched functions are within it; where the equations or they have sharp features
    (`step_lengths`), their polynomials agree with them. The length is constant to derivatives.
    """
    if limits.in_reverse:
        series, sharp = series_with_sharp_parts(vector_field, state, order)
        length = longest_step(vector_field, state, series, tolerance, limits)
        length = cut_in_reverse(vector_field, series, sharp, length, tolerance)
    else:
        series = solution_series(vector_field, state, order)
        length = longest_step(vector_field, state, series, tolerance, limits)
    for function in watched:
        length = cut_for_function(function, lax.stop_gradient(series), length, tolerance)
    return series, length


def end_at_kink(
    vector_field: VectorField,
    series: PyTree[list],
    length: Scalar,
    tolerance: Real,
    *others: Callable[[PyTree], PyTree],
) -> tuple[PyTree[list], Scalar]:
    """Return the series and the length of a step that ends just behind the first kink.

    That is of the equations or one of the `others`, by `tolerance` times the length behind it. The
    length is NaN if the equations jump by more than the root of the tolerance, relative to |y| or
    |y'|.
    """
    found = [series_of_switches(f, series) for f in (vector_field, *others)]
    switches, bases = (
        [one for part in parts for one in part] for parts in zip(*found, strict=True)
    )
    if bases:
        return step_near_powers(
            vector_field, series, switches, bases, length, tolerance, scale_of(series)
        )
    if not switches:
        return series, length
    least = jnp.asarray(tolerance, length.dtype) * length
    length = cut_at_switches(switches, length, least)
    constant, end = lax.stop_gradient((series, length))
    rates = vector_field(evaluate_series(constant, end))
    expected = jax.tree.map(
        lambda c: evaluate_polynomial(derivative_of(c), end), constant, is_leaf=is_list
    )
    defects = jax.tree.map(lambda a, b: largest(jnp.abs(a - b)), rates, expected)
    defect = largest(jnp.stack(jax.tree.leaves(defects)))
    steady = defect <= jnp.sqrt(jnp.asarray(tolerance, length.dtype)) * scale_of(series)
    return series, jnp.where(steady, length, jnp.nan)


def usable_series(vector_field: VectorField, series: PyTree[list]) -> PyTree[list]:
    """Return the series of a solution; a line very near to the zero of a fractional power."""
    bases = power_bases(vector_field, series)
    return straighten(series, bases, scale_of(series))[0] if bases else series
