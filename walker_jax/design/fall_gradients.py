"""The action of the most probable fall, and its derivatives by parameters of the walker.

Numbers of strides to a fall jump from walk to walk, and have no derivative. Where falls are rare,
the logarithm of their mean has one: it is the least action of a sequence of disturbances that
topples the walker, over the variance of the disturbances (`stability.probable_falls`).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.design.measures import Measure
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import GaitPull
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.stability.disturbances import BEYOND
from walker_jax.stability.probable_falls import most_probable_fall
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.choices import Choice, numbers_chosen, values_of
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walking.disturbed import (
    Disturbance,
    follow_disturbed,
    follow_disturbed_margins,
)
from walker_jax.walking.pulling import pull_back


def fall_gradient(
    walker: Walker,
    parameters: Choice = ("slope",),
    gait: Gait | None = None,
    *,
    ground: float | Disturbance = 1.0,
    strides: int = 4,
    directions: int = 60,
    tolerance: float | None = None,
) -> Measure:
    """Compute the action of the most probable fall, and its derivatives by parameters.

    The action is half the sum of the squares of the disturbances, in units of their standard
    deviations.

    On ground whose heights have a small standard deviation s, the mean number of strides to a fall
    is about exp(action / s^2), for the default `ground`. On the boundary of the sequences that
    topple the walker the margin m is zero. If all disturbances grow by a factor f, it stays zero as
    a parameter changes for df/dp = -(dm/dp) / (dm/df), and the action grows by its square. The
    least sequence itself changes too, but to second order.

    Arguments and errors are those of `most_probable_fall`.
    """
    names = numbers_chosen(walker, parameters)
    gait = require_gait(walker, ["gait"], tolerance=tolerance) if gait is None else gait
    how: Any = {"strides": strides, "directions": directions, "tolerance": tolerance}
    fall = most_probable_fall(check_planar(walker), ground, gait, **how)
    x = jnp.asarray(gait.states[0])
    integrator = integrator_of(x.dtype, tolerance).in_dtype(x.dtype)
    same = in_dtype(walker, x.dtype, jnp.asarray)
    even = np.zeros((max(0, fall.strides + 1 - len(fall.disturbances)), 3))
    rows = np.concatenate([fall.disturbances, even])[: fall.strides + 1]
    for beyond in BEYOND:
        last = jnp.asarray(fall.states[-1]), jnp.asarray(beyond * rows[-1], x.dtype)
        by_walker, (by_state, by_row) = pull_fall(same, integrator, *last)
        if np.isfinite(np.asarray(by_state)).all():
            break
    by_scale, by_numbers = float(np.asarray(by_row) @ rows[-1]), values_of(by_walker, names)
    for state, row in [*zip(fall.states, rows[:-1], strict=False)][::-1]:
        given = jnp.asarray(state), jnp.asarray(row, x.dtype), by_state
        by_walker, (by_state, by_row) = pull_step(same, integrator, *given)
        by_scale += float(np.asarray(by_row) @ row)
        by_numbers = by_numbers + values_of(by_walker, names)
    lift = lambda walker, x: jnp.stack(walker.lift(x))
    by_walker, by_state = pull_back(lift, same, x, by_state)
    by_numbers = by_numbers + values_of(by_walker, names)
    by_gait = GaitPull(walker, gait, names, tolerance)
    none = np.zeros(len(gait.states)), np.zeros(len(x), complex)
    by_numbers = by_numbers + by_gait.pull(np.asarray(by_state)[None], *none)
    return Measure(fall.action, -2 * fall.action * by_numbers / by_scale)


@jax.jit
def pull_fall(
    walker: Walker, integrator: Integrator, state: Float[Array, " full"], row: Float[Array, " 3"]
) -> tuple[Any, tuple]:
    """Compute derivatives of the margin of a disturbed stride that fails; NaN where it does not."""
    margin = lambda walker, given: (
        follow_disturbed_margins(walker, given[0], Disturbance(*given[1]), integrator).failed
    )
    failing = lambda found: jnp.where(jnp.isnan(found), found, 1)
    return pull_back(margin, walker, (state, row), failing)


@jax.jit
def pull_step(
    walker: Walker,
    integrator: Integrator,
    state: Float[Array, " full"],
    row: Float[Array, " 3"],
    change: Float[Array, " full"],
) -> tuple[Any, tuple]:
    """Compute derivatives by walker, start and disturbance, given those by a stride's end."""
    end = lambda walker, given: (
        follow_disturbed(walker, given[0], Disturbance(*given[1]), integrator).state
    )
    return pull_back(end, walker, (state, row), change)
