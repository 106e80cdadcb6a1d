"""Strides against an independent Runge-Kutta solution, the literature, and a 40-digit map."""

import re
import subprocess
import sys
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import DATA, read_values
from scipy.integrate import solve_ivp
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.optimize import brentq

import walker_jax as wj
from walker_jax import Outcome, SimplestWalker, State, Walker
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.walking.stride import follow_step

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


# An independent solution: equations typed anew, SciPy's DOP853, dense output, brentq


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


# Literature


@pytest.fixture(scope="module")
def walking():
    """A walk of 8 strides, of slope and x."""
    return jax.jit(lambda slope, x: wj.walk(SimplestWalker(slope), x, 8))


def test_walk_of_table_1_to_all_printed_digits(walking):
    """Schwab and Wisse (2001); the first row, printed rounded, is the start."""
    walk = walking(TABLE["slope"], jnp.array(TABLE["start"]))
    assert walk.states.shape == (9, 2) and walk.times.shape == (8,)
    assert np.all(walk.outcomes == Outcome.STRIDE) and np.all(walk.times > 2)
    np.testing.assert_array_equal(walk.states[0], TABLE["start"])
    np.testing.assert_allclose(walk.states[:, 0], TABLE["theta"], rtol=0, atol=5e-5)
    np.testing.assert_allclose(walk.states[1:, 1], TABLE["velocity"][1:], rtol=0, atol=5e-5)
    found = [[f"{value:.4f}" for value in state] for state in np.asarray(walk.states)[1:]]
    rows = zip(TABLE["theta"][1:], TABLE["velocity"][1:], strict=True)
    assert found == [[f"{theta:.4f}", f"{velocity:.4f}"] for theta, velocity in rows]


@pytest.mark.parametrize("gait", VALUES["gaits"], ids=lambda g: f"{g['kind']}-{g['slope']}")
def test_gaits_repeat_themselves(gait):
    result = strides(gait["slope"], [gait["state"]])
    assert result.outcome[0] == Outcome.STRIDE
    np.testing.assert_allclose(result.state[0], gait["state"], rtol=0, atol=1e-11)
    assert result.time[0] == pytest.approx(gait["step_time"], abs=1e-9)


def test_small_slopes_follow_their_expansion():
    """Garcia and others (1998): theta = T0 g^(1/3) + T1 g, thetadot = a theta + c1 g, leave
    terms of order g^(5/3); so the error of a stride from there."""
    long = VALUES["small_slope_expansion"]["long"]
    errors = []
    for slope in (1e-3, 1.25e-4):
        theta = long["T0"] * slope ** (1 / 3) + long["T1"] * slope
        x = np.array([theta, long["a"] * theta + long["c1"] * slope])
        result = strides(slope, [x])
        assert result.time[0] == pytest.approx(long["t0"] + long["t1"] * slope ** (2 / 3), abs=2e-3)
        errors.append(np.max(np.abs(result.state[0] - x)) / slope)
    assert errors[1] < 0.35 * errors[0] < 0.02


# The 40-digit maps


def reference_map(name):
    """Starts, outcomes and next states, (rows, columns, ...), and whether a boundary is near."""
    with np.load(DATA / name) as data:
        theta, other = data["theta"], data["sum" if "sum" in data else "thetadot"]
        first, second = np.meshgrid(theta, other, indexing="ij")
        starts = np.stack([first, second - first if "sum" in data else second], axis=-1)
        following = np.stack([data["next_theta"], data["next_velocity"]], axis=-1)
        return starts, data["outcome"], following


MAPS = {"strides_slope_0.004.npz": 0.004, "strides_slope_0.0165_plain.npz": 0.0165}


@pytest.mark.parametrize("name", MAPS)
def test_every_stride_of_the_reference_map(name):
    starts, outcome, following = (a.reshape(-1, *a.shape[2:]) for a in reference_map(name))
    result = strides(MAPS[name], starts)
    differs = np.flatnonzero(result.outcome != outcome)
    assert len(differs) <= 5
    for i in differs:  # only where a boundary passes within 1e-6
        around = starts[i] + 1e-6 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        assert outcome[i] in strides(MAPS[name], around).outcome
    walks = (outcome == Outcome.STRIDE) & (result.outcome == Outcome.STRIDE)
    assert np.max(np.abs(result.state[walks] - following[walks])) < 1e-9
    fails = result.outcome != Outcome.STRIDE
    assert np.isnan(result.state[fails]).all() and np.isnan(result.time[fails]).all()
    assert np.all(result.time[walks] > 1)
    assert result.outcome.dtype == np.int8


# How strides end


def test_starts_that_are_not_feasible_are_outside():
    """Whatever else is true of them: too steep and tensile, standing still."""
    points = [
        [EDGE, -0.2],
        [0.9, -1.5],
        [0.0, -0.2],
        [-0.1, -0.2],
        [0.2, 0.0],
        [0.2, 0.3],
        [np.nan, -0.2],
        [0.2, np.nan],
        [np.inf, -0.2],
        [0.2, -np.inf],
    ]
    result = strides(0.004, points)
    assert (result.outcome == Outcome.OUTSIDE).all()
    assert np.isnan(result.state).all() and np.isnan(result.time).all()


