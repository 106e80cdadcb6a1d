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
    """What one joint moves: the bodies after it, up to the next joints."""

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


class Pose(NamedTuple):
    """Places and angles of all links; vectors are pairs of scalars."""

    angles: list[Any]
    joints: list[Any]
    """Place of each link's joint."""
    base: Any
    """Place of the base."""
    turned: list[Any]
    """Cosine and sine of each link's angle."""


def vector(numbers: Numbers, place: Place, turned: tuple | None) -> tuple[Any, Any]:
    """Return a vector of a link; the entries that the file leaves zero cost nothing."""
    x, z = (None if name is None else numbers[name] for name in place)
    if turned is None:
        return x, z
    c, s = turned
    if z is None:
        return (None, None) if x is None else (x * c, -x * s)
    return (z * s, z * c) if x is None else (x * c + z * s, z * c - x * s)


def plus(point: tuple, by: tuple, sign: float = 1.0) -> tuple[Any, Any]:
    """Return the sum of two vectors, or their difference; None is zero."""
    add = lambda a, b: a if b is None else a + b if sign > 0 else a - b
    return add(point[0], by[0]), add(point[1], by[1])


def pose(machine: Machine, numbers: Numbers, foot: tuple, coordinates: list) -> Pose:
    """Return the pose with the stance foot at (u, v), from the coordinates in tree order.

    u and v are the coordinates of the sole as if it had rolled from the angle 0: the centre of the
    arc is at (u + radius angle, v + radius).
    """
    links, stance = machine.links, machine.feet[0]
    angles: list[Any] = []
    for link, value in zip(links, coordinates, strict=True):
        above = angles[link.parent] if link.parent != BASE else None
        angles.append(value if link.turns else above)
    turned: list[Any] = []
    for link, angle in zip(links, angles, strict=True):
        own = link.turns and angle is not None
        above = turned[link.parent] if link.parent != BASE else None
        turned.append((jnp.cos(angle), jnp.sin(angle)) if own else above)
    frame = lambda i: None if i == BASE else turned[i]

    def arm(i: int) -> tuple[Any, Any]:
        """From the parent's joint to the joint of link i."""
        link = links[i]
        found = vector(numbers, link.anchor, frame(link.parent))
        if isinstance(link.direction, float):
            return found
        slid = {"x": coordinates[i] * link.direction[0], "z": coordinates[i] * link.direction[1]}
        moved = vector(slid, ("x", "z"), frame(link.parent))
        return tuple(b if a is None else a + b for a, b in zip(found, moved, strict=True))  # pyright: ignore

    known: dict[int, tuple] = {}
    at = foot
    if stance.radius is not None:
        radius, angle = numbers[stance.radius], angles[stance.link]
        at = at[0] + (0.0 if angle is None else radius * angle), at[1] + radius
    i = stance.link
    known[i] = plus(at, vector(numbers, stance.place, turned[i]), -1.0)
    while i != BASE:  # up the stance leg, to the base
        known[links[i].parent] = plus(known[i], arm(i), -1.0)
        i = links[i].parent
    for i, link in enumerate(links):  # down from there
        if i not in known:
            known[i] = plus(known[link.parent], arm(i))
    return Pose(angles, [known[i] for i in range(len(links))], known[BASE], turned)


def place_in(found: Pose, numbers: Numbers, link: int, place: Place) -> tuple[Any, Any]:
    """Return a point of a link."""
    if link == BASE:
        return plus(found.base, vector(numbers, place, None))
    return plus(found.joints[link], vector(numbers, place, found.turned[link]))


def transfer(machine: Machine, numbers: Numbers, foot: tuple, coordinates: list) -> list:
    """Return F(q): places of the masses, angles of those with inertia, and geared-up rotors."""
    found = pose(machine, numbers, foot, coordinates)
    points: list[Any] = []
    for one in machine.masses:
        place = place_in(found, numbers, one.link, one.place)
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
    angles: list[Any] = []
    for link, value in zip(machine.links, coordinates, strict=True):
        above = angles[link.parent] if link.parent != BASE else None
        angles.append(value if link.turns else above)
    return [joint_value(machine, i, coordinates, angles) for i in range(len(machine.links))]
