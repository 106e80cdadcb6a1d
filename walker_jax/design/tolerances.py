"""Objectives over walkers whose parameters are uncertain: their mean, or that of the worst walker.

Parameters are drawn once, as changes that are added to every design (common random numbers), so
that designs are compared on the same draws, and the objective has a gradient.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.basins.attracting_gaits import gait_of_grid
from walker_jax.checks import WrongUse, check_whole, is_number, short
from walker_jax.fitting.results import Fit
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, value_of, with_values


class Tolerances(NamedTuple):
    """Changes of parameters, drawn once."""

    names: tuple[str, ...]
    changes: Float[np.ndarray, "draws names"]
    worst: bool
    """Whether the worst draw counts, rather than the mean of all."""


def draw_tolerances(
    walker: System, over: Fit | Mapping[str, float] | None, draws: int, worst: bool, seed: int
) -> Tolerances | None:
    """Draw changes from the errors of a fit, or from normal tolerances by their deviations."""
    if over is None:
        return None
    check_whole("draws", draws)
    if isinstance(over, Fit):
        names = tuple(over.parameters)
        changes = over.sample(draws, seed) - np.array([*over.parameters.values()])
    else:
        if not isinstance(over, Mapping) or not over or not all(map(is_number, over.values())):
            raise WrongUse(f"over must be a Fit, or deviations by parameter, not {short(over)}")
        names = tuple(over)
        deviations = np.array([*over.values()], float)
        changes = deviations * np.random.default_rng(seed).normal(size=(draws, len(names)))
    for name in names:
        check_parameter(walker, name)
    return Tolerances(names, changes, worst)


def evaluate_over(
    evaluate: Callable[..., Any], problem: Any, stage: int, values: Any, value_only: bool
) -> Any:
    """Evaluate the objective of each drawn walker, and return the mean, or the worst of them.

    `evaluate` is `evaluate_objective`. Errors of values are independent between draws.
    """
    over: Tolerances = problem.over
    rows = []
    for change in over.changes:
        moved = dict(zip(over.names, change.tolist(), strict=True))
        own = {name: float(value_of(problem.walker, name)) + by for name, by in moved.items()}
        one = problem._replace(walker=with_values(problem.walker, own), over=None)
        at = values + np.array([moved.get(name, 0.0) for name in problem.names])
        measure: Any = lambda how, walker: how.measure(walker)
        gait = partial(gait_with_most_starts, one)
        rows.append(evaluate(one, stage, at, gait, measure, value_only=value_only))
    strides = sum(row.strides for row in rows)
    if over.worst:
        heights = [problem.sign * row.value for row in rows]
        return rows[int(np.argmin(heights))]._replace(parameters=values, strides=strides)
    mean = lambda name: np.mean([getattr(row, name) for row in rows], axis=0)
    error = lambda name: np.linalg.norm([getattr(row, name) for row in rows], axis=0) / len(rows)
    return rows[0]._replace(
        parameters=values,
        value=float(mean("value")),
        value_error=float(error("value_error")),
        gradient=mean("gradient"),
        gradient_error=error("gradient_error"),
        measures=mean("measures"),
        strides=strides,
    )


def gait_with_most_starts(problem: Any, values: Float[np.ndarray, " parameters"]) -> Gait:
    """Return the gait with the largest basin in the grid, or of a search if none attracts there."""
    walker, found = problem.walker_at(values), None
    if problem.grid is not None:
        found = gait_of_grid(walker, problem.grid, problem.strides, problem.tolerance)
    return search_gait(walker, tolerance=problem.tolerance) if found is None else found
