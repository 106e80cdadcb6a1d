"""Taylor series of the solution of an ordinary differential equation.

Along a solution y(t) = y_0 + y_1 t + y_2 t^2 + ..., the equation y' = f(y) says

    (k + 1) y_{k+1} = f_k,

where f_k, the k-th coefficient of f(y(t)), needs y_0 ... y_k only. So the series grows order by
order, each coefficient of each intermediate result computed once. f is any function of JAX
primitives: its jaxpr is read, and every primitive has a recurrence for its coefficients
(Jorba and Zou 2005; Griewank and Walther 2008, chapter 13). Those not listed here are left to
`jax.experimental.jet`, which costs more tracing and gives the same coefficients.

Coefficients are Taylor coefficients, derivatives divided by k!.

Where f has a kink, as |x| at zero, a series continues the branch on which it starts. It holds until
a switching function changes its sign, x for |x|, and a - b for max(a, b); `switching_series` has
these.
"""

import abc
import math
import operator
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.jet import jet
from jax.extend.core import Jaxpr, Literal, Primitive
from jaxtyping import Array, Float, PyTree

from walker_jax.kernels import tracing_for_kernel
from walker_jax.kernels.jaxprs import CALLS as PLAIN, CALLS_WITH_DERIVATIVES
CALLS = {**PLAIN, **CALLS_WITH_DERIVATIVES}


