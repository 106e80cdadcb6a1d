"""Continuation along branches of any map, in the place of a walker's stride function."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.gaits.derivatives import Linearisation, SecondDerivatives
from walker_jax.gaits.requests import Response, Task


def done_with(stride: Callable, task: Task) -> Any:
    """What a task returns where a stride from x, the parameter being p, ends in stride(x, p)."""
    response = None
    while True:
        try:
            request = next(task) if response is None else task.send(response)
        except StopIteration as stop:
            return stop.value
        vectors = np.zeros_like(request.cycle) if request.vectors is None else request.vectors
        found = looked_at(stride)(request.cycle, float(request.value), vectors)
        state, jacobian, by_parameter, along, changes = (np.asarray(x)[None] for x in found)
        times = np.ones((1, len(request.cycle)))
        second = None if request.vectors is None else SecondDerivatives(along, 0 * times, changes)
        response = Response(Linearisation(state, times, jacobian, by_parameter), second)


@cache
def looked_at(stride: Callable) -> Callable:
    """Ends of strides and their derivatives, first and, along vectors, second ones."""

    def derivatives(x, p, vector):
        along = lambda x, p: jax.jvp(lambda x: stride(x, p), (x,), (vector,))[1]
        changes = jax.jacfwd(along, 0)(x, p), jax.jacfwd(along, 1)(x, p)[:, None]
        return (
            stride(x, p),
            jax.jacfwd(stride, 0)(x, p),
            jax.jacfwd(stride, 1)(x, p),
            along(x, p),
            jnp.concatenate(changes, axis=1),
        )

    return jax.jit(jax.vmap(derivatives, (0, None, 0)))
