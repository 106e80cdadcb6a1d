"""Starts that walk for ever, or fall, by proof: cells are carried until they do, and split if not.

A cell walks if strides lead all of it into a trap, and falls if all of it falls at one stride. One
of which neither is proved, as it is too wide or on a boundary, is split in four, level by level.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.proofs.boxes import TRAPPED, Boxes, Trap, boxes_of, carry, sides
from walker_jax.proofs.enclosures import exactly
from walker_jax.proofs.strides import FALL, STRIDE

WALKS, FALLS, OPEN = 1, -1, 0
"""Fates of cells, by proof; `OPEN`: neither is proved."""
WIDEST = 0.02
"""Half the side of a box from which on it is split rather than carried."""
OVERLAP = 1e-10
"""Cells are taken larger by this part, and by the rounding of their corners."""


class Window(NamedTuple):
    """Cells of the section: x = shear w, for w in a box that is cut along both axes."""

    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]
    counts: tuple[int, int]
    shear: Float[np.ndarray, "2 2"]

    def widths(self, level: int) -> Float[np.ndarray, " 2"]:
        """Sides of cells that were split `level` times."""
        return (self.high - self.low) / (np.asarray(self.counts) * 2**level)

    def area(self, level: int) -> float:
        """The area of one cell."""
        return float(np.prod(self.widths(level)) * abs(np.linalg.det(self.shear)))

    def centres(self, level: int, cells: Int[np.ndarray, "cells 2"]) -> np.ndarray:
        return self.low + self.widths(level) * (cells + 0.5)

    def boxes(self, level: int, cells: Int[np.ndarray, "cells 2"]) -> Boxes:
        """Boxes that hold the cells."""
        rounding = 8 * 2.0**-53 * (np.abs(self.low) + np.abs(self.high))
        half = self.widths(level) / 2 * (1 + OVERLAP) + rounding
        w = sides(self.centres(level, cells).T, np.broadcast_to(half, cells.shape).T)
        number = lambda value: exactly(np.float64(value), w[0].space)
        theta, thetadot = (number(p) * w[0] + number(q) * w[1] for p, q in self.shear)
        return boxes_of(theta, thetadot)


class Cells(NamedTuple):
    """Cells of one level with their fates."""

    level: int
    cells: Int[np.ndarray, "cells 2"]
    fates: Int[np.ndarray, " cells"]
    strides: Int[np.ndarray, " cells"]
    """Made before the trap, or the fall."""


def follow_cells(
    walker, window: Window, level: int, cells: Int[np.ndarray, "cells 2"], trap: Trap, most: int
) -> Cells:
    """The fates of cells, after up to some number of strides."""
    fates = np.full(len(cells), OPEN, np.int8)
    strides = np.zeros(len(cells), np.int32)
    active, boxes = np.arange(len(cells)), window.boxes(level, cells)
    for stride in range(1, most + 1):
        if not len(active):
            break
        found = carry(walker, boxes, trap, widest=WIDEST)
        fates[active[found.verdicts == TRAPPED]] = WALKS
        fates[active[found.verdicts == FALL]] = FALLS
        strides[active] = stride
        going = found.verdicts == STRIDE
        active, boxes = active[going], found.boxes.at(going)
    return Cells(level, cells, fates, strides)


def children(cells: Int[np.ndarray, "cells 2"]) -> Int[np.ndarray, "more 2"]:
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    return (2 * cells[:, None] + corners).reshape(-1, 2)


def subdivide(
    walker,
    window: Window,
    trap: Trap,
    *,
    levels: int,
    strides: int,
    wanted: Callable[[int, np.ndarray], Bool[np.ndarray, " cells"]] | None = None,
    report: Callable[[Cells], None] = lambda found: None,
) -> list[Cells]:
    """The proved fates of a window's cells, level by level; those of the last are left open.

    Cells that are not `wanted` are left out.
    """
    found, cells = [], np.indices(window.counts).reshape(2, -1).T
    for level in range(levels + 1):
        cells = cells if wanted is None else cells[wanted(level, cells)]
        last = follow_cells(walker, window, level, cells, trap, strides)
        found.append(last)
        report(last)
        cells = children(cells[last.fates == OPEN])
        if not len(cells):
            break
    return found
