"""The two feet of a machine, and contacts between its bodies, which are refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from walker_jax.checks import WrongUse, short
from walker_jax.robots.foreign import name_in
from walker_jax.robots.planes import ALIGNED, Plane, can_touch, touches

STEEPEST = 0.5
"""Least cosine of the angle between a capsule and the normal of the ground, so that one of its ends
is the foot."""


class Sole(NamedTuple):
    """The arc of a foot."""

    name: str
    body: int
    centre: np.ndarray
    """In the plane."""
    radius: float


def feet_of(mujoco: Any, plane: Plane, names: Sequence[str] | None) -> tuple[Sole, Sole]:
    """Return both feet: of these geoms or sites, or of the lowest geoms that touch the ground."""
    model = plane.model
    check_self_contacts(mujoco, plane)
    if names is None:
        soles = lowest(mujoco, plane)
    else:
        if isinstance(names, str) or not isinstance(names, Sequence) or len(names) != 2:
            raise WrongUse(f"feet must be the names of two geoms or sites, not {short(names)}")
        soles = [named_sole(mujoco, plane, name) for name in names]
    for one in soles:
        if model.body_weldid[one.body] == 0:
            raise WrongUse(f"feet must be of bodies that move, unlike {one.name}")
    if soles[0].body == soles[1].body:
        raise WrongUse(f"feet must be of two bodies, unlike {soles[0].name} and {soles[1].name}")
    return soles[0], soles[1]


def named_sole(mujoco: Any, plane: Plane, name: Any) -> Sole:
    """Return the foot of a geom or site by its name."""
    model, kinds = plane.model, mujoco.mjtObj
    if isinstance(name, str):
        geom = mujoco.mj_name2id(model, kinds.mjOBJ_GEOM, name)
        if geom >= 0:
            return sole_of_geom(mujoco, plane, geom)
        site = mujoco.mj_name2id(model, kinds.mjOBJ_SITE, name)
        if site >= 0:
            return sole_of_site(plane, site)
    raise WrongUse(f"feet must be names of geoms or sites in the file, not {short(name)}")


def sole_of_site(plane: Plane, site: int) -> Sole:
    """Return a foot that is a point."""
    at = plane.flat(plane.data.site_xpos[site])
    name = name_in(plane.model, "site", site)
    return Sole(name, int(plane.model.site_bodyid[site]), at, 0.0)


def sole_of_geom(mujoco: Any, plane: Plane, geom: int) -> Sole:
    """Return the foot of a sphere, the lower end of a capsule, or a roller across the plane."""
    model, data, kinds = plane.model, plane.data, mujoco.mjtGeom
    name, kind = name_in(model, "geom", geom), int(model.geom_type[geom])
    at, size = plane.flat(data.geom_xpos[geom]), model.geom_size[geom]
    axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    rolls = abs(abs(axis @ plane.across) - 1) < ALIGNED
    if kind == kinds.mjGEOM_CAPSULE and not rolls:
        if abs(axis @ plane.normal) < STEEPEST:
            raise WrongUse(f"feet must be round: the capsule {name} lies along the ground")
        at = at - size[1] * np.sign(axis @ plane.normal) * plane.flat(axis)
    elif kind == kinds.mjGEOM_CYLINDER and not rolls:
        raise WrongUse(f"feet must be round: the cylinder {name} does not roll")
    elif kind not in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        noun = kinds(kind).name.removeprefix("mjGEOM_").lower()
        raise WrongUse(f"feet must be spheres, capsules or sites: {name} is of type {noun}")
    return Sole(name, int(model.geom_bodyid[geom]), at, float(size[0]))


def lowest(mujoco: Any, plane: Plane) -> list[Sole]:
    """Return the feet of the two bodies that reach lowest, of those with geoms that may touch.

    Without any such geom they are sites whose names contain "foot".
    """
    model = plane.model
    moving = [
        i
        for i in range(model.ngeom)
        if touches(model, i) and model.body_weldid[model.geom_bodyid[i]] != 0
    ]
    if not moving:
        named = [i for i in range(model.nsite) if "foot" in model.site(i).name.lower()]
        if len(named) == 2:
            return [sole_of_site(plane, i) for i in named]
        raise WrongUse(
            "feet must be given: no geom can touch the ground, and no two sites are feet"
        )
    bodies: dict[int, list[int]] = {}
    for i in moving:
        bodies.setdefault(int(model.geom_bodyid[i]), []).append(i)
    bottom = lambda i: plane.flat(plane.data.geom_xpos[i])[1] - model.geom_rbound[i]
    ends = sorted(bodies, key=lambda body: min(map(bottom, bodies[body])))[:2]
    if len(ends) < 2:
        raise WrongUse("feet must be two: geoms of one body alone can touch the ground")
    for body in ends:
        if len(bodies[body]) > 1:
            names = ", ".join(name_in(model, "geom", i) for i in bodies[body])
            raise WrongUse(f"feet must be named: {names} are of one body, and may touch the ground")
    return [sole_of_geom(mujoco, plane, bodies[body][0]) for body in sorted(ends)]


def check_self_contacts(mujoco: Any, plane: Plane) -> None:
    """Raise `WrongUse` for geoms of two bodies that can touch each other."""
    model, data = plane.model, plane.data
    excluded = {tuple(divmod(int(one), 2**16)) for one in model.exclude_signature}
    across = data.geom_xpos @ plane.across
    for i in range(model.ngeom):
        for j in range(i):
            pair = sorted(int(model.geom_bodyid[k]) for k in (i, j))
            first, second = (int(model.body_weldid[body]) for body in pair)
            if 0 in (first, second) or first == second or not can_touch(model, i, j):
                continue
            parents = (int(model.body_weldid[model.body_parentid[one]]) for one in (first, second))
            related = next(parents) == second or next(parents) == first
            apart = abs(across[i] - across[j]) > model.geom_rbound[i] + model.geom_rbound[j]
            if related or apart or not excluded.isdisjoint({tuple(pair), tuple(pair[::-1])}):
                continue
            raise WrongUse(
                f"path has geoms {name_in(model, 'geom', j)} and {name_in(model, 'geom', i)} that "
                "can touch each other: exclude contacts between bodies, or set their conaffinity"
            )
