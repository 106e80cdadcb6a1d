"""The biped on spring legs, against an integration with SciPy and the runner of one leg."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import check_functions_of_modes
from graphs_by_scipy import through_graph
from reference import read_values
from scipy.integrate import solve_ivp

import walker_jax as wj

WALKER = wj.systems.SpringMassBiped()
FASTER = wj.systems.SpringMassBiped(energy=1.25)
WALKED, FLOWN = (0.94, 0.01), (0.9, 0.03)
"""Starts of the faster one: the other leg lands before the first one leaves, or after a flight."""
RUNS_AT = {"stiffness": 25.4841997961264, "angle": 1.1868238913561442, "energy": 2.27420998980632}
RUNS = read_values("systems")["slip"]["sets"][0]["fixed_points"]
"""Those of one leg at these values."""


def event(function, direction):
    function.terminal, function.direction = True, direction
    return function


def stride_by_scipy(walker, height, climb):
    """The next mid-stance and its time, in world coordinates, as in Geyer and others (2006)."""
    k, angle, energy = (float(getattr(walker, name)) for name in ("stiffness", "angle", "energy"))
    forward = np.sqrt(2 * (energy - height) - k * (1 - height) ** 2 - climb**2)
    y, time, feet = np.array([0.0, height, forward, climb]), 0.0, [0.0]

    def rates(_, y):
        ahead, up = 0.0, -1.0
        for foot in feet:
            length = np.hypot(y[0] - foot, y[1])
            ahead += k * (1 / length - 1) * (y[0] - foot)
            up += k * (1 / length - 1) * y[1]
        return [y[2], y[3], ahead, up]

    landed = False
    while True:
        stretched = [
            event(lambda _, y, foot=foot: np.hypot(y[0] - foot, y[1]) - 1, 1) for foot in feet
        ]
        ends: list[Any] = list(stretched)
        if not landed:
            ends.append(event(lambda _, y: y[1] - np.sin(angle), -1))
        if landed and len(feet) == 1:
            ends.append(event(lambda _, y, foot=feet[0]: y[0] - foot, 1))
        made = solve_ivp(
            rates, (0, 20), y, "DOP853", events=ends, rtol=1e-13, atol=1e-13, first_step=1e-3
        )
        which = next(i for i, one in enumerate(made.t_events) if one.size)
        y, time = made.y_events[which][0], time + made.t_events[which][0]
        if which < len(feet):
            del feet[which]
        elif not landed:
            landed, feet = True, [*feet, y[0] + np.cos(angle)]
        else:
            return np.array([y[1], y[3]]), time


STRIDES = [
    (WALKER, (0.97, 0.0)),
    (WALKER, (0.98, 0.02)),
    (FASTER, WALKED),
    (FASTER, FLOWN),
    (wj.systems.SpringMassBiped(**RUNS_AT), (0.9, 0.01)),
]


@pytest.mark.parametrize(("walker", "start"), STRIDES)
def test_its_modes_make_the_stride_of_two_legs(walker, start):
    made, lasted, passed = through_graph(walker)(start)
    state, time = stride_by_scipy(walker, *start)
    np.testing.assert_allclose(made, state, atol=2e-11)
    np.testing.assert_allclose(lasted, time, atol=2e-11)
    assert ("flight" in passed) != ("double support" in passed)


@pytest.mark.slow
@pytest.mark.parametrize(("walker", "start"), STRIDES)
def test_a_stride_is_that_of_another_integration(walker, start):
    made = wj.stride(walker, start)
    state, time = stride_by_scipy(walker, *start)
    assert made.outcome == wj.Outcome.STRIDE
    np.testing.assert_allclose(made.state, state, atol=2e-11)
    np.testing.assert_allclose(made.time, time, atol=2e-11)


@pytest.mark.slow
def test_modes_are_skipped_as_the_legs_land_and_leave():
    walked, flown = ([one.name for one in wj.explain(FASTER, x).modes] for x in (WALKED, FLOWN))
    assert walked == ["past mid-stance", "double support", "before mid-stance"]
    assert flown == ["past mid-stance", "flight", "before mid-stance"]
    times = np.asarray(wj.phase_times(FASTER, FLOWN))
    assert np.isfinite(times).sum() == 3
    assert np.nanmax(times) == wj.stride(FASTER, FLOWN).time


@pytest.mark.slow
def test_walking_is_stable_and_symmetric():
    """A stable symmetric gait is published at these values of energy, stiffness and angle."""
    gaits = wj.find_gaits(WALKER)
    (gait,) = (one for one in gaits if one.stable)
    assert gait.states[0, 1] == pytest.approx(0, abs=1e-12)
    assert abs(np.prod(gait.multipliers)) == pytest.approx(0.978001**2, abs=1e-5)
    (other,) = (one for one in gaits if not one.stable)
    assert np.real(other.multipliers).max() > 1


@pytest.mark.slow
def test_running_is_that_of_one_leg():
    runs = wj.find_gaits(wj.systems.SpringMassBiped(**RUNS_AT))
    apexes = np.array([[one["apex"]] for one in RUNS])
    times = wj.strides(wj.systems.SpringMassRunner(**RUNS_AT), apexes).time
    assert len(runs) == len(apexes) == 2
    for run, i in zip(runs, np.argsort(-times), strict=True):
        np.testing.assert_allclose(run.step_times, [times[i]], atol=1e-12)
        one, other = sorted(np.real(run.multipliers), key=abs)
        assert abs(one) < 1e-9
        assert other == pytest.approx(RUNS[i]["multiplier"], abs=1e-10)


def test_its_functions_have_the_derivatives_of_differences():
    check_functions_of_modes(wj.systems.SpringMassBiped, (0.94, 0.01))


@pytest.mark.slow
def test_derivatives_and_margins_pass_all_ways():
    starts, step = jnp.array([WALKED, FLOWN]), 1e-5
    stride = jax.jit(lambda x: wj.stride(FASTER, x).state)
    jacobians = jax.vmap(jax.jacfwd(stride))(starts)
    for start, jacobian in zip(starts, jacobians, strict=True):
        ends = [[stride(start + s * step * e) for s in (-2, -1, 1, 2)] for e in np.eye(2)]
        slopes = [(a - 8 * b + 8 * c - d) / (12 * step) for a, b, c, d in ends]
        np.testing.assert_allclose(jacobian, np.stack(slopes, axis=1), rtol=1e-7, atol=1e-7)
    margins = wj.margins(FASTER, np.array([WALKED, FLOWN, (0.79, 0.38)]))
    made = np.asarray(margins.stride.outcome) == wj.Outcome.STRIDE
    assert made.tolist() == [True, True, False]
    assert (np.asarray(margins.backward)[:2] > 0).all()


@pytest.mark.slow
def test_a_trajectory_passes_the_modes():
    stride = wj.stride(FASTER, WALKED)
    single, double, *_ = wj.explain(FASTER, WALKED).modes
    on_both = single.time + double.time / 2
    states = wj.trajectory(FASTER, WALKED, [0.0, on_both, float(stride.time)])
    np.testing.assert_allclose(states.y[-1], stride.state[0], atol=1e-12)
    assert states.foot[1] > 0 and states.foot[-1] == 0
