"""Solutions of equations of motion at one time, by the steps of a Taylor method."""

import jax.numpy as jnp
from jax import lax


def solve(method, state, time):
    """Integrate from a state for a time."""

    def make(now):
        state, left = now
        series, _, length, _ = method.step(state, method.begin(state))
        length = jnp.minimum(length, left)
        return method.state_at(state, series, length), left - length

    return lax.while_loop(lambda now: now[1] > 0, make, (state, time))[0]