def test_starts_in_tension_are_running():
    """Q_v < 0 where thetadot^2 > cos(theta - slope); just less, and the walker falls forward."""
    for theta in (0.01, 0.3, 0.7):
        limit = -np.sqrt(np.cos(theta - 0.004))
        fast, slow = outcomes(0.004, [[theta, limit - 1e-12], [theta, limit + 1e-12]])
        assert (fast, slow) == (Outcome.RUNNING, Outcome.FORWARD)


@pytest.mark.parametrize("theta", [0.01, 0.1, 0.2, 0.4, 0.7])
def test_energy_at_the_dead_point_divides_backward_from_the_rest(theta):
    limit = dead_point_rate(0.004, theta)
    slower, faster = outcomes(0.004, [[theta, limit * (1 - 1e-9)], [theta, limit * (1 + 1e-9)]])
    assert slower == Outcome.BACKWARD
    assert faster in (Outcome.STRIDE, Outcome.FORWARD)


def test_a_walker_below_its_dead_point_falls_backward():
    """Even with hardly any motion; above the slope's vertical the leg never comes to the top."""
    starts = [[0.3, -1e-9], [0.3, -0.29], [0.7, -1e-300], [1e-3 + 0.004, -1e-6]]
    assert set(outcomes(0.004, starts)) == {Outcome.BACKWARD}


def test_a_fast_fall_has_no_turning_point():
    (fall,) = assert_equal_strides(0.0165, [[0.0033, -0.995]])
    assert fall.outcome == Outcome.FORWARD and not fall.turned


def test_a_slow_walker_swings_its_leg_several_times():
    slow = [0.011, -0.0071]
    (expected,) = assert_equal_strides(0.004, [slow])
    assert expected.time > 4.5
    result = strides(0.004, [slow])
    known = (0.0022160330448209114, -0.006328377026862729)
    np.testing.assert_allclose(result.state[0], known, rtol=0, atol=1e-13)


def test_close_to_the_dead_point_the_leg_swings_for_long():
    """Where the stance leg lingers at the top, the swing leg is back by the time it falls."""
    starts = [[0.2, dead_point_rate(0.004, 0.2) * (1 + 10.0**-k)] for k in range(3, 9)]
    expected = assert_equal_strides(0.004, starts, tolerance=1e-6)
    assert max(each.time for each in expected) > 15


@pytest.mark.parametrize(("slope", "theta"), [(0.004, 0.2), (0.004, 0.1), (0.009, 0.35)])
def test_a_walker_that_only_just_clears_the_floor(slope, theta):
    """On both sides of the boundary of falling forward, its depth goes to zero linearly."""
    xs = lambda sums: np.stack([np.full_like(sums, theta), sums - theta], axis=1)
    low, high = np.array([-0.06]), np.array([-0.005])
    assert outcomes(slope, xs(np.concatenate([low, high]))) == [Outcome.FORWARD, Outcome.STRIDE]
    for _ in range(6):  # a thousandfold at a time
        sums = np.linspace(low[0], high[0], 1001)
        last = np.flatnonzero(strides(slope, xs(sums)).outcome == Outcome.FORWARD)[-1]
        low, high = sums[last : last + 1], sums[last + 1 : last + 2]
    assert high - low < 1e-16
    distances = np.array([1e-10, 1e-9, 1e-7, 1e-5])
    beyond = assert_equal_strides(slope, xs(low - distances))
    within = assert_equal_strides(slope, xs(high + distances), tolerance=1e-7)
    assert {each.outcome for each in beyond} == {Outcome.FORWARD}
    assert {each.outcome for each in within} == {Outcome.STRIDE}
    gradient = within[-1].depth / distances[-1]
    np.testing.assert_allclose([each.depth for each in within], gradient * distances, rtol=0.05)
    np.testing.assert_allclose([each.depth for each in beyond], -gradient * distances, rtol=0.05)


def plain_cells(outcome):
    starts, outcomes, _ = reference_map("strides_slope_0.0165_plain.npz")
    return starts[outcomes == outcome]


def test_tension_at_the_strike_is_running_and_no_lift_is_stopped():
    runs = plain_cells(Outcome.RUNNING)
    runs = runs[runs[:, 1] ** 2 < np.cos(runs[:, 0] - 0.0165)]  # in compression at the start
    stops = plain_cells(Outcome.STOPPED)
    assert len(runs) >= 4 and len(stops) >= 3
    for each in assert_equal_strides(0.0165, runs):
        assert each.outcome == Outcome.RUNNING and each.tension and each.time > 1
    for each in assert_equal_strides(0.0165, stops):
        assert each.outcome == Outcome.STOPPED and not each.tension
        assert each.arrival[0] <= -EDGE


def test_running_comes_before_stopped():
    """Of strikes beyond pi/4, those in tension are running."""
    steep = np.linspace(0.70, 0.785, 12)
    xs = np.stack([np.repeat(steep, 15), np.tile(np.linspace(-0.83, -0.72, 15), 12)], axis=1)
    found = strides(0.0165, xs).outcome
    picked = np.concatenate([xs[found == code][:6] for code in (Outcome.RUNNING, Outcome.STOPPED)])
    expected = assert_equal_strides(0.0165, picked)
    both = [each for each in expected if each.arrival[0] <= -EDGE]
    assert {each.outcome for each in both} == {Outcome.RUNNING, Outcome.STOPPED}


