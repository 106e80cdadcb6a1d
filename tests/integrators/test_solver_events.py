"""Events of motions by Runge-Kutta methods of diffrax, whose steps are long against them."""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root_scalar

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.integrators.integrator import Method
from walker_jax.systems.system import code_field

SLOW = pytest.mark.slow
TSIT5, DOPRI8 = diffrax.Tsit5(), diffrax.Dopri8()
TOLERANCES = 1e-6, 1e-9, 1e-12
TABLE = 0.5
"""Largest acceleration of the ball's table."""


class Ball(NamedTuple):
    """Height, velocity and time; or their rates."""

    y: Any
    v: Any
    t: Any


def throw(s: Ball) -> Ball:
    return Ball(s.v, -1 + 0 * s.t, 1 + 0 * s.t)


class Thrown(wj.HybridSystem):
    """A ball thrown up at a time and caught at the same height: a parabola, at any tolerance."""

    section = ("speed", "time")
    condition: Any = code_field(default=None)

    def lift(self, x):
        return Ball(0 * x[0], x[0], x[1])

    def project(self, state):
        return jnp.stack([state.v, state.t])

    def modes(self):
        watched = ()
        if self.condition is not None:
            watched = (wj.Condition(self.condition, "RUNNING", at_start=True),)
        return {"flight": wj.Mode(throw, (wj.Guard(lambda s: -s.y, wj.SECTION),), watched)}


class StiffTable(wj.HybridSystem):
    """A ball on a stiff table with a damper: contacts and flights, which begin on their guards."""

    stiffness: Any = 1e5
    turns: int = eqx.field(static=True, default=1)
    section = ("phase", "velocity")

    def lift(self, x):
        return Ball(0.3 * jnp.sin(x[0]), x[1], x[0])

    def project(self, state):
        return jnp.stack([state.t, state.v])

    def modes(self):
        depth = lambda s: 0.3 * jnp.sin(s.t) - s.y

        def press(s: Ball) -> Ball:
            sinking = 0.3 * jnp.cos(s.t) - s.v
            return Ball(s.v, self.stiffness * depth(s) * (1 + 0.3 * sinking) - 1, 1 + 0 * s.t)

        modes = {}
        for i in range(self.turns):
            to = wj.SECTION if i == self.turns - 1 else f"contact {i + 1}"
            lifts = wj.Guard(lambda s: -depth(s), f"flight {i}")
            modes[f"contact {i}"] = wj.Mode(press, (lifts,))
            modes[f"flight {i}"] = wj.Mode(throw, (wj.Guard(depth, to),))
        return modes


def first_landing(start: np.ndarray) -> float:
    """Return the time at which a thrown ball first meets the table, by a fine search."""
    phase, speed = start
    depth = lambda t: TABLE * (np.sin(phase + t) - np.sin(phase)) - speed * t + t * t / 2
    times = np.linspace(1e-6, 12, 200_001)
    values = depth(times)
    first = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))[0]
    return root_scalar(depth, bracket=(times[first], times[first + 1]), xtol=1e-14).root


