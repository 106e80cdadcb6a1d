"""The mapper: from the start of a walk to the attractor that it converges to, and how soon."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basins.attractor import (
    LONGEST_PERIOD,
    SAMPLE,
    Attractor,
    find_attractors,
    match_approaching,
    match_attractor,
    sample,
    sorted_numbers,
    targets_of,
)
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.iteration import iterate

FURTHER = 2**14
"""Further strides for which undecided walkers are followed to a cycle. They end all but one in ten
million transients with a mean life of 1000 strides, and half of those with 24,000."""


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
        further, at most `most`. Otherwise it is the motion without a period, if there is one, even
        for walkers that have yet to fall. Otherwise it is the cycle that they converge to later, or
        -1.
        """
        number, mapper = self.match_approaching(x), self
        unmatched = number < 0
        if unmatched.any() and all(one.period for one in self.attractors):
            mapper = self.with_attractors_from(sample(x[unmatched], most))
            if len(mapper.attractors) > len(self.attractors):
                number[unmatched] = mapper.match_approaching(x[unmatched])
        unmatched = number < 0
        wandering = [i for i, one in enumerate(mapper.attractors) if one.period is None]
        if wandering:
            number[unmatched] = wandering[0]
        elif mapper.attractors and mapper.further:
            number[unmatched] = mapper.follow_on(x[unmatched])
        return number, mapper

    def with_attractors_from(self, starts: Float[np.ndarray, "n section"]) -> "Mapper":
        """Return the mapper to the attractors of some starts too."""
        found = find_attractors(self.walker, starts, self.integrator, self.attractors)
        return self._replace(attractors=found)

    def without_unseen_motion(self, number: Int[np.ndarray, " n"]) -> "Mapper":
        """Drop the attractor without a period if none of these walkers is on it.

        That attractor is the last: none is sought once it is known.
        """
        last = len(self.attractors) - 1
        if last < 0 or self.attractors[last].period or (number == last).any():
            return self
        return self._replace(attractors=self.attractors[:last])

    def with_sorted_attractors(self) -> "Mapper":
        """Return the mapper with its attractors in the order in which a basin numbers them."""
        order = sorted_numbers(self.attractors)
        return self._replace(attractors=[self.attractors[i] for i in order])
