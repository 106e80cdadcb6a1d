"""An atlas: the cells of a window that are proved already, where later boxes may end.

A box that lies in cells that all walk walks too, and so does one in cells that fall: there is no
need to follow it to the trap, or to the ground.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.proofs.boxes import Boxes, boxes_of, sides
from walker_jax.proofs.enclosures import exactly

WALKS, FALLS, OPEN = 1, -1, 0
"""Fates by proof. `FALLS`: no start walks for ever; `OPEN`: neither is proved."""
OVERLAP = 1e-10
"""Cells are taken larger by this part, and by the rounding of their corners."""
MOST_CELLS = 2**25
"""Of an atlas; finer cells are not entered."""
SLICES = 8
"""Of a box, along its longer side: each is looked up by the upright rectangle about it."""
BRIM = 1e-6
"""Rectangles are taken larger by this part of a cell, for rounding."""


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
        (a, b), (c, d) = ([Fraction(float(one)) for one in row] for row in self.shear)
        return float(np.prod(self.widths(level))) * abs(float(a * d - b * c))

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


class Atlas(NamedTuple):
    """The fates of a window's cells at one level."""

    window: Window
    level: int
    fates: Int[np.ndarray, "columns rows"]

    @classmethod
    def empty(cls, window: Window) -> "Atlas":
        """Nothing is proved."""
        return cls(window, 0, np.full(window.counts, OPEN, np.int8))

    def entered(
        self, level: int, cells: Int[np.ndarray, "cells 2"], fates: Int[np.ndarray, " cells"]
    ) -> "Atlas":
        """With the cells of the same level, or of the next one where there is room for these."""
        known = self.fates
        if level > self.level and 4 * known.size > MOST_CELLS:
            return self
        known = known.copy() if level == self.level else known.repeat(2, 0).repeat(2, 1)
        known[cells[:, 0], cells[:, 1]] = fates
        return Atlas(self.window, level, known)


class Index:
    """Looks up boxes in an atlas, by sums over its rectangles."""

    def __init__(self, atlas: Atlas):
        window, self.shape = atlas.window, np.array(atlas.fates.shape)
        self.low, self.width = window.low, window.widths(atlas.level)
        self.inverse = np.linalg.inv(window.shear)
        # w = W x + (1 - W S) w, for W that is about the inverse of S
        off = np.abs(self.inverse @ window.shear - np.eye(2)).max()
        sizes = (np.abs(self.inverse) @ np.abs(window.shear)).max()
        rough = off + 32 * 2.0**-53 * (1 + sizes)
        reach = np.max(np.abs(window.low) + np.abs(window.high))
        self.brim = BRIM + 4 * rough * reach / self.width
        self.sums = {fate: sums_of(atlas.fates == fate) for fate in (WALKS, FALLS)}

    def holds(self, fate: int, boxes: Boxes) -> Bool[np.ndarray, " boxes"]:
        """Whether all of a box lies in cells of a fate, by proof."""
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
        first = np.floor((centres - size - self.low) / self.width - self.brim)
        last = np.floor((centres + size - self.low) / self.width + self.brim) + 1
        within = np.all((first >= 0) & (last <= self.shape), axis=1)
        first, last = (np.where(within[:, None], one, 0).astype(int) for one in (first, last))
        sums, cells = self.sums[fate], np.prod(last - first, axis=1)
        (a, b), (c, d) = first.T, last.T
        return within & (sums[c, d] - sums[a, d] - sums[c, b] + sums[a, b] == cells)


def sums_of(flags: Bool[np.ndarray, "columns rows"]) -> Int[np.ndarray, "columns+1 rows+1"]:
    """How many are true before each corner."""
    sums = np.zeros((flags.shape[0] + 1, flags.shape[1] + 1), np.int32)
    np.cumsum(np.cumsum(flags, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
    return sums
