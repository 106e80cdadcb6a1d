"""Boxes next to boundaries: all strides from them land in their enclosure."""

import numpy as np

import walker_jax as wj
from walker_jax.proofs.boxes import Boxes, Carried, carry_partly
from walker_jax.proofs.landings import PARTLY
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.strides import FALL

WALKER = wj.SimplestWalker(0.004)


def boxes_across(rng, count: int) -> Boxes:
    """Small boxes, half of them next to where starts begin to fall forward at once."""
    theta, total = rng.uniform(0.005, 0.39, count), rng.uniform(-0.04, 0.01, count)
    edge = np.array([0.002, -0.0083, -0.0179, -0.0268, -0.0345])  # from plain strides
    near = np.interp(theta, np.linspace(0, 0.4, 5), edge) + rng.normal(size=count) * 5e-4
    total = np.where(np.arange(count) % 2 == 0, near, total)
    half = rng.choice([1e-5, 1e-4, 1e-3], count)
    sides = np.stack([np.stack([half, 0 * half], -1), np.stack([-half, half / 20], -1)], -2)
    centres = np.stack([theta, total - theta], -1)
    return Boxes(np.concatenate([centres[..., None], sides], -1), np.zeros((count, 2)))


def strides_outside(boxes: Boxes, found: Carried) -> int:
    """Strides of random starts that end where their boxes say none does."""
    rng, outside = np.random.default_rng(2), 0
    known = np.flatnonzero((found.verdicts == PARTLY) | (found.verdicts == FALL))
    boxes, verdicts, new = boxes.at(known), found.verdicts[known], found.boxes.at(known)
    for _ in range(8):
        u = rng.uniform(-1, 1, (boxes.count, 2))
        x = boxes.terms[:, :, 0] + np.einsum("nij,nj->ni", boxes.terms[:, :, 1:], u)
        plain = wj.strides(WALKER, x)
        strides = np.asarray(plain.outcome) == wj.Outcome.STRIDE
        outside += np.sum(strides & (verdicts == FALL))
        off = np.asarray(plain.state) - new.terms[:, :, 0]
        with np.errstate(all="ignore"):
            matrix = np.where((verdicts == PARTLY)[:, None, None], new.terms[:, :, 1:], np.eye(2))
            place = np.linalg.solve(matrix, off[..., None])[..., 0]
        outside += np.sum(strides & (verdicts == PARTLY) & (np.abs(place).max(-1) > 1 + 1e-6))
    return outside


def test_all_strides_land_in_their_enclosures():
    """And in no part of them: so they are close, and the check can fail."""
    boxes = boxes_across(np.random.default_rng(1), 1024)
    found = carry_partly(check_provable(WALKER), boxes)
    counts = np.bincount(found.verdicts, minlength=6)
    assert strides_outside(boxes, found) == 0
    assert counts[PARTLY] > 300 and counts[FALL] > 200
    terms = found.boxes.terms * [1.0, 0.3, 0.3]
    assert strides_outside(boxes, Carried(Boxes(terms, found.boxes.radii), found.verdicts)) > 0
    none = np.where(found.verdicts == PARTLY, FALL, found.verdicts)
    assert strides_outside(boxes, Carried(found.boxes, none)) > 0
