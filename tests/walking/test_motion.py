"""Walks as motions: they agree with the strides they consist of, and places with F(q)."""

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.multibody.single_support import coordinates_and_rates

START = np.array([0.2, -0.21645])


@pytest.fixture(scope="module")
def nine():
    return wj.motion(wj.SimplestWalker(0.004), START, 9, step=0.1)


def frames_of(data, number):
    return data.isel(frame=data["stride"].values == number)


def test_a_motion_starts_each_stride_where_the_walk_does(nine):
    walk = wj.walk(wj.SimplestWalker(0.004), START, 9)
    np.testing.assert_array_equal(nine["states"], walk.states)
    np.testing.assert_array_equal(nine["duration"], walk.times)
    for k in range(9):
        own = frames_of(nine, k)
        at_start = [own["theta"][0], own["thetadot"][0]]
        np.testing.assert_allclose(at_start, walk.states[k], rtol=0, atol=1e-12)
        elapsed = float(own["time"][-1] - own["time"][0])
        assert elapsed == pytest.approx(float(walk.times[k]), abs=1e-12)


def test_frames_are_evenly_spaced_in_a_stride_about_as_wanted(nine):
    for k in range(9):
        steps = np.diff(frames_of(nine, k)["time"])
        assert np.ptp(steps) < 1e-12
        assert abs(steps[0] - 0.1) < 0.002


def test_the_motion_is_continuous_over_heel_strikes(nine):
    """The hip goes on from where it was, and the swing foot becomes the stance foot."""
    last = np.flatnonzero(np.diff(nine["stride"]))
    hip, swing, stance = (nine[name].values for name in ("hip", "swing", "stance"))
    np.testing.assert_allclose(hip[last + 1], hip[last], rtol=0, atol=1e-10)
    np.testing.assert_allclose(stance[last + 1], swing[last], rtol=0, atol=1e-10)
    np.testing.assert_allclose(swing[last + 1], stance[last], rtol=0, atol=1e-10)
    assert np.all(np.diff(stance[:, 0]) >= 0)


def test_the_energy_of_the_hip_is_conserved_within_a_stride(nine):
    """Of the simplest walker: kinetic energy of the hip, and its height over level ground."""
    for k in range(9):
        own = frames_of(nine, k)
        along, above = own["hip"].values.T
        height = above * np.cos(0.004) - along * np.sin(0.004)
        energy = own["thetadot"].values ** 2 / 2 + height
        assert np.ptp(energy) < 1e-11


@pytest.mark.parametrize(
    "walker",
    [
        pytest.param(wj.PointFootWalker(0.01, 0.1), marks=pytest.mark.slow),
        pytest.param(wj.RoundFootWalker(0.01), marks=pytest.mark.slow),
        pytest.param(wj.UpperBodyWalker(0.01), marks=pytest.mark.slow),
    ],
    ids=lambda walker: type(walker).__name__,
)
def test_places_are_those_that_the_walker_is_made_of(walker):
    """The hip is where F(q), or the mass of the upper body above it, says."""
    x = np.array([0.2, -0.25] + [-0.05] * (len(walker.section) - 2))
    data = wj.motion(walker, x, 1, step=0.5)
    for k in (0, 2):
        frame = data.isel(frame=k)
        names = "theta", "phi", "thetadot", "phidot"
        state = wj.State(*(jnp.asarray(float(frame[name])) for name in names))
        points = np.asarray(walker.system().transfer(coordinates_and_rates(state)[0]))
        hip = points[2:4] if isinstance(walker, wj.PointFootWalker) else points[:2]
        if isinstance(walker, wj.UpperBodyWalker):
            middle = float(state.theta - state.phi / 2)
            hip = hip - float(walker.body_com) * np.array([-np.sin(middle), np.cos(middle)])
        np.testing.assert_allclose(frame["hip"], hip, rtol=0, atol=1e-12)
        foot = np.asarray(walker.swing_foot(coordinates_and_rates(state)[0]))
        sole = frame["swing"].values[1] - data.attrs["foot_radius"]
        assert sole == pytest.approx(foot[1], abs=1e-12)
    radius = float(getattr(walker, "foot_radius", 0.0))
    assert data.attrs["foot_radius"] == pytest.approx(radius, abs=1e-12)


@pytest.mark.parametrize(
    ("start", "outcome", "side"),
    [((0.2, -0.23), wj.Outcome.FORWARD, 1), ((0.2, -0.19), wj.Outcome.BACKWARD, -1)],
)
def test_a_fall_is_shown_to_the_ground(start, outcome, side):
    data = wj.motion(wj.SimplestWalker(0.004), np.array(start), 9, step=0.1)
    assert data["outcome"].values.tolist() == [outcome]
    assert np.isnan(data["duration"].values[-1]) and data.sizes["start"] == 1
    hip = data["hip"].values[-1]
    np.testing.assert_allclose(hip, [side, 0], rtol=0, atol=1e-12)
    assert np.all(np.abs(data["theta"]) < np.pi / 2 + 1e-12)


@pytest.mark.parametrize("start", [(0.2, -0.23), (0.2, -0.19), (0.2, -0.215)])
def test_a_film_ends_at_the_event_whatever_its_frames_are(start):
    """A fall forward, one backward, and one after three strides."""
    walker = wj.SimplestWalker(0.004)
    films = [wj.motion(walker, np.array(start), 9, step=step) for step in (0.05, 0.3, 1.7)]
    assert films[0].outcome.values[-1] != wj.Outcome.STRIDE
    for name in ("time", "theta", "phi", "hip", "swing"):
        last = [film[name].values[-1] for film in films]
        np.testing.assert_allclose(last[1:], last[:1] * 2, rtol=0, atol=1e-9)


def test_a_runner_is_shown_until_its_foot_leaves_the_ground():
    walker = wj.SimplestWalker(0.0165)
    data = wj.motion(walker, np.array([0.7, -0.95]), 3, step=0.1)
    assert data["outcome"].values.tolist() == [wj.Outcome.RUNNING]
    assert data.sizes["frame"] == 1  # it pulls at the start


@pytest.mark.parametrize("step", [0.01, 0.07, 0.9])
def test_a_run_is_shown_to_the_instant_of_lift_off(step):
    """Of an inverted pendulum of energy E it is where 3 cos(theta - slope) = 2 E, before the foot
    comes down at theta = -0.285 (SciPy's DOP853)."""
    walker, start = wj.SpringWalker(0.0165, 20.0), (0.3, -0.9749387098808787)
    data = wj.motion(walker, np.array(start), 1, step=step)
    assert data["outcome"].values.tolist() == [wj.Outcome.RUNNING]
    energy = start[1] ** 2 / 2 + np.cos(start[0] - 0.0165)
    lift_off = 0.0165 - np.arccos(2 * energy / 3)
    np.testing.assert_allclose(data["theta"].values[-1], lift_off, rtol=0, atol=1e-10)
    assert lift_off > -0.2783 and np.all(data["theta"].values[:-1] > lift_off)


def test_wrong_arguments():
    walker = wj.SimplestWalker(0.004)
    with pytest.raises(ValueError, match="x must be a feasible start"):
        wj.motion(walker, np.array([0.9, -0.2]), 3)
    with pytest.raises(ValueError, match="step must be above 0, not 0"):
        wj.motion(walker, START, 3, step=0.0)
    with pytest.raises(ValueError, match="strides must be at least 1, not 0"):
        wj.motion(walker, START, 0)
