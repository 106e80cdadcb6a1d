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

from walker_jax.design.measures import Measure
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.disturbances import BEYOND
from walker_jax.stability.disturbed_falls import pull_walks
from walker_jax.stability.probable_falls import most_probable_fall
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.choices import Choice, leaves_with, numbers_chosen, values_of
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walking.disturbed import Disturbance
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
    if not names:
        return Measure(fall.action, np.zeros(0))
    x = jnp.asarray(gait.states[0])
    integrator = integrator_of(x.dtype, tolerance).in_dtype(x.dtype)
    same = in_dtype(walker, x.dtype, jnp.asarray)

    def pull(rows: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return derivatives of walks from the gait, by numbers, start and disturbances."""
        start = jnp.stack(same.lift(x))
        given = same, start, rows, change, integrator
        by_walker, by_state, by_rows = pull_walks(*given, leaves=leaves_with(names, same))
        more, by_x = jax.vmap(lambda by: pull_back(lift, same, x, by))(by_state)
        by_numbers = values_of(by_walker, names) + values_of(more, names)
        return by_numbers, *map(np.asarray, (by_x, by_rows))

    lift = lambda walker, x: jnp.stack(walker.lift(x))
    even = np.zeros((max(0, fall.strides + 1 - len(fall.disturbances)), 3))
    rows = np.concatenate([fall.disturbances, even])[: fall.strides + 1]
    tried = BEYOND[:, None, None] * rows
    by_numbers, by_x, by_rows = pull(tried, np.zeros((len(tried), len(x))))
    known = np.isfinite(by_rows).all(axis=(1, 2))
    first = int((known & by_rows.any(axis=(1, 2))).argmax())  # that falls: others have zeros
    by_scale = float(np.sum(by_rows[first] * rows)) or np.nan
    # The gait solves x = S(x, p), so the start changes by dx = (I - S_x)^-1 S_p dp.
    by_p, jacobian, _ = pull(np.zeros((len(x), 1, 3)), np.eye(len(x)))
    of_gait = np.linalg.solve((np.eye(len(x)) - jacobian).T, by_x[first])
    by_all = by_numbers[first] + of_gait @ by_p
    return Measure(fall.action, -2 * fall.action * by_all / by_scale)
