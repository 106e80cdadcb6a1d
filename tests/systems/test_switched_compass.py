"""The compass gait with a torque that jumps, against equations of motion written out here, and
SciPy's DOP853."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import assert_gait, differences, multipliers_of, stacked
from cells_of_basins import check_cells
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.switched_compass import CompassState, after_strike

NAMES = "slope leg_mass com_from_hip torque switch_angle".split()
DRIVEN = wj.systems.SwitchedCompass(0.04)


# A reference, in the angles s and n of stance and swing leg from the vertical


def accelerations(p, y, torque):
    s, n, sdot, ndot = y
    m, b = p["leg_mass"], p["com_from_hip"]
    a, coupling = 1 - b, m * b
    matrix = [
        [m * a**2 + 1 + m, -coupling * np.cos(s - n)],
        [-coupling * np.cos(s - n), m * b**2],
    ]
    turning = coupling * np.sin(s - n)
    right = [
        (m * a + 1 + m) * np.sin(s) + turning * ndot**2 - torque,
        -coupling * np.sin(n) - turning * sdot**2 + torque,
    ]
    return np.linalg.solve(matrix, right)


def leg(angle):
    return np.array([-np.sin(angle), np.cos(angle)])


def across(angle):
    """The derivative of `leg`."""
    return -np.array([np.cos(angle), np.sin(angle)])


def points(p, y):
    """Masses, places and velocities of stance leg, hip and swing leg, the stance foot at 0."""
    s, n, sdot, ndot = y
    m, b = p["leg_mass"], p["com_from_hip"]
    places = np.array([(1 - b) * leg(s), leg(s), leg(s) - b * leg(n)])
    hip = sdot * across(s)
    return np.array([m, 1, m]), places, np.array([(1 - b) * hip, hip, hip - b * ndot * across(n)])


def normal_force(p, y, torque):
    """From Newton's law for all, along the normal of the slope."""
    s, n, sdot, ndot = y
    sddot, nddot = accelerations(p, y, torque)
    m, b = p["leg_mass"], p["com_from_hip"]
    of_hip = sddot * across(s) - sdot**2 * leg(s)
    of_swing = of_hip - b * (nddot * across(n) - ndot**2 * leg(n))
    force = m * (1 - b) * of_hip + of_hip + m * of_swing + (1 + 2 * m) * np.array([0, 1])
    return force @ [np.sin(p["slope"]), np.cos(p["slope"])]


def cross(r, v):
    return r[..., 0] * v[..., 1] - r[..., 1] * v[..., 0]


def momenta(p, y, foot, legs):
    """Angular momentum of all about a point, and of one leg about the hip."""
    masses, places, velocities = points(p, y)
    whole = masses @ cross(places - foot, velocities)
    return np.array([whole, masses[legs] * cross(places[legs] - places[1], velocities[legs])])


def strike(p, y):
    """(s, n) and rates on the other leg, by angular momentum of all about the new foot, and of the
    leg that stood about the hip."""
    s, n, _, _ = y
    before = momenta(p, y, leg(s) - leg(n), 0)
    after = lambda *rates: momenta(p, [n, s, *rates], np.zeros(2), 2)
    return n, s, *np.linalg.solve(np.stack([after(1, 0), after(0, 1)], axis=1), before)


def event(value, terminal=True):
    value.terminal, value.direction = terminal, 1
    return value


def reference(walker, x, samples=1):
    """A stride from (theta, thetadot, phidot): the next of these, the outcome and the time.

    It is `RUNNING` where the normal force is below zero at one of the samples in each mode.
    """
    p = {name: float(vars(walker)[name]) for name in NAMES}
    gamma, nothing = p["slope"], np.full(3, np.nan)
    y, time, force = np.array([x[0] - gamma, -x[0] - gamma, x[1], x[1] - x[2]]), 0.0, []
    force.append(normal_force(p, y, p["torque"] if x[0] > p["switch_angle"] else 0.0))
    if force[0] < 0:
        return nothing, Outcome.RUNNING, np.nan
    stops = event(lambda t, y: y[2])
    falls = event(lambda t, y: -np.pi / 2 - y[0] - gamma)
    switches = event(lambda t, y: p["switch_angle"] - y[0] - gamma)
    strikes = event(lambda t, y: -y[0] - y[1] - 2 * gamma, terminal=False)
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}

    def follow(y, torque, *events):
        field = lambda t, y: [*y[2:], *accelerations(p, y, torque)]
        return solve_ivp(field, (0, 200), y, events=events, **options)

    def least(run, torque, until):
        times = np.linspace(0, until, samples)
        return min((normal_force(p, y, torque) for y in run.sol(times).T), default=0.0)

    if x[0] > p["switch_angle"]:
        run = follow(y, p["torque"], stops, switches)
        if len(run.t_events[0]):
            return nothing, Outcome.BACKWARD, np.nan
        y, time = run.y_events[1][0], run.t[-1]
        force.append(least(run, p["torque"], run.t[-1]))
    run = follow(y, 0.0, stops, falls, strikes)
    ahead = [i for i, y in enumerate(run.y_events[2]) if y[0] < y[1]]
    if not ahead:
        outcome = Outcome.BACKWARD if len(run.t_events[0]) else Outcome.FORWARD
        return nothing, outcome, np.nan
    until = run.t_events[2][ahead[0]]
    force.append(least(run, 0.0, until))
    if min(force) < 0:
        return nothing, Outcome.RUNNING, np.nan
    s, _, sdot, ndot = strike(p, run.y_events[2][ahead[0]])
    outcome = Outcome.STRIDE if sdot < 0 else Outcome.BACKWARD
    outcome = outcome if -ndot > sdot else Outcome.STOPPED  # else the trailing foot lifts
    return np.array([s + gamma, sdot, sdot - ndot]), outcome, time + until


