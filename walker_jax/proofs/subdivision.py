"""Starts that walk for ever, or fall, by proof: cells are carried until they do, and split if not.

A cell of which neither is proved, as it is too wide or on a boundary, is split in four, level by
level. What is proved of the cells of a level is known to those of the next.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.proofs.atlas import OPEN, Atlas, Index, Window
from walker_jax.proofs.boxes import Trap
from walker_jax.proofs.following import Fates, follow_boxes

BATCH = 2**16
"""Cells that are followed together."""


class Cells(NamedTuple):
    """Cells of one level with their fates."""

    level: int
    cells: Int[np.ndarray, "cells 2"]
    fates: Int[np.ndarray, " cells"]
    strides: Int[np.ndarray, " cells"]
    """Verified strides of each."""


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
    batch: Callable[[int, int, int, Callable[[], Fates]], Fates] = lambda level, number, of, find: (
        find()
    ),
) -> list[Cells]:
    """The proved fates of a window's cells, level by level; those of the last are left open.

    **Arguments:**

    - `wanted`: cells that are not are left out.
    - `batch`: from a level, the number of a batch there, how many it has, and a function that finds
      the fates of its cells, to these; so they may be kept.
    """
    found, cells = [], np.indices(window.counts).reshape(2, -1).T
    atlas = Atlas.empty(window)
    for level in range(levels + 1):
        cells = cells if wanted is None else cells[wanted(level, cells)]
        index, parts = Index(atlas), np.split(cells, range(BATCH, len(cells), BATCH))
        fates = [
            batch(
                level,
                i,
                len(parts),
                lambda: follow_boxes(walker, window.boxes(level, part), trap, index, strides),
            )
            for i, part in enumerate(parts)
        ]
        joined = Fates(*(np.concatenate(one) for one in zip(*fates, strict=True)))
        found.append(Cells(level, cells, *joined))
        atlas = atlas.entered(level, cells, joined.fates)
        cells = children(cells[joined.fates == OPEN])
        if not len(cells):
            break
    return found