@jax.jit  # traced once for all its uses
def sincos(angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Sine and cosine of one angle, off by less than the dtype's epsilon up to 1e5 rad.

    The angle is reduced to [-pi/4, pi/4] by a multiple of pi/2 held in three parts (Cody and
    Waite), then both are polynomials. XLA's own float64 sine serves every argument and costs
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
    sine = x * evaluate([(-1) ** i / math.factorial(2 * i + 1) for i in range(terms)], z)
    cosine = evaluate([(-1) ** i / math.factorial(2 * i) for i in range(terms)], z)
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


def evaluate(coefficients: list, t):
    """The polynomial c_0 + c_1 t + c_2 t^2 + ... by Horner's rule."""
    value = coefficients[-1] + jnp.zeros_like(t)
    for coefficient in coefficients[-2::-1]:
        value = value * t + coefficient
    return value


class Series:
    """A power series whose coefficients are computed when first asked for.

    A coefficient but the first may be `None`: it is zero.
    """

    def __init__(self, rule: Callable[[int], Any], coefficients: Iterable = ()):
        self.rule = rule
        self.coefficients: list = list(coefficients)
        if (made := recorded.get()) is not None:
            made.append(self)

    def __getitem__(self, k: int):
        while len(self.coefficients) <= k:
            self.coefficients.append(self.rule(len(self.coefficients)))
        return self.coefficients[k]


recorded: ContextVar[list[Series] | None] = ContextVar("recorded", default=None)
"""Where to note every series that is made, if anywhere."""
switches: ContextVar[list[Series] | None] = ContextVar("switches", default=None)
"""Where to note every switching function, if anywhere."""


@contextmanager
def recording(where: ContextVar[list[Series] | None]):
    """A list of the series that are noted there meanwhile."""
    noted: list[Series] = []
    token = where.set(noted)
    try:
        yield noted
    finally:
        where.reset(token)


def constant(value) -> Series:
    return Series(lambda k: value if k == 0 else None)


class VirtualPower(eqx.Module):
    """Equations of motion as a balance of virtual power, without a formula for accelerations.

    With x = F(q), they are p(q, q', x'') = 0 for some p that is linear in x'', which is F(q(t))''.
    Of the series q(t) that is a series like any other: neither derivatives of F nor the solution
    of linear equations need be expanded. A state holds the coordinates q first, then their rates.
    """

    @abc.abstractmethod
    def transfer(self, q: list) -> list:
        """F, from scalars q to scalars x."""

    @abc.abstractmethod
    def power(self, q: list, qdot: list, acceleration: list) -> list:
        """p, of q, q' and x'': one scalar for each of q."""

    @abc.abstractmethod
    def factorise(self, q: list) -> PyTree:
        """The matrix -dp/dx'' dF/dq, which multiplies q'' in -p, in a form for `solve`."""

    @abc.abstractmethod
    def solve(self, factors: PyTree, right: list) -> list:
        """The solution of linear equations with that matrix."""

    def __call__(self, state: PyTree) -> PyTree:
        """The time derivative of a state."""
        leaves, structure = jax.tree.flatten(state)
        q, rates = leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]
        velocity = lambda q: jax.jvp(self.transfer, (q,), (rates,))[1]
        convective = jax.jvp(velocity, (q,), (rates,))[1]
        accelerations = self.solve(self.factorise(q), self.power(q, rates, convective))
        return jax.tree.unflatten(structure, rates + accelerations)

    def series(self, state: PyTree, order: int) -> PyTree[list]:
        """Taylor coefficients of the solution.

        q_{k+2} is in the k-th coefficient of p in one place, the top coefficient of F(q(t)), where
        its factor is the derivative of F at t = 0. So p is computed as if q_{k+2} were zero, and
        q_{k+2} then has to supply what is missing for balance.
        """
        leaves, structure = jax.tree.flatten(state)
        start, rates = leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]
        factors = fast_sines(self.factorise)(start)
        # zero, as long as they are not known
        q = [Series(lambda k: None, pair) for pair in zip(start, rates, strict=True)]
        qdot = [derivative(series) for series in q]
        p, of_transfer, of_power = self.balance([*q, *qdot], leaves)
        for k in range(order):
            missing = [jnp.zeros_like(start[0]) if c is None else c for c in (s[k] for s in p)]
            for series in of_power:
                del series.coefficients[k:]
            for series in (*of_transfer, *q):
                del series.coefficients[k + 2 :]
            for series, value in zip(q, self.solve(factors, missing), strict=True):
                series.coefficients.append(value * (1 / ((k + 1) * (k + 2))))
        return jax.tree.unflatten(structure, [listed(series, order) for series in (*q, *qdot)])

    def balance(
        self, state: list[Series], start: list
    ) -> tuple[list[Series], list[Series], list[Series]]:
        """The series of p along q(t), and all that were made for F, and for p itself."""
        half = len(state) // 2
        q, qdot = state[:half], state[half:]
        with recording(recorded) as of_transfer:
            x = compose(self.transfer, q, start[:half])
        with recording(recorded) as of_power:
            acceleration = [derivative(series, times=2) for series in x]
            like = [jnp.zeros_like(start[0])] * len(x)
            p = compose(
                lambda args: self.power(*args),
                (q, qdot, acceleration),
                (start[:half], start[half:], like),
            )
        return p, of_transfer, of_power

    def order(self, state: PyTree, highest: int) -> int:
        """The order, up to the highest, at which the series is not too long for XLA.

        From the operations that it takes at two orders, which grow like the square of the order.
        """
        if tracing_for_kernel.value:
            return highest
        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(self)]
        key = jax.tree.structure(self), *((leaf.shape, leaf.dtype) for leaf in shapes), highest
        if key not in _orders:
            equations = jax.tree.unflatten(jax.tree.structure(self), shapes)
            low = highest // 2
            few, many = (
                operations(lambda field, state, n=n: field.series(state, n), equations, state)
                for n in (low, highest)
            )
            growth = (many - few) / (highest**2 - low**2)
            fits = math.isqrt(max(0, round((LONGEST - few) / growth) + low**2))
            _orders[key] = min(highest, max(fits, SHORTEST))
        return _orders[key]


_orders: dict = {}
LONGEST = 3100
"""Operations in an expansion that XLA still compiles to one loop. Beyond, it computes what parts
have in common once for each of them, again and again: a step then takes minutes."""
SHORTEST = 4
"""The least order."""


