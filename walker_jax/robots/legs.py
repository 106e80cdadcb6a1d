"""The links of a machine as trunk and two like legs."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from walker_jax.checks import WrongUse
from walker_jax.robots.contacts import Sole
from walker_jax.robots.foreign import name_in
from walker_jax.robots.machine import BASE

SIDES = {"left": 0, "l": 0, "right": 1, "r": 1}
"""Words in names for the side of a part."""


class Tree(NamedTuple):
    """The joints of a model but the base's two slides, by numbers of their own."""

    dofs: list[int]
    """Of the model."""
    parents: list[int]
    of_body: dict[int, int]
    """Link of each body that moves; `BASE` for those that the slides of the base move."""

    def above(self, link: int) -> list[int]:
        """Return a link and those above it, up to the base."""
        found = []
        while link != BASE:
            found.append(link)
            link = self.parents[link]
        return found

    def below(self, link: int) -> list[int]:
        return [i for i, parent in enumerate(self.parents) if parent == link]


class Sides(NamedTuple):
    legs: tuple[tuple[int, ...], tuple[int, ...]]
    """Links from the hip to each foot, those of the leg that stands first being first."""
    mirror: tuple[int, ...]
    left: tuple[int, ...]
    """Links of the first side."""
    feet: tuple[Sole, Sole]


def tree_of(mujoco: Any, model: Any) -> Tree:
    """Return the tree; raise `WrongUse` unless two slides of the base come first."""
    slide, names = (
        mujoco.mjtJoint.mjJNT_SLIDE,
        [name_in(model, "joint", i) for i in range(model.njnt)],
    )
    parents = model.dof_parentid
    free = "the base must be free in the plane: its first two joints must be slides"
    if model.nv < 4 or any(model.jnt_type[i] != slide for i in (0, 1)):
        raise WrongUse(f"path has {names[0]} first: {free}")
    if parents[0] != -1 or parents[1] != 0 or any(parents[i] < 1 for i in range(2, model.nv)):
        at = next(i for i in range(model.nv) if parents[i] < min(i - 1, 1))
        raise WrongUse(f"path has {names[at]} beside the slides of the base: {free}")
    for i in (0, 1):
        if model.jnt_stiffness[i] or model.dof_damping[i] or model.dof_armature[i]:
            raise WrongUse(f"path has a spring, damper or armature in {names[i]}, of the free base")
    of_body: dict[int, int] = {}
    for body in range(1, model.nbody):
        last = model.body_dofadr[body] + model.body_dofnum[body] - 1
        if model.body_dofnum[body]:
            of_body[body] = int(last) - 2
        elif model.body_weldid[body] != 0:
            of_body[body] = of_body[int(model.body_parentid[body])]
    dofs = list(range(2, model.nv))
    return Tree(dofs, [max(int(parents[i]) - 2, BASE) for i in dofs], of_body)


def without_side(name: str) -> tuple[str, int | None]:
    """Return a name without the word for its side, and the side; None if it names none."""
    words = [one for one in re.split(r"[\W_]+", name) if one]
    sides = [SIDES[one.lower()] for one in words if one.lower() in SIDES]
    rest = "_".join(one for one in words if one.lower() not in SIDES)
    return (rest, sides[0]) if rest and len(sides) == 1 else (re.sub(r"\W", "_", name), None)


def sides_of(model: Any, tree: Tree, feet: tuple[Sole, Sole]) -> Sides:
    """Return the legs and the pairs of links; raise `WrongUse` for legs that are no two likes."""
    if without_side(feet[0].name)[1] == 1 or without_side(body_name(model, feet[0]))[1] == 1:
        feet = feet[1], feet[0]
    up = [tree.above(tree.of_body[one.body]) for one in feet]
    shared = set(up[0]) & set(up[1])
    legs = tuple(tuple(i for i in reversed(one) if i not in shared) for one in up)
    names = " and ".join(one.name for one in feet)
    if not all(legs) or len(legs[0]) != len(legs[1]):
        raise WrongUse(
            f"path must have two like legs on a body of their own, unlike those of {names}, "
            f"of {len(legs[0])} and {len(legs[1])} joints"
        )
    mirror = {i: i for i in range(len(tree.dofs))}
    left: list[int] = []

    def pair(one: int, other: int) -> None:
        mirror[one], mirror[other] = other, one
        left.append(one)
        below = tree.below(one), tree.below(other)
        if len(below[0]) != len(below[1]):
            raise WrongUse(f"path must have like legs: those of {names} have other joints")
        for pairs in zip(*below, strict=True):
            pair(*pairs)

    pair(legs[0][0], legs[1][0])
    for parent in (BASE, *range(len(tree.dofs))):  # arms and the like
        known: dict[str, int] = {}
        for i in tree.below(parent):
            name, side = without_side(joint_name(model, tree, i))
            if mirror[i] != i or side is None:
                continue
            if name in known:
                pair(*(known[name], i) if side else (i, known[name]))
            known[name] = i
    return Sides(
        (legs[0], legs[1]), tuple(mirror[i] for i in range(len(mirror))), tuple(left), feet
    )


def body_name(model: Any, foot: Sole) -> str:
    return name_in(model, "body", foot.body)


def joint_name(model: Any, tree: Tree, link: int) -> str:
    return name_in(model, "joint", int(model.dof_jntid[tree.dofs[link]]))
