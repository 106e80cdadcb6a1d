"""Measurements of one walker of a problem: objective, gradient, and measures with limits."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.design.area_gradients import AreaSettings, MeasuredArea, differentiate_area
from walker_jax.design.disturbance_gradients import disturbance_gradient
from walker_jax.design.fall_gradients import fall_gradient
from walker_jax.design.measures import Measure, differentiate_measures
from walker_jax.design.problem import SIZES, Problem
from walker_jax.design.sensitivity_gradients import sensitivity_gradient
from walker_jax.design.tolerances import evaluate_over
from walker_jax.gaits.cycles import Gait
from walker_jax.grids import Grid
from walker_jax.stability.rays import DENSE
from walker_jax.systems.system import System
from walker_jax.walkers.choices import MANY
from walker_jax.walkers.model import check_planar, is_planar

STEP_SIZES = (0.1, 0.03, 0.01, 0.003)
"""Step sizes of each stage, in places."""
BAND_HALF_WIDTHS = (0.1, 0.05, 0.03, 0.03)
"""Half widths, in places, of the bands over which derivatives are averaged where there are none.
They are wide enough for the errors of areas at their ends."""
LEVELS_OMITTED = (3, 2, 1, 1)
"""Levels of refinement omitted in each stage; areas at the ends have all."""
BAND_LEVELS_OMITTED = 1
"""Levels omitted besides at the ends of bands. A band is so wide that its derivative is still known
to a few hundredths of the largest one, and takes half to a quarter of the time."""
SCAN_LEVELS_OMITTED = 2
"""Levels omitted in the scan, which serves a picture."""
HURRIED_OMITTED = LEVELS_OMITTED[-1]
"""Levels omitted at the ends when the time is over. With fewer starts to correct an area, too, it
takes a few seconds; its standard error says how well it is known."""
HOW_MEASURED = tuple(zip(LEVELS_OMITTED, BAND_HALF_WIDTHS, strict=True))
"""Settings on which the measurements of each stage depend, beside the parameters."""
SCAN_STAGE, ENDS_STAGE, HURRIED_ENDS_STAGE = -1, -2, -3
"""Stage numbers of the scan for a picture, and of both ends: exactly, or when the time is over."""
CHECK_STARTS = 50_000, 500_000
"""Starts that correct an area during optimisation, and at the ends."""
CHECK_STARTS_IN_SPACE = 5_000, 50_000
"""The same for walkers in space, whose strides take eleven times as long (benchmarks/space.py). The
errors of areas show the loss of accuracy."""
AREA_TOLERANCE = 1e-7
"""Tolerance of strides for areas during optimisation. In the basins of nine walkers it changes the
fates of 19 cells, at one fractal boundary, where 1e-9 does too (benchmarks/area_tolerance.py)."""
DIRECTIONS = DENSE // 8, DENSE
"""Search directions for the least disturbance during optimisation, and at the ends. An eighth of
them finds it to 1e-3 or better, except at fractal boundaries."""
BY_THEMSELVES = (*SIZES, "sensitivity-norm", "least-disturbance", "fall-action")
"""Measures that are no functions of a gait."""


class Evaluation(NamedTuple):
    """Measurements of one walker."""

    run: int
    stage: int
    parameters: Float[np.ndarray, " parameters"]
    value: float
    """Value of the objective; NaN if unknown."""
    value_error: float
    gradient: Float[np.ndarray, " parameters"]
    """Derivatives of the objective by the parameters."""
    gradient_error: Float[np.ndarray, " parameters"]
    measures: Float[np.ndarray, " measures"]
    strides: int
    """Strides made for areas or volumes."""

    @property
    def has_gradient(self) -> bool:
        """Return whether the gradient was measured too; its error is then not NaN."""
        return not np.isnan(self.gradient_error).all()


def evaluate_objective(
    problem: Problem,
    stage: int,
    values: Float[np.ndarray, " parameters"],
    gait_of: Callable[[Float[np.ndarray, " parameters"]], Gait],
    measure_area: Callable[[AreaSettings, System], MeasuredArea],
    *,
    value_only: bool = False,
) -> Evaluation:
    """Measure the objective, the limited measures and, in a stage, the objective's gradient.

    With `value_only` there is no gradient. `gait_of` and `measure_area` may know their results.
    """
    if problem.over is not None:
        return evaluate_over(evaluate_objective, problem, stage, values, value_only)
    names = problem.names if stage >= 0 and not value_only else ()
    walker = problem.walker_at(values)
    bands = BAND_HALF_WIDTHS[max(stage, 0)] * problem.scale[: len(names)]
    if problem.free.any() or len(names) >= MANY:
        bands = None
    found: dict[str, Measure] = {}
    value_error, gradient_error, made = 0.0, np.zeros(len(names)), 0
    exact = stage == ENDS_STAGE
    if problem.size and problem.grid is not None:
        how = area_settings(problem, problem.grid, stage)
        at_band_ends = how._replace(levels=max(0, how.levels - BAND_LEVELS_OMITTED))
        area = differentiate_area(measure_area(how, walker), names, bands, at_band_ends)
        found[problem.size], made = area, area.strides
        weight = abs(problem.weights[problem.size])
        value_error, gradient_error = weight * area.value_error, weight * area.gradient_error
    if set(problem.measures) - {problem.size}:
        gait = gait_of(values)
        others = [name for name in problem.measures if name not in BY_THEMSELVES]
        how = others, problem.functions, problem.tolerance
        found |= differentiate_measures(walker, names, gait, *how)
        if "sensitivity-norm" in problem.weights:
            found["sensitivity-norm"] = sensitivity_gradient(
                check_planar(walker), names, gait, tolerance=problem.tolerance
            )
        if "least-disturbance" in problem.weights:
            found["least-disturbance"] = Measure(0.0, np.zeros(len(names)))
            if gait.found and gait.stable:
                found["least-disturbance"] = evaluate_disturbance(
                    problem, walker, names, gait, bands, DIRECTIONS[exact]
                )
        if "fall-action" in problem.weights:
            found["fall-action"] = Measure(0.0, np.zeros(len(names)))
            if gait.found and gait.stable:
                found["fall-action"] = evaluate_fall(problem, walker, names, gait)
    weighted = [(weight, found[name]) for name, weight in problem.weights.items()]
    gradient = np.sum([weight * one.gradient for weight, one in weighted], axis=0)
    none = np.full(len(problem.names), np.nan)
    return Evaluation(
        run=-1,
        stage=stage,
        parameters=values,
        value=float(sum(weight * one.value for weight, one in weighted)),
        value_error=value_error,
        gradient=gradient if names else none,
        gradient_error=gradient_error if names else none,
        measures=np.array([found[name].value for name in problem.measures]),
        strides=made,
    )


def area_settings(problem: Problem, grid: Grid, stage: int) -> AreaSettings:
    """Return how areas are measured in a stage, in the scan or at the ends."""
    exact = stage == ENDS_STAGE
    others = {SCAN_STAGE: SCAN_LEVELS_OMITTED, ENDS_STAGE: 0, HURRIED_ENDS_STAGE: HURRIED_OMITTED}
    omitted = others[stage] if stage < 0 else LEVELS_OMITTED[stage]
    return AreaSettings(
        grid=grid,
        levels=max(0, problem.levels - omitted),
        strides=problem.strides,
        check=check_starts(problem.walker, exact),
        seed=problem.seed,
        tolerance=problem.tolerance if exact or problem.tolerance else AREA_TOLERANCE,
        density=problem.density,
    )


def check_starts(walker: System, exact: bool) -> int:
    """Return how many starts correct an area: more at the ends, where it is to be `exact`."""
    return (CHECK_STARTS if is_planar(walker) else CHECK_STARTS_IN_SPACE)[exact]


def evaluate_disturbance(
    problem: Problem,
    walker: System,
    names: tuple[str, ...],
    gait: Gait,
    bands: Float[np.ndarray, " bands"] | None,
    directions: int,
) -> Measure:
    """Measure the least disturbance and its gradient; NaN if the search for it fails."""
    options: Any = {"strides": problem.strides, "tolerance": problem.tolerance}
    options |= {"bands": bands, "directions": directions}
    try:
        return disturbance_gradient(walker, names, gait, **options)
    except (WrongUse, ComputationFailed, np.linalg.LinAlgError):
        # The walker returns from everywhere, or the gait is lost to rounding.
        return Measure(np.nan, np.full(len(names), np.nan))


def evaluate_fall(problem: Problem, walker: System, names: tuple[str, ...], gait: Gait) -> Measure:
    """Measure the action of the most probable fall and its gradient; NaN if the search fails."""
    try:
        return fall_gradient(check_planar(walker), names, gait, tolerance=problem.tolerance)
    except (WrongUse, ComputationFailed, np.linalg.LinAlgError):
        return Measure(np.nan, np.full(len(names), np.nan))
