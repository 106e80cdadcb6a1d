"""Fates of boxes of starts, proved by following the boxes from stride to stride.

Plain walks of a few starts of each box suggest the fate to prove; no proof rests on the guess. A
box walks if strides lead all of it into the trap or into cells that walk. None of it walks if all
of it falls or comes into cells that fall. If some of its starts strike and others may fall, those
that strike are followed further.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Index
from walker_jax.proofs.boxes import TRAPPED, Boxes, Trap, carry, carry_partly
from walker_jax.proofs.landings import PARTLY
from walker_jax.proofs.strides import FALL, STRIDE, UNDECIDED
from walker_jax.systems.outcomes import Outcome
from walker_jax.walking.iteration import strides as plain_strides

SAMPLES = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]])
"""Places of the sampled starts in a box, in units of half its sides."""


class Fates(NamedTuple):
    """Proved fates of boxes."""

    fates: Int[np.ndarray, " boxes"]
    """`WALKS`, `FALLS`, or `OPEN` if neither is proved."""
    strides: Int[np.ndarray, " boxes"]
    """Number of verified strides of each, until its fate was proved or it was given up."""

    def first(self, count: int) -> "Fates":
        """Return the fates of the first `count` boxes."""
        return Fates(self.fates[:count], self.strides[:count])


def guess_fates(walker, boxes: Boxes, trap: Trap, most: int) -> Int[np.ndarray, " boxes"]:
    """Guess the fate of each box: the one that a few of its starts share, else `OPEN`."""
    sides = np.einsum("nij,sj->nsi", boxes.terms[:, :, 1:], SAMPLES)
    x = (boxes.terms[:, None, :, 0] + sides).reshape(-1, 2)
    fates, active = np.full(len(x), OPEN, np.int8), np.arange(len(x))
    for _ in range(most):
        if not len(active):
            break
        found = plain_strides(walker, x)
        x, goes = np.asarray(found.state), np.asarray(found.outcome) == Outcome.STRIDE
        trapped = goes & (np.linalg.norm((x - trap.centre) @ trap.factor, axis=1) < trap.size)
        fates[active[~goes]], fates[active[trapped]] = FALLS, WALKS
        active, x = active[goes & ~trapped], x[goes & ~trapped]
    of_box = fates.reshape(-1, len(SAMPLES))
    return np.where(np.all(of_box == of_box[:, :1], axis=1), of_box[:, 0], OPEN).astype(np.int8)


def follow_boxes(walker, boxes: Boxes, trap: Trap, index: Index, most: int) -> Fates:
    """Prove the fates of boxes in at most `most` strides; `index` has the cells proved before."""
    guesses = guess_fates(walker, boxes, trap, most)
    fates, strides = np.full_like(guesses, OPEN), np.zeros(boxes.count, np.int32)
    active = np.flatnonzero(guesses != OPEN)
    boxes = boxes.at(active)
    for stride in range(1, most + 1):
        if not len(active):
            break
        strides[active] = stride
        boxes, goes, done = follow_once(walker, boxes, guesses[active], trap, index)
        fates[active[done]] = guesses[active[done]]
        active, boxes = active[goes], boxes.at(goes)
    return Fates(fates, strides)


def follow_once(
    walker, boxes: Boxes, guesses: Int[np.ndarray, " boxes"], trap: Trap, index: Index
) -> tuple[Boxes, np.ndarray, np.ndarray]:
    """Carry boxes through one stride.

    A box that is guessed to walk has to make each stride with all of its starts.

    **Returns** the boxes after the stride, flags of those that go on, and flags of those whose
    guessed fate is proved.
    """
    found, falls = carry(walker, boxes, trap), guesses == FALLS
    verdicts = found.verdicts
    unclear = np.flatnonzero(falls & (verdicts == UNDECIDED))
    if len(unclear):
        partly = carry_partly(walker, boxes.at(unclear))
        verdicts[unclear] = partly.verdicts
        for all_, some in zip(found.boxes, partly.boxes, strict=True):
            all_[unclear] = some
    goes = (verdicts == STRIDE) | (falls & (verdicts == PARTLY))
    done = np.where(falls, verdicts == FALL, verdicts == TRAPPED)
    for fate in (WALKS, FALLS):
        places = np.flatnonzero(goes & (guesses == fate))
        done[places] |= index.holds(fate, found.boxes.at(places))
    return found.boxes, goes & ~done, done
