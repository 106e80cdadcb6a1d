"""Motion during a stride: states at given times, and the times at which its phases end."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome, nan_unless
from walker_jax.walkers.model import Scalar, State, Walker
from walker_jax.walking.starts import as_floating, during_stride, full_state, prepare
from walker_jax.walking.stride import (
    Arrival,
    begin_stride,
    follow_phases,
    follow_stride,
    modes_from,
)


def trajectory(
    walker: HybridSystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    times: Float[ArrayLike, " times"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Any:
    """Compute angles and rates at `times` after the start x of a stride, 0 or later, in any order.

    Times are in the unit of time, sqrt(leg length / gravity), angles in rad.

    The motion follows the equations alone: it does not end at heel strike, whose time `stride`
    gives. Phases end with their events, at `phase_times`; a walker that falls before goes on.

    ```python
    walker = wj.SimplestWalker(0.004)
    state = wj.trajectory(walker, (0.2, -0.2), (0.0, 1.0, 2.0))
    state.theta, state.phi  # at each of the three times
    ```

    Returns a `State` of arrays, or a state of the stride's first phase, such as `BentState`; NaN
    where that takes more than `Mode.most_steps` of integration. Raises `ValueError` as `stride`
    does, and for times that are not finite or negative.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if not isinstance(x, Tracer) and not jnp.isfinite(x).all():
        raise WrongUse(f"x must be finite, not {x}")
    times = as_floating(times, "times").astype(x.dtype)
    if times.ndim != 1:
        raise WrongUse(f"times must be a row of numbers, not of shape {times.shape}")
    if not isinstance(times, Tracer):
        values = np.asarray(times)
        if values.size == 0 or not (np.isfinite(values) & (values >= 0)).all():
            raise WrongUse(f"times must be one or more, finite and not negative, unlike {times}")
    return jax.vmap(state_after, (None, None, 0, None))(walker, x, times, integrator)


@kernel
def state_after(
    walker: HybridSystem,
    x: Float[Array, " coordinates"],
    time: Scalar,
    integrator: Integrator,
) -> Any:
    """Compute the state a time after the start of a stride; of the first phase, if any."""
    walker = during_stride(walker, x)
    start, now = full_state(walker, x), jnp.zeros_like(time)
    *phases, swing = walker.modes()
    # A phase ends at its event only.
    alone = [mode._replace(guards=mode.guards[-1:], conditions=()) for mode in phases]
    going = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    ends = follow_phases(alone, Arrival(start, now, going, {}), integrator)
    result = start
    for mode, begun in zip([*phases, swing], ends, strict=True):
        begins = jnp.where(begun.verdict == Outcome.UNDECIDED, begun.time, jnp.inf)
        left = time - begins
        later = state_of_motion(mode, begun.state, jnp.maximum(left, 0), integrator)
        if isinstance(walker, Walker) and type(later) is not type(start):
            later = walker.phases()[0].begin(legs(later))
        result = jax.tree.map(partial(jnp.where, left >= 0), later, result)
    return result


def state_of_motion(mode: Mode, start: Any, time: Scalar, integrator: Integrator) -> Any:
    """Compute the state a time after another, in one mode."""
    method = integrator.method(mode.field, start)
    solution = method.solve(start, jnp.zeros_like(time), time, mode.most_steps)
    arrived = solution.result == diffrax.RESULTS.successful
    return jax.tree.map(lambda values: nan_unless(arrived, values[-1]), solution.ys)


def legs(states: Any) -> State:
    """Return the angles and rates of the legs, from states of any phase."""
    return State(*(getattr(states, name) for name in State._fields))


def phase_times(
    walker: HybridSystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Float[Array, " phases"]:
    """Compute the time at which each phase of a stride ends; the last is the time of `stride`.

    Times are in the unit of time. For a kneed walker they are the times of knee strike, 0 where the
    knee locks at once, and of heel strike. They are NaN for phases that do not end with their
    event. Arguments and errors are those of `stride`.

    ```python
    walker = wj.KneedWalker(0.05)
    gait = wj.find_gait(walker)
    knee_strike, heel_strike = wj.phase_times(walker, gait.states[0])
    ```
    """
    return follow_phase_times(*prepare(walker, x, tolerance, solver))


@kernel
def follow_phase_times(
    walker: HybridSystem, x: Float[Array, " coordinates"], integrator: Integrator
) -> Float[Array, " phases"]:
    ends = follow_stride(walker, x, integrator).time
    walker = during_stride(walker, x)
    *phases, _ = modes_from(walker, x)
    _, *parts = follow_phases(phases, begin_stride(walker, x), integrator)
    ended = [(one.verdict == Outcome.UNDECIDED) & jnp.isfinite(one.time) for one in parts]
    times = [nan_unless(good, one.time) for good, one in zip(ended, parts, strict=True)]
    return jnp.stack([*times, ends])
