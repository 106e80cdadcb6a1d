"""Strides and their derivatives for many branches at once.

A generator follows each branch: it yields requests for derivatives and receives responses. One call
computes the requests of one kind of all branches.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.cycles import Linearisation, linearise
from walker_jax.gaits.derivatives import SecondDerivatives, differentiate_twice
from walker_jax.gaits.jets import Curves, differentiate_curves
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import turn_to, turns_of
from walker_jax.systems.system import System
from walker_jax.walking.iteration import with_parameters


class Request(NamedTuple):
    """A request for strides from a cycle at a value of the parameter, as a `Linearisation`."""

    value: float
    cycle: Float[np.ndarray, "period section"]


class SecondOrderRequest(NamedTuple):
    """A request for strides from a cycle, with `SecondDerivatives` along each direction."""

    values: Float[np.ndarray, " parameters"]
    cycle: Float[np.ndarray, "period section"]
    directions: Float[np.ndarray, "vectors period columns"]
    """Columns of the states, then of the parameters."""


Task = Generator[Any, Any, Any]
"""A generator that yields a `Request`, a `SecondOrderRequest` or `Curves`, and gets derivatives."""


def run_batched(tasks: Sequence[Task], compute: Callable[[list[Any]], list[Any]]) -> list[Any]:
    """Run tasks side by side, their requests in batches, and return the result of each task.

    `compute` returns the response to each of some requests.
    """
    results: list[Any] = [None] * len(tasks)
    pending: dict[int, Any] = {}

    def resume(i: int, response: Any):
        try:
            pending[i] = next(tasks[i]) if response is None else tasks[i].send(response)
        except StopIteration as stop:
            results[i] = stop.value

    for i in range(len(tasks)):
        resume(i, None)
    while pending:
        requests, pending = pending, {}
        responses = compute(list(requests.values()))
        for i, response in zip(requests, responses, strict=True):
            resume(i, response)
    return results


def compute_responses(
    system: System, parameters: Sequence[str], integrator: Integrator, requests: list[Any]
) -> list[Any]:
    """Compute the responses to requests at values of these parameters."""
    results: list[Any] = [None] * len(requests)
    kinds = (Request, follow_cycles), (SecondOrderRequest, expand), (Curves, differentiate_curves)
    for kind, compute in kinds:
        which = [i for i, one in enumerate(requests) if isinstance(one, kind)]
        if which:
            found = compute(system, parameters, [requests[i] for i in which], integrator)
            for i, one in zip(which, found, strict=True):
                results[i] = one
    return results


def follow_cycles(
    system: System, parameters: Sequence[str], requests: list[Request], integrator: Integrator
) -> list[Linearisation]:
    """Make strides with first derivatives; every state of every cycle is a cell of its own."""
    lengths = [len(one.cycle) for one in requests]
    systems = with_parameters(
        system, parameters, repeat([[one.value] for one in requests], lengths)
    )
    states = np.concatenate([one.cycle for one in requests])[:, None]
    found = linearise(systems, states, integrator, parameters[0])
    parts = [Linearisation(*(v[None] for v in part)) for part in cut(found, lengths)]
    return [turn_ends(system, one.cycle, part) for one, part in zip(requests, parts, strict=True)]


def expand(
    system: System,
    parameters: Sequence[str],
    requests: list[SecondOrderRequest],
    integrator: Integrator,
) -> list[SecondDerivatives]:
    """Make strides with second derivatives; every state and direction is a cell of its own."""
    lengths = [one.directions.shape[0] * len(one.cycle) for one in requests]
    systems = with_parameters(system, parameters, repeat([one.values for one in requests], lengths))
    states = np.concatenate([np.tile(one.cycle, (len(one.directions), 1)) for one in requests])
    directions = np.concatenate(
        [one.directions.reshape(-1, one.directions.shape[2]) for one in requests]
    )
    cells = systems, states[:, None], directions[:, None]
    parts = cut(differentiate_twice(*cells, integrator, parameters), lengths)
    shaped = [
        SecondDerivatives(*(v.reshape(len(one.directions), -1, *v.shape[1:]) for v in part))
        for one, part in zip(requests, parts, strict=True)
    ]
    return [turn_ends(system, one.cycle, part) for one, part in zip(requests, shaped, strict=True)]


def turn_ends(system: System, cycle: Float[np.ndarray, "period section"], found: Any) -> Any:
    """Turn the ends of strides to the next states of a cycle, of which they may be full turns off.

    So angles do not jump along a branch.
    """
    onward = np.roll(cycle, -1, axis=0)
    return found._replace(state=turn_to(found.state, onward, turns_of(system)))


def repeat(rows: Sequence[Any], counts: Sequence[int]) -> Float[np.ndarray, "n columns"]:
    return np.repeat(np.asarray(rows, float), counts, axis=0)


def cut(values: tuple[np.ndarray, ...], lengths: Sequence[int]) -> list[tuple[np.ndarray, ...]]:
    """Cut arrays over all cells and one stride into parts of these lengths."""
    ends = np.cumsum(lengths)[:-1]
    return list(zip(*(np.split(one[:, 0], ends) for one in values), strict=True))
