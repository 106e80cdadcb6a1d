"""Attractors: cycles of strides, and motions that never repeat, with the boxes that capture walks.

A walker has reached a cycle once it is in one of its capture boxes. An attractor holds arrays
alone, so a list of attractors is an operand of a JAX function.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.systems.angles import Turns
from walker_jax.walking.iteration import Targets, nearest_target

SAMPLE = 2**14
"""Number of starts that are followed in search of attractors."""


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    states: Float[Any, "period section"]
    """The states of the cycle; otherwise, one state of the motion, of the smallest angle."""
    capture_boxes: Float[Any, "period section section"] | None = None
    """For each state, a matrix M: a walker at x has converged where |M (x - state)| < 1 in all
    coordinates. None where these are cubes of half edge `capture_radius`."""
    cloud: Float[Any, "points section"] | None = None
    """None for a cycle. Points of a motion without a period, one stride apart; none for an
    attractor that stands for all motions without a period."""

    @property
    def period(self) -> int | None:
        """Strides in a cycle; None where the motion does not repeat itself."""
        return len(self.states) if self.cloud is None else None

    @property
    def points(self) -> Float[Any, "points section"]:
        """All known points of the attractor."""
        return self.states if self.cloud is None or len(self.cloud) == 0 else self.cloud

    @property
    def stands_for_all(self) -> bool:
        """Whether it stands for all motions without a period."""
        return self.cloud is not None and len(self.cloud) == 0


def all_motions(state: Float[Any, "1 section"]) -> Attractor:
    """Return the attractor that stands for all motions without a period."""
    return Attractor(state, cloud=state[:0])


def capture_radius(dtype) -> float:
    """Return the distance, in every coordinate, within which an attractor is reached."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def cubes(attractor: Attractor, radius: float) -> Float[Any, "period section section"]:
    """Return capture boxes that are cubes, of a given half edge."""
    period, size = attractor.states.shape
    return np.tile(np.eye(size) / radius, (period, 1, 1))


def targets_of(
    attractors: Sequence[Attractor], size: int, within: float | None = None
) -> tuple[Targets, Int[np.ndarray, " m"]]:
    """Return the capture boxes of all cycles, or cubes of a half edge, and the owner of each.

    Another owner, the last, is -1: that of the target -1, for none.
    """
    states, frames, owner = [], [], []
    for number, one in enumerate(attractors):
        if one.period is None:
            continue
        boxes = one.capture_boxes if within is None else cubes(one, within)
        states.append(one.states)
        frames.append(cubes(one, capture_radius(one.states.dtype)) if boxes is None else boxes)
        owner += [number] * one.period
    if not owner:
        return Targets(np.zeros((0, size)), np.zeros((0, size, size))), np.full(1, -1, np.int32)
    join = states[0].__array_namespace__().concatenate
    return Targets(join(states), join(frames)), np.array([*owner, -1], np.int32)


def match_attractor(
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    within: float | None = None,
    turns: Turns = None,
) -> Int[np.ndarray, " n"]:
    """Return the number of the cycle whose capture box holds each state; -1 for none.

    Of several boxes the nearest counts. With `within` the boxes are cubes of that half edge.
    """
    targets, owner = targets_of(attractors, x.shape[1], within)
    return owner[nearest_target(x, targets, turns)]


def sorted_numbers(attractors: Sequence[Attractor]) -> list[int]:
    """Return their numbers, sorted by period and angle; aperiodic ones last."""
    key = [(one.period or np.inf, one.states[0, 0]) for one in attractors]
    return sorted(range(len(key)), key=key.__getitem__)


def in_order(attractors: Sequence[Attractor]) -> tuple[list[Attractor], Int[np.ndarray, " n"]]:
    """Return attractors in order, and the new number of each; the last, -1, is that of none."""
    order = sorted_numbers(attractors)
    number = np.full(len(order) + 1, -1, np.int32)
    number[order] = np.arange(len(order))
    return [attractors[i] for i in order], number


def seen(attractors: Sequence[Attractor], number: Int[np.ndarray, " n"]) -> list[Attractor]:
    """Drop attractors without a period, from the last on, if none of these walks is on it."""
    last = len(attractors) - 1
    if last < 0 or attractors[last].period or (number == last).any():
        return list(attractors)
    return seen(attractors[:last], number)


def new_cycle(
    states: Float[np.ndarray, "period section"],
    known: Sequence[Attractor],
    turns: Turns = None,
) -> Attractor | None:
    """Make a cycle, from its state of the smallest angle on; None if it is known."""
    states = np.roll(states, -int(states[:, 0].argmin()), axis=0)
    is_known = match_attractor(states[:1], known, turns=turns)[0] >= 0
    return None if is_known else Attractor(states)


def sample_indices(n: int, most: int = SAMPLE) -> Int[np.ndarray, " m"]:
    """Return the indices of a sample of n items, evenly spread over their order."""
    return np.linspace(0, n - 1, min(n, most)).astype(int)
