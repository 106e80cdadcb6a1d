"""Conditions on which a verified stride rests, each with a case that this one alone refuses.

Most cases are of a clock, whose only coordinate is the time: all bounds are known in advance.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.proofs import landings
from walker_jax.proofs.enclosures import BALLS, Enclosure, Space, ball
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.events import (
    Measures,
    Strike,
    Watch,
    enclose_strike,
    watch_piece,
    watch_step,
)
from walker_jax.proofs.flows import Flow, VerifiedStep, take_step
from walker_jax.proofs.landings import (
    LANDING_PIECES,
    PARTLY,
    LandingBounds,
    LandingSearch,
    find_strike_pieces,
    join_landings,
)
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.strides import (
    FALL,
    GOING,
    UNDECIDED,
    is_feasible,
    land_from,
    start_flow,
)
from walker_jax.walkers.model import State

ANY, BELOW, ABOVE, ZERO = (
    ball(np.float64(a), np.float64(r)) for a, r in ((0, 1), (-2, 1), (2, 1), (0, 0))
)
UNTIL_NOW = Watch(no_strike=True, rising=False, clear=True)
WHILE_RISING = UNTIL_NOW._replace(rising=True)


def look(watch: Watch, strike=ABOVE, rate=ANY, fall=BELOW, admits=ABOVE, condition=ABOVE) -> Watch:
    measured = Measures([BELOW, fall], strike, rate, [ABOVE, admits], [ABOVE, condition])
    return Watch(*map(bool, watch_piece(measured, watch)))


@pytest.mark.parametrize("strike", [BELOW, ABOVE])
def test_a_value_that_keeps_its_sign_is_no_strike(strike):
    assert look(UNTIL_NOW, strike) == UNTIL_NOW


def test_a_value_near_zero_strikes_unless_it_falls():
    assert look(UNTIL_NOW, ANY, rate=BELOW) == UNTIL_NOW
    assert look(UNTIL_NOW, ANY, admits=BELOW) == UNTIL_NOW
    for rate, admits in ((ANY, ABOVE), (ANY, ANY), (ZERO, ZERO)):
        assert not look(UNTIL_NOW, ANY, rate=rate, admits=admits).no_strike


def test_only_a_value_that_rises_throughout_may_have_one_zero():
    assert look(UNTIL_NOW, ANY, rate=ABOVE) == WHILE_RISING
    assert look(WHILE_RISING, ANY, rate=ABOVE) == WHILE_RISING
    assert look(WHILE_RISING, BELOW) == UNTIL_NOW  # it had no zero
    for strike in (ANY, ABOVE):  # it had one, or may have a second
        assert not look(WHILE_RISING, strike).no_strike
        assert not look(WHILE_RISING, strike, admits=BELOW).no_strike


def test_facts_that_are_lost_stay_lost():
    assert not look(UNTIL_NOW._replace(no_strike=False)).no_strike
    assert not look(UNTIL_NOW._replace(no_strike=False, rising=True), BELOW).no_strike
    assert not look(UNTIL_NOW._replace(clear=False)).clear


def test_a_piece_is_clear_only_if_all_starts_are():
    for fall in (ANY, ABOVE, ZERO):
        assert not look(UNTIL_NOW, fall=fall).clear
    for condition in (ANY, BELOW):
        assert not look(UNTIL_NOW, condition=condition).clear


class Clock(eqx.Module):
    """Functions a + b t of the time, by (a, b)."""

    strike: tuple
    admits: tuple = (1.0, 0.0)
    fall: tuple = (-1.0, 0.0)
    condition: tuple = (1.0, 0.0)

    def vector_field(self, state):
        return (1.0 + 0.0 * state[0],)

    def modes(self):
        line = lambda c: lambda state: c[0] + c[1] * state[0]
        fall = Guard(line(self.fall), "FORWARD")
        strike = Guard(line(self.strike), SECTION, (line(self.admits),))
        conditions = (Condition(line(self.condition), "RUNNING"),)
        return {"swing": Mode(self.vector_field, (fall, strike), conditions)}


def clock(*lines, of=np.float64) -> Clock:
    """A clock of which each number is an interval, given by its middle and perhaps a radius."""
    number = lambda value: ball(*map(of, value if np.ndim(value) else (value, 0.0)))
    return Clock(*(tuple(map(number, line)) for line in lines))


def step_of(length: float = 1.0, of=np.float64) -> VerifiedStep:
    number = lambda value: ball(of(value), of(0.0))
    series = [number(0.0), number(1.0), number(0.0)]
    return VerifiedStep(Flow((series,)), of(length), Flow((of(0.0),)), Flow((of(1.0),)), True)


def strike_of(true: tuple, believed: tuple) -> Strike:
    """Enclose the zero of a line within a step of length 1, by a series that may be wrong."""
    series = [ball(np.float64(c), 0.0) for c in believed]
    return enclose_strike(clock(true), step_of(), series, np.float64(-believed[0] / believed[1]))


def test_a_strike_is_enclosed():
    found = strike_of((-0.5, 1.0), (-0.5, 1.0))
    (time,) = found.flow.state
    assert found.proved and time.lower <= 0.5 <= time.upper <= found.latest < 0.5 + 1e-14
    found = strike_of((-0.5, 1.0), (-0.501, 1.0))  # the series is 0.001 off; the strike is known
    (time,) = found.flow.state
    assert found.proved and time.lower <= 0.5 <= time.upper and time.spread < 0.0011


@pytest.mark.parametrize(
    ("true", "believed"),
    [
        ((-0.5, 1.0), (-5.1, 10.0)),
        ((-0.002, 1.0), (-0.001, 1.0)),
        ((-0.998, 1.0), (-0.999, 1.0)),
        ((0.5, -1.0), (0.5, -1.0)),
    ],
    ids=[
        "it may lie beyond the margin that was searched",
        "the margin begins before the step",
        "the margin ends after the step",
        "it falls",
    ],
)
def test_a_strike_is_not_proved(true, believed):
    assert not strike_of(true, believed).proved


def test_a_step_is_watched_from_its_start_to_its_end():
    watch = lambda *lines: watch_step(clock(*lines), step_of(), UNTIL_NOW, np.float64(0.5))
    above, never = (1.0, 0.0), (-1.0, 0.0)
    assert watch(above) == UNTIL_NOW
    for early, late in (((1e-3, -1.0), (-0.499, 1.0)),):
        assert not watch(above, above, early).clear and not watch(above, above, late).clear
        for violated in ((-1e-3, 1.0), (0.499, -1.0)):
            assert not watch(above, above, never, violated).clear
    assert watch(above, above, (-0.501, 1.0)).clear  # only after the end
    assert watch((-0.3, 1.0)) == WHILE_RISING
    assert not watch(((-0.3, 0.0), (0.0, 1.0))).no_strike  # the rate may be zero


class Growth(eqx.Module):
    """y' = y."""

    def vector_field(self, state):
        return state


