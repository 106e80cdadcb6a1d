"""Accelerations, forces and impacts of robots against MuJoCo's own matrices, at random states."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mujoco_machines import Constrained
from robot_examples import FILES, TELESCOPE

import walker_jax as wj
from walker_jax.multibody.single_support import accelerations_and_forces
from walker_jax.robots.postures import mujoco_states
from walker_jax.robots.robot_files import read_machine
from walker_jax.robots.stances import RobotState, Stance

STATES = 1000


def random_states(stance: Stance, seed: int):
    """Coordinates and rates of the free links, around the pose of the file."""
    rng = np.random.default_rng(seed)
    links = [stance.machine.links[i] for i in stance.free]
    sizes = np.array([0.8 if link.turns else 0.2 for link in links])
    shape = (STATES, len(links))
    return rng.uniform(-1, 1, shape) * sizes, rng.normal(size=shape) * 2


def on_foot(values):
    """The same after (u, v) = 0."""
    return np.pad(values, ((0, 0), (2, 0)))


def as_states(values, rates):
    return RobotState(tuple(jnp.asarray(values.T)), tuple(jnp.asarray(rates.T)))


CASES = {
    "compass": ("compass.xml", [()]),
    "kneed": ("kneed.xml", [(1,), (1, 3)]),
    "five_link": ("five_link.xml", [()]),
    "urdf": ("compass.urdf", [()]),
    "telescope": (TELESCOPE, [()]),
}


SLOW = "compass", "five_link", "urdf"  # the others have all that these have


@pytest.fixture(
    scope="module",
    params=[pytest.param(one, marks=[pytest.mark.slow] * (one in SLOW)) for one in CASES],
)
def machine(request):
    file, locks = CASES[request.param]
    path = FILES / file
    reader, structure = read_machine(path, None)
    robot = wj.robot(path)
    rng = np.random.default_rng(1)
    ctrl = dict(zip((a.ctrl for a in structure.actuators), rng.normal(size=9), strict=False))
    robot = wj.robot(path, parameters=ctrl)
    return robot, Constrained(reader, structure), list(ctrl.values()), locks


def test_accelerations_and_forces_are_those_of_mujoco(machine):
    """Of its forward and of its inverse dynamics."""
    robot, model, ctrl, locks = machine
    for locked in locks:
        stance = robot.with_locked(locked)
        values, rates = random_states(stance, 2)
        qpos, qvel = mujoco_states(model.reader, stance, on_foot(values), on_foot(rates))
        solve = jax.jit(jax.vmap(partial(accelerations_and_forces, stance)))
        accelerations, forces = (np.stack(one, 1) for one in solve(as_states(values, rates)))
        turned = np.pad(accelerations[:, 2:], ((0, 0), (2, 0)))
        _, joint_accelerations = mujoco_states(model.reader, stance, on_foot(values), turned)
        for i in range(STATES):
            joints, held = model.at(qpos[i], qvel[i], ctrl).motion([0], locked)
            expected = model.turns(joints)[list(stance.free)]
            largest = 1 + np.abs(expected).max()
            assert np.abs(accelerations[i, 2:] - expected).max() < 1e-9 * largest
            assert np.abs(forces[i, :2] - held[:2]).max() < 1e-9 * (1 + np.abs(held).max())
            missed = model.inverse(joint_accelerations[i], forces[i, :2], locked)
            assert np.abs(missed).max() < 1e-9 * (largest + np.abs(held).max())


def test_impacts_are_those_of_mujoco(machine):
    robot, model, _, _ = machine
    stance = robot.landing()
    values, rates = random_states(stance, 3)
    qpos, qvel = mujoco_states(model.reader, stance, on_foot(values), on_foot(rates))
    struck = jax.jit(jax.vmap(stance.struck))(as_states(values, rates))
    after, lifted = (np.stack(one, 1) for one in struck)
    for i in range(STATES):
        moved, _ = model.at(qpos[i], qvel[i]).impact([1], stance.locked)
        expected = model.turns(moved)[list(stance.free)]
        assert np.abs(after[i] - expected).max() < 1e-9 * (1 + np.abs(moved).max())
        other = model.foot(0)[0] @ moved
        assert np.abs(lifted[i] - other).max() < 1e-9 * (1 + np.abs(moved).max())


def test_knee_strikes_are_those_of_mujoco():
    path = FILES / "kneed.xml"
    reader, structure = read_machine(path, None)
    model, stance = Constrained(reader, structure), wj.robot(path).first()
    values, rates = random_states(stance, 4)
    at, knee = stance.free.index(3), 3
    values[:, at] = values[:, stance.free.index(2)]
    qpos, qvel = mujoco_states(reader, stance, on_foot(values), on_foot(rates))
    locked = jax.jit(jax.vmap(lambda state: stance.straightened(state, knee)))
    after = np.stack(locked(as_states(values, rates)).rates, 1)
    for i in range(STATES):
        moved, _ = model.at(qpos[i], qvel[i]).impact([0], (1, 3))
        expected = model.turns(moved)[[0, 2]]
        assert np.abs(after[i] - expected).max() < 1e-9 * (1 + np.abs(moved).max())
