"""Conditions of theorems about basins, each with made-up bounds that it alone refuses."""

from functools import partial
from itertools import product
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.proofs import (
    basin_proofs,
    boxes,
    following,
    subdivision,
    traps,
)
from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Window
from walker_jax.proofs.boxes import PLANE, TRAPPED, Boxes, Carried, Trap, carry_box, is_trapped
from walker_jax.proofs.enclosures import Enclosure
from walker_jax.proofs.following import Fates
from walker_jax.proofs.landings import PARTLY
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.strides import FALL, STRIDE, UNDECIDED, VerifiedStride
from walker_jax.proofs.subdivision import LevelCells, children

WALKER = wj.SimplestWalker(0.015)
TRAP = Trap(np.array([0.15, -0.16]), np.array([[1.2, 0.0], [0.4, 0.9]]), 1e-3)


def place(x, radius, of=np.float64) -> tuple[Enclosure, Enclosure]:
    def along(axis: int) -> Enclosure:
        sides = [of(radius if side == axis else 0.0) for side in range(2)]
        return Enclosure([of(x[axis]), *sides, *[of(0.0)] * 3], of(0.0), PLANE)

    return along(0), along(1)


def test_a_box_is_trapped_only_if_all_of_it_is():
    rng, held = np.random.default_rng(2), 0
    corners = np.array([*product((-1, 1), repeat=2)])
    norm = lambda x: np.linalg.norm((x - TRAP.centre) @ TRAP.factor, axis=-1)
    for _ in range(300):
        radius = 10 ** rng.uniform(-6, -3)
        x = TRAP.centre + rng.normal(size=2) * 1e-3
        answer = bool(is_trapped(place(x, radius), TRAP))
        largest = norm(x + radius * corners).max()
        assert not answer or largest <= TRAP.size
        assert answer or norm(x) + 4 * radius > TRAP.size
        held += answer
    assert 50 < held < 250
    assert not is_trapped(place(np.zeros(2), 0.0), Trap.nowhere())


@pytest.mark.parametrize(
    ("verdict", "x", "expected"),
    [
        (STRIDE, TRAP.centre, TRAPPED),
        (STRIDE, TRAP.centre + 0.1, STRIDE),
        (FALL, TRAP.centre, FALL),
        (UNDECIDED, TRAP.centre, UNDECIDED),
    ],
)
def test_only_a_box_that_strides_is_trapped(monkeypatch, verdict, x, expected):
    state = place(x, 1e-5, of=jnp.float64)
    stride = VerifiedStride(jnp.asarray(verdict), state, (), 1)
    monkeypatch.setattr(boxes, "verify_stride", lambda *_, **__: stride)
    terms, radii = jnp.zeros((2, 3)), jnp.zeros(2)
    known = check_provable(WALKER)
    assert carry_box.__wrapped__(known, terms, radii, TRAP)[2] == expected


