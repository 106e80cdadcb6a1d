"""Motions within strides, walks, and what strides may be asked for."""

import re
import subprocess
import sys
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_strides import (
    GAIT,
    TABLE,
    VALUES,
    assert_equal_strides,
    motion,
    on_section,
    reference_map,
    strides,
)
from reference import DATA
from scipy.integrate import solve_ivp
from scipy.ndimage import maximum_filter, minimum_filter

import walker_jax as wj
from walker_jax import Outcome, SimplestWalker, Walker

# Trajectories


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


def test_float32_strides_are_float64s_away_from_boundaries():
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
def test_starts_of_other_dimensions_are_refused_unchecked_too():
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
        lambda x: wj.stride(Own(0.004), x, step=-0.001),
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


def test_a_trajectory_over_many_strides_is_that_of_each_stride():
    """And on after the last stride."""
    walker, x = SimplestWalker(0.004), jnp.array([0.2, -0.2])
    made = wj.walk(walker, x, 3)
    ends = np.cumsum(made.times)
    times = np.array([0.5, ends[0] + 0.7, float(ends[0]), ends[1] + 1.1, 0.0, ends[2] + 0.2])
    found = wj.trajectory(walker, x, times, strides=3)
    number = np.array([0, 1, 1, 2, 0, 2])
    for i, k in enumerate(number):
        begin = np.append(0.0, ends)[k]
        expected = wj.trajectory(walker, made.states[k], times[i : i + 1] - begin)
        for one, other in zip(found, expected, strict=True):
            assert one[i] == pytest.approx(float(other[0]), abs=1e-15)


@pytest.mark.parametrize("reverse", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("kind", "values", "start", "times", "name"),
    [
        (wj.systems.BouncingBall, (0.4, 0.8), [0.7, 2.3], [5.5, 9.5], "height"),
        pytest.param(
            SimplestWalker, (0.004,), [0.2, -0.2], [4.6, 8.9], "phi", marks=pytest.mark.slow
        ),
    ],
)
def test_a_trajectory_over_many_strides_has_derivatives(kind, values, start, times, name, reverse):
    """By the first parameter and the start, against differences; in reverse mode, if asked."""
    x, step, (first, *rest) = jnp.array(start), 1e-6, values
    path = lambda p, x: getattr(wj.trajectory(kind(p, *rest), x, times, strides=3), name)
    by_parameter, by_start = jax.jacfwd(path, (0, 1))(first, x)
    if reverse:
        back = jax.jacrev(path, (0, 1))(first, x)
        np.testing.assert_allclose(back[0], by_parameter, rtol=1e-10)
        np.testing.assert_allclose(back[1], by_start, rtol=1e-10)
    by = (path(first + step, x) - path(first - step, x)) / (2 * step)
    np.testing.assert_allclose(by_parameter, by, rtol=1e-7)
    aside = step * jnp.array([1.0, 0.0])
    by = (path(first, x + aside) - path(first, x - aside)) / (2 * step)
    np.testing.assert_allclose(by_start[:, 0], by, rtol=1e-7)


def test_a_trajectory_ends_with_the_stride_that_fails():
    """Its motion goes on as after one stride; nothing follows it."""
    walker, x = SimplestWalker(0.004), jnp.array([0.2, -0.23])
    assert wj.stride(walker, x).outcome == Outcome.FORWARD
    one, several = (wj.trajectory(walker, x, [0.3, 2.0], strides=n) for n in (1, 4))
    for alone, among in zip(one, several, strict=True):
        np.testing.assert_array_equal(alone, among)
    with pytest.raises(ValueError, match="strides must be"):
        wj.trajectory(walker, x, [0.3], strides=0)
    with pytest.raises(ValueError, match="x must be on the section"):
        wj.trajectory(walker, [0.2, 0.4, -0.2, 0.0], [0.3], strides=2)
