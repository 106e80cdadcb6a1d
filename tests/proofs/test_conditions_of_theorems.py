"""Conditions of theorems about gaits and basins, each with made-up bounds that it alone refuses."""

from functools import partial
from itertools import product
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.proofs import (
    basin_proofs,
    boxes,
    doubling_proofs,
    following,
    gait_proofs,
    returns,
    traps,
)
from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Window
from walker_jax.proofs.boxes import PLANE, TRAPPED, Boxes, Carried, Trap, carry_box, is_trapped
from walker_jax.proofs.enclosures import Enclosure, ball
from walker_jax.proofs.gait_proofs import has_no_shorter_period
from walker_jax.proofs.landings import PARTLY
from walker_jax.proofs.matrices import (
    Zero,
    identity,
    is_contraction,
    krawczyk,
    midpoints,
)
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.returns import FIRST_DEGREE, Cycle
from walker_jax.proofs.strides import FALL, STRIDE, UNDECIDED, VerifiedStride
from walker_jax.proofs.subdivision import LevelCells, children
from walker_jax.walkers.abstract_point_foot import AbstractMasslessFootWalker

WALKER = wj.SimplestWalker(0.015)
STATES = np.array([[0.2, -0.2], [0.21, -0.2], [0.22, -0.2], [0.23, -0.2]])


def interval(middle: float, radius: float = 0.0):
    return ball(np.float64(middle), np.float64(radius))


def matrix(values, radius: float = 0.0):
    return [[interval(value, radius) for value in row] for row in values]


def cycle_of(states, spread=1e-13, proved=True, jacobian=((0.5, 0.0), (0.0, 0.1)), radius=0.0):
    """A cycle whose first stride has the Jacobian, within a radius; later ones change nothing."""
    within = [interval(value, spread) for value in np.ravel(states)]
    others = [identity(2)] * (len(states) - 1)
    return Cycle(Zero(within, proved), [matrix(jacobian, radius), *others])


# Gaits


def test_a_zero_is_proved_in_all_coordinates_or_not():
    """x = 0 and y = 0, where one of the Jacobian's entries is known to within 1, not 0.1."""
    for wide in (None, 0, 1):
        jacobian = matrix(np.eye(2), 0.1)
        if wide is not None:
            jacobian[wide][wide] = interval(1.0, 1.0)
        values = [[interval(0.0)], [interval(0.0)]]
        assert krawczyk(np.zeros(2), 1.0, values, jacobian).proved == (wide is None)
    off = [[interval(0.0)], [interval(0.9)]]  # the zero may lie beyond the box
    assert not krawczyk(np.zeros(2), 1.0, off, matrix(np.eye(2), 0.1)).proved


def test_a_contraction_is_one_for_all_matrices_of_an_interval():
    rng, found = np.random.default_rng(1), {True: 0, False: 0, None: 0}
    signs = np.array([*product((-1, 0, 1), repeat=4)]).reshape(-1, 2, 2)
    for _ in range(600):
        m, radius = rng.normal(size=(2, 2)), rng.choice([1e-3, 0.05, 0.3])
        answer = is_contraction(matrix(m, radius))
        sizes = np.abs(np.linalg.eigvals(m + radius * signs)).max(-1)
        if answer is not None:
            assert np.all(sizes < 1) if answer else np.all(sizes > 1), m
        found[answer] += 1
    assert min(found.values()) > 50
    # Turns about a right angle: both multipliers are near the unit circle, on either side.
    assert is_contraction(matrix([[0.0, -1.0], [1.0, 0.0]], 1e-3)) is None
    # One multiplier is 1.05 in the middle, and below 1 at a corner.
    assert is_contraction(matrix([[0.45, 0.6], [0.6, 0.45]], 0.0265)) is None


