"""An independent solution: equations typed anew, SciPy's DOP853, dense output, brentq."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from reference import DATA, read_values
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import walker_jax as wj
from walker_jax import Outcome, SimplestWalker

VALUES = read_values("values")
TABLE = VALUES["paper_table_1"]
GAIT = VALUES["gaits"][0]  # long, slope 0.009, with its Jacobian
EDGE = np.pi / 4


def strides(slope, xs):
    return wj.strides(SimplestWalker(slope), np.asarray(xs, float))


def outcomes(slope, xs):
    return [Outcome(code) for code in strides(slope, xs).outcome]


def dead_point_rate(slope, theta):
    """thetadot with just the energy to reach the top: thetadot^2 / 2 + cos(theta - slope) = 1."""
    return -np.sqrt(2 * (1 - np.cos(theta - slope)))


class Reference(NamedTuple):
    outcome: Outcome
    time: float = np.nan
    state: np.ndarray = np.full(2, np.nan)
    arrival: np.ndarray = np.full(4, np.nan)  # full state at heel strike
    depth: float = np.nan  # the most by which the swing foot turned back below h = 0, ahead
    turned: bool = True  # whether the swing leg ever turned back
    tension: bool = False  # whether the contact force was tensile at any time
    scuffs: int = 0  # times the foot passed h = 0 upwards beside or behind the stance foot


def on_section(x):
    theta, thetadot = x
    return np.array([theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot])


def motion(slope):
    def rates(t, y):
        a = y[0] - slope
        return [y[2], y[3], np.sin(a), np.sin(y[1]) * (y[2] ** 2 - np.cos(a)) + np.sin(a)]

    return rates


def terminal(function):
    function.terminal = True
    return function


def reference(slope, x):
    """One stride, from the section or a full state; the start must be feasible."""

    def compression(y):
        return np.cos(y[0]) * (np.cos(y[0] - slope) - y[2] ** 2)

    def h(y):
        return y[1] - 2 * y[0]

    y0 = on_section(x) if len(x) == 2 else np.asarray(x)
    if compression(y0) < 0:
        return Reference(Outcome.RUNNING)
    if y0[2] >= 0:
        return Reference(Outcome.BACKWARD)
    stands = terminal(lambda t, y: y[2])
    down = terminal(lambda t, y: y[0] + np.pi / 2)
    turns = lambda t, y: y[3] - 2 * y[2]
    solution = solve_ivp(
        motion(slope),
        (0, 100),
        y0,
        method="DOP853",
        rtol=1e-13,
        atol=1e-15,
        dense_output=True,
        max_step=0.1,
        events=[stands, down, turns],
    )
    at = solution.sol
    end = solution.t[-1]
    times = np.sort(np.concatenate([np.linspace(0, end, 2000), solution.t_events[2]]))
    states = at(times)
    heights = h(states)
    facts = {
        "depth": max([-h(at(t)) for t in solution.t_events[2] if at(t)[0] < 0], default=np.nan),
        "turned": len(solution.t_events[2]) > 0,
        "scuffs": 0,
    }
    for i in np.flatnonzero((heights[:-1] < 0) & (heights[1:] >= 0)):
        time, _ = brentq(lambda t: h(at(t)), times[i], times[i + 1], xtol=1e-15, full_output=True)
        arrival = at(time)
        if arrival[0] >= 0:
            facts["scuffs"] += 1
            continue
        tension = min(np.min(compression(states[:, :i])), compression(arrival)) < 0
        stopped = arrival[0] <= -EDGE
        outcome = Outcome.STOPPED if stopped else Outcome.STRIDE
        outcome = Outcome.RUNNING if tension else outcome
        following = np.array([-arrival[0], np.cos(2 * arrival[0]) * arrival[2]])
        return Reference(outcome, time, following, arrival, tension=tension, **facts)
    outcome = Outcome.BACKWARD if len(solution.t_events[0]) else Outcome.FORWARD
    tension = bool(np.min(compression(states)) < 0)
    return Reference(outcome, end, tension=tension, **facts)


def assert_equal_strides(slope, xs, tolerance=1e-10):
    """Those of `strides` and of the independent solution; returns the latter."""
    found = strides(slope, xs)
    expected = [reference(slope, x) for x in xs]
    assert [Outcome(code) for code in found.outcome] == [each.outcome for each in expected]
    for state, time, each in zip(found.state, found.time, expected, strict=True):
        if each.outcome == Outcome.STRIDE:
            np.testing.assert_allclose(state, each.state, atol=tolerance)
            assert time == pytest.approx(each.time, abs=tolerance)
        else:
            assert np.isnan([*state, time]).all()
    return expected


def reference_map(name):
    """Starts, outcomes and next states, (rows, columns, ...), and whether a boundary is near."""
    with np.load(DATA / name) as data:
        theta, other = data["theta"], data["sum" if "sum" in data else "thetadot"]
        first, second = np.meshgrid(theta, other, indexing="ij")
        starts = np.stack([first, second - first if "sum" in data else second], axis=-1)
        following = np.stack([data["next_theta"], data["next_velocity"]], axis=-1)
        return starts, data["outcome"], following


def following(z):
    """(theta, thetadot, time) of the next heel strike."""
    result = wj.stride(SimplestWalker(z[0]), z[1:])
    return jnp.append(result.state, result.time)
