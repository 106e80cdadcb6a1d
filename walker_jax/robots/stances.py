"""A robot on its stance foot, with some knees locked: masses, contact points and impacts."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax import multibody
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import coordinates_and_rates
from walker_jax.robots.forces import Controller, joint_forces
from walker_jax.robots.machine import Machine, Numbers, Pose, masses_of, transfer, weights_of


class RobotState(NamedTuple):
    """Coordinates of the links that are not locked, in the order of `Machine.order`; rates."""

    coordinates: tuple[Any, ...]
    rates: tuple[Any, ...]


class Stance(eqx.Module):
    """A robot whose stance foot is at q[:2], with locked knees: the other coordinates are free."""

    machine: Machine = eqx.field(static=True)
    controller: Controller | None = eqx.field(static=True)
    numbers: Numbers
    locked: tuple[int, ...] = eqx.field(static=True, default=())

    @property
    def free(self) -> tuple[int, ...]:
        """The links that are not locked, in the order of the coordinates."""
        return tuple(i for i in self.machine.order if i not in self.locked)

    def all_coordinates(self, q: Float[Array, " q"]) -> list:
        return self.machine.locked(list(q[2:]), self.numbers, self.locked)

    def all_rates(self, qdot: Float[Array, " q"]) -> list:
        """Rates of all links: a locked one turns as the link above it."""
        given = dict(zip(self.free, qdot[2:], strict=True))
        for i, link in enumerate(self.machine.links):
            given.setdefault(i, given.get(link.parent))
        return [given[i] for i in range(len(self.machine.links))]

    def system(self) -> multibody.System:
        """Return masses, F(q) and forces in these coordinates."""
        machine, numbers = self.machine, self.numbers

        def places(q):
            points: Any = transfer(machine, numbers, (q[0], q[1]), self.all_coordinates(q))
            return jnp.stack(points)

        def forces(q, qdot):
            coordinates, rates = self.all_coordinates(q), self.all_rates(qdot)
            on = joint_forces(machine, numbers, self.controller, coordinates, rates)
            found: dict[int, Any] = dict.fromkeys(self.free, 0 * q[0])
            for i, one in enumerate(on):
                while i in self.locked:
                    i = machine.links[i].parent
                found[i] = found[i] + one
            return jnp.stack([0 * q[0], 0 * q[0], *found.values()])

        weights = jnp.stack(weights_of(machine, numbers))
        masses = jnp.stack(masses_of(machine, numbers))
        return multibody.System(places, masses, weights, forces if self.has_forces() else None)

    def has_forces(self) -> bool:
        """Return whether there are forces but gravity: springs, dampers or actuators."""
        links = self.machine.links
        return bool(self.machine.actuators) or any(one.stiffness or one.damping for one in links)

    def energy(self, state: RobotState) -> Any:
        """Return the kinetic energy, and that of gravity with the stance foot at the origin."""
        (q, qdot), system = coordinates_and_rates(state), self.system()
        return multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)

    def pose(self, q: Float[Array, " q"]) -> Pose:
        """Return the pose of all links."""
        return Pose(self.machine, self.numbers, (q[0], q[1]), self.all_coordinates(q))

    def sole(self, q: Float[Array, " q"]) -> Float[Array, " 2"]:
        """Return (u, v) of the swing foot, as (q[0], q[1]) are of the stance foot."""
        pose, foot = self.pose(q), self.machine.feet[1]
        centre = pose.swing_centre()
        if foot.radius is None:
            return jnp.stack(centre)
        radius, angle = self.numbers[foot.radius], pose.angles[foot.link]
        rolled = 0.0 if angle is None else radius * angle
        return jnp.stack([centre[0] - rolled, centre[1] - radius])

    def hip(self, q: Float[Array, " q"]) -> tuple[Any, Any]:
        """Return the place of the stance leg's hip."""
        return self.pose(q).joint(self.machine.legs[0][0])

    def ahead(self, q: Float[Array, " q"]) -> Any:
        """Return the distance of the swing foot ahead of the stance foot."""
        pose = self.pose(q)
        return pose.swing_centre()[0] - pose.centre[0]

    def progress(self, state: RobotState) -> Any:
        """Return the rate at which the hip passes over the centre of the stance foot's arc."""

        def leg(q):
            pose = self.pose(q)
            hip = pose.joint(self.machine.legs[0][0])
            return [hip[0] - pose.centre[0], hip[1] - pose.centre[1]]

        q, rates = coordinates_and_rates(state)
        along, rate = jax.jvp(leg, (q,), (rates,))
        return along[1] * rate[0] - along[0] * rate[1]

    def struck(self, state: RobotState) -> tuple[list, list]:
        """Return rates just after the swing foot came down and stays, and the other's velocity.

        The foot that stood is free. Knees stay as they are locked.
        """

        def solve(stance, state):
            after = multibody.impact(stance.system(), stance.sole, *coordinates_and_rates(state))
            return [*after.velocities]

        u, v, *rates = unroll(solve)(self, state)
        return rates, [u, v]

    def straightened(self, state: RobotState, knee: int) -> RobotState:
        """Return the state after a knee has come to its stop and locks; the foot stays."""
        machine, at = self.machine, 2 + self.free.index(knee)

        def solve(stance, state):
            above = 2 + stance.free.index(machine.links[knee].parent)
            contacts = lambda q: jnp.stack([q[0], q[1], q[at] - q[above]])
            after = multibody.impact(stance.system(), contacts, *coordinates_and_rates(state))
            return [*after.velocities]

        rates = unroll(solve)(self, state)
        without = lambda some: tuple(one for i, one in enumerate(some) if i != at - 2)
        return RobotState(without(state.coordinates), without(rates[2:]))
