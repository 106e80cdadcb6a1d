"""Power series of branches, of loops of known length, of remainders and of rounded numbers.

All are piecewise smooth: the series continues the branch on which it starts. A branch and a loop
have no switching functions of their own, as those of the comparisons in them are recorded.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from walker_jax.integrators.series import Series, dense_coefficient, scale
from walker_jax.kernels.jaxprs import binding, scan_counts

MAX_TURNS = 128
"""Most turns of a loop that is expanded: the series of each turn are a part of the program."""


def branch_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand all branches of a `lax.cond` or `lax.switch`, and select those of one."""
    which, *inputs = operands
    branches = [expansion.interpret(one, inputs) for one in equation.params["branches"]]

    def select(k: int, i: int) -> Any:
        which[k]  # raises if its jumps are not known
        results = [branch[i] for branch in branches]
        if all(one[k] is None for one in results):
            return None
        return lax.select_n(which[0], *(dense_coefficient(k, one) for one in results))

    return by_itself_at_first(equation, operands, select)


def loop_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand a `lax.scan`, and so a `fori_loop` with numbers as bounds, turn by turn."""
    params = equation.params
    constants, carried = scan_counts(params)
    if params["length"] > MAX_TURNS:
        return expansion.default_rule(equation, operands)
    fixed, carry = operands[:constants], operands[constants : constants + carried]
    inputs, turns = operands[constants + carried :], range(params["length"])
    rows = {}
    for i in reversed(turns) if params["reverse"] else turns:
        here = [entry(x, i) for x in inputs]
        results = expansion.interpret(params["jaxpr"], [*fixed, *carry, *here])
        carry, rows[i] = results[:carried], results[carried:]

    def coefficient(k: int, i: int) -> Any:
        if i < carried:
            return carry[i][k]
        stacked = [rows[turn][i - carried] for turn in turns]
        if all(one[k] is None for one in stacked):
            return None
        return jnp.stack([dense_coefficient(k, one) for one in stacked])

    return by_itself_at_first(equation, operands, coefficient)


def entry(x: Series, i: int) -> Series:
    """Return the series of an entry of an array."""
    return Series(lambda k: None if x[k] is None else x[k][i])


def by_itself_at_first(
    equation, operands: list[Series], coefficient: Callable[[int, int], Any]
) -> list[Series]:
    """Return series with c_0 by the primitive itself, which chooses a branch, or loops.

    `coefficient(k, i)` is the k-th of the i-th result, for k > 0.
    """
    first = Series(lambda k: binding(equation)(*(x[0] for x in operands)))
    part = lambda i: Series(lambda k: coefficient(k, i) if k else first[0][i])
    return [part(i) for i in range(len(equation.outvars))]


def remainder(k: int, operands: list[Series], bind: Callable) -> Any:
    """Return the k-th coefficient of x - n y, with the whole number n of the start."""
    x, y = operands
    if y[k] is None:
        return x[k]
    whole = jnp.round((x[0] - bind(x[0], y[0])) / y[0])
    return dense_coefficient(k, x) - whole * y[k]


def remainder_switches(x: Series, y: Series) -> list[Series]:
    """Return x - n y for both ends n of the interval in which x / y has the same whole number.

    That number is x / y without its fraction, so the interval at zero is (-1, 1).
    """
    whole = jnp.trunc(x[0] / y[0])
    low = jnp.where(whole > 0, whole, whole - 1)
    high = jnp.where(whole < 0, whole, whole + 1)
    return [x - n * y for n in (low, high)]


def distances_to_rounding(x: Series, whole: Callable) -> list[Series]:
    """Return the distances of x to both ends of the interval that rounds to the same number."""
    return distances(x, whole(x[0]), whole(x[0]) + 1)


def distances(x: Series, low: Array, high: Array) -> list[Series]:
    """Return the distances of x to both ends of an interval."""
    below = lambda k: x[0] - low if k == 0 else x[k]
    above = lambda k: high - x[0] if k == 0 else scale(x[k], -1)
    return [Series(below), Series(above)]


def cast_switches(x: Series) -> list[Series]:
    return [x, *distances_to_rounding(x, jnp.floor)]
