"""Atlas of the cells of a window whose fates are proved, in which later boxes may end.

A box in cells that all walk walks too, and one in cells that all fall falls. There is no need to
follow it to the trap, or until it has fallen.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.proofs.boxes import Boxes, boxes_of, upright_boxes
from walker_jax.proofs.enclosures import exactly

WALKS, FALLS, OPEN = 1, -1, 0
"""Proved fates. `WALKS`: all starts walk for ever; `FALLS`: none does; `OPEN`: neither proved."""
CELL_ROUNDING = 8 * 2.0**-53
"""Bound on the rounding of a cell's edges, over the size of the window's."""
OVERLAP = 1e-10
"""Relative amount by which cells are enlarged, beside the rounding of their corners."""
MOST_CELLS = 2**25
"""Limit of the cells of an atlas; finer levels are left out."""
SLICES = 8
"""Number of slices of a box along its longer side; each is looked up by an upright rectangle about
it."""
MARGIN = 1e-6
"""Part of a cell by which rectangles are enlarged, for rounding."""


class Window(NamedTuple):
    """Window of the section in cells: x = shear w, for w in a box that is cut along both axes."""

    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]
    counts: tuple[int, int]
    shear: Float[np.ndarray, "2 2"]

    def widths(self, level: int) -> Float[np.ndarray, " 2"]:
        """Return the sides of cells that were split `level` times."""
        return (self.high - self.low) / (np.asarray(self.counts) * 2**level)

    def area(self, level: int) -> float:
        """Return the area of one cell."""
        (a, b), (c, d) = ([Fraction(float(one)) for one in row] for row in self.shear)
        return float(np.prod(self.widths(level))) * abs(float(a * d - b * c))

    def centres(self, level: int, cells: Int[np.ndarray, "cells 2"]) -> np.ndarray:
        return self.low + self.widths(level) * (cells + 0.5)

    def boxes(self, level: int, cells: Int[np.ndarray, "cells 2"]) -> Boxes:
        """Return boxes that hold the cells."""
        rounding = CELL_ROUNDING * (np.abs(self.low) + np.abs(self.high))
        half = self.widths(level) / 2 * (1 + OVERLAP) + rounding
        w = upright_boxes(self.centres(level, cells).T, np.broadcast_to(half, cells.shape).T)
        exact = lambda value: exactly(np.float64(value), w[0].space)
        theta, thetadot = (exact(p) * w[0] + exact(q) * w[1] for p, q in self.shear)
        return boxes_of(theta, thetadot)


class Atlas(NamedTuple):
    """Fates of a window's cells at one level."""

    window: Window
    level: int
    fates: Int[np.ndarray, "columns rows"]

    @classmethod
    def empty(cls, window: Window) -> "Atlas":
        """Return an atlas in which nothing is proved."""
        return cls(window, 0, np.full(window.counts, OPEN, np.int8))

    def with_fates(
        self, level: int, cells: Int[np.ndarray, "cells 2"], fates: Int[np.ndarray, " cells"]
    ) -> "Atlas":
        """Return an atlas with the fates of further cells of its level or the next.

        It is unchanged if the next level has too many cells.
        """
        known = self.fates
        if level > self.level and 4 * known.size > MOST_CELLS:
            return self
        known = known.copy() if level == self.level else known.repeat(2, 0).repeat(2, 1)
        known[cells[:, 0], cells[:, 1]] = fates
        return Atlas(self.window, level, known)


class Index:
    """Index that looks up boxes in an atlas, by sums over rectangles of its cells."""

    def __init__(self, atlas: Atlas):
        window, self.shape = atlas.window, np.array(atlas.fates.shape)
        self.low, self.width = window.low, window.widths(atlas.level)
        self.inverse = np.linalg.inv(window.shear)
        # The computed inverse W of the shear S is not exact: w = W x + (1 - W S) w.
        off = np.abs(self.inverse @ window.shear - np.eye(2)).max()
        sizes = (np.abs(self.inverse) @ np.abs(window.shear)).max()
        rough = off + 32 * 2.0**-53 * (1 + sizes)
        reach = np.max(np.abs(window.low) + np.abs(window.high))
        self.margin = MARGIN + 4 * rough * reach / self.width
        self.sums = {fate: sums_of(atlas.fates == fate) for fate in (WALKS, FALLS)}

    def holds(self, fate: int, boxes: Boxes) -> Bool[np.ndarray, " boxes"]:
        """Return whether each box certainly lies in cells of a fate."""
        terms, places = boxes.terms, np.arange(boxes.count)
        longer = 1 + np.argmax(np.linalg.norm(terms[:, :, 1:], axis=1), axis=-1)
        along, across = terms[places, :, longer], terms[places, :, 3 - longer]
        turned = lambda x: x @ self.inverse.T
        size = np.abs(turned(along)) / SLICES + np.abs(turned(across))
        size = size + boxes.radii @ np.abs(self.inverse).T
        held = np.ones(boxes.count, bool)
        for part in (2 * np.arange(SLICES) + 1 - SLICES) / SLICES:
            held &= self.holds_rectangles(fate, turned(terms[:, :, 0] + part * along), size)
        return held

    def holds_rectangles(self, fate: int, centres: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return whether each rectangle, in coordinates w, certainly lies in cells of a fate."""
        first = np.floor((centres - size - self.low) / self.width - self.margin)
        last = np.floor((centres + size - self.low) / self.width + self.margin) + 1
        within = np.all((first >= 0) & (last <= self.shape), axis=1)
        first, last = (np.where(within[:, None], one, 0).astype(int) for one in (first, last))
        sums, cells = self.sums[fate], np.prod(last - first, axis=1)
        (a, b), (c, d) = first.T, last.T
        return within & (sums[c, d] - sums[a, d] - sums[c, b] + sums[a, b] == cells)


def sums_of(flags: Bool[np.ndarray, "columns rows"]) -> Int[np.ndarray, "columns+1 rows+1"]:
    """Return the number of true flags before each corner, along both axes."""
    sums = np.zeros((flags.shape[0] + 1, flags.shape[1] + 1), np.int32)
    np.cumsum(np.cumsum(flags, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
    return sums
