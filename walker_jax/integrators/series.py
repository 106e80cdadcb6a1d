"""Power series in t: arithmetic and elementary functions.

The k-th coefficient of a product is sum_j a_j b_{k-j}. Any other smooth function solves a
differential equation: with D = t d/dt, which multiplies the k-th coefficient by k, y = exp(x)
solves D y = D x y, and y = sqrt(x) solves D y = D x / (2 y). So y_k follows from y_0 ... y_{k-1}
(Griewank and Walther 2008, chapter 13).
"""

import math
import operator
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from walker_jax.kernels.products import sum_of_products


@jax.jit  # traced once for all calls
def sincos(angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return sine and cosine of an angle up to 1e5 rad, with errors below the dtype's epsilon.

    The angle is reduced to [-pi/4, pi/4] by a multiple of pi/2 in three parts (Cody and Waite).
    There sine and cosine are polynomials. XLA's own float64 sine accepts any argument, but costs
    seven times as much as this pair on a CPU.
    """
    return sincos_and_derivative(angle)


@jax.custom_jvp
def sincos_and_derivative(angle):
    dtype = angle.dtype
    if dtype == jnp.float64:
        parts = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
    elif dtype == jnp.float32:
        parts = (1.5703125, 4.837512969970703e-4, 7.549789954891882e-8)
    else:
        return lax.sin(angle), lax.cos(angle)
    quadrant = lax.round(angle * (2 / math.pi), lax.RoundingMethod.TO_NEAREST_EVEN)
    x = angle
    for part in parts:
        x = x - quadrant * part
    terms, eps = 1, float(jnp.finfo(dtype).eps)
    while (math.pi / 4) ** (2 * terms) / math.factorial(2 * terms) > eps / 16:
        terms += 1
    z = x * x
    sine = x * evaluate_polynomial([(-1) ** i / math.factorial(2 * i + 1) for i in range(terms)], z)
    cosine = evaluate_polynomial([(-1) ** i / math.factorial(2 * i) for i in range(terms)], z)
    turn = quadrant.astype(jnp.int32)
    odd = (turn & 1) == 1
    sine, cosine = lax.select(odd, cosine, sine), lax.select(odd, sine, cosine)
    return (
        lax.select((turn & 2) == 2, -sine, sine),
        lax.select(((turn + 1) & 2) == 2, -cosine, cosine),
    )


@sincos_and_derivative.defjvp
def _sincos_jvp(primals, tangents):
    (angle,), (dangle,) = primals, tangents
    sine, cosine = sincos(angle)
    return (sine, cosine), (cosine * dangle, -sine * dangle)


def evaluate_polynomial(coefficients: list, t):
    """Evaluate the polynomial c_0 + c_1 t + c_2 t^2 + ... by Horner's rule."""
    value = coefficients[-1] + jnp.zeros_like(t)
    for coefficient in coefficients[-2::-1]:
        value = sum_of_products(value, t, coefficient)
    return value


def short_logs(*xs: Float[Array, ""]) -> list[Float[Array, ""]]:
    """Return log(x) in float32, where it is cheap, also of a float64 too large for that type."""
    known = [(x, jnp.zeros_like(x, jnp.float32)) for x in xs]
    if xs[0].dtype == jnp.float64:  # one loop for all, as hardly any number is so large
        large = lambda x: (x > 1e30) & (x < jnp.inf)
        shrunk = lambda x, log: (x * 1e-60, log + 60 * math.log(10))
        shrink = lambda x, log: jax.tree.map(partial(jnp.where, large(x)), shrunk(x, log), (x, log))
        any_large = lambda known: reduce(operator.or_, [large(x) for x, _ in known])
        known = lax.while_loop(any_large, lambda known: [shrink(*one) for one in known], known)
    return [log + jnp.log(x.astype(jnp.float32)) for x, log in known]


class Series:
    """A power series whose coefficients are computed when first read.

    A coefficient of `None` is zero. The first coefficient of an argument or result is never `None`.
    """

    equation: Any = None
    """The equation of a jaxpr to which a switching function belongs."""

    def __init__(self, rule: Callable[[int], Any], coefficients: Iterable = ()):
        self.rule = rule
        self.coefficients: list = list(coefficients)
        if (made := series_log.get()) is not None:
            made.append(self)

    def __getitem__(self, k: int):
        while len(self.coefficients) <= k:
            self.coefficients.append(self.rule(len(self.coefficients)))
        return self.coefficients[k]

    def __neg__(self):
        return Series(lambda k: scale(self[k], -1))

    def __add__(self, other):
        return combine(plus, self, other)

    def __sub__(self, other):
        return combine(minus, self, other)

    def __mul__(self, other):
        return combine(times, self, other)

    def __truediv__(self, other):
        return quotient(self, other)

    def __radd__(self, other):
        return combine(plus, constant(other), self)

    def __rsub__(self, other):
        return combine(minus, constant(other), self)

    def __rmul__(self, other):
        return combine(times, constant(other), self)


def coefficients_up_to(series: Series, order: int) -> list:
    """Return the coefficients of a series up to an order, as arrays."""
    zero = jnp.zeros_like(series[0])
    return [zero if series[k] is None else series[k] for k in range(order + 1)]


def dense_coefficient(k: int, x: Series) -> Any:
    """Return the k-th coefficient as an array, zeros for None."""
    return jnp.zeros_like(x[0]) if x[k] is None else x[k]


def parts(series: Series, equation) -> list[Series]:
    """Split a series into those of an equation's results, if coefficients are lists of several."""
    if not equation.primitive.multiple_results:
        return [series]
    part = lambda i: Series(lambda k: None if (all := series[k]) is None else all[i])
    return [part(i) for i in range(len(equation.outvars))]


series_log: ContextVar[list[Series] | None] = ContextVar("series_log", default=None)
"""The list that collects every new series; None if they are not wanted."""


@contextmanager
def recording(where: ContextVar[list[Series] | None]):
    """Collect series in a new list of a context variable, inside a `with` block."""
    collected: list[Series] = []
    token = where.set(collected)
    try:
        yield collected
    finally:
        where.reset(token)


# Coefficients. None is zero.


def constant(value) -> Series:
    return Series(lambda k: value if k == 0 else None)


results_known: ContextVar[dict | None] = ContextVar("results_known", default=None)
"""Kept results of operations on coefficients, so that each is traced once; None if not kept."""


@contextmanager
def keeping_results():
    """Compute equal terms of coefficients only once, inside a `with` block.

    A series that is computed again with one more coefficient shares most of its terms.
    """
    token = results_known.set({})
    try:
        yield
    finally:
        results_known.reset(token)


def apply_once(operation: Callable, *operands):
    """Return operation(*operands), the same object for the same operands."""
    known = results_known.get()
    if known is None:
        return operation(*operands)
    key = tuple(map(id, (operation, *operands)))
    if key not in known:  # keeps the operands alive, so that no others have their ids
        known[key] = operation, operands, operation(*operands)
    return known[key][-1]


def scale(value, factor):
    if value is None:
        return None
    return apply_once(lax.mul, value, number(factor, jnp.result_type(value)))  # faster than *


@cache
def number(value: float, dtype) -> np.ndarray:
    """Return a number of a type, always the same object, as `apply_once` compares objects."""
    return np.asarray(value, dtype)


def add_terms(terms):
    terms = [term for term in terms if term is not None]
    return reduce(partial(apply_once, lax.add), terms) if terms else None


def add_products(left: Series, right: Series, places: Iterable[tuple[int, int]], start=None):
    """Return the sum of left_i right_j over the places (i, j), in this order, and of `start`.

    The right coefficient is not read if the left one is zero. Where results are kept, so is the
    sum without its last two products.
    """
    products: list = []
    for i, j in places:
        if (one := left[i]) is not None and (other := right[j]) is not None:
            products += one, other
    known = 0 if results_known.get() is None else max(len(products) - 4, 0)
    for part in (products[:known], products[known:]):
        if part:
            start = apply_once(sum_of_products, *part, *(() if start is None else (start,)))
    return start


def newest_last(last: int) -> list[int]:
    """Return 0 ... last, with these two moved to the end, as their terms are known last.

    A processor can then sum the other terms while it waits for them.
    """
    return [*range(1, last), *dict.fromkeys((0, last))]


# Rules: the k-th coefficient of a result, given the operands and the operation on coefficients.


def combine(rule: Callable, left: Series, right) -> Series:
    operands = [left, right if isinstance(right, Series) else constant(right)]
    return Series(lambda k: rule(k, operands))


def plus(k: int, operands: list[Series], bind: Callable = operator.add) -> Any:
    left, right = operands[0][k], operands[1][k]
    if left is None or right is None:
        return right if left is right else as_sum(right if left is None else left, operands)
    return apply_once(bind, left, right)


def minus(k: int, operands: list[Series], bind: Callable = operator.sub) -> Any:
    left, right = operands[0][k], operands[1][k]
    if left is None:
        return None if right is None else as_sum(apply_once(operator.neg, right), operands)
    return as_sum(left, operands) if right is None else apply_once(bind, left, right)


def as_sum(coefficient: Any, operands: list[Series]) -> Any:
    """Return a coefficient in the shape of the sum: a number may add to an array."""
    shape = np.broadcast_shapes(*map(np.shape, (coefficient, *(one[0] for one in operands))))
    return coefficient if np.shape(coefficient) == shape else jnp.broadcast_to(coefficient, shape)


def bilinear(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    pairs = ((left[j], right[k - j]) for j in newest_last(k) if left[j] is not None)
    return add_terms(apply_once(bind, a, b) for a, b in pairs if b is not None)


def times(k: int, operands: list[Series], bind: Callable | None = None) -> Any:
    """Return the k-th coefficient of a product; the primitive itself is not needed."""
    left, right = operands
    if left is right:
        return square(k, left)
    return add_products(left, right, ((j, k - j) for j in newest_last(k)))


def square(k: int, x: Series) -> Any:
    """Return the k-th coefficient of a square; each product of coefficients is computed once."""
    pairs = add_products(x, x, ((j, k - j) for j in newest_last((k - 1) // 2))) if k else None
    return add_products(x, x, [(k // 2, k // 2)] if k % 2 == 0 else [], start=scale(pairs, 2))


def quotient(
    numerator: Series,
    denominator: Series,
    divide: Callable | None = None,
    invert: Callable = lambda divisor: 1 / divisor,
) -> Series:
    """Return r = n / d, from n = r d."""
    # One division for all orders: XLA would repeat the computation of the divisor for each.
    reciprocal = Series(lambda k: invert(denominator[0]))

    def rule(k):
        if k == 0 and divide is not None:
            return divide(numerator[0], denominator[0])
        places = ((j, k - j) for j in newest_last(k - 1)) if k else ()
        known = add_products(result, denominator, places)
        difference = add_terms([numerator[k], scale(known, -1)])
        return None if difference is None else difference * reciprocal[0]

    result = Series(rule)
    return result


def inverse_or_zero(divisor):
    """Return 1 / x, or zero where x is zero; its derivatives are finite."""
    zero = divisor == 0
    return jnp.where(zero, 0, 1 / jnp.where(zero, 1, divisor))


def over_base(numerator: Series, base: Series) -> Series:
    """Return n / x for a power of x; zero where x begins at zero, so that the power stays zero."""
    return quotient(numerator, base, invert=inverse_or_zero)


def base_log(base: Series) -> Series:
    """Return log(x) for a base x of a power; zero where x begins at zero, as that power is zero."""

    def value(x):
        zero = x == 0
        return jnp.where(zero, 0, jnp.log(jnp.where(zero, 1, x)))

    return solution(lambda y, x, Dx: over_base(Dx, x), value, base)


# Functions that solve a differential equation: D y of a result y, given each operand x and D x,
# with D = t d/dt. D x is the left factor: it is zero at t = 0, so the k-th coefficient of D y does
# not read y_k.
EQUATIONS: dict[str, Callable[..., Series]] = {
    "acos": lambda y, x, Dx: -Dx / sqrt_series((1 - x) * (1 + x)),
    "acosh": lambda y, x, Dx: Dx / sqrt_series((x - 1) * (x + 1)),
    "asin": lambda y, x, Dx: Dx / sqrt_series((1 - x) * (1 + x)),
    "asinh": lambda y, x, Dx: Dx / sqrt_series(1 + x * x),
    "atan": lambda y, x, Dx: Dx / (1 + x * x),
    "atan2": lambda angle, y, Dy, x, Dx: (Dy * x - Dx * y) / (x * x + y * y),
    "atanh": lambda y, x, Dx: Dx / ((1 - x) * (1 + x)),
    "cbrt": lambda y, x, Dx: over_base(Dx * y, x * 3),
    "erf": lambda y, x, Dx: Dx * exp_series(-(x * x)) * (2 / math.sqrt(math.pi)),
    "erf_inv": lambda y, x, Dx: Dx * exp_series(y * y) * (math.sqrt(math.pi) / 2),
    "erfc": lambda y, x, Dx: Dx * exp_series(-(x * x)) * (-2 / math.sqrt(math.pi)),
    "exp": lambda y, x, Dx: Dx * y,
    "exp2": lambda y, x, Dx: Dx * y * math.log(2),
    "expm1": lambda y, x, Dx: Dx * (y + 1),
    "log": lambda y, x, Dx: Dx / x,
    "log1p": lambda y, x, Dx: Dx / (1 + x),
    "log2": lambda y, x, Dx: Dx / (x * math.log(2)),
    "logistic": lambda y, x, Dx: Dx * (y - y * y),
    "pow": lambda y, x, Dx, p, Dp: over_base(Dx * (p * y), x) + Dp * (base_log(x) * y),
    "rsqrt": lambda y, x, Dx: Dx * y / (x * -2),
    "sqrt": lambda y, x, Dx: over_base(Dx, y * 2),
    "tan": lambda y, x, Dx: Dx * (1 + y * y),
    "tanh": lambda y, x, Dx: Dx * (1 - y * y),
}


def solution(equation: Callable[..., Series], bind: Callable, *operands: Series) -> Series:
    """Return the series y that solves one of these equations, with the primitive's value at 0."""
    first = lambda: bind(*(x[0] for x in operands))
    y = Series(lambda k: scale(Dy[k], 1 / k) if k else first())
    Dy = equation(y, *(each for x in operands for each in (x, times_order(x))))
    return y


def times_order(x: Series) -> Series:
    """Return D x = t dx/dt."""
    return Series(lambda k: scale(x[k], k) if k else None)


def exp_series(x: Series) -> Series:
    return solution(EQUATIONS["exp"], jnp.exp, x)


def sqrt_series(x: Series) -> Series:
    return solution(EQUATIONS["sqrt"], jnp.sqrt, x)


def sine_and_cosine(x: Series, values: Callable, sign: int) -> tuple[Series, Series]:
    """Return s and c from s' = c x' and c' = sign s x'; their values at t = 0 are values(x)."""
    sine = Series(lambda k: scale(Dsine[k], 1 / k) if k else values(x[0])[0])
    cosine = Series(lambda k: scale(Dcosine[k], sign / k) if k else values(x[0])[1])
    Dx = times_order(x)
    Dsine, Dcosine = Dx * cosine, Dx * sine
    return sine, cosine
