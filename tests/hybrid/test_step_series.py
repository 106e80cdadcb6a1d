"""The series of a step with an event: carried to the search for it, or expanded again there."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import pytest
from jax.extend.core import jaxprs_in_params

import walker_jax as wj
from walker_jax.integrators.taylor_steps import SERIES_ORDER
from walker_jax.kernels.program import tracing_for_kernel

ROUND_FEET = wj.RoundFootWalker(0.009), jnp.array([0.2, -0.2, 0.1])
SIMPLEST = wj.SimplestWalker(0.009), jnp.array([0.2, -0.2])


def orders_of_expansions(jaxpr, variables: int) -> Iterator[int]:
    """Yield the order of every expansion of a solution in a program."""
    for equation in jaxpr.eqns:
        if equation.params.get("name") == "solution_series":
            yield len(equation.outvars) // variables - 1
        for inner in jaxprs_in_params(equation.params):
            yield from orders_of_expansions(inner, variables)


@pytest.mark.parametrize(("start", "expansions"), [(SIMPLEST, 2), (ROUND_FEET, 1)])
def test_only_a_cheap_expansion_is_in_a_program_twice(start, expansions):
    with tracing_for_kernel(True):
        closed = jax.make_jaxpr(wj.stride)(*start)
    orders = list(orders_of_expansions(closed.jaxpr, variables=4))
    assert orders.count(SERIES_ORDER[jnp.dtype("float64")]) == expansions