def test_a_fall_in_tension_is_forward():
    """Any fall to theta = -pi/2 ends in tension, and is no running without a strike."""
    for each in assert_equal_strides(0.004, [[0.2, -0.6], [0.05, -0.9], [0.2, -0.23]]):
        assert each.outcome == Outcome.FORWARD and each.tension


def test_rest_at_the_top_is_an_outcome_too():
    """The slowest starts there are. Too slow to move at all in float64: there is no answer."""
    assert outcomes(0.004, [[0.004, -1e-300]]) == [Outcome.UNDECIDED]
    assert_equal_strides(0.004, [[1e-300, -1e-300], [0.2, -0.19569]], tolerance=1e-9)
    # From the top theta - slope = -1e-15 sinh(t), while the swing leg is a pendulum at rest.
    late, slowly = 14.0, 1e-15
    pendulum = solve_ivp(
        lambda t, y: [y[1], -np.sin(y[0])], (0, late), [0.008, 0.0], rtol=1e-13, atol=1e-16
    )
    phi, phidot = pendulum.y[:, -1]
    stance = 0.004 - slowly * np.sinh(late), -slowly * np.cosh(late)
    expected = reference(0.004, [stance[0], phi, stance[1], phidot])
    found = strides(0.004, [[0.004, -slowly]])
    assert found.outcome[0] == expected.outcome == Outcome.STRIDE
    assert found.time[0] == pytest.approx(late + expected.time, abs=1e-3)
    np.testing.assert_allclose(found.state[0], expected.state, rtol=0, atol=1e-6)


# What hardly ever happens, to a walker that is simple to follow


class PulledWalker(SimplestWalker):
    """Its stance leg topples, and its swing leg turns uniformly.

    The ground pulls at its foot while theta is within `width` of `at`: ever more towards `at`, or,
    where it `jumps`, as much all the time.
    """

    at: jax.Array
    width: jax.Array
    jumps: jax.Array
    force_least_at_ends: ClassVar = False

    def vector_field(self, state):
        none = jnp.zeros_like(state.theta)
        return State(state.thetadot, state.phidot, state.theta - self.slope, none)

    def contact_force(self, state):
        force = (state.theta - self.at) ** 2 - self.width**2
        force = jnp.where(self.jumps > 0, jnp.sign(force), force)
        return jnp.zeros_like(state.theta), force


LAUNCH = [0.2, 0.4, -0.2, -0.25]


def steps_down(starts, drop, at, width, jumps=0.0, tolerance=1e-12):
    """Steps down of such walkers, each pulled at a place of its own."""
    pulled = lambda at: PulledWalker(0.009, at, jnp.asarray(width), jnp.asarray(jumps))
    cells = jax.vmap(pulled)(jnp.asarray(at)), np.array(starts), np.full(len(starts), -drop)
    args = *cells, Integrator(np.float64(tolerance))
    return map_cells(follow_step, args, (True, True, True, False))


@pytest.mark.parametrize("tolerance", [1e-12, 1e-5])
def test_tension_is_seen_however_short_it_is(tolerance):
    """Within a single step of the integration too, and on the way down from the level."""
    lasts = []
    for drop in (0.0, 0.02):
        plain = steps_down([LAUNCH], drop, [0.0], 0.0, tolerance=tolerance)
        assert plain.outcome[0] == Outcome.STRIDE
        last = plain.state[0, 0] - plain.state[0, 1]  # theta of the leg that stood
        lasts.append(last)
        for width in (0.05, 3e-3, 1e-4):
            at = np.linspace(last - 0.1, 0.3, 81)
            pulls = (at + width > last) & (at - width < 0.2)
            close = np.minimum(np.abs(at + width - last), np.abs(at - width - 0.2)) < 1e-6
            found = steps_down(len(at) * [LAUNCH], drop, at, width, tolerance=tolerance).outcome
            expected = np.where(pulls, Outcome.RUNNING, Outcome.STRIDE)
            np.testing.assert_array_equal(found[~close], expected[~close])
            assert set(expected[~close]) == {Outcome.RUNNING, Outcome.STRIDE}
    # of the angles at which it was pulled, some were below the level alone
    assert lasts[1] < lasts[0] - 0.02


def test_tension_that_comes_and_goes_at_once_is_seen_at_the_ends_of_steps():
    """Of steps of the integration, and where the foot is level with the ground it stood on."""
    for drop in (0.0, 0.02):
        assert steps_down([LAUNCH], drop, [-0.04], 0.15, jumps=1.0).outcome == Outcome.RUNNING
    level = steps_down([LAUNCH], 0.0, [1.0], 0.0)
    level = level.state[:, 0] - level.state[:, 1]
    assert steps_down([LAUNCH], 0.02, level, 1e-6, jumps=1.0).outcome == Outcome.RUNNING
    assert steps_down([LAUNCH], 0.02, level + 1.0, 1e-6, jumps=1.0).outcome == Outcome.STRIDE


def test_a_leg_that_turns_right_round_strikes_no_lower_ground():
    """Its foot is there again where phi = 2 pi + ..., as if it were ahead."""
    whirling = [[-0.1, -0.205, -0.5, rate] for rate in np.linspace(6.0, 6.8, 9)]
    found = steps_down([LAUNCH, *whirling], 0.1, np.zeros(10), 0.0)
    assert found.outcome.tolist() == [Outcome.STRIDE] + 9 * [Outcome.FORWARD]


