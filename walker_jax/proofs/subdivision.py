"""Starts that walk for ever, or fall, by proof: cells are carried until they do, and split if not.

A cell of which neither is proved, as it is too wide or on a boundary, is split in four, level by
level. What is proved of the cells of a level is known to those of the next.
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
"""Cells that are followed together."""


Keep = Callable[[int, int, Callable[[], Fates]], Fates]
"""From a level, the number of a batch there, and a function that finds its fates, to these."""


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
    keep: Keep = lambda level, number, find: find(),
    progress: bool = False,
) -> list[Cells]:
    """The proved fates of a window's cells, level by level; those of the last are left open.

    **Arguments:**

    - `wanted`: cells that are not are left out.
    - `keep`: returns the fates of a batch, which it keeps, or has kept.
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
        found.append(Cells(level, cells, *joined))
        atlas = atlas.entered(level, cells, joined.fates)
        cells = children(cells[joined.fates == OPEN])
        if not len(cells):
            break
    return found
