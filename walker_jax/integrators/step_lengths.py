"""Lengths of Taylor steps: where the last terms of a series reach the tolerance.

Only variables with nonzero last terms count. Those of a clock, or of a position without force, are
polynomials of time, which a series of higher order represents exactly.

The derivative of a solution along a direction has a series of its own, of the variational
equations. A direction that is faster than the solution, such as one across a slow manifold or from
an equilibrium, needs shorter steps than the solution. So where JAX differentiates a step, its
length is the least that the series of the solution and of its derivatives allow.

A series shows what the equations are near the start of a step. An exponential, such as stiff
exponential ground or a torque switched by a tanh, may be negligible there and large at the end. So
where equations contain such a function, the slope of the polynomial is compared with the equations
in the middle and at the end of the step.
"""

import operator
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, PyTree

from walker_jax.integrators.closures import convert_closure
from walker_jax.integrators.expansion import LINEAR, trace
from walker_jax.integrators.integrals import beside, motion_of
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import Real, Scalar, derivative_of
from walker_jax.integrators.series import evaluate_polynomial, short_logs
from walker_jax.integrators.taylor import (
    VariedField,
    VectorField,
    evaluate_series,
    function_series,
    is_list,
    order_of,
    with_zeros,
)
from walker_jax.kernels.directions import holds_along_all
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES, Interpreter, equations_in

LONGEST_STEP, POLYNOMIAL_STEP = 2.0, 0.25
"""Two step lengths, in units of |y| / |y'|. If a step would be longer than the first, the last
terms of the series do not limit it (steps of a harmonic motion are at most a third as long). It
then has the second length; if the state is a polynomial of time, functions of it seldom have more
than one extremum in such a step."""
DERIVATIVE_TOLERANCE = 100.0
"""Tolerance of a derivative's last terms, in units of that of the solution. With this, derivatives
by the start of a walker's stride allow steps that are 1.1 times as long as the solution allows, or
longer, so that only faster directions shorten a step."""
FIRST_TERMS = range(4)
"""Terms of a derivative's series with which the last ones are compared. The first
or the first two may vanish, as those of a derivative by a parameter do."""
DEFECT = 12.0
"""Largest difference between the slope of a step's polynomial and the equations, in units of
tolerance |y| over the length. If the series shows all that is within the step, it is about n + 1
times the first omitted term, which is a tenth of the last one."""
MOST_HALVINGS = 100
"""A step is shortened by so many halvings at most, so that this ends where equations are not
finite. A step of a solution at rest may have the length 1 / epsilon before."""
SHORTER = 0.75
"""Part of a step that is tried next where the series of a derivative does not allow the whole: few
directions are much faster than the solution, and to look again is cheap. Equations with sharp
features cost more to evaluate, so their steps are halved."""
SHARP = frozenset("cosh erf erfc exp exp2 expm1 log1p logistic sinh tanh".split())
"""Primitives whose derivatives of all orders may be negligible at a point and large nearby. Poles
and branch points, as those of quotients, roots and fractional powers, show from afar."""
LOW_POWER = 8
"""Integer powers above this count as sharp too."""


class StepLimits(NamedTuple):
    """Limits of steps that a mode sets itself."""

    scales: PyTree | None = None
    """Sizes below which the errors of the variables are absolute, a tree like the state; without
    them errors are relative to the largest variable."""
    longest: Real | None = None
    """Longest step, for features of time that lie wholly within a step."""
    proportional: PyTree | None = None
    """Variables whose errors are relative to their own size where there are no scales
    (`own_sizes`)."""
    in_reverse: bool = False
    """Whether reverse mode transposes the steps (`steps_in_reverse`)."""


NO_LIMITS = StepLimits()


def longest_step(
    field: VectorField, state: PyTree, series: PyTree, tolerance: Real, limits: StepLimits
) -> Scalar:
    """Return the length of a step of y' = f(y), given its series from a state.

    Integrals beside the motion do not limit it (`WithIntegrals`).
    """
    motion, start = motion_of(field, state)
    _, known = motion_of(field, series)
    counted = count_variables(known) if may_have_clocks(motion, start) else None
    sizes = sizes_of(known, counted, limits)
    length = step_size(known, tolerance, sizes, counted)
    if limits.longest is not None:
        length = jnp.minimum(length, lax.stop_gradient(limits.longest))
    checked = None
    if has_sharp_features(field, state):
        checked = field if isinstance(field, PowerBalance) else convert_closure(field, state)
    if field is not motion:
        sizes = jax.tree.map(lambda _: sizes, start) if eqx.is_array(sizes) else sizes
        sizes = beside(field, sizes, state, jnp.full_like(length, jnp.inf))
    return shorten(checked, (series,), length, tolerance, sizes)


