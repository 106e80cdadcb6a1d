"""Series of functions of series: a rule for each of JAX's primitives.

Where a function has a kink, as |x| at zero, its series continues the branch on which it starts. It
holds until a switching function changes its sign, x for |x|, and a - b for max(a, b).
"""

import operator
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import Literal
from jaxtyping import PyTree

from walker_jax.integrators.series import (
    EQUATIONS,
    Series,
    bilinear,
    constant,
    minus,
    plus,
    quotient,
    scaled,
    sincos,
    sine_and_cosine,
    solution,
    times,
)
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES, Interpreter, changes_entries

switches: ContextVar[list[Series] | None] = ContextVar("switches", default=None)
"""Where to note every switching function, if anywhere."""


def compose(function: Callable, series: PyTree[Series], start: PyTree) -> PyTree[Series]:
    """The series of function(y(t)), given those of y(t), which is `start` at t = 0."""
    structure = jax.tree.structure(start)
    flat = lambda *leaves: function(jax.tree.unflatten(structure, leaves))
    closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*jax.tree.leaves(start))
    results = Expansion().interpret(closed, jax.tree.leaves(series))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


class Expansion(Interpreter):
    """The series of a jaxpr's results, given those of its arguments."""

    def __init__(self):
        self.pairs: dict = {}
        """Sine and cosine of every series of which either was asked for, also hyperbolic ones."""

    def constant(self, value) -> Series:
        return constant(value)

    def keep(self, equation, operands: list[Series]) -> list[Series]:
        """Results of a primitive whose series is not known: constants, or they are refused."""

        def rule(k, operands, bind):
            if any(operand[j] is not None for operand in operands for j in range(1, k + 1)):
                raise no_series(equation.primitive.name)

        return by_coefficients(rule)(self, equation, operands)


def no_series(name: str) -> NotImplementedError:
    return NotImplementedError(
        f"no Taylor series is known of the JAX primitive {name!r}: write the equations without "
        "it, or integrate them with one of diffrax's Runge-Kutta solvers"
    )


# Rules: the k-th coefficient of a result, k > 0, given its operands and the primitive itself.


def squared(k: int, operands: list[Series], bind: Callable) -> Any:
    return times(k, operands * 2)


def linear(k: int, operands: list[Series], bind: Callable) -> Any:
    """Of all real operands together; others, as indices and choices, stay as they are."""
    if all(value is None for value in [x[k] for x in operands]):  # all asked for: one may refuse
        return None
    return bind(*(filled(k, x) if varies(x) else x[0] for x in operands))


def varies(x: Series) -> Any:
    """Whether a series is of real or complex numbers: others are constant but for jumps."""
    return jnp.issubdtype(jnp.result_type(x[0]), jnp.inexact)


def filled(k: int, x: Series) -> Any:
    """The k-th coefficient as an array."""
    return jnp.zeros_like(x[0]) if x[k] is None else x[k]


