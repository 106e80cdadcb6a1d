"""Attractors, their capture boxes, and the order in which they are numbered."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.checks import WrongUse
from walker_jax.walking.iteration import Targets, nearest_target

CLOSE = 0.01
"""Distance from a cycle at which a walker that has made all its strides may be one that approaches
it: close to a period doubling too slowly to come within `capture_radius`."""


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    period: int | None
    """Strides in a cycle; none where the motion does not repeat itself."""
    states: Float[np.ndarray, "period section"]
    """The states of the cycle; otherwise, one state of the motion."""
    capture_boxes: Float[np.ndarray, "period section section"] | None = None
    """For each state, a matrix M: a walker at x has converged where |M (x - state)| < 1 in all
    coordinates. None where these are cubes of half edge `capture_radius`."""
    cycles: int = 0
    """By cell mapping: how many cycles of cells belong to it, or are this artefact."""
    falling: int = 0
    """From how many of the centres of their cells a walker falls."""
    artefact: bool = False
    """Whether it is a cycle of cells alone: walkers from most of its centres do not converge to one
    attractor. Its states are those centres."""


def capture_radius(dtype) -> float:
    """Distance, in every coordinate of the section, at which a walker has reached an attractor."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def check_cycle(
    states: Float[np.ndarray, "period section"], ends: Float[np.ndarray, "period section"]
) -> None:
    """Refuse the states of a gait from which strides end elsewhere: the gait of another walker."""
    miss = np.abs(ends - np.roll(states, -1, axis=0)).max()
    if not miss < capture_radius(states.dtype):
        raise WrongUse(
            f"gait must be one of this walker, whose strides miss it by {miss:.2g}: find_gait "
            "gives one"
        )


def cubes(attractor: Attractor, radius: float) -> Float[np.ndarray, "period section section"]:
    """Capture boxes that are cubes, of a half edge."""
    period, size = attractor.states.shape
    return np.tile(np.eye(size) / radius, (period, 1, 1))


def targets_of(
    attractors: Sequence[Attractor], size: int, within: float | None = None
) -> tuple[Targets, Int[np.ndarray, " m"]]:
    """The capture boxes of all cycles, or cubes of a half edge, and which attractor each is of."""
    states, frames, owner = [], [], []
    for number, one in enumerate(attractors):
        if one.period is None:
            continue
        boxes = one.capture_boxes if within is None else cubes(one, within)
        states.append(one.states)
        frames.append(cubes(one, capture_radius(one.states.dtype)) if boxes is None else boxes)
        owner += [number] * one.period
    if not owner:
        return Targets(np.zeros((0, size)), np.zeros((0, size, size))), np.zeros(0, np.int32)
    targets = Targets(np.concatenate(states), np.concatenate(frames))
    return targets, np.array(owner, np.int32)


def match_attractor(
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    within: float | None = None,
) -> Int[np.ndarray, " n"]:
    """Number of the cycle in whose capture boxes each state is, the nearest of several, or -1.

    With `within` the boxes are cubes of that half edge.
    """
    targets, owner = targets_of(attractors, x.shape[1], within)
    return owners(nearest_target(x, targets), owner)


def owners(target: Int[np.ndarray, " n"], owner: Int[np.ndarray, " m"]) -> Int[np.ndarray, " n"]:
    """The attractors whose capture boxes have these numbers; -1 for -1."""
    return np.append(owner, np.int32(-1))[target]


def sorted_numbers(attractors: Sequence[Attractor]) -> list[int]:
    """Their numbers, by period, then by angle; those without a period, then artefacts, last."""
    key = [(one.artefact, one.period or np.inf, one.states[0, 0]) for one in attractors]
    return sorted(range(len(key)), key=key.__getitem__)
