"""Constrained motion by MuJoCo's own matrices: inertia, bias, and Jacobians of feet and knees.

Contacts are equality constraints, solved exactly: M a - J^T f = tau - bias, J a = -Jdot v. MuJoCo's
own constraints, which are soft, are off.
"""

from typing import Any

import mujoco as installed
import numpy as np

from walker_jax.robots.machine import Machine
from walker_jax.robots.reading import Reader

mujoco: Any = installed
"""Type checkers do not know the names in it."""


class Constrained:
    """A robot's model, on some of its feet and with some of its knees locked."""

    def __init__(self, reader: Reader, machine: Machine):
        self.reader, self.machine, self.model = reader, machine, reader.model
        off = mujoco.mjtDisableBit
        self.model.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
        self.data = mujoco.MjData(self.model)

    def at(self, qpos, qvel, ctrl=()):
        """Take a state, with all that depends on it."""
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        if len(ctrl):
            self.data.ctrl[:] = ctrl
        mujoco.mj_forward(self.model, self.data)
        return self

    def inertia(self):
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full

    def foot(self, side):
        """The rates of a foot's sole along the ground and normal to it: rows, and Jdot v."""
        sole, plane = self.reader.sides.feet[side], self.reader.plane
        away = sole.centre - plane.flat(self.reader.data.xpos[sole.body])
        away = away[0] * plane.along + away[1] * plane.normal
        body, turn = sole.body, self.data.xmat[sole.body].reshape(3, 3)
        turned = turn @ self.reader.data.xmat[body].reshape(3, 3).T
        point = self.data.xpos[body] + turned @ away
        found = []
        for jacobian in (mujoco.mj_jac, mujoco.mj_jacDot):
            moves, turns = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
            jacobian(self.model, self.data, moves, turns, point, body)
            rolls = plane.along @ moves - sole.radius * plane.across @ turns
            found.append(np.stack([rolls, plane.normal @ moves]))
        return found[0], found[1] @ self.data.qvel

    def knees(self, links):
        rows = np.zeros((len(links), self.model.nv))
        rows[range(len(links)), [self.reader.tree.dofs[i] for i in links]] = 1
        return rows, np.zeros(len(links))

    def rows(self, sides, locked):
        parts = [*(self.foot(side) for side in sides), self.knees(locked)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def motion(self, sides, locked):
        """Accelerations and constraint forces."""
        data, (J, drift) = self.data, self.rows(sides, locked)
        force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        return self.solve(J, force, -drift)

    def inverse(self, joints, forces, locked):
        """Forces that MuJoCo's inverse dynamics miss, at the joints that are not locked.

        Given are the joints' accelerations and the ground's force on the first foot. As that rests,
        the acceleration of the base follows.
        """
        data, (J, drift) = self.data, self.foot(0)
        data.qacc[2:] = joints[2:]
        data.qacc[:2] = np.linalg.solve(J[:, :2], -drift - J[:, 2:] @ joints[2:])
        mujoco.mj_inverse(self.model, data)
        missed = data.qfrc_inverse - data.qfrc_actuator - J.T @ forces
        return np.delete(missed, [self.reader.tree.dofs[i] for i in locked])

    def impact(self, sides, locked):
        """Rates after a plastic impact, and impulses."""
        J, _ = self.rows(sides, locked)
        change, impulses = self.solve(J, np.zeros(self.model.nv), -J @ self.data.qvel)
        return self.data.qvel + change, impulses

    def solve(self, J, force, closing):
        count, nv = len(J), self.model.nv
        matrix = np.block([[self.inertia(), -J.T], [J, np.zeros((count, count))]])
        found = np.linalg.solve(matrix, np.concatenate([force, closing]))
        return found[:nv], found[nv:]

    def turns(self, rates):
        """Rates of the links' coordinates, in tree order, from those of joints."""
        found = []
        for i, link in enumerate(self.machine.links):
            body = int(self.model.dof_bodyid[self.reader.tree.dofs[i]])
            if not link.turns:
                found.append(rates[self.reader.tree.dofs[i]])
                continue
            moves, turns = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
            mujoco.mj_jac(self.model, self.data, moves, turns, self.data.xpos[body], body)
            found.append(self.reader.plane.across @ turns @ rates)
        return np.array(found)
