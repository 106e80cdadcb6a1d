"""Steps by Taylor series: their size, and a solver that makes them in `diffrax.diffeqsolve`.

`SeriesSteps` is the step size controller that suits the solver, which never rejects a step.
Derivatives are taken in forward mode; `kernels.kernel` derives reverse mode from them.
"""

from collections.abc import Callable
from typing import ClassVar

import diffrax
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
    NO_LIMITS,
    StepLimits,
    cut_for_function,
    longest_step,
    scale_of,
    step_size,
)
from walker_jax.integrators.steps_in_reverse import cut_in_reverse
from walker_jax.integrators.taylor import (
    VectorField,
    evaluate_series,
    is_list,
    power_bases,
    series_of_switches,
    solution_series,
    switching_series,
)

SERIES_ORDER = {jnp.dtype("float64"): 14, jnp.dtype("float32"): 8}
"""Order of the series: the fastest, or nearly, at the default tolerance (benchmarks/README.md).

A higher order takes fewer steps, with more work for each.
"""


def taylor_step(
    vector_field: VectorField,
    state: PyTree,
    order: int,
    tolerance: Real,
    *others: Callable[[PyTree], PyTree],
    watched: tuple[Callable[[PyTree], Scalar], ...] = (),
    limits: StepLimits = NO_LIMITS,
) -> tuple[PyTree[list], Scalar]:
    """Return the series of the solution of y' = f(y) from a state, and the length of a step.

    At the end of the step the last terms of the series reach the tolerance, and those of the
    watched functions are within it; where f or they have sharp features (`step_lengths`), their
    polynomials agree with them. If f or one of the `others` has a kink before that, the step
    ends just behind the kink, by `tolerance` times the length. The length is NaN if f jumps by more
    than the root of the tolerance, relative to |y| or |y'|.
    """
    series = solution_series(vector_field, state, order)
    length = smooth_length(vector_field, state, series, tolerance, watched, limits)
    return end_at_kink(vector_field, series, length, tolerance, *others)


def smooth_length(
    vector_field: VectorField,
    state: PyTree,
    series: PyTree[list],
    tolerance: Real,
    watched: tuple[Callable[[PyTree], Scalar], ...],
    limits: StepLimits,
) -> Scalar:
    """Return the length of a step from a state, if it meets no kink; constant to derivatives."""
    length = longest_step(vector_field, state, series, tolerance, limits)
    if limits.in_reverse:
        length = cut_in_reverse(vector_field, series, length, tolerance)
    for function in watched:
        length = cut_for_function(function, lax.stop_gradient(series), length, tolerance)
    return length


def end_at_kink(
    vector_field: VectorField,
    series: PyTree[list],
    length: Scalar,
    tolerance: Real,
    *others: Callable[[PyTree], PyTree],
) -> tuple[PyTree[list], Scalar]:
    """Return the series and the length of a step that ends just behind the first kink."""
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


class TaylorInterpolation(diffrax.AbstractLocalInterpolation):
    """A step's own polynomial."""

    t0: Scalar
    t1: Scalar
    series: PyTree

    def evaluate(self, t0, t1=None, left=True):
        del left
        if t1 is not None:
            return jax.tree.map(lambda a, b: a - b, self.evaluate(t1), self.evaluate(t0))
        return evaluate_series(self.series, t0 - self.t0)


class Taylor(diffrax.AbstractAdaptiveSolver):
    """Explicit Taylor method for `diffrax.diffeqsolve`, of any order.

    The error estimate is the last term of the series, so adaptive steps keep that term below the
    tolerance. Dense output is the series itself, of the full order. Equations may depend on time.
    """

    taylor_order: int = eqx.field(static=True, default=SERIES_ORDER[jnp.dtype("float64")])
    field: VectorField | None = None
    """f, if it depends on the state alone; it may be a `PowerBalance`."""

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar = TaylorInterpolation

    def order(self, terms):
        return self.taylor_order

    def error_order(self, terms):
        return self.taylor_order

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def expand(self, terms, t0, y0, args) -> tuple[PyTree[list], PyTree, list[list[Scalar]]]:
        """Expand the solution from a state: its series, last terms and switching functions."""

        def autonomous(state):
            time, y = state
            return jnp.ones_like(time), terms.vf(time, y, args)

        field = autonomous if self.field is None else self.field
        state = (jnp.asarray(t0), y0) if self.field is None else y0
        known = solution_series(field, state, self.taylor_order)
        series = usable_series(field, known)
        last = jax.tree.map(lambda c: c[-1], known, is_leaf=is_list)
        switches = switching_series(field, series)
        return (
            (series, last, switches) if self.field is not None else (series[1], last[1], switches)
        )

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump
        series, last, switches = self.expand(terms, t0, y0, args)
        length = jnp.asarray(t1 - t0)
        power = length**self.taylor_order
        error = jax.tree.map(lambda c: c * power, last)
        if switches:
            # A step over a kink gets an error that every controller rejects; a step that ends just
            # behind the kink does not.
            eps = float(jnp.finfo(length.dtype).eps)
            least = 1e3 * eps * jnp.maximum(step_size(series, eps), jnp.abs(t1))
            over = length > cut_at_switches(switches, length, least)
            error = jax.tree.map(lambda e: jnp.where(over, scale_of(series), e), error)
        return (
            evaluate_series(series, length),
            error,
            dict(series=series),
            None,
            diffrax.RESULTS.successful,
        )


class SeriesSteps(diffrax.AbstractStepSizeController):
    """Makes steps as long as the series of the solution allows, so that none is rejected.

    The steps and the arguments are those of `taylor_step`.
    """

    field: VectorField
    order: int = eqx.field(static=True)
    tolerance: Real
    others: tuple[Callable[[PyTree], PyTree], ...] = ()

    def wrap(self, direction):
        return self

    def longest(self, state: PyTree) -> Scalar:
        return taylor_step(self.field, state, self.order, self.tolerance, *self.others)[1]

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return t0 + self.longest(y0), None

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        following = t1 + self.longest(y1_candidate)
        return jnp.array(True), t1, following, False, None, diffrax.RESULTS.successful
