"""Taylor series of the solution of an ordinary differential equation.

Along a solution y(t) = y_0 + y_1 t + y_2 t^2 + ..., the equation y' = f(y) says

    (k + 1) y_{k+1} = f_k,

where f_k, the k-th coefficient of f(y(t)), needs y_0 ... y_k only. So the series grows order by
order, and each coefficient of each intermediate result is computed once (Jorba and Zou 2005). f is
any function of JAX primitives that `expansion` has a rule for.

Coefficients are Taylor coefficients, derivatives divided by k!.

If f has a kink, its series continues the branch on which it starts, and is valid until a switching
function changes sign. `series_of_switches` returns the series of these functions.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array, PyTree

from walker_jax.checks import is_traced
from walker_jax.integrators.closures import convert_closure
from walker_jax.integrators.expansion import bases, compose, switches
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.integrators.series import (
    Series,
    coefficients_up_to,
    evaluate_polynomial,
    recording,
    scale,
)
from walker_jax.kernels.jaxprs import CALLS, called_function
from walker_jax.kernels.stored import is_long

VectorField = Callable[[PyTree], PyTree]


def traced_once(expand: Callable) -> Callable:
    """Share the trace of an expansion among all calls with one function of the state.

    JAX keeps the function. If it is no `equinox.Module`, tracers in its closure would be kept too,
    so within a trace it is then expanded anew.
    """
    shared = eqx.filter_jit(expand)

    @wraps(expand)
    def call(function, state, *args, **kwargs):
        keep = isinstance(function, eqx.Module) or not is_traced(state)
        return (shared if keep else expand)(function, state, *args, **kwargs)

    return call


@traced_once
def solution_series(vector_field: VectorField, state: PyTree, order: int) -> PyTree[list]:
    """Compute the Taylor coefficients of the solution of y' = f(y) that starts at `state`.

    **Arguments:**

    - `vector_field`: f, from the state to its time derivative, of the same structure, or a
      `PowerBalance`. If it is a method of an `equinox.Module`, the expansion is traced once for
      all calls.
    - `state`: y_0, a PyTree of floating-point arrays.
    - `order`: order of the last coefficient.

    **Returns** a PyTree of the structure of the state with a list of `order + 1` coefficients at
    each leaf. Raises `NotImplementedError` if f uses a primitive without a known series.
    """
    if isinstance(vector_field, PowerBalance):
        return vector_field.series(state, order)
    state = jax.tree.map(jnp.asarray, state)
    # The values in the function's closure become arguments, so that derivatives go through them.
    return expand_solution(convert_closure(vector_field, state), state, order=order)


def grow_series(vector_field, state, order):
    return grow_both(lambda state: (vector_field(state), ()), state, order)[0]


def grow_both(rates_and_others: Callable, state: PyTree, order: int) -> tuple[PyTree, PyTree]:
    """Return the coefficients of a solution, and of other functions of the state along it."""
    leaves, structure = jax.tree.flatten(state)
    rates: list[Series] = []

    def solution(i):
        return Series(lambda k: leaves[i] if k == 0 else scale(rates[i][k - 1], 1 / k))

    solutions = jax.tree.unflatten(structure, [solution(i) for i in range(len(leaves))])
    found, others = compose(rates_and_others, solutions, state)
    rates += jax.tree.leaves(found)
    return jax.tree.map(lambda series: coefficients_up_to(series, order), (solutions, others))


expand_solution = eqx.filter_custom_jvp(grow_series)


@expand_solution.def_jvp
def expand_variation(primals, tangents, *, order):
    """Expand a solution and its derivative, as the solution of one system.

    If f contains operations that are not smooth, each coefficient is differentiated instead.
    """
    (vector_field, state), (change, dstate) = primals, tangents
    # Its terms are shared with the series of the derivative, and JAX linearises a separate call.
    series = expand_solution(vector_field, state, order=order)
    if not is_smooth(vector_field, state):
        grow = lambda vector_field, state: grow_series(vector_field, state, order)
        return series, eqx.filter_jvp(grow, primals, tangents)[1]
    varied = VariedField(vector_field, change)
    both = state, with_zeros(dstate, state)
    return series, expand_solution(varied, both, order=order)[1]


def with_zeros(tangents: PyTree, state: PyTree) -> PyTree:
    """Return tangents of a state, with zeros where there are none."""
    tangent = lambda dx, x: jnp.zeros_like(x) if dx is None and x is not None else dx
    return jax.tree.map(tangent, tangents, state, is_leaf=is_absent)


SMOOTH = frozenset(
    "add add_any cos div exp integer_pow log mul neg sin square sub sum_of_products".split()
)
"""Primitives whose derivatives consist of these primitives too."""


def is_smooth(function: Callable, state: PyTree) -> bool:
    """Return whether a function consists of smooth primitives, on real numbers of one type."""
    closed = jax.make_jaxpr(function)(state)
    known = [*closed.jaxpr.constvars, *closed.jaxpr.invars, *closed.jaxpr.outvars]
    types = {variable.aval.dtype for variable in known}
    return (
        len(types) == 1
        and jnp.issubdtype(types.pop(), jnp.floating)
        and has_smooth_equations(closed)
    )


def has_smooth_equations(closed: ClosedJaxpr) -> bool:
    """Return whether all equations have smooth primitives, on numbers of the result's type."""
    for equation in closed.jaxpr.eqns:
        types = {variable.aval.dtype for variable in (*equation.invars, *equation.outvars)}
        if equation.primitive.name in CALLS:
            if not has_smooth_equations(called_function(equation)):
                return False
        elif equation.primitive.name not in SMOOTH or len(types) > 1:
            return False
    return True