# Full states


def test_full_states_of_all_kinds_equal_the_independent_solution():
    """Launches and pushes, gentle and wild; among them scuffing, and every outcome."""
    rng = np.random.default_rng(0)
    signs = np.array([1.0, 1.0, -1.0, 1.0])
    wild = signs * rng.uniform([-1.3, -2.5, 0, -2.5], [1.3, 2.5, 1.6, 2.5], (40, 4))
    gentle = signs * rng.uniform([-0.4, -0.8, 0, -0.8], [0.4, 0.8, 0.5, 0.8], (60, 4))
    expected = assert_equal_strides(0.05, np.concatenate([gentle, wild]), tolerance=1e-9)
    counts = np.bincount([each.outcome for each in expected], minlength=4)
    assert np.all(counts[:4] > 5)


def test_scuffing_behind_and_beside_the_stance_foot_is_ignored():
    """h rises through zero with theta > 0, and later again with theta < 0."""
    starts = [
        [0.369, 0.693, -0.392, -0.04],
        [0.163, 0.325, -0.166, 0.064],
        [0.306, 0.567, -0.309, 0.238],
    ]
    for each in assert_equal_strides(0.004, starts):
        assert each.outcome == Outcome.STRIDE and each.scuffs == 1
        assert each.arrival[0] < 0


def test_a_foot_below_the_floor_ahead_at_the_start_strikes_where_it_comes_up():
    """A launch from h > 0: the leg must rise from below first."""
    starts = [[-0.1, -0.19, -0.2, -0.8], [-0.1, -0.19, -0.2, 0.5], [-0.1, -0.21, -0.2, 0.0]]
    fates = [each.outcome for each in assert_equal_strides(0.004, starts)]
    assert fates[2] == Outcome.STRIDE


def test_full_states_that_are_not_feasible():
    starts = {
        (1.6, 0.1, -0.1, 0.0): Outcome.OUTSIDE,
        (-np.pi / 2, 0.1, -0.1, 0.0): Outcome.OUTSIDE,
        (np.nan, 0.1, -0.1, 0.0): Outcome.OUTSIDE,
        (0.1, np.inf, -0.1, 0.0): Outcome.OUTSIDE,
        (0.1, 0.1, -0.1, np.nan): Outcome.OUTSIDE,
        (0.1, 0.1, 0.0, 0.0): Outcome.BACKWARD,
        (0.1, 0.1, 0.5, 0.0): Outcome.BACKWARD,
        (0.1, 0.1, 1.5, 0.0): Outcome.RUNNING,
        (0.1, 0.1, -1.5, 0.0): Outcome.RUNNING,
        (1.2, 2.4, -0.1, -0.1): Outcome.BACKWARD,  # beyond pi/4, but standing
    }
    assert outcomes(0.004, list(starts)) == list(starts.values())


# Trajectories


@pytest.fixture(scope="module")
def swing():
    """Times, and angles and rates, of the gait at slope 0.009."""
    times = np.linspace(0, GAIT["step_time"], 24)
    path = wj.trajectory(SimplestWalker(GAIT["slope"]), np.array(GAIT["state"]), times)
    return times, np.stack(path, axis=1)


def test_trajectory_equals_the_independent_solution(swing):
    times, states = swing
    solution = solve_ivp(
        motion(GAIT["slope"]),
        (0, times[-1]),
        on_section(GAIT["state"]),
        method="DOP853",
        rtol=1e-13,
        atol=1e-15,
        t_eval=times,
    )
    np.testing.assert_allclose(states, solution.y.T, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_trajectory_and_walk_are_the_same_under_jit(swing):
    """There XLA calls the programs."""
    times, states = swing
    walker, start = SimplestWalker(GAIT["slope"]), np.array(GAIT["state"])
    traced = jax.jit(wj.trajectory)(walker, start, times)
    np.testing.assert_allclose(np.stack(traced, axis=1), states, rtol=0, atol=2e-12)
    begin = np.array([0.2, -0.2])
    plain, traced = wj.walk(walker, begin, 8), jax.jit(wj.walk, static_argnums=2)(walker, begin, 8)
    np.testing.assert_array_equal(plain.outcomes, traced.outcomes)
    np.testing.assert_allclose(plain.states, traced.states, rtol=0, atol=1e-11)
    np.testing.assert_allclose(plain.times, traced.times, rtol=0, atol=1e-11)


def test_walk_is_nan_after_a_failure():
    """Whether it is traced or not, and its outcome stays that of the failure."""
    walker, start = SimplestWalker(0.004), np.array([0.2, -0.23])
    for found in (wj.walk(walker, start, 3), jax.jit(wj.walk, static_argnums=2)(walker, start, 3)):
        assert found.outcomes.tolist() == [Outcome.FORWARD] * 3
        assert found.outcomes.dtype == np.int8
        assert np.isnan(found.states[1:]).all() and np.isnan(found.times).all()


def test_trajectory_takes_times_in_any_order(swing):
    """Each state is integrated on its own."""
    walker, times = SimplestWalker(GAIT["slope"]), swing[0][[7, 2, 2, 0]]
    path = wj.trajectory(walker, np.array(GAIT["state"]), times)
    np.testing.assert_allclose(np.stack(path, axis=1), swing[1][[7, 2, 2, 0]], rtol=0, atol=2e-12)


def test_trajectory_keeps_the_energy_of_the_stance_leg(swing):
    theta, _, thetadot, _ = swing[1].T
    energy = thetadot**2 / 2 + np.cos(theta - GAIT["slope"])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-13)


