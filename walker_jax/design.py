"""Walkers designed by gradient: the best values of any of their parameters.

A parameter's place is where it is between its bounds, from 0 to 1. From each of several starts Adam
(optax) climbs the gradient of an objective by long steps, with areas on coarse grids; the best of
these climbs goes on by ever shorter steps on finer grids. A step that leads no higher is not made,
but shorter ones are tried. Steps end between the bounds, and where they break a limit go back, by
Newton's iteration along its gradient, to what that allows. Both ends are measured once more, areas
on a grid finer than any before.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from importlib.metadata import version
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.basin import basin, check_grid
from walker_jax.cells import Grid
from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_kind,
    check_whole,
    is_number,
    refuses_tracers,
)
from walker_jax.gaits import Gait, check_parameter, find_gait, with_parameter
from walker_jax.objectives import (
    GAIT_MEASURES,
    Measure,
    area_gradient,
    disturbance_gradient,
    gait_measures,
)
from walker_jax.progress import console
from walker_jax.refinement import BYTES_PER_CELL, FINEST, finer, refined
from walker_jax.robustness import default_region
from walker_jax.walkers import Walker

OBJECTIVES = {
    "area": 1.0,
    "least-disturbance": 1.0,
    "speed": 1.0,
    "step-length": 1.0,
    "spectral-radius": -1.0,
    "cost-of-transport": -1.0,
}
"""What a walker can be designed for: 1 where more of it is better, -1 where less is."""
STEPS = (0.1, 0.03, 0.01, 0.003)
"""Lengths of the steps of each stage, in places."""
BANDS = (0.1, 0.05, 0.03, 0.03)
"""Half widths, in places, of the bands over which derivatives are averaged where there are none.
They are wide enough for the errors of areas at their ends."""
COARSER = (3, 2, 1, 1)
"""By how many levels areas are less refined in each stage than at the ends."""
SCAN, ENDS = -1, -2
"""In place of a stage: for what is measured for a picture, and at the ends."""
TRIES = (1.0, -1.0, 0.5, -0.5, 0.25, -0.25)
"""Shares of a step, until one leads higher; if none does, the stage ends. Some objectives fall by
jumps: where one does just ahead, a shorter step leads higher, or one back."""
MOST = 40
"""Steps of a stage."""
RESCUES = 8
"""Long steps that are made, from where nothing walks, to where the gait is more stable."""
NEWTON = 20
"""Steps back to what constraints allow."""
MET, BINDING = 1e-9, 1e-6
"""By how much, relatively, a limit may be missed, and kept where it holds an optimum."""
SURE = 2
"""Standard errors from which on a difference of values is believed."""
CHECK = 50_000, 500_000
"""Starts that correct an area on the way, and at the ends."""
ATTRACTED = -1
"""In the place of a fate, in those basins: the walker comes to an attractor."""
VIEW = 300
"""Cells along each axis in which the basins at both ends are shown."""


class Problem(NamedTuple):
    """What is to be optimised."""

    walker: Walker
    names: tuple[str, ...]
    """Of the parameters that are free."""
    low: Float[np.ndarray, " parameters"]
    high: Float[np.ndarray, " parameters"]
    weights: dict[str, float]
    """Of the measures in the objective."""
    sign: float
    """Whether that is to be large, 1, or small, -1."""
    limits: dict[str, tuple[float, float]]
    """The least and the greatest value allowed of measures of the gait."""
    grid: Grid | None
    levels: int
    strides: int
    seed: int
    tolerance: float | None

    @property
    def measures(self) -> tuple[str, ...]:
        """What the objective is made of, and what has limits."""
        return tuple(dict.fromkeys([*self.weights, *self.limits]))

    def values(self, place: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Parameters at a place; not rounded where they are at a bound."""
        inner = self.low + (self.high - self.low) * place
        return np.where(place == 0, self.low, np.where(place == 1, self.high, inner))

    def place(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        return (values - self.low) / (self.high - self.low)

    def built(self, values: Float[np.ndarray, " parameters"]) -> Walker:
        walker = self.walker
        for name, value in zip(self.names, values, strict=True):
            walker = with_parameter(walker, name, jnp.asarray(float(value)))
        return walker

    def refusal(self, values: Float[np.ndarray, " parameters"]) -> str:
        """What the walker's constructor says against these parameters together, if anything."""
        try:
            check_parameter(self.built(values), self.names[0], float(values[0]))
        except ValueError as error:
            return str(error)
        return ""

    def named(self, values: Float[np.ndarray, " parameters"]) -> str:
        pairs = zip(self.names, values, strict=True)
        return ", ".join(f"{name} {value:.6g}" for name, value in pairs)


class Row(NamedTuple):
    """What was measured of one walker."""

    run: int
    stage: int
    parameters: Float[np.ndarray, " parameters"]
    value: float
    """Of the objective; NaN where there is none."""
    value_error: float
    gradient: Float[np.ndarray, " parameters"]
    """By the parameters."""
    gradient_error: Float[np.ndarray, " parameters"]
    measures: Float[np.ndarray, " measures"]
    strides: int
    """That were made for areas."""


class Climb(NamedTuple):
    """From where to where; or why not."""

    start: Row | None
    best: Row | None
    converged: bool
    note: str = ""


@refuses_tracers()
def optimise(
    walker: Walker,
    bounds: Mapping[str, Any],
    objective: str | Mapping[str, Any] = "area",
    *,
    at_least: Mapping[str, Any] | None = None,
    at_most: Mapping[str, Any] | None = None,
    grid: Grid | None = None,
    starts: int = 3,
    levels: int = 4,
    strides: int = 200,
    scan: int = 0,
    seed: int = 0,
    tolerance: float | None = None,
    known: xr.Dataset | None = None,
    keep: Callable[[xr.Dataset], object] | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """The best values of a walker's parameters, within bounds.

    **Arguments:**

    - `walker`: of one kind. Its own values are the first start, where they are within the bounds.
    - `bounds`: the least and the greatest value of each parameter that is free.
    - `objective`: "area" (of the basin, all attractors together), "least-disturbance" (from which
      the walker does not come back), "speed" or "step-length" to be large, "spectral-radius" or
      "cost-of-transport" to be small; or weights of these by name, for a sum that is to be large.
    - `at_least`, `at_most`: limits of "speed", "step-length", "spectral-radius" and
      "cost-of-transport", by name.
    - `grid`: where the area is measured, the same for all parameters. By default as in
      `robustness`: of walkers with mass on their legs, the slice around the gait of the first start
      that has one. The slice stays where it is as gaits move away, so areas in it compare walkers
      whose gaits have about the same phidot.
    - `starts`: how many. Those after the first are spread over the bounds.
    - `levels`: of refinement, for the areas at both ends.
    - `strides`: how many of them a walker is followed for.
    - `scan`: if above 0, at so many values of each parameter, others as in the optimum, the
      objective is measured too.
    - `seed`: of the starts, and of `refine`.
    - `tolerance`: of the integration, as in `stride`.
    - `known`: an earlier result, or the trace of a run that was interrupted, whose measurements are
      taken as they are.
    - `keep`: called with the trace after each measurement.
    - `progress`: whether to show on a terminal what is being measured.

    **Returns** a data set: over the parameters, `start` and `optimum`, those of the best climb;
    `objective_start` and `objective_optimum`, as this saw them; `exact_start` and `exact_optimum`,
    with standard errors `exact_start_error` and `exact_optimum_error`, which are 0 but of areas;
    `at_bound`, -1 or 1 for parameters that end at their lower or upper bound; `binding`, which
    measures hold the optimum by their limits; and `converged`, whether it ended because no step
    of the last stage, of those tried along the gradient, led higher. The trace, over evaluations:
    `run`, `stage` (-1 for the scan, -2 for the ends), `parameters`, `value` and `value_error`,
    `gradient` and `gradient_error` (by the parameters), `measures`, and the `strides` that were
    made for areas; `note`, for each run, says why it led nowhere. `scan_parameters`, `scan_value`
    and `scan_allowed`, by the limits. `fate_start` and `fate_optimum`: the basins at both ends, on
    a grid that shows them; -1 where a walker comes to an attractor. Where `found` is false no start
    led anywhere, and all but the trace is missing.

    Where nothing walks, areas and disturbances are zero and have no gradient: a start there is led,
    by up to eight long steps, to where its gait is more stable, if it has one.

    `ValueError` for parameters, bounds, names and numbers that are not such, and as for `refine`.
    """
    (weights, sign), limits = weights_of(objective), limits_of(at_least, at_most)
    check_kind("walker", walker, Walker)
    check_kind("bounds", bounds, Mapping)
    if known is not None:
        check_kind("known", known, xr.Dataset)
    if not bounds:
        raise WrongUse(f"bounds must name at least one parameter, not {dict(bounds)}")
    for name, ends in bounds.items():
        check_bounds(walker, name, ends)
    for name, value, least in (
        *(("starts", starts, 1), ("strides", strides, 1)),
        *(("levels", levels, 0), ("scan", scan, 0), ("seed", seed, 0)),
    ):
        check_whole(name, value, least)
    if "cost-of-transport" in {*weights, *limits} and not walker.driven_by_gravity():
        raise WrongUse(
            f"cost-of-transport is not known of a {type(walker).__name__}, which more than gravity "
            "may drive (driven_by_gravity)"
        )
    low, high = np.array([tuple(map(float, ends)) for ends in bounds.values()]).T
    how = (grid, levels, strides, seed, tolerance)
    problem = Problem(walker, tuple(bounds), low, high, weights, sign, limits, *how)
    places = starting_places(problem, starts)
    if grid is None:
        regions = (default_region(problem.built(problem.values(place))) for place in places)
        problem = problem._replace(grid=next((one for one in regions if one is not None), None))
    if problem.grid is None and "area" in weights:
        raise WrongUse("grid is wanted: no start has a gait of period one to lay it around")
    if problem.grid is not None:
        check_grid(walker, problem.grid, "direct")
        check_whole("levels", levels, 0, FINEST)
        check_grid(walker, finer(problem.grid, levels), "direct", each=BYTES_PER_CELL)

    trace = Trace(problem, known, keep, progress)
    first = [climb(trace, run, 0, place) for run, place in enumerate(places)]
    height = lambda one: -np.inf if one.best is None else sign * one.best.value
    run = max(range(starts), key=lambda i: height(first[i]))
    last, notes = first[run], {"note": ("start_number", strings(one.note for one in first))}
    for stage in range(1, len(STEPS)):
        if last.best is not None:
            further = climb(trace, run, stage, problem.place(last.best.parameters))
            # what walked on a coarse grid alone is still the best that is known
            last = further if further.best is not None else last._replace(converged=False)
    start, best = first[run].start, last.best
    if start is None or best is None:
        return trace.data().assign(notes | {"found": False})
    found = both_ends(trace, start, best) | {"converged": last.converged}
    found |= scanned(trace, best, scan) if scan else {}
    found |= {} if problem.grid is None else compared(problem, start, best)
    return trace.data().assign(notes | found | {"found": True})


def weights_of(objective: str | Mapping[str, Any]) -> tuple[dict[str, float], float]:
    """The weights of an objective, checked, and whether it is to be large, 1, or small, -1."""
    named = isinstance(objective, str)
    if not named:
        check_kind("objective", objective, Mapping)
    given = {objective: 1.0} if named else dict(objective)
    if not given:
        raise WrongUse("objective must name at least one measure, not none")
    for name, weight in given.items():
        if name not in OBJECTIVES:
            raise WrongUse(f"objective must be one of {', '.join(OBJECTIVES)}, not {name!r}")
        if not (is_number(weight) and np.isfinite(weight) and weight != 0):
            raise WrongUse(f"objective must give {name} a weight other than 0, not {weight}")
    weights = {name: float(weight) for name, weight in given.items()}
    return weights, OBJECTIVES[objective] if named else 1.0


def limits_of(
    at_least: Mapping[str, Any] | None, at_most: Mapping[str, Any] | None
) -> dict[str, tuple[float, float]]:
    """The least and the greatest value of each measure that has limits, checked."""
    limits: dict[str, tuple[float, float]] = {}
    for side, given in enumerate((at_least, at_most)):
        given = {} if given is None else given
        check_kind("limits", given, Mapping)
        for name, value in given.items():
            if name not in GAIT_MEASURES:
                known = ", ".join(GAIT_MEASURES)
                raise WrongUse(f"limits must be those of one of {known}, not of {name!r}")
            if not (is_number(value) and np.isfinite(value)):
                raise WrongUse(f"limits of {name} must be finite numbers, not {value!r}")
            pair = list(limits.get(name, (-np.inf, np.inf)))
            pair[side] = float(value)
            limits[name] = pair[0], pair[1]
    for name, (low, high) in limits.items():
        if low > high:
            raise WrongUse(f"limits of {name} must be the lower first, not {low:g} and {high:g}")
    return limits


def check_bounds(walker: Walker, name: str, ends: Any) -> None:
    """Refuse bounds that are not two numbers that the walker may have, the lower one first."""
    try:
        low, high = map(float, ends)
    except (TypeError, ValueError):
        raise WrongUse(f"bounds of {name} must be two numbers, not {ends!r}") from None
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise WrongUse(f"bounds of {name} must be finite, the lower first, not {low:g}:{high:g}")
    check_parameter(walker, name, low, high)


def starting_places(problem: Problem, starts: int) -> list[Float[np.ndarray, " parameters"]]:
    """The walker's own place, if it is within the bounds, and others spread over these."""
    own = problem.place(np.array([float(getattr(problem.walker, name)) for name in problem.names]))
    first = [own] if np.all((own >= 0) & (own <= 1)) else []
    from scipy.stats import qmc

    sampler = qmc.LatinHypercube(len(own), rng=np.random.default_rng(problem.seed))
    return [*first, *sampler.random(starts - len(first))]


class Trace:
    """What has been measured so far."""

    def __init__(
        self,
        problem: Problem,
        known: xr.Dataset | None,
        keep: Callable[[xr.Dataset], object] | None,
        progress: bool,
    ):
        self.problem, self.keep = problem, keep
        self.rows: list[Row] = []
        if known is not None:
            check_known(problem, known)
        self.known = {} if known is None else {key(row): row for row in rows_of(known)}
        self.gaits: dict[bytes, Gait] = {}
        self.slacks: dict[bytes, list[Slack]] = {}
        self.console = console(progress)

    def gait(self, values: Float[np.ndarray, " parameters"]) -> Gait:
        """That of the walker with these parameters."""
        if values.tobytes() not in self.gaits:
            walker, tolerance = self.problem.built(values), self.problem.tolerance
            self.gaits[values.tobytes()] = find_gait(walker, tolerance=tolerance)
        return self.gaits[values.tobytes()]

    def measure(self, run: int, stage: int, place: Float[np.ndarray, " parameters"]) -> Row:
        """Measure the walker at a place, unless that is known."""
        values = self.problem.values(place)
        row = self.known.get((stage, values.tobytes()))
        if row is None:
            status = self.console.status(f"{len(self.rows) + 1}: {self.problem.named(values)}")
            with nullcontext() if self.console.quiet else status:
                row = measured(self.problem, stage, values, self.gait)
            self.known[key(row)] = row
            self.rows.append(row._replace(run=run))
            if self.keep is not None:
                visited = {key(one) for one in self.rows}
                left = [one for place, one in self.known.items() if place not in visited]
                self.keep(self.data([*self.rows, *left]))
        else:
            self.rows.append(row._replace(run=run))
        return self.rows[-1]

    def data(self, rows: list[Row] | None = None) -> xr.Dataset:
        """The measurements, as `optimise` returns them."""
        rows = self.rows if rows is None else rows
        problem, count = self.problem, len(rows)
        dims = dict.fromkeys(("parameters", "gradient", "gradient_error"), "parameter")
        dims |= {"measures": "measure"}
        coords = {"parameter": strings(problem.names), "measure": strings(problem.measures)}
        data = xr.Dataset(coords=coords, attrs=description(problem))
        for name in Row._fields:
            own = [dims[name]] if name in dims else []
            shape = [count, *(len(coords[dim]) for dim in own)]
            column = np.array([getattr(row, name) for row in rows]).reshape(shape)
            data[name] = ["evaluation", *own], column
        return data


def strings(values: Iterable[str]) -> np.ndarray:
    """An array of them, of a type that has a place in a store."""
    return np.array(list(values), dtype=object)


def key(row: Row) -> tuple[int, bytes]:
    """By which a measurement is found again."""
    return int(row.stage), row.parameters.tobytes()


def rows_of(data: xr.Dataset) -> list[Row]:
    """The measurements in a data set."""
    return [Row(*row) for row in zip(*(data[name].values for name in Row._fields), strict=True)]


def check_known(problem: Problem, known: xr.Dataset) -> None:
    """Refuse measurements that were made for something else."""
    for name, value in description(problem).items():
        own = name.startswith("walker_") and name.removeprefix("walker_") in problem.names
        if not own and name != "version" and known.attrs.get(name) != value:
            raise WrongUse(
                f"known must be of the same {name}, {value!r}, not {known.attrs.get(name)!r}"
            )


def description(problem: Problem) -> dict:
    """What was asked for, as attributes of a data set."""
    bounds = zip(problem.names, problem.low.tolist(), problem.high.tolist(), strict=True)
    limits = {
        name: [end if np.isfinite(end) else None for end in ends]
        for name, ends in problem.limits.items()
    }
    return {
        "walker": type(problem.walker).__name__,
        **{f"walker_{name}": float(value) for name, value in vars(problem.walker).items()},
        "section": list(problem.walker.section),
        "objective": json.dumps(problem.weights),
        "sign": problem.sign,
        "bounds": json.dumps({name: ends for name, *ends in bounds}),
        "limits": json.dumps(limits),
        "region": json.dumps({} if problem.grid is None else problem.grid.box),
        "levels": problem.levels,
        "strides_followed": problem.strides,
        "seed": problem.seed,
        "tolerance": problem.tolerance or 0.0,
        "version": f"walker-jax {version('walker-jax')}",
    }


def measured(
    problem: Problem,
    stage: int,
    values: Float[np.ndarray, " parameters"],
    gait_of: Callable[[Float[np.ndarray, " parameters"]], Gait],
) -> Row:
    """Measure the objective, what has limits, and in a stage, the objective's gradient."""
    walker, names = problem.built(values), problem.names if stage >= 0 else ()
    bands = BANDS[max(stage, 0)] * (problem.high - problem.low)[: len(names)]
    found: dict[str, Measure] = {}
    value_error, gradient_error, made = 0.0, np.zeros(len(names)), 0
    if "area" in problem.weights and problem.grid is not None:
        area = area_gradient(
            walker,
            problem.grid,
            names,
            bands=bands,
            levels=max(0, problem.levels - (0 if stage == ENDS else COARSER[stage])),
            strides=problem.strides,
            check=CHECK[stage == ENDS],
            seed=problem.seed,
            tolerance=problem.tolerance,
        )
        found["area"], made = Measure(area.area, area.gradient), area.strides
        weight = abs(problem.weights["area"])
        value_error, gradient_error = weight * area.area_error, weight * area.error
    if set(problem.measures) - {"area"}:
        gait = gait_of(values)
        found |= gait_measures(walker, names, gait, tolerance=problem.tolerance)
        if "least-disturbance" in problem.weights:
            found["least-disturbance"] = Measure(0.0, np.zeros(len(names)))
            if gait.found and gait.stable:
                found["least-disturbance"] = least_disturbed(problem, walker, names, gait, bands)
    weighted = [(weight, found[name]) for name, weight in problem.weights.items()]
    gradient = np.sum([weight * one.gradient for weight, one in weighted], axis=0)
    none = np.full(len(problem.names), np.nan)
    return Row(
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


def least_disturbed(
    problem: Problem,
    walker: Walker,
    names: tuple[str, ...],
    gait: Gait,
    bands: Float[np.ndarray, " bands"],
) -> Measure:
    """The least disturbance and its gradient; NaN where the search for it fails."""
    options = {"strides": problem.strides, "tolerance": problem.tolerance}
    try:
        least = disturbance_gradient(walker, names, gait, bands=bands, **options)
    except (WrongUse, ComputationFailed, np.linalg.LinAlgError):
        # The walker returns from everywhere, or the gait is lost to rounding.
        return Measure(np.nan, np.full(len(names), np.nan))
    return Measure(least.size, least.gradient)


def climb(trace: Trace, run: int, stage: int, place: Float[np.ndarray, " parameters"]) -> Climb:
    """Go up from a place by the steps of one stage, until none leads higher."""
    import optax  # here alone: it takes a quarter of a second

    problem, begin = trace.problem, allowed(trace, place)
    if begin is None:
        return Climb(None, None, False, why_nowhere(trace, place))
    start = trace.measure(run, stage, begin)
    here = start if walks(problem, start) else None
    if here is None and stage == 0:
        here = rescued(trace, run, start)
    if here is None:
        return Climb(start, None, False, why_nowhere(trace, begin))
    optimiser = optax.adam(STEPS[stage], b1=0.5, b2=0.9, eps=1e-12)
    standard = lambda: jax.numpy_dtype_promotion("standard")  # as optax's own arithmetic needs
    with standard():
        state = optimiser.init(jnp.asarray(begin))
    best = here
    for _ in range(MOST):
        place = problem.place(best.parameters)
        uphill = problem.sign * best.gradient * (problem.high - problem.low)
        downhill = jnp.asarray(-along_limits(trace, place, uphill))
        with standard():
            update, state = optimiser.update(downhill, state)
        for share in TRIES:
            goal = allowed(trace, np.clip(place + share * np.asarray(update), 0, 1))
            if goal is None:
                continue
            held = share == 1 and np.abs(goal - place).max() < STEPS[stage] / 100
            if held and np.array_equal(goal, place):
                return Climb(start, best, True)
            there = trace.measure(run, stage, goal)
            if walks(problem, there) and leads_up(problem, best, there):
                best = there
                break
            if held:  # by bounds or limits
                return Climb(start, best, True)
        else:
            return Climb(start, best, True)
    return Climb(start, best, False)


def leads_up(problem: Problem, here: Row, there: Row) -> bool:
    """Whether a value is higher; where errors do not tell, whether it is uphill at both ends."""
    gain = problem.sign * (there.value - here.value)
    if np.abs(gain) > SURE * np.hypot(here.value_error, there.value_error):
        return bool(gain > 0)
    step = problem.sign * (there.parameters - here.parameters)
    return bool(here.gradient @ step > 0 and there.gradient @ step > 0)


def walks(problem: Problem, row: Row) -> bool:
    """Whether something walks, where the objective is about that, and shows which way is up."""
    sizes = [
        size
        for name, size in zip(problem.measures, row.measures, strict=True)
        if name in ("area", "least-disturbance")
    ]
    known = np.isfinite(row.value) and np.isfinite(row.gradient).all()
    return bool(known) and (not sizes or any(size > 0 for size in sizes))


def rescued(trace: Trace, run: int, row: Row) -> Row | None:
    """By long steps, from where nothing walks, to where the gait is more stable, until one does."""
    problem = trace.problem
    for _ in range(RESCUES):
        gait = trace.gait(row.parameters)
        walker, tolerance = problem.built(row.parameters), problem.tolerance
        measures = gait_measures(walker, problem.names, gait, tolerance=tolerance)
        growth = measures["spectral-radius"].gradient * (problem.high - problem.low)
        steepest = np.abs(growth).max()
        if not (np.isfinite(steepest) and steepest > 0):
            return None
        place = problem.place(row.parameters) - STEPS[0] * growth / steepest
        goal = allowed(trace, np.clip(place, 0, 1))
        if goal is None:
            return None
        row = trace.measure(run, 0, goal)
        if walks(problem, row):
            return row
    return None


def why_nowhere(trace: Trace, place: Float[np.ndarray, " parameters"]) -> str:
    """Why nothing can be climbed from a place."""
    problem, values = trace.problem, trace.problem.values(place)
    where, refusal = problem.named(values), problem.refusal(values)
    if refusal:
        return f"{where}: {refusal}"
    measures = gait_measures(problem.built(values), (), trace.gait(values))
    radius = measures["spectral-radius"].value
    if np.isnan(radius):
        return f"{where}: no gait is found"
    for name, (low, high) in problem.limits.items():
        value = measures[name].value
        if not low <= value <= high:
            limit = f"at least {low:g}" if value < low else f"at most {high:g}"
            return f"{where}: {name} is {value:.4g}, and no way was found to {limit}"
    return (
        f"{where}: nothing walks, or nothing says which way is up; "
        f"the gait of period one has a multiplier of modulus {radius:.4g}"
    )


class Slack(NamedTuple):
    """By how much a limit is kept, relatively, and how that changes with the place."""

    name: str
    value: float
    gradient: Float[np.ndarray, " parameters"]


def slacks(trace: Trace, place: Float[np.ndarray, " parameters"]) -> list[Slack]:
    """Those of all limits; NaN where there is no gait."""
    problem, values = trace.problem, trace.problem.values(place)
    if not problem.limits:
        return []
    if values.tobytes() in trace.slacks:
        return trace.slacks[values.tobytes()]
    walker, gait = problem.built(values), trace.gait(values)
    measures = gait_measures(walker, problem.names, gait, tolerance=problem.tolerance)
    found = []
    for name, ends in problem.limits.items():
        for limit, side in zip(ends, (1, -1), strict=True):
            if np.isfinite(limit):
                scale = side / (abs(limit) or 1.0)
                value, gradient = measures[name]
                gradient = gradient * (problem.high - problem.low)
                found.append(Slack(name, scale * (value - limit), scale * gradient))
    trace.slacks[values.tobytes()] = found
    return found


def allowed(
    trace: Trace, place: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, " parameters"] | None:
    """The place, or one near it that keeps all limits; none if that is not found."""
    beyond = None
    for _ in range(NEWTON):
        if trace.problem.refusal(trace.problem.values(place)):
            return None
        found = slacks(trace, place)
        broken = [one for one in found if not one.value >= -MET]
        if not broken:
            least = min((one.value for one in found), default=0.0)
            if beyond is None or least < BINDING:
                return place
            return on_limit(trace, place, beyond)  # Newton's step was too long
        beyond, worst = place, min(broken, key=lambda one: one.value)
        held = ((place == 0) & (worst.gradient < 0)) | ((place == 1) & (worst.gradient > 0))
        gradient = np.where(held, 0.0, worst.gradient)
        if not (np.isfinite(worst.value) and np.sum(gradient**2) > 0):
            return None
        place = np.clip(place - worst.value * gradient / np.sum(gradient**2), 0, 1)
    return None


def on_limit(
    trace: Trace,
    within: Float[np.ndarray, " parameters"],
    beyond: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, " parameters"]:
    """Where a limit is reached on the way from a place within it to one beyond."""

    def least(share: float) -> float:
        slack = min(one.value for one in slacks(trace, within + share * (beyond - within)))
        return slack if np.isfinite(slack) else -1.0

    from scipy.optimize import brentq

    share: Any = brentq(least, 0.0, 1.0, xtol=1e-13)
    return within + share * (beyond - within)


def along_limits(
    trace: Trace,
    place: Float[np.ndarray, " parameters"],
    uphill: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, " parameters"]:
    """A direction without what leads out of the bounds, and beyond limits that hold."""
    holding = [one.gradient for one in slacks(trace, place) if one.value < BINDING]
    for _ in range(1 + len(place)):
        free = ~(((place == 0) & (uphill < 0)) | ((place == 1) & (uphill > 0)))
        uphill = np.where(free, uphill, 0.0)
        for gradient in (np.where(free, one, 0.0) for one in holding):
            if uphill @ gradient < 0:
                uphill = uphill - (uphill @ gradient) / np.sum(gradient**2) * gradient
    return uphill


def both_ends(trace: Trace, start: Row, best: Row) -> dict:
    """What `optimise` says of the best climb's start and its end."""
    problem, sides = trace.problem, {"start": start, "optimum": best}
    found: dict = {}
    for name, row in sides.items():
        exact = trace.measure(row.run, ENDS, problem.place(row.parameters))
        found[name] = "parameter", row.parameters
        found[f"objective_{name}"] = row.value
        found[f"exact_{name}"], found[f"exact_{name}_error"] = exact.value, exact.value_error
    place = problem.place(best.parameters)
    side = (place == 1).astype(np.int8) - (place == 0).astype(np.int8)
    binding = {one.name for one in slacks(trace, place) if one.value < BINDING}
    found["at_bound"] = "parameter", side
    found["binding"] = "measure", [name in binding for name in problem.measures]
    return found


def scanned(trace: Trace, best: Row, count: int) -> dict:
    """The objective at values of each parameter, others as in the best row."""
    problem, middle = trace.problem, trace.problem.place(best.parameters)
    places = np.tile(middle, (len(middle), count, 1))
    for k in range(len(middle)):
        places[k, :, k] = np.linspace(0, 1, count)
    rows = [[trace.measure(-1, SCAN, place) for place in line] for line in places]
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


def compared(problem: Problem, start: Row, best: Row) -> dict:
    """The fates of a grid that holds both basins; none over three dimensions."""
    grid = problem.grid
    if grid is None or len(grid.names) != 2:
        return {}
    walkers = [problem.built(row.parameters) for row in (start, best)]
    rough = [
        refined(
            walker,
            grid,
            min(1, problem.levels),
            strides=problem.strides,
            check=CHECK[False],
            seed=problem.seed,
            tolerance=problem.tolerance,
        )
        for walker in walkers
    ]
    cells = np.concatenate([np.argwhere(one.attractor >= 0) for one in rough])
    shape = np.array(rough[0].grid.shape)
    low, high = (cells.min(axis=0), cells.max(axis=0) + 1) if len(cells) else (0 * shape, shape)
    margin = np.maximum(1, (high - low) // 20)
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, shape)
    spacing = np.asarray(rough[0].grid.spacing)
    axes = {
        name: (float(start + first * width), float(start + last * width), VIEW)
        for name, start, first, last, width in zip(
            grid.names, grid.lower, low, high, spacing, strict=True
        )
    }
    view = Grid(axes, grid.shear, grid.origin, grid.fixed)
    fates = {}
    for name, walker in zip(("start", "optimum"), walkers, strict=True):
        data = basin(walker, view, "direct", strides=problem.strides, tolerance=problem.tolerance)
        fate = np.where(data["attractor"] >= 0, ATTRACTED, data["fate"]).astype(np.int8)
        fates[f"fate_{name}"] = tuple(grid.names), fate
    return fates | {name: (name, values) for name, values in view.axes.items()}
