"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3).

A stride follows the modes of a walker: its phases and, last, the swing, which ends at heel strike
or in a fall (`courses`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_number, check_whole, short
from walker_jax.hybrid.graphs import entered_again
from walker_jax.hybrid.modes import SECTION, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name, modes_of
from walker_jax.systems.outcomes import Outcome, Stride, make_stride
from walker_jax.systems.system import System, apply_map
from walker_jax.walkers.model import Scalar, Walker, check_planar
from walker_jax.walking.courses import (
    Course,
    Entry,
    begin_course,
    end_course,
    follow_graph,
    follow_modes,
    follow_one,
    method_of,
    take_guard,
)
from walker_jax.walking.raised_ground import height_of_step, onto_step, raise_ground
from walker_jax.walking.starts import during_stride, on_section, prepare

ROUNDING = 100
"""Largest height of a step that counts as level, over the spacing of floating-point numbers at
1."""


def stride(
    walker: System,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    step: Real | None = None,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Stride:
    """Make one stride, S(x), equation (20); for any `System`, the step to its next point.

    ```python
    walker = wj.SimplestWalker(0.004)
    end = wj.stride(walker, (0.2, -0.2))
    end.outcome, end.state, end.time
    ```

    Works under JAX's transformations, in the dtype of x, float32 or float64: `jax.jit`, `jax.vmap`,
    `jax.lax.scan`; `jax.jacfwd`, `jax.grad` and `jax.jacrev`, and derivatives of these. On a CPU
    all of them call machine code (`kernels`), so a jitted `jax.vmap` is as fast as `strides`.

    **Arguments:**

    - `walker`: any walker or other system; derivatives with respect to its parameters are right
      too.
    - `x`: the start, on the walker's section just after heel strike; or a full state
      (theta, phi, thetadot, phidot), for a launch or after a push. A full state is feasible if it
      is finite and the stance leg stands, |theta| < pi/2.
    - `step`: height of the next foothold above the present one, normal to the slope, in the unit of
      length; by default 0. The swing foot comes down there ahead of the other, with a straight
      knee; if it does not rise that high, the walker falls. Scuffing is judged by the present
      level. The result's state is then a full state, just after heel strike and off the section, as
      one foot is lower. `stride` takes it from there, on a slope through the standing foot.
    - `tolerance`: of one integration step: of its last Taylor terms, relative to the state or its
      rate (`integrators.taylor_steps.step_size`), or of the error that another solver estimates.
      By default 1e-12 in float64 and 1e-6 in float32. A stride amplifies this error, up to 1e5
      times near falling backward.
    - `solver`: one of diffrax's Runge-Kutta methods, such as `diffrax.Dopri8()`, in place
      of the Taylor series. It does not know where a vector field has kinks.

    **Returns** a `Stride`. A failure is an `Outcome`. Raises `ValueError` for a wrong shape or
    dtype, and for a tolerance that the dtype cannot hold.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if step is None:
        return follow_stride(walker, x, integrator)
    return follow_step(check_planar(walker), x, height_of_step(step, x.dtype), integrator)


@kernel
def follow_stride(
    walker: System, x: Float[Array, " coordinates"], integrator: Integrator
) -> Stride:
    walker = during_stride(walker, x)
    if not isinstance(walker, HybridSystem):
        return apply_map(walker, x)
    modes = modes_from(walker, x)
    course = follow_graph(walker, modes, start_course(walker, modes, x), integrator)
    return end_course(walker, first_of(modes), course)


def modes_from(
    walker: HybridSystem, x: Float[Array, " coordinates"], *, to_the_end: bool = False
) -> dict[str, Mode]:
    """Return the modes of the stride from x.

    A launched walker, which did not start on the section, is followed to the end of a fall.
    """
    modes = modes_of(walker)
    for mode in modes.values():
        check_whole("most_steps", mode.most_steps)
    launched = not on_section(walker, x)
    if launched or to_the_end:
        modes = {name: one._replace(foregone=None) for name, one in modes.items()}
    if launched:
        anywhere = lambda one: one._replace(zero_at_ends=(False, one.zero_at_ends[1]))
        first, *_ = modes
        conditions = tuple(map(anywhere, modes[first].conditions))
        modes[first] = modes[first]._replace(conditions=conditions)
    return modes


def check_entered_once(walker: HybridSystem, modes: dict[str, Mode], what: str) -> None:
    """Raise `WrongUse` for a system some of whose modes can be entered again in a stride."""
    if again := entered_again(modes):
        raise WrongUse(
            f"{what} of {walker.label()} cannot be had: its mode {again[0]!r} can be entered again"
        )


def first_of(modes: dict[str, Mode]) -> Mode:
    """Return the mode in which strides begin."""
    return next(iter(modes.values()))


def start_course(
    walker: HybridSystem, modes: dict[str, Mode], x: Float[Array, " coordinates"]
) -> Course:
    """Return the course of the stride from x, in the first mode."""

    def begin(walker, x):
        start = walker.launch(x)
        return start, jnp.asarray(walker.may_launch(x, start))

    first, *_ = modes
    return begin_course(first, *with_fast_sincos(begin)(walker, x))


def step_down(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    drop: Real,
    *,
    tolerance: Real | None = None,
) -> Stride:
    """Make one stride whose heel strike is on ground lower by `drop`, which is not negative.

    It is `stride(walker, x, step=-drop)`; `drop` is in the unit of length.

    ```python
    walker = wj.SimplestWalker(0.004)
    end = wj.step_down(walker, wj.find_gait(walker).states[0], 0.001)
    end.state  # a full state: the feet stand at different heights
    ```
    """
    if not isinstance(drop, Tracer):
        check_number("drop", drop)
        if not 0 <= drop < np.inf:
            raise WrongUse(f"drop must be one number, finite and not negative, not {short(drop)}")
    step = -drop if isinstance(drop, Tracer) else -float(drop)
    return stride(walker, x, step=step, tolerance=tolerance)


@kernel
def follow_step(
    walker: Walker, x: Float[Array, " coordinates"], step: Float[Array, ""], integrator: Integrator
) -> Stride:
    """Make one stride to ground higher by `step`; the result's state is a full state."""
    walker = during_stride(walker, x)
    modes, course = follow_to_contact(walker, x, step, integrator)
    return end_step(walker, modes, course)[1]


def end_step(walker: Walker, modes: dict[str, Mode], course: Course) -> tuple[Course, Stride]:
    """Return the course of a step after its heel strike, and its stride, whose state is full."""
    strike = modes[[*modes][-1]].guards[-1]
    take = with_fast_sincos(partial(take_guard, strike, failures_by_name(walker)))
    held, following = take(course.entries[SECTION].state)
    landed = {SECTION: course.entries[SECTION]._replace(state=following)}
    course = course._replace(entries=landed, held=held)
    stride = end_course(walker, first_of(modes), course)
    return course, make_stride(jnp.stack(following), stride.outcome, course.time)


def follow_to_contact(
    walker: Walker,
    x: Float[Array, " coordinates"],
    step: Scalar,
    integrator: Integrator,
    measured: bool = False,
) -> tuple[dict[str, Mode], Course]:
    """Return the modes of a stride to ground higher by `step`, and its course to heel strike."""
    modes = modes_from(walker, x, to_the_end=measured)
    *phases, last = modes
    course = start_course(walker, modes, x)
    if raised := {name: raise_ground(modes[name], step) for name in phases}:
        course = follow_modes(walker, raised, course, integrator, measured)
    course = follow_to_step(walker, last, modes[last], course, step, integrator, measured)
    # On even ground no swing is left, but its derivative with respect to the step is.
    contact = lambda state: step - walker.clearance(state)
    state = course.entries[SECTION].state
    state, delay = method_of(modes[last], state, integrator).refine_event(contact, state)
    entries = {SECTION: course.entries[SECTION]._replace(state=state)}
    return modes, course._replace(entries=entries, time=course.time + delay)


def follow_to_step(
    walker: Walker,
    name: str,
    swing: Mode,
    course: Course,
    step: Scalar,
    integrator: Integrator,
    measured: bool = False,
) -> Course:
    """Follow the swing on even ground, and on to ground that is higher by `step`, to its strike.

    A foot that goes below the ground has passed its level first, ahead of the other: the legs may
    pass each other below the level, and that is no heel strike.
    """
    # A step within rounding counts as level: its foot may be there already, or have been there as
    # the legs passed each other.
    rounding = ROUNDING * jnp.finfo(step.dtype).eps
    passed, numbers = step > rounding, failures_by_name(walker)
    if walker.phases():  # a foot in front may be below the level as a knee strikes
        state = course.entries[name].state
        ahead = (state.phi < 0) & (walker.is_ahead(state) > 0)
        under = with_fast_sincos(walker.clearance)(state) < 0
        passed |= (step < 0) & ahead & under
    follow = lambda mode, course, switched: follow_one(
        name, {name: mode}, numbers, course, integrator, measured, switched
    )
    level = follow(onto_step(walker, swing, step, passed), course, bool(walker.phases()))
    struck = level.entries[SECTION]
    lower = (level.verdict == Outcome.STRIDE) & (step < -rounding) & ~passed
    verdict = jnp.where(lower, Outcome.UNDECIDED, level.verdict).astype(jnp.int8)
    entries = {name: Entry(lower, struck.state), SECTION: struck}
    return follow(
        onto_step(walker, swing, step), level._replace(entries=entries, verdict=verdict), True
    )
