"""Forces in the joints: springs, dampers, and motors or servos, with a controller of the user's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from walker_jax.checks import WrongUse, short
from walker_jax.robots.machine import Actuator, Machine, Numbers, joint_values

Controller = Callable[[dict[str, Any], dict[str, Any], Numbers], Mapping[str, Any]]
"""From the joints' values and rates by name, and all parameters, to ctrl of actuators by name."""


def joint_forces(
    machine: Machine,
    numbers: Numbers,
    controller: Controller | None,
    coordinates: list,
    rates: list,
) -> list:
    """Return generalised forces dual to the coordinates, in tree order."""
    values, speeds = joint_values(machine, coordinates), joint_values(machine, rates)
    at = [value + one.reference for value, one in zip(values, machine.links, strict=True)]
    forces: list[Any] = [0 * coordinates[0]] * len(at)
    for i, link in enumerate(machine.links):
        if link.stiffness is not None:
            rest = 0.0 if link.rest is None else numbers[link.rest]
            forces[i] = forces[i] - numbers[link.stiffness] * (at[i] - rest)
        if link.damping is not None:
            forces[i] = forces[i] - numbers[link.damping] * speeds[i]
    ctrl = commands(machine, numbers, controller, at, speeds)
    for one in machine.actuators:
        i = one.link
        forces[i] = forces[i] + actuator_force(one, numbers, ctrl[one.name], at[i], speeds[i])
    return on_coordinates(machine, forces)


def commands(
    machine: Machine, numbers: Numbers, controller: Controller | None, at: list, speeds: list
) -> dict[str, Any]:
    """Return ctrl of each actuator by name: the controller's, or else its parameter."""
    ctrl = {one.name: numbers[one.ctrl] for one in machine.actuators}
    if controller is None:
        return ctrl
    joints = [one.joint for one in machine.links]
    values, rates = (dict(zip(joints, some, strict=True)) for some in (at, speeds))
    given = controller(values, rates, numbers)
    if not isinstance(given, Mapping) or not set(given) <= set(ctrl):
        raise WrongUse(
            f"controller must return ctrl by the names of actuators, {', '.join(ctrl) or 'none'}, "
            f"not {short(given)}"
        )
    return ctrl | {name: jnp.asarray(value) for name, value in given.items()}


def actuator_force(one: Actuator, numbers: Numbers, ctrl: Any, at: Any, speed: Any) -> Any:
    """Return the force of an actuator on its joint."""
    if one.ctrl_limits is not None:
        ctrl = jnp.clip(ctrl, *one.ctrl_limits)
    if one.gain is not None:
        force = numbers[one.gain] * ctrl
    else:
        force = 0.0 * at
        if one.kp is not None:
            force = force + numbers[one.kp] * (ctrl - one.gear * at)
        if one.kv is not None:
            aim = ctrl if one.targets_rate else 0.0
            force = force + numbers[one.kv] * (aim - one.gear * speed)
    if one.force_limits is not None:
        force = jnp.clip(force, *one.force_limits)
    return one.gear * force


def on_coordinates(machine: Machine, forces: list) -> list:
    """Return the forces dual to the coordinates: a hinge also turns the link before it back."""
    zero = 0 * forces[0]
    found = [zero] * len(forces)
    for i, link in enumerate(machine.links):
        if not isinstance(link.direction, float):
            found[i] = found[i] + forces[i]
            continue
        turn = forces[i] if link.direction > 0 else -forces[i]
        found[i] = found[i] + turn
        above = link.parent
        while above >= 0 and not machine.links[above].turns:
            above = machine.links[above].parent
        if above >= 0:
            found[above] = found[above] - turn
    return found
