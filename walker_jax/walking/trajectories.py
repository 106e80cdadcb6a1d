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

from walker_jax.checks import WrongUse, check_whole
from walker_jax.hybrid.graphs import in_order, suit_state
from walker_jax.hybrid.modes import SECTION, Mode
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.kernels.primitive import nan_allowed
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import nan_unless
from walker_jax.walking.courses import (
    begin_course,
    end_course,
    follow_modes,
    follow_one,
    leads_on,
)
from walker_jax.walking.iteration import check_on_section, follow_walk
from walker_jax.walking.starts import as_floating, during_stride, prepare
from walker_jax.walking.stride import check_entered_once, first_of, modes_from, start_course


def trajectory(
    walker: HybridSystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    times: Float[ArrayLike, " times"] | Sequence[Any],
    *,
    strides: int = 1,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Any:
    """Compute angles and rates at `times` after the start x of a stride, 0 or later, in any order.

    Times are in the unit of time, sqrt(leg length / gravity), angles in rad.

    The motion follows the equations alone: it does not end at heel strike, whose time `stride`
    gives. A mode ends where a guard leads to another one, at `phase_times`; a walker that falls
    before goes on. With `strides` above 1, times go on over so many strides, the last of which does
    not end; at the instant at which one ends, the state is the first of the next. They have
    derivatives, which jump where a stride ends.

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
    check_whole("strides", strides)
    if strides == 1:
        return jax.vmap(state_after, (None, None, 0, None))(walker, x, times, integrator)
    check_on_section(walker, x)
    with nan_allowed():
        walk = follow_walk(walker, x, strides - 1, integrator)
    ends = jnp.cumsum(walk.times)
    number = jnp.searchsorted(ends, times, side="right")  # times after a failure are NaN, the last
    left = times - jnp.concatenate([jnp.zeros_like(ends[:1]), ends])[number]
    return jax.vmap(state_after, (None, 0, 0, None))(walker, walk.states[number], left, integrator)


@kernel
def state_after(
    walker: HybridSystem,
    x: Float[Array, " coordinates"],
    time: Scalar,
    integrator: Integrator,
) -> Any:
    """Compute the state a time after the start of a stride; of the first phase, if any."""
    walker = during_stride(walker, x)
    modes, numbers = modes_from(walker, x), failures_by_name(walker)
    check_entered_once(walker, modes, "the trajectory")
    order = in_order(modes)
    result = start = walker.launch(x)
    course = begin_course(order[0], start, jnp.asarray(True))
    for name in order:
        entry = course.entries[name]
        mode = suit_state(name, modes[name], entry.state)
        left = time - jnp.where(entry.reached, course.time, jnp.inf)
        later = walker.shown(state_of_motion(mode, entry.state, jnp.maximum(left, 0), integrator))
        if jax.tree.structure(later) != jax.tree.structure(start):
            raise WrongUse(
                f"the trajectory of {walker.label()} cannot be had: mode {name!r} has a state "
                "of another kind than the first one, unless shown makes it one"
            )
        result = jax.tree.map(partial(jnp.where, left >= 0), later, result)
        onward = tuple(one for one in mode.guards if leads_on(one, numbers))
        if onward:  # a mode ends by these alone
            alone = {name: mode._replace(guards=onward, conditions=(), foregone=None)}
            switched = name != order[0]
            course = follow_one(name, alone, numbers, course, integrator, False, switched)
    return result


def state_of_motion(mode: Mode, start: Any, time: Scalar, integrator: Integrator) -> Any:
    """Compute the state a time after another, in one mode."""
    method = integrator.method(mode.field, start)
    solution = method.solve(start, jnp.zeros_like(time), time, mode.most_steps)
    arrived = solution.result == diffrax.RESULTS.successful
    return jax.tree.map(lambda values: nan_unless(arrived, values[-1]), solution.ys)


def phase_times(
    walker: HybridSystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Float[Array, " modes"]:
    """Compute the time at which each mode of a stride ends; the latest is the time of `stride`.

    Times are in the unit of time, one for each mode, in the order of `modes`. For a kneed walker
    they are the times of knee strike, 0 where the knee locks at once, and of heel strike. They are
    NaN for modes that lead neither to another one nor to the section. Arguments and errors are
    those of `stride`.

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
) -> Float[Array, " modes"]:
    walker = during_stride(walker, x)
    modes = modes_from(walker, x)
    check_entered_once(walker, modes, "phase times")
    course = follow_modes(walker, modes, start_course(walker, modes, x), integrator)
    made = end_course(walker, first_of(modes), course)
    times = {}
    for name, part in zip(in_order(modes), course.parts, strict=True):
        end = part.time + part.end.time
        for i, guard in enumerate(part.mode.guards):
            if guard.leads_to == SECTION:  # or a later stride's failure, known at its end
                end = jnp.where(part.taken == i, made.time, end)
        times[name] = nan_unless(part.passed, end)
    return jnp.stack([times[name] for name in modes])
