"""The rimless wheel with a torso, against equations of motion written out here, and SciPy's
DOP853."""

from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import assert_gait, differences, newton, stacked
from cells_of_basins import check_cells
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.hybrid.modes import Mode
from walker_jax.multibody.single_support import SingleSupport
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.rimless_wheel import WheelState

NAMES = "slope alpha torso_mass torso_com torso_inertia stiffness damping lean".split()
LEVEL = wj.systems.TorsoWheel()
DOWNHILL = wj.systems.TorsoWheel(0.08, 0.3, 0.7, 0.4, 0.05, 2.0, 0.3, 0.1)
WHEELS = {"level": LEVEL, "downhill": DOWNHILL}
LEVEL_GAIT = [[-0.444569120151, 0.608648375889, 0.336953860588]]


# A reference, in angles from the vertical


def masses_of(p, s, psi):
    """Mass matrix of (s, psi) with the stance foot on the ground."""
    coupling = -p["torso_mass"] * p["torso_com"] * np.cos(s + psi)
    torso = p["torso_inertia"] + p["torso_mass"] * p["torso_com"] ** 2
    return np.array([[1 + p["torso_mass"], coupling], [coupling, torso]])


def accelerations(p, state):
    s, psi, sdot, psidot = state
    M, arm = p["torso_mass"], p["torso_mass"] * p["torso_com"]
    tau = p["stiffness"] * (p["lean"] - psi) - p["damping"] * psidot
    right = [(1 + M) * np.sin(s) + tau, arm * np.sin(psi) + tau]
    right -= arm * np.sin(s + psi) * np.array([psidot**2, sdot**2])
    return np.linalg.solve(masses_of(p, s, psi), right)


def normal_force(p, state):
    """From Newton's law for hub and torso together, along the normal of the slope."""
    s, psi, sdot, psidot = state
    sddot, psiddot = accelerations(p, state)
    M, arm = p["torso_mass"], p["torso_mass"] * p["torso_com"]
    hub = sddot * np.array([-np.cos(s), -np.sin(s)]) + sdot**2 * np.array([np.sin(s), -np.cos(s)])
    arm_turned = psiddot * np.array([np.cos(psi), -np.sin(psi)])
    arm_turned -= psidot**2 * np.array([np.sin(psi), np.cos(psi)])
    force = (1 + M) * (hub + np.array([0, 1])) + arm * arm_turned
    return force @ [np.sin(p["slope"]), np.cos(p["slope"])]


def strike(p, state):
    """Angular momentum of all about the new foot, and of the torso about the hub, is kept."""
    s, psi, sdot, psidot = state
    M, arm = p["torso_mass"], p["torso_mass"] * p["torso_com"]
    old, new = s, s + 2 * p["alpha"]
    hub = -sdot * np.array([np.cos(old), np.sin(old)])
    about_hub = masses_of(p, old, psi)[1] @ [sdot, psidot]
    across = -np.array([np.cos(new), np.sin(new)])
    momentum = (1 + M) * hub + arm * psidot * np.array([np.cos(psi), -np.sin(psi)])
    return np.linalg.solve(masses_of(p, new, psi), [across @ momentum, about_hub])


