"""The section of a robot: both feet on the ground, the trailing one behind its joint."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.robots.machine import Machine, Numbers, Pose
from walker_jax.robots.stances import RobotState, Stance


class Arm(NamedTuple):
    """The way from the joint of the last free link of a leg to the centre of the foot."""

    length: Any
    angle: Any
    """Coordinate of that link at which the foot is straight below the joint, but for the sign."""


def last_free(stance: Stance) -> int:
    """Return the link whose coordinate the section leaves out: that nearest to the swing foot."""
    return stance.free[-1]


def foot_arm(stance: Stance) -> Arm:
    """Return the arm of the swing foot; the locked links below the joint are rigid."""
    machine, numbers = stance.machine, stance.numbers
    zero = 0 * numbers["gravity"]
    coordinates = machine.locked([zero] * len(stance.free), numbers, stance.locked)
    pose = Pose(machine, numbers, (zero, zero), coordinates)
    centre, joint = pose.swing_centre(), pose.joint(last_free(stance))
    x, z = centre[0] - joint[0], centre[1] - joint[1]
    return Arm(jnp.sqrt(x**2 + z**2), jnp.arctan2(-x, -z))


def radius_of(machine: Machine, numbers: Numbers) -> Any:
    name = machine.feet[0].radius
    return 0.0 if name is None else numbers[name]


def cosine_of_last(stance: Stance, arm: Arm, known: list) -> Any:
    """Return the cosine of the angle of the swing foot's arm, with both feet on the ground."""
    joint = stance.pose(stance_coordinates([*known, jnp.zeros_like(known[0])])).joint(
        last_free(stance)
    )
    return (joint[1] - radius_of(stance.machine, stance.numbers)) / arm.length


def slid_to_ground(stance: Stance, known: list) -> Any:
    """Return the displacement of a slide as the last link, with both feet on the ground."""
    height = lambda last: stance.sole(stance_coordinates([*known, last]))[1]
    zero = jnp.zeros_like(known[0])
    nothing, one = height(zero), height(zero + 1)
    return nothing / (nothing - one)


def last_coordinate(stance: Stance, straight: bool, known: list) -> Any:
    """Return the coordinate that the section leaves out; NaN where the foot cannot reach."""
    if not stance.machine.links[last_free(stance)].turns:
        return slid_to_ground(stance, known)
    arm = foot_arm(stance)
    if straight:
        return -known[0] - 2 * arm.angle
    return jnp.arccos(cosine_of_last(stance, arm, known)) - arm.angle


def can_reach(stance: Stance, straight: bool, x: Float[Array, " section"]) -> Any:
    """Return whether there is such a pose; straight legs must walk forward and lift a foot too."""
    count = len(stance.free)
    if straight:
        angle = x[0] + foot_arm(stance).angle
        rates = x[count - 1 :]
        forward = (angle < 0) & (angle > -jnp.pi / 2) & (rates[0] > 0)
        return forward & (rates[0] + rates[-1] > 0)
    if not stance.machine.links[last_free(stance)].turns:
        return jnp.isfinite(slid_to_ground(stance, list(x[: count - 1])))
    return jnp.abs(cosine_of_last(stance, foot_arm(stance), list(x[: count - 1]))) < 1


def state_on_section(stance: Stance, straight: bool, x: Float[Array, " section"]) -> RobotState:
    """Return the state of a point of the section."""
    count = len(stance.free)
    known = list(x[: count - 1])
    return RobotState((*known, last_coordinate(stance, straight, known)), tuple(x[count - 1 :]))


def point_of(state: RobotState) -> Float[Array, " section"]:
    """Return the point of the section that belongs to a state on it."""
    return jnp.stack([*state.coordinates[:-1], *state.rates])
