"""The structure of a planar machine on two like legs, and the places of its parts.

The plane has axes along the ground, forward, and normal to it. Angles are of links, from the pose
in which the file has them (MuJoCo's qpos0), positive where a link leans forward. A vector (x, z)
that is fixed in a link and given in that pose points, at the angle a, to

    (x cos a + z sin a, z cos a - x sin a).

Numbers are the entries of a dictionary, of which the structure holds the names; None is a zero of
the file. Both legs have the same numbers. The stance leg comes first.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

Numbers = Mapping[str, Any]
Name = str | None
Place = tuple[Name, Name]
"""Names of x and z of a vector."""
BASE = -1
"""The frame that the two slides of the base move; it does not turn."""


class Link(NamedTuple):
    """The bodies that one joint moves, up to the next joints."""

    name: str
    """Of its coordinate, such as stance_shank."""
    joint: str
    """Of the joint, such as stance_knee."""
    parent: int
    """Number of the link before the joint, or `BASE`."""
    anchor: Place
    """From the parent's joint to this one."""
    direction: float | tuple[float, float]
    """1 or -1 for a hinge whose angle grows forward or backward; the direction of a slide."""
    reference: float
    """The joint's value in the pose of the file."""
    stiffness: Name = None
    rest: Name = None
    """Value of the joint at which its spring is slack."""
    damping: Name = None
    armature: Name = None
    bends: float = 0.0
    """1 or -1 for a knee that bends to greater or smaller values of the joint; 0 for no knee."""
    stop: Name = None
    """Value of a knee's joint where it is straight."""

    @property
    def turns(self) -> bool:
        return isinstance(self.direction, float)


class Mass(NamedTuple):
    """The mass of one body."""

    link: int
    place: Place
    """Centre of mass, from the joint of its link."""
    mass: str
    inertia: Name
    along: tuple[float, float] | None = None
    """The direction of the base's first slide, for a body that moves along it alone."""


class Foot(NamedTuple):
    link: int
    place: Place
    """Centre of the arc, from the joint of its link."""
    radius: Name


class Actuator(NamedTuple):
    """A motor, force gear gain ctrl, or a servo, gear (kp (ctrl - gear q) - kv gear q')."""

    name: str
    link: int
    gear: float
    ctrl: str
    gain: Name
    kp: Name
    kv: Name
    targets_rate: bool
    """Whether ctrl is the rate at which a servo of kv aims."""
    ctrl_limits: tuple[float, float] | None
    force_limits: tuple[float, float] | None


class Machine(NamedTuple):
    """A planar machine on two like legs."""

    name: str
    links: tuple[Link, ...]
    """Parents come first."""
    order: tuple[int, ...]
    """Links in the order of the coordinates: the stance leg from the foot up, others, the swing
    leg down to the foot."""
    mirror: tuple[int, ...]
    """For each link, that of the other side."""
    masses: tuple[Mass, ...]
    feet: tuple[Foot, Foot]
    legs: tuple[tuple[int, ...], tuple[int, ...]]
    """Links from the hip to the foot."""
    actuators: tuple[Actuator, ...]
    size: float
    """Distance from the hip to the sole, in the pose of the file."""

    def knees(self) -> tuple[int, ...]:
        """Return the links below the knees, that of the stance leg first."""
        return tuple(i for leg in self.legs for i in leg if self.links[i].bends)

    def locked(self, coordinates: list, numbers: Numbers, locked: tuple[int, ...]) -> list:
        """Return the coordinates of all links, in tree order, from those of links not locked."""
        given = dict(zip((i for i in self.order if i not in locked), coordinates, strict=True))
        for i, link in enumerate(self.links):
            if i in locked:
                above, stop = given[link.parent], self.straight(i, numbers)
                given[i] = above if stop is None else above + stop
        return [given[i] for i in range(len(self.links))]

    def straight(self, knee: int, numbers: Numbers) -> Any:
        """Return the angle between shank and thigh at a knee's stop; None for zero."""
        link = self.links[knee]
        assert isinstance(link.direction, float)
        return None if link.stop is None else link.direction * (numbers[link.stop] - link.reference)


