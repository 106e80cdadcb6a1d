"""A bootstrap over steps: fits to steps drawn with replacement."""

from functools import partial

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.fitting.residuals import Data, Layout, Problem, Unknowns
from walker_jax.fitting.solving import Solved, solve

AT_ONCE = 50
"""Fits in one call, which holds as many copies of all predictions."""


def resample(
    problem: Problem, solved: Solved, data: Data, count: int, seed: int
) -> Float[np.ndarray, "draws parameters"]:
    """Return parameters of fits to resampled steps; NaN where a fit did not converge.

    Each step counts as often as it is drawn. Linked steps are drawn together, by runs.
    """
    layout, steps = problem.layout, data.steps
    random = np.random.default_rng(seed)
    groups = steps.run if layout.single else np.arange(len(steps.run))
    number = int(groups.max()) + 1
    found = [np.zeros((0, len(layout.names)))]
    for first in range(0, count, AT_ONCE):
        size = min(AT_ONCE, count - first)
        counts = random.multinomial(number, np.full(number, 1 / number), size=size)
        weights = counts[:, groups].astype(float)
        values, converged = solve_weighted(layout, solved.unknowns, data, weights)
        found.append(np.where(np.asarray(converged)[:, None], values, np.nan))
    return np.concatenate(found)


@partial(jax.jit, static_argnums=0)
def solve_weighted(
    layout: Layout, begun: Unknowns, data: Data, weights: Float[Array, "draws steps"]
) -> tuple[Float[Array, "draws parameters"], Bool[Array, " draws"]]:
    """Solve again with other weights of steps, all draws in one call; return the parameters."""
    again = lambda one: solve(layout, begun, data._replace(weights=one))
    found = jax.vmap(again)(weights)
    return found.motion.values, found.converged
