"""Attractors, their capture boxes, and their numbering."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.walking.iteration import Targets, nearest_target

CLOSE = 0.01
"""Distance from a cycle within which a walk that has made all its strides may still be approaching
it: near a period doubling, convergence is too slow to come within `capture_radius`."""


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    period: int | None
    """Strides in a cycle; None where the motion does not repeat itself."""
    states: Float[np.ndarray, "period section"]
    """The states of the cycle; otherwise, one state of the motion."""
    capture_boxes: Float[np.ndarray, "period section section"] | None = None
    """For each state, a matrix M: a walker at x has converged where |M (x - state)| < 1 in all
    coordinates. None where these are cubes of half edge `capture_radius`."""
    cycles: int = 0
    """By cell mapping: number of cycles of cells that belong to it, or make up this artefact."""
    falling: int = 0
    """Number of centres of those cells from which a walker falls."""
    artefact: bool = False
    """Whether it is a cycle of cells alone: walkers from most of its centres do not converge to one
    attractor. Its states are those centres."""


def capture_radius(dtype) -> float:
    """Return the distance, in every coordinate, within which an attractor is reached."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def cubes(attractor: Attractor, radius: float) -> Float[np.ndarray, "period section section"]:
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
    targets = Targets(np.concatenate(states), np.concatenate(frames))
    return targets, np.array([*owner, -1], np.int32)


def match_attractor(
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    within: float | None = None,
) -> Int[np.ndarray, " n"]:
    """Return the number of the cycle whose capture box holds each state; -1 for none.

    Of several boxes the nearest counts. With `within` the boxes are cubes of that half edge.
    """
    targets, owner = targets_of(attractors, x.shape[1], within)
    return owner[nearest_target(x, targets)]


def sorted_numbers(attractors: Sequence[Attractor]) -> list[int]:
    """Return their numbers, sorted by period and angle; aperiodic ones, then artefacts, last."""
    key = [(one.artefact, one.period or np.inf, one.states[0, 0]) for one in attractors]
    return sorted(range(len(key)), key=key.__getitem__)
