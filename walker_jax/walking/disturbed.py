"""Walks with a disturbance in every stride: of the ground, the slope, or a push.

States are full states, such as (theta, phi, thetadot, phidot), just after heel strike, because the
feet stand at different heights on rough ground.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.stride import follow_step


class Disturbance(NamedTuple):
    """Disturbances of one stride."""

    step: Scalar | float = 0.0
    """Height of the next foothold above the present one, in the unit of length."""
    slope: Scalar | float = 0.0
    """Change of the ground's slope, for this stride (rad)."""
    push: Scalar | float = 0.0
    """Change of thetadot at the stride's start (`Walker.push`)."""


class DisturbedWalk(NamedTuple):
    """The end of a number of disturbed strides: arrays of JAX or of NumPy."""

    state: Float[Any, "*walks full"]
    """The full state after the last stride; NaN after a failure."""
    outcome: Int[Any, "*walks"]
    """`Outcome` of the last stride."""
    strides: Int[Any, "*walks"]
    """Number of completed strides."""


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
    start = walker.lift(x) if x.shape == (len(walker.section),) else walker.state(*x)
    pushed = jnp.stack(walker.push(start, jnp.asarray(disturbance.push)))
    return steeper, pushed, jnp.asarray(disturbance.step)


def follow_disturbed_walk(
    walker: Walker,
    x: Float[Array, " full"],
    disturbances: Float[Array, "strides 3"],
    integrator: Integrator,
) -> DisturbedWalk:
    """Follow strides, each with its disturbance, to a failure or the last one."""

    def advance(walk, disturbance):
        result = follow_disturbed(walker, walk.state, Disturbance(*disturbance), integrator)
        going = walk.outcome == Outcome.STRIDE
        outcome = jnp.where(going, result.outcome, walk.outcome)
        made = (outcome == Outcome.STRIDE).astype(jnp.int32)
        return DisturbedWalk(result.state, outcome, walk.strides + made), None

    first = DisturbedWalk(x, jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.zeros((), jnp.int32))
    return lax.scan(advance, first, disturbances)[0]
