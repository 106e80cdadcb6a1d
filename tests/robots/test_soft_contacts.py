"""Words on MuJoCo's soft contacts, against balls that MuJoCo itself drops."""

from typing import Any

import mujoco as installed
import numpy as np
import pytest
from robot_examples import FILES, as_robot

import walker_jax as wj
from walker_jax.robots.soft_contacts import SoftContact, stopping

mujoco: Any = installed
"""Type checkers do not know the names in it."""
SPEED = 0.05
DEFAULTS = 'solref="0.02 1" solimp="0.9 0.95 0.001 0.5 2"'
SPRINGY = 'solref="-3000 -40" solimp="0.97 0.98 0.002 0.5 2"'
SLOW = 'solref="0.1 1.5" solimp="0.8 0.9 0.001 0.5 2"'


def contact_of(folder, contacts, **options) -> SoftContact:
    """The contact of compass.xml with other numbers of its feet."""
    text = (FILES / "compass.xml").read_text()
    text = text.replace('friction="1"', f'friction="1" priority="1" {contacts}')
    for name, value in options.items():
        text = text.replace(f'{name}="1e-4"', f'{name}="{value}"')
    (folder / "compass.xml").write_text(text)
    found = wj.robot(folder / "compass.xml").contact
    assert found is not None
    return found


def dropped(contacts, gravity, speed, steps, step=2e-5):
    """Heights of a ball on the ground, which begins at a speed; and its speeds."""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{step}" gravity="0 0 {-gravity}"/>
      <worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.05">
        <joint type="slide" axis="0 0 1"/><geom size="0.05" priority="1" {contacts}/>
      </body></worldbody></mujoco>""")
    data, found = mujoco.MjData(model), []
    data.qvel[:] = -speed
    for _ in range(steps):
        mujoco.mj_step(model, data)
        found.append((data.qpos[0], data.qvel[0]))
    return np.array(found).T


@pytest.mark.parametrize("contacts", [DEFAULTS, SPRINGY, SLOW], ids=["default", "springy", "slow"])
def test_feet_stop_and_stand_as_deep_as_balls_in_mujoco(contacts, tmp_path):
    found = contact_of(tmp_path, contacts)
    depths, speeds = dropped(contacts, 0.0, SPEED, 10_000)
    stopped = int(np.argmax(speeds >= 0))
    # the impedance changes while a foot sinks
    assert found.stop == pytest.approx(stopped * 2e-5, rel=5e-3)
    assert found.reach * SPEED == pytest.approx(-depths[stopped], rel=0.03)
    depths, speeds = dropped(contacts, 9.81 * np.cos(0.05), 0.0, 8000, 1e-3)
    assert abs(speeds[-1]) < 1e-6
    assert found.rest == pytest.approx(-depths[-1], rel=1e-6)


def test_a_time_constant_below_two_steps_is_two_steps(tmp_path):
    short = contact_of(tmp_path, 'solref="0.001 1"', timestep=0.002)
    assert (short.step, short.solref) == (0.002, (0.001, 1.0))
    assert short.stop == pytest.approx(2 * 0.002, rel=0.1)


def test_a_foot_that_is_stopped_follows_its_equation():
    """r = v t exp(-w t) with critical damping, sin without any."""
    assert stopping(2500.0, 100.0) == pytest.approx((0.02, 0.02 / np.e))
    assert stopping(2500.0, 0.0) == pytest.approx((np.pi / 100, 0.02))
    for damping in (30.0, 99.999, 100.001, 400.0):
        roots = np.roots([1.0, damping, 2500.0]).astype(complex)
        time, depth = stopping(2500.0, damping)
        weights = np.linalg.solve(np.stack([np.ones(2), roots]), np.array([0.0, 1.0]))
        depths, rates = weights * np.exp(roots * time), weights * roots * np.exp(roots * time)
        assert abs(rates.sum()) < 1e-7 and depths.sum().real == pytest.approx(depth, rel=1e-6)


def test_a_robot_says_how_mujoco_differs():
    """With the file's own numbers; and that nothing touches where nothing can."""
    lines = wj.robot(FILES / "compass.xml").remarks()
    assert len(lines) == 3 and all(line.startswith("MuJoCo: ") for line in lines)
    assert "solref 0.02 1, solimp 0.9 0.95 0.001 0.5 2" in lines[0]
    assert "sinks by 0.00037" in lines[0] and "beyond a friction of 1" in lines[0]
    assert "in 0.0208, which is 208 of its time steps, 0.0077 v below" in lines[1]
    assert "to first order in that time" in lines[2]
    (line,) = wj.robot(FILES / "compass.urdf").remarks()
    assert "touch no ground" in line


REMARKS = "MuJoCo: it would bounce.", "MuJoCo: it would stop."


class MapWithRemarks(wj.Map):
    def remarks(self):
        return REMARKS


def test_explain_repeats_what_a_system_says():
    halve: Any = (lambda x: x / 2), ("x",)
    plain, told = wj.explain(wj.Map(*halve), [0.5]), wj.explain(MapWithRemarks(*halve), [0.5])
    assert plain.remarks == () and told.remarks == REMARKS
    assert str(told).splitlines()[-2:] == [*REMARKS]


@pytest.mark.slow
def test_explain_a_robot():
    robot = wj.robot(FILES / "compass.xml")
    found = wj.explain(robot, as_robot((0.28809807504, -0.35705418063, -0.20285043033)))
    assert found.complaints == [] and found.remarks == robot.remarks()