@pytest.mark.parametrize("part", ["verify_points", "verify_boxes"])
def test_a_cycle_is_enclosed_only_if_all_its_strides_are_proved(monkeypatch, part):
    """Of points and of boxes about them, which come once for each direction. It is a zero of
    S(x_1) - x_2 and S(x_2) - x_1, whose Jacobian has those of both strides on its diagonal."""

    def stride(states, undecided: bool) -> VerifiedStride:
        verdict = np.full(len(states), STRIDE)
        verdict[-1] = UNDECIDED if undecided else STRIDE
        enclose = lambda values: Enclosure([values, None, None], 0.0, FIRST_DEGREE)
        slopes = enclose(np.arange(1.0, 1 + len(states))), enclose(-np.ones(len(states)))
        there = tuple(enclose(x) for x in states[::-1].T)
        return VerifiedStride(verdict, there, (slopes,), 1)

    def solve(centre, radius, values, jacobian):
        expected = [[1, 3, -1, 0], [-1, -1, 0, -1], [-1, 0, 2, 4], [0, -1, -1, -1]]
        assert centre.tolist() == STATES[:2].ravel().tolist() and radius == 1e-6
        assert midpoints(jacobian).tolist() == expected and not midpoints(values).any()
        return Zero([], True)

    monkeypatch.setattr(returns, "krawczyk", solve)

    for wrong in (False, True):
        for name, times in (("verify_points", 1), ("verify_boxes", 2)):
            undecided = wrong and name == part
            monkeypatch.setattr(
                returns,
                name,
                lambda _, states, *__, times=times, undecided=undecided: stride(
                    np.concatenate([states] * times), undecided
                ),
            )
        assert (returns.enclose_cycle(WALKER, STATES[:2], 1e-6) is None) == wrong


@pytest.mark.parametrize(
    ("states", "shorter"),
    [
        (STATES[[0]], False),
        (STATES[[0, 1]], False),
        (STATES[[0, 0]], True),
        (STATES[[0, 1, 0, 1]], True),  # a period of 2, followed twice
        (STATES, False),
        (STATES[[0, 1]] * [0, 1], True),  # they differ in nothing
        (STATES[[0, 1]] - [[0, 0], [0, 1e-12]], False),
    ],
)
def test_states_of_a_cycle_differ_from_its_first(states, shorter):
    assert has_no_shorter_period(cycle_of(states)) != shorter


def prove_made_up_gait(monkeypatch, states, enclose):
    found = SimpleNamespace(states=states)
    monkeypatch.setattr(gait_proofs, "find_gait", lambda walker, guess, period: found)
    monkeypatch.setattr(gait_proofs, "enclose_cycle", lambda known, near, radius: enclose(radius))
    return wj.prove_gait(WALKER, period=len(states))


def test_a_gait_is_unique_in_the_part_of_its_box_that_is_left(monkeypatch):
    """The box is about the approximate states, but the result about those of the enclosure."""
    moved = STATES[:1] + np.array([0.0, 3e-13])
    proved = prove_made_up_gait(monkeypatch, STATES[:1], lambda radius: cycle_of(moved))
    assert np.all(proved.states == moved) and proved.radii.max() == pytest.approx(1e-13)
    assert 6.5e-13 < proved.unique_within < gait_proofs.RADII[0] - 3e-13
    assert proved.stable and proved.multipliers[0] == 0.5


@pytest.mark.parametrize(
    ("states", "cycle"),
    [
        (STATES[:2], None),
        (STATES[:2], cycle_of(STATES[:2], proved=False)),
        (STATES[[0, 0]], cycle_of(STATES[[0, 0]])),
        (STATES[:2], cycle_of(STATES[:2], spread=1e-6)),
        (STATES[:2], cycle_of(STATES[:2] + 1e-6)),
    ],
    ids=["no stride", "no zero", "a gait of period 1", "too wide", "beyond the box"],
)
def test_a_gait_is_not_proved(monkeypatch, states, cycle):
    with pytest.raises(ComputationFailed, match="no gait of period 2 is proved"):
        prove_made_up_gait(monkeypatch, states, lambda radius: cycle)


