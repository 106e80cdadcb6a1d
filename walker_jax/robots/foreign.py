"""Parts of a model that a planar machine on two feet cannot have, refused by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from walker_jax.checks import WrongUse

PARTS = {
    "ntendon": ("tendon", "tendon"),
    "neq": ("equality constraint", "equality"),
    "nflex": ("flexible body", "flex"),
    "npair": ("contact pair", "pair"),
    "nplugin": ("plugin", "plugin"),
}
"""Counts of a model whose parts are refused: the noun, and MuJoCo's name for the kind."""
FLUID = "density", "viscosity"


def name_in(model: Any, kind: str, number: Any) -> str:
    """Return the name of a part of a model, or its number where it has none."""
    return getattr(model, kind)(int(number)).name or f"{kind}{number}"


def check_supported(mujoco: Any, model: Any) -> None:
    """Raise `WrongUse` for the first part that cannot be had."""
    for reason in unsupported(mujoco, model):
        raise WrongUse(f"path {reason}")


def unsupported(mujoco: Any, model: Any) -> Iterator[str]:
    """Yield what cannot be had, by name."""
    for count, (noun, kind) in PARTS.items():
        if getattr(model, count):
            yield f"has the {noun} {part_name(model, kind)}, which a planar machine cannot have"
    for name in FLUID:
        if getattr(model.opt, name):
            yield f"has option {name} {getattr(model.opt, name):g}: nothing moves in a fluid here"
    if model.nmocap:
        yield "has a mocap body, which is moved from outside"
    yield from joints_unsupported(mujoco, model)
    yield from actuators_unsupported(mujoco, model)


def part_name(model: Any, kind: str) -> str:
    """Return the name of the first part of a kind."""
    return name_in(model, kind, 0) if hasattr(model, kind) else f"{kind}0"


def joints_unsupported(mujoco: Any, model: Any) -> Iterator[str]:
    kinds = mujoco.mjtJoint
    for i in range(model.njnt):
        joint, kind = name_in(model, "joint", i), int(model.jnt_type[i])
        if kind == kinds.mjJNT_FREE:
            yield f"has the free joint {joint}: give the base two slides and a hinge in the plane"
        elif kind == kinds.mjJNT_BALL:
            yield f"has the ball joint {joint}: only hinges about one axis and slides are planar"
        if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            continue
        dof = model.jnt_dofadr[i]
        if model.dof_frictionloss[dof]:
            yield f"has frictionloss in joint {joint}: dry friction has no smooth equations"
        if np.any(model.jnt_stiffnesspoly[i]) or np.any(model.dof_dampingpoly[dof]):
            yield f"has a spring or damper in joint {joint} that is not linear"
        if model.jnt_actfrclimited[i]:
            yield f"has actuatorfrcrange in joint {joint}: limit the actuator by forcerange"
    for i in np.flatnonzero(model.body_gravcomp):
        yield f"has gravcomp in body {name_in(model, 'body', i)}: gravity acts on all bodies"


def actuators_unsupported(mujoco: Any, model: Any) -> Iterator[str]:
    for i in range(model.nu):
        name = name_in(model, "actuator", i)
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            yield f"has the actuator {name}, which acts on no joint"
        elif model.actuator_dyntype[i] != mujoco.mjtDyn.mjDYN_NONE:
            yield f"has the actuator {name} with a state of its own: use motor or position"
        elif kind_of(mujoco, model, i) is None:
            yield f"has the actuator {name}, which is no motor, position or velocity servo"
        elif model.actuator_damping[i] or model.actuator_armature[i]:
            yield f"has damping or armature in actuator {name}: give them to its joint"


def kind_of(mujoco: Any, model: Any, i: int) -> str | None:
    """Return motor, position or velocity for an actuator; None for any other."""
    gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
    if model.actuator_gaintype[i] != mujoco.mjtGain.mjGAIN_FIXED:
        return None
    if model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE:
        return "motor"
    if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_AFFINE or bias[0]:
        return None
    if bias[1] == -gain[0] and gain[0]:
        return "position"
    return "velocity" if bias[1] == 0 and bias[2] == -gain[0] else None