def cut_for_function(
    function: Callable[[PyTree], Scalar], series: PyTree, length: Scalar, tolerance: Real
) -> Scalar:
    """Cut a step to where the last terms of a function of the solution reach the tolerance.

    If the function has sharp features, its polynomial also agrees with it. The series of the
    solution must be constant to derivatives.
    """
    known = function_series(function, series)
    # a watched function may begin at zero with rate zero, as 1 - cos does
    size = jnp.maximum(sizes_of((known,)), largest_coefficient((known,), 2))
    allowed = uncapped_step_size((known,), tolerance, size).astype(length.dtype)
    length = jnp.minimum(length, allowed)
    start = jax.tree.map(lambda c: c[0], series, is_leaf=is_list)
    if not has_sharp_features(function, start):
        return length
    known = lax.stop_gradient(known)

    def fits(length):
        agree = jnp.asarray(True)
        for t in (length, length / 2):
            change = function(evaluate_series(series, t)) - evaluate_polynomial(known, t)
            agree &= jnp.abs(change) <= tolerance * size
        return agree

    return shorten_until(fits, lax.stop_gradient(length))


def step_size(
    series: PyTree, tolerance: Real, sizes: PyTree | None = None, counted: PyTree | None = None
) -> Scalar:
    """Return the step size h at which the last terms of the series reach the tolerance.

    h = min over k = n-1, n of (tolerance |y| / |c_k|)^(1/k), in the maximum norm over all variables
    that count (Jorba and Zou 2005), where |y| is the larger of |c_0| and |c_1|; or with the `sizes`
    of all variables in place of |y|.

    The last terms vanish for a polynomial of time, such as a ballistic flight or a clock, and all
    terms vanish at rest. So that h stays finite, it is `POLYNOMIAL_STEP` |y| / |c_1| if it would
    exceed `LONGEST_STEP` |y| / |c_1|, and |c_1| counts as at least the rounding of |y|. The powers
    are computed in float32, where they are cheap: h needs few digits.
    """
    sizes = sizes_of(series) if sizes is None else sizes
    shortest = uncapped_step_size(series, tolerance, sizes)
    rate = relative_size(series, 1, sizes, counted).astype(jnp.float32)
    unit = 1 / jnp.maximum(rate, float(jnp.finfo(series_dtype(series)).eps))
    shortest = jnp.where(shortest > LONGEST_STEP * unit, POLYNOMIAL_STEP * unit, shortest)
    return shortest.astype(series_dtype(series))


def uncapped_step_size(series: PyTree, tolerance: Real, sizes: PyTree) -> Scalar:
    """Return the h of `step_size` without its cap, infinite if the last terms vanish; float32."""
    orders = order_of(series) - 1, order_of(series)
    log_tolerance = jnp.log(jnp.asarray(tolerance, jnp.float32))
    logs = short_logs(*(relative_size(series, k, sizes) for k in orders))
    lengths = [(log_tolerance - log) / k for k, log in zip(orders, logs, strict=True)]
    return jnp.exp(jnp.minimum(*lengths))


def sizes_of(
    series: PyTree, counted: PyTree | None = None, limits: StepLimits = NO_LIMITS
) -> PyTree[Array]:
    """Return |y| at the start of a step, above zero: one number, or one for each variable."""
    smallest = float(jnp.finfo(series_dtype(series)).tiny) ** 0.5
    if limits.scales is not None:
        above = lambda scale: jnp.maximum(lax.stop_gradient(scale), smallest)
        size = lambda c, scale: jnp.maximum(own_size(c), above(scale))
        return jax.tree.map(size, series, limits.scales, is_leaf=is_list)
    of_all = jnp.maximum(scale_of(series, counted), smallest)
    if limits.proportional is None:
        return of_all
    size = lambda c, own: jnp.where(own, jnp.maximum(own_size(c), smallest), of_all)
    return jax.tree.map(size, series, limits.proportional, is_leaf=is_list)


def own_size(coefficients: list[Array]) -> Array:
    """Return the larger of |y| and |y'| of a variable, constant to derivatives."""
    now, rate = (jnp.abs(lax.stop_gradient(c)) for c in coefficients[:2])
    return jnp.maximum(now, rate)


