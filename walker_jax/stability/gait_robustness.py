"""All measures of robustness of a gait, and their table over a parameter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.basins.attracting_gaits import compare_with_search, gait_of_basins
from walker_jax.basins.computation import check_grid
from walker_jax.basins.refinement import refine
from walker_jax.basins.windows import default_region
from walker_jax.checks import WrongUse, check_precision, numbers, refuses_tracers
from walker_jax.execution.progress import bar, track
from walker_jax.execution.threads import side_by_side
from walker_jax.fractals.dimensions import Uncertainty
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.stability.dimension import boundary_dimension, comparisons
from walker_jax.stability.disturbances import LeastDisturbance, least_disturbance_if_any
from walker_jax.stability.robustness_fields import (
    DIMENSION,
    GAIT,
    GROUND,
    LEAST_DISTURBANCE,
    LEAST_FALL,
    RETURN,
    STABILITY,
    STEP_DOWN,
    variables,
    without_gait,
)
from walker_jax.stability.sampling import BasinStability, basin_stability
from walker_jax.stability.steps_down import NO_STEP_DOWN, LeastStepDown, least_step_down
from walker_jax.stability.time_to_fall import steps_to_fall
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walkers.model import check_planar, is_planar
from walker_jax.walkers.parameters import check_parameter, with_parameter

WALKS, WALK_LIMIT = 1000, 2000
"""Number of walks on rough ground, and the most strides of each. They take some seconds on two
cores, and give an interval of some 6 % if all walks fall."""
LEADS_ELSEWHERE = Outcome.STRIDE, Outcome.UNDECIDED
"""Outcomes of a walker that neither returns to its gait nor falls."""
NEEDED_BY = "robustness, which has the dimension of a boundary,"
NEGLIGIBLE = 1e-9
"""Coordinates of a gait's state below this share of the largest have no size: they are rounding."""


