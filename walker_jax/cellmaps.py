"""The simple cell map of Hsu (1987, Cell-to-Cell Mapping, Springer).

A simple cell map sends each cell to the cell that holds the image of its centre. The n cells of the
grid are numbered 0 ... n - 1. Images off the grid, and centres without an image, go to sinks, which
map to themselves: sink s has the number n + s. By convention s is the code of what went wrong; code
0 means success, so sink 0 is never used.

Indices are int32 throughout; -1 stands for none.
"""

import itertools
from array import array
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int32

from walker_jax.checks import WrongUse
from walker_jax.grids import MAX_SINKS, MAX_SIZE, Grid, cell_slices

CANDIDATE_SHARE = 2**-10
"""Share of all cells that is small enough to follow one by one."""


def cell_image(
    grid: Grid, point: Float[Array, " s"], outcome: Int[ArrayLike, ""], *, leave: int
) -> Int32[Array, ""]:
    """Return the image of a cell under the simple cell map, given what became of its centre.

    The image is the cell that holds `point` where `outcome` is 0, sink `leave` where `point` is off
    the grid or not finite, and sink `outcome` otherwise. Sink s has the index size + s.

    The function takes one cell: `jax.vmap` it over a grid, and give the result to `resolve`, with
    sinks numbered up to the greatest of the outcomes and `leave`.
    """
    outcome = jnp.asarray(outcome).astype(jnp.int32)
    cell = grid.cell(point)
    sink = jnp.where(outcome == 0, jnp.int32(leave), outcome)
    size = jnp.prod(jnp.asarray(grid.counts), dtype=jnp.int32)
    return jnp.where((outcome == 0) & (cell >= 0), cell, size + sink)


class CellMap(NamedTuple):
    """The attractor or sink that every cell of a simple cell map reaches."""

    end: Int32[np.ndarray, " n"]
    """Number of the attractor the cell converges to; -1 - s where it ends in sink s."""
    steps: Int32[np.ndarray, " n"]
    """Steps until the cell is on its attractor, 0 if it is on it; or steps before the one into a
    sink."""
    attractors: tuple[Int[np.ndarray, " _period"], ...]
    """The cells of each cycle in the order of visits, from the smallest index on. Cycles are sorted
    by period, then by their smallest index. Sinks are not among them."""

    @property
    def attractor(self) -> Int32[np.ndarray, " n"]:
        """Number of the attractor the cell converges to; -1 where it ends in a sink."""
        return np.maximum(self.end, -1)

    @property
    def sink(self) -> Int32[np.ndarray, " n"]:
        """Number of the sink the cell ends in; -1 where it converges to an attractor."""
        return np.maximum(-1 - self.end, -1)

    def part(self, cells: slice) -> "CellMap":
        """Return the rows of some of the cells."""
        return self._replace(end=self.end[cells], steps=self.steps[cells])


def resolve(image: ArrayLike, sinks: int) -> CellMap:
    """Find the attractors, basins and transients of a simple cell map.

    `image`, integers of shape (n,), holds the image of each cell: a cell 0 ... n - 1, or n + s for
    sink s. There are `sinks` sinks. Runs on the host.

    Pointers are doubled, f^(j + k) = f^j(f^k), so the number of rounds grows with the logarithm of
    the longest transient. Doubling is in place: it takes nine bytes for each cell beside the image,
    and a little more for cells of cycles. The result takes eight. Maps without attraction, such as
    permutations, are followed cell by cell.

    Raises ValueError where `image` has another form or points to a cell that does not exist.

    Source: Hsu (1987) poses the problem. His algorithm follows one sequence of cells after the
    other (Schwab and Wisse 2001, section 4.3); the results are the same.
    """
    image = np.asarray(image)
    check_image(image, sinks)
    image = image.astype(np.int32, copy=False)
    attractors = find_cycles(image, cycle_candidates(image, sinks))
    recurrent = np.concatenate([np.zeros(0, np.int32), *attractors])
    end, steps = resolve_transients(image, sinks, recurrent)

    number = np.repeat(np.arange(len(attractors)), [len(cycle) for cycle in attractors])
    order = np.argsort(recurrent)
    for part in cell_slices(image.size):
        sunk = end[part] >= image.size
        place = np.searchsorted(recurrent, np.where(sunk, 0, end[part]), sorter=order)
        reached = number[order[place]] if len(order) else -1
        end[part] = np.where(sunk, image.size - 1 - end[part], reached)
        steps[part] -= sunk
    return CellMap(end, steps, attractors)