@pytest.mark.parametrize(
    "solver",
    [TSIT5, *(pytest.param(one, marks=SLOW) for one in (DOPRI8, diffrax.Dopri5()))],
    ids=repr,
)
def test_a_ball_lands_when_its_parabola_meets_the_table(solver):
    """The error of a step is zero, so only the sine of the table bounds its length."""
    starts = np.random.default_rng(0).uniform((-3, 1), (3, 4), (100, 2))
    expected = np.array([first_landing(x) for x in starts])
    for tolerance in TOLERANCES:
        found = wj.strides(
            wj.systems.BouncingBall(TABLE), starts, solver=solver, tolerance=tolerance
        )
        assert np.all(found.outcome == Outcome.STRIDE)
        np.testing.assert_allclose(found.time, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("solver", [TSIT5, pytest.param(DOPRI8, marks=SLOW)], ids=repr)
def test_modes_that_begin_on_their_guards_do_not_end_there(solver):
    rng = np.random.default_rng(0)
    starts = rng.uniform((-3, -3), (3, -0.5), (200, 2))
    series = wj.strides(StiffTable(), starts)
    found = wj.strides(StiffTable(), starts, solver=solver, tolerance=1e-10)
    np.testing.assert_array_equal(found.outcome, series.outcome)
    assert found.time.min() > 1e-3  # half a period of the contact is 0.01: no start is at rest
    np.testing.assert_allclose(found.time, series.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.state, series.state, rtol=0, atol=1e-6)
    for i in range(8):
        alone = wj.stride(StiffTable(), starts[i], solver=solver, tolerance=1e-10)
        assert alone.outcome == found.outcome[i]
        np.testing.assert_allclose(alone.time, found.time[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(alone.state, found.state[i], rtol=0, atol=1e-10)


@SLOW
@pytest.mark.parametrize("solver", [None, TSIT5], ids=repr)
def test_phases_that_begin_where_the_last_one_ended_go_on(solver):
    """Two strides of two modes are one of four; its third mode begins on its guard to rounding."""
    starts = np.random.default_rng(1).uniform((-3, -3), (3, -0.5), (400, 2))
    twice: Any = dict(solver=solver, tolerance=1e-10)
    one = wj.strides(StiffTable(100.0), starts, **twice)
    other = wj.strides(StiffTable(100.0), one.state, **twice)
    both = wj.strides(StiffTable(100.0, turns=2), starts, **twice)
    assert np.all(both.outcome == Outcome.STRIDE) and np.all(other.outcome == Outcome.STRIDE)
    np.testing.assert_allclose(both.time, one.time + other.time, rtol=0, atol=1e-8)


@SLOW
@pytest.mark.parametrize("solver", [TSIT5, DOPRI8], ids=repr)
def test_a_runner_is_decided_as_by_series(solver):
    starts = np.random.default_rng(0).uniform(0.93, 2.27, (400, 1))
    runner = wj.systems.SpringMassRunner()
    series = wj.strides(runner, starts)
    for tolerance in TOLERANCES:
        found = wj.strides(runner, starts, solver=solver, tolerance=tolerance)
        np.testing.assert_array_equal(found.outcome, series.outcome)
        np.testing.assert_allclose(found.state, series.state, rtol=0, atol=10 * tolerance)
        np.testing.assert_allclose(found.time, series.time, rtol=0, atol=10 * tolerance)


class ThrownAtTimes(Thrown):
    """Its flight also ends near multiples of 2 pi, and near 9, where a sawtooth has a kink."""

    def modes(self):
        flight = super().modes()["flight"]
        near = lambda s: jnp.cos(s.t) - np.cos(1e-3), lambda s: 1 - jnp.abs(s.t - 9) - 0.998
        guards = (*(wj.Guard(one, wj.SECTION) for one in near), *flight.guards)
        return {"flight": flight._replace(guards=guards)}


def test_short_rises_and_kinks_within_long_steps_are_found():
    """A cosine exceeds cos(0.001) for 0.002, and the sawtooth 0.998 for 0.004."""
    starts = np.random.default_rng(0).uniform((0.1, 0.1), (4, 8.9), (80, 2))
    starts = starts[np.abs(starts[:, 1] - 2 * np.pi) > 1e-2]  # none begins within a rise
    begins, caught = starts[:, 1], 2 * starts[:, 0]
    first = np.where(begins < 2 * np.pi - 1e-3, 2 * np.pi - 1e-3, 9 - 2e-3)
    expected = np.minimum(first - begins, caught)
    for one in np.unique(first):
        assert 10 < (expected < caught)[first == one].sum()
    assert 10 < (expected == caught).sum()
    for tolerance in TOLERANCES:
        found = wj.strides(ThrownAtTimes(), starts, solver=TSIT5, tolerance=tolerance)
        np.testing.assert_allclose(found.time, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("solver", [diffrax.Bosh3(), pytest.param(TSIT5, marks=SLOW)], ids=repr)
def test_conditions_that_turn_often_are_kept(solver):
    """cos(5 t) is below -0.995 for 0.04 around each odd multiple of pi / 5."""
    starts = np.random.default_rng(0).uniform((0.1, -5), (6, 5), (1000, 2))
    phases = 5 * (starts[:, 1:] + 2 * starts[:, :1] * np.linspace(0, 1, 4001))
    negative = np.any(0.995 + np.cos(phases) < 0, axis=1)
    assert 10 < (~negative).sum()
    system = Thrown(condition=lambda s: 0.995 + jnp.cos(5 * s.t))
    for tolerance in 1e-3, 1e-9:
        found = wj.strides(system, starts, solver=solver, tolerance=tolerance)
        np.testing.assert_array_equal(found.outcome == Outcome.RUNNING, negative)


def test_a_time_that_does_not_converge_is_no_number():
    """From q = 0, p = 1 the place is sin t; it reaches 0.5 at pi / 6 and never 1.5."""
    method = Method(lambda state: (state[1], -state[0]), diffrax.Tsit5(), 1e-6)
    start, length = (jnp.array(0.0), jnp.array(1.0)), jnp.array(0.8)
    reach, series = lambda level: lambda state: state[0] - level, method.begin(start).series
    refine = lambda level: method.refine_time(reach(level), start, series, jnp.array(0.52), length)
    state = method.state_at(start, series, refine(0.5))
    assert refine(0.5) == pytest.approx(np.pi / 6, abs=1e-5)
    assert abs(state[0] - 0.5) < 1e-15
    assert np.isnan(refine(1.5)) and np.isnan(refine(0.9))


def test_a_landing_in_single_precision_by_another_solver():
    starts = np.random.default_rng(0).uniform((-3, 1), (3, 4), (100, 2)).astype(np.float32)
    expected = np.array([first_landing(x) for x in starts.astype(float)])
    found = wj.strides(wj.systems.BouncingBall(TABLE), starts, solver=TSIT5)
    assert found.state.dtype == np.float32
    np.testing.assert_allclose(found.time, expected, rtol=0, atol=1e-4)


@SLOW
def test_a_runner_in_single_precision_by_another_solver():
    starts = np.linspace(1.0, 2.2, 60, dtype=np.float32)[:, None]
    series = wj.strides(wj.systems.SpringMassRunner(), starts)
    found = wj.strides(wj.systems.SpringMassRunner(), starts, solver=TSIT5)
    np.testing.assert_array_equal(found.outcome, series.outcome)
    assert found.state.dtype == np.float32
    np.testing.assert_allclose(found.state, series.state, rtol=0, atol=1e-4)


def test_derivatives_at_the_landing_by_another_solver():
    """The landing time T of a ball on a table obeys depth(T, x) = 0, which gives dT/dx."""
    phase, speed = start = jnp.array([0.3, 2.5])
    land = lambda x: wj.stride(wj.systems.BouncingBall(TABLE), x, solver=TSIT5, tolerance=1e-9).time
    time = first_landing(np.asarray(start))
    rate = TABLE * np.cos(phase + time) - speed + time
    by_start = TABLE * (np.cos(phase + time) - np.cos(phase)), -time
    expected = [-float(one) / float(rate) for one in by_start]
    np.testing.assert_allclose(jax.jit(jax.jacfwd(land))(start), expected, rtol=1e-10)


def test_steps_keep_the_longest_step_and_the_scales_of_a_mode():
    """A push of 2 within 0.01 around t = 3 lifts the ball; a variable of 1e-9 doubles in time."""

    class Pushed(wj.HybridSystem):
        section = ("speed", "small")

        def lift(self, x):
            return Ball(0 * x[0], x[0], 0 * x[0]), x[1]

        def project(self, state):
            return jnp.stack([state[0].v, state[1]])

        def modes(self):
            def field(state):
                push = 2 * jnp.exp(-(((state[0].t - 3) / 5e-3) ** 2)) / (5e-3 * np.sqrt(np.pi))
                return Ball(state[0].v, push - 1, 1 + 0 * push), state[1] * jnp.cos(state[0].t)

            scales = (Ball(1.0, 1.0, 1.0), 1e-9)
            guard = wj.Guard(lambda state: -state[0].y, wj.SECTION)
            return {"flight": wj.Mode(field, (guard,), scales=scales, longest_step=5e-3)}

    found = wj.stride(Pushed(), jnp.array([2.5, 1e-9]), solver=TSIT5, tolerance=1e-8)
    # y = 2.5 t - t^2 / 2 + 2 (t - 3) after the push, which is symmetric
    expected = 4.5 + np.sqrt(4.5**2 - 12)
    assert found.time == pytest.approx(expected, abs=1e-6)
    assert found.state[1] == pytest.approx(1e-9 * np.exp(np.sin(expected)), rel=1e-6)


class TiltedSection(wj.HybridSystem):
    """A harmonic oscillator from a line at an angle, where it passes upward, to the line again.

    A point of the line lies on it to rounding only. The period is 2 pi. If the line is a failure's
    guard instead, the oscillator never comes to its section.
    """

    angle: Any = 0.7
    leads_to: str = eqx.field(static=True, default=wj.SECTION)

    section = ("place",)

    def normal(self):
        return jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)])

    def lift(self, x):
        first, second = self.normal()
        return 0.3 * self.normal() + x[0] * jnp.stack([-second, first])

    def project(self, state):
        first, second = self.normal()
        return (first * state[1] - second * state[0])[None]

    def modes(self):
        guard = wj.Guard(lambda s: self.normal() @ s - 0.3, self.leads_to)
        later = wj.Guard(lambda s: 0.3 - self.normal() @ s, wj.SECTION)
        guards = (guard,) if self.leads_to == wj.SECTION else (guard, later)
        return {"turn": wj.Mode(lambda s: jnp.stack([s[1], -s[0]]), guards)}


@pytest.mark.parametrize("solver", [None, diffrax.Dopri8()])
def test_a_stride_does_not_end_as_it_leaves_its_section(solver):
    places = np.random.default_rng(0).uniform(0.5, 4, (300, 1))
    start = jax.vmap(TiltedSection().lift)(jnp.asarray(places))
    values = start @ TiltedSection().normal() - 0.3
    assert (values < 0).sum() > 30 and (values > 0).sum() > 30 and np.abs(values).max() < 1e-14
    tolerance = None if solver is None else 1e-9
    found = wj.strides(TiltedSection(), places, solver=solver, tolerance=tolerance)
    np.testing.assert_array_equal(found.outcome, Outcome.STRIDE)
    np.testing.assert_allclose(found.time, 2 * np.pi, rtol=1e-12)
    np.testing.assert_allclose(found.state, places, rtol=1e-12)


def test_a_mode_does_not_fail_as_it_leaves_a_failures_guard():
    """It comes to the line again from above, after the time for the angle between both places."""
    places = np.random.default_rng(1).uniform(0.5, 4, (300, 1))
    found = wj.strides(TiltedSection(leads_to="FORWARD"), places)
    np.testing.assert_array_equal(found.outcome, Outcome.STRIDE)
    np.testing.assert_allclose(found.state, -places, rtol=1e-12)
    np.testing.assert_allclose(found.time, 2 * np.arctan2(places, 0.3)[:, 0], rtol=1e-12)
