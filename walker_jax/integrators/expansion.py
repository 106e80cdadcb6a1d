"""Power series of functions of power series: a rule for each of JAX's primitives.

If a function has a kink, as |x| has at zero, its series continues the branch on which it starts.
The series is valid until a switching function changes sign: x for |x|, a - b for max(a, b).
"""

import operator
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal
from jaxtyping import Array, PyTree

from walker_jax.integrators.branches import (
    branch_rule,
    cast_switches,
    distances_to_rounding,
    loop_rule,
    remainder,
    remainder_switches,
)
from walker_jax.integrators.definitions import (
    by_squaring,
    cumulative_product,
    reduce_by,
    reduce_product,
)
from walker_jax.integrators.linear_systems import LINEAR_ALGEBRA
from walker_jax.integrators.series import (
    EQUATIONS,
    Series,
    bilinear,
    constant,
    dense_coefficient,
    evaluate_polynomial,
    minus,
    parts,
    plus,
    quotient,
    scale,
    sincos,
    sine_and_cosine,
    solution,
    times,
)
from walker_jax.integrators.softplus import custom_call_rule
from walker_jax.integrators.unknown_series import no_series
from walker_jax.kernels.jaxprs import (
    CALLS,
    CALLS_WITH_DERIVATIVES,
    Interpreter,
    binding,
    changes_entries,
    line_of,
)
from walker_jax.kernels.products import add_one_by_one

switches: ContextVar[list[Series] | None] = ContextVar("switches", default=None)
"""The list that collects switching functions; None if they are not wanted."""
bases: ContextVar[list[Series] | None] = ContextVar("bases", default=None)
"""The list that collects the bases of fractional powers, which switch too; None likewise."""


def compose(function: Callable, series: PyTree[Series], start: PyTree) -> PyTree[Series]:
    """Return the series of function(y(t)), given those of y(t), with `start` = y(0)."""
    closed, shapes = trace(function, start)
    results = Expansion().interpret(closed, jax.tree.leaves(series))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def trace(function: Callable, start: PyTree) -> tuple[ClosedJaxpr, PyTree]:
    """Return the jaxpr of a function of the leaves of `start`, and the shapes of its results."""
    leaves, structure = jax.tree.flatten(start)
    flat = lambda *leaves: function(jax.tree.unflatten(structure, leaves))
    return jax.make_jaxpr(flat, return_shape=True)(*leaves)


def with_fast_sincos(function: Callable) -> Callable:
    """Return the function with every sine and cosine computed by `sincos`."""

    def faster(*args):
        closed, shapes = trace(lambda a: function(*a), args)
        results = first_coefficients(closed, jax.tree.leaves(args))
        return jax.tree.unflatten(jax.tree.structure(shapes), results)

    return faster


def first_coefficients(closed: ClosedJaxpr, leaves: list) -> list[Array]:
    results = Expansion().interpret(closed, list(map(constant, leaves)))
    return [jnp.asarray(series[0]) for series in results]


def without_derivatives(function: Callable, start: PyTree, *, once: bool = False) -> Callable:
    """Return a function with `sincos` in which nothing is differentiated.

    Its argument and the values in its closure are constants to differentiation. It is traced at
    `start`. If `once`, all calls with states of the same types share one program, in loops too.
    """
    closed, shapes = trace(function, start)
    compute = lambda held, leaves: first_coefficients(closed.replace(consts=held), leaves)
    compute = jax.jit(compute) if once else compute

    def constant_function(state):
        # Stopped here, not outside: reverse mode differentiates by all that a function closes over.
        results = compute(*lax.stop_gradient((closed.consts, jax.tree.leaves(state))))
        return jax.tree.unflatten(jax.tree.structure(shapes), results)

    return constant_function


class Expansion(Interpreter):
    """Computes the series of a jaxpr's results, given those of its arguments."""

    def __init__(self):
        self.pairs: dict = {}
        """By argument: its sine and cosine, circular or hyperbolic, computed together."""
        self.source: Any = None
        """Where the equation is from that is being expanded."""

    def constant(self, value) -> Series:
        return constant(value)

    def apply(self, equation, operands: list[Series]) -> list[Series]:
        """Return the results; an equation without a line of user code has its caller's."""
        caller = self.source
        if caller is not None and line_of(equation) is None:
            equation = equation.replace(source_info=caller)
        self.source = equation.source_info
        try:
            return super().apply(equation, operands)
        finally:
            self.source = caller

    def default_rule(self, equation, operands: list[Series]) -> list[Series]:
        """Evaluate a primitive without a rule; raise if an operand varies with time."""

        def rule(k, operands, bind):
            if any(operand[j] is not None for operand in operands for j in range(1, k + 1)):
                raise no_series(equation.primitive.name)

        return by_coefficients(rule)(self, equation, operands)


