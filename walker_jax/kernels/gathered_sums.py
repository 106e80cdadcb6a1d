"""Sums of long arrays in a transposed function, each written once.

Reverse mode adds the cotangents of a value one after the other: those of a matrix of a network are
an outer product for each coefficient of a series. Each addition would read and write all of a long
array in memory. So the terms of a sum are gathered: outer products become one product of matrices,
which consist of all their factors, and products of entries become one `sum_of_products`.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, no_type_check

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal

from walker_jax.kernels.jaxprs import CALLS, Interpreter, binding, enter, shape_dtype
from walker_jax.kernels.products import sum_of_products_p
from walker_jax.kernels.stored import is_long, is_long_product, multiplies_long_matrices


def with_gathered_sums(closed: ClosedJaxpr) -> ClosedJaxpr:
    """Return a function with its sums of long arrays gathered; results differ by rounding alone."""
    if not multiplies_long_matrices(closed.jaxpr):
        return closed
    flat = lambda *leaves: list(map(value_of, Gathering().interpret(closed, list(leaves))))
    return jax.make_jaxpr(flat)(*map(shape_dtype, closed.in_avals))


class Term(NamedTuple):
    """A term of a sum: a value, the product of two entry by entry, or their outer product."""

    operands: tuple
    outer: JaxprEqn | None = None
    """The equation of an outer product."""


class Sum:
    """A sum of terms that has not been computed: one equation uses it, which may add more."""

    def __init__(self, terms: Sequence[Term]):
        self.terms = list(terms)

    def value(self) -> Any:
        products, outer, total = [], {}, None
        for operands, equation in self.terms:
            if equation is not None:
                key = str(equation.params["dimension_numbers"]), *map(jnp.shape, operands)
                outer.setdefault(key, (equation, []))[1].append(operands)
            elif len(operands) == 2:
                products += operands
            else:
                total = operands[0] if total is None else lax.add(total, operands[0])
        if len(products) == 2 and total is None:
            total = lax.mul(*products)  # as it was, so that a kernel knows an equal one
        elif products:
            total = sum_of_products_p.bind(*products, *([] if total is None else [total]))
        for equation, pairs in outer.values():
            found = add_outer_products(equation, pairs)
            total = found if total is None else lax.add(total, found)
        return total


def value_of(value: Any) -> Any:
    return value.value() if isinstance(value, Sum) else value


def terms_of(value: Any) -> list[Term]:
    return value.terms if isinstance(value, Sum) else [Term((value,))]


def add_outer_products(equation: JaxprEqn, pairs: list[tuple]) -> Any:
    """Return the sum of outer products as a product of matrices: contracted over the terms."""
    bind = binding(equation)
    if len(pairs) == 1:
        return bind(*pairs[0])
    left, right = (jnp.stack(factors) for factors in zip(*pairs, strict=True))
    return bind(left, right, dimension_numbers=(((0,), (0,)), ((), ())))


@no_type_check  # as its base
class Gathering(Interpreter):
    """Evaluates a jaxpr; a value is a `Sum` until an equation needs its numbers."""

    def interpret(self, closed: ClosedJaxpr, inputs: list) -> list:
        jaxpr = closed.jaxpr
        uses = Counter(
            one
            for variables in (*(equation.invars for equation in jaxpr.eqns), jaxpr.outvars)
            for one in variables
            if not isinstance(one, Literal)
        )
        values = dict(zip(jaxpr.constvars, closed.consts, strict=True))
        values |= zip(jaxpr.invars, map(value_of, inputs), strict=True)
        read = lambda one: one.val if isinstance(one, Literal) else values[one]
        for equation in jaxpr.eqns:
            results = self.apply(equation, list(map(read, equation.invars)))
            for variable, result in zip(equation.outvars, results, strict=True):
                values[variable] = result if uses[variable] == 1 else value_of(result)
        return list(map(read, jaxpr.outvars))

    def constant(self, value) -> Any:
        return value

    def default_rule(self, equation, operands: list, **params) -> list:
        results = binding(equation)(*map(value_of, operands), **params)
        return results if equation.primitive.multiple_results else [results]


def add(gathering: Gathering, equation, operands: list) -> list:
    like = equation.outvars[0].aval
    if not is_long(like) or not all(v.aval.shape == like.shape for v in equation.invars):
        return gathering.default_rule(equation, operands)
    return [Sum([term for one in operands for term in terms_of(one)])]


def multiply(gathering: Gathering, equation, operands: list) -> list:
    if not is_long(equation.outvars[0].aval):
        return gathering.default_rule(equation, operands)
    return [Sum([Term(tuple(map(value_of, operands)))])]


def contract(gathering: Gathering, equation, operands: list) -> list:
    contracted, batches = equation.params["dimension_numbers"]
    if not is_long_product(equation) or any((*contracted, *batches)):
        return gathering.default_rule(equation, operands)
    return [Sum([Term(tuple(map(value_of, operands)), equation)])]


def within(*names: str) -> Callable:
    """Return the rule of a primitive whose functions are these parameters."""

    def rule(gathering: Gathering, equation, operands: list) -> list:
        gather = lambda one: (
            tuple(map(with_gathered_sums, one))
            if isinstance(one, tuple)
            else with_gathered_sums(one)
        )
        inner = {name: gather(equation.params[name]) for name in names}
        return gathering.default_rule(equation, operands, **inner)

    return rule


Gathering.rules = {
    **dict.fromkeys(CALLS, enter),
    **dict.fromkeys(("add", "add_any"), add),
    "cond": within("branches"),
    "dot_general": contract,
    "mul": multiply,
    "scan": within("jaxpr"),
    "while": within("body_jaxpr"),
}