def operations(function: Callable, *args) -> int:
    """How many operations on scalars a function takes, those that repeat another left out."""
    numbers: dict = {}
    distinct: dict = {}

    def number(variable):
        if isinstance(variable, Literal):
            return repr(variable.val)
        return numbers.setdefault(variable, object())

    def count(jaxpr: Jaxpr):
        for equation in jaxpr.eqns:
            params = equation.params
            if equation.primitive.name in CALLS:
                inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
                numbers.update(zip(inner.jaxpr.invars, map(number, equation.invars), strict=True))
                numbers.update(zip(inner.jaxpr.constvars, map(repr, inner.consts), strict=True))
                count(inner.jaxpr)
                numbers.update(zip(equation.outvars, map(number, inner.jaxpr.outvars), strict=True))
                continue
            key = equation.primitive.name, repr(params), *map(number, equation.invars)
            values = distinct.setdefault(key, [object() for _ in equation.outvars])
            numbers.update(zip(equation.outvars, values, strict=True))

    count(jax.make_jaxpr(function)(*args).jaxpr)
    return len(distinct)


def derivative(series: Series, times: int = 1) -> Series:
    """That of a series by time."""

    def rule(k):
        coefficient = scaled(series[k + times], math.perm(k + times, times))
        return jnp.zeros_like(series[0]) if coefficient is None and k == 0 else coefficient

    return Series(rule)


@eqx.filter_jit
def solution_series(
    vector_field: Callable[[PyTree], PyTree], state: PyTree, order: int
) -> PyTree[list]:
    """Taylor coefficients of the solution of y' = f(y) that starts at `state`.

    **Arguments:**

    - `vector_field`: f, from the state to its time derivative, of the same structure, or a
      `VirtualPower`. Where it is a method of an `equinox.Module`, the expansion is traced once for
      all its uses.
    - `state`: y_0, a PyTree of floating-point arrays.
    - `order`: of the last coefficient.

    **Returns** a PyTree of the structure of the state with a list of `order + 1` coefficients at
    each leaf. Raises `NotImplementedError` where f holds a primitive of which no series is known.
    """
    if isinstance(vector_field, VirtualPower):
        return vector_field.series(state, order)
    leaves, structure = jax.tree.flatten(state)
    rates: list[Series] = []

    def solution(i):
        return Series(lambda k: leaves[i] if k == 0 else scaled(rates[i][k - 1], 1 / k))

    solutions = jax.tree.unflatten(structure, [solution(i) for i in range(len(leaves))])
    rates += jax.tree.leaves(compose(vector_field, solutions, state))
    return jax.tree.map(lambda series: listed(series, order), solutions)


def function_series(function: Callable[[PyTree], PyTree], series: PyTree[list]) -> PyTree[list]:
    """Taylor coefficients of function(y(t)), given those of y(t), to the same order."""
    known = jax.tree.map(lambda c: Series(c.__getitem__), series, is_leaf=is_list)
    order = len(jax.tree.leaves(series, is_leaf=is_list)[0]) - 1
    start = jax.tree.map(lambda c: c[0], series, is_leaf=is_list)
    return jax.tree.map(lambda result: listed(result, order), compose(function, known, start))


@eqx.filter_jit
def switching_series(
    function: Callable[[PyTree], PyTree], series: PyTree[list]
) -> list[list[Array]]:
    """Taylor coefficients of the functions whose zeros are the kinks of function(y(t)), and jumps.

    **Arguments:**

    - `function`: of the state, or a `VirtualPower`.
    - `series`: the coefficients of y(t), to some order.

    **Returns** a list of coefficients for each scalar whose sign selects a branch and changes with
    time; none where `function` is smooth. Its order is that of the series, and less by two for a
    `VirtualPower`.
    """
    known = jax.tree.map(lambda c: Series(c.__getitem__), series, is_leaf=is_list)
    start = jax.tree.map(lambda c: c[0], series, is_leaf=is_list)
    order = len(jax.tree.leaves(series, is_leaf=is_list)[0]) - 1
    with recording(switches) as found:
        if isinstance(function, VirtualPower):
            function.balance(jax.tree.leaves(known, is_leaf=is_series), jax.tree.leaves(start))
            order -= 2
        else:
            compose(function, known, start)
    varying = [one for one in found if any(one[k] is not None for k in range(1, order + 1))]
    return [
        [coefficient.ravel()[i] for coefficient in listed(one, order)]
        for one in varying
        for i in range(one[0].size)
    ]


