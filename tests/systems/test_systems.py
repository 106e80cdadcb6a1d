"""Maps and hybrid systems in place of walkers, against values that were computed independently."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from henon import as_map
from reference import read_values
from scipy.integrate import solve_ivp
from scipy.optimize import root, root_scalar

import walker_jax as wj

REFERENCE = read_values("systems")


# Maps


def test_a_map_has_its_parameters_and_no_others():
    system = as_map(1.4)
    assert system.a == 1.4 and repr(system) == "henon(a=1.4, b=0.3)"
    with pytest.raises(AttributeError, match="has no parameter 'c'"):
        system.c  # noqa: B018 (to look is to ask for it)


@pytest.mark.parametrize("which", ["1.02", "1.4"])
def test_fixed_points_of_henon(which):
    expected = REFERENCE["henon"][which]
    region = {"x": (-2, 2, 10), "y": (-2, 2, 10)}
    for system in wj.systems.HenonMap(expected["a"]), as_map(expected["a"], region=region):
        found = wj.find_gaits(system)
        points = sorted(expected["fixed_points"], key=lambda one: one["x"])
        for gait, point in zip(found, points, strict=True):
            np.testing.assert_allclose(gait.states[0], [point["x"], point["y"]], atol=5e-13)
            eigenvalues = sorted(point["eigenvalues"], key=abs, reverse=True)
            np.testing.assert_allclose(gait.multipliers, eigenvalues, atol=5e-12)


def test_basins_of_henon_are_the_points_that_stay():
    """Against the same iteration by NumPy, at the cells of a small grid."""
    grid = wj.Grid.plain(x=(-2, 2, 60), y=(-2, 2, 60))
    x, y = grid.centres(np.arange(grid.size)).T
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(1000):
            x, y = 1 - 1.02 * x**2 + y, 0.3 * x
    stays = (np.hypot(x, y) < 10).reshape(grid.shape)
    region = {"x": (-2, 2, 30), "y": (-2, 2, 30)}
    of_map = as_map(1.02, feasible=lambda x, a, b: jnp.sum(x**2) < 100, region=region)
    for system in wj.systems.HenonMap(1.02), of_map:
        data = wj.basin(system, grid, "direct", strides=1000)
        assert data.period.values.tolist() == [4]
        np.testing.assert_array_equal(data.attractor.values == 0, stays)
        assert set(np.unique(data.fate)) == {wj.Outcome.STRIDE, wj.Outcome.OUTSIDE}
    cells = wj.basin(wj.systems.HenonMap(1.02), grid, "cell-map")
    assert abs(int((cells.attractor >= 0).sum()) / stays.sum() - 1) < 0.05


def test_the_default_method_is_cell_mapping_for_walkers_alone():
    """On a fractal basin a map of cells leads many of them elsewhere."""
    grid = wj.Grid.plain(x=(-2, 2, 8), y=(-2, 2, 8))
    assert wj.basin(wj.systems.HenonMap(1.02), grid).attrs["method"] == "direct"
    section = wj.Grid.sheared(theta=(0.1, 0.3, 4), sum=(-0.02, 0.01, 4))
    assert wj.basin(wj.SimplestWalker(0.004), section).attrs["method"] == "cell-map"


@pytest.mark.slow
@pytest.mark.parametrize("which", ["1.02", "1.4"])
def test_as_many_cells_stay_as_were_counted(which):
    expected = REFERENCE["henon"][which]
    grid = wj.Grid.plain(x=(-2, 2, 2000), y=(-2, 2, 2000))
    data = wj.basin(wj.systems.HenonMap(expected["a"]), grid, "direct", strides=1000)
    assert int((data.fate == wj.Outcome.STRIDE).sum()) == expected["bounded_cells"]


def test_areas_of_basins_of_maps_have_derivatives():
    """The area of the points that stay, by a; its boundary is that of those that escape."""
    grid = wj.Grid.plain(x=(-2, 2, 60), y=(-2, 2, 60))
    area = lambda a: wj.measure(
        wj.systems.HenonMap(a), "area", ("a",), grid=grid, levels=3, strides=600, check=0
    )
    found = area(1.0)
    step = 0.02
    change = (area(1.0 + step).value - area(1.0 - step).value) / (2 * step)
    assert found.lost < 0.1 * found.crossings
    assert found.gradient[0] == pytest.approx(change, abs=3 * found.gradient_error[0] + 0.15)
    assert change < -3


def test_derivatives_of_ten_strides_of_a_map_are_differences():
    def last(a):
        return wj.walk(as_map(a), jnp.array([0.1, 0.2]), 10).states[-1, 0]

    differences = last(1.0 + 1e-5) - last(1.0 - 1e-5)
    assert jax.grad(last)(1.0) == pytest.approx(float(differences) / 2e-5, rel=1e-7)


def test_a_system_that_says_itself_how_it_fails():
    class Halving(wj.System):
        section = ("x",)

        def advance(self, x):
            return x / 2, jnp.where(x[0] > 1, wj.Outcome.FORWARD, wj.Outcome.STRIDE), 2.0

    many = wj.strides(Halving(), np.array([[0.5], [1.5], [np.nan]]))
    assert many.outcome.tolist() == [0, wj.Outcome.FORWARD, wj.Outcome.OUTSIDE]
    np.testing.assert_array_equal(many.state[:, 0], [0.25, np.nan, np.nan])
    gait = wj.find_gait(Halving(), [0.3])
    assert gait.stable and gait.multipliers[0] == 0.5 and gait.step_times[0] == 2.0


def test_a_point_that_is_not_finite_is_undecided():
    system = wj.Map(lambda x: x / 0.0, ("x",))
    assert wj.stride(system, jnp.array([1.0])).outcome == wj.Outcome.UNDECIDED


def test_margins_of_two_guards_that_lead_to_one_failure():
    """A lifted point falls back by the sum of two coordinates: whichever guard holds counts."""

    class Fork(wj.HybridSystem):
        section = ("a", "b")

        def lift(self, x):
            return jnp.stack([x[0], x[1], 0 * x[0]])

        def project(self, state):
            return state[:2]

        def modes(self):
            drop = lambda y: y.at[:2].add(0.5)
            guards = (
                wj.Guard(lambda y: y[0], "BACKWARD", at_once=True),
                wj.Guard(lambda y: y[1], "BACKWARD", at_once=True),
                wj.Guard(lambda y: y[2] - 1, wj.SECTION, reset=drop),
            )
            return {"fork": wj.Mode(lambda y: jnp.array([0.0, 0.0, 1.0], y.dtype), guards)}

    found = wj.margins(Fork(), np.array([[-0.6, -2.0], [-2.0, -0.6], [-0.4, -2.0]]))
    assert found.stride.outcome.tolist() == [0, 0, wj.Outcome.BACKWARD]
    np.testing.assert_allclose(found.backward, [0.1, 0.1, -0.1], atol=1e-14)
    single = wj.margins(Fork(), np.array([[-0.6, -2.0]], np.float32))
    assert {field.dtype for field in jax.tree.leaves(single[1:])} == {np.dtype(np.float32)}


# Flows


@pytest.fixture(scope="module")
def oscillator() -> wj.systems.DuffingOscillator:
    return wj.systems.DuffingOscillator()


def test_cycles_and_basins_of_duffings_oscillator(oscillator):
    expected = REFERENCE["duffing"]
    grid = wj.Grid.plain(x=(-2, 2, 70), v=(-2, 2, 70))
    data = wj.basin(oscillator, grid, "direct", strides=1000)
    assert data.period.values.tolist() == [1, 1, 3]
    names = "left_period1", "right_period1", "period3"
    for number, name in enumerate(names):
        cycle = np.array(expected["attractors"][name])
        np.testing.assert_allclose(data.states.values[number, : len(cycle)], cycle, atol=2e-11)
        share = float((data.attractor == number).mean())
        assert share == pytest.approx(expected["shares"][name], abs=0.02)  # of 4,900 cells
    assert set(np.unique(data.fate)) == {wj.Outcome.STRIDE}


def test_a_period_of_duffings_oscillator_by_another_integrator(oscillator):
    def field(t, y):
        x, v = y
        return [v, x - x**3 - 0.15 * v + 0.245 * np.cos(t)]

    starts = np.random.default_rng(0).uniform(-2, 2, (5, 2))
    found = wj.strides(oscillator, starts)
    for x, state in zip(starts, found.state, strict=True):
        end = solve_ivp(field, (0, 2 * np.pi), x, method="DOP853", rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(state, end.y[:, -1], atol=2e-9)
    np.testing.assert_allclose(found.time, 2 * np.pi, rtol=1e-14)


def test_derivatives_of_ten_periods_are_those_of_differences(oscillator):
    def last(force):
        system = wj.systems.DuffingOscillator(force=force)
        return wj.walk(system, jnp.array([1.2785, 0.1053]), 10).states[-1, 0]

    lasts = jax.vmap(last)(0.245 + 1e-4 * jnp.array([-2.0, -1.0, 1.0, 2.0]))
    differences = float(lasts @ jnp.array([1.0, -8.0, 8.0, -1.0])) / 12e-4
    assert jax.grad(last)(0.245) == pytest.approx(differences, rel=1e-7)


# Impacts and flights


@pytest.mark.parametrize("orbit", REFERENCE["bouncing_ball"]["orbits"], ids=lambda o: o["Gamma"])
def test_the_ball_that_keeps_step_with_the_table(orbit):
    gaits = wj.find_gaits(wj.systems.BouncingBall(orbit["Gamma"]), 1)
    phases = [gait.states[0, 0] for gait in gaits if abs(gait.states[0, 1] - np.pi) < 1e-9]
    np.testing.assert_allclose(phases, [orbit["saddle_phase"], orbit["phase"]], atol=1e-12)
    (stable,) = (gait for gait in gaits if gait.stable and gait.states[0, 1] > 3)
    expected = np.array(orbit["multipliers"]) @ [1, 1j]
    np.testing.assert_allclose(
        np.sort_complex(stable.multipliers), np.sort_complex(expected), atol=1e-11
    )
    np.testing.assert_allclose(stable.step_times, 2 * np.pi, rtol=1e-13)


@pytest.mark.parametrize(
    ("system", "axes"),
    [
        (wj.systems.BouncingBall(), {"angle": (0.4, 1.2, 8), "velocity": (2.8, 3.4, 8)}),
        pytest.param(
            wj.systems.ImpactOscillator(),
            {"angle": (2.4, 3.1, 8), "v": (-1, -0.1, 8)},
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda one: type(one).__name__,
)
def test_basins_of_systems_with_impacts(system, axes):
    """Of each cell, what a walk from its centre shows; of the region too."""
    grid = wj.Grid.plain(**axes)
    data = wj.basin(system, grid, "direct", strides=400)
    xs = grid.centres(np.arange(grid.size))
    for _ in range(400):
        found = wj.strides(system, xs)
        xs = np.where(found.outcome[:, None] == wj.Outcome.STRIDE, found.state, xs)
    gait = wj.find_gait(system)
    arrived = np.abs(xs - gait.states[0]).max(axis=1) < 1e-6
    (number,) = np.flatnonzero(
        [np.abs(one - gait.states[0]).max() < 1e-6 for one in data["states"].values[:, 0]]
    )
    np.testing.assert_array_equal(data["attractor"].values.ravel() == number, arrived)
    assert arrived.sum() > 10


def test_the_ball_doubles_its_period_where_it_must():
    expected = REFERENCE["bouncing_ball"]
    branch = wj.continue_gait(
        wj.systems.BouncingBall(1.0),
        "amplitude",
        (0.9, 1.2),
        wj.find_gait(wj.systems.BouncingBall(1.0)),
    )
    (doubling,) = branch.doublings
    assert doubling.value == pytest.approx(expected["Gamma_doubling"], abs=1e-10)
    cycle = np.array(expected["after_doubling"]["period2"])
    gait = wj.find_gait(wj.systems.BouncingBall(expected["after_doubling"]["Gamma"]), cycle, 2)
    np.testing.assert_allclose(np.sort(gait.states, axis=0), np.sort(cycle, axis=0), atol=5e-11)


def test_a_periodic_impact_in_closed_form():
    """x'' + 2 d x' + x = cos(w t) has a closed solution, from impact to impact after one period."""
    damping, frequency, stop, restitution = 0.05, 2.6, 0.1, 0.7
    system = wj.systems.ImpactOscillator(frequency, stop, restitution, damping)
    rate = np.sqrt(1 - damping**2)
    gain = 1 / complex(1 - frequency**2, 2 * damping * frequency)

    def flow(phase, v, time):
        forced = lambda t: (gain * np.exp(1j * (phase + frequency * t))).real
        forced_rate = lambda t: (1j * frequency * gain * np.exp(1j * (phase + frequency * t))).real
        a = stop - forced(0)
        b = (v - forced_rate(0) + damping * a) / rate
        decay, c, s = np.exp(-damping * time), np.cos(rate * time), np.sin(rate * time)
        x = decay * (a * c + b * s) + forced(time)
        slope = decay * (-damping * (a * c + b * s) + rate * (b * c - a * s)) + forced_rate(time)
        return x, slope

    period = 2 * np.pi / frequency

    def misses(start):
        x, v = flow(start[0], start[1], period)
        return [x - stop, -restitution * v - start[1]]

    gait = wj.find_gait(system)
    phase, v = root(misses, gait.states[0] + 1e-3, tol=1e-14).x
    np.testing.assert_allclose(gait.states[0], [phase, v], atol=1e-11)
    assert gait.step_times[0] == pytest.approx(period, rel=1e-12)
    product = np.prod(gait.multipliers).real  # Liouville: of the flow, and of the impacts
    assert product == pytest.approx(restitution**2 * np.exp(-2 * damping * period), rel=1e-10)


