"""Design problems from the arguments of `optimise`, checked."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from walker_jax.basins.computation import check_grid
from walker_jax.basins.refinement import FINEST, check_finest
from walker_jax.basins.windows import default_region, grid_along, whole_section
from walker_jax.checks import WrongUse, check_number, check_whole, short
from walker_jax.design.measures import (
    GAIT_MEASURES,
    GaitFunction,
    cost_is_known,
    measures_known,
)
from walker_jax.design.problem import OBJECTIVES, SIZES, Problem
from walker_jax.design.training import Training
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.model import check_planar


def check_budget(seconds: Any) -> float:
    """Return the time for climbs; refuse a time that is not above zero."""
    if seconds is None:
        return math.inf
    check_number("seconds", seconds)
    if not seconds > 0:
        raise WrongUse(f"seconds must be above 0, not {short(seconds)}", of="seconds")
    return float(seconds)


def further_measures(walker: System, functions: Mapping[str, GaitFunction]) -> dict[str, float]:
    """Return the signs of measures of the user's own, by name, as in `OBJECTIVES`."""
    own = dict.fromkeys(measures_known(walker)[len(GAIT_MEASURES) :], -1.0)
    if taken := sorted({*own} & {*OBJECTIVES, *functions}):
        raise WrongUse(f"objective must have functions of names of their own, not {taken[0]!r}")
    return own | dict.fromkeys(functions, 1.0)


def read_training(steps: Any, rate: Any, batch: Any) -> Training:
    """Return checked settings of an ascent by many parameters."""
    check_whole("steps", steps)
    check_whole("batch", batch)
    check_number("rate", rate)
    if not rate > 0:
        raise WrongUse(f"rate must be above 0, not {short(rate)}", of="rate")
    return Training(steps, float(rate), batch)


def pose_problem(
    walker: System,
    bounds: Mapping[str, tuple[float, float]],
    goal: tuple[dict[str, float], float],
    limits: dict[str, tuple[float, float]],
    how: tuple[Any, ...],
) -> Problem:
    """Return the checked problem; `goal` is the result of `parse_objective`."""
    low, high = np.array([*bounds.values()]).T
    problem = Problem(walker, tuple(bounds), low, high, *goal, limits, *how)
    check_whole("strides", problem.strides)
    check_whole("levels", problem.levels, 0)
    check_whole("seed", problem.seed, 0)
    if {"sensitivity-norm", "fall-action"} & {*problem.weights}:
        check_planar(walker)
    if "cost-of-transport" in problem.measures and not cost_is_known(walker):
        raise WrongUse(
            f"cost-of-transport is unknown for a {type(walker).__name__}: define its motor_work, "
            "or driven_by_gravity if nothing else drives it"
        )
    if ("basin-stability" in problem.weights) != callable(problem.density):
        raise WrongUse(
            f"density must be a function of states for basin-stability, and for that alone, not "
            f"{short(problem.density)}"
        )
    return problem


def with_grid(problem: Problem, places: list[Float[np.ndarray, " parameters"]]) -> Problem:
    """Give the problem a checked grid, if it needs one."""
    if problem.grid is None:
        problem = problem._replace(grid=grid_for(problem, places))
    if problem.grid is None:
        if problem.size:
            raise WrongUse(
                "grid is required: no start has a gait of period one to lay it around", of="grid"
            )
        return problem
    check_grid(problem.walker, problem.grid, "direct", kind="optimum")
    axes, needed = len(problem.grid.names), SIZES.get(problem.size)
    if needed is not None and axes != needed:
        raise WrongUse(f"objective {problem.size} must have a grid of {needed} axes, not {axes}")
    check_whole("levels", problem.levels, 0, FINEST)
    check_finest(problem.walker, problem.grid, problem.levels)
    return problem


def grid_for(problem: Problem, places: list[Float[np.ndarray, " parameters"]]) -> Grid | None:
    """Choose a grid: the whole section for a volume, else the first default region of a start."""
    walkers = (problem.walker_at(problem.values(place)) for place in places)
    if problem.size == "volume":
        first = next(walkers)
        axes = whole_section(first)
        if axes is None:
            raise WrongUse(
                f"objective must be area for a {type(first).__name__}, whose section has "
                f"{len(first.section)} coordinates, not volume",
                of="objective",
            )
        return grid_along(axes)
    return next((one for one in map(default_region, walkers) if one is not None), None)