class Pose:
    """Places and angles of links, each computed when it is first asked for.

    The stance foot is at (u, v), the coordinates of the sole as if it had rolled from the angle 0:
    the centre of its arc is at (u + radius angle, v + radius). Places are pairs of scalars. The
    coordinates are in tree order.
    """

    def __init__(self, machine: Machine, numbers: Numbers, foot: tuple, coordinates: list):
        self.machine, self.numbers, self.coordinates = machine, numbers, coordinates
        self.angles = angles_of(machine, coordinates)
        self.turns: dict[int, Any] = {}
        self.known: dict[int, tuple] = {}
        stance, at = machine.feet[0], foot
        if stance.radius is not None:
            radius, angle = numbers[stance.radius], self.angles[stance.link]
            at = at[0] + (0.0 if angle is None else radius * angle), at[1] + radius
        self.centre = at
        """Of the arc of the stance foot."""
        self.above = {}
        """The links above others on the stance leg, up to the base, with those below them."""
        i = stance.link
        while i != BASE:
            self.above[machine.links[i].parent] = i
            i = machine.links[i].parent

    def turned(self, i: int) -> Any:
        """Return cosine and sine of a link's angle; None for one that does not turn."""
        if i == BASE or self.angles[i] is None:
            return None
        if not self.machine.links[i].turns:
            return self.turned(self.machine.links[i].parent)
        if i not in self.turns:
            self.turns[i] = jnp.cos(self.angles[i]), jnp.sin(self.angles[i])
        return self.turns[i]

    def arm(self, i: int) -> tuple[Any, Any]:
        """Return the way from the parent's joint to that of link i."""
        link = self.machine.links[i]
        frame = self.turned(link.parent)
        found = vector(self.numbers, link.anchor, frame)
        if isinstance(link.direction, float):
            return found
        slide: Any = link.direction
        moved = {name: self.coordinates[i] * slide[k] for k, name in enumerate("xz")}
        return total(found, vector(moved, ("x", "z"), frame))

    def joint(self, i: int) -> tuple:
        """Return the place of a link's joint, or of the base."""
        if i not in self.known:
            stance = self.machine.feet[0]
            if i == stance.link:
                to_centre = vector(self.numbers, stance.place, self.turned(i))
                self.known[i] = plus(self.centre, to_centre, -1.0)
            elif i in self.above:  # up the stance leg, to the base
                below = self.above[i]
                self.known[i] = plus(self.joint(below), self.arm(below), -1.0)
            else:
                self.known[i] = plus(self.joint(self.machine.links[i].parent), self.arm(i))
        return self.known[i]

    def place(self, link: int, place: Place) -> tuple:
        """Return a point of a link."""
        return plus(self.joint(link), vector(self.numbers, place, self.turned(link)))

    def swing_centre(self) -> tuple:
        """Return the centre of the arc of the swing foot."""
        foot = self.machine.feet[1]
        return self.place(foot.link, foot.place)


def angles_of(machine: Machine, coordinates: list) -> list:
    """Return the angles of links from their coordinates; None for those that do not turn."""
    angles: list[Any] = []
    for link, value in zip(machine.links, coordinates, strict=True):
        above = angles[link.parent] if link.parent != BASE else None
        angles.append(value if link.turns else above)
    return angles


def vector(numbers: Numbers, place: Place, turned: tuple | None) -> tuple[Any, Any]:
    """Return a vector of a link; the entries that the file leaves zero cost nothing."""
    x, z = (None if name is None else numbers[name] for name in place)
    if turned is None:
        return x, z
    c, s = turned
    if z is None:
        return (None, None) if x is None else (x * c, -x * s)
    return (z * s, z * c) if x is None else (x * c + z * s, z * c - x * s)


def total(one: tuple, other: tuple) -> tuple[Any, Any]:
    """Return the sum of two vectors, of which entries may be None, for zero."""
    add = lambda a, b: b if a is None else a if b is None else a + b
    return add(one[0], other[0]), add(one[1], other[1])


def plus(point: tuple, by: tuple, sign: float = 1.0) -> tuple[Any, Any]:
    """Return a point moved by a vector, or back by it; None is zero."""
    add = lambda a, b: a if b is None else a + b if sign > 0 else a - b
    return add(point[0], by[0]), add(point[1], by[1])


def transfer(machine: Machine, numbers: Numbers, foot: tuple, coordinates: list) -> list:
    """Return F(q): places of the masses, angles of those with inertia, and geared-up rotors."""
    found = Pose(machine, numbers, foot, coordinates)
    points: list[Any] = []
    for one in machine.masses:
        place = found.place(one.link, one.place)
        if one.along is None:
            points += place
        else:
            points.append(one.along[0] * place[0] + one.along[1] * place[1])
    points += [found.angles[one.link] for one in machine.masses if one.inertia is not None]
    for i, link in enumerate(machine.links):
        if link.armature is not None:
            points.append(joint_value(machine, i, coordinates, found.angles))
    return points


def masses_of(machine: Machine, numbers: Numbers) -> list:
    """Return M, one number for each entry of F."""
    found: list[Any] = []
    for one in machine.masses:
        found += [numbers[one.mass]] * (2 if one.along is None else 1)
    found += [numbers[one.inertia] for one in machine.masses if one.inertia is not None]
    return found + [numbers[one.armature] for one in machine.links if one.armature is not None]


def weights_of(machine: Machine, numbers: Numbers) -> list:
    """Return f, the weights: gravity points down the slope."""
    g, slope = numbers["gravity"], numbers["slope"]
    pull = g * jnp.sin(slope), -g * jnp.cos(slope)
    found: list[Any] = []
    for one in machine.masses:
        mass = numbers[one.mass]
        if one.along is None:
            found += [mass * pull[0], mass * pull[1]]
        else:
            found.append(mass * (one.along[0] * pull[0] + one.along[1] * pull[1]))
    return found + [0.0 * g] * (len(masses_of(machine, numbers)) - len(found))


def joint_value(machine: Machine, i: int, coordinates: list, angles: list) -> Any:
    """Return by how much a joint is away from the pose of the file."""
    link = machine.links[i]
    if not isinstance(link.direction, float):
        return coordinates[i]
    above = None if link.parent == BASE else angles[link.parent]
    turn = coordinates[i] if above is None else coordinates[i] - above
    return turn if link.direction > 0 else -turn


def joint_values(machine: Machine, coordinates: list) -> list:
    """Return the value of each joint from that in the pose of the file; for rates likewise."""
    angles = angles_of(machine, coordinates)
    return [joint_value(machine, i, coordinates, angles) for i in range(len(machine.links))]
