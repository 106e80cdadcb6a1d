"""The mapper: from the start of a walk to the attractor that it converges to, and how soon."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basins.attractor import (
    LONGEST_PERIOD,
    SAMPLE,
    SURVIVAL,
    Attractor,
    find_attractors,
    match_approaching,
    match_attractor,
    sample,
    sorted_numbers,
    targets_of,
)
from walker_jax.basins.motions import Clouds
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.iteration import RECORDED, iterate, orbits

FURTHER = 2**14
"""Further strides for which undecided walkers are followed to a cycle. They end all but one in ten
million transients with a mean life of 1000 strides, and half of those with 24,000."""
SKIPPED = 4
"""Number of strides between the states of a walker that are compared with motions without a
period."""


class Labels(NamedTuple):
    """The fates and attractors of walkers from n starts."""

    fate: Int[np.ndarray, " n"]
    """`Outcome` of the last stride; `STRIDE` where the walker did not fail."""
    attractor: Int[np.ndarray, " n"]
    """Number of the attractor that it converges to; -1 for none."""
    strides: Int[np.ndarray, " n"]
    """Strides completed before it converged or failed."""
    states: Float[np.ndarray, "n section"]
    """State after these strides; NaN after a failure."""

    @property
    def converged(self) -> Bool[np.ndarray, " n"]:
        return self.attractor >= 0

    @property
    def fallen(self) -> Bool[np.ndarray, " n"]:
        """Mark the walks that are known to have failed."""
        return ~np.isin(self.fate, (Outcome.STRIDE, Outcome.UNDECIDED))

    @property
    def remaining(self) -> Int[np.ndarray, " left"]:
        """Indices of walks that neither failed nor converged."""
        return np.flatnonzero((self.fate == Outcome.STRIDE) & ~self.converged)

    @property
    def total_strides(self) -> int:
        """Number of strides computed, including the failing strides."""
        return int(self.strides.sum() + np.sum(self.fate != Outcome.STRIDE))


class Mapper(NamedTuple):
    """Maps starts to the attractors to which walkers converge: labels = mapper(starts).

    A walker has converged to a cycle once it is in one of its capture boxes. After all its strides,
    it has also converged if it comes ever nearer to the cycle (`attractor.approaches`). To
    label the remaining walkers too, they are followed further, each to its cycle.
    """

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
    ) -> Labels:
        """Follow walkers until they fail, or converge to one of the attractors."""
        labels = self.follow(starts, progress=progress)
        remaining = labels.remaining
        labels.attractor[remaining] = self.match_approaching(labels.states[remaining])
        return labels

    def follow(
        self, starts: Float[np.ndarray, "n section"], *, progress: str | None = None
    ) -> Labels:
        """Follow walkers until they fail, or are in a capture box."""
        targets, owner = targets_of(self.attractors, starts.shape[1])
        end = iterate(
            self.walker, starts, self.strides, self.integrator, targets, progress=progress
        )
        return Labels(end.outcome, owner[end.target], end.strides, end.state)

    def match_approaching(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Return the numbers of the cycles that walkers come ever nearer to; -1 for none."""
        return match_approaching(self.walker, x, self.attractors, self.integrator)

    def follow_on(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Follow walkers further; return the numbers of the cycles they converge to, or -1."""
        number, left, made = np.full(len(x), -1, np.int32), np.arange(len(x)), 0
        while len(left) and made < self.further:
            count = min(max(made, LONGEST_PERIOD), self.further - made)
            end = iterate(self.walker, x, count, self.integrator)
            turns = turns_of(self.walker)
            number[left] = match_attractor(end.state, self.attractors, turns=turns)  # -1 for NaN
            on = (end.outcome == Outcome.STRIDE) & (number[left] < 0)
            left, x, made = left[on], end.state[on], made + count
        number[left] = self.match_approaching(x)
        return number

    def label_all(
        self, starts: Float[np.ndarray, "n section"], *, progress: str | None = None
    ) -> tuple[Labels, "Mapper"]:
        """Label all starts, undecided ones too; return labels, and the mapper to all attractors."""
        return self.complete_labels(self.follow(starts, progress=progress))

    def complete_labels(self, labels: Labels, most: int = SAMPLE) -> tuple[Labels, "Mapper"]:
        """Label the walkers that remain too; return labels, and the mapper to all attractors."""
        remaining = labels.remaining
        labels.attractor[remaining], mapper = self.label_remaining(labels.states[remaining], most)
        return labels, mapper

    def label_remaining(
        self, x: Float[np.ndarray, "n section"], most: int = SAMPLE
    ) -> tuple[Int[np.ndarray, " n"], "Mapper"]:
        """Find the attractors of walkers that have made all strides; return the mapper to all.

        The attractor is the cycle that they approach, or one found by following some of them
        further, at most `most`. Otherwise it is the nearest motion without a period, if there is
        one, even for walkers that have yet to fall. Otherwise it is the cycle that they converge to
        later, or -1.
        """
        number, mapper = self.match_approaching(x), self
        unmatched = np.flatnonzero(number < 0)
        strange = unmatched[~self.on_known_motions(x[unmatched])]
        if len(strange):
            mapper = self.with_attractors_from(sample(x[strange], most))
            if len(mapper.attractors) > len(self.attractors):
                number[strange] = mapper.match_approaching(x[strange])
        unmatched = number < 0
        if mapper.wandering:
            number[unmatched] = mapper.nearest_motion(x[unmatched])
        elif mapper.attractors and mapper.further:
            number[unmatched] = mapper.follow_on(x[unmatched])
        return number, mapper

    @property
    def wandering(self) -> list[int]:
        """Numbers of the attractors without a period."""
        return [i for i, one in enumerate(self.attractors) if one.period is None]

    def clouds(self) -> Clouds | None:
        """Return the clouds of all motions without a period; None where one stands for all."""
        known = [self.attractors[i].cloud for i in self.wandering]
        clouds = [cloud for cloud in known if cloud is not None]
        return Clouds(clouds) if len(clouds) == len(known) else None

    def on_known_motions(self, x: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        """Return whether each walker is on one of the known motions without a period."""
        if not self.wandering or not len(x):
            return np.zeros(len(x), bool)
        clouds = self.clouds()
        if clouds is None:
            return np.ones(len(x), bool)
        return clouds.nearest(self.next_states(x)[:, ::SKIPPED])[1]

    def nearest_motion(self, x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        """Return the number of the motion without a period that is nearest to each walker.

        It is -1 for walkers that repeat themselves, as on an unstable cycle. Of several motions, it
        is the one that walkers on none of them come to in more strides.
        """
        walks, clouds = self.next_states(x), self.clouds()
        number = np.full(len(x), self.wandering[0], np.int32)
        if clouds is not None and len(self.wandering) > 1:
            nearest, near = clouds.nearest(walks[:, ::SKIPPED])
            end = iterate(self.walker, x[~near], SURVIVAL[0], self.integrator)
            on = end.outcome == Outcome.STRIDE
            later = self.next_states(end.state[on])[:, ::SKIPPED]
            nearest[np.flatnonzero(~near)[on]], _ = clouds.nearest(later)
            number = np.array(self.wandering, np.int32)[nearest]
        exact = 1e3 * np.finfo(x.dtype).eps
        repeats = (np.abs(walks[:, 1:] - walks[:, :1]).max(axis=2) < exact).any(axis=1)
        number[repeats] = -1
        return number

    def next_states(
        self, x: Float[np.ndarray, "n section"]
    ) -> Float[np.ndarray, "n states section"]:
        """Return the states of a few more strides of walkers, NaN after a failure."""
        return orbits(self.walker, x, RECORDED, self.integrator)[0]

    def with_attractors_from(self, starts: Float[np.ndarray, "n section"]) -> "Mapper":
        """Return the mapper to the attractors of some starts too."""
        found = find_attractors(self.walker, starts, self.integrator, self.attractors)
        return self._replace(attractors=found)

    def without_unseen_motion(self, number: Int[np.ndarray, " n"]) -> "Mapper":
        """Drop attractors without a period, from the last on, if none of these walkers is on it."""
        last = len(self.attractors) - 1
        if last < 0 or self.attractors[last].period or (number == last).any():
            return self
        fewer = self._replace(attractors=self.attractors[:last])
        return fewer.without_unseen_motion(number)

    def with_sorted_attractors(self) -> "Mapper":
        """Return the mapper with its attractors in the order in which a basin numbers them."""
        order = sorted_numbers(self.attractors)
        return self._replace(attractors=[self.attractors[i] for i in order])