def test_a_step_is_proved_only_while_no_solution_leaves_its_box():
    """From 0.9 to 1.1 the largest solution is 1.1 exp(t), which is also its largest rate."""
    flow, verdicts = Flow((ball(np.float64(1.0), np.float64(0.1)),)), []
    for factor in (0.001, 0.01, 0.1, 0.3, 1.0, 3.0):
        step = take_step(Growth(), flow, np.float64(factor), order=3, tolerance=1.0)
        holds = step.speeds.state[0] >= 1.1 * np.exp(step.length)
        assert holds or not step.proved
        verdicts.append((bool(step.proved), bool(holds)))
    assert (True, True) in verdicts and (False, False) in verdicts


WALKER = enclose_parameters(check_provable(wj.SimplestWalker(0.004)), BALLS)
AT_STRIKE = {"theta": -0.15, "phi": -0.3, "thetadot": -0.15, "phidot": 0.1}


class TrailingFootStays(wj.SimplestWalker):
    """The trailing foot would not lift."""

    def impact(self, state):
        (across, lift), after = super().impact(state)
        return (across, -lift), after


class TurnedBack(wj.SimplestWalker):
    """The next stance leg would swing back."""

    def impact(self, state):
        foot, after = super().impact(state)
        return foot, after._replace(thetadot=-after.thetadot, phidot=-after.phidot)