def is_series(x) -> bool:
    return isinstance(x, Series)


def fast_sines(function: Callable) -> Callable:
    """The same function, with every sine and cosine in it computed by `sincos`."""

    def faster(*args):
        constants = jax.tree.map(constant, args)
        results = compose(lambda a: function(*a), constants, args)
        return jax.tree.map(lambda series: jnp.asarray(series[0]), results)

    return faster


def is_list(x) -> bool:
    return isinstance(x, list)


def listed(series: Series, order: int) -> list:
    zero = jnp.zeros_like(series[0])
    return [zero if series[k] is None else series[k] for k in range(order + 1)]


def compose(function: Callable, series: PyTree[Series], start: PyTree) -> PyTree[Series]:
    """The series of function(y(t)), given those of y(t), which is `start` at t = 0."""
    structure = jax.tree.structure(start)
    flat = lambda *leaves: function(jax.tree.unflatten(structure, leaves))
    closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*jax.tree.leaves(start))
    results = interpret(closed.jaxpr, closed.consts, jax.tree.leaves(series))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def interpret(jaxpr: Jaxpr, constants: list, inputs: list[Series]) -> list[Series]:
    """The series of a jaxpr's outputs, given those of its inputs."""
    series: dict = dict(zip(jaxpr.constvars, map(constant, constants), strict=True))
    series |= zip(jaxpr.invars, inputs, strict=True)
    sines: dict = {}

    def read(variable):
        return constant(variable.val) if isinstance(variable, Literal) else series[variable]

    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        operands = [read(variable) for variable in equation.invars]
        if name in CALLS:
            inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
            outputs = interpret(inner.jaxpr, inner.consts, operands)
        elif name in ("sin", "cos"):
            variable = equation.invars[0]
            key = id(operands[0]) if isinstance(variable, Literal) else variable
            if key not in sines:
                sines[key] = sine_and_cosine(operands[0])
            outputs = [sines[key][name == "cos"]]
        elif equation.primitive.multiple_results:
            outputs = results_series(equation.primitive, params, operands)
        else:
            outputs = [primitive_series(equation.primitive, params, operands)]
        series |= zip(equation.outvars, outputs, strict=True)
    return [read(variable) for variable in jaxpr.outvars]


# Primitives that are linear in all their operands together.
LINEAR = frozenset(
    "broadcast_in_dim concatenate convert_element_type copy copy_p expand_dims neg pad "
    "reduce_sum reshape rev slice squeeze stack stop_gradient transpose".split()
)
BILINEAR = frozenset(["mul", "dot_general"])
# Those with several results, the parts of their one operand.
PARTS = frozenset(["split", "unstack"])
# Those whose results do not change with time, but for jumps.
DISCRETE = frozenset(
    "and cast ceil eq floor ge gt is_finite le lt ne not or round sign xor".split()
)
# Those with kinks of which no switching functions are known.
UNKNOWN_SWITCHES = frozenset(
    "argmax argmin bitcast_convert_type cummax cummin nextafter reduce_max reduce_min rem sort "
    "top_k".split()
)


def primitive_series(primitive: Primitive, params: dict, operands: list[Series]) -> Series:
    """The series of a primitive's result: c_0 by the primitive itself, the others by its rule."""
    name = primitive.name
    bind = lambda *values: primitive.bind(*values, **params)
    if name == "convert_element_type" and is_cut_off(operands[0], params["new_dtype"]):
        name = "cast"
    if (found := switches.get()) is not None and name in SWITCHES:
        if jnp.issubdtype(jnp.result_type(operands[0][0]), jnp.floating):
            found += SWITCHES[name](*operands)
    if name == "div":
        numerator, denominator = operands
        return quotient(numerator, denominator, bind)
    rule = RULES.get(name, partial(by_jet, name))
    if name == "integer_pow" and params["y"] == 2:
        rule = squared
    return Series(lambda k: rule(k, operands, bind) if k else bind(*(o[0] for o in operands)))


