"""Wrong uses of robots, each told in one line."""

import os
import subprocess
import sys

import pytest
from reference import ROOT
from robot_examples import FILES
from unchecked import unchecked

import walker_jax as wj

COMPASS, KNEED = FILES / "compass.xml", FILES / "kneed.xml"


def edited(folder, source, *changes):
    """A file with some changes."""
    text = source.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "edited.xml").write_text(text)
    return folder / "edited.xml"


ARGUMENTS = {
    "path must be that of an MJCF or URDF file, not 3": lambda: wj.robot(3),  # pyright: ignore[reportArgumentType]
    "path must end in .xml, .mjcf, .urdf, not be robot.py": lambda: wj.robot("robot.py"),
    "path none.xml: there is no such file": lambda: wj.robot("none.xml"),
    "feet must be the names of two geoms or sites": lambda: wj.robot(COMPASS, feet="left_foot"),
    "feet must be names of geoms or sites in the file, not 'toe'": lambda: wj.robot(
        COMPASS, feet=("left_foot", "toe")
    ),
    "feet must be of two bodies, unlike left_foot and left_foot": lambda: wj.robot(
        COMPASS, feet=("left_foot", "left_foot")
    ),
    "controller must be a function, not 3": lambda: wj.robot(COMPASS, controller=3),  # pyright: ignore[reportArgumentType]
    "check_scuffing must be": lambda: wj.robot(COMPASS, check_scuffing=3),  # pyright: ignore[reportArgumentType]
}


@pytest.mark.parametrize("message", ARGUMENTS)
def test_wrong_arguments_of_robots_are_told(message):
    with unchecked(), pytest.raises(ValueError) as refused:
        ARGUMENTS[message]()
    assert str(refused.value).startswith(message) and "\n" not in str(refused.value)


def test_a_controller_must_name_actuators():
    robot = wj.robot(FILES / "five_link.xml", controller=lambda q, rates, p: {"knee": 0.0})
    with pytest.raises(ValueError, match="by the names of actuators, stance_hip, stance_knee"):
        wj.explain(robot, robot.gait_region().centre(0))


def test_without_mujoco_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ValueError, match=r"pip install 'walker-jax\[robots\]'"):
        wj.robot(COMPASS)


def test_a_mujoco_that_does_not_load_is_told_in_one_line():
    """Without the OpenGL that the environment names, it cannot even be imported."""
    load = "from walker_jax.robots.files import load_mujoco; load_mujoco()"
    environment = os.environ | {"MUJOCO_GL": "nothing"}
    run = [sys.executable, "-c", load]
    said = subprocess.run(run, env=environment, cwd=ROOT, capture_output=True, text=True).stderr
    reason = "invalid value for environment variable MUJOCO_GL: nothing"
    assert said.splitlines()[-1].endswith(
        f"robot needs the package mujoco, which does not load here ({reason}): check MUJOCO_GL"
    )


CHANGED = {
    "path has legs with the knees stance_knee and stance_ankle: one may lock": [
        (
            f'<geom name="{side}_foot" class="foot" pos="0 {place} -0.45"/>',
            f'<body name="{side}_toe"><joint name="{side}_ankle" class="knee"/>'
            '<inertial pos="0 0 -.4" mass="1" diaginertia=".1 .1 .1"/>'
            f'<geom name="{side}_foot" class="foot" pos="0 {place} -0.45"/></body>',
        )
        for side, place in (("left", "-0.05"), ("right", "0.05"))
    ],
    "path must have like legs: those of left_foot and right_foot have other joints": [
        (
            '<geom name="left_foot"',
            '<body name="flag"><joint axis="0 1 0"/><geom size=".1" mass="1"/></body>'
            '<geom name="left_foot"',
        )
    ],
    "path has two parts with a number hip_com_x: name them differently": [
        ('<body name="left_thigh">', '<body name="left_hip">'),
        ('<body name="right_thigh">', '<body name="right_hip">'),
    ],
    "path has slides of the base at no right angle, below cart": [
        (
            '<joint name="x" type="slide" axis="1 0 0"/>\n      '
            '<joint name="z" type="slide" axis="0 0 1"/>',
            '<joint name="z" type="slide" axis="1 0 1"/>',
        ),
        (
            '<body name="hip" pos="0 0 1">',
            '<body name="cart"><joint name="x" type="slide" axis="1 0 0"/>'
            '<geom size=".1" mass="1"/><body name="hip" pos="0 0 1">',
        ),
        ("</worldbody>", "</body></worldbody>"),
    ],
}


@pytest.mark.parametrize("message", CHANGED)
def test_changed_files_are_refused(message, tmp_path):
    with pytest.raises(ValueError) as refused:
        wj.robot(edited(tmp_path, KNEED, *CHANGED[message]))
    assert str(refused.value) == message


def test_feet_are_of_bodies_that_move(tmp_path):
    stone = ("<worldbody>", '<worldbody><site name="stone"/>')
    with pytest.raises(ValueError, match="feet must be of bodies that move, unlike stone"):
        wj.robot(edited(tmp_path, COMPASS, stone), feet=("left_foot", "stone"))