def check_image(image: np.ndarray, sinks: Any) -> None:
    """Raise `WrongUse` unless `image` is a map of cells."""
    if image.ndim != 1 or image.size == 0 or not np.issubdtype(image.dtype, np.integer):
        raise WrongUse(
            f"image of shape {image.shape} and type {image.dtype}: must be integers of shape (n,)"
        )
    if not isinstance(sinks, int) or not 0 <= sinks <= MAX_SINKS:
        raise WrongUse(f"sinks={sinks!r}: must be 0 ... {MAX_SINKS}")
    if image.size > MAX_SIZE:
        raise WrongUse(f"image of {image.size} cells: must be at most {MAX_SIZE}")
    cells = image.size + sinks
    if image.min() < 0 or image.max() >= cells:
        cell = np.argmax((image < 0) | (image >= cells))
        raise WrongUse(f"image[{cell}]={image[cell]}: must be 0 ... {cells - 1}")


def cycle_candidates(image: Int32[np.ndarray, " n"], sinks: int) -> Bool[np.ndarray, " n"]:
    """Mark the cells that are reached after many steps; they include every cycle.

    Parts are updated in place, one after the other, so cells advance by different numbers of steps.
    That does no harm: cells of a cycle stay on it, and all others come closer to one.
    """
    n = image.size
    ahead = np.concatenate([image, np.arange(n, n + sinks, dtype=np.int32)])
    reached, count, before = np.empty(n + sinks, bool), n, 2 * n
    while count > CANDIDATE_SHARE * n and count <= before / 2:
        before = count
        reached[:] = False
        for part in cell_slices(n):
            for _ in range(2):  # marking takes as long as two steps
                ahead[part] = ahead.take(ahead[part])
            reached[ahead[part]] = True
        count = np.count_nonzero(reached[:n])
    return reached[:n]


def find_cycles(
    image: Int32[np.ndarray, " n"], starts: Bool[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " _period"], ...]:
    """Find the cycles that the starts lead to, one sequence of cells after the other."""
    following = image.data  # a memoryview, whose items are faster to read than an array's
    visited, found = bytearray(image.size), []
    numbers = ((np.flatnonzero(starts[part]) + part.start).data for part in cell_slices(image.size))
    for here in itertools.chain.from_iterable(numbers):
        sequence = array("i")
        while here < image.size and not visited[here]:
            visited[here] = True
            sequence.append(here)
            here = following[here]
        if sequence and here in sequence:
            cycle = np.array(sequence[sequence.index(here) :])
            found.append(np.roll(cycle, -cycle.argmin()))
    return tuple(sorted(found, key=lambda cycle: (len(cycle), cycle[0])))


def resolve_transients(
    image: Int32[np.ndarray, " n"], sinks: int, recurrent: Int[np.ndarray, " m"]
) -> tuple[Int32[np.ndarray, " n"], Int32[np.ndarray, " n"]]:
    """Return the first recurrent cell, or sink, that each cell reaches, and the steps to it."""
    n = image.size
    both = np.empty((n + sinks, 2), np.int32)
    both[:n, 0], both[:, 1] = image, 1
    for ends in (recurrent, np.arange(n, n + sinks)):  # they map to themselves
        both[ends, 0], both[ends, 1] = ends, 0
    pairs = both.view(np.int64)[:, 0]  # both in one read
    ahead, steps = both[:n].T

    def advance(part: slice) -> bool:
        here = ahead[part].copy()
        there = pairs.take(here).view(np.int32).reshape(-1, 2)
        there[:, 1] += steps[part]
        both[part] = there
        return not np.array_equal(there[:, 0], here)

    moving = cell_slices(n)
    while moving:
        moving = [part for part in moving if advance(part)]
    return ahead, steps
