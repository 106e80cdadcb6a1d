"""A robot as a hybrid system: its modes, its section and where its gaits are sought."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.multibody.single_support import (
    SingleSupport,
    coordinates_and_rates,
    normal_force,
)
from walker_jax.robots.forces import Controller
from walker_jax.robots.machine import Machine
from walker_jax.robots.sections import can_reach, foot_arm, point_of, state_on_section
from walker_jax.robots.soft_contacts import SoftContact, remarks_on
from walker_jax.robots.stances import RobotState, Stance
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.system import code_field

LEAST_SCUFF = 1e-6
"""Depth, over the size of the robot, from which a foot counts as below the ground: a smaller depth
is rounding."""

WINDOW_CELLS = 100
"""Cells along each axis of the window around a gait."""


class Robot(HybridSystem):
    """A planar machine on two like legs, read from a file by `wj.robot`.

    The coordinates are angles of links from the pose in the file, positive where they lean forward,
    and displacements of slides. A stride begins just after a foot has come down, with both feet on
    the ground; the section leaves out the coordinate of the swing leg that follows from that.

    Legs are straight if they come down as one link each, with all knees locked, on one hip. Such
    legs pass each other whatever their length: scuffing is ignored unless `check_scuffing`. Others
    fail (`SCUFFED`) where the swing foot is below the ground. Further failures are `FORWARD`: the
    hip reaches the ground; `BACKWARD`: the hip does not pass over the foot any more; `RUNNING`: the
    ground would have to pull; `STOPPED`: straight legs stay on both feet; `BENT_KNEE`: the foot
    comes down before the knee is locked; `OUTSIDE`: the start is not feasible, or the foot comes
    down in a pose outside the section. Feet neither slip nor bounce, and only feet touch anything.
    """

    machine: Machine = code_field()
    controller: Controller | None = code_field()
    section: tuple[str, ...] = code_field()  # pyright: ignore[reportIncompatibleVariableOverride] (of each robot)
    near: tuple[float, ...] | None = code_field()
    """A point of the section near a gait, from the file's first keyframe."""
    contact: SoftContact | None = code_field()
    """Of the file, as MuJoCo takes it."""
    check_scuffing: bool = eqx.field(static=True, default=False)
    parameters: dict[str, Any]  # pyright: ignore[reportGeneralTypeIssues] (no default; __init__ is our own)

    def __init__(
        self,
        machine: Machine,
        parameters: Mapping[str, Any],
        controller: Controller | None = None,
        *,
        near: tuple[float, ...] | None = None,
        contact: SoftContact | None = None,
        check_scuffing: bool = False,
    ):
        self.machine, self.controller, self.near = machine, controller, near
        self.contact = contact
        self.check_scuffing = check_scuffing
        self.parameters = {name: jnp.asarray(value) for name, value in parameters.items()}
        names = [machine.links[i].name for i in self.landing().free]
        self.section = (*names[:-1], *(f"{name}_rate" for name in names))

    def label(self):
        return self.machine.name

    def remarks(self):
        """How MuJoCo's motion of the same file differs."""
        return remarks_on(self.contact)

    def with_locked(self, knees: tuple[int, ...]) -> Stance:
        """Return the robot on its stance foot, with some knees locked."""
        return Stance(self.machine, self.controller, self.parameters, knees)

    def landing(self) -> Stance:
        """Return the robot as a foot comes down: all knees are locked."""
        return self.with_locked(self.machine.knees())

    def first(self) -> Stance:
        """Return the robot as a stride begins: the knee of the swing leg is free."""
        return self.with_locked(self.machine.knees()[:1])

    def straight_legs(self) -> bool:
        """Return whether legs come down as one link each, on one hip."""
        machine, free = self.machine, self.landing().free
        tops = [machine.links[leg[0]] for leg in machine.legs]
        single = all(sum(i in free for i in leg) == 1 for leg in machine.legs)
        return single and tops[0].anchor == tops[1].anchor and all(one.turns for one in tops)

    def modes(self):
        landing, first = self.landing(), self.first()
        last = self.landing_mode(landing)
        if not self.machine.knees():
            return {"stance": last}
        knee = self.machine.knees()[1]
        return {"knee_free": self.bent_mode(first, knee), "knee_locked": last}

    def mode(
        self, stance: Stance, guards: tuple[Guard, ...], conditions: tuple[Condition, ...]
    ) -> Mode:
        """Return a mode of motion on the stance foot."""
        energy = None if stance.has_forces() else stance.energy
        return Mode(SingleSupport(stance), guards, conditions, as_smooth=True, energy=energy)

    def falls(self, stance: Stance) -> tuple[Guard, ...]:
        """Return the guards of falls."""
        if self.straight_legs():
            bearing = self.bearing(stance)
            rate = lambda state: -state.rates[0]
            forward = Guard(lambda state: bearing(state) - np.pi / 2, "FORWARD")
            return Guard(rate, "BACKWARD", at_once=True), forward
        hip = lambda state: stance.hip(coordinates_and_rates(state)[0])[1]
        forward = Guard(lambda state: -hip(state), "FORWARD")
        stops = Guard(lambda state: -stance.progress(state), "BACKWARD", at_once=True)
        return forward, stops

    def bearing(self, stance: Stance) -> Any:
        """Return the function to the angle of a straight stance leg from the normal."""
        angle = foot_arm(self.landing()).angle
        return lambda state: state.coordinates[0] + angle

    def forces(self, stance: Stance) -> Condition:
        """Return the condition that the ground need not pull."""
        return Condition(lambda state: normal_force(stance, state), "RUNNING", at_start=True)

    def depth(self, stance: Stance) -> Any:
        """Return the function to the depth of the swing foot below the ground."""
        return lambda state: -stance.sole(coordinates_and_rates(state)[0])[1]

    def clears(self, stance: Stance) -> tuple[Condition, ...]:
        """Return the condition that the swing foot is not below the ground, if that is checked."""
        if self.straight_legs() and not self.check_scuffing:
            return ()
        depth, least = self.depth(stance), LEAST_SCUFF * self.machine.size
        return (Condition(lambda state: least - depth(state), "SCUFFED", zero_at_start=True),)

    def ahead(self, stance: Stance) -> Any:
        """Return the function to the distance of the swing foot ahead of the stance foot."""
        return lambda state: stance.ahead(coordinates_and_rates(state)[0])

    def landing_mode(self, stance: Stance) -> Mode:
        """Return the mode that ends as the swing foot comes down, with all knees locked."""
        reset = lambda state: self.landed(stance, state)
        if self.straight_legs():
            twice = 2 * foot_arm(stance).angle
            contact = lambda state: state.coordinates[0] + state.coordinates[-1] + twice
            lifts = Condition(lambda state: stance.struck(state)[1][1], "STOPPED")
            admits = (self.bearing(stance),)
            down = (Guard(contact, SECTION, admits, reset=reset, must_hold=(lifts,)),)
        else:
            depth, ahead, leans = self.depth(stance), self.ahead(stance), self.leans(stance)
            away = Guard(depth, "OUTSIDE", (ahead, lambda state: -leans(state)))
            down = Guard(depth, SECTION, (ahead, leans), reset=reset, makes_zero=("SCUFFED",))
            down = away, down
        conditions = (self.forces(stance), *self.clears(stance))
        return self.mode(stance, (*self.falls(stance), *down), conditions)

    def leans(self, stance: Stance) -> Any:
        """Return the function whether the stance foot's joint is ahead of it, as after landing."""
        machine = self.machine
        i = next(i for i in reversed(machine.legs[0]) if i not in stance.locked)
        if not machine.links[i].turns:
            return lambda state: jnp.ones_like(state.rates[0])

        def distance(state):
            pose = stance.pose(coordinates_and_rates(state)[0])
            return pose.joint(i)[0] - pose.centre[0]

        return distance

    def landed(self, stance: Stance, state: RobotState) -> RobotState:
        """Return the state after the swing foot has come down, with the legs exchanged."""
        rates, _ = stance.struck(state)
        place = {link: k for k, link in enumerate(stance.free)}
        other = [place[self.machine.mirror[link]] for link in stance.free]
        return RobotState(
            tuple(state.coordinates[k] for k in other), tuple(rates[k] for k in other)
        )

    def bent_mode(self, stance: Stance, knee: int) -> Mode:
        """Return the mode in which the knee of the swing leg is free, until it is straight."""
        link, numbers = self.machine.links[knee], self.parameters
        at, above = stance.free.index(knee), stance.free.index(link.parent)
        assert isinstance(link.direction, float)
        side, stop = link.bends * link.direction, self.machine.straight(knee, numbers)

        def straight(state):
            bent = state.coordinates[at] - state.coordinates[above]
            return -side * (bent if stop is None else bent - stop)

        reset = lambda state: stance.straightened(state, knee)
        past = (self.bearing(stance),) if self.straight_legs() else (self.ahead(stance),)
        down = Guard(self.depth(stance), "BENT_KNEE", (*past, self.ahead(stance)))
        guards = (*self.falls(stance), down, Guard(straight, "knee_locked", reset=reset))
        return self.mode(stance, guards, (self.forces(stance), *self.clears(stance)))

    def begin(self, state):
        """The knee of the swing leg, straight until now, is released."""
        first = self.first()
        if not self.machine.knees():
            return state
        landing = self.landing()
        q, rates = coordinates_and_rates(state)
        coordinates, speeds = landing.all_coordinates(q), landing.all_rates(rates)
        return RobotState(
            tuple(coordinates[i] for i in first.free), tuple(speeds[i] for i in first.free)
        )

    def names_of_state(self):
        names = [self.machine.links[i].name for i in self.first().free]
        return *names, *(f"{name}_rate" for name in names)

    def shown(self, state):
        of_first = len(state.rates) == len(self.first().free)
        return state if of_first else self.begin(state)

    def lift(self, x):
        return state_on_section(self.landing(), self.straight_legs(), x)

    def project(self, state):
        return point_of(state)

    def feasible(self, x):
        return jnp.all(jnp.isfinite(x)) & can_reach(self.landing(), self.straight_legs(), x)

    def step_length(self, x, end):
        """Return the way from foot to foot, the rolling of a stride included."""
        return self.landing().sole(coordinates_and_rates(end())[0])[0]

    def unit_of_time(self):
        return (self.machine.size / self.parameters["gravity"]) ** 0.5

    def basin_region(self, gait):
        """A slice through the gait, or the region in which one is sought."""
        at = gait()
        return self.gait_region() if at is None else window_around(self, at)

    def gait_region(self):
        """The keyframe of the file, or legs that are apart and move as pendulums."""
        free = self.landing().free
        if self.near is not None:
            sizes = np.maximum(np.abs(self.near), 0.1) / 8
            axes = zip(self.section, np.asarray(self.near), sizes, strict=True)
            return Grid.plain(**{name: (at - by, at + by, 1) for name, at, by in axes})
        return pendulum_region(self, len(free))


