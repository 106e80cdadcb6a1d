"""The labels of a grid's cells, stored as runs of equal neighbours along the last axis.

A label is one number for the fate and the attractor of a cell. A row of cells with one label costs
one run, so memory grows with the boundary between labels, not with the volume of the grid. A run
never continues from one row to the next. Cells are numbered as in `Grid`, but by 64 bits.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from walker_jax.systems.outcomes import OUTCOMES, Outcome


class Runs(NamedTuple):
    """The label of each cell, and the level of refinement on which it was followed."""

    shape: tuple[int, ...]
    """Shape of the grid."""
    first: Int[np.ndarray, " runs"]
    """The first cell of each run; the run ends before the next one."""
    label: Int[np.ndarray, " runs"]
    level: Int[np.ndarray, " runs"]

    @classmethod
    def from_cells(
        cls, label: Int[np.ndarray, "*shape"], level: Int[np.ndarray, "*shape"]
    ) -> "Runs":
        """Make the runs of cells with given labels and levels."""
        first = np.arange(label.size)
        return join_runs(label.shape, first, label.ravel(), level.ravel())

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def lengths(self) -> Int[np.ndarray, " runs"]:
        """Number of cells of each run."""
        return np.diff(self.first, append=self.size)

    @property
    def fate(self) -> Int[np.ndarray, " runs"]:
        """Fates of the cells of each run."""
        return fates_of(self.label).astype(np.int8)

    @property
    def attractor(self) -> Int[np.ndarray, " runs"]:
        """Attractors of the cells of each run; -1 for none."""
        return attractors_of(self.label).astype(np.int32)

    def of_cells(self, cells: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
        """Return the numbers of the runs that cells are in."""
        return np.searchsorted(self.first, cells, "right") - 1

    def levels_of(self, cells: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the level on which each cell, or the one it inherited from, was followed."""
        return self.level[self.of_cells(cells)]

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Return an array over the grid with the value of each run in all of its cells."""
        return np.repeat(values, self.lengths).reshape(self.shape)

    def with_cells(
        self, cells: Int[np.ndarray, " n"], label: Int[np.ndarray, " n"], level: int
    ) -> "Runs":
        """Return the runs after some cells, in ascending order, were followed on a level."""
        ends = cells[cells + 1 < self.size] + 1
        first = merge([self.first, cells, ends])
        before, place = self.of_cells(first), np.searchsorted(first, cells)
        labels, levels = self.label[before], self.level[before]
        labels[place], levels[place] = label, level
        return join_runs(self.shape, first, labels, levels)

    def subdivide(self) -> "Runs":
        """Return the runs of the cells halved along each axis."""
        shape = tuple(2 * count for count in self.shape)
        places = 2 * np.stack(np.unravel_index(self.first, self.shape))
        steps = np.indices((*[2] * (len(shape) - 1), 1)).reshape(len(shape), -1)
        parts = places[:, None] + steps[:, :, None]
        first = flat_index(parts, shape).ravel()
        order = np.argsort(first, kind="stable")
        run = order % len(self.first)
        return Runs(shape, first[order], self.label[run], self.level[run])

    def count_levels(self, levels: int) -> Int[np.ndarray, " levels"]:
        """Count the cells that were followed on each of the first levels."""
        counts = [self.lengths[self.level == level].sum() for level in range(levels)]
        return np.array(counts, int)

    def count_at_border(self, chosen: Bool[np.ndarray, " runs"]) -> int:
        """Count the cells of some runs that are at the border of the grid."""
        *places, begins = np.unravel_index(self.first[chosen], self.shape)
        lengths = self.lengths[chosen]
        ends = 1 * (begins == 0) + (begins + lengths == self.shape[-1])
        outer = np.zeros(len(begins), bool)
        for place, count in zip(places, self.shape, strict=False):
            outer |= (place == 0) | (place == count - 1)
        return int(np.where(outer, lengths, np.minimum(ends, lengths)).sum())

    def cells_of_level(self, level: int, number: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the cells of a level with given ranks, from 0 on, in ascending order of cells."""
        own = np.flatnonzero(self.level == level)
        ends = np.cumsum(self.lengths[own])
        place = np.searchsorted(ends, number, "right")
        return self.first[own[place]] + self.lengths[own[place]] - (ends[place] - number)


def merge(sequences: Sequence[Int[np.ndarray, "..."]]) -> Int[np.ndarray, " n"]:
    """Merge sequences of numbers, each in about ascending order; each number is kept once.

    A stable sort profits from that order: it is a hundred times as fast as `np.unique`.
    """
    numbers = np.sort(np.concatenate(sequences), kind="stable")
    return numbers[np.diff(numbers, prepend=-1) > 0]


def join_runs(
    shape: tuple[int, ...],
    first: Int[np.ndarray, " n"],
    label: Int[np.ndarray, " n"],
    level: Int[np.ndarray, " n"],
) -> Runs:
    """Join equal runs in the same row."""
    begins = first % shape[-1] == 0
    begins[1:] |= (label[1:] != label[:-1]) | (level[1:] != level[:-1])
    return Runs(shape, first[begins], label[begins].astype(np.int32), level[begins].astype(np.int8))


def label_of(
    fate: Int[np.ndarray, "*n"], attractor: Int[np.ndarray, "*n"]
) -> Int[np.ndarray, "*n"]:
    """Return one number for the fate and the attractor of each cell; attractor -1 means none."""
    return np.where(attractor >= 0, OUTCOMES + attractor, fate)


def fates_of(label: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """Return the fates of labels."""
    return np.where(label < OUTCOMES, label, int(Outcome.STRIDE))


def attractors_of(label: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """Return the attractors of labels; -1 for none."""
    return np.where(label < OUTCOMES, -1, label - OUTCOMES)


def labels_among(label: Int[np.ndarray, "*n"]) -> Int[np.ndarray, " labels"]:
    """Return the labels that occur: those with attractors first, then the fates."""
    found = np.unique(label)
    return np.roll(found, np.count_nonzero(found >= OUTCOMES))


def neighbours(
    cells: Int[np.ndarray, " n"], shape: tuple[int, ...]
) -> Iterator[Int[np.ndarray, " n"]]:
    """Yield the neighbours of cells in each direction, corners included, within the border."""
    places = np.unravel_index(cells, shape)
    for step in np.ndindex((3,) * len(shape)):
        if step != (1,) * len(shape):
            beside = [place + one - 1 for place, one in zip(places, step, strict=True)]
            yield flat_index(beside, shape)


def flat_index(
    places: Sequence[Int[np.ndarray, "..."]] | Int[np.ndarray, "..."], shape: tuple[int, ...]
) -> Int[np.ndarray, "..."]:
    """Return the numbers of the cells at places on each axis, moved to the border if beyond it."""
    return np.asarray(np.ravel_multi_index(tuple(places), shape, mode="clip"))
