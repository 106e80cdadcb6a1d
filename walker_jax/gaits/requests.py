"""Strides and their derivatives for many branches at once.

A branch is followed by a generator that yields what it asks for; the strides that all branches ask
for are made together.
"""

from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.derivatives import Curved, Linearised, curve, linearise
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.iteration import stacked
from walker_jax.walking.stepping import prepare

# How a branch is followed. Each path is a generator that asks for strides and their derivatives
# and is sent the answer, so that one call computes what all paths ask for.


class Ask(NamedTuple):
    """A cycle of states at a value of the parameter, of which the derivatives are wanted."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    vectors: Float[np.ndarray, "period section"] | None = None
    """Directions along which second derivatives are wanted too."""


class Answer(NamedTuple):
    """Derivatives at a cycle of states, as `linearise` and `curve` give them."""

    local: Linearised
    curved: Curved | None


Task = Generator[Ask, Answer, Any]


def together(
    walker: Walker, parameter: str, tasks: Sequence[Task], tolerance: Real | None
) -> list[Any]:
    """Run tasks side by side, what they ask for computed in batches; returns what they return."""
    results: list[Any] = [None] * len(tasks)
    asked: dict[int, Ask] = {}

    def advance(i: int, answer: Answer | None):
        try:
            asked[i] = next(tasks[i]) if answer is None else tasks[i].send(answer)
        except StopIteration as stop:
            results[i] = stop.value

    for i in range(len(tasks)):
        advance(i, None)
    while asked:
        asks, asked = asked, {}
        answers = answer_all(walker, parameter, list(asks.values()), tolerance)
        for i, answer in zip(asks, answers, strict=True):
            advance(i, answer)
    return results


def answer_all(
    walker: Walker, parameter: str, asks: list[Ask], tolerance: Real | None
) -> list[Answer]:
    """What is asked for, every state of every cycle a cell of its own."""
    dtype = asks[0].cycle.dtype
    walker, _, tolerance = prepare(walker, asks[0].cycle[0], tolerance)
    batch = lambda asks: cells_of(walker, parameter, asks, dtype)
    locals_ = split(linearise(*batch(asks), tolerance, parameter), asks)
    bent = [ask for ask in asks if ask.vectors is not None]
    curves: list[Curved] = []
    if bent:
        vectors = np.concatenate([ask.vectors for ask in bent if ask.vectors is not None])
        directions = np.concatenate([vectors, np.zeros_like(vectors[:, :1])], axis=1)[:, None]
        walkers, states = batch(bent)
        curves = split(curve(walkers, states, directions, tolerance, parameter), bent)
    curved = iter(curves)
    return [
        Answer(local, next(curved) if ask.vectors is not None else None)
        for ask, local in zip(asks, locals_, strict=True)
    ]


def cells_of(
    walker: Walker, parameter: str, asks: list[Ask], dtype: Any
) -> tuple[Walker, Float[np.ndarray, "n 1 section"]]:
    """Walkers and states of all cycles asked about, one after the other."""
    values = np.concatenate([np.full(len(ask.cycle), ask.value, dtype) for ask in asks])
    states = np.concatenate([ask.cycle for ask in asks])[:, None]
    return with_parameter(stacked(walker, len(values), dtype), parameter, values), states


def split(values: Linearised | Curved, asks: list[Ask]) -> list[Any]:
    """What was found at all states, cycle by cycle."""
    ends = np.cumsum([len(ask.cycle) for ask in asks])[:-1]
    parts = zip(*(np.split(np.moveaxis(v, 1, 0), ends, axis=1) for v in values), strict=True)
    return [type(values)(*part) for part in parts]
