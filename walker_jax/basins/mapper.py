"""The mapper: `label` for many starts, on all cores.

Each step of a label is made for all starts that the one before left open: so few walks wait for the
longest ones.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basins.attractor import Attractor, match_attractor, targets_of
from walker_jax.basins.labels import (
    CLOSE,
    FURTHER,
    SKIPPED,
    SURVIVAL,
    VISITED,
    Label,
    comes_nearer,
    cycles_of,
    follow_near,
    motions_apart,
    repeats,
    without_period,
)
from walker_jax.basins.motions import nearest_motion
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.systems.trees import in_dtype, with_static_functions
from walker_jax.walking.iteration import iterate, orbits


class Mapper(NamedTuple):
    """Maps starts to the attractors to which walkers converge: labels = mapper(starts)."""

    walker: System
    """One walker, with numbers for parameters."""
    attractors: list[Attractor]
    integrator: Integrator
    strides: int
    """Most strides for which a walker is followed."""
    further: int = FURTHER
    """Further strides for which the remaining walkers are followed to their cycles; a later fall
    does not count."""

    def __call__(
        self, starts: Float[np.ndarray, "n section"], *, progress: str | None = None
    ) -> Label:
        """Return the labels of starts, as `label` gives them one by one."""
        labels = self.follow(starts, progress=progress)
        remaining = labels.remaining
        labels.attractor[remaining] = self.identify(labels.state[remaining])
        return labels

    def follow(
        self, starts: Float[np.ndarray, "n section"], *, progress: str | None = None
    ) -> Label:
        """Label walkers that fail, or come to a cycle or ever nearer to it, in their strides."""
        labels = self.walk(starts, progress=progress)
        remaining = labels.remaining
        labels.attractor[remaining] = self.match_approaching(labels.state[remaining])
        return labels

    def walk(self, starts: Float[np.ndarray, "n section"], *, progress: str | None = None) -> Label:
        """Follow walkers until they fail, are in a capture box, or have made all strides."""
        targets, owner = targets_of(self.attractors, starts.shape[1])
        end = iterate(
            self.walker, starts, self.strides, self.integrator, targets, progress=progress
        )
        return Label(end.outcome, owner[end.target], end.strides, end.state)

    def identify(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Return the attractors of walks that have made all strides; -1 for none."""
        number = self.match_approaching(x)
        left = np.flatnonzero(number < 0)
        if without_period(self.attractors):
            number[left] = self.follow_motions(x[left])
        elif self.attractors and self.further:
            later = self._replace(strides=self.further).follow(x[left])
            number[left] = later.attractor
        return number

    def match_approaching(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Return the numbers of the cycles that walkers come ever nearer to; -1 for none."""
        return match_approaching(self.walker, x, self.attractors, self.integrator)

    def follow_motions(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Return the nearest motion of each walk, as `follow_motion` does."""
        walks, clouds = self.visited(x), motions_apart(self.attractors)
        numbers = np.array(without_period(self.attractors), np.int32)
        number = np.full(len(x), numbers[0])
        if clouds is not None and len(numbers) > 1:
            nearest, near = nearest_motion(clouds, walks[:, ::SKIPPED])
            end = iterate(self.walker, x[~near], SURVIVAL[0], self.integrator)
            on = end.outcome == Outcome.STRIDE
            later = self.visited(end.state[on])[:, ::SKIPPED]
            nearest[np.flatnonzero(~near)[on]], _ = nearest_motion(clouds, later)
            number = numbers[nearest]
        number[repeats(walks)] = -1
        return number

    def on_known_motions(self, x: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        """Return whether each walker is on one of the known motions without a period."""
        if not without_period(self.attractors) or not len(x):
            return np.zeros(len(x), bool)
        clouds = motions_apart(self.attractors)
        if clouds is None:
            return np.ones(len(x), bool)
        return nearest_motion(clouds, self.visited(x)[:, ::SKIPPED])[1]

    def visited(self, x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n states section"]:
        """Return the states of a few more strides of walkers, NaN after a failure."""
        return orbits(self.walker, x, VISITED, self.integrator)[0]


def match_approaching(
    walker: System,
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    integrator: Integrator,
) -> Int[np.ndarray, " n"]:
    """Return the numbers of the cycles that walkers come ever nearer to; -1 for none."""
    number = match_attractor(x, attractors, CLOSE, turns_of(walker))
    near = np.flatnonzero(number >= 0)
    if len(near):
        largest = largest_distances(walker, x[near], attractors, integrator)
        number[near[~comes_nearer(largest)]] = -1
    return number


def largest_distances(
    walker: System,
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    integrator: Integrator,
) -> Float[np.ndarray, "n blocks"]:
    """Return the largest distance of walks from a cycle that they are close to, by stretches."""
    walker = in_dtype(with_static_functions(walker), x.dtype)
    cycles = cycles_of(attractors, x.shape[1], x.dtype)
    given = walker, x, cycles, integrator.in_dtype(x.dtype)
    return map_cells(follow_near, given, (False, True, False, False))[1]