@refuses_tracers()
def robustness(
    walker: System,
    grid: Grid | None = None,
    *,
    values: Sequence[Any] | ArrayLike | None = None,
    parameter: str = "slope",
    levels: int = 4,
    check: int = 500_000,
    disturbances: float = 0.1,
    strides: int = 500,
    seed: int = 0,
    ground: float | None = None,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Measure the robustness of a walker's gait: basin, disturbances, basin stability, boundary.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.04, 0.01, 40))
    data = wj.robustness(wj.SimplestWalker(0.004), grid, levels=1, check=1000)
    float(data.least_disturbance), float(data.stability), float(data.step_down)
    table = wj.robustness(wj.SimplestWalker(0.004), grid, values=[0.004, 0.009], check=1000)
    ```

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: grid for `refine` and `boundary_dimension`. The default for a walker on point feet has
      all feasible angles, with sum from -0.12 to 0.06 for the simplest and -1.1 to 0.1 for others.
      For any other walker it is a slice around the gait, in space over yaw and leandot.
    - `values`, `parameter`: values of a parameter, to measure walkers with these: the result is
      then a table over them. Without a grid, each walker with mass on its legs has a slice around
      its own gait.
    - `levels`, `check`: of refinement; in space, where strides take longer, choose fewer starts.
    - `disturbances`: for `basin_stability`, as shares of the coordinates of the gait's own state,
      of the largest where one is 0, and of 1 where all are.
    - `strides`: number of strides in which a walker may return.
    - `seed`, `tolerance`: of random numbers, and of the integration.
    - `ground`: standard deviation of normally distributed heights of steps, in the unit of length,
      for `steps_to_fall`; without it walks on rough ground are left out.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** the data set of `refine`, with measures of the gait of the largest basin:

    - `gait_period`, `gait_state` (the state nearest to the least disturbance), `multiplier` (the
      largest modulus), `step_time` (the mean) and `return_strides` (the characteristic return
      time);
    - from `least_disturbance`, `least_disturbance`, `direction`, `failing_state`, `failure` and
      `failing_strides`; NaN and -1 if the walker returns from all that were tried;
    - from `least_disturbance` with `fall`, `least_fall`, `fall_direction`, `fall_state`,
      `fall_failure` and `fall_strides`; the same point unless the first leads to another motion;
    - `step_down` and `step_down_failure`, and `step_down_fall`, the least step down from which the
      walker falls;
    - from `basin_stability`, `stability`, with `_low` and `_high`, `in_time`, `median_strides`,
      `slowest_strides`, `mean_strides`, `pace`, `median_pace`, `mean_shock` and `largest_shock`;
      sizes are shares of the gait's state;
    - `dimension` of the boundary, with `_low` and `_high`;
    - with a `ground`, the mean `steps_to_fall`, with `_low` and `_high`;
    - `note`: the gait of `find_gait` if that is another one, otherwise empty. A default slice lies
      around the gait of `find_gait`.

    Values are NaN or -1 where no gait attracts, and for steps down of a walker in space. A table
    has no results by cell or attractor.

    Raises `ValueError` as `refine` does, without a grid where no gait of period one is found, for
    a ground under a walker in space, and for values that the walker refuses.
    """
    about: Any = {"strides": strides, "tolerance": tolerance}
    if values is not None:
        how = {"levels": levels, "check": check, "disturbances": disturbances, "ground": ground}
        return tabulate(walker, values, parameter, grid, progress, how | {"seed": seed} | about)
    if ground is not None:
        check_planar(walker)
    if grid is not None:
        check_grid(walker, grid, "direct", kind="robustness")
    check_precision(jnp.result_type(float), NEEDED_BY)
    with bar("search for a gait", progress):
        searched = search_gait(walker, tolerance=tolerance)
        grid = default_region(walker, searched) if grid is None else grid
    if grid is None:
        raise WrongUse("grid is required where no gait of period one is found", of="grid")
    with bar("basin", progress):
        data = refine(walker, grid, levels, check=check, seed=seed, progress=progress, **about)
    data.attrs["disturbances"] = disturbances
    if ground is not None:
        data.attrs["ground"] = float(ground)
        data = data.assign(dict.fromkeys(GROUND.values(), np.nan))
    gait = gait_of_basins(walker, data, tolerance)
    data = data.assign(without_gait(walker))
    # A store can hold an array of objects.
    data["note"] = np.array(compare_with_search(gait, searched, turns_of(walker)), object)
    if gait is None:
        return data
    with bar("disturbances, steps down, and the boundary", progress):
        rolled, found = measure_gait(walker, grid, gait, disturbances, seed, about)
    if ground is not None:
        with bar("walks on rough ground", progress):
            how: Any = {"gait": rolled, "limit": WALK_LIMIT, "tolerance": tolerance}
            planar, key = check_planar(walker), jax.random.key(seed)
            walks = steps_to_fall(planar, ground, WALKS, key, **how)
        found |= variables(GROUND, walks._asdict())
    return data.assign(found)


def measure_gait(
    walker: System, grid: Grid, gait: Gait, disturbances: float, seed: int, about: dict[str, Any]
) -> tuple[Gait, dict[str, Any]]:
    """Measure a gait; return it from its state nearest to failure on, and its variables.

    `about` holds the arguments that all measures take: strides, and the tolerance.
    """

    def by_boundary() -> Uncertainty:
        how = comparisons(walker) | about
        return boundary_dimension(walker, grid, seed=seed, progress=False, **how)

    def by_disturbances() -> tuple[Gait, LeastDisturbance, LeastDisturbance, BasinStability]:
        nearest = fall = least_disturbance_if_any(walker, gait, **about)
        if nearest.failure in LEADS_ELSEWHERE:
            fall = least_disturbance_if_any(walker, gait, fall=True, **about)
        rolled = gait._replace(states=np.roll(np.asarray(gait.states), -nearest.phase, axis=0))
        size = np.abs(np.asarray(rolled.states[0]))
        largest = size.max() or 1.0
        scale = np.where(size > NEGLIGIBLE * largest, size, largest)
        stability = basin_stability(walker, disturbances, rolled, scale=scale, seed=seed, **about)
        return rolled, nearest, fall, stability

    def by_steps_down() -> tuple[LeastStepDown, LeastStepDown]:
        if not is_planar(walker):
            return NO_STEP_DOWN, NO_STEP_DOWN
        planar = check_planar(walker)
        down = fall = least_step_down(planar, gait, **about)
        if down.failure in LEADS_ELSEWHERE:
            fall = least_step_down(planar, gait, fall=True, **about)
        return down, fall

    measures: list[Callable[[], Any]] = [by_boundary, by_disturbances, by_steps_down]
    found = side_by_side(lambda one: one(), measures)
    boundary, (rolled, nearest, fall, stability), (down, down_fall) = found
    returns = stability._asdict()
    returns |= {f"{name}_strides": returns[name] for name in ("median", "slowest", "mean")}
    about_gait = {
        "period": len(rolled.states),
        "state": rolled.states[0],
        "multiplier": np.abs(rolled.multipliers[0]),
        "step_time": np.mean(rolled.step_times),
        "return_strides": rolled.return_strides,
    }
    steps = {"step_down": down.size, "step_down_failure": down.failure}
    return rolled, {
        **variables(GAIT, about_gait),
        **variables(LEAST_DISTURBANCE, nearest._asdict()),
        **variables(LEAST_FALL, fall._asdict()),
        **variables(STEP_DOWN, steps | {"step_down_fall": down_fall.size}),
        **variables(STABILITY | RETURN, returns),
        **variables(DIMENSION, boundary._asdict()),
    }


def tabulate(
    walker: System,
    values: Any,
    parameter: str,
    grid: Grid | None,
    progress: bool,
    how: dict[str, Any],
) -> xr.Dataset:
    """Measure robustness over values of a parameter; `how` has the arguments of all measures."""
    values = numbers("values", values)
    if values.ndim != 1 or len(values) == 0:
        raise WrongUse(f"values must be one row of numbers, not of shape {values.shape}")
    check_parameter(walker, parameter, *map(float, values))
    check_precision(jnp.result_type(float), NEEDED_BY)
    rows = []
    for value in track(values, parameter, progress):
        there = with_parameter(walker, parameter, float(value))
        region = default_region(there) if grid is None else grid
        if region is None:
            unknown = dict.fromkeys(("total_area", "total_area_error"), np.nan)
            rows.append(xr.Dataset(unknown | without_gait(there)))
            continue
        one = robustness(there, region, progress=progress, **how)
        rows.append(one[[name for name in one if set(one[name].dims) <= {"coordinate"}]])
    about = {"walker": walker.label(), "disturbances": how["disturbances"]}
    table = join_rows(rows, values, parameter)
    return table.assign_attrs(about | table.attrs)


def join_rows(
    rows: list[xr.Dataset], values: Float[np.ndarray, " n"], parameter: str
) -> xr.Dataset:
    """Join all rows into one table, with NaN for the missing values of a row.

    Attributes that differ between rows are dropped.
    """
    where = xr.DataArray(values, dims=parameter, name=parameter)
    own = "area", f"walker_{parameter}"
    about = [{name: row.attrs[name] for name in row.attrs if name not in own} for row in rows]
    plain = [
        row.reset_coords().drop_attrs().assign_attrs(attributes)
        for row, attributes in zip(rows, about, strict=True)
    ]
    joining: Any = {"data_vars": "all", "coords": "minimal", "compat": "override", "join": "outer"}
    return xr.concat(plain, where, **joining, combine_attrs="drop_conflicts")
