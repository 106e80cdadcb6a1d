"""Margins by which a disturbed stride misses each way to fail."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.outcomes import Outcome, make_stride
from walker_jax.walkers.model import Walker
from walker_jax.walking.disturbed import Disturbance, disturbed_start
from walker_jax.walking.failure_margins import (
    Margins,
    guards_of,
    lesser_known,
    measure_stride,
    strike_margin,
)
from walker_jax.walking.raised_ground import onto_step
from walker_jax.walking.starts import during_stride
from walker_jax.walking.stride import (
    Arrival,
    Part,
    end_stride,
    follow_to_contact,
)


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
    swing, last = follow_to_contact(walker, x, step, integrator, measured=True)
    onto = onto_step(walker, swing, step)
    *before, level, lower = last.parts
    modes = [*(part.mode for part in before), level.mode._replace(at_end=()), onto]
    went_lower = lower.verdict == Outcome.UNDECIDED
    choose = partial(jnp.where, went_lower)
    ways = [part[1:] for part in (*before, level)]
    ways.append(jax.tree.map(choose, lower[1:], level[1:]))

    def measure(walker, arrival: Arrival, ways: list[Any]):
        following, stride = end_stride(walker, [swing], arrival)
        stride = make_stride(jnp.stack(following), stride.outcome, stride.time)
        parts = tuple(Part(mode, *way) for mode, way in zip(modes, ways, strict=True))
        known = measure_stride(walker, arrival._replace(parts=parts), stride.outcome)
        passed = strike_margin(parts[-2], guards_of(parts[-2]), went_lower)
        forward = jnp.where(stride.outcome == Outcome.STRIDE, passed, jnp.nan)
        known["forward"] = lesser_known(known["forward"], forward)
        return Margins(stride, **known)

    return with_fast_sincos(measure)(walker, last._replace(parts=()), ways)