@pytest.mark.parametrize(
    ("period", "stride", "verdict"), [(1, 0, STRIDE), (2, 0, UNDECIDED), (2, 0, TRAPPED), (2, 1, 1)]
)
def test_one_box_that_does_not_come_back_is_no_trap(monkeypatch, period, stride, verdict):
    """All boxes have to make each stride, and to be in the trap after the last."""
    made = []

    def carry(walker, known: Boxes, trap: Trap, wrong: bool) -> Carried:
        now, last = len(made), len(made) == period - 1
        assert (trap.size > 0) == last
        assert now == 0 or known is made[-1]  # those after the stride before
        made.append(Boxes(known.terms + 1, known.radii))
        verdicts = np.full(known.count, TRAPPED if last else STRIDE)
        if wrong and now == stride:
            verdicts[known.count // 2] = verdict
        return Carried(made[-1], verdicts)

    for wrong in (False, True):
        made.clear()
        monkeypatch.setattr(traps, "carry", partial(carry, wrong=wrong))
        assert traps.is_trap(WALKER, TRAP, period) != wrong


def test_an_ellipse_too_thin_for_float64_is_no_trap(monkeypatch):
    """Its cover is empty, of which all boxes come back."""
    monkeypatch.setattr(traps, "carry", lambda _, known, __: Carried(known, np.zeros(known.count)))
    thin = TRAP._replace(factor=np.array([[1.0, 0.0], [1e4, 1e-4]]))
    assert traps.cover(thin).count == 0 and not traps.is_trap(WALKER, thin, 1)


FATES = {  # what is guessed, the verdict on the stride: what is done and what goes on
    (WALKS, STRIDE): (False, True),
    (WALKS, TRAPPED): (True, False),
    (WALKS, FALL): (False, False),
    (WALKS, UNDECIDED): (False, False),
    (FALLS, STRIDE): (False, True),
    (FALLS, TRAPPED): (False, False),
    (FALLS, FALL): (True, False),
    (FALLS, UNDECIDED): (False, True),  # those that stride land in the next box
}


def test_a_fate_is_proved_by_its_own_verdicts_alone(monkeypatch):
    guesses, verdicts = (np.array(one) for one in zip(*FATES, strict=True))
    some = Boxes(np.arange(len(FATES) * 6.0).reshape(-1, 2, 3), np.zeros((len(FATES), 2)))
    copied = lambda: Boxes(some.terms.copy(), some.radii.copy())
    monkeypatch.setattr(following, "carry", lambda *_: Carried(copied(), verdicts.copy()))
    partly = lambda _, known: Carried(
        Boxes(-known.terms, known.radii + 1), np.full(known.count, PARTLY)
    )
    monkeypatch.setattr(following, "carry_partly", partly)
    nothing: Any = SimpleNamespace(holds=lambda fate, known: np.zeros(known.count, bool))
    new, goes, done = following.follow_once(WALKER, some, guesses, TRAP, nothing)
    known = np.arange(len(FATES)) * 6.0
    assert new.terms[:, 0, 0].tolist() == [*known[:-1], -known[-1]] and new.radii[-1, 0] == 1
    assert [*zip(done.tolist(), goes.tolist(), strict=True)] == [*FATES.values()]
    # Of boxes that go on, those that come into cells of their own fate are done.
    held: Any = SimpleNamespace(holds=lambda fate, known: np.full(known.count, fate == FALLS))
    _, goes, done = following.follow_once(WALKER, some, guesses, TRAP, held)
    expected = {(FALLS, STRIDE): (True, False), (FALLS, UNDECIDED): (True, False)}
    assert [*zip(done.tolist(), goes.tolist(), strict=True)] == [*(FATES | expected).values()]


def test_only_open_cells_are_split(monkeypatch):
    """One cell of four walks and one falls; the halves of the others stay open."""
    known = []

    def follow(walker, some: Boxes, trap, index, most) -> Fates:
        known.append([index.sums[fate][-1, -1] for fate in (WALKS, FALLS)])
        fates = [WALKS, OPEN, FALLS, OPEN] if some.count == 4 else [OPEN] * some.count
        return Fates(np.array(fates), np.ones(some.count, int))

    monkeypatch.setattr(subdivision, "follow_boxes", follow)
    window = WINDOW._replace(counts=(2, 2))
    found = subdivision.prove_cells(WALKER, window, TRAP, levels=2, strides=3)
    assert [len(one.cells) for one in found] == [4, 8, 32]
    assert {tuple(one) for one in found[1].cells // 2} == {(0, 1), (1, 1)}
    assert known == [[0, 0], [1, 1], [4, 4]]  # in cells of the level before


RADIUS, CENTRE = 0.3, np.array([0.1, -0.2])
WINDOW = Window(CENTRE - 0.31, CENTRE + 0.31, (7, 5), np.eye(2))
MOVED = 0.9e-12
"""The gait may lie this far from the centre of the disc."""


def test_cells_in_a_disc_and_those_that_may_meet_it():
    cells = np.indices((28, 20)).reshape(2, -1).T
    inside = basin_proofs.is_in_disc(WINDOW, LevelCells(2, cells, cells, cells), CENTRE, RADIUS)
    meets = basin_proofs.may_meet_disc(WINDOW, CENTRE, RADIUS, 2, cells)
    half, apart = WINDOW.widths(2) / 2, np.abs(WINDOW.centres(2, cells) - CENTRE)
    farthest = np.hypot(*(apart + half).T)
    nearest = np.hypot(*np.maximum(apart - half, 0).T)
    assert np.all(farthest[inside] < RADIUS) and np.all(farthest[~inside] > 0.999 * RADIUS)
    assert np.all(nearest[~meets] > RADIUS) and np.all(nearest[meets] < 1.001 * RADIUS)
    assert 100 < inside.sum() < meets.sum() < len(cells)


def test_a_disc_may_be_about_a_gait_that_is_not_quite_known():
    """Cells that end at its circle, to a rounding or the error of the gait, are on both sides."""
    cell, known = np.array([[0, 0]]), lambda cells: LevelCells(0, cells, cells, cells)
    for radius in (1e-3, 0.3):
        low = CENTRE - [0.0, radius / 10]
        window = Window(low, CENTRE + radius * np.array([0.6, 0.8]), (1, 1), np.eye(2))
        assert not basin_proofs.is_in_disc(window, known(cell), CENTRE, radius)
        smaller = window._replace(high=CENTRE + (radius - 1e-7 * radius) * np.array([0.6, 0.8]))
        assert basin_proofs.is_in_disc(smaller, known(cell), CENTRE, radius)
        beyond = window._replace(low=CENTRE + np.array([radius + MOVED, -1e-3]), high=CENTRE + 1.0)
        assert basin_proofs.may_meet_disc(beyond, CENTRE, radius, 0, cell)[0]
        about = basin_proofs.window_about_disc(CENTRE, radius)
        assert np.all(about.low < CENTRE - radius - MOVED)
        assert np.all(about.high > CENTRE + radius + MOVED)


HALF = np.array([0.4, 0.2])


def data_of(fates: list, finer: list, radius: float = 0.0):
    """A window of 2 x 1 cells, the open ones of which are split in four."""
    window = Window(CENTRE - HALF, CENTRE + HALF, (2, 1), np.eye(2))
    cells = np.array([[0, 0], [1, 0]])
    found = [LevelCells(0, cells, np.array(fates), np.array([3, 4]))]
    if finer:
        split = children(cells[np.array(fates) == OPEN])
        found.append(LevelCells(1, split, np.array(finer), np.full(len(split), 2)))
    trap = TRAP._replace(centre=CENTRE)
    known = wj.SimplestWalker(0.004)
    return basin_proofs.dataset_of(known, ("theta", "thetadot"), window, trap, found, 1, radius)


def test_areas_are_bounded_by_cells_that_walk_or_may():
    """The whole window has the area 0.32, a cell 0.16, and a fourth of it 0.04."""
    data = data_of([WALKS, OPEN], [WALKS, FALLS, OPEN, OPEN])
    assert data["proved"].values.tolist() == [WALKS, WALKS, FALLS, OPEN, OPEN]
    assert data.attrs["verified_strides"] == 3 + 4 + 4 * 2 and not data.attrs["all_walk"]
    assert 0.2 * (1 - 1e-11) < data.attrs["area_lower"] < 0.2
    assert 0.28 < data.attrs["area_upper"] < 0.28 * (1 + 1e-11)
    assert data_of([WALKS, WALKS], []).attrs["all_walk"]
    assert not data_of([WALKS, FALLS], []).attrs["all_walk"]
    assert not data_of([WALKS, OPEN], []).attrs["all_walk"]


def test_cells_across_a_circle_count_in_the_upper_bound():
    """The first two fourths, of 0.04 each, end 0.283 from the centre, the others 0.447."""
    part = data_of([FALLS, OPEN], [WALKS, OPEN, WALKS, FALLS], radius=0.3).attrs
    assert part["area_lower"] == pytest.approx(0.04, rel=1e-9)
    assert part["area_upper"] == pytest.approx(0.12, rel=1e-9)
    whole = data_of([WALKS, WALKS], [], radius=0.15).attrs
    assert whole["area_lower"] == pytest.approx(np.pi * 0.15**2, rel=1e-9)
    assert whole["area_upper"] == pytest.approx(np.pi * 0.15**2, rel=1e-9)
    # All final cells of the first level walk, but not all of the next.
    part = data_of([WALKS, OPEN], [WALKS, FALLS, OPEN, OPEN], radius=0.15).attrs
    assert part["area_lower"] == 0 and not part["all_walk"]
    some = data_of([WALKS, OPEN], [], radius=0.15).attrs
    assert some["area_lower"] == 0 and some["area_upper"] <= np.pi * 0.15**2 * (1 + 1e-11)