# Rules: the k-th coefficient of a result, k > 0, given the operands and the bound primitive.


def square_operand(k: int, operands: list[Series], bind: Callable) -> Any:
    return times(k, operands * 2)


def one_minus_square(k: int, operands: list[Series], bind: Callable) -> Any:
    return scale(times(k, operands * 2), -1)


def linear(k: int, operands: list[Series], bind: Callable) -> Any:
    """Return a result that is jointly linear in its real operands; indices, flags are constant."""
    if all(value is None for value in [x[k] for x in operands]):  # evaluates all, as one may raise
        return None
    return bind(*(dense_coefficient(k, x) if varies(x) else x[0] for x in operands))


def varies(x: Series) -> Any:
    """Return whether a series has real or complex numbers; others are constant between jumps."""
    return jnp.issubdtype(jnp.result_type(x[0]), jnp.inexact)


def one_of_two(takes_left: Callable, k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    which = takes_left(left[0], right[0])
    if left[k] is None and right[k] is None:
        return None
    return jnp.where(which, dense_coefficient(k, left), dense_coefficient(k, right))


def clamped_operand(k: int, operands: list[Series], bind: Callable) -> Any:
    if all(operand[k] is None for operand in operands):
        return None
    low, x, high = (operand[0] for operand in operands)
    below, inside, above = (dense_coefficient(k, operand) for operand in operands)
    return jnp.where(x < low, below, jnp.where(x > high, above, inside))


def absolute_value(k: int, operands: list[Series], bind: Callable) -> Any:
    (x,) = operands
    return None if x[k] is None else jnp.where(x[0] < 0, -x[k], x[k])


# Application of the rules to an equation.


def by_coefficients(rule: Callable) -> Callable:
    """Compute c_0 by the primitive itself, and the other coefficients by a rule."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        bind = binding(equation)
        series = Series(lambda k: rule(k, operands, bind) if k else bind(*(x[0] for x in operands)))
        return parts(series, equation)

    return expand


def gather_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand entries at computed indices; an entry out of bounds is constant."""
    bind, (x, places) = binding(equation), operands
    change = partial(bind, fill_value=0)
    return [Series(lambda k: None if x[k] is None else (change if k else bind)(x[k], places[0]))]


def scatter_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    if changes_entries("scatter", equation.params):
        raise no_series("scatter with a function of the entries")
    return by_coefficients(linear)(expansion, equation, operands)


def by_equation(name: str) -> Callable:
    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        return [solution(EQUATIONS[name], binding(equation), *operands)]

    return expand


def by_definition(function: Callable) -> Callable:
    """Expand a primitive by the function that defines it."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        start = [x[0] for x in operands]
        closed = jax.make_jaxpr(partial(function, **equation.params))(*start)
        return expansion.interpret(closed, operands)

    return expand


def by_pair(values: Callable, sign: int, which: int) -> Callable:
    """Expand a sine or cosine, by one recurrence for both."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        (x,) = operands
        if (x, sign) not in expansion.pairs:
            expansion.pairs[x, sign] = sine_and_cosine(x, values, sign)
        return [expansion.pairs[x, sign][which]]

    return expand


def division_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    numerator, denominator = operands
    return [quotient(numerator, denominator, binding(equation))]


def power_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand x^p for a real p; if p is a literal integer, p >= 0, x may be zero."""
    x, p = operands
    exponent = equation.invars[1]
    rule = fractional_power
    if isinstance(exponent, Literal) and exponent.val >= 0 and float(exponent.val).is_integer():
        rule = by_definition(lambda x, p: by_squaring(x, int(exponent.val)))
    elif isinstance(exponent, Literal) and exponent.val < 0:
        rule = by_equation("pow")
    elif not varies(p):
        p = constant(jnp.asarray(p[0], x[0].dtype))
    return rule(expansion, equation, [x, p])


def fractional_power(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand a root, or a power with a real exponent, whose derivatives are infinite at x = 0.

    Where x is zero for a while, the power is zero too, with its derivatives. If x only begins at
    zero, it is a switching function that is zero at once, so that the step is very short.
    """
    name, bind = equation.primitive.name, binding(equation)
    if (found := bases.get()) is not None:
        add_switches(found, [Series(operands[0].__getitem__)], equation)

    def value(x, *p):
        zero = x == 0
        at_zero = jnp.where(p[0] > 0, 0, jnp.where(p[0] == 0, 1, jnp.inf)) if p else 0
        return jnp.where(zero, at_zero, bind(jnp.where(zero, 1, x), *p))

    return [solution(EQUATIONS[name], value, *operands)]


def integer_power_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    p = equation.params["y"]
    if p >= 0:
        return by_definition(by_squaring)(expansion, equation, operands)
    return [solution(lambda y, x, Dx: Dx * (y * p) / x, binding(equation), *operands)]


def record_switches(switch: Callable[..., list[Series]], rule: Callable) -> Callable:
    """Extend a rule so that it records the primitive's switching functions."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        if (found := switches.get()) is not None and varies(operands[0]):
            add_switches(found, switch(*operands), equation)
        return rule(expansion, equation, operands)

    return expand


def add_switches(found: list[Series], new: list[Series], equation) -> None:
    """Add an equation's switching functions to a list."""
    for one in new:
        one.equation = equation
    found += new


def conversion_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Convert to another type; from a real to an integer or a flag, the result jumps."""
    kept = jnp.issubdtype(equation.params["new_dtype"], jnp.inexact)
    rule = (
        by_coefficients(linear)
        if kept
        else record_switches(cast_switches, by_coefficients(piecewise_constant))
    )
    return rule(expansion, equation, operands)


def piecewise_constant(k: int, operands: list[Series], bind: Callable) -> None:
    """Return None: the result is constant in time between its jumps."""
    for x in operands:
        if not varies(x):
            x[k]  # raises if its jumps are not known


LINEAR = (
    "broadcast_in_dim complex concatenate conj copy copy_p cumsum dynamic_slice "
    "dynamic_update_slice expand_dims fft imag neg pad real reduce_sum reduce_window_sum "
    "reshape rev scatter-add select_n slice split squeeze stack stop_gradient transpose "
    "unstack"
).split()
"""Primitives that are jointly linear in their real operands."""
DISCRETE = "and ceil eq floor ge gt is_finite le le_to lt lt_to ne not or round sign xor".split()
"""Primitives whose results are constant in time between jumps."""
Expansion.rules = {
    **CALLS,
    **CALLS_WITH_DERIVATIVES,
    **LINEAR_ALGEBRA,
    **dict.fromkeys(LINEAR, by_coefficients(linear)),
    "gather": gather_rule,
    "scatter": scatter_rule,
    **dict.fromkeys(DISCRETE, by_coefficients(piecewise_constant)),
    **dict.fromkeys(("add", "add_any"), by_coefficients(plus)),
    **dict.fromkeys(("conv_general_dilated", "dot_general"), by_coefficients(bilinear)),
    **{name: by_equation(name) for name in EQUATIONS},
    **dict.fromkeys(("cbrt", "sqrt"), fractional_power),
    "abs": by_coefficients(absolute_value),
    "clamp": by_coefficients(clamped_operand),
    "cond": branch_rule,
    "convert_element_type": conversion_rule,
    "cos": by_pair(sincos, -1, 1),
    "custom_jvp_call": custom_call_rule,
    "cosh": by_pair(lambda x: (jnp.sinh(x), jnp.cosh(x)), 1, 1),
    "cumprod": by_definition(cumulative_product),
    "div": division_rule,
    "integer_pow": integer_power_rule,
    "max": by_coefficients(partial(one_of_two, operator.ge)),
    "min": by_coefficients(partial(one_of_two, operator.le)),
    "mul": by_coefficients(times),
    "one_minus_square": by_coefficients(one_minus_square),
    "polynomial": by_definition(lambda x, *c, **_: evaluate_polynomial(list(c), x)),
    "pow": power_rule,
    "reduce_max": by_definition(reduce_by(lax.max)),
    "reduce_min": by_definition(reduce_by(lax.min)),
    "reduce_prod": by_definition(reduce_product),
    "rem": by_coefficients(remainder),
    "scan": loop_rule,
    "sin": by_pair(sincos, -1, 0),
    "sinh": by_pair(lambda x: (jnp.sinh(x), jnp.cosh(x)), 1, 0),
    "square": by_coefficients(square_operand),
    "sub": by_coefficients(minus),
    "sum_of_products": by_definition(add_one_by_one),
}
SWITCHES: dict[str, Callable[..., list[Series]]] = {
    **dict.fromkeys(
        ("ge", "gt", "le", "le_to", "lt", "lt_to", "max", "min"), lambda left, right: [left - right]
    ),
    **dict.fromkeys(("abs", "sign"), lambda x: [x]),
    "atan2": lambda y, x: [y],
    "ceil": lambda x: distances_to_rounding(x, lambda value: jnp.ceil(value) - 1),
    "clamp": lambda low, x, high: [x - low, high - x],
    "floor": lambda x: distances_to_rounding(x, jnp.floor),
    "rem": remainder_switches,
    "round": lambda x: distances_to_rounding(x, lambda value: jnp.round(value) - 0.5),
}
"""By primitive: functions of the operands; the result has a kink or a jump at their zeros."""

Expansion.rules |= {
    name: record_switches(SWITCHES[name], Expansion.rules[name]) for name in SWITCHES
}