RUNNERS = [
    wj.systems.SpringMassRunner(one["kt"], np.radians(one["alpha_deg"]), one["E"])
    for one in REFERENCE["slip"]["sets"]
]


@pytest.mark.parametrize("number", [0, 1])
def test_runs_of_the_spring_mass_runner(number):
    runner, expected = RUNNERS[number], REFERENCE["slip"]["sets"][number]
    gaits = wj.find_gaits(runner)
    for gait, point in zip(gaits, expected["fixed_points"], strict=True):
        assert gait.states[0, 0] == pytest.approx(point["apex"], abs=2e-12)
        assert gait.multipliers[0] == pytest.approx(point["multiplier"], abs=2e-11)
        assert gait.stable == point["stable"]


def test_the_basin_of_a_run_ends_at_its_unstable_companion():
    runner, expected = RUNNERS[0], REFERENCE["slip"]["sets"][0]
    low, high = expected["basin"]
    data = wj.basin(runner, wj.Grid.plain(apex=(0.9, 2.3, 140)), "direct", strides=500)
    apex = data.apex.values
    np.testing.assert_array_equal(data.attractor.values == 0, (apex > low) & (apex < high))
    outcomes = wj.strides(runner, np.array([[0.92], [1.0], [1.5], [1.9], [2.274]])).outcome
    expected_outcomes = [wj.Outcome.OUTSIDE, 0, 0, wj.Outcome.BACKWARD, wj.Outcome.STOPPED]
    assert outcomes.tolist() == expected_outcomes