def scale_of(series: PyTree, counted: PyTree | None = None) -> Scalar:
    """Return the larger of |y| and |y'| at the start of a step, of all variables that count."""
    return jnp.maximum(*(largest_coefficient(series, k, counted) for k in range(2)))


def largest_coefficient(series: PyTree, k: int, counted: PyTree | None = None) -> Scalar:
    """Return the largest modulus of the variables' k-th coefficients; constant to derivatives."""
    leaves = jax.tree.leaves(series, is_leaf=is_list)
    size = jnp.zeros((), leaves[0][0].dtype)
    for i, leaf in enumerate(leaves):
        modulus = jnp.abs(leaf[k])
        if counted is not None:
            modulus = jnp.where(jax.tree.leaves(counted)[i], modulus, 0)
        size = jnp.maximum(size, largest(modulus))
    return lax.stop_gradient(size)


def relative_size(series: PyTree, k: int, sizes: PyTree, counted: PyTree | None = None) -> Scalar:
    """Return the largest k-th coefficient, relative to |y| or to each variable's own size."""
    if eqx.is_array(sizes) and sizes.ndim == 0:  # not those of a state that is one array
        return largest_coefficient(series, k, counted) / sizes
    ratio = lambda c, size: [c[k] / size]
    return largest_coefficient(jax.tree.map(ratio, series, sizes, is_leaf=is_list), 0, counted)


def series_dtype(series: PyTree) -> Any:
    return jax.tree.leaves(series)[0].dtype


# ------------------------------------------------------------------------------------------ clocks


def count_variables(series: PyTree) -> PyTree[Array]:
    """Return which variables count: those whose last terms do not vanish; all, if all vanish."""
    last = lambda c: (lax.stop_gradient(c[-1]) != 0) | (lax.stop_gradient(c[-2]) != 0)
    moves = jax.tree.map(last, series, is_leaf=is_list)
    none = ~jnp.any(jnp.stack([jnp.any(one) for one in jax.tree.leaves(moves)]))
    return jax.tree.map(lambda one: one | none, moves)


def may_have_clocks(field: VectorField, state: PyTree) -> bool:
    """Return whether some variables, but not all, may be polynomials of time.

    That is certainly not so if the rate of each variable is a nonlinear function of the state, or
    depends on such a variable, as in equations of motion of pendulums.
    """
    if isinstance(field, PowerBalance):
        return False
    leaves = jax.tree.leaves(state)
    if any(map(jnp.ndim, leaves)):
        return True
    closed, _ = trace(field, state)
    rates = Dependence().interpret(closed, [frozenset({i}) for i in range(len(leaves))])
    moving: set = {NONLINEAR}
    for _ in leaves:
        moving |= {i for i, rate in enumerate(rates) if rate & moving}
    return len(moving) <= len(leaves)


NONLINEAR = -1
"""Stands for a nonlinear function of the state among the variables on which a result depends."""


class Dependence(Interpreter):
    """Finds the variables on which the results of a function depend linearly."""

    def constant(self, value) -> frozenset:
        return frozenset()

    def default_rule(self, equation, operands: list[frozenset]) -> list[frozenset]:
        linear = equation.primitive.name in (*LINEAR, "add", "sub", "convert_element_type")
        if equation.primitive.name in ("mul", "div"):
            linear = not all(operands) if equation.primitive.name == "mul" else not operands[1]
        depends = frozenset().union(*operands)
        depends = depends if linear or not depends else frozenset({NONLINEAR})
        return [depends] * len(equation.outvars)

    rules: ClassVar = {**CALLS, **CALLS_WITH_DERIVATIVES}


# --------------------------------------------------------------- derivatives and sharp features


@eqx.filter_custom_jvp
def shorten(
    field: VectorField | None,
    blocks: Sequence[PyTree],
    length: Scalar,
    tolerance: Real,
    sizes: PyTree,
) -> Scalar:
    """Return the length of a step, halved until derivatives and sharp features allow it.

    The result is constant to derivatives.

    **Arguments:**

    - `field`: the equations y' = f(y), if they have sharp features; otherwise None.
    - `blocks`: the series of the solution, then those of its derivatives. JAX adds them: those
      along a first direction; then, along a second, the derivatives of all that precede.
    - `length`: what the series of the solution allow.
    - `tolerance`, `sizes`: as for `step_size`.
    """
    if field is None and len(blocks) == 1:
        return length

    def fits(h):
        fits = jnp.asarray(True)
        for derivative in blocks[1:]:
            fits &= derivative_fits(derivative, h, tolerance)
        fits = fits if field is None else fits & field_fits(field, blocks, h, tolerance, sizes)
        return holds_along_all(fits)

    return shorten_until(fits, length, SHORTER if field is None else 0.5)


