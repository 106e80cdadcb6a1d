"""Raibert's hopper, against an integration with SciPy and closed forms of hopping in place."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import assert_gait, differences, newton
from graphs_by_scipy import through_graph
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

import walker_jax as wj

HOPPER = wj.systems.RaibertHopper()
NAMES = (
    "stiffness",
    "damping",
    "thrust",
    "thrust_rate",
    "stance_time",
    "gain",
    "desired_speed",
)
VALUES = {name: float(getattr(HOPPER, name)) for name in NAMES}
GUESS = 1.4, 0.6
WEAK = wj.systems.RaibertHopper(damping=4.0, thrust=0.01)
SLOW = wj.systems.RaibertHopper(thrust=0.2, thrust_rate=0.4)
"""Its foot leaves the ground before the motor has stopped."""


def event(function, direction=1):
    function.terminal, function.direction = True, direction
    return function


def stride_by_scipy(x, hopper=HOPPER):
    """The next apex, its time and the motor's work; the leg is a length and an angle."""
    k, c, thrust, rate, stance, gain, desired = (float(getattr(hopper, name)) for name in NAMES)
    apex, speed = x
    step = speed * stance / 2 + gain * (speed - desired)
    height = np.sqrt(1 - step**2)
    fall = np.sqrt(2 * (apex - height))
    push = lambda y: k * (1 + y[4] - y[0]) - c * y[2]

    def rates(motor):  # polar coordinates: r, angle from the vertical, their rates; motor and work
        return lambda _, y: [
            y[2],
            y[3],
            y[0] * y[3] ** 2 - np.cos(y[1]) + push(y),
            (np.sin(y[1]) - 2 * y[2] * y[3]) / y[0],
            motor,
            k * (1 + y[4] - y[0]) * motor,
        ]

    sin, cos = -step, height
    y = np.array([1, np.arctan2(sin, cos), speed * sin - fall * cos, 0, 0, 0])
    y[3] = speed * cos + fall * sin
    leaves = event(lambda _, y: push(y), -1)
    time, parts = fall, ((0, lambda _, y: y[2]), (rate, lambda _, y: y[4] - thrust), (0, leaves))
    for motor, end in parts:
        ends = [leaves, event(end)] if end is not leaves else [leaves]
        options: Any = {"rtol": 1e-13, "atol": 1e-13, "first_step": 1e-3}
        made = solve_ivp(rates(motor), (0, 20), y, "DOP853", events=ends, **options)
        which = next(i for i, one in enumerate(made.t_events) if one.size)
        y, time = made.y_events[which][0], time + made.t_events[which][0]
        if which == 0:
            break
    up = y[2] * np.cos(y[1]) - y[0] * y[3] * np.sin(y[1])
    forward = y[2] * np.sin(y[1]) + y[0] * y[3] * np.cos(y[1])
    return np.array([y[0] * np.cos(y[1]) + up**2 / 2, forward]), time + up, y[5]


HOPS = (HOPPER, (1.4, 0.6)), (HOPPER, (1.2, -0.3)), (HOPPER, (2.0, 0.1)), (SLOW, (1.3, 0.4))


@pytest.mark.parametrize(("hopper", "start"), HOPS)
def test_its_modes_make_the_hop_of_a_leg_with_a_motor(hopper, start):
    made, lasted, passed = through_graph(hopper)(start)
    state, time, _ = stride_by_scipy(start, hopper)
    np.testing.assert_allclose(made, state, atol=2e-11)
    np.testing.assert_allclose(lasted, time, atol=2e-11)
    assert ("extension" in passed) == (hopper is HOPPER)


@pytest.mark.slow
@pytest.mark.parametrize(("hopper", "start"), HOPS)
def test_a_stride_is_that_of_another_integration(hopper, start):
    made = wj.stride(hopper, start)
    state, time, _ = stride_by_scipy(start, hopper)
    assert made.outcome == wj.Outcome.STRIDE
    np.testing.assert_allclose(made.state, state, atol=2e-11)
    np.testing.assert_allclose(made.time, time, atol=2e-11)


@pytest.mark.slow
def test_the_foot_may_leave_before_the_motor_has_stopped():
    for hopper, extends in ((HOPPER, True), (SLOW, False)):
        times = np.asarray(wj.phase_times(hopper, (1.3, 0.4)))
        assert np.isfinite(times).tolist() == [True, True, True, extends, True]
        assert times[-1] == pytest.approx(float(wj.stride(hopper, (1.3, 0.4)).time), abs=1e-14)
    times = np.asarray(wj.phase_times(WEAK, (1.001, 0.0)))
    assert np.isfinite(times).tolist() == [True, True, True, False, False]  # as the motor is still


