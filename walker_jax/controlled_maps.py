"""Cell maps with a choice of actions: each cell has one image for each action.

Cells of a grid are numbered 0 ... n - 1, as in `cellmaps`. An action that leads off the grid or
fails has a sink as its image, n + s for the sink with code s. The *viability kernel* is the set of
cells from which some choice of actions stays on the grid for ever (Aubin 1991, Viability Theory,
Birkhauser). The *capture basin* of a target is the set of cells from which some choice of actions
leads into it.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8, Int32

from walker_jax.grids import CELLS_PER_PART


class Points(NamedTuple):
    """Images that are single cells: the images of the cells' centres."""

    image: Int32[np.ndarray, "n m"]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of cells and of actions."""
        n, m = self.image.shape
        return n, m

    def table(self, chosen: Bool[np.ndarray, " n"]) -> Any:
        """Return a set of cells in the form that `within` reads."""
        return np.append(chosen, False)

    def within(self, table: Any, cells: Int[np.ndarray, " k"], actions: Any) -> Any:
        """Return whether the set holds the images of cells under actions.

        `actions` is one for each cell, for a result of shape (k,), or `slice(None)` for all of
        them, of shape (k, m).
        """
        return table[np.minimum(self.image[cells, actions], len(table) - 1)]


class ImageBoxes(NamedTuple):
    """Images that are boxes of cells: bounds on the image of a cell as a whole.

    With `every`, a set holds an image if it holds all cells of the box. If boxes hold the images of
    whole cells, a viable cell is then viable from each of its points. Without `every`, a set holds
    an image if it holds any cell of the box. A cell that is not viable is then viable from none of
    its points.
    """

    low: Int[np.ndarray, "n m d"]
    """First place of the box on each axis of the grid."""
    high: Int[np.ndarray, "n m d"]
    """Last place of the box on each axis."""
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
        """Return a summed-area table: the chosen cells before each place, along all axes."""
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


Images = Points | ImageBoxes


def find_viable(
    images: Images,
    cells: Int[np.ndarray, " n"] | None = None,
    alive: Bool[np.ndarray, " all"] | None = None,
) -> Int32[np.ndarray, " n"]:
    """Compute the viability kernel: the most steps each cell can make; -1 for ever.

    Each round removes the cells without an action that leads to a remaining cell. Each cell keeps
    one such action as its witness; the others are tried only when the witness fails.

    `cells` are the cells with images, by default all. Other cells of `alive` always remain.
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
    """Count the actions by which each viable cell stays viable; 0 for others."""
    table, count = images.table(viable), np.zeros(len(viable), np.int32)
    for cells in parts(np.flatnonzero(viable), images.shape[1]):
        count[cells] = images.within(table, cells, slice(None)).sum(axis=1)
    return count


def find_capture(images: Images, target: Bool[np.ndarray, " n"]) -> Int32[np.ndarray, " n"]:
    """Compute the capture basin of a target: the fewest steps into it, or -1."""
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
    """Return the action to the image of the greatest value; -1 where no value is positive."""
    n, m = points.shape
    best, action = np.append(value, 0), np.full(n, -1, np.int32)
    for cells in parts(np.arange(n), m):
        values = best[np.minimum(points.image[cells], n)]
        chosen = values.argmax(axis=1)
        action[cells] = np.where(values.max(axis=1) > 0, chosen, -1)
    return action


def unavoidable_failure(points: Points, lasting: Int32[np.ndarray, " n"]) -> Int8[np.ndarray, " n"]:
    """Return the sink in which the longest walk from a cell ends; 0 for viable cells.

    If several actions make as many steps, the first counts. If none makes a step, the sink of most
    actions counts.
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
    """Split cells into parts whose images stay in the cache; yield at least one."""
    size = max(1, 4 * CELLS_PER_PART // actions)
    for start in range(0, max(1, len(cells)), size):
        yield cells[start : start + size]
