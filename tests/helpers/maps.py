"""Continuation along branches of any map, in the place of a walker's stride function."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.gaits.cycles import Linearisation
from walker_jax.gaits.derivatives import SecondDerivatives
from walker_jax.gaits.jets import Curves, Jet
from walker_jax.gaits.requests import Request, SecondOrderRequest, Task


def done_with(stride: Callable, task: Task) -> Any:
    """What a task returns where a stride from x, the parameter being p, ends in stride(x, p)."""
    response = None
    while True:
        try:
            request = next(task) if response is None else task.send(response)
        except StopIteration as stop:
            return stop.value
        response = ANSWERS[type(request)](stride, request)


def first_derivatives(stride: Callable, request: Request) -> Linearisation:
    zeros = np.zeros((*request.cycle.shape[:1], request.cycle.shape[1] + 1))
    found = compiled_derivatives(stride)(request.cycle, float(request.value), zeros)
    state, by_columns = (np.asarray(x)[None] for x in found[:2])
    times = np.ones((1, len(request.cycle)))
    of_times = np.zeros(by_columns.shape[:2] + by_columns.shape[3:])
    return Linearisation(state, times, by_columns[..., :-1], by_columns[..., -1], of_times)


def second_derivatives(stride: Callable, request: SecondOrderRequest) -> SecondDerivatives:
    found = [
        compiled_derivatives(stride)(request.cycle, float(request.values[0]), one)
        for one in request.directions
    ]
    state, by_columns, along, changes = (
        np.stack([np.asarray(one) for one in values]) for values in zip(*found, strict=True)
    )
    return SecondDerivatives(state, by_columns, along, changes)


def derivatives_along(stride: Callable, request: Curves) -> Jet:
    jet = request.first, request.second, np.zeros_like(request.first)
    for x in request.cycle:
        along = lambda *rows, x=x: compiled_jet(stride)(x, float(request.values[0]), *rows)
        found = [along(*rows) for rows in zip(*jet, strict=True)]
        jet = tuple(
            np.stack([np.asarray(one) for one in part]) for part in zip(*found, strict=True)
        )
    return Jet(*jet)


ANSWERS = {
    Request: first_derivatives,
    SecondOrderRequest: second_derivatives,
    Curves: derivatives_along,
}


@cache
def compiled_derivatives(stride: Callable) -> Callable:
    """Ends of strides and their derivatives by all columns, and those along a direction."""

    def derivatives(x, p, direction):
        of_columns = lambda columns: stride(columns[:-1], columns[-1])
        columns = jnp.append(x, p)
        along = lambda columns: jax.jvp(of_columns, (columns,), (direction,))[1]
        return (
            of_columns(columns),
            jax.jacfwd(of_columns)(columns),
            along(columns),
            jax.jacfwd(along)(columns),
        )

    return jax.jit(jax.vmap(derivatives, (0, None, 0)))


@cache
def compiled_jet(stride: Callable) -> Callable:
    """The first three derivatives of the end of a stride along a curve."""

    def derivatives(x, p, first, second, third):
        end = lambda t: stride(x + t * first + t**2 / 2 * second + t**3 / 6 * third, p)
        of = [jax.jacfwd(end)]
        for _ in range(2):
            of.append(jax.jacfwd(of[-1]))
        return tuple(one(0.0) for one in of)

    return jax.jit(derivatives)
