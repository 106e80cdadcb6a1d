"""Strides of compass.xml by MuJoCo's own time steps: a black box, with soft contacts.

A stride begins as the left foot touches the ground in front, and ends as the right one does. The
coordinates are those of the front leg, angle and rate, and the rate of the rear leg.
"""

from pathlib import Path

import mujoco
import numpy as np

import walker_jax as wj

MODEL = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("compass.xml")))
MODEL.opt.timestep = 5e-4
MODEL.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
MODEL.geom_solref[:] = 0.01, 1
MODEL.geom_friction[:, 0] = 2
LEFT, RIGHT = (MODEL.geom(name).id for name in ("left_foot", "right_foot"))
RADIUS, LENGTH, LONGEST = 0.05, 0.95, 3.0


def stride(front, rate, rear_rate):
    """Return the next such state; None for a fall."""
    data = mujoco.MjData(MODEL)
    height = RADIUS + LENGTH * np.cos(front)
    data.qpos[:] = 0, height - 1, front, -front
    ahead, up = height * rear_rate, LENGTH * np.sin(front) * rear_rate  # the rear foot rolls
    data.qvel[:] = ahead, up, rate, rear_rate
    while data.time < LONGEST:
        left, right = data.qpos[2:]
        passed = left > 0 and left + right < 0  # the right foot is ahead, and above the ground
        MODEL.geom_contype[LEFT] = 1
        MODEL.geom_contype[RIGHT] = data.time < 0.02
        mujoco.mj_step(MODEL, data)
        left, right = data.qpos[2:]
        if passed and left + right >= 0:
            return right, data.qvel[3], data.qvel[2]
        if abs(left) > 1.2 or (data.time > 0.1 and data.qvel[2] < 0):
            return None
    return None


def mujoco_compass(starts):
    """Make a stride from each start: the next states, and whether there is one."""
    ends = [stride(*start) for start in starts]
    made = np.array([end is not None for end in ends])
    return np.array([(np.nan,) * 3 if end is None else end for end in ends]), made


box = wj.BlackBox(mujoco_compass, ("front", "front_rate", "rear_rate"), step=1e-3)