def test_trajectory_ends_in_the_heel_strike(swing):
    """phi = 2 theta, and (22) leads back to its start."""
    theta, phi, thetadot, _ = swing[1][-1]
    assert phi == pytest.approx(2 * theta, abs=1e-11)
    following = (-theta, np.cos(2 * theta) * thetadot)
    np.testing.assert_allclose(following, GAIT["state"], rtol=0, atol=1e-11)


def test_a_stride_continues_from_any_state_within_it(swing):
    times, states = swing
    result = strides(GAIT["slope"], states[:-1])
    assert np.all(result.outcome == Outcome.STRIDE)
    np.testing.assert_allclose(result.state, np.tile(GAIT["state"], (23, 1)), rtol=0, atol=2e-11)
    np.testing.assert_allclose(result.time, GAIT["step_time"] - times[:-1], rtol=0, atol=1e-10)


def test_a_push_in_mid_stride(swing):
    """Of stance leg and swing leg, at several times."""
    states = swing[1][[3, 8, 12, 16]]
    pushes = [[0, 0, -0.02, 0], [0, 0, 0.02, 0], [0, 0, 0, 0.05], [0, 0, -0.3, 0]]
    pushed = np.concatenate([states + push for push in pushes])
    expected = assert_equal_strides(GAIT["slope"], pushed)
    found = {each.outcome for each in expected}
    assert {Outcome.STRIDE, Outcome.BACKWARD, Outcome.FORWARD} == found


# Walks


