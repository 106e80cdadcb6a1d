"""Proved fates of the cells of a window: each is followed until it walks or falls, or is split.

If neither is proved of a cell, because it is too wide or on a boundary, it is split in four, level
by level. The proofs of each level use those of the levels before.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from walker_jax.execution.progress import track
from walker_jax.proofs.atlas import OPEN, Atlas, Index, Window
from walker_jax.proofs.boxes import Trap
from walker_jax.proofs.following import Fates, follow_boxes

BATCH = 2**16
"""Number of cells that are followed together."""


KeepFates = Callable[[int, int, Callable[[], Fates]], Fates]
"""Function of a level, the number of a batch in it, and a function that finds the fates of the
batch. It returns these fates, found or stored before."""


class LevelCells(NamedTuple):
    """Cells of one level, with their fates."""

    level: int
    cells: Int[np.ndarray, "cells 2"]
    fates: Int[np.ndarray, " cells"]
    strides: Int[np.ndarray, " cells"]
    """Number of verified strides of each."""


def children(cells: Int[np.ndarray, "cells 2"]) -> Int[np.ndarray, "more 2"]:
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    return (2 * cells[:, None] + corners).reshape(-1, 2)


def prove_cells(
    walker,
    window: Window,
    trap: Trap,
    *,
    levels: int,
    strides: int,
    wanted: Callable[[int, np.ndarray], Bool[np.ndarray, " cells"]] | None = None,
    keep: KeepFates = lambda level, number, find: find(),
    progress: bool = False,
) -> list[LevelCells]:
    """Prove the fates of a window's cells, level by level; those open at the last level stay open.

    **Arguments:**

    - `wanted`: takes a level and cells of it, and returns flags; cells without one are left out.
    - `keep`: returns the fates of a batch, which it finds and stores, or has stored before.
    - `progress`: whether to show progress bars on a terminal, after a second.
    """
    found, cells = [], np.indices(window.counts).reshape(2, -1).T
    atlas = Atlas.empty(window)
    for level in range(levels + 1):
        cells = cells if wanted is None else cells[wanted(level, cells)]
        index, parts = Index(atlas), np.split(cells, range(BATCH, len(cells), BATCH))
        fates = []
        for number, part in enumerate(track(parts, f"level {level} of {levels}", progress)):
            boxes = window.boxes(level, part)
            find = partial(follow_boxes, walker, boxes, trap, index, strides)
            fates.append(keep(level, number, find).first(len(part)))
        joined = Fates(*(np.concatenate(one) for one in zip(*fates, strict=True)))
        found.append(LevelCells(level, cells, *joined))
        atlas = atlas.with_fates(level, cells, joined.fates)
        cells = children(cells[joined.fates == OPEN])
        if not len(cells):
            break
    return found
