"""Frames of a stride, for pictures and films: to its end, or to the end of the fall."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Walker
from walker_jax.walking.raised_ground import raise_ground
from walker_jax.walking.starts import during_stride, prepare
from walker_jax.walking.stride import (
    begin_stride,
    follow_phases,
    follow_swing,
    follow_to_step,
    modes_from,
)
from walker_jax.walking.trajectories import legs, trajectory


@kernel
def ends_of_modes(
    walker: Walker,
    x: Float[Array, " coordinates"],
    step: Float[Array, ""] | None,
    integrator: Integrator,
) -> Float[Array, " modes"]:
    """Return the time at which each phase ends, and at which the picture ends; infinite if never.

    The picture ends where the swing foot comes down, or the walker is on the ground.
    """
    walker = during_stride(walker, x)
    *phases, swing = map(to_the_ground, modes_from(walker, x, to_the_end=True))
    begun = begin_stride(walker, x)
    if step is None:
        ends = follow_phases(phases, begun, integrator)
        last = follow_swing(swing, ends[-1], integrator)
    else:
        ends = follow_phases([raise_ground(one, step) for one in phases], begun, integrator)
        last = follow_to_step(walker, swing, ends[-1], step, integrator)
    times = [jnp.where(one.verdict == Outcome.UNDECIDED, one.time, jnp.inf) for one in ends[1:]]
    end = jnp.where(last.verdict == Outcome.UNDECIDED, jnp.inf, last.time)
    return jnp.stack([*times, end])


def to_the_ground(mode: Mode) -> Mode:
    """Return the same motion, in which a leg that stops goes on until it is down."""
    down = lambda state: state.theta - np.pi / 2
    guards = [
        one._replace(value=down, persists=False) if one.leads_to == Outcome.BACKWARD else one
        for one in mode.guards
    ]
    return mode._replace(guards=tuple(guards), conditions=())


def frames_of_stride(
    walker: Walker,
    x: Float[np.ndarray, " coordinates"],
    stride: tuple[Outcome, float],
    step: float,
    *,
    longest: float,
    height: float | None = None,
    tolerance: float | None = None,
) -> tuple[Float[np.ndarray, " frames"], Any]:
    """Return times about `step` apart from the start of a stride to its end, and the states then.

    `stride` is its outcome and duration. A failing stride is shown to its end, or to the violation
    of a condition, and for `longest` at most. `height` is the step up to the next foothold, on
    rough ground.
    """
    outcome, duration = stride
    ends = np.array([duration])
    if outcome != Outcome.STRIDE:
        ends = np.minimum(find_ends(walker, x, height, tolerance), longest)
    times = np.linspace(0, ends[-1], 1 + max(1, round(ends[-1] / step)))
    states = jax.tree.map(np.asarray, trajectory(walker, x, times, tolerance=tolerance))
    count = frames_shown(walker, outcome, states, swings_at(times, ends))
    return times[:count], jax.tree.map(lambda values: values[:count], states)


def find_ends(
    walker: Walker,
    x: Float[np.ndarray, " coordinates"],
    height: float | None = None,
    tolerance: float | None = None,
) -> Float[np.ndarray, " modes"]:
    """Compute `ends_of_modes`, with arguments as in `stride`."""
    walker, start, integrator = prepare(walker, x, tolerance)
    step = None if height is None else jnp.asarray(height, start.dtype)
    return np.asarray(ends_of_modes(walker, start, step, integrator))


def swings_at(
    times: Float[np.ndarray, " frames"], ends: Float[np.ndarray, " modes"]
) -> Bool[np.ndarray, " frames"]:
    """Return whether the phases before the swing are over."""
    return times >= (ends[-2] if len(ends) > 1 else 0)


def frames_shown(
    walker: Walker, outcome: Outcome, states: Any, swings: Bool[np.ndarray, " frames"]
) -> int:
    """Count the frames before the violation of the condition that ended a stride, if one did.

    The count is at least one. Before the swing, states are those of the first phase.
    """
    violated, modes = np.zeros(len(swings), bool), walker.modes()
    parts = [(modes[-1], legs(states) if len(modes) > 1 else states, swings)]
    parts += [(modes[0], states, ~swings)] if len(modes) > 1 else []
    for mode, at, here in parts:
        for one in mode.conditions:
            if one.outcome == outcome:
                value = jax.vmap(one.value)(jax.tree.map(jnp.asarray, at))
                violated |= here & (np.asarray(value) < 0)
    return max(1, int(violated.argmax())) if violated.any() else len(swings)
