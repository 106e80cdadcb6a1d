"""The machines of the page of examples, against integrations with SciPy and closed forms."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences
from graphs_by_scipy import through_graph
from reference import ROOT
from scipy.integrate import solve_ivp

import walker_jax as wj

PAGE = ROOT / "docs" / "machine-examples.md"
PROGRAMS = dict(re.findall(r"<!-- (.*?) -->\n```python\n(.*?)```", PAGE.read_text(), re.S))


def names_of(title, until=None):
    """What a program of the page defines, up to a text in it; its assertions hold."""
    program = PROGRAMS[title]
    assert "\nassert " in program
    names: dict[str, Any] = {"__name__": "own"}
    with jax.numpy_dtype_promotion("standard"):  # as those who copy it have
        exec(compile(program[: until and program.index(until)], PAGE.name, "exec"), names)
    return names


@pytest.fixture(scope="module")
def table():
    return names_of("a ball on a soft table")


@pytest.fixture(scope="module")
def relay():
    return names_of("a relay that slides")


@pytest.fixture(scope="module")
def scuffing():
    return names_of("a walker whose foot may scuff")


def test_every_program_of_the_page_is_tested():
    assert len(PROGRAMS) == PAGE.read_text().count("```python") == 3


def event(function, direction=1):
    function.terminal, function.direction = True, direction
    return function


def period_of_table(x, table):
    """The ball after a period, by pieces in which it does not touch the table, or all along."""
    k, damping, amplitude, gravity = (
        float(getattr(table, name)) for name in ("stiffness", "damping", "amplitude", "gravity")
    )

    def rates(t, y):
        depth = max(-y[0], 0.0)
        push = k * depth**1.5 * (1 - damping * y[1])
        return [y[1], push - gravity + amplitude * np.sin(t)]

    t, y = 0.0, np.array(x, float)
    while t < 2 * np.pi:
        sign = np.sign(y[0]) or np.sign(y[1])
        ends = event(lambda _, y, sign=sign: -sign * y[0])
        options: Any = {"rtol": 1e-13, "atol": 1e-13, "first_step": 1e-5}
        made = solve_ivp(rates, (t, 2 * np.pi), y, "DOP853", events=ends, **options)
        t, y = made.t[-1], made.y[:, -1]
        y[0] = 0.0 if made.t_events[0].size else y[0]
    return y


@pytest.mark.slow
def test_a_ball_begins_a_period_above_the_table_or_in_it(table):
    table = table["table"]
    starts = np.array([[2.6, -2.8], [0.0, -0.5], [-0.002, -0.3], [-0.004, 0.2], [0.3, 0.1]])
    made = wj.strides(table, starts)
    assert made.outcome.tolist() == [wj.Outcome.STRIDE] * 5
    expected = [period_of_table(x, table) for x in starts]
    np.testing.assert_allclose(made.state, expected, atol=1e-8)


@pytest.mark.slow
def test_a_ball_on_a_table_has_derivatives_and_a_basin(table):
    gait, table = table["gait"], table["table"]
    stride = jax.jit(lambda x: wj.stride(table, x).state)
    expected = differences(
        lambda many: np.stack([*map(stride, many)]), gait.states[0], np.full(2, 5e-4)
    )
    np.testing.assert_allclose(jax.jacfwd(stride)(gait.states[0]), expected, rtol=1e-7)
    data = wj.basin(table, wj.Grid.plain(gap=(2.5, 2.75, 5), rate=(-2.9, -2.6, 5)), "direct")
    assert data.attractor.sel(gap=2.63, rate=-2.78, method="nearest") == 0


@pytest.mark.slow
def test_a_relay_slides_where_both_fields_point_to_the_switch(relay):
    gait, relay = relay["gait"], relay["Relay"]()
    starts = np.linspace(-3, 0.985, 400)[:, None]  # no start chatters; at y = 0 it would rest
    made = wj.strides(relay, starts)
    assert (made.outcome == wj.Outcome.STRIDE).all()
    # Those that slide leave the switch at (0, 1) in the end, so they return to one place.
    ends = made.state[starts[:, 0] > -1]
    np.testing.assert_allclose(ends, gait.states[0, 0], atol=1e-12)
    data = wj.basin(relay, wj.Grid.plain(y=(-2, 0.9, 30)), "direct")
    assert (data.fate == wj.Outcome.STRIDE).all()


def after_crossing(y):
    """Where the relay arrives next at its switch, from (0, y) below it."""

    def fly(u, y, way):
        rates = lambda _, s: [0.2 * s[0] + s[1] - u, u - s[0]]
        ends = event(lambda _, s: s[0], way)
        options: Any = {"rtol": 1e-13, "atol": 1e-13, "first_step": 1e-3}
        made = solve_ivp(rates, (0, 20), [0.0, y], "DOP853", events=ends, **options)
        return made.y_events[0][0][1]

    return fly(1, max(fly(-1, y, 1), 1.0), -1)  # after sliding, if it slides


def test_modes_of_a_relay_cross_the_switch():
    relay = names_of("a relay that slides", until="\ngait = ")["Relay"]()
    state, _, passed = through_graph(relay)([-1.5])
    np.testing.assert_allclose(state, [after_crossing(-1.5)], atol=1e-11)
    assert passed == ["sliding", "below", "sliding", "above"]


@pytest.mark.slow
def test_a_crossed_switch_is_that_of_another_integration(relay):
    found = wj.stride(relay["Relay"](), [-1.5]).state
    np.testing.assert_allclose(found, [after_crossing(-1.5)], atol=1e-11)


THETAS, SUMS = np.meshgrid([0.12, 0.15, 0.2, 0.25, 0.3], [-0.003, -0.01, -0.02])
SCUFFING = np.stack([THETAS, SUMS - THETAS], -1).reshape(-1, 2)
"""Starts, from some of which a foot scuffs that is too long by 5e-4."""


def test_modes_of_a_walker_scuff_where_the_foot_lacks_room():
    """By SciPy's place of the foot; a foot that clears the ground changes nothing."""
    kind = names_of("a walker whose foot may scuff", until="\n# A gait")["ScuffingWalker"]
    walkers = wj.SimplestWalker(0.004), kind(0.004, jnp.array(0.5)), kind(0.004, jnp.array(5e-4))
    strides, scuffs = [*map(through_graph, walkers)], []
    for x in ([0.2, -0.203], [0.25, -0.27], [0.3, -0.32]):
        (free, *_), (none, *_), (_, _, passed) = (stride(x) for stride in strides)
        np.testing.assert_allclose(none, free, atol=1e-10)
        assert np.isfinite(free).all()
        scuffs.append(lacks_room(x, 5e-4))
        assert (passed[-1] == "scuffs") == scuffs[-1]
    assert scuffs == [False, True, True]