def window_around(robot: Robot, x: Any) -> Grid:
    """Return a slice through a point, along the stance leg's first coordinate and its rate."""
    point = dict(zip(robot.section, np.asarray(x, float).tolist(), strict=True))
    ends, first = ends_around(robot, x), robot.section[0]
    names = first, f"{first}_rate"
    return Grid.through(point, **{name: (*ends[name], WINDOW_CELLS) for name in names})


def ends_around(robot: Robot, x: Any) -> dict[str, tuple[float, float]]:
    """Return the ends of a window around a point along each coordinate."""
    found = {}
    for name, value in zip(robot.section, np.asarray(x, float).tolist(), strict=True):
        width = max(abs(value), 0.5 if name.endswith("_rate") else 0.1) / 2
        found[name] = value - width, value + width
    return found


def pendulum_region(robot: Robot, count: int) -> Grid:
    """Return slow starts with the feet apart; other links are in the pose of the file."""
    unit = 1 / float(robot.unit_of_time())
    axes: dict[str, Any] = {name: (-0.05, 0.05, 1) for name in robot.section}
    first, rates = robot.section[0], robot.section[count - 1 :]
    axes[first] = -0.6, 0.0, 15
    axes[rates[0]] = -0.6 * unit, 0.6 * unit, 20
    axes[rates[-1]] = -0.8 * unit, 0.8 * unit, 12
    shear = np.eye(len(robot.section))
    shear[count - 1, 0] = -unit  # a longer step is a faster one
    return Grid(axes, shear)