@shorten.def_jvp
def vary_length(primals, tangents):
    field, blocks, *rest = primals
    varied = None if field is None else VariedField(field, tangents[0])
    changes = [with_zeros(*pair) for pair in zip(tangents[1], blocks, strict=True)]
    length = shorten(varied, (*blocks, *changes), *rest)
    return length, jnp.zeros_like(length)


def shorten_until(
    fits: Callable[[Scalar], Bool[Array, ""]], length: Scalar, part: float = 0.5
) -> Scalar:
    """Return the length of a step, multiplied by `part` until it fits; NaN if none does."""
    least = length * 0.5**MOST_HALVINGS
    found = lax.while_loop(lambda h: ~fits(h) & (h > least), lambda h: h * part, length)
    return jnp.where(found > least, found, jnp.nan)


def derivative_fits(series: PyTree, length: Scalar, tolerance: Real) -> Bool[Array, ""]:
    """Return whether the last terms of a derivative are small beside its first ones in a step.

    If they are not finite, no shorter step makes them so.
    """
    last = order_of(series) - 1, order_of(series)
    finite = jnp.isfinite(sum_of_terms(series, jnp.ones_like(length), last))
    size = DERIVATIVE_TOLERANCE * tolerance * sum_of_terms(series, length, FIRST_TERMS)
    return ~(finite & (sum_of_terms(series, length, last) > size))


def sum_of_terms(series: PyTree, length: Scalar, orders: Sequence[int]) -> Scalar:
    """Return the sum of the moduli of successive terms of a series at the end of a step."""
    leaves = lax.stop_gradient(jax.tree.leaves(series, is_leaf=is_list))
    sizes = [reduce(operator.add, (jnp.sum(jnp.abs(c[k])) for c in leaves)) for k in orders]
    return evaluate_polynomial(sizes, length) * length ** orders[0]


def has_sharp_features(function: Callable, state: PyTree) -> bool:
    """Return whether a function contains primitives whose series may not show what lies ahead."""
    return any(map(is_sharp, equations_in(jax.make_jaxpr(function)(state).jaxpr)))


def is_sharp(equation) -> bool:
    """Return whether the series of an equation's result may not show what lies ahead."""
    name = equation.primitive.name
    return name in SHARP or (name == "integer_pow" and equation.params["y"] > LOW_POWER)


def field_fits(
    field: VectorField, blocks: Sequence[PyTree], length: Scalar, tolerance: Real, sizes: PyTree
) -> Bool[Array, ""]:
    """Return whether the equations agree with the slope of the polynomials in a step."""
    count = len(jax.tree.leaves(blocks[0], is_leaf=is_list))
    allowed = [sizes] * count if eqx.is_array(sizes) else jax.tree.leaves(sizes)
    for series in blocks[1:]:
        allowed += [DERIVATIVE_TOLERANCE * sum_of_terms(series, length, FIRST_TERMS)] * count
    # A derivative may vanish before the feature; it is then compared with its change beyond.
    scale, rounding = scale_of(blocks[0]), float(jnp.finfo(length.dtype).eps)
    unit = scale / jnp.maximum(largest_coefficient(blocks[0], 1), rounding * scale)
    slopes = jax.tree.map(derivative_of, nest(blocks), is_leaf=is_list)
    agree = jnp.asarray(True)
    for t in (length, length / 2):
        rates = jax.tree.leaves(field(evaluate_series(nest(blocks), t)))
        expected = jax.tree.leaves(evaluate_series(slopes, t))
        for i, (rate, slope, size) in enumerate(zip(rates, expected, allowed, strict=True)):
            if i >= count:
                size = jnp.maximum(size, DERIVATIVE_TOLERANCE * unit * jnp.abs(rate))
            near = jnp.abs(rate - slope) * length <= DEFECT * tolerance * size
            agree &= jnp.all(near | ~jnp.isfinite(slope))  # no shorter step makes a series finite
    return agree


def nest(blocks: Sequence[PyTree]) -> Any:
    """Return the state of the variational equations: a state, or pairs of pairs of states."""
    half = len(blocks) // 2
    return (nest(blocks[:half]), nest(blocks[half:])) if half else blocks[0]
