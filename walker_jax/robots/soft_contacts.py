"""MuJoCo's contact of a foot with the ground: a spring and damper, where here an impact is instant.

For a depth r MuJoCo's contact has the acceleration -d (b r' + k r), to which it adds 1 - d of the
acceleration that there would be without contact; d, the impedance, b and k follow from `solref` and
`solimp` (its documentation, "Solver parameters").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from walker_jax.robots.reading import Reader

TOUCH = 1e-6
"""Depth, over the size of a foot or 1, at which a foot is put to have a contact."""
ROUNDS = 50
"""Rounds in which the depth at rest is found: it sinks as the impedance grows with the depth."""


class SoftContact(NamedTuple):
    """Numbers of a foot's contact, as MuJoCo takes them from the file."""

    solref: tuple[float, ...]
    solimp: tuple[float, ...]
    friction: float | None
    """None for a contact without friction."""
    stop: float
    """Time in which a foot that comes down is stopped; infinite where nothing stops it."""
    reach: float
    """Depth at which it is stopped, for a speed of 1."""
    rest: float
    """Depth of a foot that carries its load at rest."""
    step: float
    """Time step."""


def remarks_on(contact: SoftContact | None) -> tuple[str, ...]:
    """Return in words how MuJoCo's motion differs."""
    if contact is None:
        return ("MuJoCo: the feet of this file touch no ground there, and here it is rigid",)
    solref, solimp = (" ".join(f"{one:g}" for one in some) for some in contact[:2])
    slip = "freely" if contact.friction is None else f"beyond a friction of {contact.friction:g}"
    return (
        f"MuJoCo: its ground gives way (solref {solref}, solimp {solimp}): a foot that stands "
        f"sinks by {contact.rest:.2g}; here it is rigid, and a foot never slips, but there {slip}",
        f"MuJoCo: it stops a foot that comes down at a speed v in {contact.stop:.3g}, which is "
        f"{contact.stop / contact.step:.3g} of its time steps, {contact.reach:.2g} v below the "
        "ground; here the impact is instant, without rebound",
        "MuJoCo: states after a stride differ from these to first order in that time",
    )


def soft_contact(reader: Reader) -> SoftContact | None:
    """Return MuJoCo's contact of the first foot; None where it would not touch the ground."""
    sole = reader.sides.feet[0]
    size = max(sole.radius, TOUCH)
    found = touch(reader, TOUCH * size)
    if found is None:
        return None
    (contact, (stiffness, damping, impedance)), depth = found, 0.0
    strength, slope = reader.plane.gravity()
    for _ in range(ROUNDS):
        load = (1 - impedance) * strength * np.cos(slope)
        depth = load / (impedance * stiffness) if stiffness else np.inf
        _, (stiffness, damping, impedance) = touch(reader, max(depth, TOUCH * size)) or found
    stop, reach = stopping(impedance * stiffness, impedance * damping)
    return SoftContact(
        tuple(contact.solref.tolist()),
        tuple(contact.solimp.tolist()),
        float(contact.friction[0]) if contact.dim > 1 else None,
        stop,
        reach,
        float(depth),
        float(reader.model.opt.timestep),
    )


def touch(reader: Reader, depth: float) -> tuple[Any, tuple[float, float, float]] | None:
    """Return MuJoCo's contact of the first foot at a depth, with its stiffness, damping, impedance.

    The base is moved there, in the pose of the file; all feet and the ground are as they are.
    """
    mujoco, model, plane, sole = reader.mujoco, reader.model, reader.plane, reader.sides.feet[0]
    slides = np.stack([plane.flat(reader.data.xaxis[i]) for i in (0, 1)], axis=1)
    gap = sole.centre[1] - sole.radius - plane.height
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    data.qpos[:2] += np.linalg.solve(slides, [0.0, -gap - depth])
    mujoco.mj_fwdPosition(model, data)
    for one in data.contact:
        bodies = {int(model.geom_bodyid[one.geom[k]]) for k in (0, 1)}
        if sole.body in bodies and any(model.body_weldid[body] == 0 for body in bodies):
            if one.efc_address >= 0:
                stiffness, damping, impedance, _ = data.efc_KBIP[one.efc_address].tolist()
                return one, (impedance * stiffness, damping, impedance)
    return None


def stopping(stiffness: float, damping: float) -> tuple[float, float]:
    """Return when r'' = -damping r' - stiffness r stops from r = 0, r' = 1, and r there."""
    half = damping / 2
    root = np.sqrt(complex(stiffness - half**2))
    if abs(root) < 1e-6 * max(half, np.sqrt(max(stiffness, 0.0))):  # critical
        stop = 1 / half if half else np.inf
    else:
        stop = float((np.arctan(root / half) / root).real) if half else float(np.pi / 2 / root.real)
    return stop, float(np.exp(-half * stop) / np.sqrt(stiffness)) if stiffness else np.inf
