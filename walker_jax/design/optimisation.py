"""Design by gradient: the best values of any parameters of a walker.

The place of a parameter is its position between its bounds, from 0 to 1. From each of several
starts, Adam (optax) climbs the gradient of an objective by long steps, with areas on coarse grids.
The best of these climbs continues by ever shorter steps on finer grids. A step that leads no higher
is rejected, and shorter ones are tried; one that leads higher is doubled as long as that leads
higher still. The gradient of an area takes many times as long as the area, so it is measured only
where a step may lead higher. Steps end between the bounds. A step that breaks a limit goes back to
it by Newton's iteration along the limit's gradient. At the end both the start and the optimum are
measured again, with areas on the finest grid.
"""

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import xarray as xr

from walker_jax.basins.computation import basin
from walker_jax.basins.refinement import refine_cells
from walker_jax.basins.windows import default_region
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_whole,
    refuses_tracers,
)
from walker_jax.design.area_gradients import Density
from walker_jax.design.budget import Budget
from walker_jax.design.climbs import Climb, climb
from walker_jax.design.evaluation import (
    ENDS_STAGE,
    HURRIED_ENDS_STAGE,
    SCAN_STAGE,
    STEP_SIZES,
    Evaluation,
    check_starts,
)
from walker_jax.design.measures import (
    GaitFunction,
)
from walker_jax.design.posing import (
    check_budget,
    further_measures,
    pose_problem,
    read_training,
    with_grid,
)
from walker_jax.design.problem import (
    BINDING_SLACK,
    Problem,
    default_levels,
    name_functions,
    parse_limits,
    parse_objective,
    read_bounds,
    starting_places,
)
from walker_jax.design.tolerances import draw_tolerances
from walker_jax.design.trace import Trace, string_array
from walker_jax.design.training import train
from walker_jax.execution.progress import bar
from walker_jax.execution.threads import side_by_side
from walker_jax.fitting.results import Fit
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.choices import MANY, Choice
from walker_jax.walkers.model import is_planar

ATTRACTED = -1
"""Stands for a fate, in `fate_start` and `fate_optimum`, where the walker converges."""
USUAL_MEASUREMENTS = 10
"""Measurements of one climb, to estimate how long an optimisation takes."""
MOST_MEASURED = 10_000
"""Most starts, and values in the scan of a parameter: each takes a second or more."""
VIEW_CELLS = 300
"""Cells along each axis of the basins shown for the start and the optimum."""
VIEW_CELLS_IN_SPACE = HURRIED_VIEW_CELLS = 100
"""The same for walkers in space, whose strides take eleven times as long (benchmarks/space.py): a
ninth of the starts. No more are shown of any walker when the time is over."""


