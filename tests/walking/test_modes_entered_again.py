"""A ball that bounces several times in a stride, and a block that sticks and slips again.

Flights are parabolas (g = 1): with the energy E = y + v^2 / 2 of the first flight, that of the one
after k bounces is e^(2k) E, and it lasts 2 e^k sqrt(2 E).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj


class Ball(NamedTuple):
    y: Any
    v: Any
    clock: Any


class Bouncer(wj.HybridSystem):
    """A ball under a ceiling, which is seen after a time; its impacts and its power have limits."""

    restitution: Any
    ceiling: Any
    time: Any = 5.0

    section = "y", "v"
    failures = "ceiling", "hard", "powerful"

    def lift(self, x):
        return Ball(x[0], x[1], 0 * x[0])

    def project(self, state):
        return jnp.stack([state.y, state.v])

    def modes(self):
        bounce = lambda s: s._replace(y=0 * s.y, v=-self.restitution * s.v)
        flight = wj.Mode(
            lambda s: Ball(s.v, 0 * s.v - 1, 1 + 0 * s.v),
            (
                wj.Guard(lambda s: s.y - self.ceiling, "ceiling"),
                wj.Guard(lambda s: -s.y, "flight", reset=bounce),
                wj.Guard(lambda s: s.clock - self.time, wj.SECTION),
            ),
            conditions=(
                wj.Condition(lambda s: 4 + s.v, "hard", least_at_ends=True),
                wj.Condition(lambda s: 4 + s.y * s.v, "powerful"),
            ),
            largest={"height": lambda s: s.y, "power": lambda s: s.y * s.v},
        )
        return {"flight": flight}


X = jnp.array([0.3, 0.6])
SMALL, LARGE = Bouncer(0.8, 3.0), Bouncer(1.25, 3.0)
"""Flights become smaller or larger; the stride ends as the ball rises, to the highest place of all
if flights become larger."""


def energy(x):
    return x[0] + x[1] ** 2 / 2


def bounces(system, x):
    """The times of bounces, and the speed after each."""
    speed, at = jnp.sqrt(2 * energy(x)), x[1] + jnp.sqrt(2 * energy(x))
    times, speeds = [], []
    while at < system.time:
        speed = system.restitution * speed
        times, speeds = [*times, at], [*speeds, speed]
        at = at + 2 * speed
    return times, speeds


def falling_energy(system, x):
    """The energy of the largest flight in which the ball falls."""
    _, speeds = bounces(system, x)
    k = 0 if system.restitution < 1 else len(speeds) - 1
    return system.restitution ** (2 * k) * energy(x)


def height(system, x):
    """The greatest height: that of an apex, or at the end."""
    (*_, begun), (*_, up) = bounces(system, x)
    passed = system.time - begun
    return jnp.maximum(falling_energy(system, x), up * passed - passed**2 / 2)


@pytest.mark.parametrize("system", [SMALL, LARGE], ids=["small", "large"])
def test_margins_are_the_least_of_all_flights(system):
    times, _ = bounces(system, X)
    assert len(times) > 1 and 0.1 < system.time - times[-1]
    assert (height(system, X) > falling_energy(system, X)) == (system is LARGE)

    def expected(x):
        most = falling_energy(system, x)
        fall = jnp.sqrt(2 * most / 3)  # y v is least there
        values = 3 - height(system, x), 4 - jnp.sqrt(2 * most), 4 - fall**3
        return dict(zip(system.failures, values, strict=True))

    found = wj.margins(system, X)
    assert found.stride.outcome == wj.Outcome.STRIDE and np.isnan(found.failed)
    gradient, by = jax.jacfwd(lambda x: wj.margins(system, x).by_name)(X), jax.jacfwd(expected)(X)
    for name, value in expected(X).items():
        assert found.by_name[name] == pytest.approx(float(value), abs=1e-12)
        np.testing.assert_allclose(gradient[name], by[name], atol=1e-11)


def test_a_failure_in_a_later_flight_has_its_margin():
    """The ceiling stops the second apex of growing flights: margins pass zero smoothly there."""
    second = float(1.25**2 * energy(X))
    for ceiling in (second - 0.01, second + 0.01):
        found = wj.margins(Bouncer(1.25, ceiling, 3.0), X)
        fails = ceiling < second
        assert found.stride.outcome == (wj.Outcome(12) if fails else wj.Outcome.STRIDE)
        assert found.by_name["ceiling"] == pytest.approx(ceiling - second, abs=1e-12)
        assert np.isnan(found.failed) != fails


def test_largest_values_are_those_of_all_flights():
    for system in (SMALL, LARGE):
        found, (*_, last) = wj.integrals(system, X), bounces(system, X)[1]
        assert found["height"] == pytest.approx(float(height(system, X)), abs=1e-12)
        most = last**2 / 2 if system is LARGE else energy(X)  # the ball begins below that place
        assert found["power"] == pytest.approx(float(2 * most / 3) ** 1.5, abs=1e-12)


def test_trajectories_and_times_of_modes_pass_all_flights():
    times, speeds = bounces(SMALL, X)
    at = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 4.9, 7.0, 8.0])  # the motion goes on at the section
    found = wj.trajectory(SMALL, X, at)
    long = Bouncer(0.8, 3.0, 9.0)
    times, speeds = bounces(long, X)
    last = np.searchsorted(times, at + 1e-12) - 1
    begun, up = np.array([0.0, *times])[last + 1], np.array([X[1], *speeds])[last + 1]
    passed, low = at - begun, np.where(last < 0, X[0], 0)
    np.testing.assert_allclose(found.y, low + up * passed - passed**2 / 2, atol=1e-12)
    np.testing.assert_allclose(found.v, up - passed, atol=1e-12)
    assert wj.phase_times(SMALL, X) == wj.stride(SMALL, X).time
    rates = jax.jacfwd(lambda t: wj.trajectory(SMALL, X, t[None]).y[0])(jnp.array(3.0))
    assert rates == pytest.approx(float(found.v[4]), abs=1e-12)


@pytest.mark.slow
def test_a_block_sticks_and_slips_again():
    """From the cycle's turn: on a circle about kinetic, then with the belt, and again."""
    system = wj.systems.StickSlip()
    speed, static, kinetic = (float(getattr(system, n)) for n in ("speed", "static", "kinetic"))
    d = static - kinetic
    radius, slip = np.hypot(d, speed), np.pi + np.arctan2(speed, d)
    period = slip + 2 * d / speed + np.arctan2(speed, d)
    x = jnp.array([kinetic + radius])
    np.testing.assert_allclose(
        wj.phase_times(system, x), [period, slip + 2 * d / speed, np.nan], atol=1e-12
    )
    times = np.linspace(0.1, 2.9, 15) * period
    found = wj.trajectory(system, x, times)
    part = times % period
    turns = np.where(part < slip, part, part - period)
    sticks = (slip < part) & (part < slip + 2 * d / speed)
    on_belt = 2 * kinetic - static + speed * (part - slip)
    expected = np.where(sticks, on_belt, kinetic + radius * np.cos(turns))
    assert 2 < sticks.sum() < 12
    np.testing.assert_allclose(found.x, expected, atol=1e-11)
    np.testing.assert_allclose(
        found.v, np.where(sticks, speed, -radius * np.sin(turns)), atol=1e-11
    )
