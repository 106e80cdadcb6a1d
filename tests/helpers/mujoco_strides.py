"""Strides of compass.xml by MuJoCo's own time steps, with its soft contacts."""

from typing import Any

import mujoco as installed
import numpy as np
from robot_examples import FILES

mujoco: Any = installed
"""Type checkers do not know the names in it."""
PATH = FILES / "compass.xml"
FEET = "left_foot", "right_foot"


def simulate(qpos, qvel, times, impact, *, time_constant, step):
    """qpos at times from a start on the left foot, whose other foot comes down at `impact`.

    A foot touches the ground alone while it stands or comes down, as straight legs scuff.
    """
    model = mujoco.MjModel.from_xml_path(str(PATH))
    data, found = mujoco.MjData(model), []
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
    model.opt.cone, model.opt.iterations = mujoco.mjtCone.mjCONE_ELLIPTIC, 200
    model.opt.tolerance = 1e-14
    model.geom_solref[:] = time_constant, 1
    model.geom_solimp[:] = 0.99, 0.99, 0.001, 0.5, 2
    model.geom_friction[:, 0] = 2
    left, right = (model.geom(name).id for name in FEET)
    data.qpos[:], data.qvel[:] = qpos, qvel
    for time in times:
        for _ in range(round((time - data.time) / step)):
            model.geom_contype[left] = data.time < impact + 0.1
            model.geom_contype[right] = data.time > impact - 0.05
            mujoco.mj_step(model, data)
        found.append((data.time, data.qpos.copy()))
    return found


def largest_errors(motion, times, impact, *, time_constant, step):
    """Largest difference of any coordinate from an exported motion, at each time."""
    start = motion.qpos[0], motion.qvel[0]
    errors = []
    for time, qpos in simulate(*start, times, impact, time_constant=time_constant, step=step):
        i = int(np.argmin(np.abs(motion.times - time)))
        at = motion.qpos[i] + (time - motion.times[i]) * motion.qvel[i]
        errors.append(np.abs(qpos - at)[2:].max())
    return errors