def lands(walker, watch: Watch = UNTIL_NOW, proved=True, **other: float) -> bool:
    numbers: Any = {name: ball(np.float64(x), 1e-9) for name, x in (AT_STRIKE | other).items()}
    strike = Strike(Flow(State(**numbers)), 0.5, proved)
    return bool(land_from(walker, walker, strike, watch)[0])


def test_a_stride_ends_at_a_strike_only_if_all_of_it_is_proved():
    assert lands(WALKER) and lands(WALKER, WHILE_RISING)
    assert not lands(WALKER, proved=False)
    assert not lands(WALKER, UNTIL_NOW._replace(no_strike=False))
    assert not lands(WALKER, UNTIL_NOW._replace(clear=False))
    assert not lands(WALKER, theta=0.1, phi=-0.1)  # not admitted, though the next start is feasible


@pytest.mark.parametrize("kind", [TrailingFootStays, TurnedBack])
def test_a_stride_ends_only_if_foot_and_leg_go_on(kind):
    assert not lands(enclose_parameters(check_provable(kind(0.004)), BALLS))


def test_a_box_is_feasible_only_if_all_of_it_is():
    box = lambda low, high: ball(np.float64((low + high) / 2), np.float64((high - low) / 2))
    quarter = np.pi / 4
    assert is_feasible((box(0.01, quarter - 1e-9), box(-2.0, -1e-9)))
    assert not is_feasible((box(-1e-9, 0.2), box(-0.2, -0.1)))
    assert not is_feasible((box(0.2, quarter + 1e-9), box(-0.2, -0.1)))
    assert not is_feasible((box(0.2, 0.3), box(-0.2, 1e-9)))


ALWAYS, NEVER, RISES = (1.0, 0.0), (-1.0, 0.0), (-0.53, 1.0)
NONE, WITHIN = (LANDING_PIECES, -1), (8, 8)  # 0.53 is in piece 8, counted from 0, of 16
LANDINGS = [  # strike, admits, fall, whether the stride begins there, the first and last piece
    ("rises", RISES, ALWAYS, NEVER, False, WITHIN),
    ("rises in the first step", RISES, ALWAYS, NEVER, True, WITHIN),
    ("falls", (0.53, -1.0), ALWAYS, NEVER, False, NONE),
    ("perhaps rises", (0.0, (0.0, 1.0)), ALWAYS, NEVER, False, (0, 15)),
    ("is below", (-1.01, 1.0), ALWAYS, NEVER, False, NONE),
    ("is above", (0.01, 1.0), ALWAYS, NEVER, False, NONE),
    ("begins at zero and rises", (0.0, 1.0), ALWAYS, NEVER, True, NONE),
    ("begins at zero and perhaps rises", (0.0, (0.5, 1.0)), ALWAYS, NEVER, True, (0, 15)),
    ("rises at zero in a later step", (-1e-3, 1.0), ALWAYS, NEVER, False, (0, 0)),
    ("is not admitted", RISES, NEVER, NEVER, False, NONE),
    ("is perhaps admitted", RISES, ((0.0, 0.1), 0.0), NEVER, False, WITHIN),
    ("is admitted from then on", RISES, RISES, NEVER, False, WITHIN),
    ("after a fall", RISES, ALWAYS, (-0.4, 1.0), False, NONE),
    ("after a fall of some", RISES, ALWAYS, ((0.0, 0.1), 0.0), False, WITHIN),
]


def test_pieces_that_may_hold_a_strike_are_found():
    names, *lines, at_start, expected = zip(*LANDINGS, strict=True)
    pairs = lambda line, i: [one[i] if np.ndim(one[i]) else (one[i], 0.0) for one in line]
    columns = lambda line: [zip(*pairs(line, i), strict=True) for i in (0, 1)]
    arrays = [[[*map(jnp.array, one)] for one in columns(line)] for line in lines]

    @jax.jit
    def find(lines, at_start):
        some = Clock(*(tuple(ball(*number) for number in line) for line in lines))
        return find_strike_pieces(some, step_of(of=jnp.float64), at_start)

    for i, name in enumerate(names):
        one = jax.tree.map(lambda values, i=i: values[i], arrays)
        found = tuple(map(int, find(one, jnp.asarray(at_start[i]))))
        assert found == expected[i], name


