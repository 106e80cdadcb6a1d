"""Fates of boxes of starts, proved by carrying them from stride to stride.

Which fate to prove is guessed from plain walks of a few starts of each box; nothing rests on it.
A box walks if strides lead all of it into the trap, or into cells that walk. None of it walks if
all of it falls, or comes into cells that fall; where some of its starts strike and others may fall,
those that strike are carried on.
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
"""Places in a box of the starts that the guess is from."""


class Fates(NamedTuple):
    """Fates of boxes, as far as they are proved."""

    fates: Int[np.ndarray, " boxes"]
    strides: Int[np.ndarray, " boxes"]
    """Verified strides of each, before its fate was known or it was given up."""

    def first(self, count: int) -> "Fates":
        """Fates of the first boxes."""
        return Fates(self.fates[:count], self.strides[:count])


def guess_fates(walker, boxes: Boxes, trap: Trap, most: int) -> Int[np.ndarray, " boxes"]:
    """The fate that a few starts of each box share, `OPEN` if they share none; not proved."""
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
    """The fates of boxes, after up to some number of strides; `index` has what is known."""
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
    """Boxes after a stride, which of them go on, and of which the fate that was guessed is proved.

    Of a box that may walk, all of it has to make each stride.
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