def reference(wheel, x, samples=1):
    """A stride from (thetadot, psi, psidot): the next of these, the outcome and the time.

    It is `RUNNING` where the normal force is below zero at one of the samples.
    """
    p = {name: float(vars(wheel)[name]) for name in NAMES}

    def event(value):
        value.terminal, value.direction = True, 1
        return value

    ends = [
        event(lambda t, y: y[2]),
        event(lambda t, y: -np.pi / 2 - y[1]),
        event(lambda t, y: y[1] - np.pi / 2),
        event(lambda t, y: -p["alpha"] - p["slope"] - y[0]),
    ]
    start = [p["alpha"] - p["slope"], x[1], x[0], x[2]]
    field = lambda t, y: [*y[2:], *accelerations(p, y)]
    run = solve_ivp(
        field, (0, 100), start, "DOP853", events=ends, rtol=1e-12, atol=1e-13, dense_output=True
    )
    (which,) = (i for i, times in enumerate(run.t_events) if len(times))
    end, time = run.y_events[which][0], run.t[-1]
    outcome = [Outcome.BACKWARD, Outcome.BACKWARD, Outcome.FORWARD, Outcome.STRIDE][which]
    sampled = run.sol(np.linspace(0, time, samples)).T
    least = min((normal_force(p, y) for y in sampled), default=0.0)
    if normal_force(p, start) < 0 or (outcome == Outcome.STRIDE and least < 0):
        return np.full(3, np.nan), Outcome.RUNNING, np.nan
    if outcome != Outcome.STRIDE:
        return np.full(3, np.nan), outcome, np.nan
    sdot, psidot = strike(p, end)
    outcome = outcome if sdot < 0 else Outcome.BACKWARD
    return np.array([sdot, end[1], psidot]), outcome, time


@cache
def gait_named(name):
    return wj.find_gait(WHEELS[name])


def gait_of(wheel):
    return gait_named(next(name for name, one in WHEELS.items() if one is wheel))


# Gaits