def greater(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    return branch(k, left[0] >= right[0], left, right)


def lesser(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    return branch(k, left[0] <= right[0], left, right)


def branch(k: int, which, one: Series, other: Series) -> Any:
    """The k-th coefficient of one series or another."""
    if one[k] is None and other[k] is None:
        return None
    return jnp.where(which, filled(k, one), filled(k, other))


def clamped(k: int, operands: list[Series], bind: Callable) -> Any:
    if all(operand[k] is None for operand in operands):
        return None
    low, x, high = (operand[0] for operand in operands)
    below, inside, above = (filled(k, operand) for operand in operands)
    return jnp.where(x < low, below, jnp.where(x > high, above, inside))


def absolute(k: int, operands: list[Series], bind: Callable) -> Any:
    (x,) = operands
    return None if x[k] is None else jnp.where(x[0] < 0, -x[k], x[k])


# How they are applied to an equation.


def by_coefficients(rule: Callable) -> Callable:
    """c_0 by the primitive itself, the others by a rule for the k-th one."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        bind = binding(equation)
        series = Series(lambda k: rule(k, operands, bind) if k else bind(*(x[0] for x in operands)))
        return parts(series, equation)

    return expand


def binding(equation) -> Callable:
    """A function of a primitive's operands."""
    primitive = equation.primitive
    return partial(primitive.bind, **primitive.get_bind_params(equation.params))


def parts(series: Series, equation) -> list[Series]:
    """The series of an equation's results; where there are several, `series` has lists of them."""
    if not equation.primitive.multiple_results:
        return [series]
    part = lambda i: Series(lambda k: None if (all := series[k]) is None else all[i])
    return [part(i) for i in range(len(equation.outvars))]


def gathered(expansion, equation, operands: list[Series]) -> list[Series]:
    """Entries at computed places; where one is out of bounds, a constant."""
    bind, (x, places) = binding(equation), operands
    change = partial(bind, fill_value=0)
    return [Series(lambda k: None if x[k] is None else (change if k else bind)(x[k], places[0]))]


def scattered(expansion, equation, operands: list[Series]) -> list[Series]:
    if changes_entries("scatter", equation.params):
        raise no_series("scatter with a function of the entries")
    return by_coefficients(linear)(expansion, equation, operands)


def by_equation(name: str) -> Callable:
    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        return [solution(EQUATIONS[name], binding(equation), *operands)]

    return expand


def by_definition(function: Callable) -> Callable:
    """A primitive as a function of others."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        start = [x[0] for x in operands]
        closed = jax.make_jaxpr(partial(function, **equation.params))(*start)
        return expansion.interpret(closed, operands)

    return expand


def by_pair(values: Callable, sign: int, which: int) -> Callable:
    """Sine or cosine: the other one is asked for too."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        (x,) = operands
        if (x, sign) not in expansion.pairs:
            expansion.pairs[x, sign] = sine_and_cosine(x, values, sign)
        return [expansion.pairs[x, sign][which]]

    return expand


def divided(expansion, equation, operands: list[Series]) -> list[Series]:
    numerator, denominator = operands
    return [quotient(numerator, denominator, binding(equation))]


def power(expansion, equation, operands: list[Series]) -> list[Series]:
    """x^p for a real p; where that stands there as a whole number, x may be zero."""
    x, p = operands
    exponent = equation.invars[1]
    rule = by_equation("pow")
    if isinstance(exponent, Literal) and exponent.val >= 0 and float(exponent.val).is_integer():
        rule = by_definition(lambda x, p: by_squaring(x, int(exponent.val)))
    elif not varies(p):
        p = constant(jnp.asarray(p[0], x[0].dtype))
    return rule(expansion, equation, [x, p])


def whole_power(expansion, equation, operands: list[Series]) -> list[Series]:
    p = equation.params["y"]
    if p >= 0:
        return by_definition(by_squaring)(expansion, equation, operands)
    return [solution(lambda y, x, Dx: Dx * (y * p) / x, binding(equation), *operands)]


def by_squaring(x, y: int):
    """x^y for a whole number y."""
    if y < 2:
        return x if y else jnp.ones_like(x)
    half = by_squaring(x, y // 2)
    return half * half * x if y % 2 else half * half


def cumulative_product(x, axis: int, reverse: bool):
    return lax.associative_scan(lax.mul, x, axis=axis, reverse=reverse)


def product_over(x, axes, **_):
    rows = jnp.moveaxis(x, axes, range(len(axes)))
    rows = rows.reshape(-1, *rows.shape[len(axes) :])
    return reduce(operator.mul, rows, jnp.ones_like(x, shape=rows.shape[1:]))


def noting(switch: Callable[..., list[Series]], rule: Callable) -> Callable:
    """A rule that notes the primitive's switching functions."""

    def expand(expansion, equation, operands: list[Series]) -> list[Series]:
        if (found := switches.get()) is not None and varies(operands[0]):
            found += switch(*operands)
        return rule(expansion, equation, operands)

    return expand


def converted(expansion, equation, operands: list[Series]) -> list[Series]:
    """To another type; a real number that becomes whole, or a truth value, jumps."""
    kept = jnp.issubdtype(equation.params["new_dtype"], jnp.inexact)
    rule = by_coefficients(linear) if kept else noting(cast_switches, by_coefficients(none))
    return rule(expansion, equation, operands)


def none(k: int, operands: list[Series], bind: Callable) -> None:
    """A result that does not change with time, but for jumps."""
    for x in operands:
        if not varies(x):
            x[k]  # which may refuse, as what has jumps that are not known does


def to_rounding(x: Series, whole: Callable) -> list[Series]:
    """How far x is from the two ends of the interval in which it is rounded to one number."""
    below = lambda k: x[0] - whole(x[0]) if k == 0 else x[k]
    above = lambda k: whole(x[0]) + 1 - x[0] if k == 0 else scaled(x[k], -1)
    return [Series(below), Series(above)]


def cast_switches(x: Series) -> list[Series]:
    return [x, *to_rounding(x, jnp.floor)]


LINEAR = (
    "broadcast_in_dim complex concatenate conj copy copy_p cumsum dynamic_slice "
    "dynamic_update_slice expand_dims fft imag neg pad real reduce_sum reduce_window_sum "
    "reshape rev scatter-add select_n slice split squeeze stack stop_gradient transpose "
    "unstack"
).split()
"""Primitives that are linear in all their real operands together."""
DISCRETE = "and ceil eq floor ge gt is_finite le lt ne not or round sign xor".split()
"""Those whose results do not change with time, but for jumps."""
Expansion.rules = {
    **CALLS,
    **CALLS_WITH_DERIVATIVES,
    **dict.fromkeys(LINEAR, by_coefficients(linear)),
    "gather": gathered,
    "scatter": scattered,
    **dict.fromkeys(DISCRETE, by_coefficients(none)),
    **dict.fromkeys(("add", "add_any"), by_coefficients(plus)),
    **dict.fromkeys(("conv_general_dilated", "dot_general"), by_coefficients(bilinear)),
    **{name: by_equation(name) for name in EQUATIONS},
    "abs": by_coefficients(absolute),
    "clamp": by_coefficients(clamped),
    "convert_element_type": converted,
    "cos": by_pair(sincos, -1, 1),
    "cosh": by_pair(lambda x: (jnp.sinh(x), jnp.cosh(x)), 1, 1),
    "cumprod": by_definition(cumulative_product),
    "div": divided,
    "integer_pow": whole_power,
    "max": by_coefficients(greater),
    "min": by_coefficients(lesser),
    "mul": by_coefficients(times),
    "pow": power,
    "reduce_prod": by_definition(product_over),
    "sin": by_pair(sincos, -1, 0),
    "sinh": by_pair(lambda x: (jnp.sinh(x), jnp.cosh(x)), 1, 0),
    "square": by_coefficients(squared),
    "sub": by_coefficients(minus),
}
SWITCHES: dict[str, Callable[..., list[Series]]] = {
    **dict.fromkeys(("ge", "gt", "le", "lt", "max", "min"), lambda left, right: [left - right]),
    **dict.fromkeys(("abs", "sign"), lambda x: [x]),
    "atan2": lambda y, x: [y],
    "ceil": lambda x: to_rounding(x, lambda value: jnp.ceil(value) - 1),
    "clamp": lambda low, x, high: [x - low, high - x],
    "floor": lambda x: to_rounding(x, jnp.floor),
    "round": lambda x: to_rounding(x, lambda value: jnp.round(value) - 0.5),
}
"""Switching functions of primitives, whose results have a kink or a jump where one is zero."""

Expansion.rules |= {name: noting(SWITCHES[name], Expansion.rules[name]) for name in SWITCHES}
