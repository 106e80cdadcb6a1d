"""Derivatives of many strides in reverse: at one cost for any number of parameters."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.system import System
from walker_jax.walkers.choices import values_of
from walker_jax.walking.stride import follow_stride

PULLED_BACK = 64
"""Cells whose derivatives are computed in one call, so that one program serves any number."""

Pull = Callable[..., tuple[Any, Float[Array, "n section"]]]
"""A function of a walker, an integrator and arrays over n cells, beginning with the states, that
returns derivatives by the walker and by the states."""


def pull_in_batches(
    pull: Pull,
    walker: System,
    integrator: Integrator,
    cells: Sequence[np.ndarray],
    names: Sequence[str],
) -> tuple[Float[np.ndarray, "n numbers"], Float[np.ndarray, "n section"]]:
    """Call a function of derivatives in batches; return those by the numbers, and by the states."""
    n, (x, *_) = len(cells[0]), cells
    by_numbers, by_state = np.empty((n, len(names)), x.dtype), np.empty_like(x)
    for first in range(0, n, PULLED_BACK):
        batch = np.minimum(np.arange(first, first + PULLED_BACK), n - 1)
        by_walker, by_x = pull(walker, integrator, *(one[batch] for one in cells))
        count = min(PULLED_BACK, n - first)
        by_numbers[first : first + count] = values_of(by_walker, names)[:count]
        by_state[first : first + count] = np.asarray(by_x)[:count]
    return by_numbers, by_state


@jax.jit
def pull_strides(
    walker: System,
    integrator: Integrator,
    x: Float[Array, "n section"],
    by_end: Float[Array, "n section"],
    by_time: Float[Array, " n"],
) -> tuple[Any, Float[Array, "n section"]]:
    """Compute derivatives by walker and start, given those by the ends and times of strides."""

    def one(x, by_end, by_time):
        def ends(walker, x):
            made = follow_stride(walker, x, integrator)
            return made.state, made.time

        return pull_back(ends, walker, x, (by_end, by_time))

    return jax.vmap(one)(x, by_end, by_time)


def pull_back(function: Callable, walker: Any, x: Any, change: Any) -> tuple[Any, Any]:
    """Compute derivatives by a walker and a state, given those by a function's results.

    `change` may be a function of the results. Integers of the walker keep their values.
    """
    real, exact = eqx.partition(walker, eqx.is_inexact_array)
    results, pull = jax.vjp(lambda real, x: function(eqx.combine(real, exact), x), real, x)
    by_real, by_x = pull(change(results) if callable(change) else change)
    return eqx.combine(by_real, exact), by_x
