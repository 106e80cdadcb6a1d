"""The programs and files of docs/robots.md."""

import re
import shutil
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from reference import ROOT
from robot_examples import FILES, as_robot

import walker_jax as wj
from walker_jax.walkers.references import load_file

PAGE = (ROOT / "docs" / "robots.md").read_text()
GAIT = as_robot((0.28809807504, -0.35705418063, -0.20285043033))


def run(title, folder, monkeypatch):
    """The names that a program of the page makes, run beside the files."""
    (source,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", PAGE, re.S)
    for file in FILES.glob("*.xml"):
        shutil.copy(file, folder)
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    exec(compile(source, title, "exec"), names)
    return names


@pytest.mark.slow
def test_a_robot_from_a_file(tmp_path, monkeypatch):
    made = run("a robot from a file", tmp_path, monkeypatch)
    assert np.abs(made["gait"].states[0] - GAIT).max() < 1e-7


def test_a_controller_acts_on_the_joints(tmp_path, monkeypatch):
    robot = run("a controller", tmp_path, monkeypatch)["robot"]
    assert {"gain", "loss", "swing_hip_ctrl"} <= set(robot.parameters)
    q = jnp.array([0, 0, -0.1, -0.4, 0.2, 0.1, 0.5])
    forces = np.asarray(robot.landing().system().generalised_forces(q, 0 * q))
    knee, hip = -400 * (0.3 - 0.2), 400 * (0.2 - 0.1)
    assert np.abs(forces - [0, 0, knee, hip - knee, -hip, 0, 0]).max() < 1e-12


def test_a_walk_goes_back_to_mujoco(tmp_path, monkeypatch):
    made = run("back to MuJoCo", tmp_path, monkeypatch)
    assert made["way"].qpos.shape == (len(made["way"].times), 4)
    assert wj.robot(tmp_path / "walking.xml").near is not None


@pytest.mark.filterwarnings("ignore:.*black box")
def test_a_loop_of_mujoco_walks_as_the_robot():
    """The state of the robot's gait before an impact, which is its end; then some disturbances."""
    loop = load_file(FILES / "mujoco_loop.py")
    front = np.array([-0.28809808, 1.65771752, 1.49294265])
    walked = np.array(loop.stride(*front))
    assert np.abs(walked - front).max() < 0.04
    found = wj.audit(loop.box, walked, 0.02, samples=4, strides=5, within=0.15)
    assert found.returned == 1 and found.low < 0.6 and found.strides >= 5
    assert wj.audit(loop.box, walked, 1.5, samples=4, strides=5, within=0.15, seed=1).returned < 1