@cache
def gaits():
    """The unstable and the stable one."""
    return wj.find_gaits(DRIVEN)


# Gaits


@pytest.mark.slow
def test_gaits_are_those_of_the_reference():
    assert [bool(gait.stable) for gait in gaits()] == [False, True]
    for gait in gaits():
        assert gait.states[0, 0] > DRIVEN.switch_angle
        _, outcome, time = reference(DRIVEN, gait.states[0])
        assert outcome == Outcome.STRIDE
        assert gait.step_times[0] == pytest.approx(time, abs=1e-10)
        assert_gait(gait, lambda x: reference(DRIVEN, x)[0], 1e-3, 2e-9)


@pytest.mark.slow
def test_the_stable_gait_has_these_numbers():
    known = [0.250711229952, -0.329106355024, -0.202455043526]
    np.testing.assert_allclose(gaits()[1].states[0], known, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_without_a_torque_it_is_the_walker_with_point_feet():
    """Whose section leaves out phidot, as the foot that lifts moves along its leg only."""
    known, walker = wj.PointFootWalker(0.01, 0.01), wj.systems.SwitchedCompass(0.01, 0.01, 1.0, 0.0)
    rng = np.random.default_rng(3)
    theta = rng.uniform(0.02, 0.3, 60)
    xs = np.stack([theta, -theta + rng.uniform(-0.04, 0.02, 60)], axis=1)
    lifted = lambda xs: np.column_stack([xs, (1 - np.cos(2 * xs[:, 0])) * xs[:, 1]])
    expected, found = wj.strides(known, xs), wj.strides(walker, lifted(xs))
    np.testing.assert_array_equal(found.outcome, expected.outcome)
    assert set(expected.outcome) == {0, 1, 2}
    walks = expected.outcome == Outcome.STRIDE
    states = lifted(expected.state[walks])
    np.testing.assert_allclose(found.state[walks], states, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.time[walks], expected.time[walks], rtol=0, atol=1e-10)

    axes = {"theta": (0.2, 0.21, 1), "thetadot": (-0.21, -0.2, 1), "phidot": (-0.02, -0.01, 1)}
    (gait,) = wj.find_gaits(walker, region=wj.Grid.plain(**axes))
    again = wj.strides(known, gait.states[:, :2])
    np.testing.assert_allclose(lifted(again.state), gait.states, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.time, gait.step_times, rtol=0, atol=1e-11)
    of_section = lambda xs: wj.strides(known, xs).state
    expected = multipliers_of(differences(of_section, gait.states[0, :2], np.full(2, 1e-4)))
    np.testing.assert_allclose(gait.multipliers, [*expected, 0], rtol=0, atol=1e-8)


def test_a_switch_angle_below_zero_is_refused():
    with pytest.raises(ValueError, match="switch_angle must be finite and not negative"):
        wj.systems.SwitchedCompass(0.04, switch_angle=-0.1)


# Strides


def test_strides_end_as_those_of_the_reference_do():
    rng = np.random.default_rng(0)
    lower, upper = (0, 0.05, 0.2, -0.1, 0), (0.1, 1, 1, 0.1, 0.4)
    walkers = [
        wj.systems.SwitchedCompass(*map(float, p)) for p in rng.uniform(lower, upper, (80, 5))
    ]
    theta, change, turn = rng.uniform((0.1, -0.25, -0.3), (0.5, 0.1, 0.3), (80, 3)).T
    xs = np.stack([theta, -1.1 * theta + change, turn], axis=1)
    xs[:12, 1] -= 0.9  # which fly
    feasible = xs[:, 2] > 2 * xs[:, 1]
    found = wj.strides(stacked(walkers), xs)
    np.testing.assert_array_equal(found.outcome == Outcome.OUTSIDE, ~feasible)
    checked = np.flatnonzero(feasible)
    expected = [reference(walkers[i], xs[i], samples=100) for i in checked]
    states, outcomes, times = (np.array(values) for values in zip(*expected, strict=True))
    outcome, state, time = (part[checked] for part in (found.outcome, found.state, found.time))
    # a strike that turns the walker back is BACKWARD in both
    np.testing.assert_array_equal(outcome, outcomes)
    assert set(outcomes) == {0, 1, 2, 3, 4}
    walks = outcome == Outcome.STRIDE
    before = xs[checked, 0] < [walkers[i].switch_angle for i in checked]
    assert min((walks & before).sum(), (walks & ~before).sum()) >= 5
    np.testing.assert_allclose(state[walks], states[walks], rtol=0, atol=1e-9)
    np.testing.assert_allclose(time[walks], times[walks], rtol=0, atol=1e-9)


class InOneMode(wj.systems.SwitchedCompass):
    """The same torque in one mode, whose field jumps."""

    def modes(self):
        first, swing = super().modes().values()

        def rates(state):
            on = state.theta > self.switch_angle
            choose = lambda one, other: jnp.where(on, one, other)
            return jax.tree.map(choose, first.rates(state), swing.rates(state))

        return {"swing": swing._replace(field=rates, rates_at=None)}


@pytest.mark.slow
def test_a_torque_that_jumps_needs_two_modes():
    """A step of the integration knows no jump within: without a mode of its own for the torque, it
    is seen and nothing is said of the stride."""
    x, from_the_start = gaits()[1].states[0] + 1e-3, 0.3  # above theta: it never acts
    kinds = [
        (kind(0.04), kind(0.04, switch_angle=from_the_start)) for kind in (type(DRIVEN), InOneMode)
    ]
    found, in_one = (wj.strides(stacked(walkers), np.stack([x, x])) for walkers in kinds)
    for i, walker in enumerate(kinds[0]):
        state, outcome, time = reference(walker, x)
        assert found.outcome[i] == outcome == Outcome.STRIDE
        np.testing.assert_allclose(found.state[i], state, rtol=0, atol=1e-11)
        assert found.time[i] == pytest.approx(time, abs=1e-11)
    np.testing.assert_array_equal(in_one.outcome, [Outcome.UNDECIDED, Outcome.STRIDE])
    np.testing.assert_allclose(in_one.state[1], found.state[1], rtol=0, atol=1e-11)


def energy(p, y):
    masses, places, velocities = points(p, y)
    return masses @ (np.sum(velocities**2, axis=1) / 2 + places[:, 1])


def change_of_energy(p, y, rates):
    along = lambda times: np.array([energy(p, y + time * rates) for (time,) in times])
    return differences(along, np.zeros(1), np.full(1, 0.05))[0, 0]


def test_energy_changes_by_the_work_of_the_torque_alone():
    p = {name: float(vars(DRIVEN)[name]) for name in NAMES}
    rng = np.random.default_rng(1)
    # angles of the legs from the vertical, of those from the normal and between the legs
    turned = np.array([[1, 0, 0, 0], [1, -1, 0, 0], [0, 0, 1, 0], [0, 0, 1, -1]])
    for numbers in rng.uniform(-1, 1, (4, 4)):
        state = CompassState(*map(jnp.asarray, numbers))
        y = turned @ numbers - p["slope"] * np.array([1, 1, 0, 0])
        torques = {"driven": DRIVEN.torque, "free": 0.0}
        assert DRIVEN.modes().keys() == torques.keys()
        for name, mode in DRIVEN.modes().items():
            rates = turned @ np.array(mode.rates(state))
            change = change_of_energy(p, y, rates)
            assert change == pytest.approx(-float(torques[name]) * numbers[3], abs=1e-12)


def test_a_strike_keeps_angular_momentum_about_foot_and_hip():
    p = {name: float(vars(DRIVEN)[name]) for name in NAMES}
    for theta, thetadot, phidot in np.random.default_rng(2).uniform(-1, 0, (5, 3)):
        numbers = [jnp.asarray(value) for value in (theta, 2 * theta, thetadot, phidot)]
        after = after_strike(DRIVEN, CompassState(*numbers))
        y = [theta - p["slope"], -theta - p["slope"], thetadot, thetadot - phidot]
        then = [float(after.theta), float(after.theta - after.phi)]
        then = [angle - p["slope"] for angle in then]
        then += [float(after.thetadot), float(after.thetadot - after.phidot)]
        np.testing.assert_allclose(then[:2], [y[1], y[0]], rtol=0, atol=1e-14)
        before = momenta(p, y, leg(y[0]) - leg(y[1]), 0)
        np.testing.assert_allclose(momenta(p, then, np.zeros(2), 2), before, rtol=0, atol=1e-13)


# Derivatives and basins


@pytest.mark.slow
def test_derivatives_of_ten_strides_are_those_of_differences():
    values = np.array([vars(DRIVEN)[name] for name in NAMES])
    x = gaits()[1].states[0] + 0.003 * np.array([1, -1, 1])
    z = np.concatenate([x, values])

    def after_ten(z):
        return wj.walk(wj.systems.SwitchedCompass(*z[3:]), z[:3], 10).states[-1, 0]

    slopes = jax.jit(jax.grad(after_ten))(jnp.asarray(z))

    def many(points):
        xs = points[:, :3]
        walkers = stacked(
            [wj.systems.SwitchedCompass(*map(float, values)) for values in points[:, 3:]]
        )
        for _ in range(10):
            xs = wj.strides(walkers, xs).state
        return xs[:, :1]

    expected = differences(many, z, np.full(len(z), 5e-4))[0]
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(slopes, expected, rtol=1e-7)


@pytest.mark.slow
def test_cells_of_the_basin_end_as_walks_do():
    gait = gaits()[1]
    at = dict(zip(DRIVEN.section, map(float, gait.states[0]), strict=True))
    grid = wj.Grid.through(at, theta=(0.05, 0.45, 20), thetadot=(-0.6, -0.1, 20))
    check_cells(DRIVEN, np.asarray(gait.states), grid)


@pytest.mark.slow
def test_a_branch_folds_and_doubles_where_the_reference_does():
    branch = wj.continue_gait(DRIVEN, "torque", (-0.1, 0.1), gaits()[1])
    (fold,), (doubling,) = branch.folds, branch.doublings
    assert fold.value < 0 < DRIVEN.torque < doubling.value
    for one, multiplier in (fold, 1.0), (doubling, -1.0):
        walker = wj.systems.SwitchedCompass(0.04, torque=float(one.value))
        following, _, _ = reference(walker, one.states[0])
        np.testing.assert_allclose(following, one.states[0], rtol=0, atol=1e-9)
        walk = lambda xs, walker=walker: np.array([reference(walker, x)[0] for x in xs])
        found = np.linalg.eigvals(differences(walk, one.states[0], np.full(3, 1e-3)))
        assert np.abs(found - multiplier).min() < 1e-7


@pytest.mark.slow
def test_the_unstable_gait_is_the_edge_state():
    unstable, stable = gaits()
    edge = wj.edge_state(DRIVEN, stable.states[0], np.array([0.2, -0.15, -0.1]))
    assert edge.kind == "saddle" and edge.saddle is not None
    np.testing.assert_allclose(edge.saddle.states, unstable.states, rtol=0, atol=1e-10)
    plane = [[1, 0, 0], [0, 1, 0]]
    least = wj.least_disturbance(DRIVEN, stable, along=np.array(plane), directions=64)
    assert least.size < np.linalg.norm(unstable.states[0] - stable.states[0])
    shares = np.array([1 - 1e-6, 1 + 1e-6])[:, None]
    xs = stable.states[0] + shares * (least.state - stable.states[0])
    for _ in range(200):
        found = wj.strides(DRIVEN, xs)
        xs = np.where(found.outcome[:, None] == Outcome.STRIDE, found.state, xs)
    np.testing.assert_array_equal(found.outcome, [Outcome.STRIDE, least.failure])
    np.testing.assert_allclose(xs[0], stable.states[0], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_best_torque_is_that_of_the_least_multiplier():
    best = wj.optimise(DRIVEN, {"torque": (0.0, 0.05)}, "spectral-radius", starts=1)
    torques = np.linspace(0, 0.05, 51)
    guess, radii = gaits()[1].states[0], []
    for torque in torques:
        gait = wj.find_gait(wj.systems.SwitchedCompass(0.04, torque=float(torque)), guess)
        guess = gait.states[0]
        radii.append(np.abs(gait.multipliers).max())
    assert float(best.value.min()) == pytest.approx(min(radii), abs=2e-3)
    assert float(best.value.min()) <= min(radii) + 1e-9