def test_a_gait_by_differences_is_that_of_the_reference():
    states, multipliers = newton(LEVEL, [-0.44, 0.61, 0.34], step=2e-3)
    np.testing.assert_allclose(states, LEVEL_GAIT, rtol=0, atol=1e-11)
    gait = SimpleNamespace(states=states, multipliers=multipliers)
    assert_gait(gait, lambda x: reference(LEVEL, x)[0], 2e-3, 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("wheel", WHEELS.values(), ids=WHEELS)
def test_gaits_are_those_of_the_reference(wheel):
    gait = gait_of(wheel)
    _, outcome, time = reference(wheel, gait.states[0])
    assert outcome == Outcome.STRIDE and gait.stable
    assert gait.step_times[0] == pytest.approx(time, abs=1e-11)
    assert_gait(gait, lambda x: reference(wheel, x)[0], 2e-3, 1e-9)


@pytest.mark.slow
def test_the_gait_on_level_ground_is_one_with_these_numbers():
    (gait,) = wj.find_gaits(LEVEL)
    np.testing.assert_allclose(gait.states, LEVEL_GAIT, rtol=0, atol=1e-11)
    known = [0.643845112371, -0.392150400913, -0.271893040444]
    np.testing.assert_allclose(gait.multipliers, known, rtol=0, atol=1e-10)


def test_a_torso_without_mass_leaves_the_closed_return_map():
    """thetadot -> -cos(2 alpha) sqrt(thetadot^2 + 4 sin(alpha) sin(slope)), from energy and (17).

    Slower than the dead point it rolls back, and faster than gravity holds it flies.
    """
    slope, alpha, rates = 0.1, 0.3, -np.linspace(0.02, 1.1, 60)
    bare = wj.systems.TorsoWheel(slope, alpha, 0.0, 0.5, 0.1, 0.0, 0.0, 0.0)
    found = wj.strides(bare, np.stack([rates, 0.2 + 0 * rates, 0 * rates], axis=1))
    expected = -np.cos(2 * alpha) * np.sqrt(rates**2 + 4 * np.sin(alpha) * np.sin(slope))
    slow = rates**2 < 2 * (1 - np.cos(alpha - slope))
    np.testing.assert_array_equal(found.outcome == Outcome.BACKWARD, slow)
    fast = (rates**2 > np.cos(alpha - slope)) | (  # at the start, or as the next spoke strikes
        rates**2 + 4 * np.sin(alpha) * np.sin(slope) > np.cos(alpha + slope)
    )
    np.testing.assert_array_equal(found.outcome == Outcome.RUNNING, fast)
    walks = found.outcome == Outcome.STRIDE
    assert min(walks.sum(), slow.sum(), fast.sum()) > 5
    np.testing.assert_allclose(found.state[walks, 0], expected[walks], rtol=1e-12)
    np.testing.assert_allclose(found.state[walks, 1:], [[0.2, 0.0]] * walks.sum(), atol=1e-14)


# Strides


def test_strides_end_as_those_of_the_reference_do():
    rng = np.random.default_rng(0)
    xs = rng.uniform((-1.3, -1.5, -2), (0, 1.5, 2), (60, 3))
    wheels = [
        wj.systems.TorsoWheel(*map(float, values))
        for values in rng.uniform(
            (0, 0.2, 0.2, 0.2, 0.05, 0, 0, 0), (0.2, 0.5, 2, 0.8, 0.3, 3, 1, 0.6), (60, 8)
        )
    ]
    found = wj.strides(stacked(wheels), xs)
    expected = [reference(wheel, x, samples=200) for wheel, x in zip(wheels, xs, strict=True)]
    outcomes = [outcome for _, outcome, _ in expected]
    assert set(outcomes) == {0, 1, 2, 3}
    np.testing.assert_array_equal(found.outcome, outcomes)
    walks = found.outcome == Outcome.STRIDE
    states, _, times = (np.array(values) for values in zip(*expected, strict=True))
    np.testing.assert_allclose(found.state[walks], states[walks], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.time[walks], times[walks], rtol=0, atol=1e-9)


def energy(wheel, state):
    """From places and speeds of hub and torso."""
    hub = lambda s: jnp.stack([-jnp.sin(s), jnp.cos(s)])
    torso = lambda s, psi: hub(s) + wheel.torso_com * jnp.stack([jnp.sin(psi), jnp.cos(psi)])
    s, rates = state.theta - wheel.slope, (state.thetadot, state.psidot)
    _, of_hub = jax.jvp(hub, (s,), rates[:1])
    place, of_torso = jax.jvp(torso, (s, state.psi), rates)
    kinetic = of_hub @ of_hub + wheel.torso_mass * of_torso @ of_torso
    kinetic += wheel.torso_inertia * state.psidot**2
    return kinetic / 2 + jnp.cos(s) + wheel.torso_mass * place[1]


def test_energy_changes_by_the_work_of_the_motor_alone():
    rng = np.random.default_rng(1)
    wheel = jax.tree.map(jnp.asarray, DOWNHILL)
    states = WheelState(*jnp.asarray(rng.uniform(-1, 1, (4, 50))))
    (mode,) = wheel.modes().values()
    change = lambda y: jax.jvp(lambda y: energy(wheel, y), (y,), (mode.rates(y),))[1]
    tau = wheel.stiffness * (wheel.lean - states.psi) - wheel.damping * states.psidot
    work = tau * (states.psidot + states.thetadot)
    np.testing.assert_allclose(jax.vmap(change)(states), work, rtol=0, atol=1e-13)


def angular_momenta(wheel, state, rates, foot):
    """About a foot of all, and about the hub of the torso, by cross products; the hub is at 0."""
    psi, (vx, vy, psidot) = state.psi, rates
    arm = wheel.torso_com * np.array([np.sin(psi), np.cos(psi)])
    hub, torso = np.array([vx, vy]), np.array([vx, vy])
    torso = torso + wheel.torso_com * psidot * np.array([np.cos(psi), -np.sin(psi)])
    cross = lambda r, v: r[0] * v[1] - r[1] * v[0]
    spin = -wheel.torso_inertia * psidot
    about_hub = wheel.torso_mass * cross(arm, torso) + spin
    return cross(-foot, hub) + wheel.torso_mass * cross(arm - foot, torso) + spin, about_hub


def test_a_strike_keeps_angular_momentum_about_foot_and_hub():
    rng = np.random.default_rng(2)
    wheel = DOWNHILL
    for psi, thetadot, psidot in rng.uniform((-1, -1, -1), (1, 0, 1), (5, 3)):
        numbers = map(jnp.asarray, (-wheel.alpha, psi, thetadot, psidot))
        before = WheelState(*numbers)
        after = wheel.strike(before)
        assert after.theta == pytest.approx(float(wheel.alpha), abs=1e-15)
        s = after.theta - wheel.slope
        foot = np.array([np.sin(s), -np.cos(s)])
        kept = []
        for state in before, after:
            s = state.theta - wheel.slope
            hub = -state.thetadot * np.array([np.cos(s), np.sin(s)])
            kept.append(angular_momenta(wheel, state, (*hub, state.psidot), foot))
        np.testing.assert_allclose(*kept, rtol=0, atol=1e-14)
        drop = 2 * np.sin(wheel.alpha) * np.sin(wheel.slope)  # from foot to foot
        assert energy(wheel, after) - (1 + wheel.torso_mass) * drop < energy(wheel, before)


# Derivatives and basins


@pytest.mark.slow
def test_derivatives_of_ten_strides_are_those_of_differences():
    x = np.array([-0.5, 0.5, 0.2])
    values = np.array([vars(LEVEL)[name] for name in NAMES])

    def after_ten(z):
        return wj.walk(wj.systems.TorsoWheel(*z[3:]), z[:3], 10).states[-1, 0]

    z = jnp.concatenate([x, values])
    slopes = jax.jit(jax.grad(after_ten))(z)

    def many(points):
        xs = points[:, :3]
        wheels = stacked([wj.systems.TorsoWheel(*map(float, values)) for values in points[:, 3:]])
        for _ in range(10):
            xs = wj.strides(wheels, xs).state
        return xs[:, :1]

    expected = differences(many, np.asarray(z), np.full(len(z), 2e-3))[0]
    assert np.isfinite(slopes).all() and np.abs(slopes).min() > 1e-4
    np.testing.assert_allclose(slopes, expected, rtol=1e-7)


@pytest.mark.slow
def test_cells_of_the_basin_end_as_walks_do():
    gait = gait_of(LEVEL)
    at = dict(zip(LEVEL.section, map(float, gait.states[0]), strict=True))
    grid = wj.Grid.through(at, thetadot=(-1, 0, 20), psi=(-1, 1.5, 20))
    data = check_cells(LEVEL, np.asarray(gait.states), grid)
    assert set(data.fate.values.ravel()) == {0, 2, 3}


@pytest.mark.slow
def test_a_branch_ends_where_the_wheel_begins_to_fly():
    branch = wj.continue_gait(LEVEL, "lean", (0.4, 0.9), gait_of(LEVEL))
    for lean, states in zip(branch.values[::4], branch.states[::4], strict=True):
        following, outcome, _ = reference(
            wj.systems.TorsoWheel(lean=float(lean)), states[0], samples=400
        )
        assert outcome == Outcome.STRIDE
        np.testing.assert_allclose(following, states[0], rtol=0, atol=1e-9)
    assert branch.ends == ("the end of the range", "a state makes no stride")
    (before, last), (slower, state) = branch.values[[-9, -1]], branch.states[[-9, -1], 0]
    ahead = state + 1e-4 / (last - before) * (state - slower)
    assert 0.7 < last < 0.9
    found = wj.stride(wj.systems.TorsoWheel(lean=float(last) + 1e-4), ahead)
    assert found.outcome == Outcome.RUNNING


@pytest.mark.slow
def test_beside_the_least_disturbance_it_returns_or_fails():
    gait = gait_of(LEVEL)
    least = wj.least_disturbance(LEVEL, gait, along=[[1, 0, 0], [0, 1, 0]], directions=64)
    assert least.failure == Outcome.RUNNING
    angles = np.linspace(0, 2 * np.pi, 400)
    around = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    starts = [gait.states[0] + (1 - 1e-6) * least.size * around, least.state[None]]
    starts[1] = starts[1] + 1e-6 * least.direction
    xs = np.concatenate(starts)
    for _ in range(60):
        found = wj.strides(LEVEL, xs)
        xs = np.where(found.outcome[:, None] == Outcome.STRIDE, found.state, xs)
    assert (found.outcome[:-1] == Outcome.STRIDE).all() and found.outcome[-1] == least.failure
    np.testing.assert_allclose(xs[:-1], np.tile(gait.states, (400, 1)), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_areas_of_basins_change_as_their_derivative_says():
    at = dict(zip(LEVEL.section, map(float, gait_of(LEVEL).states[0]), strict=True))
    grid = wj.Grid.through(at, thetadot=(-1, 0, 80), psi=(-0.2, 1.5, 80))
    areas = {
        lean: wj.measure(wj.systems.TorsoWheel(lean=lean), "area", ["lean"], grid=grid)
        for lean in (0.45, 0.5, 0.55)
    }
    change = areas[0.55].value - areas[0.45].value
    error = (
        np.hypot(areas[0.55].value_error, areas[0.45].value_error)
        + 0.1 * areas[0.5].gradient_error[0]
    )
    assert 0.1 * areas[0.5].gradient[0] == pytest.approx(change, abs=3 * error)
    assert abs(change) > 6 * error
    fine = wj.refine(LEVEL, grid, 2)
    assert float(fine.area[0]) == pytest.approx(areas[0.5].value, abs=1e-3)


# A controller with a state of its own


class Remembering(NamedTuple):
    """The wheel, and the integral of the torso's error."""

    wheel: WheelState
    integral: jax.Array


class IntegratingWheel(wj.systems.TorsoWheel):
    """One whose controller integrates the error until the torso leans as it should on average."""

    gain: Any = 0.1
    section = (*wj.systems.TorsoWheel.section, "integral")

    def modes(self):
        (mode,) = super().modes().values()

        def rates(state):
            held = eqx.tree_at(lambda one: one.lean, self, self.lean + self.gain * state.integral)
            return Remembering(SingleSupport(held)(state.wheel), self.lean - state.wheel.psi)

        of_wheel = lambda one: lambda state: one(state.wheel)
        *falls, strikes = (one._replace(value=of_wheel(one.value)) for one in mode.guards)
        strike = lambda state: Remembering(self.strike(state.wheel), state.integral)
        return {"stance": Mode(rates, (*falls, strikes._replace(reset=strike)))}

    def lift(self, x):
        return Remembering(super().lift(x[:3]), x[3])

    def project(self, state):
        return jnp.append(super().project(state.wheel), state.integral)

    def feasible(self, x):
        return jnp.isfinite(x[3]) & super().feasible(x[:3])


@pytest.mark.slow
def test_an_integrating_controller_holds_the_torso_on_average():
    wheel = IntegratingWheel(lean=0.65)
    gait = wj.find_gait(wheel, [*gait_of(LEVEL).states[0], -1.5])
    assert gait.stable
    thetadot, psi, psidot, integral = gait.states[0]
    p = {name: float(vars(wheel)[name]) for name in NAMES}

    def field(t, y):
        held = p | {"lean": p["lean"] + 0.1 * y[4]}
        return [*y[2:4], *accelerations(held, y[:4]), p["lean"] - y[1]]

    time = float(gait.step_times[0])
    start = [p["alpha"], psi, thetadot, psidot, integral]
    run = solve_ivp(field, (0, time), start, "DOP853", rtol=1e-12, atol=1e-13)
    s, psi_end, _, _, integral_end = run.y[:, -1]
    assert s == pytest.approx(-p["alpha"], abs=1e-11)
    assert integral_end == pytest.approx(integral, abs=1e-11)  # so the error is zero on average
    assert psi_end == pytest.approx(psi, abs=1e-11)
    np.testing.assert_allclose(strike(p, run.y[:4, -1]), [thetadot, psidot], atol=1e-11)
    assert abs(integral) > 0.1  # without it, the torso leans less or more
