"""Conditions of a mode: their least values between two states of a motion.

The value of a condition may cost as much as a vector field, as a force does. So it is not expanded
in a series but evaluated where steps end, with its rate. A step has a minimum within it if the rate
is negative at its start and positive at its end.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool

from walker_jax.hybrid.modes import Condition, Function
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.roots import Scalar

FINE = 1e-6
"""Resolution of a time, as part of a step. The error of a value is about the square of it."""


def is_negative(condition: Condition, state: Any) -> Bool[Array, ""]:
    return with_fast_sincos(condition.value)(lax.stop_gradient(state)) < 0


def value_and_rate(
    value: Function, rates: Callable[[Any], Any], state: Any
) -> tuple[Scalar, Scalar]:
    """Return the value of a function and its rate along a motion; constants to derivatives."""
    both = with_fast_sincos(lambda state: jax.jvp(value, (state,), (rates(state),)))
    return lax.stop_gradient(both(lax.stop_gradient(state)))


def least_between(
    at: Callable[[Any], tuple[Scalar, Scalar]],
    before: Any,
    after: Any,
    between: Callable[[Scalar], Any],
    time: Scalar,
    *,
    resolution: float = FINE,
    above: float = -np.inf,
) -> tuple[Scalar, Scalar]:
    """Find the time at which a value is least between two states of a motion, and that value.

    The states are `time` apart. `at` returns the value with its rate. The least value is at a root
    of the rate, bracketed by secants (Illinois) to a part of `time`, or until the value is not
    `above` some number. It is infinite where there is no minimum in between. Results are constants
    to derivatives.
    """
    before, after, time = lax.stop_gradient((before, after, time))
    below, beyond, zero = at(before)[1], at(after)[1], jnp.zeros_like(time)
    # A finer resolution would never be reached.
    resolution = max(resolution, 8 * float(jnp.finfo(time.dtype).eps))

    def unfinished(carry):
        low, high, *_, least = carry
        return (high - low > resolution * time) & (least > above)

    def narrow(carry):
        low, high, below, beyond, best, least = carry
        t = low + (high - low) * jnp.clip(below / (below - beyond), 0.01, 0.99)
        value, rate = at(lax.stop_gradient(between(t)))
        falling = rate < 0
        # An end that stays counts half as much the next time.
        return (
            jnp.where(falling, t, low),
            jnp.where(falling, high, t),
            jnp.where(falling, rate, below / 2),
            jnp.where(falling, beyond / 2, rate),
            jnp.where(value < least, t, best),
            jnp.minimum(least, value),
        )

    active = (below < 0) & (beyond > 0)
    high = jnp.where(active, time, zero)
    carry = (zero, high, below, beyond, zero, jnp.full_like(time, jnp.inf))
    *_, best, least = lax.while_loop(unfinished, narrow, carry)
    return best, least
