"""Motion during a stride: states at given times, and the times at which its phases end."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse, check_whole
from walker_jax.hybrid.graphs import check_states
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.integrator import AnySolver, Integrator, zero_at
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.kernels.primitive import nan_allowed
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import Outcome, nan_unless
from walker_jax.walking.guards import leads_on
from walker_jax.walking.integrals import with_integrals
from walker_jax.walking.iteration import check_on_section, follow_walk
from walker_jax.walking.starts import as_floating, during_stride, prepare
from walker_jax.walking.stride import (
    ModeResult,
    begin_course,
    end_course,
    follow_graph,
    modes_from,
    start_course,
)


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
    """Compute the state a time after the start of a stride; of the first phase, if any.

    That is a stride whose section is that time.
    """
    walker = during_stride(walker, x)
    modes, start = modes_from(walker, x), walker.launch(x)
    check_states(modes, start)
    kind = jax.tree.structure(start)
    until = {name: to_time(walker, name, mode, time, kind) for name, mode in modes.items()}
    both = start, {CLOCK: zero_at(start)}
    course = begin_course(next(iter(modes)), both, jnp.isfinite(time))
    course, _ = follow_graph(walker, until, course, integrator)
    arrived = course.verdict == Outcome.STRIDE
    return jax.tree.map(partial(nan_unless, arrived), course.entries[SECTION].state)


CLOCK = "time"
"""The integral that tells the time since the start of a stride."""


def to_time(walker: HybridSystem, name: str, mode: Mode, time: Scalar, kind: Any) -> Mode:
    """Return a mode that ends where it leads to another one, or at a time in a state to be shown.

    Its states are pairs, of the state and of the clock.
    """

    def show(both):
        shown = walker.shown(both[0])
        if jax.tree.structure(shown) != kind:
            raise WrongUse(
                f"the trajectory of {walker.label()} cannot be had: mode {name!r} has a state "
                "of another kind than the first one, unless shown makes it one"
            )
        return shown

    numbers = failures_by_name(walker)
    onward = tuple(one for one in mode.guards if leads_on(one, numbers))
    alone = mode._replace(guards=onward, conditions=(), early_exit=None)
    clocked = with_integrals(alone._replace(integrals={CLOCK: lambda state: 1.0}), [CLOCK])
    end = Guard(lambda both: both[1][CLOCK] - time, SECTION, at_once=True, reset=show)
    return clocked._replace(guards=(*clocked.guards, end))


def phase_times(
    walker: HybridSystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Float[Array, " modes"]:
    """Compute the time at which each mode of a stride ends; the latest is the time of `stride`.

    Times are in the unit of time, one for each mode, in the order of `modes`. For a kneed walker
    they are the times of knee strike, 0 where the knee locks at once, and of heel strike. A mode
    that is entered again has the time at which it ends last. Times are NaN for modes that lead
    neither to another one nor to the section. Arguments and errors are those of `stride`.

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
    begun = start_course(walker, modes, x)
    none = jnp.full_like(begun.time, jnp.nan), jnp.asarray(False)

    def add(known: Ends, part: ModeResult) -> Ends:
        """Add a mode; one that is entered again ends later."""
        time, is_last = known[part.name]
        for i, guard in enumerate(part.mode.guards):
            if guard.leads_to == SECTION:
                is_last |= part.taken == i
        time = jnp.where(part.passed, part.time + part.end.time, time)
        return known | {part.name: (time, is_last)}

    course, ends = follow_graph(walker, modes, begun, integrator, add, dict.fromkeys(modes, none))
    made = end_course(walker, modes, course)
    walks = made.outcome == Outcome.STRIDE  # or a later stride's failure, known at its end
    # By name, as loops of JAX sort the keys.
    each = (ends[name] for name in modes)
    return jnp.stack([nan_unless(~is_last | walks, time) for time, is_last in each])


Ends = dict[str, tuple[Scalar, Bool[Array, ""]]]
"""When each mode ended last since the start of the stride, NaN if it led nowhere, and whether it
led to the section."""
