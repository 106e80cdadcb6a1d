"""Attractors, the regions they attract, and walks that end at one."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.walkers.model import Walker
from walker_jax.walking.iteration import strides
from walker_jax.walking.outcomes import Outcome

CLOSE = 0.01
"""Distance from a cycle at which a walker counts as its, that is left when all others are there."""


class Basins(NamedTuple):
    """What became of each of a grid's cells, in the order of their indices."""

    fate: Int[np.ndarray, " n"]
    attractor: Int[np.ndarray, " n"]
    strides: Int[np.ndarray, " n"]
    attractors: list["Attractor"]

    @property
    def made(self) -> int:
        """Strides that were made, the failing ones among them."""
        return int(self.strides.sum() + np.sum(self.fate != Outcome.STRIDE))


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    period: int | None
    """Strides in a cycle; none where the motion does not repeat itself."""
    states: Float[np.ndarray, "period section"]
    """The states of the cycle; otherwise, one state of the motion."""
    frames: Float[np.ndarray, "period section section"] | None = None
    """For each state, matrices that make displacements from it less than 1, in all coordinates,
    where a walker is taken to have arrived; none where that is `near`."""
    cycles: int = 0
    """By cell mapping: how many cycles of cells belong to it, or are this artefact."""
    falling: int = 0
    """From how many of the centres of their cells a walker falls."""
    artefact: bool = False
    """Whether it is a cycle of cells alone, from most of whose centres walkers do not come to one
    attractor; its states are those centres."""

    def boxes(self) -> Float[np.ndarray, "period section section"]:
        """The frames, also where there are none."""
        if self.frames is not None:
            return self.frames
        period, size = self.states.shape
        return np.tile(np.eye(size) / near(self.states.dtype), (period, 1, 1))


class Followed(NamedTuple):
    """What became of walkers that were followed, but for those that are left at the end."""

    fate: Int[np.ndarray, " n"]
    attractor: Int[np.ndarray, " n"]
    """-1 for none, and for those left."""
    strides: Int[np.ndarray, " n"]
    left: Int[np.ndarray, " left"]
    """Numbers of those that neither failed nor came near an attractor."""
    ends: Float[np.ndarray, "left section"]
    """Where these are."""


def until_near(
    walker: Walker,
    starts: Float[np.ndarray, "n section"],
    attractors: list[Attractor],
    tolerance: float,
    limit: int,
    progress: bool = False,
) -> Followed:
    """Follow every start for a number of strides, until it fails or comes near an attractor."""
    fate = np.full(len(starts), Outcome.STRIDE, np.int8)
    attractor = np.full(len(starts), -1, np.int32)
    count = np.zeros(len(starts), np.int32)
    cells, x = np.arange(len(starts)), starts
    for k in range(limit + 1):
        reached = nearest(x, attractors)
        attractor[cells[reached >= 0]] = reached[reached >= 0]
        cells, x = cells[reached < 0], x[reached < 0]
        if k == limit or len(cells) == 0:
            break
        label = f"stride {k + 1}, {len(cells)} cells" if progress else None
        ends = strides(walker, x, tolerance=tolerance, progress=label)
        x, outcome = np.asarray(ends.state), np.asarray(ends.outcome)
        fate[cells] = outcome
        going = outcome == Outcome.STRIDE
        count[cells[going]] += 1
        cells, x = cells[going], x[going]
    return Followed(fate, attractor, count, cells, x)


def nearest(
    x: Float[np.ndarray, "n section"], attractors: list[Attractor], within: float | None = None
) -> Int[np.ndarray, " n"]:
    """Number of the cycle that each point is near to, the nearest of several, -1 for none."""
    number, least = np.full(len(x), -1, np.int32), np.ones(len(x), x.dtype)
    for i, attractor in enumerate(attractors):
        boxes = attractor.boxes() if within is None else np.eye(x.shape[1])[None] / within
        for state, frame in zip(attractor.states, itertools.cycle(boxes), strict=False):
            if attractor.period:
                away = np.abs((x - state) @ frame.T).max(axis=1)
                number[away < least], least = i, np.fmin(away, least)
    return number


def near(dtype) -> float:
    """Distance, in every coordinate of the section, at which a walker has reached an attractor."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def sort_attractors(found: Basins) -> Basins:
    """The same, attractors numbered in order."""
    order = in_order(found.attractors)
    number = np.full(len(order) + 1, -1, np.int32)  # the last is that of no attractor
    number[order] = np.arange(len(order))
    attractors = [found.attractors[i] for i in order]
    return found._replace(attractor=number[found.attractor], attractors=attractors)


def in_order(attractors: list[Attractor]) -> list[int]:
    """Their numbers, by period, then by angle; those without a period, then artefacts, last."""
    key = [(one.artefact, one.period or np.inf, one.states[0, 0]) for one in attractors]
    return sorted(range(len(key)), key=key.__getitem__)
