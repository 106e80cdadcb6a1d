"""The plane in which a machine moves, its ground, and all places in the pose of the file."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from walker_jax.checks import WrongUse
from walker_jax.robots.foreign import name_in

ALIGNED = 1e-9
"""Largest sine of an angle between directions that are to be the same: rounding of a file."""


class Plane(NamedTuple):
    """The plane of motion, and a model in the pose of its file."""

    model: Any
    data: Any
    along: np.ndarray
    """Along the ground, forward."""
    normal: np.ndarray
    """Normal of the ground, up."""
    across: np.ndarray
    """Axis of rotation from up to forward."""
    height: float
    """Of the ground, along its normal."""

    def flat(self, vector: np.ndarray) -> np.ndarray:
        """Return the components in the plane."""
        return np.array([vector @ self.along, vector @ self.normal])

    def gravity(self) -> tuple[float, float]:
        """Return the strength of gravity, and the slope of the ground."""
        pull = self.flat(self.model.opt.gravity)
        return float(np.hypot(*pull)), float(np.arctan2(pull[0], -pull[1]))


def plane_of(mujoco: Any, model: Any) -> Plane:
    """Return the plane of a model; raise `WrongUse` for one that does not move in a plane."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    kinds = mujoco.mjtJoint
    hinges = [i for i in range(model.njnt) if model.jnt_type[i] == kinds.mjJNT_HINGE]
    if not hinges:
        raise WrongUse("path has no hinge: legs must turn about one axis")
    normal, height = ground_of(mujoco, model, data)
    across = data.xaxis[hinges[0]]
    if abs(across @ normal) > ALIGNED:
        joint = name_in(model, "joint", hinges[0])
        raise WrongUse(f"path has the hinge {joint}, whose axis is not along the ground")
    across = (across - (across @ normal) * normal) / np.linalg.norm(across)
    along = np.cross(across, normal)
    if (along[0] if abs(along[0]) > ALIGNED else along[1]) < 0:  # forward is x, or else y
        across, along = -across, -along
    for i in range(model.njnt):
        parallel = abs(data.xaxis[i] @ across)
        off = parallel if model.jnt_type[i] == kinds.mjJNT_SLIDE else 1 - parallel
        if off > ALIGNED:
            raise WrongUse(
                f"path has the joint {name_in(model, 'joint', i)} out of the plane: all hinges "
                "must turn about one axis, and slides be at right angles to it"
            )
    if abs(model.opt.gravity @ across) > ALIGNED * (1 + np.linalg.norm(model.opt.gravity)):
        raise WrongUse("path has gravity out of the plane in which its joints move")
    if not model.opt.gravity @ normal < 0:
        raise WrongUse("path must have gravity that pulls to the ground")
    return Plane(model, data, along, normal, across, height)


def ground_of(mujoco: Any, model: Any, data: Any) -> tuple[np.ndarray, float]:
    """Return the normal and the height of the ground: the plane of the world, or z = 0."""
    ground = None
    for i in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[i]] != 0 or not touches(model, i):
            continue
        name = name_in(model, "geom", i)
        if model.geom_type[i] != mujoco.mjtGeom.mjGEOM_PLANE:
            raise WrongUse(f"path has the geom {name} in the world: the ground must be a plane")
        if ground is not None:
            raise WrongUse(f"path has a second ground, {name}: there must be one plane")
        ground = i
    if ground is None:
        return np.array([0.0, 0.0, 1.0]), 0.0
    normal = data.geom_xmat[ground].reshape(3, 3)[:, 2]
    return normal, float(normal @ data.geom_xpos[ground])


def touches(model: Any, geom: int) -> bool:
    """Return whether a geom can touch any other."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def can_touch(model: Any, one: int, other: int) -> bool:
    """Return whether two geoms are of kinds that touch each other."""
    kinds, affinities = model.geom_contype, model.geom_conaffinity
    return bool((kinds[one] & affinities[other]) | (kinds[other] & affinities[one]))
