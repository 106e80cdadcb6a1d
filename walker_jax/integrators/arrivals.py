"""Derivatives of the state at an event, and of its time.

The solution of y' = f(y) from a state y arrives at the zero of e after a time t(y), in the state
Y = Y(t(y), y). Where y is that zero already, t = 0 and Y = y, but their derivatives do not vanish.
With V dy the derivative of Y at constant t,

    e'(Y) (V dy + f(Y) dt) = 0,    dY = V dy + f(Y) dt.

At t = 0 V is the identity, but it too changes with t: V dy follows the variational equations along
the solution. So it is differentiated as Y is, and derivatives of any order are exact.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import (
    VariedField,
    VectorField,
    evaluate_series,
    solution_series,
    with_zeros,
)
from walker_jax.kernels.reverse import reversing


def arrive(
    event: Callable[[PyTree], Scalar], field: VectorField, state: PyTree
) -> tuple[PyTree, Scalar]:
    """Return the state at the event, and the time to it, which is zero, with all derivatives."""
    if reversing.value:
        return arrive_by_newton(event, field, state)
    time = time_to(event, field, state)
    return flow(field, state, time), time


@eqx.filter_custom_jvp
def time_to(event: Callable[[PyTree], Scalar], field: VectorField, state: PyTree) -> Scalar:
    """Return the time t(y) from a state to the event, which is zero, with its derivatives."""
    return jnp.zeros((), jax.tree.leaves(state)[0].dtype)


@time_to.def_jvp
def vary_time(primals, tangents):
    (event, field, state), (devent, dfield, dstate) = primals, tangents
    time = time_to(event, field, state)
    end, change = flow(field, state, time), vary_flow(field, state, time, dfield, dstate)
    rate = jax.jvp(event, (end,), (field(end),))[1]
    return time, -VariedField(event, devent)((end, change))[1] / rate


@eqx.filter_custom_jvp
def flow(field: VectorField, state: PyTree, time: Scalar) -> PyTree:
    """Return the state Y(t, y) after a time that is zero, with its derivatives."""
    return state


@flow.def_jvp
def vary_end(primals, tangents):
    (field, state, time), (dfield, dstate, dtime) = primals, tangents
    end, change = flow(field, state, time), vary_flow(field, state, time, dfield, dstate)
    if dtime is not None:
        change = jax.tree.map(lambda v, rate: v + rate * dtime, change, field(end))
    return end, change


ARRIVAL_ORDER = 3
"""Order to which derivatives of an adjoint are exact at an event: two Newton steps have these."""


def arrive_by_newton(
    event: Callable[[PyTree], Scalar], field: VectorField, state: PyTree
) -> tuple[PyTree, Scalar]:
    """Return `flow` at `time_to` the event, and that time, by operations that JAX can transpose.

    JAX drops a rule for derivatives when it transposes one, and with it how V changes with t. Here
    two Newton steps, from an event that is zero but for rounding, have the derivatives themselves.
    """
    series = solution_series(field, state, ARRIVAL_ORDER)
    end, time = state, jnp.zeros((), jax.tree.leaves(state)[0].dtype)
    for _ in range(2):
        value, rate = jax.jvp(event, (end,), (field(end),))
        time = time - value / rate
        end = evaluate_series(series, time)
    return end, time


def vary_flow(field: VectorField, state: PyTree, time: Scalar, dfield, dstate) -> PyTree:
    """Return V dy, and what the change of the equations adds to it."""
    both = state, with_zeros(dstate, state)
    return flow(VariedField(field, dfield), both, time)[1]
