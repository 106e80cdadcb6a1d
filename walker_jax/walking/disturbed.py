"""Strides and walks with a disturbance in every stride: of the ground, the slope, or a push.

States are full states, such as (theta, phi, thetadot, phidot), just after heel strike, because the
feet stand at different heights on rough ground.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.hybrid.modes import SECTION
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.courses import Part
from walker_jax.walking.failure_margins import (
    Margins,
    guards_of,
    measure_stride,
    strike_margin,
)
from walker_jax.walking.raised_ground import onto_step
from walker_jax.walking.scan import Walked, scan_strides
from walker_jax.walking.starts import during_stride, on_section
from walker_jax.walking.stride import end_step, first_of, follow_step, follow_to_contact


class Disturbance(NamedTuple):
    """Disturbances of one stride."""

    step: Scalar | float = 0.0
    """Height of the next foothold above the present one, in the unit of length."""
    slope: Scalar | float = 0.0
    """Change of the ground's slope, for this stride (rad)."""
    push: Scalar | float = 0.0
    """Change of thetadot at the stride's start (`Walker.push`)."""


@kernel
def follow_disturbed(
    walker: Walker,
    x: Float[Array, " coordinates"],
    disturbance: Disturbance,
    integrator: Integrator,
) -> Stride:
    """Follow one disturbed stride; the result's state is a full state."""
    return follow_step(*disturbed_start(walker, x, disturbance), integrator)


def disturbed_start(
    walker: Walker, x: Float[Array, " coordinates"], disturbance: Disturbance
) -> tuple[Walker, Float[Array, " full"], Scalar]:
    """Return the walker on a disturbed slope, its state after the push, and the step's height."""
    slope = vars(walker)["slope"] + disturbance.slope
    steeper = with_parameter(walker, "slope", slope)
    start = walker.lift(x) if on_section(walker, x) else walker.state(*x)
    pushed = jnp.stack(walker.push(start, jnp.asarray(disturbance.push)))
    return steeper, pushed, jnp.asarray(disturbance.step)


def follow_disturbed_walk(
    walker: Walker,
    x: Float[Array, " full"],
    disturbances: Float[Array, "strides 3"],
    integrator: Integrator,
) -> Walked:
    """Follow strides, each with its disturbance, to a failure or the last one."""
    step = lambda x, i: follow_disturbed(walker, x, Disturbance(*disturbances[i]), integrator)
    return scan_strides(step, x, len(disturbances))[0]


@kernel
def follow_disturbed_margins(
    walker: Walker,
    x: Float[Array, " full"],
    disturbance: Disturbance,
    integrator: Integrator,
) -> Margins:
    """Follow one disturbed stride, as `follow_disturbed` does, and measure its margins.

    A foot that comes down on lower ground has passed the level of the other foot before: the
    forward margin is the smaller one of the two.
    """
    walker, x, step = disturbed_start(walker, x, disturbance)
    walker = during_stride(walker, x)
    modes, course = follow_to_contact(walker, x, step, integrator, measured=True)
    *before, level, lower = course.parts
    swing = modes[[*modes][-1]]
    *others, contact = onto_step(walker, swing, step).guards
    contact = contact._replace(must_hold=swing.guards[-1].must_hold)
    to_contact = swing._replace(guards=(*others, contact))
    choose = partial(jnp.where, lower.followed)
    last = Part(to_contact, *jax.tree.map(choose, lower[1:], level[1:]))
    state = course.entries[SECTION].state  # with its derivative by the step
    last = last._replace(end=last.end._replace(state=state))
    *falls, passes = level.mode.guards
    to_level = level.mode._replace(guards=(*falls, passes._replace(leads_to="below")))
    level = level._replace(mode=to_level)
    course, stride = end_step(walker, modes, course)
    course = course._replace(parts=(*before, level, last))
    found = measure_stride(walker, first_of(modes), course, stride)
    passed = with_fast_sincos(lambda: strike_margin(level, guards_of(level)[-1], len(falls)))()
    known = lower.followed & (stride.outcome == Outcome.STRIDE)
    forward = jnp.fmin(found.forward, jnp.where(known, passed, jnp.nan))
    return found._replace(by_name=found.by_name | {Outcome.FORWARD.name: forward})
