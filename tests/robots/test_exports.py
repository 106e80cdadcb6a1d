"""Walks in MuJoCo's coordinates: against its own kinematics, velocities and accelerations."""

from typing import Any

import mujoco as installed
import numpy as np
import pytest
from mujoco_machines import Constrained
from mujoco_strides import largest_errors
from PIL import Image
from robot_examples import FILES, as_robot

import walker_jax as wj
from walker_jax.checks import ComputationFailed
from walker_jax.robots.robot_files import read_machine

mujoco: Any = installed
"""Type checkers do not know the names in it."""
PATH = FILES / "compass.xml"
GAIT = as_robot((0.28809807504, -0.35705418063, -0.20285043033))
RATE = 400.0


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    place = tmp_path_factory.mktemp("motion") / "started.xml"
    robot = wj.robot(PATH)
    return robot, wj.export_motion(robot, GAIT, PATH, strides=3, rate=RATE, keyframe=place), place


def test_feet_stand_where_they_came_down(exported):
    _, motion, _ = exported
    model = Constrained(*read_machine(PATH, None))
    ends = np.searchsorted(motion.times, np.arange(1, 4) * 0.7796973663)
    heights, slips = [], []
    for i, (qpos, qvel) in enumerate(zip(motion.qpos, motion.qvel, strict=True)):
        model.at(qpos, qvel)
        side = int(np.searchsorted(ends, i, side="right")) % 2
        heights.append(
            model.data.geom_xpos[model.model.geom(("left_foot", "right_foot")[side]).id][2]
        )
        slips.append(model.foot(side)[0] @ qvel)
    assert np.abs(np.array(heights[:-1]) - 0.05).max() < 1e-12
    assert np.abs(slips[:-1]).max() < 1e-12


def test_motion_follows_its_rates_but_for_impacts(exported):
    _, motion, _ = exported
    steps = np.diff(motion.times)
    smooth = (motion.qvel[:-1] + motion.qvel[1:]) / 2 * steps[:, None]
    missed = np.abs(np.diff(motion.qpos, axis=0) - smooth).max(axis=1)
    assert np.sort(missed)[-6:].max() < 0.01 and np.sort(missed)[-7] < 2e-5
    travelled = motion.qpos[-1, 0] - motion.qpos[0, 0]
    assert (
        abs(travelled - 3 * 2 * 0.95 * np.sin(0.2880980750416) - 3 * 2 * 0.05 * 0.2880980750416)
        < 1e-6
    )


def test_a_keyframe_brings_back_the_start(exported):
    robot, motion, place = exported
    model = mujoco.MjModel.from_xml_path(str(place))
    assert np.abs(model.key_qpos[0] - motion.qpos[0]).max() < 1e-9
    again = wj.robot(place)
    assert again.machine == robot.machine
    assert np.abs(np.array(again.near) - GAIT).max() < 1e-9


def test_a_film_shows_the_robot_that_walks(exported, tmp_path):
    """In the middle, as the camera follows it; the right leg swings forward."""
    robot, _, _ = exported
    film = tmp_path / "walk.gif"
    try:
        mujoco.Renderer(mujoco.MjModel.from_xml_path(str(PATH)), 8, 8).close()
    except Exception as error:  # whatever a platform without OpenGL raises
        pytest.skip(f"MuJoCo cannot render here: {error}")
    wj.export_motion(robot, GAIT, PATH, strides=1, rate=10, film=film)
    feet, hips = [], []
    with Image.open(film) as opened:
        frames: Any = opened
        assert frames.n_frames == 9 and frames.info["duration"] == 100
        for k in range(7):
            frames.seek(k)
            red, _, blue = np.moveaxis(np.array(frames.convert("RGB"), float), -1, 0)
            rows, columns = np.nonzero(blue > red + 40)  # the right leg
            feet.append(columns[rows.argmax()])
            hips.append(np.nonzero(red[:240] < 200)[1].mean())  # before the sky
    assert np.abs(np.array(hips) - 320).max() < 60
    assert np.all(np.diff(feet) > 0) and feet[0] < 300 and feet[-1] > 340


def test_without_a_renderer_a_film_is_refused_in_one_line(exported, tmp_path, monkeypatch):
    robot, _, _ = exported

    def refuse(*_):
        raise RuntimeError("no OpenGL\nat all")

    monkeypatch.setattr(mujoco, "Renderer", refuse)
    reason = r"film needs OpenGL, which MuJoCo cannot use here \(no OpenGL at all\): set MUJOCO_GL"
    with pytest.raises(ComputationFailed, match=reason):
        wj.export_motion(robot, GAIT, PATH, strides=1, rate=10, film=tmp_path / "walk.gif")


def test_a_walk_that_falls_is_not_exported(exported):
    robot, _, _ = exported
    with pytest.raises(ComputationFailed, match="the walk ends in stride 1"):
        wj.export_motion(robot, GAIT * [1, 3, 1], PATH)
    with pytest.raises(ValueError, match="path must be that of the robot"):
        wj.export_motion(robot, GAIT, FILES / "kneed.xml")
    with pytest.raises(ValueError, match="rate must be positive"):
        wj.export_motion(robot, GAIT, PATH, rate=0)
    with pytest.raises(ValueError, match=r"film must end in \.gif"):
        wj.export_motion(robot, GAIT, PATH, film="walk.mp4")


def test_steps_of_mujoco_approach_a_stride_as_contacts_stiffen(exported):
    """To first order in the time constant of its contacts; benchmarks/robots.py has the impact."""
    _, motion, _ = exported
    errors = [
        largest_errors(motion, [0.4, 0.7], 0.7796973663, time_constant=tau, step=tau / 20)
        for tau in (0.02, 0.01, 0.005)
    ]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.abs(orders - 1).max() < 0.15 and np.max(errors[-1]) < 3e-4
