"""A robot from a file, fitted to a recording of itself."""

import numpy as np
import pytest
from robot_examples import FILES, as_robot

import walker_jax as wj

GAIT = as_robot((0.28809807504, -0.35705418063, -0.20285043033))


def test_recordings_of_a_robot_are_of_its_coordinates():
    robot = wj.robot(FILES / "compass.xml")
    names = "stance_leg", "swing_leg", "stance_leg_rate", "swing_leg_rate"
    assert robot.names_of_state() == names
    samples = {"time": np.linspace(0, 2, 40), "theta": np.zeros(40)}
    recordings = wj.read_recordings(samples, strikes=[0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match=f"columns must be among {', '.join(names)}, not 'theta'"):
        wj.fit(robot, recordings, ["leg_mass", "slope"])


@pytest.mark.slow
def test_a_mass_and_the_slope_come_back_from_angles_of_the_legs():
    """Noise of 1e-3 rad; errors are those of the Jacobian."""
    truth = {"leg_mass": 5.2, "slope": 0.051}
    robot = wj.robot(FILES / "compass.xml", parameters=truth)
    made = wj.walk(robot, wj.find_gait(robot, GAIT).states[0] * 1.01, 8)
    strikes = np.append(0, np.cumsum(made.times))
    times = np.arange(0.02, strikes[-1], 0.04)
    way, random = wj.trajectory(robot, made.states[0], times, strides=8), np.random.default_rng(0)
    samples = {"time": times} | {
        name: np.asarray(angle) + 1e-3 * random.normal(size=len(times))
        for name, angle in zip(("stance_leg", "swing_leg"), way.coordinates, strict=True)
    }
    names = {name: name for name in ("stance_leg", "swing_leg")}
    recordings = wj.read_recordings(samples, names, strikes=strikes)
    noise = dict.fromkeys(names, 1e-3) | {"time": 1e-4}
    found = wj.fit(wj.robot(FILES / "compass.xml"), recordings, [*truth], noise=noise)
    for name, value in truth.items():
        assert 0 < found.errors[name] < 0.1 * value
        assert abs(found.parameters[name] - value) < 4 * found.errors[name]