@refuses_tracers()
def optimise(
    walker: System,
    bounds: Mapping[str, Any] | None = None,
    objective: str | GaitFunction | Mapping[Any, Any] = "area",
    *,
    parameters: Choice | None = None,
    at_least: Mapping[Any, Any] | None = None,
    at_most: Mapping[Any, Any] | None = None,
    grid: Grid | None = None,
    starts: int = 3,
    levels: int | None = None,
    strides: int = 200,
    scan: int = 0,
    seed: int = 0,
    tolerance: float | None = None,
    density: Density | None = None,
    over: Fit | Mapping[str, float] | None = None,
    draws: int = 8,
    worst: bool = False,
    steps: int = 100,
    rate: float = 0.01,
    batch: int = 1000,
    known: xr.Dataset | None = None,
    keep: Callable[[xr.Dataset], object] | None = None,
    seconds: float | int | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Find the best values of a walker's parameters within bounds, by gradient ascent.

    ```python
    walker = wj.SpringWalker(slope=0.004, hip_stiffness=1.0)
    found = wj.optimise(walker, {"hip_stiffness": (0, 30)}, "area", seconds=60)
    found["optimum"], found["exact_optimum"]
    ```

    **Arguments:**

    - `walker`: a single walker. Its own values are the first start, if they are within the bounds.
    - `bounds`: lowest and highest value of each free parameter by name; the name of a whole leaf or
      tree gives all its numbers the same.
    - `objective`: its name; a JAX function of a walker and its `Gait` that returns one number to
      maximise; or weights by name, or by function, for a sum to maximise. Maximised are "area" (of
      the basins of all attractors; in a slice for walkers with mass on their legs), "volume" (the
      same in the three dimensions of the section of such walkers), "basin-stability" (the
      probability that starts of a given `density` converge to an attractor), "least-disturbance"
      (from which the walker does not return), "fall-action" (`fall_gradient`, for walkers that last
      on slightly rough ground), "speed" and "step-length". Minimised are "spectral-radius",
      "sensitivity-norm" (`gait_sensitivity`), "cost-of-transport", and the mean over the gait of an
      integral or largest value that the modes name (`integrals`). All have gradients; those of
      areas, volumes and basin stability are integrals along the boundary.
    - `parameters`: further parameters that are free, without bounds: names of numbers, of leaves or
      of trees, or a function of the walker that returns leaves, as for `eqx.tree_at`. They start
      from the walker's own values.
    - `at_least`, `at_most`: limits on "speed", "step-length", "spectral-radius",
      "cost-of-transport", integrals and largest values, by name, and on functions of a gait.
    - `grid`: where the area or volume is measured, the same for all parameters. By default it is
      `basins.windows.whole_section` for volumes, and that of `robustness` for areas: for walkers
      with mass on their legs, the slice around the gait of the first start that has one. The slice
      stays in place as gaits move away, so its areas compare walkers whose gaits have about the
      same phidot.
    - `starts`: number of starts. All but the first are spread over the bounds.
    - `levels`: levels of refinement for the areas or volumes at both ends; by default 4 for areas,
      and 2 for volumes.
    - `strides`: number of strides for which a walker is followed.
    - `scan`: number of values of each parameter, with the others as in the optimum, at which the
      objective is also measured.
    - `seed`: seed of the starts, and of `refine`.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `density`: for basin stability, the density of starts: a function of states of shape
      (n, section) that returns n numbers, the same for all parameters; 0 beyond the grid.
    - `over`: what is uncertain of the walker: a `Fit`, or standard deviations of normal tolerances
      by the names of parameters, free ones among them. The objective is then the mean over as many
      `draws`, the same changes at every design, or with `worst` that of the worst draw.
    - `steps`, `rate`, `batch`: of an ascent by 16 numbers or more. It is one of Adam, of so many
      steps, each of which changes a number by up to about the rate (with bounds, relative to
      these), by so many starts for areas; and both ends are measured roughly, as where the time is
      over.
    - `known`: an earlier result, or the trace of an interrupted run; its measurements are reused.
    - `keep`: called with the trace after each measurement.
    - `seconds`: time of the climbs, compilation included, after which the best walker so far is
      the optimum. A measurement in progress is given up, and none begins that would not fit. The
      budget cannot cut the first value of the objective with its compilation (`first_seconds`).
      A third of the time left after that comes on top, for the ends, on a grid half as fine, a
      scan and the basins shown; what does not fit is left out, and ends then have the values of
      the climb. The run can be continued by `known`.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** a data set. Over the parameters:

    - `start` and `optimum` of the best climb;
    - `at_bound`: -1 or 1 for parameters that end at their lower or upper bound.

    Of the best climb:

    - `objective_start` and `objective_optimum`, as measured during the climb;
    - `exact_start` and `exact_optimum`, with standard errors `exact_start_error` and
      `exact_optimum_error`. These are 0 except for areas, volumes and basin stability, and NaN with
      the least disturbance, for which the search gives an upper bound;
    - `binding`: the measures whose limits bind at the optimum;
    - `converged`: whether it ended because no step of the last stage along the gradient improved
      the objective; `out_of_time`: whether anything was left out because the `seconds` were over;
      with these, `first_seconds`: the time until the first value was known;
    - `note_start` and `note_optimum`: the gait of `find_gait`, if that is another one.

    Over all evaluations, the trace: `run`, `stage` (-1 for the scan, -2 for the ends, -3 for these
    if out of time), `parameters`, `value` and `value_error`, `gradient` and `gradient_error` (by
    the parameters; NaN where a step was rejected by its area alone), `measures`, and the number of
    `strides` made for them. Over the starts, `note`: the reason why a run failed. Of the scan:
    `scan_parameters`, `scan_value` and `scan_allowed` (by the limits). Of both ends: the basins
    `fate_start` and `fate_optimum`, on a grid that shows them; -1 where a walker converges to an
    attractor. If `found` is false, all starts failed, and everything but the trace is missing.

    The measured gait is the one with the largest basin in the grid, of any period; if none attracts
    there, the one that `find_gait` finds.

    Where nothing walks, areas, volumes and disturbances are zero and have no gradient. From such a
    start up to eight long steps lead to a more stable gait, if there is one.

    Raises `ValueError` for wrong parameters, bounds, names and numbers, and as `refine`.
    """
    check_kind("walker", walker, System)
    (goal, *limits), functions = name_functions(objective, at_least, at_most)
    further = further_measures(walker, functions)
    goal, limits = parse_objective(goal, further), parse_limits(limits[0], limits[1], further)
    if known is not None:
        check_kind("known", known, xr.Dataset)
    check_whole("starts", starts, most=MOST_MEASURED)
    check_whole("scan", scan, 0, MOST_MEASURED)
    levels = default_levels(goal[0]) if levels is None else levels
    budget = Budget(check_budget(seconds))
    training = read_training(steps, rate, batch)
    drawn = draw_tolerances(walker, over, draws, worst, seed)
    how = (grid, levels, strides, seed, tolerance, density, functions, drawn)
    problem = pose_problem(walker, read_bounds(walker, bounds, parameters), goal, limits, how)
    if scan and problem.free.any():
        raise WrongUse(f"scan must be 0 without bounds on all parameters, not {scan}")
    places = starting_places(problem, starts)
    problem = with_grid(problem, places)
    many = len(problem.names) >= MANY
    climbs = len(places) + len(STEP_SIZES) - 1
    expected = steps if many else climbs * USUAL_MEASUREMENTS + scan * len(problem.names)
    trace = Trace(problem, known, keep, progress, expected + 2, budget)  # 2 ends
    if many:
        first = [train(trace, places[0], training)]
    else:
        with bar(f"{len(places)} starts", progress):
            climb_from = lambda numbered: climb(trace, numbered[0], 0, numbered[1])
            first = list(side_by_side(climb_from, enumerate(places)))
        trace.sort_runs()
    run, last = (0, first[0]) if many else climb_on(trace, first)
    limited = {} if seconds is None else {"first_seconds": budget.first}
    notes = {"note": ("start_number", string_array(one.note for one in first))}
    start, best = first[run].start, last.best
    if start is None or best is None:
        return trace.data().assign(notes | {"found": False})
    found = finish(trace, start, best, scan, hurried=budget.ran_out or many)
    found |= limited | {"converged": last.converged, "out_of_time": budget.ran_out}
    return trace.data().assign(notes | found | {"found": True})


def climb_on(trace: Trace, first: list[Climb]) -> tuple[int, Climb]:
    """Return the number of the highest climb, and the last climb that continues from its end."""
    sign = trace.problem.sign
    height = lambda one: -np.inf if one.best is None else sign * one.best.value
    run = max(range(len(first)), key=lambda i: height(first[i]))
    last = first[run]
    for stage in range(1, len(STEP_SIZES)):
        if last.best is not None:
            further = climb(trace, run, stage, trace.problem.place_of(last.best.parameters))
            # a walker that walks only on a coarse grid is still the best known
            last = further if further.best is not None else last._replace(converged=False)
    return run, last


def finish(trace: Trace, start: Evaluation, best: Evaluation, scan: int, hurried: bool) -> dict:
    """Measure what follows the climbs, as far as there is time for it; roughly if `hurried`."""
    budget, problem = trace.budget, trace.problem
    budget.extend()
    found = measure_ends(trace, start, best, hurried)
    if scan:
        found |= budget.try_in_time(partial(scan_objective, trace, best, scan)) or {}
    if problem.grid is not None:
        work = partial(compare_basins, problem, start, best, hurried or budget.ran_out)
        # it compiles programs of its own, as the first measurement did
        found |= budget.try_in_time(work, least=budget.first or 0.0) or {}
    return found


def measure_ends(trace: Trace, start: Evaluation, best: Evaluation, hurried: bool) -> dict:
    """Measure the start and the end of the best climb again; roughly if `hurried`.

    Without time for that they have the values of the climb. That is as good if `hurried`, except
    for areas.
    """
    problem, sides = trace.problem, {"start": start, "optimum": best}
    found: dict = {}
    ends = [problem.place_of(row.parameters) for row in sides.values()]
    stage = HURRIED_ENDS_STAGE if hurried else ENDS_STAGE

    def measure() -> list[Evaluation]:
        with closing(trace.measure_each(best.run, stage, ends)) as rows:
            return list(rows)

    exactly = None
    if problem.size or not hurried:
        exactly = trace.budget.try_in_time(measure)
    exactly = [start, best] if exactly is None else exactly
    for (name, row), exact in zip(sides.items(), exactly, strict=True):
        found[name] = "parameter", row.parameters
        found[f"objective_{name}"] = row.value
        found[f"note_{name}"] = np.array(trace.note(row.parameters), object)
        error = np.nan if "least-disturbance" in problem.weights else exact.value_error
        found[f"exact_{name}"], found[f"exact_{name}_error"] = exact.value, error
    place = problem.place_of(best.parameters)
    at_ends = (place < BINDING_SLACK, place > 1 - BINDING_SLACK)  # not equal, because of rounding
    side = at_ends[1].astype(np.int8) - at_ends[0].astype(np.int8)
    binding = trace.limits.binding(place)
    found["at_bound"] = "parameter", side
    found["binding"] = "measure", [name in binding for name in problem.measures]
    return found


def scan_objective(trace: Trace, best: Evaluation, count: int) -> dict:
    """Measure the objective at values of each parameter, with others as in the best row."""
    problem, middle = trace.problem, trace.problem.place_of(best.parameters)
    places = np.tile(middle, (len(middle), count, 1))
    for k in range(len(middle)):
        places[k, :, k] = np.linspace(0, 1, count)
    with closing(trace.measure_each(-1, SCAN_STAGE, places.reshape(-1, len(middle)))) as measured:
        rows = [list(islice(measured, count)) for _ in middle]
    low, high = np.array(
        [problem.limits.get(name, (-np.inf, np.inf)) for name in problem.measures]
    ).T
    keeps = lambda row: bool(np.all((row.measures >= low) & (row.measures <= high)))
    at = [[row.parameters[k] for row in line] for k, line in enumerate(rows)]
    dims = "parameter", "point"
    return {
        "scan_parameters": (dims, at),
        "scan_value": (dims, [[row.value for row in line] for line in rows]),
        "scan_allowed": (dims, [[keeps(row) for row in line] for line in rows]),
    }


def compare_basins(problem: Problem, start: Evaluation, best: Evaluation, hurried: bool) -> dict:
    """Return both basins on one grid; for a volume, in the slice at one of the gaits."""
    grid = problem.grid
    if problem.size == "volume":
        ends = (problem.walker_at(row.parameters) for row in (start, best))
        grid = next((one for one in map(default_region, ends) if one is not None), None)
    if grid is None or len(grid.names) != 2:
        return {}
    walkers = [problem.walker_at(row.parameters) for row in (start, best)]
    refine_roughly = partial(
        refine_cells,
        grid=grid,
        levels=0 if hurried else min(1, problem.levels),
        strides=problem.strides,
        check=check_starts(problem.walker, False),
        seed=problem.seed,
        tolerance=problem.tolerance,
    )
    rough = list(side_by_side(refine_roughly, walkers))
    cells = np.concatenate([np.argwhere(one.attractor >= 0) for one in rough])
    shape = np.array(rough[0].grid.shape)
    low, high = (cells.min(axis=0), cells.max(axis=0) + 1) if len(cells) else (0 * shape, shape)
    margin = np.maximum(1, (high - low) // 20)
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, shape)
    spacing = np.asarray(rough[0].grid.spacing)
    shown_cells = VIEW_CELLS if is_planar(problem.walker) else VIEW_CELLS_IN_SPACE
    shown_cells = min(shown_cells, HURRIED_VIEW_CELLS) if hurried else shown_cells
    axes = {
        name: (float(start + first * width), float(start + last * width), shown_cells)
        for name, start, first, last, width in zip(
            grid.names, grid.lower, low, high, spacing, strict=True
        )
    }
    view = Grid(axes, grid.shear, grid.origin, grid.fixed)
    follow = partial(
        basin, grid=view, method="direct", strides=problem.strides, tolerance=problem.tolerance
    )
    fates = {}
    for name, data in zip(("start", "optimum"), side_by_side(follow, walkers), strict=True):
        fate = np.where(data["attractor"] >= 0, ATTRACTED, data["fate"]).astype(np.int8)
        fates[f"fate_{name}"] = tuple(grid.names), fate
    shown = view.fixed_values if problem.size == "volume" else {}
    return fates | shown | {name: (name, values) for name, values in view.axes.items()}