@pytest.mark.slow
def test_a_foot_that_clears_the_ground_changes_nothing(scuffing):
    """And starts with a foot that is too long scuff, by SciPy's place of the foot."""
    walker, kind = scuffing["walker"], scuffing["ScuffingWalker"]
    free, none = (wj.strides(one, SCUFFING) for one in (walker, kind(0.004, 0.5)))
    walks = free.outcome == wj.Outcome.STRIDE
    np.testing.assert_array_equal(none.outcome == wj.Outcome.STRIDE, walks)
    np.testing.assert_allclose(none.state, free.state, atol=1e-12)
    short = kind(0.004, 5e-4)
    outcomes = wj.strides(short, SCUFFING).outcome
    for x, outcome in zip(SCUFFING[walks], outcomes[walks], strict=True):
        scuffs = outcome == int(short.failure("scuffs"))
        assert scuffs == lacks_room(x, 5e-4) and (scuffs or outcome == wj.Outcome.STRIDE)


@pytest.mark.slow
def test_explanations_say_the_way(table, relay, scuffing):
    begun = wj.explain(table["table"], [-0.004, 0.2])
    assert begun.modes[0].led_to == "contact at once" and begun.modes[1].name == "contact"
    slides, crosses = (wj.explain(relay["Relay"](), [y]) for y in (-0.5, -1.5))
    assert [one.led_to for one in slides.modes] == ["below", "sliding", "above", "section"]
    assert [one.led_to for one in crosses.modes][:2] == ["below at once", "sliding"]
    assert slides.modes[0].time == pytest.approx(np.log(2), abs=1e-13)
    start = scuffing["gait"].states[0]
    short, long = (wj.explain(scuffing[one], start) for one in ("little", "enough"))
    assert short.name == "scuffs" and [one.name for one in short.modes] == ["shortened"]
    assert [one.led_to for one in long.modes] == ["swing", "section"] and not long.complaints


def lacks_room(x, shortening):
    """Whether the shortened foot touches the ground before its leg has room to be straight."""
    theta, thetadot = x
    start = [theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot]

    def rates(_, y):
        theta, phi, thetadot, phidot = y
        pull = np.sin(theta - 0.004)
        along = np.sin(phi) * (thetadot**2 - np.cos(theta - 0.004))
        return [thetadot, phidot, pull, along + pull]

    height = lambda part, y: np.cos(y[0]) - (1 - part) * np.cos(y[0] - y[1])
    room = event(lambda t, y: height(0, y) if y[0] > y[1] else -1.0)
    touches = event(lambda t, y: height(shortening, y), -1)
    made = solve_ivp(
        rates, (0, 10), start, "DOP853", events=(room, touches), rtol=1e-11, max_step=0.02
    )
    return made.t_events[1].size > 0
