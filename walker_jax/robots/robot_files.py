"""`wj.robot`: a robot from an MJCF or URDF file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.robots.contacts import feet_of
from walker_jax.robots.files import compile_file, load_mujoco
from walker_jax.robots.forces import Controller
from walker_jax.robots.foreign import check_supported
from walker_jax.robots.legs import sides_of, tree_of
from walker_jax.robots.machine import Machine
from walker_jax.robots.planes import plane_of
from walker_jax.robots.reading import Reader, keyframe_of
from walker_jax.robots.robots import Robot
from walker_jax.robots.soft_contacts import soft_contact
from walker_jax.systems.system import code_of

UNNAMED = "MuJoCo Model"
"""The name that MuJoCo gives to a model without one."""
PATHS: dict[tuple, Path] = {}
"""Files of the robots that were made of a path alone, by their code."""


def robot(
    path: str | os.PathLike,
    *,
    feet: Sequence[str] | None = None,
    controller: Controller | None = None,
    parameters: Mapping[str, Any] | None = None,
    check_scuffing: bool = False,
) -> Robot:
    """Read a planar robot on two like legs from an MJCF or URDF file.

    ```python
    robot = wj.robot("compass.xml")
    gait = wj.find_gait(robot)
    ```

    MuJoCo compiles the file. Its masses, lengths, inertias, springs, dampers and servos become
    parameters by name, `thigh_mass` for both thighs; numbers that are zero in the file are no
    parameters.

    **Arguments:**

    - `path`: the file.
    - `feet`: names of two geoms (spheres, capsules, or cylinders across the plane) or sites
      (points); by default the lowest geoms that can touch the ground, or else the two sites named
      foot.
    - `controller`: a pure JAX function (q, rates, parameters) that returns ctrl of actuators by
      name, from the values and rates of joints by name, `stance_knee`, `swing_knee`. Others keep
      their parameter, `stance_hip_ctrl`: a torque of a motor, a target of a servo.
    - `parameters`: further numbers, of the controller, or other values than those of the file.
    - `check_scuffing`: whether straight legs fail (`SCUFFED`) where the swing foot is below the
      ground.

    Raises `ValueError`, which names the part, for what is not planar or cannot be had.
    """
    check_kind("check_scuffing", check_scuffing, bool)
    check_kind("parameters", {} if parameters is None else parameters, Mapping)
    if controller is not None and not callable(controller):
        raise WrongUse(f"controller must be a function, not {short(controller)}")
    reader, machine = read_machine(path, feet)
    numbers, key = dict(reader.ledger.numbers), keyframe_of(reader, machine)
    numbers |= {} if key is None else key.ctrl
    numbers |= dict(parameters or {})
    how: Any = {"contact": soft_contact(reader), "check_scuffing": check_scuffing}
    made = Robot(machine, numbers, controller, **how)
    if key is not None:
        free = [machine.order.index(i) for i in made.landing().free]
        near = [key.coordinates[i] for i in free[:-1]] + [key.rates[i] for i in free]
        made = Robot(machine, numbers, controller, near=tuple(near), **how)
    if feet is None and controller is None and not check_scuffing:
        PATHS[code_of(made)] = Path(path).resolve()
    return made


def path_of(robot: Robot) -> Path | None:
    """Return the file of which this process made a robot by `robot(path)`; None if by none."""
    return PATHS.get(code_of(robot))


def read_machine(path: str | os.PathLike, feet: Sequence[str] | None) -> tuple[Reader, Machine]:
    """Return the machine of a file, and its reader, which knows MuJoCo's coordinates."""
    (spec, model), mujoco = compile_file(path), load_mujoco()
    check_supported(mujoco, model)
    plane = plane_of(mujoco, model)
    tree = tree_of(mujoco, model)
    sides = sides_of(model, tree, feet_of(mujoco, plane, feet))
    reader = Reader(mujoco, spec, plane, tree, sides)
    given = model.names.split(b"\0")[0].decode()
    called = Path(path).stem if given in ("", UNNAMED) else given
    return reader, reader.machine(re.sub(r"\W+", "_", called))