@pytest.mark.slow
def test_the_ends_of_the_basin_of_a_run_are_found_one_by_one():
    runner, (low, high) = RUNNERS[0], REFERENCE["slip"]["sets"][0]["basin"]
    edge = wj.edge_state(runner, np.array([1.0]), np.array([1.4]))
    assert edge.kind == "saddle"
    assert edge.saddle is not None and edge.saddle.states[0, 0] == pytest.approx(high, abs=1e-11)
    nearest = wj.least_disturbance(runner, wj.find_gait(runner))
    assert nearest.state[0] == pytest.approx(low, abs=1e-9)
    assert nearest.failure == wj.Outcome.OUTSIDE


def test_a_leg_that_is_retracted_lands_later_and_steeper():
    """Against an integration with events by SciPy."""
    runner = wj.systems.SpringMassRunner(angle=1.1, retraction=0.3)
    k, a, energy, w = (
        float(getattr(runner, name)) for name in ("stiffness", "angle", "energy", "retraction")
    )
    start = 1.1
    vx = np.sqrt(2 * (energy - start))
    lands = lambda t: start - t**2 / 2 - np.sin(a + w * t)
    fall = root_scalar(lands, bracket=(0, 2), xtol=1e-15).root
    leg = a + w * fall
    bounce = lambda t, s: [
        *s[2:],
        k * (1 / np.hypot(*s[:2]) - 1) * s[0],
        k * (1 / np.hypot(*s[:2]) - 1) * s[1] - 1,
    ]
    lift_off = lambda t, s: np.hypot(*s[:2]) - 1 if t > 1e-3 else -1.0
    lift_off.terminal = True
    stance = solve_ivp(
        bounce,
        (0, 5),
        [-np.cos(leg), np.sin(leg), vx, -fall],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        events=lift_off,
    )
    (_, y, _, vy) = stance.y[:, -1]
    found = wj.stride(runner, jnp.array([start]))
    assert found.state[0] == pytest.approx(y + vy**2 / 2, abs=1e-9)
    assert found.time == pytest.approx(fall + stance.t[-1] + vy, abs=1e-9)


