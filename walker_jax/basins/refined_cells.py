"""The cells of ever finer grids: only cells on a boundary are followed.

All other cells inherit the label of the cell that they are part of. Memory holds only the runs of
equal labels and the cells followed on the last level. So memory grows with the boundary, in two
dimensions as in three.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from walker_jax.basins.attractor_search import label_and_find
from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.runs import Runs, flat_index, merge, neighbours
from walker_jax.checks import check_memory
from walker_jax.grids import Grid, edge

BYTES_PER_FOLLOWED_CELL = 150
"""Peak memory in bytes, for each cell followed on one level (benchmarks/volumes.py)."""
CELLS_TOGETHER = 2**21
"""Cells followed in one call, which bounds the memory of their states."""

SPREAD = 1 / 12
"""Variance, in cells, that a cell beside one of another fate adds to the area if it is not
measured. A cell of which a part f is in the basin adds f (1 - f), 1/6 on average; at least half of
these cells lie on one side only. The value holds for a line; where a boundary fills cells the
variance may be three times as large. For the simplest walker it is 0.06 to 0.094, at slopes from
0.004 to 0.0165."""
REDRAWN = 20_000
"""Most starts from which the variance of the followed cells is measured. Its root scattered by 1 to
3 % over seeds, in two dimensions and in three."""


class RefinedCells:
    """The labels of all cells of ever finer grids, and the level that each was followed on."""

    def __init__(
        self,
        grid: Grid,
        levels: int,
        by_centres: bool,
        mapper: Mapper,
        rng: np.random.Generator,
        progress: str | None,
    ):
        """On the finest level, `by_centres` gives cells the labels of their centres."""
        self.grid, self.levels, self.by_centres = grid, levels, by_centres
        self.mapper, self.rng, self.progress = mapper, rng, progress
        self.total_strides = 0
        none = np.full(grid.shape, -1)
        self.runs = Runs.from_cells(none, none)
        self.cells, self.strides = np.zeros(0, int), np.zeros(0, np.int32)

    @property
    def follows_all(self) -> bool:
        """Whether all cells of this level were followed."""
        return len(self.cells) == self.runs.size

    def random_places(self, count: int) -> Float[np.ndarray, "n axes"]:
        """Draw random places within cells, from 0 to 1 along each axis."""
        return self.rng.uniform(size=(count, len(self.runs.shape)))

    def map(
        self, cells: Int[np.ndarray, " n"], within: Float[np.ndarray, "n axes"] | None = None
    ) -> Label:
        """Label cells by points at some places within them, or by their centres.

        Attractors that are new are found.
        """
        parts = []
        for first in range(0, max(1, len(cells)), CELLS_TOGETHER):
            part = slice(first, first + CELLS_TOGETHER)
            places = np.stack(np.unravel_index(cells[part], self.runs.shape), axis=1)
            places = places + (0.5 if within is None else within[part])
            x = self.grid.points_at(places / np.array(self.runs.shape))
            labels, self.mapper, made = label_and_find(
                self.mapper, x, boxes=True, progress=self.progress
            )
            self.total_strides += made
            parts.append(labels._replace(state=labels.state[:0]))  # the states are not needed
        return Label(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def follow_levels(self) -> tuple[list[int], list[int]]:
        """Follow all levels; return the number of cells followed on each, and on the boundary."""
        followed, boundary, cells = [], [], np.arange(self.grid.size)
        for level in range(self.levels + 1):
            if level:
                self.runs = self.runs.subdivide()
                self.cells, self.strides = self.cells[:0], self.strides[:0]
                cells = self.children(cells)
            self.follow(level, cells)
            cells = self.cells[self.on_boundary(self.runs.label)]
            followed.append(len(self.cells))
            boundary.append(len(cells))
        return followed, boundary

    def follow(self, level: int, cells: Int[np.ndarray, " n"]) -> None:
        """Follow cells, then their neighbours where labels differ, until no new boundary shows."""
        while cells.size:
            check_level(self.levels, level, len(self.cells) + len(cells), BYTES_PER_FOLLOWED_CELL)
            anywhere = level == self.levels and not self.by_centres
            found = self.map(cells, self.random_places(len(cells)) if anywhere else None)
            self.runs = self.runs.with_cells(cells, found.number, level)
            order = np.argsort(np.concatenate([self.cells, cells]), kind="stable")
            self.cells = np.concatenate([self.cells, cells])[order]
            self.strides = np.concatenate([self.strides, found.strides])[order]
            if self.follows_all:
                return
            own, unlike = self.runs.label[self.runs.of_cells(cells)], [np.zeros(0, int)]
            for beside in neighbours(cells, self.runs.shape):
                run = self.runs.of_cells(beside)
                met = (self.runs.label[run] != own) & (self.runs.level[run] < level)
                unlike.append(beside[met])
            cells = merge(unlike)

    def on_boundary(self, values: Shaped[np.ndarray, " runs"]) -> Bool[np.ndarray, " n"]:
        """Mark the cells followed on this level that have a neighbour in a run of another value.

        Other cells have no such neighbour: where labels differ, both cells have been followed.
        """
        if self.follows_all:
            return edge(self.runs.spread(values)).ravel()
        own, found = values[self.runs.of_cells(self.cells)], np.zeros(len(self.cells), bool)
        for beside in neighbours(self.cells, self.runs.shape):
            found |= values[self.runs.of_cells(beside)] != own
        return found

    def children(self, cells: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
        """Return the parts of cells of the level before, in ascending order."""
        shape = self.runs.shape
        places = 2 * np.stack(np.unravel_index(cells, tuple(count // 2 for count in shape)))
        steps = np.indices((2,) * len(shape)).reshape(len(shape), -1)
        parts = places[:, None] + steps[:, :, None]
        return np.sort(flat_index(parts, shape), axis=None, kind="stable")

    def inherited(self) -> Float[np.ndarray, " levels"]:
        """Count the cells that inherited their labels from each level."""
        return self.runs.count_levels(self.levels).astype(float)

    def compare(
        self, shares: Float[np.ndarray, " levels"], check: int
    ) -> tuple[
        Int[np.ndarray, " n"],
        Int[np.ndarray, " n"],
        Bool[np.ndarray, " n"],
        Int[np.ndarray, " levels"],
    ]:
        """Compare random points in cells that inherited with the labels of these cells.

        Returns the cells, in ascending order; 1 where only the point walks, -1 where only the cell
        does, else 0; whether their attractors differ; and the number of cells from each level.
        """
        counts = np.floor(check * shares / max(shares.sum(), 1)).astype(int)
        counts = np.maximum(counts, (shares > 0) & (check > 0))
        sizes = self.runs.count_levels(self.levels)
        drawn = [
            self.runs.cells_of_level(level, self.rng.integers(0, size, n))
            for level, (size, n) in enumerate(zip(sizes, counts, strict=True))
            if n
        ]
        cells = np.concatenate([np.zeros(0, int), *drawn])
        within, order = self.random_places(len(cells)), np.argsort(cells)
        cells = cells[order]  # neighbours make about as many strides
        points = self.map(cells, within[order]).attractor
        own = self.runs.attractor[self.runs.of_cells(cells)]
        return cells, (points >= 0).astype(int) - (own >= 0), points != own, counts

    def measure_variance(self, count: int) -> float:
        """Estimate the variance of the number of walking cells: the sum of f (1 - f).

        The term f (1 - f) is half the chance that two points of a cell differ. One point gave the
        cell its label; a second one is drawn in some cells. If none is drawn, each cell on the
        boundary has `SPREAD`.
        """
        walks = self.runs.attractor >= 0
        if count == 0 or len(self.cells) == 0:
            return SPREAD * np.count_nonzero(self.on_boundary(walks))
        drawn = np.sort(self.rng.choice(self.cells, count))
        points_walk = self.map(drawn, self.random_places(count)).converged
        differ = np.count_nonzero(points_walk != walks[self.runs.of_cells(drawn)])
        # One more counts as different than was found, so that a lack of differences is not
        # certainty.
        return len(self.cells) * (differ + 1) / (2 * count)


def check_level(levels: int, level: int, count: int, each: int) -> None:
    """Raise `TooLarge` for a level of refinement with more cells than fit the memory."""
    subject = f"levels={levels}: level {level} follows {count} cells, which need"
    check_memory(count * each, subject, "lower levels")