def landing(theta: tuple, thetadot: tuple) -> tuple[Enclosure, Enclosure]:
    """Coordinates a + b t of a landing, by (a, b)."""
    one = lambda c: Enclosure([*map(np.float64, c), None], 0.0, Space(1, 2))
    return one(theta), one(thetadot)


def test_bounds_hold_all_landings_and_none_that_is_far():
    none = LandingBounds(*((np.float64(x),) * 2 for x in (1.0, 8.0, -8.0)))
    bounds, known = join_landings(none, landing((0.2, 0.1), (-0.2, 0.0)), np.True_)
    assert known and bounds.axis == (0.1, 0.0)
    np.testing.assert_allclose((bounds.low, bounds.high), ((0.01, -0.02), (0.03, -0.02)), rtol=1e-9)
    both, known = join_landings(bounds, landing((0.0, 0.0), (0.3, 0.1)), np.True_)
    assert known and both.axis == bounds.axis  # along the first landing
    np.testing.assert_allclose((both.low, both.high), ((0, -0.02), (0.03, 0.04)), atol=1e-15)
    same, known = join_landings(bounds, landing((1e9, 0.1), (1e9, 0.0)), np.False_)
    assert known and same == bounds
    for far in (((1e3, 0.1), (0.0, 0.1)), ((0.0, 0.1), (1e3, 0.1)), ((-1e3, 0.1), (-1e3, 0.1))):
        assert not join_landings(bounds, landing(*far), np.True_)[1]


NO_LANDINGS = LandingBounds(*((np.float64(x),) * 2 for x in (1.0, 8.0, -8.0)))
SOME_LANDINGS = NO_LANDINGS._replace(low=(np.float64(0.1),) * 2, high=(np.float64(0.2),) * 2)
START = ball(np.float64(0.15), 1e-9), ball(np.float64(-0.15), 1e-9)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("proved", [True, False])
@pytest.mark.parametrize("fallen", [True, False])
def test_all_of_a_box_falls_only_by_proved_steps(monkeypatch, known, proved, fallen):
    """And only if all landings so far are bounded."""
    take, nothing = landings.take_step, lambda *_: (np.float64(16), np.float64(-1))
    step = lambda *args, **how: take(*args, **how)._replace(proved=np.bool_(proved))
    monkeypatch.setattr(landings, "take_step", step)
    monkeypatch.setattr(landings, "find_strike_pieces", nothing)
    monkeypatch.setattr(landings, "landings_between", lambda *_: None)
    monkeypatch.setattr(landings, "join_landings", lambda *_: (SOME_LANDINGS, np.bool_(known)))
    monkeypatch.setattr(landings, "fallen_by", lambda _: np.bool_(fallen))
    flow = evaluate(start_flow, WALKER, START, ())
    begun = LandingSearch(flow, np.float64(1.0), NO_LANDINGS, np.int32(GOING), np.int32(0))
    now = landings.advance_landings(WALKER, WALKER, lambda one: one, begun)
    verdict = (FALL if fallen else GOING) if known else UNDECIDED
    assert now.verdict == (verdict if proved else GOING)
    assert now.bounds == (SOME_LANDINGS if proved else NO_LANDINGS)
    assert (now.flow.state[0].midpoint != flow.state[0].midpoint) == proved


@pytest.mark.parametrize(
    ("last", "found", "verdict"),
    [
        (FALL, NO_LANDINGS, FALL),
        (FALL, SOME_LANDINGS, PARTLY),
        (UNDECIDED, NO_LANDINGS, UNDECIDED),
        (UNDECIDED, SOME_LANDINGS, UNDECIDED),
    ],
)
def test_landings_are_bounded_only_once_all_else_has_fallen(monkeypatch, last, found, verdict):
    def advance(walker, parameters, fill, now):
        return now._replace(
            verdict=jnp.int32(last), bounds=jax.tree.map(jnp.float64, found), steps=now.steps + 1
        )

    monkeypatch.setattr(landings, "advance_landings", advance)
    start: Any = [ball(jnp.float64(one.midpoint), jnp.float64(1e-9)) for one in START]
    assert landings.enclose_landings(WALKER, start)[0] == verdict
