"""The machine of a compiled model: its links, masses, feet, actuators and their numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from walker_jax.checks import WrongUse
from walker_jax.robots.contacts import Sole
from walker_jax.robots.foreign import kind_of, name_in
from walker_jax.robots.ledger import NOTHING, Ledger
from walker_jax.robots.legs import Sides, Tree, joint_name, without_side
from walker_jax.robots.machine import BASE, Actuator, Foot, Link, Machine, Mass, Place
from walker_jax.robots.planes import Plane


class Reader:
    """Reads the parts of a model, whose tree and legs are known."""

    def __init__(self, mujoco: Any, spec: Any, plane: Plane, tree: Tree, sides: Sides):
        self.spec = spec
        self.mujoco, self.plane, self.tree, self.sides = mujoco, plane, tree, sides
        self.model, self.data, self.ledger = plane.model, plane.data, Ledger()
        self.joints = [int(self.model.dof_jntid[dof]) for dof in tree.dofs]
        self.twins = {name: pair for pair in self.pairs_of_names() for name in pair}
        """Names of a part of the first side and of its like on the other, by each of them."""
        top = tree.above(sides.legs[0][0])[-1]
        self.base = plane.flat(self.data.xanchor[self.joints[top]])
        """The point of the base, in the pose of the file."""

    def machine(self, name: str) -> Machine:
        """Return the structure; the numbers are in the ledger."""
        strength, slope = self.plane.gravity()
        self.ledger.always("slope", slope)
        self.ledger.always("gravity", strength)
        acted = {int(one) for one in self.model.actuator_trnid[:, 0]}
        links = tuple(self.link(i, acted) for i in range(len(self.joints)))
        masses = tuple(self.masses(links))
        feet = tuple(self.foot(one) for one in self.sides.feet)
        legs, mirror = self.sides.legs, self.sides.mirror
        others = [i for i in range(len(links)) if i not in legs[0] and i not in legs[1]]
        order = (*reversed(legs[0]), *others, *legs[1])
        actuators = tuple(self.actuator(i) for i in range(self.model.nu))
        hip, sole = self.origin(legs[0][0]), self.sides.feet[0]
        size = float(np.linalg.norm(hip - sole.centre) + sole.radius)
        for leg in legs:
            bent = [links[i].joint for i in leg if links[i].bends]
            if len(bent) > 1:
                raise WrongUse(f"path has legs with the knees {' and '.join(bent)}: one may lock")
        made = Machine(
            name, links, order, mirror, masses, (feet[0], feet[1]), legs, actuators, size
        )
        self.check_sides(made)
        return made

    def check_sides(self, machine: Machine) -> None:
        """Raise `WrongUse` where a body or an actuator has no like on the other side."""
        masses = [(one.link, one.place, one.mass, one.inertia) for one in machine.masses]
        motors = [(one.link, abs(one.gear), one.gain, one.kp, one.kv) for one in machine.actuators]
        for left in self.sides.left:
            both = left, self.sides.mirror[left]
            for what, parts in (("bodies", masses), ("actuators", motors)):
                first, other = ([part[1:] for part in parts if part[0] == link] for link in both)
                if first != other:
                    names = " and ".join(joint_name(self.model, self.tree, one) for one in both)
                    raise WrongUse(f"path must have two like legs: other {what} hang on {names}")

    def pairs_of_names(self) -> Iterator[tuple[str, str]]:
        """Yield the names of each part of the first side, and of its like on the other."""
        numbers = {joint: link for link, joint in enumerate(self.joints)}
        acting = enumerate(map(int, self.model.actuator_trnid[:, 0]))
        acted = {i: numbers[joint] for i, joint in acting if joint in numbers}
        for kind, links in {"joint": numbers, "body": self.tree.of_body, "actuator": acted}.items():
            each: dict[int, list[str]] = {}
            for part, link in links.items():
                each.setdefault(link, []).append(name_in(self.model, kind, part))
            for one in self.sides.left:
                pair = each.get(one, []), each.get(self.sides.mirror[one], [])
                yield from zip(*pair, strict=False)
        yield self.sides.feet[0].name, self.sides.feet[1].name

    def paired(self, name: str, link: int) -> str:
        """Return the name that a part of a link and that of its mirror image share.

        It has no word for the side; or no number at its end, as of leg_1 and leg_2; or the words
        that are in both names, as of leg_a and leg_b; if there are none, it is the first side's.
        """
        plain, side = without_side(name)
        if link == BASE or self.sides.mirror[link] == link:
            return plain if side is None else name
        if side is not None:
            return plain
        pair = self.twins.get(name, (name, name))
        first, other = (without_side(one)[0].rstrip("0123456789").rstrip("_") for one in pair)
        words = [re.split(r"_+", one) for one in (first, other)]
        shared = [a for a, b in zip(*words, strict=False) if a == b]
        return "_".join(shared) or first or "part"

    def role(self, link: int) -> str:
        """Return the prefix of a link's names: which leg it is on as the stride begins."""
        if link == BASE or self.sides.mirror[link] == link:
            return ""
        return "stance_" if link in self.sides.left else "swing_"

    def owner(self, link: int) -> int:
        """Return a number that a link and its mirror image share."""
        return link if link == BASE else min(link, self.sides.mirror[link])

    def origin(self, link: int) -> np.ndarray:
        """Return the joint of a link, in the pose of the file."""
        return self.base if link == BASE else self.plane.flat(self.data.xanchor[self.joints[link]])

    def place(self, at: np.ndarray, link: int, name: str, owner: int, part: str) -> Place:
        """Note the way from a link's joint to a point."""
        x, z = at - self.origin(link)
        note = self.ledger.note
        return note(f"{name}_x", x, owner, part), note(f"{name}_z", z, owner, part)

    def link(self, i: int, acted: set[int]) -> Link:
        """Return a link, and note the numbers of its joint."""
        model, joint, dof = self.model, self.joints[i], self.tree.dofs[i]
        part, owner = joint_name(model, self.tree, i), self.owner(i)
        name, body = self.paired(part, i), int(model.jnt_bodyid[joint])
        last = dof == model.body_dofadr[body] + model.body_dofnum[body] - 1
        called = self.paired(name_in(model, "body", body), i) if last else name
        axis = self.data.xaxis[joint]
        hinge = model.jnt_type[joint] == self.mujoco.mjtJoint.mjJNT_HINGE
        turn = float(np.sign(axis @ self.plane.across))
        slide = self.plane.flat(axis)
        parent, note = self.tree.parents[i], self.ledger.note
        kept = {
            "stiffness": note(f"{name}_stiffness", model.jnt_stiffness[joint], owner, part),
            "damping": note(f"{name}_damping", model.dof_damping[dof], owner, part),
            "armature": note(f"{name}_armature", model.dof_armature[dof], owner, part),
        }
        if kept["stiffness"]:
            rest = model.qpos_spring[model.jnt_qposadr[joint]]
            kept["rest"] = note(f"{name}_springref", rest, owner, part)
        reference = float(model.qpos0[model.jnt_qposadr[joint]])
        in_leg = any(i in leg[1:] for leg in self.sides.legs)
        knee = in_leg and hinge and model.jnt_limited[joint] and joint not in acted
        bends, kept["stop"] = self.stop_of(name, joint, reference) if knee else (0.0, None)
        at = self.plane.flat(self.data.xanchor[joint])
        anchor = self.place(at, parent, name, owner, part)
        role, direction = self.role(i), turn if hinge else (float(slide[0]), float(slide[1]))
        return Link(
            role + called, role + name, parent, anchor, direction, reference, bends=bends, **kept
        )

    def stop_of(self, name: str, joint: int, reference: float) -> tuple[float, str | None]:
        """Return in which direction a knee bends, and the name of its stop, the nearer end.

        None for a stop in the pose of the file.
        """
        low, high = self.model.jnt_range[joint]
        bends = 1.0 if abs(low - reference) <= abs(high - reference) else -1.0
        stop = low if bends > 0 else high
        if abs(stop - reference) <= NOTHING:
            return bends, None
        return bends, self.ledger.always(f"{name}_stop", stop)

    def masses(self, links: tuple[Link, ...]) -> Any:
        """Yield the masses of all bodies that move."""
        model, data, note = self.model, self.data, self.ledger.note
        first = self.plane.flat(data.xaxis[0])
        count: dict[int, int] = {}
        for body, link in self.tree.of_body.items():
            if not model.body_mass[body]:
                continue
            part, number = name_in(model, "body", body), count.get(link, 0)
            count[link] = number + 1
            along = (float(first[0]), float(first[1])) if link < BASE else None
            if along is not None and abs(first @ self.plane.flat(data.xaxis[1])) > NOTHING:
                raise WrongUse(f"path has slides of the base at no right angle, below {part}")
            link = max(link, BASE)
            name, owner = self.paired(part, link), self.owner(link) * 1000 + number
            at = self.plane.flat(data.xipos[body])
            place = self.place(at, link, f"{name}_com", owner, part)
            mass = note(f"{name}_mass", model.body_mass[body], owner, part)
            inertia, above = None, self.tree.above(link)
            if any(links[i].turns for i in above):
                axis = data.ximat[body].reshape(3, 3).T @ self.plane.across
                moment = float(model.body_inertia[body] @ axis**2)
                inertia = note(f"{name}_inertia", moment, owner, part)
            assert mass is not None
            yield Mass(link, place, mass, inertia, along)

    def foot(self, sole: Sole) -> Foot:
        link = self.tree.of_body[sole.body]
        name, owner = self.paired(sole.name, link), self.owner(link)
        place = self.place(sole.centre, link, name, owner, sole.name)
        return Foot(link, place, self.ledger.note(f"{name}_radius", sole.radius, owner, sole.name))

    def actuator(self, i: int) -> Actuator:
        model, note = self.model, self.ledger.note
        link = self.joints.index(int(model.actuator_trnid[i, 0]))
        part, owner = name_in(model, "actuator", i), self.owner(link)
        name, kind = self.paired(part, link), kind_of(self.mujoco, model, i)
        gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
        kept: dict[str, str | None] = {"gain": None, "kp": None, "kv": None}
        if kind == "motor":
            kept["gain"] = self.ledger.always(f"{name}_gain", float(gain[0]))
        elif kind == "position":
            kept["kp"] = note(f"{name}_kp", gain[0], owner, part)
        if kind != "motor":
            kept["kv"] = note(f"{name}_kv", -bias[2], owner, part)
        limits = lambda limited, ends: tuple(map(float, ends[i])) if limited[i] else None
        called = self.role(link) + name
        ctrl = self.ledger.always(f"{called}_ctrl", 0.0)
        return Actuator(
            called,
            link,
            float(model.actuator_gear[i, 0]),
            ctrl,
            targets_rate=kind == "velocity",
            ctrl_limits=limits(model.actuator_ctrllimited, model.actuator_ctrlrange),  # pyright: ignore[reportArgumentType] (two ends)
            force_limits=limits(model.actuator_forcelimited, model.actuator_forcerange),  # pyright: ignore[reportArgumentType] (two ends)
            **kept,
        )


