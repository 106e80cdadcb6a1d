"""Variables that only grow or decay in proportion to themselves, such as numbers of animals.

The rate of such a variable is zero where it is zero, whatever the others are: y' = y g(y, z). It
may fall by hundreds of orders of magnitude and grow again, so its digits count however small it is.
Other variables are restored by what drives them.
"""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from walker_jax.integrators.expansion import trace
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.kernels.entries import EXACT, Unrolling
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES
from walker_jax.kernels.shortcuts import is_known

MOST_VARIABLES = 32
"""Largest number of variables that are examined: each takes an interpretation of the equations."""
MOST_ENTRIES = MOST_VARIABLES**2
"""Most entries of an array that are examined: those of a matrix of all variables. Larger ones, as
of a layer of a network, count as unknown."""
UNKNOWN = object()
"""A number that is not known to be zero."""
VANISHING = frozenset(
    "abs asin asinh atan atanh cbrt convert_element_type copy div erf expm1 integer_pow log1p sign "
    "sin sinh sqrt square stop_gradient tan tanh".split()
)
"""Primitives that are zero where their first operand is."""


def proportional_variables(field: Callable | PowerBalance, state: PyTree) -> PyTree | None:
    """Return which variables have a rate that is zero wherever they are; None if none has.

    The equations y' = f(y) show it: a factor of each term of the rate is zero. The result is a tree
    like the state.
    """
    leaves, structure = jax.tree.flatten(state)
    if isinstance(field, PowerBalance) or sum(map(np.size, leaves)) > MOST_VARIABLES:
        return None
    closed, _ = trace(field, state)
    variables = [np.full(np.shape(leaf), UNKNOWN, object) for leaf in leaves]
    constant = list(map(is_zero, Zeros().interpret(closed, variables)))
    found = [np.zeros(np.shape(leaf), bool) for leaf in leaves]
    for i, flags in enumerate(found):
        for place in np.ndindex(flags.shape):
            changed = [one.copy() for one in variables]
            changed[i][place] = 0.0
            rate = Zeros().interpret(closed, changed)[i]
            flags[place] = is_zero(rate)[place] and not constant[i][place]
    return jax.tree.unflatten(structure, found) if any(map(np.any, found)) else None


def is_zero(entries: np.ndarray) -> np.ndarray:
    """Return which entries are known to be zero."""
    known = [is_known(entry) and entry == 0 for entry in entries.ravel()]
    return np.array(known, bool).reshape(entries.shape)


class Zeros(Unrolling):
    """Finds the entries of results that are zero where some entries of the arguments are."""

    def constant(self, value) -> np.ndarray:
        if isinstance(value, Tracer) or np.size(value) > MOST_ENTRIES:
            return np.full(np.shape(value), UNKNOWN, object)
        return self.entries_of(np.asarray(value))

    def apply(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        if equation.primitive.name not in (*CALLS, *CALLS_WITH_DERIVATIVES):
            variables: Any = (*equation.invars, *equation.outvars)
            if any(math.prod(one.aval.shape) > MOST_ENTRIES for one in variables):
                return self.default_rule(equation, operands)
        return super().apply(equation, operands)

    def default_rule(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        return [np.full(one.aval.shape, UNKNOWN, object) for one in equation.outvars]

    def evaluate_term(self, primitive, params: dict, operands: list, dtypes: list) -> Any:
        name = primitive.name
        if name in EXACT and all(map(is_known, operands)):
            return super().evaluate_term(primitive, params, operands, dtypes)
        zero = [is_known(one) and one == 0 for one in operands]
        if name == "select_n":
            return 0.0 if all(zero[1:]) else UNKNOWN
        if name == "convert_element_type" and is_known(operands[0]):
            return operands[0]
        vanishes = name in VANISHING and zero[0] and params.get("y", 1) > 0
        return 0.0 if vanishes else UNKNOWN

    rules: ClassVar = {
        **Unrolling.rules,
        **dict.fromkeys(CALLS_WITH_DERIVATIVES, Unrolling.call),
    }
