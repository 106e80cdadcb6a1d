"""A bootstrap over steps: fits to steps drawn with replacement, all in one call."""

import numpy as np
from jaxtyping import Float

from walker_jax.fitting.residuals import Data, Layout
from walker_jax.fitting.solving import Solved, solve_weighted
from walker_jax.fitting.steps import Steps

AT_ONCE = 50
"""Fits in one call, which holds as many copies of all predictions."""


def resample(
    layout: Layout, solved: Solved, data: Data, steps: Steps, count: int, seed: int
) -> Float[np.ndarray, "draws parameters"]:
    """Return parameters of fits to resampled steps; NaN where a fit did not converge.

    Each step counts as often as it is drawn. Linked steps are drawn together, by runs.
    """
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