class Keyframe(NamedTuple):
    """The first keyframe of a file, in the coordinates of a machine."""

    coordinates: tuple[float, ...]
    """Of the links, in the order of the machine, the front foot standing."""
    rates: tuple[float, ...]
    ctrl: dict[str, float]


def keyframe_of(reader: Reader, machine: Machine) -> Keyframe | None:
    """Return the first keyframe of a file, if it has one."""
    model, mujoco = reader.model, reader.mujoco
    if not model.nkey:
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    mujoco.mj_kinematics(model, data)
    arms = []
    for foot, sole in zip(machine.feet, reader.sides.feet, strict=True):
        body = sole.body
        away = (
            np.zeros(3) + sole.centre[0] * reader.plane.along + sole.centre[1] * reader.plane.normal
        )
        start, frame = reader.data.xpos[body], reader.data.xmat[body].reshape(3, 3)
        local = frame.T @ (away - start)
        arms.append((data.xpos[body] + data.xmat[body].reshape(3, 3) @ local) @ reader.plane.along)
        assert foot.link == reader.tree.of_body[body]
    stands = list(range(len(machine.links)))
    swapped = arms[1] > arms[0]
    source = [machine.mirror[i] for i in stands] if swapped else stands
    angles = absolute(machine, [model.key_qpos[0][d] - model.qpos0[d] for d in reader.tree.dofs])
    rates = absolute(machine, [model.key_qvel[0][d] for d in reader.tree.dofs])
    pick = lambda some: tuple(float(some[source[i]]) for i in machine.order)
    ctrl = {}
    for one, value in zip(machine.actuators, model.key_ctrl[0], strict=True):
        link = machine.mirror[one.link] if swapped else one.link
        same = [a for a in machine.actuators if a.link == link and base_name(a) == base_name(one)]
        ctrl[(same or [one])[0].ctrl] = float(value)
    return Keyframe(pick(angles), pick(rates), ctrl)


def base_name(actuator: Actuator) -> str:
    return actuator.name.removeprefix("stance_").removeprefix("swing_")


def absolute(machine: Machine, values: list) -> list:
    """Return the coordinates of links, in tree order, from the displacements of their joints."""
    found, turns = [], []
    for link, value in zip(machine.links, values, strict=True):
        above = 0.0 if link.parent == BASE else turns[link.parent]
        if isinstance(link.direction, float):
            turns.append(above + link.direction * value)
            found.append(turns[-1])
        else:
            turns.append(above)
            found.append(value)
    return found
