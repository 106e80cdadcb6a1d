"""Atlases of proved cells: boxes are looked up, and none is held that reaches beyond."""

import numpy as np
import pytest

from walker_jax.proofs import atlas
from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Atlas, Index, Window
from walker_jax.proofs.boxes import Boxes

WINDOW = Window(
    np.array([0.1, -0.02]), np.array([0.3, 0.01]), (5, 8), np.array([[1.0, 0.0], [-1.0, 1.0]])
)


@pytest.fixture(scope="module")
def known() -> Atlas:
    """A disc of cells that walk, among others that fall or are open."""
    cells = np.indices((20, 32)).reshape(2, -1).T
    apart = np.hypot(*((cells + 0.5) / [20, 32] - 0.5).T)
    fates = np.where(apart < 0.3, WALKS, np.where(apart > 0.4, FALLS, OPEN))
    empty = Atlas.empty(WINDOW)
    all_ = np.indices((10, 16)).reshape(2, -1).T
    coarse = empty.with_fates(1, all_, np.full(len(all_), OPEN))
    return coarse.with_fates(2, cells, fates)


def random_boxes(rng, count: int) -> Boxes:
    w = rng.uniform(WINDOW.low - 0.01, WINDOW.high + 0.01, (count, 2))
    size = 10 ** rng.uniform(-5, -1.3, count)
    sides = (
        rng.normal(size=(count, 2, 2))
        * size[:, None, None]
        * [
            [[1.0, 0.1]],
        ]
    )
    terms = np.concatenate([(w @ WINDOW.shear.T)[..., None], sides], -1)
    return Boxes(terms, 10 ** rng.uniform(-7, -2.5, (count, 2)))


def misses(known: Atlas) -> tuple[int, int]:
    """Of boxes that are held, points with another fate; and how many boxes are held."""
    rng, lost, held = np.random.default_rng(1), 0, 0
    boxes = random_boxes(rng, 20_000)
    for fate in (WALKS, FALLS):
        some = boxes.at(Index(known).holds(fate, boxes))
        held += some.count
        for _ in range(30):
            u = rng.choice([-1, 1, *rng.uniform(-1, 1, 3)], (some.count, 2))
            x = some.terms[:, :, 0] + np.einsum("nij,nj->ni", some.terms[:, :, 1:], u)
            x = x + some.radii * rng.choice([-1, 1], x.shape)
            place = (x @ np.linalg.inv(WINDOW.shear).T - WINDOW.low) / WINDOW.widths(2)
            inside = np.all((place >= 0) & (place < known.fates.shape), axis=1)
            i, j = np.where(inside[:, None], place, 0).astype(int).T
            lost += np.sum(~inside | (known.fates[i, j] != fate))
    return lost, held


def test_boxes_that_are_held_lie_in_their_cells(known):
    lost, held = misses(known)
    assert lost == 0 and held > 2000


def test_slices_that_leave_out_an_end_are_seen(known, monkeypatch):
    """Rectangles about slices must hold all of a slice."""
    whole = Index.holds_rectangles
    part = lambda self, fate, centres, size: whole(self, fate, centres, 0.5 * size)
    monkeypatch.setattr(Index, "holds_rectangles", part)
    assert misses(known)[0] > 0


def test_cells_enter_at_their_level_and_the_finest_are_left_out(known, monkeypatch):
    assert known.fates.shape == (20, 32) and known.level == 2
    monkeypatch.setattr(atlas, "MOST_CELLS", 1000)
    assert known.with_fates(3, np.array([[0, 0]]), np.array([WALKS])) is known


def test_boxes_that_are_no_numbers_are_not_held(known):
    boxes = Boxes(np.full((2, 2, 3), np.nan), np.zeros((2, 2)))
    assert not np.any(Index(known).holds(WALKS, boxes))
