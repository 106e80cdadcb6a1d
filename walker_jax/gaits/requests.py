"""Strides and their derivatives for many branches at once.

A generator follows each branch: it yields requests for strides and receives responses. One call
computes the requests of all branches.
"""

from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.derivatives import (
    Linearisation,
    SecondDerivatives,
    differentiate_twice,
    linearise,
)
from walker_jax.integrators.integrator import integrator_of
from walker_jax.integrators.roots import Real
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.iteration import broadcast_parameters


class Request(NamedTuple):
    """Strides from a cycle of states at a value of the parameter, with their derivatives."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    vectors: Float[np.ndarray, "period section"] | None = None
    """Directions of second derivatives; None where none are needed."""


class Response(NamedTuple):
    """The result of `linearise` and `differentiate_twice` for the cycle of a request."""

    local: Linearisation
    second: SecondDerivatives | None


Task = Generator[Request, Response, Any]


def run_batched(
    walker: System, parameter: str, tasks: Sequence[Task], tolerance: Real | None
) -> list[Any]:
    """Run tasks side by side, with their requests in batches; returns what each task returns."""
    results: list[Any] = [None] * len(tasks)
    pending: dict[int, Request] = {}

    def resume(i: int, response: Response | None):
        try:
            pending[i] = next(tasks[i]) if response is None else tasks[i].send(response)
        except StopIteration as stop:
            results[i] = stop.value

    for i in range(len(tasks)):
        resume(i, None)
    while pending:
        requests, pending = pending, {}
        responses = compute_responses(walker, parameter, list(requests.values()), tolerance)
        for i, response in zip(requests, responses, strict=True):
            resume(i, response)
    return results


def compute_responses(
    walker: System, parameter: str, requests: list[Request], tolerance: Real | None
) -> list[Response]:
    """The responses to requests; every state of every cycle is a cell of its own."""
    dtype = requests[0].cycle.dtype
    integrator = integrator_of(dtype, tolerance)
    batch = lambda requests: batch_cells(walker, parameter, requests, dtype)
    linear = split_by_cycle(linearise(*batch(requests), integrator, parameter), requests)
    with_vectors = [request for request in requests if request.vectors is not None]
    seconds: list[SecondDerivatives] = []
    if with_vectors:
        vectors = np.concatenate(
            [request.vectors for request in with_vectors if request.vectors is not None]
        )
        directions = np.concatenate([vectors, np.zeros_like(vectors[:, :1])], axis=1)[:, None]
        walkers, states = batch(with_vectors)
        seconds = split_by_cycle(
            differentiate_twice(walkers, states, directions, integrator, parameter),
            with_vectors,
        )
    remaining = iter(seconds)
    return [
        Response(local, next(remaining) if request.vectors is not None else None)
        for request, local in zip(requests, linear, strict=True)
    ]


def batch_cells(
    walker: System, parameter: str, requests: list[Request], dtype: Any
) -> tuple[System, Float[np.ndarray, "n 1 section"]]:
    """Walkers and states of the cycles of all requests, one after the other."""
    values = np.concatenate(
        [np.full(len(request.cycle), request.value, dtype) for request in requests]
    )
    states = np.concatenate([request.cycle for request in requests])[:, None]
    return with_parameter(
        broadcast_parameters(walker, len(values), dtype), parameter, values
    ), states


def split_by_cycle(values: Linearisation | SecondDerivatives, requests: list[Request]) -> list[Any]:
    """Derivatives at all states, in parts: one for the cycle of each request."""
    ends = np.cumsum([len(request.cycle) for request in requests])[:-1]
    parts = zip(*(np.split(np.moveaxis(v, 1, 0), ends, axis=1) for v in values), strict=True)
    return [type(values)(*part) for part in parts]