def is_cut_off(x: Series, dtype: Any) -> bool:
    """Whether a real number becomes an integer, or a truth value."""
    real = jnp.issubdtype(jnp.result_type(x[0]), jnp.floating)
    return real and not jnp.issubdtype(dtype, jnp.floating)


# Rules: the k-th coefficient of a result, k > 0, given its operands and the primitive itself.
# None is zero.


def linear(k: int, operands: list[Series], bind: Callable) -> Any:
    values = filled(k, operands)
    return None if values is None else bind(*values)


def plus(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands[0][k], operands[1][k]
    return right if left is None else left if right is None else bind(left, right)


def minus(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands[0][k], operands[1][k]
    if left is None:
        return None if right is None else -right
    return left if right is None else bind(left, right)


def bilinear(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    if left is right:
        return square(left, k, bind)
    return total(product(left[j], right[k - j], bind) for j in newest_last(0, k))


def squared(k: int, operands: list[Series], bind: Callable) -> Any:
    return square(operands[0], k)


def selected(k: int, operands: list[Series], bind: Callable) -> Any:
    values = filled(k, operands)
    return None if values is None else bind(operands[0][0], *values[1:])


def greater(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    return branch(k, left[0] >= right[0], left, right)


def lesser(k: int, operands: list[Series], bind: Callable) -> Any:
    left, right = operands
    return branch(k, left[0] <= right[0], left, right)


def clamped(k: int, operands: list[Series], bind: Callable) -> Any:
    values = filled(k, operands)
    if values is None:
        return None
    low, x, high = (operand[0] for operand in operands)
    return jnp.where(x < low, values[0], jnp.where(x > high, values[2], values[1]))


def absolute(k: int, operands: list[Series], bind: Callable) -> Any:
    (x,) = operands
    return None if x[k] is None else jnp.where(x[0] < 0, -x[k], x[k])


def branch(k: int, which, one: Series, other: Series) -> Any:
    """The k-th coefficient of one series or another."""
    values = filled(k, [one, other])
    return None if values is None else jnp.where(which, *values)


def by_jet(name: str, k: int, operands: list[Series], bind: Callable) -> Any:
    """The rule of JAX's own for a primitive, if it has one."""
    if all(operand[j] is None for operand in operands for j in range(1, k + 1)):
        return None
    if name in UNKNOWN_SWITCHES:
        raise no_series(name)
    zeros = [jnp.zeros_like(operand[0]) for operand in operands]
    terms = [
        [zero if operand[j] is None else operand[j] for j in range(1, k + 1)]
        for zero, operand in zip(zeros, operands, strict=True)
    ]
    try:
        _, series = jet(bind, [o[0] for o in operands], terms, factorial_scaled=False)
    except (KeyError, NotImplementedError) as error:
        raise no_series(name) from error
    return series[-1]


def filled(k: int, operands: list[Series]) -> list | None:
    """The k-th coefficients of the operands, or None where all are zero."""
    values = [operand[k] for operand in operands]
    if all(value is None for value in values):
        return None
    return [
        jnp.zeros_like(operand[0]) if value is None else value
        for value, operand in zip(values, operands, strict=True)
    ]


RULES: dict[str, Callable] = {"add": plus, "add_any": plus, "sub": minus}
RULES |= {"select_n": selected, "square": squared}
RULES |= {"max": greater, "min": lesser, "clamp": clamped, "abs": absolute}
RULES |= dict.fromkeys(DISCRETE, lambda k, operands, bind: None)
RULES |= dict.fromkeys(LINEAR, linear) | dict.fromkeys(BILINEAR, bilinear)


def difference(left: Series, right: Series) -> Series:
    return Series(lambda k: minus(k, [left, right], operator.sub))


def to_rounding(x: Series, whole: Callable) -> list[Series]:
    """How far x is from the two ends of the interval in which it is rounded to one number."""
    below = lambda k: x[0] - whole(x[0]) if k == 0 else x[k]
    above = lambda k: whole(x[0]) + 1 - x[0] if k == 0 else scaled(x[k], -1)
    return [Series(below), Series(above)]


# Switching functions of primitives, whose results have a kink or a jump where one is zero.
SWITCHES: dict[str, Callable[..., list[Series]]] = dict.fromkeys(
    "ge gt le lt max min".split(), lambda left, right: [difference(left, right)]
)
SWITCHES |= dict.fromkeys(("abs", "sign"), lambda x: [x])
SWITCHES["atan2"] = lambda y, x: [y]
SWITCHES["cast"] = lambda x: [x, *to_rounding(x, jnp.floor)]
SWITCHES |= {
    "clamp": lambda low, x, high: [difference(x, low), difference(high, x)],
    "ceil": lambda x: to_rounding(x, lambda value: jnp.ceil(value) - 1),
    "floor": lambda x: to_rounding(x, jnp.floor),
    "round": lambda x: to_rounding(x, lambda value: jnp.round(value) - 0.5),
}


def quotient(numerator: Series, denominator: Series, divide: Callable) -> Series:
    """r = n / d, from n = r d."""
    # One division for all orders: XLA computes an expression anew for each division of its parts.
    reciprocal = Series(lambda k: 1 / denominator[0])

    def rule(k):
        known = total(product(result[j], denominator[k - j]) for j in range(k))
        difference = total([numerator[k], None if known is None else -known])
        return product(difference, reciprocal[0])

    result = Series(lambda k: rule(k) if k else divide(numerator[0], denominator[0]))
    return result


def results_series(primitive: Primitive, params: dict, operands: list[Series]) -> list[Series]:
    """The series of a primitive with several results: parts of an array, or constants of a loop."""

    def varies(k):
        return any(operand[j] is not None for operand in operands for j in range(1, k + 1))

    def results(k):
        if k == 0:
            return primitive.bind(*(operand[0] for operand in operands), **params)
        if primitive.name in PARTS and operands[0][k] is not None:
            return primitive.bind(operands[0][k], **params)
        if primitive.name not in PARTS and varies(k):
            raise no_series(primitive.name)
        return None

    together = Series(results)

    def result(i):
        return Series(lambda k: None if (parts := together[k]) is None else parts[i])

    values = jax.eval_shape(
        lambda *values: primitive.bind(*values, **params), *(operand[0] for operand in operands)
    )
    return [result(i) for i in range(len(values))]


def no_series(name: str) -> NotImplementedError:
    return NotImplementedError(
        f"no Taylor series is known of the JAX primitive {name!r}: write the equations without "
        "it, or integrate them with one of diffrax's Runge-Kutta solvers"
    )


def sine_and_cosine(x: Series) -> tuple[Series, Series]:
    """s = sin(x) and c = cos(x) together, from s' = c x' and c' = -s x'."""
    slope = Series(lambda k: scaled(x[k], k) if k else None)

    def rule(k, zeroth, other, sign):
        if k == 0:
            return sincos(jnp.asarray(x[0]))[zeroth]
        terms = (product(slope[j], other[k - j]) for j in newest_last(1, k))
        return scaled(total(terms), sign / k)

    sine = Series(lambda k: rule(k, 0, cosine, 1))
    cosine = Series(lambda k: rule(k, 1, sine, -1))
    return sine, cosine


def newest_last(first: int, last: int) -> list[int]:
    """first ... last, with those two, whose terms are known last, at the end.

    A processor can then add up the other terms while it waits for these.
    """
    return [*range(first + 1, last), *dict.fromkeys((first, last))]


def square(x: Series, k: int, multiply=operator.mul) -> Any:
    """The k-th coefficient of a square, each product of two coefficients computed once."""
    pairs = (product(x[j], x[k - j], multiply) for j in newest_last(0, (k - 1) // 2))
    double = scaled(total(pairs), 2) if k else None
    middle = product(x[k // 2], x[k // 2], multiply) if k % 2 == 0 else None
    return total([middle, double])


def scaled(value, factor):
    return None if value is None else value * factor


def product(left, right, multiply=operator.mul):
    return None if left is None or right is None else multiply(left, right)


def total(terms):
    terms = [term for term in terms if term is not None]
    return sum(terms[1:], terms[0]) if terms else None