def test_states_may_be_trees_of_arrays():
    class Pendulum(wj.HybridSystem):
        damping: float = 0.2
        section = ("angle", "rate")

        def lift(self, x):
            return {"q": jnp.stack([x[0], 0 * x[0]]), "v": jnp.stack([x[1], 1 + 0 * x[0]])}

        def project(self, state):
            return jnp.stack([state["q"][0], state["v"][0]])

        def modes(self):
            def field(y):
                turn = -self.damping * y["v"][0] - jnp.sin(y["q"][0]) + 0.3 * jnp.cos(y["q"][1])
                return {"q": y["v"], "v": jnp.stack([turn, 0 * turn])}

            period = wj.Guard(lambda y: y["q"][1] - 2 * np.pi, wj.SECTION)
            return {"period": wj.Mode(field, (period,))}

    plain = lambda t, y: [y[1], -0.2 * y[1] - np.sin(y[0]) + 0.3 * np.cos(t)]
    end = solve_ivp(plain, (0, 2 * np.pi), [0.1, 0.2], method="DOP853", rtol=1e-12, atol=1e-13)
    found = wj.stride(Pendulum(), jnp.array([0.1, 0.2]))
    np.testing.assert_allclose(found.state, end.y[:, -1], atol=1e-10)


class Decay(wj.HybridSystem):
    """Leaves of three shapes, each decaying as exp(-rate t), beside a clock that is a scalar."""

    rate: Any = 1.0
    section = ("a", "b")

    def lift(self, x):
        return {"clock": 0 * x[0], "pair": x, "table": x[:, None] * jnp.array([[1.0, 2.0, 3.0]])}

    def project(self, state):
        return state["pair"] + 0 * state["table"][:, 0]

    def modes(self):
        def field(y):
            decays = {name: -self.rate * y[name] for name in ("pair", "table")}
            return {"clock": 1 + 0 * y["clock"]} | decays

        late = wj.Guard(lambda y: y["table"][1, 2] - 9.0, "FORWARD")
        ends = wj.Guard(lambda y: y["clock"] - 1.0, wj.SECTION)
        small = wj.Condition(lambda y: 5.0 - jnp.sum(y["pair"]), "RUNNING", at_start=True)
        return {"decay": wj.Mode(field, (late, ends), (small,))}