def test_nothing_follows_a_failure(walking):
    """At slope 0.004 from theta = 0.2 the walker takes some strides and falls."""
    starts, _, _ = reference_map("strides_slope_0.004.npz")
    with np.load(DATA / "strides_slope_0.004.npz") as data:
        fate, count = data["fate"], data["strides"]
    for failure in (Outcome.FORWARD, Outcome.BACKWARD):
        chosen = (fate == failure) & (count == 3)
        start = starts[chosen][len(starts[chosen]) // 2]
        walk = walking(0.004, jnp.array(start))
        assert walk.outcomes.tolist() == [0] * 3 + [failure] * 5
        assert np.isfinite(walk.states[:4]).all() and np.isnan(walk.states[4:]).all()
        assert np.isfinite(walk.times[:3]).all() and np.isnan(walk.times[3:]).all()
    walk = walking(0.004, jnp.array([0.2, 0.1]))
    assert set(walk.outcomes.tolist()) == {Outcome.OUTSIDE}
    np.testing.assert_array_equal(walk.states[0], [0.2, 0.1])
    assert np.isnan(walk.states[1:]).all()


def test_a_walk_is_stride_after_stride(walking):
    walk = walking(TABLE["slope"], jnp.array(TABLE["start"]))
    result = strides(TABLE["slope"], walk.states[:-1])
    np.testing.assert_allclose(result.state, walk.states[1:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.time, walk.times, rtol=0, atol=1e-12)


# Precision, wrong use, transformations


def test_float32_strides_are_those_of_float64_away_from_boundaries():
    starts, outcome, following = reference_map("strides_slope_0.004.npz")
    inner = minimum_filter(outcome, 7) == maximum_filter(outcome, 7)  # at least 3 cells, 6e-4
    starts, outcome, following = (a[inner][::7] for a in (starts, outcome, following))
    result = wj.strides(SimplestWalker(0.004), starts.astype(np.float32))
    assert result.state.dtype == result.time.dtype == np.float32
    np.testing.assert_array_equal(result.outcome, outcome)
    walks = outcome == Outcome.STRIDE
    assert set(outcome) == {0, 1, 2, 5} and np.sum(walks) > 500
    errors = np.abs(result.state[walks] - following[walks])
    assert np.max(errors) < 2e-5 and np.median(errors) < 1e-6


@pytest.mark.parametrize("shape", [(1,), (3,), (5,)], ids=str)
def test_starts_of_other_shapes_are_refused(shape):
    walker, start = SimplestWalker(0.004), np.full(shape, 0.1)
    calls = [
        lambda: wj.stride(walker, start),
        lambda: wj.strides(walker, start[None]),
        lambda: wj.walk(walker, start, 2),
        lambda: wj.trajectory(walker, start, np.ones(1)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=r"xs? must have shape") as error:
            call()
        assert str(error.value).endswith((f"not {shape}", f"not {(1, *shape)}"))


WRONG_USE = """
import numpy as np
import walker_jax as wj

walker = wj.SimplestWalker(0.004)
for shape in ((), (1, 2), (2, 2)):
    x = np.full(shape, 0.1)
    for call in (wj.stride, lambda w, x: wj.trajectory(w, x, [1.0]), lambda w, x: wj.walk(w, x, 2)):
        try:
            call(walker, x)
        except ValueError as error:
            print("shape" in str(error) and str(shape) in str(error))
for shape in ((2,), (2, 2, 2)):
    try:
        wj.strides(walker, np.full(shape, 0.1))
    except ValueError as error:
        print("shape" in str(error) and str(shape) in str(error))
"""


@pytest.mark.slow
def test_starts_of_other_dimensions_are_refused_without_checks_of_types():
    """In a process of its own, where nothing checks signatures."""
    done = subprocess.run([sys.executable, "-c", WRONG_USE], capture_output=True, text=True)
    assert done.stdout.split() == ["True"] * 11, done.stderr


@pytest.mark.parametrize("tolerance", [0.0, 1e-18, -1.0, 1.0, np.nan])
def test_tolerances_that_cannot_be_held_are_refused(tolerance):
    walker, x = SimplestWalker(0.004), np.array([0.2, -0.2])
    calls = [
        lambda: wj.stride(walker, x, tolerance=tolerance),
        lambda: wj.strides(walker, x[None], tolerance=tolerance),
        lambda: wj.walk(walker, x, 2, tolerance=tolerance),
        lambda: wj.trajectory(walker, x, np.ones(1), tolerance=tolerance),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="tolerance"):
            call()


def test_other_dtypes_are_refused():
    with pytest.raises(ValueError, match="float16"):
        wj.stride(SimplestWalker(0.004), np.array([0.2, -0.2], np.float16))


def test_a_looser_tolerance_is_less_exact_but_not_by_much():
    starts = np.array([gait["state"] for gait in VALUES["gaits"] if gait["slope"] == 0.009])
    loose = wj.strides(SimplestWalker(0.009), starts, tolerance=1e-5)
    errors = np.abs(loose.state - starts)
    assert np.all(errors < 1e-4) and np.max(errors) > 1e-10


@pytest.mark.slow
def test_single_strides_equal_those_in_tiles_and_mapped(tangents):
    """Called as it is, in tiles, and jitted and mapped over slopes."""
    starts = np.array([[0.2, -0.2], [0.2, -0.25], [0.2, -0.1], [0.9, -0.1], GAIT["state"]])
    walker = SimplestWalker(0.009)
    tiled = strides(0.009, starts)
    mapped, _ = tangents(np.insert(starts, 0, 0.009, axis=1), np.zeros((5, 3)))
    np.testing.assert_allclose(mapped[:, :2], tiled.state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mapped[:, 2], tiled.time, rtol=0, atol=1e-12)
    assert set(tiled.outcome) == {0, 1, 2, 5}
    for i, start in enumerate(starts):
        single = wj.stride(walker, start)
        assert single.state.shape == (2,) and single.outcome.shape == single.time.shape == ()
        assert single.outcome == tiled.outcome[i] and single.outcome.dtype == jnp.int8
        np.testing.assert_allclose(single.state, tiled.state[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(single.time, tiled.time[i], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("rates", "found"),
    [
        (lambda s: jnp.sin(s.theta), "f64[]"),
        (lambda s: (s.thetadot, s.phidot, s.theta), "(f64[], f64[], f64[])"),
        (lambda s: [*s], "[f64[], f64[], f64[], f64[]]"),
        (lambda s: jnp.stack(s), "f64[4]"),
        (lambda s: s._replace(phi=jnp.stack(s)), "State(theta=f64[], phi=f64[4], "),
        (lambda s: None, "None"),
    ],
)
def test_a_vector_field_that_gives_no_state_is_refused(rates, found):
    class Own(SimplestWalker):
        def vector_field(self, state):
            return rates(state)

    expected = "the rates of its state, State(theta, phi, thetadot, phidot)"
    said = f"vector_field of Own must return {expected}, not {found}"
    for function in (
        lambda x: wj.stride(Own(0.004), x),
        lambda x: wj.margins(Own(0.004), x),
        lambda x: wj.trajectory(Own(0.004), x, jnp.array([1.0])),
        lambda x: wj.step_down(Own(0.004), x, 0.001),
    ):
        for call in (function, jax.jit(function)):
            with pytest.raises(ValueError, match=f"^{re.escape(said)}"):
                call(jnp.array([0.2, -0.21]))


class PatientWalker(Walker):
    """The simplest walker, watched to the end of every fall."""

    inner: SimplestWalker
    section: ClassVar = SimplestWalker.section

    def __init__(self, slope):
        self.inner = SimplestWalker(slope)

    def lift(self, x):
        return self.inner.lift(x)

    def project(self, state):
        return self.inner.project(state)

    def feasible(self, x):
        return self.inner.feasible(x)

    def gait_region(self):
        return self.inner.gait_region()

    def vector_field(self, state):
        return self.inner.vector_field(state)

    def contact_force(self, state):
        return self.inner.contact_force(state)

    def contact(self, state):
        return self.inner.contact(state)

    def past_contact(self, state):
        return state.theta > jnp.inf

    def impact(self, state):
        return self.inner.impact(state)

    def clearance(self, state):
        return self.inner.clearance(state)

    def reach(self, state):
        return self.inner.reach(state)

    def exchange_legs(self, state):
        return self.inner.exchange_legs(state)


@pytest.mark.slow
def test_no_outcome_depends_on_when_a_fall_is_given_up():
    starts, outcome, _ = reference_map("strides_slope_0.0165_plain.npz")
    patient = wj.strides(PatientWalker(0.0165), starts.reshape(-1, 2))
    np.testing.assert_array_equal(patient.outcome, outcome.ravel())
    rng = np.random.default_rng(4)
    wild = rng.uniform([-1.5, -3, -1.6, -3], [1.5, 3, 0, 3], (4000, 4))
    patient = wj.strides(PatientWalker(0.0165), wild)
    np.testing.assert_array_equal(patient.outcome, strides(0.0165, wild).outcome)


# Derivatives with respect to z = (slope, theta, thetadot)


def following(z):
    """(theta, thetadot, time) of the next heel strike."""
    result = wj.stride(SimplestWalker(z[0]), z[1:])
    return jnp.append(result.state, result.time)


@pytest.fixture(scope="module")
def tangents():
    """`following` at each of any number of points, and its derivative along a direction each."""
    batch = 128
    run = jax.jit(jax.vmap(lambda z, v: jax.jvp(following, (z,), (v,))))

    def along(points, directions):
        values, slopes = [], []
        for i in range(0, len(points), batch):
            part, direction = points[i : i + batch], directions[i : i + batch]
            missing = ((0, batch - len(part)), (0, 0))
            value, slope = run(np.pad(part, missing, "edge"), np.pad(direction, missing, "edge"))
            values.append(value[: len(part)])
            slopes.append(slope[: len(part)])
        return np.concatenate(values), np.concatenate(slopes)

    return along


def jacobian(tangents, z):
    """d following / d z, (3, 3)."""
    return tangents(np.tile(z, (3, 1)), np.eye(3))[1].T


def differences(function, z, scale):
    """d function / d z by central differences, extrapolated to step 0 thrice (Richardson)."""
    steps = scale * 0.5 ** np.arange(4)
    points = [z + sign * h * e for e in np.eye(3) for h in steps for sign in (1, -1)]
    values = function(np.array(points)).reshape(3, 4, 2, -1)
    table = (values[:, :, 0] - values[:, :, 1]) / (2 * steps[:, None])
    for power in (4, 16, 64):
        table = (power * table[:, 1:] - table[:, :-1]) / (power - 1)
    return table[:, 0].T


def test_jacobian_of_the_gait_is_the_reference(tangents):
    z = np.array([GAIT["slope"], *GAIT["state"]])
    found = jacobian(tangents, z)[:2, 1:]
    np.testing.assert_allclose(found, GAIT["jacobian"], rtol=0, atol=1e-8)


def test_multipliers_of_the_gaits_are_the_reference(tangents):
    for gait in VALUES["gaits"]:
        found = jacobian(tangents, np.array([gait["slope"], *gait["state"]]))[:2, 1:]
        multipliers = np.sort_complex(np.linalg.eigvals(found))
        expected = np.sort_complex(np.array(gait["multipliers"]) @ [1, 1j])
        np.testing.assert_allclose(multipliers, expected, rtol=0, atol=2e-9)


def test_gait_follows_the_slope_as_in_the_reference(tangents):
    """x = S(x, slope): dx/dslope = (1 - dS/dx)^-1 dS/dslope."""
    known = VALUES["gait_slope_derivative"]
    derivatives = jacobian(tangents, np.array([GAIT["slope"], *GAIT["state"]]))[:2]
    found = np.linalg.solve(np.eye(2) - derivatives[:, 1:], derivatives[:, 0])
    np.testing.assert_allclose(found, known["d_state_d_slope"], rtol=0, atol=6e-6)


# z, and the length over which its stride changes: its distance to the nearest boundary
POINTS = {
    "gait": ((GAIT["slope"], *GAIT["state"]), 4e-4),
    "table": ((0.004, 0.2, -0.21645), 4e-4),
    "tiny": ((0.004, 0.011, -0.0071), 1e-5),
    "nearly backward": ((0.004, 0.2, dead_point_rate(0.004, 0.2) - 2e-6), 1e-7),
    "backward": ((0.0165, 0.5, dead_point_rate(0.0165, 0.5) - 1e-5), 5e-7),
    "only just clear": ((0.004, 0.2, -0.21818277212359), 5e-8),
    "steep": ((0.0165, 0.7, -0.70), 2e-4),
}


@pytest.mark.parametrize("name", POINTS)
def test_derivatives_equal_extrapolated_differences(name, tangents):
    """Of next state and time, by slope and start, relative to the largest of a row."""
    z, scale = POINTS[name]
    found = jacobian(tangents, np.array(z))
    expected = differences(lambda zs: tangents(zs, zs)[0], np.array(z), scale)
    assert np.isfinite(found).all()
    errors = np.abs(found - expected) / np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(errors) < 1e-7, (found, expected)


def test_derivatives_grow_as_the_boundaries_are_neared(tangents):
    """The points above are near enough to matter."""
    sizes = {
        name: np.max(np.abs(jacobian(tangents, np.array(POINTS[name][0]))[:2]))
        for name in ("gait", "nearly backward", "only just clear")
    }
    assert sizes["gait"] < 10
    assert sizes["nearly backward"] > 1e3 and sizes["only just clear"] > 100


@pytest.mark.slow
def test_jacfwd_is_the_same_derivative(tangents):
    z = jnp.array([GAIT["slope"], *GAIT["state"]])
    found = jax.jit(jax.jacfwd(following))(z)
    np.testing.assert_allclose(found, jacobian(tangents, np.asarray(z)), rtol=1e-10)
    np.testing.assert_allclose(found[:2, 1:], GAIT["jacobian"], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_second_derivatives_equal_differences_of_the_first(tangents):
    z = np.array([GAIT["slope"], *GAIT["state"]])

    @jax.jit
    def second(z, v, w):
        along = lambda z: jax.jvp(following, (z,), (v,))[1]
        return jax.jvp(along, (z,), (w,))[1]

    for v in np.eye(3):
        first = lambda zs, v=v: tangents(zs, np.tile(v, (len(zs), 1)))[1]
        expected = differences(first, z, 4e-4)
        found = np.stack([second(z, v, w) for w in np.eye(3)], axis=1)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


# A heel strike on lower ground


def test_a_step_down_is_what_the_motion_of_the_feet_gives():
    """By Runge-Kutta, and from velocities of hip and feet in the plane."""
    slope, x = 0.009, np.array([0.2, -0.2])
    walker = SimplestWalker(slope)
    full = np.array([0.2, 0.4, -0.2, (1 - np.cos(0.4)) * -0.2])

    def field(t, y):
        theta, phi, thetadot, phidot = y
        swing = np.sin(phi) * (thetadot**2 - np.cos(theta - slope)) + np.sin(theta - slope)
        return [thetadot, phidot, np.sin(theta - slope), swing]

    for drop in (0.0, 1e-4, 2e-3, 0.02):
        found = wj.step_down(walker, x, drop)
        assert found.outcome == Outcome.STRIDE
        time = float(found.time)
        before = solve_ivp(field, (0, time), full, rtol=1e-13, atol=1e-13, method="DOP853").y[:, -1]
        theta, phi, thetadot, _ = before
        foot = np.cos(theta) - np.cos(theta - phi)
        assert foot == pytest.approx(-drop, abs=1e-11)
        across = lambda angle: np.array([-np.cos(angle), -np.sin(angle)])
        stance = theta - phi
        rate = thetadot * across(theta) @ across(stance)  # the hip's velocity across the new leg
        trailing = rate * across(stance) @ across(theta)  # the old foot's across its leg is zero
        expected = stance, -phi, rate, rate - trailing
        np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-10)
    level = wj.stride(walker, x)
    flat = wj.step_down(walker, x, 0.0)
    np.testing.assert_allclose(flat.state[jnp.array([0, 2])], level.state, rtol=0, atol=1e-13)
    assert float(flat.state[1] - 2 * flat.state[0]) == pytest.approx(0, abs=1e-13)
    assert float(flat.time) == pytest.approx(float(level.time), abs=1e-12)


def test_a_step_down_by_nothing_is_a_stride_from_anywhere():
    """Legs that pass each other, and feet that never clear the slope, strike no lower ground."""
    walker = jax.tree.map(np.asarray, SimplestWalker(0.004))
    starts = np.random.default_rng(1).uniform([0.01, -0.8], [np.pi / 4, -0.01], (4000, 2))
    level = wj.strides(walker, starts)
    for drop in (0.0, 1e-9):
        drops = np.full(len(starts), drop)
        down = map_cells(
            follow_step,
            (walker, starts, -drops, Integrator(np.float64(1e-12))),
            (False, True, True, False),
        )
        np.testing.assert_array_equal(down.outcome, level.outcome)
        np.testing.assert_allclose(down.time, level.time, rtol=0, atol=1e-6)
        np.testing.assert_allclose(down.state[:, 0], level.state[:, 0], rtol=0, atol=1e-6)
    assert {0, 1, 2} <= set(level.outcome.tolist())


def test_an_impulse_changes_the_momentum_also_on_lower_ground():
    walker = SimplestWalker(0.009)
    state = State(*map(jnp.asarray, (-0.21, -0.4, -0.2, 0.1)))
    (_, _), after = walker.impact(state)
    across = lambda angle: np.array([-np.cos(angle), -np.sin(angle)])
    before = float(state.thetadot) * across(float(state.theta))
    swing = float(state.theta - state.phi)
    change = float(after.thetadot - after.phidot) * across(swing) - before
    np.testing.assert_allclose(np.array(walker.impulse(state)), change, rtol=0, atol=1e-15)


def test_a_step_down_may_fail():
    walker = SimplestWalker(0.009)
    assert wj.step_down(walker, np.array([0.2, -0.2]), 0.9).outcome == Outcome.FORWARD
    assert wj.step_down(walker, np.array([0.2, -0.1]), 1e-3).outcome == Outcome.BACKWARD
    assert np.isnan(wj.step_down(walker, np.array([0.2, -0.1]), 1e-3).state).all()


@pytest.mark.slow
def test_a_step_down_has_derivatives():
    walker = SimplestWalker(0.009)
    state = lambda z: wj.step_down(walker, z[:2], z[2]).state
    z, width = jnp.array([0.2, -0.2, 1e-3]), 1e-4
    jacobian = jax.jit(jax.jacfwd(state))(z)
    step = lambda i, h: (state(z.at[i].add(h)) - state(z.at[i].add(-h))) / (2 * h)
    for i in range(3):
        central = (4 * step(i, width / 2) - step(i, width)) / 3
        np.testing.assert_allclose(jacobian[:, i], central, rtol=0, atol=1e-7)
