"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3).

A stride follows the modes of a walker: its phases and, last, the swing, which ends at heel strike
or in a fall (`courses`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_number, check_whole, short
from walker_jax.hybrid.modes import SECTION, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, has_ground, modes_of
from walker_jax.systems.outcomes import Stride, make_stride
from walker_jax.systems.system import System, apply_map
from walker_jax.walking.courses import (
    Course,
    begin_course,
    end_course,
    follow_graph,
)
from walker_jax.walking.starts import during_stride, on_section, prepare


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
      length; by default 0. It is negative for a step down, as in `stride(walker, x, step=-0.001)`.
      The swing foot comes down there ahead of the other, with a straight
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
    return follow_step(check_ground(walker), x, height_of_step(step, x.dtype), integrator)


def check_ground(walker: System) -> HybridSystem:
    """Raise `WrongUse` for a system without ground that may be raised."""
    if not has_ground(walker):
        raise WrongUse(f"walker must be planar, not a {type(walker).__name__}", of="walker")
    return cast("HybridSystem", walker)


def height_of_step(step: Any, dtype) -> Float[Array, ""]:
    """Return a step's height, checked."""
    if not isinstance(step, Tracer):
        check_number("step", step)
        if not abs(step) <= np.finfo(float).max:
            raise WrongUse(f"step must be one finite number, not {short(step)}")
    return jnp.asarray(step, dtype)


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
    walker: HybridSystem,
    x: Float[Array, " coordinates"],
    step: Scalar | None = None,
    *,
    to_the_end: bool = False,
) -> dict[str, Mode]:
    """Return the modes of the stride from x, on level ground or onto a `step`.

    A launched walker, which did not start on the section, is followed to the end of a fall.
    """
    modes = modes_of(walker, step)
    for mode in modes.values():
        check_whole("most_steps", mode.most_steps)
    launched = not on_section(walker, x)
    if launched or to_the_end:
        modes = {name: one._replace(foregone=None) for name, one in modes.items()}
    if launched:
        anywhere = lambda one: one._replace(zero_at_start=False)
        first, *_ = modes
        conditions = tuple(map(anywhere, modes[first].conditions))
        modes[first] = modes[first]._replace(conditions=conditions)
    return modes


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


@kernel
def follow_step(
    walker: HybridSystem,
    x: Float[Array, " coordinates"],
    step: Float[Array, ""],
    integrator: Integrator,
) -> Stride:
    """Make one stride to ground higher by `step`; the result's state is a full state."""
    walker = during_stride(walker, x)
    modes = modes_from(walker, x, step)
    course = follow_graph(walker, modes, start_course(walker, modes, x), integrator)
    return with_full_state(end_course(walker, first_of(modes), course), course)


def with_full_state(stride: Stride, course: Course) -> Stride:
    """Return a stride with the full state after its last reset."""
    state = jnp.stack(jax.tree.leaves(course.entries[SECTION].state))
    return make_stride(state, stride.outcome, stride.time)