@pytest.mark.slow
def test_hopping_in_place_is_that_of_linear_equations():
    """Its stance is solved by exponentials of matrices, up to the times at which parts end."""
    k, c, thrust, rate, *_ = VALUES.values()
    equations = np.array([[0, 1, 0, 0], [-k, -c, k, k - 1], [0, 0, 0, 0], [0, 0, 0, 0]])
    after = lambda motor, y, t: (
        expm((equations + motor * np.outer([0, 0, 1, 0], [0, 0, 0, 1])) * t) @ y
    )
    first = lambda value, low, high: float(
        brentq(value, low, high, xtol=1e-15)  # pyright: ignore[reportArgumentType] (one number)
    )

    def next_apex(apex):
        y = np.array([1, -np.sqrt(2 * (apex - 1)), 0, 1])
        y = after(0, y, first(lambda t: after(0, y, t)[1], 0.1, 0.5))
        y = after(rate, y, thrust / rate)
        pull = lambda y: k * (1 + y[2] - y[0]) - c * y[1]
        y = after(0, y, first(lambda t: pull(after(0, y, t)), 0.1, 0.4))
        return y[0] + y[1] ** 2 / 2

    apex = first(lambda h: next_apex(h) - h, 1.1, 3.0)
    gait = wj.find_gait(wj.systems.RaibertHopper(desired_speed=0.0), [1.5, 0.0])
    np.testing.assert_allclose(gait.states[0], np.array([apex, 0]), atol=1e-12)
    slope = (next_apex(apex + 1e-4) - next_apex(apex - 1e-4)) / 2e-4
    assert np.abs(gait.multipliers - slope).min() < 1e-7


def test_without_damping_a_hop_gains_the_work_of_the_motor():
    hopper = wj.systems.RaibertHopper(damping=0.0)
    apex, speed = start = (1.3, 0.4)
    *_, work = stride_by_scipy(start, hopper)
    (after, forward), *_ = through_graph(hopper)(start)
    assert work > 0.05
    assert after + forward**2 / 2 - apex - speed**2 / 2 == pytest.approx(work, abs=1e-11)


@pytest.mark.slow
def test_hopping_is_stable():
    """By differences of strides."""
    states, multipliers = newton(HOPPER, GUESS, step=1e-3)
    assert np.abs(multipliers).max() < 1
    gait = SimpleNamespace(states=states, multipliers=multipliers)
    assert_gait(gait, lambda x: stride_by_scipy(x)[0], 1e-3, 1e-7)


@pytest.mark.slow
def test_hopping_is_found_alone_and_starts_around_it_return():
    gait = wj.find_gait(HOPPER)
    assert gait.stable
    assert_gait(gait, lambda x: stride_by_scipy(x)[0], 1e-3, 1e-7)
    np.testing.assert_allclose(gait.states, wj.find_gait(HOPPER, GUESS).states, atol=1e-11)
    grid = wj.Grid.plain(apex=(0.9, 3.0, 21), speed=(-1.5, 2.5, 20))
    data = wj.basin(HOPPER, grid, "direct")
    apex, speed = gait.states[0]
    assert data.attractor.sel(apex=apex, speed=speed, method="nearest") == 0
    assert {0, wj.Outcome.FORWARD, wj.Outcome.OUTSIDE} <= set(np.unique(data.fate))


@pytest.mark.slow
def test_derivatives_by_parameters_are_those_of_differences():
    values = np.array([*VALUES.values()])
    stride = jax.jit(lambda p: wj.stride(wj.systems.RaibertHopper(*p), jnp.array([1.4, 0.6])).state)
    expected = differences(lambda many: np.stack([*map(stride, many)]), values, np.full(7, 1e-3))
    np.testing.assert_allclose(jax.jacfwd(stride)(values), expected, rtol=1e-8, atol=1e-8)


def test_a_hopper_that_stays_on_the_ground_has_stopped():
    state, _, passed = through_graph(WEAK)((1.001, 0.0))
    assert passed[-1] == "STOPPED" and np.isnan(state).all()


@pytest.mark.slow
def test_a_stride_on_the_ground_ends_by_stopping():
    made = wj.stride(WEAK, (1.001, 0.0))
    assert made.outcome == wj.Outcome.STOPPED and np.isnan(made.state).all()


OUTSIDE = np.array([[0.9, 0.6], [1.4, 4.0], [np.nan, 0.6]])
"""Lower than a leg in front of it lands, faster than a leg of length 1 can step, and no start."""


def test_wrong_uses_are_refused():
    with pytest.raises(ValueError, match="thrust_rate must be finite and above 0, not 0"):
        wj.systems.RaibertHopper(thrust_rate=0.0)
    with pytest.raises(ValueError, match="damping must be finite and not negative, not -1"):
        wj.systems.RaibertHopper(damping=-1.0)
    assert not any(HOPPER.feasible(jnp.array(one)) for one in OUTSIDE)
    assert HOPPER.feasible(jnp.array(GUESS))


@pytest.mark.slow
def test_low_and_fast_starts_are_outside():
    assert wj.strides(HOPPER, OUTSIDE).outcome.tolist() == [wj.Outcome.OUTSIDE] * 3
