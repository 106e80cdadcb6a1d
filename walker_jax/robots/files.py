"""MJCF and URDF files, compiled by MuJoCo."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from walker_jax.checks import WrongPlace, WrongUse, short

SUFFIXES = ".xml", ".mjcf", ".urdf"


def is_robot_file(name: str) -> bool:
    """Return whether a name is that of a file of a robot."""
    return name.lower().endswith(SUFFIXES)


def load_mujoco() -> Any:
    """Return the package that reads such files."""
    try:
        import mujoco
    except ImportError as error:
        raise WrongUse(
            "robot needs the package mujoco, which reads such files: "
            "pip install 'walker-jax[robots]'"
        ) from error
    except Exception as error:  # such as an OpenGL that MUJOCO_GL names and is not there
        reason = " ".join(str(error).split())
        raise WrongUse(
            f"robot needs the package mujoco, which does not load here ({reason}): check MUJOCO_GL"
        ) from error
    return mujoco


def compile_file(path: str | os.PathLike) -> tuple[Any, Any]:
    """Return MuJoCo's specification of a file, and the compiled model.

    A URDF robot gets a base that is free in the plane.
    """
    if not isinstance(path, str | os.PathLike):
        raise WrongUse(f"path must be that of an MJCF or URDF file, not {short(path)}")
    file = Path(path)
    if not is_robot_file(file.name):
        raise WrongUse(f"path must end in {', '.join(SUFFIXES)}, not be {file}")
    if not file.is_file():
        raise WrongPlace(f"path {file}: there is no such file")
    mujoco = load_mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        if is_urdf(file):
            spec.compiler.fusestatic = False
            free_base(mujoco, spec)
        return spec, spec.compile()
    except ValueError as error:
        raise WrongUse(f"path {file} cannot be read: {' '.join(str(error).split())}") from error


def is_urdf(file: Path) -> bool:
    """Return whether a file is of the kind URDF, whose first element is a robot."""
    return re.search(r"<robot[\s>]", file.read_text(errors="replace")) is not None


def free_base(mujoco: Any, spec: Any) -> None:
    """Give the root of a URDF robot, which has no joint, two slides and a hinge."""
    roots = [body for body in spec.worldbody.bodies if not body.joints]
    if len(roots) != 1 or len(spec.worldbody.bodies) != 1:
        return
    model = spec.compile()
    hinges = [i for i in range(model.njnt) if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE]
    if not hinges:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    across = data.xaxis[hinges[0]]
    forward = np.cross(across, (0.0, 0.0, 1.0))
    kinds = mujoco.mjtJoint
    for name, kind, axis in (
        ("base_x", kinds.mjJNT_SLIDE, forward),
        ("base_z", kinds.mjJNT_SLIDE, (0.0, 0.0, 1.0)),
        ("base_turn", kinds.mjJNT_HINGE, across),
    ):
        roots[0].add_joint(name=name, type=kind, axis=axis)
