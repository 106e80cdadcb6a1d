"""Basins over any parameters of a walker, each with its gait, area and robustness."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.errors import JaxRuntimeError
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax import storage
from walker_jax.basins.attracting_gaits import compare_with_search, gait_of_basins
from walker_jax.basins.computation import basin, check_grid
from walker_jax.basins.labels import LONGEST_PERIOD
from walker_jax.basins.matching import number_alike
from walker_jax.basins.refinement import FINEST, check_memory_of_starts, refine
from walker_jax.basins.schema import ARRAYS, arrays_to_compute, describe, request_of
from walker_jax.basins.windows import default_region
from walker_jax.checks import WrongUse, check_kind, check_whole, numbers, refuses_tracers, short
from walker_jax.design.measures import differentiate_measures
from walker_jax.execution.pieces import Work, complete_store
from walker_jax.execution.workers import Compute
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import default_tolerance
from walker_jax.stability.gait_robustness import robustness
from walker_jax.stability.robustness_fields import without_gait
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import System, has_gait_region
from walker_jax.walkers.parameters import check_parameter, with_parameter

GAIT_NUMBERS = ("step-length", "speed", "cost-of-transport")
"""Measures of a gait besides its state, multiplier and step time."""
ATTRACTOR_ARRAYS = ("attractor_period", "attractor_states")
"""Arrays kept for the attractors of each basin."""
MOST_ATTRACTORS = 8
"""Attractors of a basin whose states are kept: more than any walker has had so far."""
MAX_COMBINATIONS = 2**20
"""Most combinations of parameters; each takes about twenty files of a store."""


class Measurement(NamedTuple):
    """The measurements that `sweep` is asked to make for every combination."""

    walker: System
    grid: Grid
    names: tuple[str, ...]
    """The parameters that change, in the order of the dimensions."""
    levels: int
    check: int
    robust: bool
    strides: int
    seed: int
    tolerance: float


@refuses_tracers()
def sweep(
    walker: System,
    over: Mapping[str, Sequence[Any] | ArrayLike],
    grid: Grid | None = None,
    *,
    levels: int = 2,
    check: int = 500_000,
    robust: bool = False,
    strides: int = 200,
    seed: int = 0,
    tolerance: float | None = None,
    out: Path | str | None = None,
    request: dict | None = None,
    overwrite: bool = False,
    cluster: Any = None,
    progress: bool = True,
) -> xr.Dataset:
    """Compute the basin, its area and the gait for all combinations of parameter values.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 125))
    wj.sweep(walker, {"slope": [0.004, 0.009]}, grid)["total_area"]
    ```

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `over`: values of each of the parameters.
    - `grid`: grid of all basins; by default that of `robustness` for this walker.
    - `levels`, `check`: refinement of areas, as in `refine`.
    - `robust`: whether to measure all that `robustness` does, half a minute for each combination.
    - `strides`: number of strides for which a walker is followed.
    - `seed`, `tolerance`: seed of random numbers, and tolerance of the integration.
    - `out`, `request`, `overwrite`, `cluster`: as in `basin`; a piece is one combination.
    - `progress`: whether to show a progress bar on a terminal, after a second.

    **Returns** a data set with the parameters as dimensions, in the given order:

    - over the grid too: `fate`, `attractor` and `strides`, as in `basin`, by direct iteration from
      the cells' centres. `attractors` is their number in each basin; each basin numbers its own;
    - for up to `MOST_ATTRACTORS` of these: `attractor_period`, `attractor_states`, and
      `attractor_number`, which is the same for a gait of the same period in neighbouring
      combinations (`basins.matching.number_alike`);
    - `area` of the cells that converge to any attractor; `total_area` and its standard error
      `total_area_error`, as in `refine`; volumes if the grid has three dimensions;
    - for the gait with the largest basin, of any period: `gait_period`, `gait_state`, `multiplier`
      (the largest modulus), `step_time`, `step_length`, `speed` and `cost_of_transport`; if no gait
      attracts, the period is 0 and the others are NaN;
    - `note`: the gait of `find_gait`, if that is another one, otherwise empty;
    - if `robust`, the results of `robustness` for the same gait.

    A combination that cannot be computed, such as one that the walker refuses, has `failed` 1, a
    `reason` (empty otherwise), fates of -1, and NaN; the others are computed. Other errors, such as
    a lack of memory, are raised, and the same call resumes with that combination.

    Raises `ValueError` for a parameter or a value that the walker does not have, for no values or
    more than a million combinations, and as `basin` and `refine` do.
    """
    check_kind("walker", walker, System)
    check_kind("over", over, Mapping)
    values = {name: np.atleast_1d(numbers(f"over {name}", given)) for name, given in over.items()}
    check_values(walker, values)
    levels = check_whole("levels", levels, 0, FINEST)
    check = check_whole("check", check, 0)
    check_memory_of_starts("check", check)
    check_kind("robust", robust, bool)
    strides = check_whole("strides", strides)
    seed = check_whole("seed", seed, 0)
    grid = default_region(walker) if grid is None else grid
    if grid is None:
        raise WrongUse("grid is required where no gait of period one is found", of="grid")
    check_grid(walker, grid, "direct", kind="sweep")
    tolerance = float(default_tolerance(jnp.result_type(float), tolerance))
    how = {"levels": levels, "check": check, "robust": int(robust), "strides": strides}
    how = {"method": "direct", **how, "seed": seed, "tolerance": tolerance}
    about = describe(walker, grid, how)
    for name in values:
        about.attrs.pop(f"walker_{name}", None)  # a number of an array has no attribute of its own
    own = {"command": "sweep", "over": {name: given.tolist() for name, given in values.items()}}
    request = request or request_of(about, grid) | own
    about = about.assign_coords(values)
    wanted = Measurement(walker, grid, (*values,), levels, check, robust, strides, seed, tolerance)
    work, label = work_of(wanted, about, request), " × ".join(values)
    by: Any = {"cluster": cluster, "progress": progress, "label": label}
    if out is not None:
        return complete_store(work, Path(out), overwrite=overwrite, **by)
    with tempfile.TemporaryDirectory() as folder:  # nobody else sees it
        data = complete_store(work, Path(folder) / "sweep.zarr", overwrite=False, **by).load()
    del data.attrs["request"]
    return data


def check_values(walker: System, values: Mapping[str, Float[np.ndarray, "..."]]) -> None:
    """Refuse parameters and values that the walker does not have."""
    if not values:
        raise WrongUse("over must name at least one parameter")
    for name, given in values.items():
        if given.ndim != 1 or len(given) == 0 or len(np.unique(given)) < len(given):
            raise WrongUse(f"over {name} must be one row of different numbers, not {short(given)}")
    count = math.prod(map(len, values.values()))
    if count > MAX_COMBINATIONS:
        raise WrongUse(f"over must have at most {MAX_COMBINATIONS} combinations, not {count}")
    for name, given in values.items():
        check_parameter(walker, name, *given.tolist())


def work_of(wanted: Measurement, about: xr.Dataset, request: dict) -> Work:
    """Return how a sweep is computed: a piece is one combination of values."""
    shape = [about.sizes[name] for name in wanted.names]
    fields = {
        name: broadcast(value, wanted.names, shape) for name, value in empty_row(wanted).items()
    }

    def values_of(place: storage.Pieces, piece: int) -> tuple[float, ...]:
        at = zip(wanted.names, place.place(piece), strict=True)
        return tuple(float(about[name][k]) for name, k in at)

    def finish(place: storage.Pieces, _: Compute) -> xr.Dataset:
        period, states = (np.asarray(place.array(name)[...]) for name in ATTRACTOR_ARRAYS)
        alike = number_alike(period, states, turns_of(wanted.walker))
        return about.assign({"attractor_number": ((*wanted.names, "own"), alike)})

    compute, block = partial(compute_row, wanted), (1,) * len(shape)
    return Work(request, about, fields, block, finish, values_of, compute)


def empty_row(plan: Measurement) -> dict[str, xr.Variable]:
    """Return the variables of one combination before it is computed."""
    single = ("area", "total_area", "total_area_error", "multiplier", "step_time")
    single += tuple(name.replace("-", "_") for name in GAIT_NUMBERS)
    unknown_state = "coordinate", np.full(plan.grid.coordinates, np.nan)
    row = dict.fromkeys(single, np.nan) | {
        "gait_state": unknown_state,
        **dict.fromkeys(("attractors", "failed", "gait_period"), 0),
        **dict.fromkeys(("reason", "note"), ""),
        "attractor_period": ("own", np.full(MOST_ATTRACTORS, -1)),
    }
    shape = MOST_ATTRACTORS, LONGEST_PERIOD, plan.grid.coordinates
    row |= {"attractor_states": (("own", "phase", "coordinate"), np.full(shape, np.nan))}
    row = (without_gait(plan.walker) if plan.robust else {}) | row
    return arrays_to_compute(plan.walker, plan.grid) | {
        str(name): one.variable for name, one in xr.Dataset(row).items()
    }


def broadcast(value: xr.Variable, names: Sequence[str], shape: list[int]) -> xr.Variable:
    """Repeat a variable for every combination of parameters, without taking memory."""
    everywhere = np.broadcast_to(value.values, (*shape, *value.shape))
    return xr.Variable((*names, *value.dims), everywhere, value.attrs)


def compute_row(plan: Measurement, _notes: dict, values: tuple[float, ...]) -> dict[str, Any]:
    """Compute all variables of one combination of values, unknown ones included."""
    unknown = {name: value.values for name, value in empty_row(plan).items()}
    return unknown | compute_combination(plan, values)


def compute_combination(plan: Measurement, values: tuple[float, ...]) -> dict[str, Any]:
    """Compute the variables of one combination of values, or the reason why it failed."""
    try:
        there = plan.walker
        for name, value in zip(plan.names, values, strict=True):
            check_parameter(there, name, value)
            there = with_parameter(there, name, jnp.asarray(value, jnp.result_type(float)))
        return measure_basin(there, plan)
    except Exception as error:  # one bad combination must not cost the others
        full = isinstance(error, JaxRuntimeError) and "RESOURCE_EXHAUSTED" in str(error)
        if full or isinstance(error, MemoryError | OSError | ImportError):
            raise  # the machine's fault, not the combination's
        words = str(error).split()
        if not isinstance(error, WrongUse):
            words.insert(0, f"{type(error).__name__}{':' * bool(words)}")
        return {"failed": 1, "reason": " ".join(words)}


def measure_basin(walker: System, plan: Measurement) -> dict[str, Any]:
    """Measure the basin of a walker, its area, and its gait."""
    grid, strides, tolerance = plan.grid, plan.strides, plan.tolerance
    cells = basin(walker, grid, "direct", strides=strides, tolerance=tolerance, progress=False)
    row: dict[str, Any] = {name: cells[name].values for name in ARRAYS}
    row |= {"area": float(cells["area"].sum()), "attractors": cells.sizes["number"]}
    period, states = (empty_row(plan)[name].values.copy() for name in ATTRACTOR_ARRAYS)
    kept = cells.isel(number=slice(MOST_ATTRACTORS))
    period[: kept.sizes["number"]] = kept["period"]
    states[: kept.sizes["number"], : kept.sizes["phase"]] = kept["states"]
    row |= {"attractor_period": period, "attractor_states": states}
    measure = robustness if plan.robust else refine
    fine = measure(
        walker,
        grid,
        levels=plan.levels,
        check=plan.check,
        strides=strides,
        seed=plan.seed,
        tolerance=tolerance,
    )
    gait = gait_of_basins(walker, fine, tolerance)
    if not plan.robust and has_gait_region(walker):  # `robustness` gives a note of its own
        row["note"] = compare_with_search(
            gait, search_gait(walker, tolerance=tolerance), turns_of(walker)
        )
    if gait is not None:
        row |= {"gait_period": len(gait.states), "gait_state": np.asarray(gait.states[0])}
        row |= {"multiplier": np.abs(gait.multipliers[0]), "step_time": np.mean(gait.step_times)}
        of_gait = differentiate_measures(walker, (), gait, GAIT_NUMBERS, {}, tolerance)
        row |= {name.replace("-", "_"): of_gait[name].value for name in GAIT_NUMBERS}
    of_basin = ("total_area", "total_area_error", *(without_gait(walker) if plan.robust else ()))
    return row | {name: fine[name].values for name in of_basin}