class VariedField(eqx.Module):
    """The variational equations (y, dy)' = (f, (df/dy) dy + (df/dp) dp) of y' = f(y, p).

    Their solution contains the derivative dy of y along a direction in which parameters change by
    dp. The coefficients of dy are the derivatives of those of y, but take fewer operations. For
    example, the derivative of the series of sin(y) is one product of series, cos(y) dy; its
    coefficients, differentiated one by one, take parts of four such products.
    """

    field: VectorField
    change: PyTree
    """dp: a tree like `field`, with `None` for constants."""

    def __call__(self, state: tuple[PyTree, PyTree]) -> tuple[PyTree, PyTree]:
        (y, dy), change = state, self.change
        varies = jax.tree.map(lambda dx, x: dx is not None, change, self.field, is_leaf=is_absent)
        varying, constant = eqx.partition(self.field, varies)
        f = lambda varying, y: eqx.combine(varying, constant)(y)
        return jax.jvp(f, (varying, y), (change, dy))


def function_series(function: Callable[[PyTree], PyTree], series: PyTree[list]) -> PyTree[list]:
    """Return the Taylor coefficients of function(y(t)), given those of y(t), to the same order."""
    results = compose(function, *expandable(series))
    return jax.tree.map(lambda result: coefficients_up_to(result, order_of(series)), results)


def expandable(series: PyTree[list]) -> tuple[PyTree[Series], PyTree]:
    """Return lists of coefficients as `Series`, and their values at t = 0."""
    known = jax.tree.map(lambda c: Series(c.__getitem__), series, is_leaf=is_list)
    return known, jax.tree.map(lambda c: c[0], series, is_leaf=is_list)


def evaluate_series(series: PyTree[list], t) -> PyTree:
    """Return y(t), given its Taylor coefficients."""
    return jax.tree.map(lambda c: evaluate_polynomial(c, t), series, is_leaf=is_list)


def order_of(series: PyTree[list]) -> int:
    """Return the order of the last coefficients."""
    return len(jax.tree.leaves(series, is_leaf=is_list)[0]) - 1


def power_bases(function: Callable[[PyTree], PyTree], series: PyTree[list]) -> list[list[Array]]:
    """Expand the bases of fractional powers, of which derivatives are infinite at zero."""
    return series_of_switches(function, series)[1]


@traced_once
def series_of_switches(
    function: Callable[[PyTree], PyTree], series: PyTree[list]
) -> tuple[list[list[Array]], list[list[Array]]]:
    """Expand the switching functions, whose zeros are the kinks and jumps of function(y(t)).

    **Arguments:**

    - `function`: a function of the state, or a `PowerBalance`.
    - `series`: the coefficients of y(t), to some order.

    **Returns** a list of coefficients for each scalar whose sign selects a branch and changes with
    time, and on their own those of the bases of fractional powers. Their order is that of the
    series, less two for a `PowerBalance`. Those of a long array, as of a layer of a network, are
    one list of arrays.
    """
    kinks, of_powers = find_switches(function, series, together=True)
    return [one for _, one in kinks], [one for _, one in of_powers]


def located_switches(
    function: Callable[[PyTree], PyTree], series: PyTree[list]
) -> list[tuple[Any, list[Array]]]:
    """Expand the switching functions, each with the equation of a jaxpr that switches."""
    kinks, of_powers = find_switches(function, series)
    return [*kinks, *of_powers]


def find_switches(
    function: Callable[[PyTree], PyTree], series: PyTree[list], *, together: bool = False
) -> tuple[list[tuple[Any, list[Array]]], list[tuple[Any, list[Array]]]]:
    """Expand the switching functions, and the bases of powers, each with its equation.

    Switching functions are scalars, or, with `together`, all those of a long array at once.
    """
    (known, start), order = expandable(series), order_of(series)
    with recording(switches) as of_switches, recording(bases) as of_bases:
        if isinstance(function, PowerBalance):
            function.balance(jax.tree.leaves(known), jax.tree.leaves(start))
            order -= 2
        else:
            compose(function, known, start)

    def scalars(found: list[Series], together: bool = False) -> list[tuple[Any, list[Array]]]:
        varying = [one for one in found if any(one[k] is not None for k in range(1, order + 1))]
        parts = []
        for one in varying:
            flat = [c.ravel() for c in coefficients_up_to(one, order)]
            all_at_once = together and is_long(flat[0])
            each = [flat] if all_at_once else [[c[i] for c in flat] for i in range(one[0].size)]
            parts += [(one.equation, part) for part in each]
        return parts

    return scalars(of_switches, together), scalars(of_bases)


def is_absent(x) -> bool:
    return x is None


def is_list(x) -> bool:
    return isinstance(x, list)