def test_a_state_may_hold_scalars_and_arrays_of_any_shape():
    start = jnp.array([1.0, 0.5])
    end, slope = jax.jvp(lambda rate: wj.stride(Decay(rate), start), (1.0,), (1.0,))
    np.testing.assert_allclose(end.state, start / np.e, rtol=1e-12)
    np.testing.assert_allclose(slope.state, -start / np.e, rtol=1e-12)
    found = wj.margins(Decay(), start)
    assert found.forward == pytest.approx(9 - 1.5) and found.running == pytest.approx(5 - 1.5)
    states = wj.trajectory(Decay(), start, jnp.array([0.0, 0.5]))
    np.testing.assert_allclose(states["table"][1], np.exp(-0.5) * states["table"][0], rtol=1e-12)
    assert wj.find_gait(Decay(), [0.1, 0.1]).states == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
def test_by_another_solver_and_in_an_explanation_too():
    start = jnp.array([1.0, 0.5])
    other = wj.stride(Decay(), start, solver=diffrax.Tsit5(), tolerance=1e-12)
    np.testing.assert_allclose(other.state, start / np.e, rtol=1e-10)
    assert "guard 1 (section) rose at 1\n" in str(wj.explain(Decay(), start))


def test_guards_that_turn_faster_than_the_motion_are_not_missed():
    """A ball in flight is a polynomial; the table below it is not, however far it is thrown."""
    ball = wj.systems.BouncingBall(0.5)
    starts = np.array([[0.3, 40.0], [-2.0, 3.0], [1.0, 300.0]])
    found = wj.strides(ball, starts)
    for (phase, v), time in zip(starts, found.time, strict=True):
        height = lambda t, p=phase, v=v: 0.5 * np.sin(p) + v * t - t**2 / 2 - 0.5 * np.sin(p + t)
        ts = np.linspace(1e-6, 2 * v + 5, 400_000)
        i = np.flatnonzero(height(ts) < 0)[0]
        exact = root_scalar(height, bracket=(ts[i - 1], ts[i]), xtol=1e-14).root
        assert time == pytest.approx(exact, abs=1e-9)
