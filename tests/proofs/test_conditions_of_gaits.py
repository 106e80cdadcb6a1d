"""Conditions of theorems about gaits, each with made-up bounds that it alone refuses."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.proofs import (
    doubling_proofs,
    gait_proofs,
    returns,
)
from walker_jax.proofs.enclosures import Enclosure, ball
from walker_jax.proofs.gait_proofs import has_no_shorter_period, multipliers_of
from walker_jax.proofs.matrices import (
    Zero,
    identity,
    is_contraction,
    krawczyk,
    midpoints,
)
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.returns import FIRST_DEGREE, Cycle
from walker_jax.proofs.strides import STRIDE, UNDECIDED, VerifiedStride
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


@pytest.mark.parametrize("m", [[[0.5, 0.2], [0.1, -0.3]], [[0.5, 0.4], [-0.4, 0.5]]])
def test_multipliers_of_all_matrices_are_within_their_radius(m):
    """Real ones, and a pair; both parts are within the radius."""
    found, width = multipliers_of(matrix(m, 1e-3))
    corners = np.array([*product((-1, 1), repeat=4)]).reshape(-1, 2, 2)
    for true in np.linalg.eigvals(np.array(m) + 1e-3 * corners):
        off = np.sort_complex(true) - np.sort_complex(found)
        assert max(np.abs(off.real).max(), np.abs(off.imag).max()) <= width < 0.01


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
        *("begin", "launch", "may_launch"),
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
