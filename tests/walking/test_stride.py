"""Strides against an independent Runge-Kutta solution, the literature, and a 40-digit map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_strides import (
    EDGE,
    TABLE,
    VALUES,
    assert_equal_strides,
    dead_point_rate,
    outcomes,
    reference,
    reference_map,
    strides,
)
from scipy.integrate import solve_ivp

from walker_jax import Outcome, SimplestWalker, State
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.walking.stride import follow_stride

# Literature


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
def test_energy_at_the_dead_point_divides_falls_backward(theta):
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


def test_tension_at_the_strike_is_running_no_lift_is_stopped():
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
    """The slowest starts there are."""
    assert_equal_strides(0.004, [[1e-300, -1e-300], [0.2, -0.19569]], tolerance=1e-9)
    # From the top theta - slope = -slowly sinh(t), while the swing leg is a pendulum at rest.
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
    # Beside 0.004 an angle of 1e-300 is nothing, so rounding decides when this one leaves the top;
    # then it ends as the pendulum's phase has it.
    slowest = strides(0.004, [[0.004, -1e-300]])
    assert slowest.outcome[0] in (Outcome.STRIDE, Outcome.FORWARD)


# What hardly ever happens, to a walker that is simple to follow


class PulledWalker(SimplestWalker):
    """Its stance leg topples, and its swing leg turns uniformly.

    The ground pulls at its foot while theta is within `width` of `at`: ever more towards `at`, or,
    where it `jumps`, as much all the time.
    """

    at: jax.Array
    width: jax.Array
    jumps: jax.Array

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
    walkers, steps = jax.vmap(pulled)(jnp.asarray(at)), np.full(len(starts), -drop)
    args = walkers, np.array(starts), Integrator(np.float64(tolerance)), steps
    return map_cells(follow_stride, args, (True, True, False, True))


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


def test_tension_that_comes_and_goes_is_seen_at_ends_of_steps():
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


def test_full_states_equal_the_independent_solution():
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


def test_a_foot_below_the_floor_at_the_start_strikes_coming_up():
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
