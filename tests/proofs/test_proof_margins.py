"""Margins for rounding, against exact rational numbers; with smaller ones each test fails."""

from fractions import Fraction

import numpy as np

from walker_jax.proofs import atlas, boxes, landings, traps
from walker_jax.proofs.atlas import WALKS, Atlas, Index, Window
from walker_jax.proofs.boxes import Boxes, Trap, rectangle_of
from walker_jax.proofs.enclosures import Enclosure, ball, lies_within
from walker_jax.proofs.returns import ERRORS, align_errors
from walker_jax.walkers.model import State

exactly = np.vectorize(Fraction, otypes=[object])
SHEAR = np.array([[1.0, 0.3], [-1.0, 0.7]])
WINDOW = Window(np.array([0.1, -0.02]), np.array([0.3, 0.01]), (7, 5), SHEAR)


def solve(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Solve equations of exact numbers for points in rows."""
    (a, b), (c, d) = exactly(matrix)
    u, v = x.T
    return np.stack([d * u - b * v, a * v - c * u], axis=1) / (a * d - b * c)


def times_left_out() -> int:
    """Intervals of times of which an end is not held."""
    rng = np.random.default_rng(1)
    low = rng.random(2000)
    high = low + 10.0 ** rng.uniform(-6, 0, 2000)
    middle, half, _ = landings.time_between(low, high).terms
    low, high, middle, half = map(exactly, (low, high, middle, half))
    return int(np.sum((middle - half > low) | (middle + half < high)))


def test_all_times_of_an_interval_are_held(monkeypatch):
    assert times_left_out() == 0
    monkeypatch.setattr(landings, "ROOM", 0.0)
    assert times_left_out() > 500


def corners_outside(terms: np.ndarray, radii: np.ndarray, corners: np.ndarray) -> int:
    """Points, all of one box, that lie outside it: exactly, with radii taken along both axes."""
    apart = exactly(corners) - exactly(terms[:, 0])
    # |apart - sides u| <= radii for some |u| <= 1 if no direction tells them apart; for a
    # parallelogram and a rectangle the normals of the sides and the axes are enough.
    sides = exactly(terms[:, 1:])
    normals = [(1, 0), (0, 1), *((-b, a) for a, b in sides.T)]
    outside = np.zeros(len(corners), bool)
    for n in normals:
        n = np.array(n, object)
        reach = np.abs(n @ sides).sum() + np.abs(n) @ exactly(radii)
        outside |= (np.abs(apart @ n) > reach).astype(bool)
    return int(outside.sum())


def rectangles_left_out(share: float = 1.0) -> int:
    """Corners of parallelograms that lie outside a share of the rectangles about them."""
    rng, lost = np.random.default_rng(2), 0
    space = boxes.PLANE
    for _ in range(60):
        terms = rng.normal(size=(2, 3)) * [1.0, 1e-3, 1e-3 * rng.random()]
        given = [Enclosure([*row, None, None, None], 0.0, space) for row in terms.tolist()]
        found, radii = map(np.array, rectangle_of(tuple(given)))
        signs = np.array([(p, q) for p in (-1, 1) for q in (-1, 1)])
        corners = exactly(terms[:, 0]) + exactly(signs) @ exactly(terms[:, 1:]).T
        found[:, 1:] *= share
        lost += corners_outside(found, share * radii, corners)
    return lost


def test_rectangles_hold_their_parallelograms():
    assert rectangles_left_out() == 0
    assert rectangles_left_out(1 - 1e-11) > 60


def cells_left_out() -> int:
    """Corners of cells of a window that lie outside the boxes about the cells."""
    level, lost = 5, 0
    counts = np.array(WINDOW.counts) * 2**level
    cells = np.random.default_rng(3).integers(0, counts, (400, 2))
    found = WINDOW.boxes(level, cells)
    low, high = exactly(WINDOW.low), exactly(WINDOW.high)
    for k, cell in enumerate(cells):
        places = [cell + np.array([p, q]) for p in (0, 1) for q in (0, 1)]
        w = np.array([low + (high - low) * exactly(p) / exactly(counts) for p in places])
        lost += corners_outside(found.terms[k], found.radii[k], w @ exactly(SHEAR).T)
    return lost


def test_boxes_of_a_window_hold_their_cells(monkeypatch):
    assert cells_left_out() == 0
    monkeypatch.setattr(atlas, "OVERLAP", 0.0)
    assert cells_left_out() == 0
    monkeypatch.setattr(atlas, "CELL_ROUNDING", 0.0)
    assert cells_left_out() > 0


def boxes_held_in_error(index: Index) -> tuple[int, int]:
    """Boxes that end at the edge of a cell, or next to it: those beyond it that are held."""
    rng = np.random.default_rng(4)
    counts = np.array(WINDOW.counts)
    width = exactly(WINDOW.high - WINDOW.low) / exactly(counts)
    wrong = held = 0
    for half in 10.0 ** rng.uniform(-8, -3, 500):
        # In the fourth column of cells, that walk; the cells beside it do not.
        side = int(rng.choice([-1, 1]))
        edge = WINDOW.low[0] + float(width[0]) * (4 if side > 0 else 3)
        w = np.array([edge - side * half * (1 + rng.choice([1e-2, 0.0, -1e-15])), -0.004])
        sides = side * half * SHEAR[:, 0]
        box = Boxes(np.stack([SHEAR @ w, sides, 1e-9 * SHEAR[:, 1]], 1)[None], np.zeros((1, 2)))
        inside = bool(index.holds(WALKS, box)[0])
        x = exactly(box.terms[0, :, 0]) + exactly(sides)
        reach = solve(SHEAR, x[None])[0, 0] - Fraction(float(WINDOW.low[0]))
        held += inside
        wrong += inside and (reach > 4 * width[0] if side > 0 else reach < 3 * width[0])
    return wrong, held


def test_boxes_beyond_a_cell_by_a_rounding_are_not_held(monkeypatch):
    fates = np.zeros(WINDOW.counts, np.int8)
    fates[3] = WALKS
    index = Index(Atlas(WINDOW, 0, fates))
    wrong, held = boxes_held_in_error(index)
    assert wrong == 0 and held > 50
    monkeypatch.setattr(atlas, "MARGIN", 0.0)  # that of the rounding of the shear's inverse stays
    index = Index(Atlas(WINDOW, 0, fates))
    assert boxes_held_in_error(index)[0] == 0
    index.margin = 0.0
    assert boxes_held_in_error(index)[0] > 0


def intervals_held_in_error() -> tuple[int, int]:
    """Intervals that end at the ends of another, or a few roundings beside them: how many are held
    although they reach beyond it, and how many are held."""
    rng = np.random.default_rng(5)
    centre, radius = rng.normal(size=2000), 10.0 ** rng.uniform(-12, 0, 2000)
    part = radius * rng.random(2000)
    middle = centre + rng.choice([-1, 1], 2000) * (radius - part)
    part = part * (1 - 2.0**-48 * rng.integers(0, 3, 2000))
    held = np.asarray(lies_within(ball(middle, part), ball(centre, radius)))
    middle, part, centre, radius = map(exactly, (middle, part, centre, radius))
    beyond = abs(middle - centre) + part > radius
    return int(np.sum(held & beyond)), int(np.sum(held))


def test_intervals_lie_within_another_to_a_rounding(monkeypatch):
    wrong, held = intervals_held_in_error()
    assert wrong == 0 and held > 300
    monkeypatch.setattr("walker_jax.proofs.enclosures.GROWTH", 1.0)
    assert intervals_held_in_error()[0] > 0


def starts_left_out() -> int:
    """Starts on the border of traps, and between squares, that are in no box of the cover."""
    rng, lost = np.random.default_rng(6), 0
    for number in range(10):
        factor = np.array([[rng.uniform(0.5, 3), 0.0], [rng.normal(), rng.uniform(0.5, 3)]])
        trap = Trap(rng.normal(size=2), factor, 10.0 ** rng.uniform(-6, 0))
        if number % 2:  # about zero, where numbers are so small that their rounding hides nothing
            trap = Trap(np.zeros(2), np.eye(2), trap.size)
        cover = traps.cover(trap)
        centres = (cover.terms[:, :, 0] - trap.centre) @ trap.factor
        for t in exactly([0.0, 1.0, -1.0, *rng.normal(size=20)]):
            z = np.array([1 - t * t, 2 * t], object) * Fraction(trap.size) / (1 + t * t)
            x = exactly(trap.centre) + solve(trap.factor.T, z[None])[0]
            apart = np.abs(centres - z.astype(float)).max(1)
            near = np.flatnonzero(apart < 1.1 * trap.size / traps.SQUARES)
            lost += all(corners_outside(*cover.at(i), x[None]) for i in near)
        if number % 2:  # between two squares of a row
            row = cover.at(np.isclose(cover.terms[:, 1, 0], trap.size / traps.SQUARES))
            assert row.count == traps.SQUARES
            ends = exactly(row.terms[:, 0, 0]), exactly(row.terms[:, 0, 1] + row.radii[:, 0])
            lost += int(np.sum((ends[0] + ends[1])[:-1] < (ends[0] - ends[1])[1:]))
    return lost


def test_covers_of_traps_hold_their_borders(monkeypatch):
    """Also with an inverse of L that is hardly good enough."""
    assert starts_left_out() == 0
    exact = np.linalg.inv
    monkeypatch.setattr(np.linalg, "inv", lambda m: exact(m) @ (np.eye(2) - 5e-10))
    assert starts_left_out() == 0
    monkeypatch.setattr(np.linalg, "inv", exact)
    monkeypatch.setattr(traps, "SLACK", 0.0)
    monkeypatch.setattr(traps, "is_inverse", lambda *_: True)
    assert starts_left_out() > 0


def states_left_out(kind: str) -> int:
    """States of an enclosure that are not in the aligned one: at ends of its variables and radii.

    `kind`: of rounding errors alone, or of errors along one direction, which are aligned.
    """
    rng, count = np.random.default_rng(7), 40
    if kind == "narrow":
        ways, radii = np.zeros((4, count, 4)), rng.random((4, count)) * 1e-16
    else:
        ways = rng.normal(size=(4, count, 4)) * [1.0, 1e-9, 1e-9, 1e-9]
        radii = rng.random((4, count)) * 1e-12
    made = [Enclosure([np.zeros(count), *ways[i].T], radii[i], ERRORS) for i in range(4)]
    found = align_errors(State(*made))  # pyright: ignore[reportArgumentType] (enclosures)
    lost = 0
    for n in range(count):
        new = exactly(np.array([[one.terms[1 + k][n] for k in range(4)] for one in found]))
        room = exactly(np.array([one.radius[n] for one in found]))
        for _ in range(4):
            u, e = exactly(rng.choice([-1.0, 1.0], (2, 4)))
            x = exactly(ways[:, n]) @ u + exactly(radii[:, n]) * e
            # The columns of `new` are nearly at right angles: each share is that of a projection.
            share = np.array([(x @ side) / (side @ side) for side in new.T])
            rest = x - new @ np.clip(share, -1, 1)
            lost += bool(np.any(abs(rest) > room))
    return lost


def test_aligned_errors_hold_all_errors(monkeypatch):
    assert states_left_out("narrow") == states_left_out("long") == 0
    monkeypatch.setattr("walker_jax.proofs.returns.ROUNDING", 0.0)
    assert states_left_out("long") > 0
