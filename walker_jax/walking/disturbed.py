"""Strides and walks with a disturbance in every stride: of the ground, the slope, or a push.

States are full states, such as (theta, phi, thetadot, phidot), just after heel strike, because the
feet stand at different heights on rough ground.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Stride
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.failure_margins import Margins, measure_modes
from walker_jax.walking.scan import Walked, scan_strides
from walker_jax.walking.starts import during_stride, on_section
from walker_jax.walking.stride import follow_stride, modes_from, with_full_state


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
    walker, x, step = disturbed_start(walker, x, disturbance)
    return follow_stride(walker, x, integrator, step)


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
    """Follow one disturbed stride, as `follow_disturbed` does, and measure its margins."""
    walker, x, step = disturbed_start(walker, x, disturbance)
    walker = during_stride(walker, x)
    modes = modes_from(walker, x, step, to_the_end=True)
    found, course = measure_modes(walker, x, modes, integrator)
    return found._replace(stride=with_full_state(found.stride, course))
