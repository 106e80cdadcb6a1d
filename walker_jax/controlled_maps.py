"""Cell maps with a choice: where each of several actions leads from each cell.

As in `cellmaps`, cells of a grid are numbered 0 ... n - 1, and what leads off the grid, or fails,
leads to a sink, n + s for the one with the code s. But a cell has a row of images here, one for
each action. Cells from which some choice of actions stays on the grid for ever are the *viability
kernel* (Aubin 1991, Viability Theory, Birkhauser). Cells from which some choice leads into a target
are its *capture basin*.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8, Int32

from walker_jax.grids import CELLS_PER_PART


class Points(NamedTuple):
    """Images that are cells: those of the cells' centres."""

    image: Int32[np.ndarray, "n m"]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of cells and of actions."""
        n, m = self.image.shape
        return n, m

    def table(self, chosen: Bool[np.ndarray, " n"]) -> Any:
        """A choice of cells in the form that `within` reads."""
        return np.append(chosen, False)

    def within(self, table: Any, cells: Int[np.ndarray, " k"], actions: Any) -> Any:
        """Whether the choice holds the images of cells by actions: by one for each cell, of shape
        (k,), or by all for `slice(None)`, of shape (k, m)."""
        return table[np.minimum(self.image[cells, actions], len(table) - 1)]


class Boxes(NamedTuple):
    """Images that are boxes of cells, for bounds on what cells do as a whole.

    With `every`, a choice holds an image if it holds all of its cells: if boxes hold all that cells
    do, a viable cell is then viable from each of its points. Otherwise it holds an image if it
    holds one of its cells: a cell that is not viable is then viable from none of its points.
    """

    low: Int[np.ndarray, "n m d"]
    """First place of the box on each axis of the grid."""
    high: Int[np.ndarray, "n m d"]
    """The last one."""
    valid: Bool[np.ndarray, "n m"]
    """Whether there is an image."""
    counts: tuple[int, ...]
    """Cells along each axis."""
    every: bool

    @property
    def shape(self) -> tuple[int, int]:
        n, m = self.valid.shape
        return n, m

    def table(self, chosen):
        """How many cells are chosen before each place, along all axes: a summed-area table."""
        table = np.zeros([count + 1 for count in self.counts], np.int32)
        inner = (slice(1, None),) * len(self.counts)
        table[inner] = chosen.reshape(self.counts)
        for axis in range(len(self.counts)):
            np.cumsum(table, axis=axis, out=table)
        return table.ravel()

    def within(self, table, cells, actions):
        low, high = self.low[cells, actions], self.high[cells, actions]
        strides = np.ones(len(self.counts), np.int64)
        strides[:-1] = np.cumprod(np.array(self.counts[:0:-1]) + 1)[::-1]
        found, size = np.int32(0), np.int64(1)
        for corner in range(2 ** len(self.counts)):
            place, sign = 0, 1
            for axis, stride in enumerate(strides):
                upper = corner >> axis & 1
                ends = high[..., axis].astype(np.int64) + 1 if upper else low[..., axis]
                place, sign = place + stride * ends, sign * (1 if upper else -1)
            found = found + sign * table[place]
        for axis in range(len(self.counts)):
            size = size * (high[..., axis].astype(np.int64) - low[..., axis] + 1)
        return self.valid[cells, actions] & (found == size if self.every else found > 0)


Images = Points | Boxes


def find_viable(
    images: Images,
    cells: Int[np.ndarray, " n"] | None = None,
    alive: Bool[np.ndarray, " all"] | None = None,
) -> Int32[np.ndarray, " n"]:
    """The viability kernel: how many steps each cell can make at most; -1 where for ever.

    Each round removes the cells that no action takes to a cell that is left. A cell keeps a
    witness, an action that does, and the others are tried only when the witness fails. All cells
    have images, or only some of those `alive` at first: the others of these stay.
    """
    n, m = images.shape
    lasting = np.full(n, -1, np.int32)
    witness = np.zeros(n, np.int32)
    cells = np.arange(n) if cells is None else cells
    alive = np.ones(n, bool) if alive is None else alive.copy()
    left, steps = np.arange(n), 0
    while True:
        table, lost = images.table(alive), []
        for rows in parts(left, 1):
            lost.append(rows[~images.within(table, rows, witness[rows])])
        dead = []
        for rows in parts(np.concatenate(lost), m):
            safe = images.within(table, rows, slice(None))
            some = safe.any(axis=1)
            witness[rows[some]] = safe[some].argmax(axis=1)
            dead.append(rows[~some])
        ended = np.concatenate(dead)
        if not len(ended):
            return lasting
        lasting[ended], alive[cells[ended]] = steps, False
        left, steps = left[lasting[left] < 0], steps + 1


def count_safe(images: Images, viable: Bool[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """By how many actions each viable cell stays viable; 0 for others."""
    table, count = images.table(viable), np.zeros(len(viable), np.int32)
    for cells in parts(np.flatnonzero(viable), images.shape[1]):
        count[cells] = images.within(table, cells, slice(None)).sum(axis=1)
    return count


def find_capture(images: Images, target: Bool[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """The capture basin of a target: the fewest steps into it, 0 within it; -1 for none."""
    m = images.shape[1]
    steps = np.where(target, 0, -1).astype(np.int32)
    left, made = np.flatnonzero(~target), 0
    while True:
        table, made, captured = images.table(steps >= 0), made + 1, []
        for cells in parts(left, m):
            leads = images.within(table, cells, slice(None))
            captured.append(cells[leads.any(axis=1)])
        new = np.concatenate(captured)
        if not len(new):
            return steps
        steps[new] = made
        left = left[steps[left] < 0]


def best_action(points: Points, value: Int[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """The action that leads to the cell of the greatest value; -1 where none is positive."""
    n, m = points.shape
    best, action = np.append(value, 0), np.full(n, -1, np.int32)
    for cells in parts(np.arange(n), m):
        values = best[np.minimum(points.image[cells], n)]
        chosen = values.argmax(axis=1)
        action[cells] = np.where(values.max(axis=1) > 0, chosen, -1)
    return action


def unavoidable_failure(points: Points, lasting: Int32[np.ndarray, " n"]) -> Int8[np.ndarray, " n"]:
    """The sink in which the longest walk from a cell ends; 0 for viable cells.

    If several actions make as many steps, the first counts; if none makes a step, the sink to which
    most actions lead.
    """
    n, m = points.shape
    failure, most = np.zeros(n, np.int8), int(lasting.max(initial=-1))
    for cells in parts(np.flatnonzero(lasting == 0), m):
        sinks = points.image[cells] - n
        votes = [(sinks == code).sum(axis=1) for code in range(max(1, sinks.max(initial=0)) + 1)]
        failure[cells] = np.argmax(votes, axis=0)
    for steps in range(1, most + 1):
        for cells in parts(np.flatnonzero(lasting == steps), m):
            image = np.minimum(points.image[cells], n)
            longest = (np.append(lasting, -1)[image] == steps - 1) & (image < n)
            following = image[np.arange(len(cells)), longest.argmax(axis=1)]
            failure[cells] = failure[following]
    return failure


def parts(cells: Int[np.ndarray, " n"], actions: int) -> Iterator[Int[np.ndarray, " k"]]:
    """Cells in parts whose images stay in the cache; one at least."""
    size = max(1, 4 * CELLS_PER_PART // actions)
    for start in range(0, max(1, len(cells)), size):
        yield cells[start : start + size]
