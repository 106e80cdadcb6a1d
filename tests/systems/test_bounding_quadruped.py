"""The bounding quadruped, against an integration with SciPy and the runner of one leg."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import assert_gait, check_functions_of_modes, differences
from graphs_by_scipy import through_graph
from reference import read_values
from scipy.integrate import solve_ivp

import walker_jax as wj

BOUNDER = wj.systems.BoundingQuadruped()
bound = through_graph(BOUNDER)
STARTS = {
    (1.04, 0.7, 0.0): "flight, on rear, flight after rear, on front after rear, last flight",
    (1.03, -0.7, 0.01): "flight, on front, flight after front, on rear after front, last flight",
    (1.13, 0.05, -0.01): "flight, on rear, on both, on front after rear, last flight",
    (1.13, -0.05, 0.02): "flight, on front, on both, on rear after front, last flight",
    (1.043, 0.198, -0.114): "flight, on rear, on both, on rear after front, last flight",
    (1.163, -0.106, 0.09): "flight, on front, on both, on front after rear, last flight",
}
"""Starts, and the modes of their strides: all orders that there are."""
BOUND = np.array([1.0434854760262262, 0.6946417222600052, 0.0])
"""The apex of the gait, which `find_gait` finds from (1.04, 0.7, 0)."""
RUNS_AT = {"stiffness": 25.4841997961264, "angle": 1.1868238913561442, "energy": 2.27420998980632}
RUNS = read_values("systems")["slip"]["sets"][0]["fixed_points"]
"""Those of one leg at these values."""


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(BOUNDER, [1.04, 0.7, 0.0])


def event(function, direction=1):
    function.terminal, function.direction = True, direction
    return function


def stride_by_scipy(x, walker=BOUNDER):
    """The next apex and its time: legs are lines between points, their torque a cross product."""
    names = "stiffness", "inertia", "hips", "rear_angle", "front_angle", "energy"
    k, inertia, hips, *angles, energy = (float(getattr(walker, name)) for name in names)
    height, rate, pitch = x
    forward = np.sqrt(2 * (energy - height) - inertia * rate**2)
    y, time = np.array([0, height, pitch, forward, 0, rate]), 0.0
    feet: dict[int, Any] = {0: None, 1: None}  # of pairs that stand, or have yet to land
    arm = lambda y, i: (2 * i - 1) * hips * np.exp(1j * y[2])
    hip = lambda y, i: y[0] + 1j * y[1] + arm(y, i)

    def rates(_, y):
        force, torque = -1j, 0.0
        for i, foot in feet.items():
            if foot is not None:
                leg = hip(y, i) - foot
                push = k * (1 - abs(leg)) * leg / abs(leg)
                force, torque = force + push, torque + (np.conj(arm(y, i)) * push).imag
        return [*y[3:], force.real, force.imag, torque / inertia]

    while True:
        pairs, ends = [*feet], []
        for i in pairs:
            if feet[i] is None:
                ends.append(lambda _, y, i=i: np.sin(angles[i]) - hip(y, i).imag)
            else:
                ends.append(lambda _, y, i=i: abs(hip(y, i) - feet[i]) - 1)
        ends = [event(one) for one in ends] or [event(lambda _, y: y[4], -1)]
        made = solve_ivp(
            rates, (0, 20), y, "DOP853", events=ends, rtol=1e-13, atol=1e-13, first_step=1e-3
        )
        which = next(n for n, one in enumerate(made.t_events) if one.size)
        y, time = made.y_events[which][0], time + made.t_events[which][0]
        if not pairs:
            return np.array([y[1], y[5], y[2]]), time
        i = pairs[which]
        if feet[i] is None:
            feet[i] = hip(y, i).real + np.cos(angles[i])
        else:
            del feet[i]


@pytest.mark.parametrize("start", [*STARTS, tuple(BOUND)])
def test_its_modes_in_any_order_make_the_stride_of_legs(start):
    """And the bound returns to its start."""
    made, lasted, passed = bound(start)
    state, time = stride_by_scipy(start)
    np.testing.assert_allclose(made, state, atol=5e-11)
    np.testing.assert_allclose(lasted, time, atol=5e-11)
    assert ", ".join(passed) == STARTS.get(start, STARTS[1.04, 0.7, 0.0])
    if start == tuple(BOUND):
        np.testing.assert_allclose(made, BOUND, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("start", [*STARTS, tuple(BOUND)])
def test_a_stride_in_any_order_is_that_of_another_integration(start):
    made = wj.stride(BOUNDER, start)
    state, time = stride_by_scipy(start)
    assert made.outcome == wj.Outcome.STRIDE
    np.testing.assert_allclose(made.state, state, atol=5e-11)
    np.testing.assert_allclose(made.time, time, atol=5e-11)


@pytest.mark.slow
def test_modes_follow_the_order_of_footfalls():
    names = [*BOUNDER.modes()]
    for start, expected in STARTS.items():
        times = np.asarray(wj.phase_times(BOUNDER, start))
        entered = [names[i] for i in np.argsort(times) if np.isfinite(times[i])]
        assert ", ".join(entered) == expected
        assert np.nanmax(times) == wj.stride(BOUNDER, start).time


@pytest.mark.slow
def test_the_bound_is_stable():
    """Its multipliers are those of differences of strides."""
    stride = lambda many: wj.strides(BOUNDER, many).state
    multipliers = np.linalg.eigvals(differences(stride, BOUND, np.full(3, 1e-3)))
    assert np.abs(multipliers).max() < 0.9


@pytest.mark.slow
def test_bounding_is_stable_and_symmetric_in_time(gait):
    """Backward in time the rear becomes the front: both stand as long, and the body is level."""
    np.testing.assert_allclose(gait.states[0], BOUND, atol=1e-11)
    assert gait.stable and abs(gait.states[0, 2]) < 1e-12
    assert_gait(gait, lambda x: stride_by_scipy(x)[0], 1e-3, 1e-7)
    times = np.sort(wj.phase_times(BOUNDER, gait.states[0]))[:5]
    down, on_rear, between, on_front, up = np.diff(times, prepend=0.0)
    assert on_rear == pytest.approx(on_front, abs=1e-11) and between > 0.1
    assert down == pytest.approx(up, abs=1e-11)


@pytest.mark.slow
def test_every_mode_keeps_the_energy(gait):
    found = wj.explain(BOUNDER, gait.states[0])
    assert not found.complaints and len(found.modes) == 5
    for mode in found.modes:
        np.testing.assert_allclose(mode.energy, BOUNDER.energy, rtol=1e-12)


@pytest.mark.slow
def test_a_bound_is_the_same_from_the_apex_of_either_flight(gait):
    other = wj.find_gait(BOUNDER, [1.03, -0.71, 0.0])
    assert other.states[0, 1] < 0 < gait.states[0, 1]
    np.testing.assert_allclose(other.multipliers, gait.multipliers, atol=1e-10)
    np.testing.assert_allclose(other.step_times, gait.step_times, atol=1e-12)


@pytest.mark.slow
def test_pronking_is_running_on_one_leg_of_twice_the_stiffness():
    """All feet land at once and leave at once, and the pitch stays zero."""
    k, angle, energy = RUNS_AT.values()
    pronker = wj.systems.BoundingQuadruped(
        stiffness=k / 2, rear_angle=angle, front_angle=angle, energy=energy
    )
    stride = lambda many: np.column_stack([(made := wj.strides(pronker, many)).state, made.time])
    apexes = np.array([[one["apex"]] for one in RUNS])
    times = wj.strides(wj.systems.SpringMassRunner(**RUNS_AT), apexes).time
    for run, time in zip(RUNS, times, strict=True):
        x = np.array([run["apex"], 0.0, 0.0])
        np.testing.assert_allclose(stride(x[None])[0], [*x, time], atol=1e-12)
        jacobian = differences(stride, x, np.full(3, 1e-4))
        assert jacobian[0, 0] == pytest.approx(run["multiplier"], abs=1e-7)
        # A pitch that turns the other way exchanges the pairs, which differ in nothing then.
        np.testing.assert_allclose(jacobian[[0, 3], 1:], 0, atol=1e-7)


@pytest.mark.slow
def test_derivatives_of_pronking_are_those_of_differences():
    k, angle, energy = RUNS_AT.values()
    pronker = wj.systems.BoundingQuadruped(
        stiffness=k / 2, rear_angle=angle, front_angle=angle, energy=energy
    )
    stride = lambda x: jnp.append((made := wj.stride(pronker, x)).state, made.time)
    jacobian, stride = jax.jit(jax.jacfwd(stride)), jax.jit(stride)
    for run in wj.find_gaits(wj.systems.SpringMassRunner(**RUNS_AT)):
        x = np.array([float(run.states[0, 0]), 0.0, 0.0])
        found = np.asarray(jacobian(x))
        assert found[0, 0] == pytest.approx(float(np.real(run.multipliers[0])), abs=1e-10)
        np.testing.assert_allclose(found[[0, 3], 1:], 0, atol=1e-10)
        expected = differences(lambda many: np.stack([*map(stride, many)]), x, np.full(3, 1e-4))
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


def test_its_functions_have_the_derivatives_of_differences():
    check_functions_of_modes(wj.systems.BoundingQuadruped, (1.03, 0.7, 0.02))


@pytest.mark.slow
def test_derivatives_by_parameters_are_those_of_differences(gait):
    names = "stiffness", "inertia", "hips", "rear_angle", "front_angle", "energy"
    values = np.array([float(getattr(BOUNDER, name)) for name in names])
    stride = jax.jit(
        lambda p: wj.stride(wj.systems.BoundingQuadruped(*p), jnp.array(gait.states[0])).state
    )
    expected = differences(lambda many: np.stack([*map(stride, many)]), values, np.full(6, 1e-3))
    np.testing.assert_allclose(jax.jacfwd(stride)(values), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_starts_near_the_bound_return_to_it_and_others_fall(gait):
    h, rate, _ = gait.states[0]
    grid = wj.Grid.plain(
        height=(h - 0.2, h + 0.2, 12), pitch_rate=(rate - 0.8, rate + 0.8, 12), pitch=0.0
    )
    data = wj.basin(BOUNDER, grid, "direct")
    near = data.sel(height=h, pitch_rate=rate, method="nearest")
    assert near.fate == wj.Outcome.STRIDE  # the apexes of both flights are attractors
    reached = data.states.values[int(near.attractor), 0]
    np.testing.assert_allclose(reached, gait.states[0], atol=1e-9)
    assert set(np.unique(data.fate)) == {0, wj.Outcome.FORWARD, wj.Outcome.OUTSIDE}


@pytest.mark.slow
def test_margins_have_the_signs_of_outcomes():
    starts = np.stack([*np.meshgrid([0.9, 1.0, 1.1], [-1.5, 0.0, 0.7, 1.5], [-0.1, 0.05])], -1)
    found = wj.margins(BOUNDER, starts.reshape(-1, 3))
    outcome = np.asarray(found.stride.outcome)
    falls = outcome == wj.Outcome.FORWARD
    assert 2 < falls.sum() < (outcome != wj.Outcome.OUTSIDE).sum() - 2
    inside = outcome != wj.Outcome.OUTSIDE
    np.testing.assert_array_equal(np.asarray(found.forward)[inside] < 0, falls[inside])
    assert (np.asarray(found.backward)[outcome == wj.Outcome.STRIDE] > 0).all()


def test_wrong_uses_are_refused():
    with pytest.raises(ValueError, match="stiffness must be finite and above 0, not -1"):
        wj.systems.BoundingQuadruped(stiffness=-1.0)
    with pytest.raises(ValueError, match="inertia must be finite and above 0, not 0"):
        wj.systems.BoundingQuadruped(inertia=0.0)
    assert not BOUNDER.feasible(jnp.array(LOW)) and BOUNDER.feasible(jnp.array(BOUND))


LOW = (1.0, 0.0, -0.3)
"""At this pitch the front feet would be under the ground."""


@pytest.mark.slow
def test_low_starts_are_outside():
    assert wj.stride(BOUNDER, LOW).outcome == wj.Outcome.OUTSIDE


@pytest.mark.slow
def test_low_starts_are_explained():
    assert wj.explain(BOUNDER, LOW).complaints == ["the start is not feasible"]