def test_a_larger_box_is_tried_and_the_gait_enclosed_anew(monkeypatch):
    """In a box about the enclosure, which holds the gait; if that fails, the first result stays."""
    near = 1e-11
    boxes = {gait_proofs.RADII[0]: None, gait_proofs.RADII[1]: cycle_of(STATES[:1], near)}
    prove = lambda: prove_made_up_gait(monkeypatch, STATES[:1], lambda radius: boxes.get(radius))
    assert prove().radii.max() == pytest.approx(near)
    boxes[float(cycle_of(STATES[:1], near).zero.within[0].spread)] = cycle_of(STATES[:1])
    assert prove().radii.max() == pytest.approx(1e-13)


# Period doublings

AT, WIDTH = 0.015, 2e-8
ENDS = AT - WIDTH / 2, AT + WIDTH / 2


def prove_made_up_doubling(monkeypatch, states=STATES[:1], at_ends=({}, {}), whole=None, **near):
    """The multiplier passes through -1 at the same rate as the slope; `at_ends` and `whole` say
    what is otherwise. Returns the result and the slopes that were enclosed."""
    asked = []

    def enclose(known, about, box):
        asked.append(known.slope)
        if known.slope.spread > WIDTH / 4:
            given = {} if whole is None else whole
        else:
            given = at_ends[int(known.slope.midpoint > AT)]
            if box < 1e-10:
                given = given | near
        if given.get("cycle", 0) is None:
            return None
        jacobian = np.diag([-1 + known.slope.midpoint - AT, 0.1])
        return cycle_of(states, **{"jacobian": jacobian, **given})

    monkeypatch.setattr(doubling_proofs, "find_doubling", lambda *_: (AT, states))
    monkeypatch.setattr(doubling_proofs, "enclose_cycle", enclose)
    return wj.prove_doubling(WALKER, 0.0145, 0.0155, period=len(states), width=WIDTH), asked


def test_a_doubling_is_proved_between_ends_of_opposite_signs(monkeypatch):
    proved, asked = prove_made_up_doubling(monkeypatch)
    assert (proved.low, proved.high) == ENDS and proved.radius == 200 * WIDTH
    assert asked[-1].lower <= proved.low and asked[-1].upper >= proved.high
    # Where the first enclosure of an end decides no sign, smaller ones may.
    wide = {"radius": 1e-8}
    prove_made_up_doubling(monkeypatch, at_ends=(wide, {}), radius=0.0)


@pytest.mark.parametrize(
    "given",
    [
        {"whole": {"cycle": None}},
        {"whole": {"proved": False}},
        {"states": STATES[[0, 0]]},
        {"at_ends": ({"cycle": None}, {})},
        {"at_ends": ({}, {"proved": False})},
        {"at_ends": ({"radius": 1e-7}, {})},
        {"at_ends": ({}, {"radius": 1e-7})},
        {"at_ends": ({"jacobian": np.diag([-0.9, 0.1])}, {})},
        {"cycle": None},
    ],
    ids=[
        *("no stride at some slope", "no zero at some slope", "a gait of period 1"),
        *("no stride at an end", "no zero at an end", "no sign at one end", "no sign at the other"),
        *("one sign at both ends", "no stride in a smaller box"),
    ],
)
def test_a_doubling_is_not_proved(monkeypatch, given):
    with pytest.raises(ComputationFailed, match="no period doubling is proved"):
        prove_made_up_doubling(monkeypatch, **given)


# Walkers


@pytest.mark.parametrize(
    "method",
    [
        *("phases", "during_stride", "project", "feasible", "exchange_legs", "modes", "equations"),
        *("section", "lift", "contact", "is_ahead", "falls", "margin"),
    ],
)
def test_a_method_that_proofs_assume_more_of_is_fixed(method):
    """Even if it does the same: the proofs do not see whether it does."""
    known = getattr(AbstractMasslessFootWalker, method)
    same = lambda self, *args, **how: known(self, *args, **how)
    same = tuple([*known]) if method == "section" else same
    kind = type("Own", (wj.SimplestWalker,), {method: same})
    with pytest.raises(WrongUse, match="that changes only equations"):
        check_provable(kind(0.004))


# Traps and cells

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
    some = data_of([WALKS, OPEN], [], radius=0.15).attrs
    assert some["area_lower"] == 0 and some["area_upper"] <= np.pi * 0.15**2 * (1 + 1e-11)
