"""How large a disturbance a gait survives.

A disturbance moves the walker from its gait to another point of the Poincaré section. The least one
from which it does not come back says more of a machine than the multipliers of its gait do (Schwab
and Wisse 2001, section 5).
"""

from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.attraction import (
    Attractor,
    follow,
    framed_attractors,
    near,
    settle,
    with_frames,
)
from walker_jax.basin import around, check_grid
from walker_jax.boundaries import Uncertainty, checked_distances, uncertainty_exponent, upper_end
from walker_jax.cells import Grid
from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_kind,
    check_number,
    check_precision,
    check_whole,
    is_number,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.gaits import Gait, check_parameter, find_gait, with_parameter
from walker_jax.integrate import default_tolerance
from walker_jax.margins import failed_by, follow_margins
from walker_jax.progress import tracked
from walker_jax.refinement import edge, refine
from walker_jax.stride import (
    Outcome,
    check_parameters,
    follow_step_down,
    follow_stride,
    step_down,
)
from walker_jax.stride import strides as take_strides
from walker_jax.tiles import map_cells
from walker_jax.walkers import PointFeetWalker, Scalar, SimplestWalker, Walker, moves_like

RAYS, RADII = 720, 128
"""Directions, of two dimensions, and distances along each, at which a walker is first tried."""
DENSE, SHELL = 16, 64
"""How many times as many directions are then tried, at how many distances up to the least found."""
KEPT = 0.01
"""By how much, relatively, a failure may be farther than the nearest for its ray to be kept."""
ARC, CLOSER = 2000, 16
"""Directions, of those kept, about which more are tried, and how many about each."""
FAN = 61
"""Directions that are tried at once around one of the nearest."""
CANDIDATES = 128
"""Directions that are nearer than their neighbours, of which as many are looked at more closely."""
ZOOMS = 3
"""How often fans are made narrower."""
POLISHES = 4
"""Searches along the boundary's gradient that follow."""
ALONG = 2.0 ** np.arange(-6, 3)
"""Parts of the way, to where the boundary would be nearest if it were flat, that each tries."""
LAST = 512
"""Distances at which it is made sure that nothing nearer fails in the direction found."""
HEIGHTS = 4096
"""Heights of a step down, up to the least found."""
BEYOND = 1 + np.array([1e-8, 1e-10, 0.0])
"""Of the least disturbance, those of which the first that fails says how: rounding is less."""
MEETING, OUTWARDS = 90, 0.1 * 0.5 ** np.arange(12.0)[:, None]
"""Directions and distances, of starts from which other gaits are met."""
HALVINGS = 12, 34
"""Of the distance between two points tried on a ray: to tell rays apart, and in the end."""


class LeastDisturbance(NamedTuple):
    """The nearest point to a gait from which the walker does not come back, or falls."""

    size: float
    """Its distance from the gait, in the metric asked for."""
    direction: Float[np.ndarray, " section"]
    """Of it from the gait, of length one in that metric."""
    state: Float[np.ndarray, " section"]
    """The point."""
    phase: int
    """The state of the gait that it is nearest to."""
    failure: Outcome
    """How the walker fails from just beyond it; `STRIDE` where it comes to another motion."""
    strides: int
    """Strides before that, the failing one not counted."""


@refuses_tracers("disturbance_gradient gives derivatives of the least disturbance")
def least_disturbance(
    walker: Walker,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    fall: bool = False,
    strides: int = 500,
    tolerance: float | None = None,
) -> LeastDisturbance:
    """The nearest point of the section from which a walker does not return to its gait, or falls.

    From the nearest point at which it does not return it may come to another motion: the `failure`
    is `STRIDE` then, and the nearest at which it falls, found with `fall`, is farther. Otherwise
    these are the same.

    Rays from the gait are followed outwards, all at once, to the first distance from which the
    walker does not return; then closer rays, up to the least of these; then fans of rays around
    those that are nearer than their neighbours, ever narrower, and along the boundary's gradient.
    Fingers of failure may be missed that pass between the points tried, in 11,520 directions at
    distances 1.6 % of the size apart, or 0.16 % close to it, where directions are 8 times as close
    too: then the size found is too large by as much as such a finger comes nearer.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `gait`: a stable one; the most stable of period one, by default.
    - `scale`: what counts as one unit along each coordinate of the section, positive. The size is
      the length of the disturbance divided by it; by default it is plain length.
    - `along`: vectors, one a row, that disturbances are made of, such as (0, 1) for a push that
      changes thetadot alone. By default they have any direction.
    - `fall`: whether the walker is to fall, and no other motion counts.
    - `strides`: how many of them a walker may take to come back, or to fall.
    - `tolerance`: of the integration, as in `stride`.

    `ValueError` for a gait that is not stable, or not found, and for a scale or vectors that are
    not of the section; `ComputationFailed` where no disturbance up to a size of a thousand is
    found from which the walker does not return.
    """
    unit, basis = metric(walker, scale, along)
    size, lost = len(unit), which_walks(fall)
    states, shared = returning(walker, gait, strides, tolerance)
    if fall:
        rays = directions(len(basis), MEETING) @ basis * unit
        shared = until_settled(shared, states[:, None, None] + OUTWARDS * rays[:, None])

    def fails(points: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        return lost(map_cells(end_of_walk, (shared, points)))

    def gradient(points: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n section"]:
        count = map_cells(end_of_walk, (shared, points)).strides
        still = jax.tree.map(lambda leaf: np.zeros(size * len(points), leaf.dtype), shared[0])
        tangents = still, np.tile(np.eye(size, dtype=points.dtype), (len(points), 1))
        cells = np.repeat(points, size, axis=0), np.repeat(count, size), tangents
        return map_cells(change_of_margin, (shared[:2], cells)).reshape(-1, size)

    found = [
        nearest_failure(
            lambda y, x=x: fails(x + y * unit), basis, lambda y, x=x: gradient(x + y * unit) * unit
        )
        for x in states
    ]
    phase = int(np.argmin([np.linalg.norm(one) for one in found]))
    step = found[phase]
    length = float(np.linalg.norm(step))
    state = states[phase] + step * unit
    beyond = map_cells(end_of_walk, (shared, states[phase] + BEYOND[:, None] * step * unit))
    first = int(lost(beyond).argmax())
    failure, made = Outcome(int(beyond.outcome[first])), int(beyond.strides[first])
    return LeastDisturbance(length, step / length, state, phase, failure, made)


class LeastStepDown(NamedTuple):
    """The least step down from which a walker does not come back to its gait, or falls."""

    size: float
    """Its height, at right angles to the slope, in the unit of length."""
    state: Float[np.ndarray, " 4"]
    """(theta, phi, thetadot, phidot) just after heel strike on the lower ground; NaN if none."""
    phase: int
    """The state of the gait from which the stride begins that ends there."""
    failure: Outcome
    """How the walker fails from just beyond it; `STRIDE` where it comes to another motion."""
    strides: int
    """Strides before that, the one down included, the failing one not."""


@refuses_tracers()
def least_step_down(
    walker: Walker,
    gait: Gait | None = None,
    *,
    fall: bool = False,
    strides: int = 500,
    tolerance: float | None = None,
) -> LeastStepDown:
    """The least height of a step down from which a walker does not return to its gait, or falls.

    One heel strike is on ground that is lower (`step_down`), and so are all that follow. Arguments
    and errors are those of `least_disturbance`. Heights are tried at some 4096 places up to the
    least: failures in narrower ranges may be missed.
    """
    lost = which_walks(fall)
    states, shared = returning(walker, gait, strides, tolerance)

    def end(state, heights):
        starts = np.broadcast_to(state, (len(heights), len(state)))
        return map_cells(end_after_step, (shared, (starts, heights.astype(states.dtype))))

    up = np.ones((1, 1))
    found = []
    for state in states:
        fails = lambda heights, state=state: lost(end(state, heights[:, 0]))
        reach = scanned(fails, up, HEIGHTS)[0]
        first = first_failures(fails, up, 0.0, reach, HEIGHTS)
        found.append(halved(fails, up, first, reach / HEIGHTS, HALVINGS[1])[0])
    phase = int(np.argmin(found))
    height = float(found[phase])
    beyond = end(states[phase], BEYOND * height)
    first = int(lost(beyond).argmax())
    failure, made = Outcome(int(beyond.outcome[first])), int(beyond.strides[first])
    down = step_down(walker, states[phase], height, tolerance=tolerance)
    return LeastStepDown(height, np.asarray(down.state), phase, failure, made)


class BasinStability(NamedTuple):
    """The fraction of disturbances that a gait survives (Menck and others 2013)."""

    value: Float[np.ndarray, "*walkers"]
    """The fraction of the starts from which the walker comes back to its gait."""
    low: Float[np.ndarray, "*walkers"]
    high: Float[np.ndarray, "*walkers"]
    """Wilson's confidence interval."""
    fates: Int[np.ndarray, "*walkers outcomes"]
    """Starts by the `Outcome` of their last stride; of those with `STRIDE`, `elsewhere` did not
    come back, but still walk."""
    elsewhere: Int[np.ndarray, "*walkers"]
    median: Float[np.ndarray, "*walkers"]
    """Strides to within a distance of the gait, of half of those that come back."""
    slowest: Float[np.ndarray, "*walkers"]
    """And of 95 of 100; infinite where they have not come that close, NaN where none come back."""


@refuses_tracers()
def basin_stability(
    walker: Walker,
    disturbances: float | Grid,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    within: float = 1e-6,
    samples: int = 10_000,
    strides: int = 500,
    confidence: float = 0.95,
    seed: int = 0,
    tolerance: float | None = None,
) -> BasinStability:
    """The fraction of random disturbances from which a walker comes back to its gait, and how soon.

    **Arguments:**

    - `walker`: its parameters are numbers, or arrays of n, as in `strides`; then the results are
      arrays of n, and NaN where there is no stable gait.
    - `disturbances`: the greatest length of disturbances of the gait's first state, of which all
      are as likely, in the metric of `least_disturbance` with `scale` and `along`; or a grid, in
      whose region of the section starts are as likely anywhere.
    - `gait`: a stable one, of one walker; the most stable of period one, by default.
    - `within`: distance of a state of the gait, in every coordinate, to which strides are counted.
    - `samples`: starts for each walker, the same disturbances for all.
    - `strides`: how many of them a walker may take to come so close to its gait, if not within
      that distance, that all walkers come to it from there.
    - `confidence`: of the interval.
    - `seed`: of what is drawn.
    - `tolerance`: of the integration, as in `stride`.

    `ValueError` for a single walker without a stable gait, and for arguments out of range.
    """
    unit, basis = metric(walker, scale, along)
    if isinstance(disturbances, Grid):
        check_grid(walker, disturbances, "direct")
        if scale is not None or along is not None:
            raise WrongUse("scale and along are of no use where disturbances is a grid")
    elif not is_number(disturbances) or not 0 < disturbances < np.inf:
        raise WrongUse(
            f"disturbances must be a positive number, or a grid, not {short(disturbances)}"
        )
    check_number("within", within)
    check_number("confidence", confidence)
    if not within > 0:
        raise WrongUse(f"within must be positive, not {within}")
    check_whole("samples", samples)
    check_whole("seed", seed, 0)
    if not 0 < confidence < 1:
        raise WrongUse(f"confidence must be between 0 and 1, not {confidence}")
    counts = {np.size(leaf) for leaf in jax.tree.leaves(walker) if np.ndim(leaf)}
    if counts and gait is not None:
        raise WrongUse("gait must be left out for walkers with arrays for parameters")
    if counts:
        check_parameters(walker, max(counts))
    if 0 in counts:
        raise WrongUse("walker must be one or more, and its parameters are arrays of none")
    rng = np.random.default_rng(seed)
    if isinstance(disturbances, Grid):
        starts = disturbances.states(rng.uniform(size=(samples, len(disturbances.names))))
        about = lambda state: starts
    else:
        inside = in_ball(rng, samples, len(basis)) @ basis * unit * disturbances
        about = lambda state: state + inside

    def one(walker: Walker, gait: Gait | None) -> tuple:
        states, shared = returning(walker, gait, strides, tolerance)
        starts = about(states[0]).astype(states.dtype)
        found = map_cells(end_of_walk, (shared, starts))
        fates = np.bincount(found.outcome, minlength=len(Outcome))
        elsewhere = np.count_nonzero((found.outcome == Outcome.STRIDE) & ~found.back)
        cubes = np.broadcast_to(np.eye(states.shape[1]) / within, shared[3].shape)
        closer = map_cells(
            end_of_walk, ((*shared[:3], cubes.astype(states.dtype), shared[4]), starts[found.back])
        )
        made = np.where(closer.back, closer.strides, np.inf)
        back = len(made)
        late = np.percentile(made, (50, 95), method="inverted_cdf") if back else (np.nan, np.nan)
        return back / samples, *wilson(back, samples, confidence), fates, elsewhere, *late

    if not counts:
        return BasinStability(*map(np.asarray, one(walker, gait)))
    rows = []
    for i in range(max(counts)):
        single = jax.tree.map(lambda leaf, i=i: leaf[i] if np.ndim(leaf) else leaf, walker)
        gait = find_gait(single)
        if gait.found and gait.stable:
            rows.append(one(single, gait))
        else:
            rows.append((np.nan, np.nan, np.nan, np.zeros(len(Outcome), int), 0, np.nan, np.nan))
    return BasinStability(*map(np.array, zip(*rows, strict=True)))


DISTANCES = 10.0 ** np.linspace(-6, -3.5, 11)
"""Between starts whose fates are compared, as shares of the lengths of a grid's axes."""


@refuses_tracers()
def boundary_dimension(
    walker: Walker,
    grid: Grid,
    *,
    distances: Sequence[Any] | ArrayLike = DISTANCES,
    pairs: int = 50_000,
    strides: int = 200,
    confidence: float = 0.95,
    seed: int = 0,
    tolerance: float | None = None,
) -> Uncertainty:
    """The dimension of the boundary of the basins in a region, by the uncertainty exponent.

    A start is uncertain at a distance if a walker that starts that far from it, on either side, in
    a random direction, comes to another attractor, or to none. Starts are drawn from the cells that
    have a neighbour of another fate: elsewhere next to none are uncertain.

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: its region is meant, or slice, in cells larger than the distances.
    - `distances`: as shares of the lengths of the grid's axes.
    - `pairs`: starts for each distance.
    - `strides`: how many of them a walker is followed for.
    - `confidence`, `seed`: of the interval, and of what is drawn.
    - `tolerance`: of the integration, as in `stride`.

    It is NaN where all cells have one fate. `ValueError` as for `basin` and `uncertainty_exponent`.
    """
    check_grid(walker, grid, "direct")
    check_whole("seed", seed, 0)
    apart = checked_distances(numbers("distances", distances), pairs)
    upper_end(confidence)
    check_whole("strides", strides)
    dtype = jnp.asarray(0.0).dtype
    check_precision(dtype, "boundary_dimension, which compares starts 1e-6 apart,")
    finest = float(default_tolerance(dtype, tolerance))
    starts, attractors = framed_attractors(walker, grid, finest, strides)

    def label_of(share: Float[np.ndarray, "n axes"]) -> Int[np.ndarray, " n"]:
        return follow(walker, grid.states(share), attractors, finest, strides).attractor

    shape = np.array(grid.shape)
    label = follow(walker, starts, attractors, finest, strides).attractor.reshape(grid.shape)
    on_edge = np.argwhere(edge(label))
    if len(on_edge) == 0:
        return Uncertainty(np.nan, np.nan, np.nan, np.nan, np.zeros(0), np.zeros(0))

    def draw(rng: np.random.Generator, n: int) -> Float[np.ndarray, "n axes"]:
        return (rng.choice(on_edge, n) + rng.uniform(size=(n, len(shape)))) / shape

    return uncertainty_exponent(
        label_of, draw, apart, pairs=pairs, seed=seed, confidence=confidence
    )


@refuses_tracers()
def robustness(
    walker: Walker,
    grid: Grid | None = None,
    *,
    levels: int = 4,
    check: int = 500_000,
    disturbances: float = 0.1,
    strides: int = 500,
    seed: int = 0,
    tolerance: float | None = None,
) -> xr.Dataset:
    """How robust a walker's gait is: basin, least disturbance, basin stability, boundary.

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: what `refine` and `boundary_dimension` begin with; by default all feasible angles of a
      walker on point feet, sum from -0.12 to 0.06 (-1.1 to 0.1 but for the simplest), and a slice
      around the gait of any other.
    - `levels`, `check`: of refinement.
    - `disturbances`: for `basin_stability`, shares of the coordinates of the gait's own state.
    - `strides`: how many of them a walker may take to come back.
    - `seed`, `tolerance`: of what is drawn, and of the integration.

    **Returns** what `refine` does, and of the gait, the attractor of the largest basin:
    `gait_period`, `gait_state` (that from which the least disturbance is), `multiplier` (the
    largest modulus), `step_time` (the mean); of the point that `least_disturbance` finds,
    `least_disturbance`, `direction`, `failing_state`, `failure` (-1 for none) and
    `failing_strides`; of the one that it finds with `fall`, which is the same unless the first
    leads to another motion, `least_fall`, `fall_direction`, `fall_state`, `fall_failure` and
    `fall_strides`; `step_down` and `step_down_failure`, and `step_down_fall`, the least one from
    which the walker falls; `stability`, with `_low` and `_high`, `median_strides` and
    `slowest_strides`; `dimension`, with `_low` and `_high`, of the boundary. NaN, or -1, where no
    gait attracts.

    `ValueError` as for `refine`, and for a walker that a grid is wanted for: without it, no gait of
    period one is found.
    """
    check_kind("walker", walker, Walker)
    check_precision(jnp.asarray(0.0).dtype, "robustness, which has the dimension of a boundary,")
    grid = default_region(walker) if grid is None else grid
    if grid is None:
        raise WrongUse("grid is wanted where no gait of period one is found")
    options: Any = {"check": check, "strides": strides, "seed": seed, "tolerance": tolerance}
    data = refine(walker, grid, levels, **options)
    data.attrs["disturbances"] = disturbances
    cells = data["cells"].values * (data["period"].values > 0)
    if cells.sum() == 0:
        return data.assign(without_gait(walker))
    largest = int(cells.argmax())
    period = int(data["period"][largest])
    gait = find_gait(walker, data["states"].values[largest, :period], period)
    if not (gait.found and gait.stable):
        return data.assign(without_gait(walker))
    least = least_disturbance(walker, gait, strides=strides, tolerance=tolerance)
    down = least_step_down(walker, gait, strides=strides, tolerance=tolerance)
    fall, fall_down = least, down
    unknown = (Outcome.STRIDE, Outcome.UNDECIDED)
    if least.failure in unknown:
        fall = least_disturbance(walker, gait, fall=True, strides=strides, tolerance=tolerance)
    if down.failure in unknown:
        fall_down = least_step_down(walker, gait, fall=True, strides=strides, tolerance=tolerance)
    gait = gait._replace(states=np.roll(np.asarray(gait.states), -least.phase, axis=0))
    stability = basin_stability(
        walker,
        disturbances,
        gait,
        scale=np.abs(np.asarray(gait.states[0])),
        strides=strides,
        seed=seed,
        tolerance=tolerance,
    )
    boundary = boundary_dimension(walker, grid, strides=strides, seed=seed, tolerance=tolerance)
    return data.assign(
        {
            "gait_period": period,
            "gait_state": ("coordinate", np.asarray(gait.states[0])),
            "multiplier": float(np.abs(gait.multipliers[0])),
            "step_time": float(np.mean(gait.step_times)),
            "least_disturbance": least.size,
            "direction": ("coordinate", least.direction),
            "failing_state": ("coordinate", least.state),
            "failure": int(least.failure),
            "failing_strides": least.strides,
            "least_fall": fall.size,
            "fall_direction": ("coordinate", fall.direction),
            "fall_state": ("coordinate", fall.state),
            "fall_failure": int(fall.failure),
            "fall_strides": fall.strides,
            "step_down": down.size,
            "step_down_failure": int(down.failure),
            "step_down_fall": fall_down.size,
            "stability": float(stability.value),
            "stability_low": float(stability.low),
            "stability_high": float(stability.high),
            "median_strides": float(stability.median),
            "slowest_strides": float(stability.slowest),
            "dimension": boundary.value,
            "dimension_low": boundary.low,
            "dimension_high": boundary.high,
        }
    )


def without_gait(walker: Walker) -> dict:
    """What `robustness` adds where no gait attracts."""
    names = (
        *("multiplier", "step_time", "least_disturbance", "least_fall"),
        *("step_down", "step_down_fall"),
        *("stability", "stability_low", "stability_high", "median_strides", "slowest_strides"),
        *("dimension", "dimension_low", "dimension_high"),
    )
    nowhere = "coordinate", np.full(len(walker.section), np.nan)
    vectors = ("gait_state", "direction", "failing_state", "fall_direction", "fall_state")
    vectors = dict.fromkeys(vectors, nowhere)
    none = ("failure", "failing_strides", "fall_failure", "fall_strides", "step_down_failure")
    whole = {"gait_period": 0} | dict.fromkeys(none, -1)
    return dict.fromkeys(names, np.nan) | vectors | whole


@refuses_tracers()
def robustness_table(
    walker: Walker,
    values: Sequence[Any] | ArrayLike,
    parameter: str = "slope",
    grid: Grid | None = None,
    *,
    levels: int = 4,
    check: int = 500_000,
    disturbances: float = 0.1,
    strides: int = 500,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """`robustness` over values of a parameter: all that is not of single cells or attractors.

    Without a grid, the slices of walkers with mass on their legs are around the gait of each.
    Arguments are those of `robustness`; `progress` shows a bar on a terminal. `ValueError` also for
    values that the walker refuses.
    """
    values = numbers("values", values)
    if values.ndim != 1 or len(values) == 0:
        raise WrongUse(f"values must be one row of numbers, not of shape {values.shape}")
    check_parameter(walker, parameter, *map(float, values))
    check_precision(jnp.asarray(0.0).dtype, "robustness_table, as robustness does,")
    rows = []
    for value in tracked(values, parameter, progress):
        there = with_parameter(walker, parameter, float(value))
        region = default_region(there) if grid is None else grid
        if region is None:
            unknown = dict.fromkeys(("total_area", "total_area_error"), np.nan)
            rows.append(xr.Dataset(unknown | without_gait(there)))
            continue
        one = robustness(
            there,
            region,
            levels=levels,
            check=check,
            disturbances=disturbances,
            strides=strides,
            seed=seed,
            tolerance=tolerance,
        )
        rows.append(one[[name for name in one if set(one[name].dims) <= {"coordinate"}]])
    about = {"walker": type(walker).__name__, "disturbances": disturbances}
    return joined(rows, values, parameter).assign_attrs(about | common(rows, parameter))


def joined(rows: list[xr.Dataset], values: Float[np.ndarray, " n"], parameter: str) -> xr.Dataset:
    """One table of rows. What a row lacks, of a walker without a gait, is NaN."""
    where = xr.DataArray(values, dims=parameter, name=parameter)
    plain = [row.reset_coords().drop_attrs() for row in rows]
    return xr.concat(
        plain, where, data_vars="all", coords="minimal", compat="override", join="outer"
    )


def common(rows: list[xr.Dataset], parameter: str) -> dict[str, Any]:
    """The attributes that rows have, but those of a row's own."""
    own = ("area", f"walker_{parameter}")
    return {name: value for row in rows for name, value in row.attrs.items() if name not in own}


def default_region(walker: Walker) -> Grid | None:
    """All feasible angles of a walker on point feet, or a slice around a gait, if there is one.

    The rates are those of the simplest walker's basins, and more for others.
    """
    if isinstance(walker, PointFeetWalker):
        rates = (-0.12, 0.06, 200) if moves_like(walker, SimplestWalker) else (-1.1, 0.1, 800)
        return Grid.sheared(theta=(0, np.pi / 4, 200), sum=rates)
    gait = find_gait(walker)
    if not gait.found:
        return None
    return Grid.sheared(**around(gait.states[0], ("theta", "sum", "phidot")))


def in_ball(rng: np.random.Generator, n: int, rank: int) -> Float[np.ndarray, "n rank"]:
    """Points of the unit ball, all as likely."""
    x = rng.normal(size=(n, rank))
    radius = rng.uniform(size=(n, 1)) ** (1 / rank)
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True)


def wilson(successes: int, n: int, confidence: float) -> tuple[float, float]:
    """Wilson's interval for a probability, from a number of successes of n."""
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    centre, spread = successes + z**2 / 2, z * np.sqrt(successes * (1 - successes / n) + z**2 / 4)
    return float((centre - spread) / (n + z**2)), float((centre + spread) / (n + z**2))


def metric(
    walker: Walker, scale: Sequence[Any] | ArrayLike | None, along: Sequence[Any] | ArrayLike | None
) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "rank section"]]:
    """The units of a walker's section, and unit vectors at right angles in these that span `along`.

    `ValueError` for what is not of the section.
    """
    check_kind("walker", walker, Walker)
    size = len(walker.section)
    unit = np.ones(size) if scale is None else numbers_or_none(scale)
    if unit.shape != (size,) or not np.all(np.isfinite(unit) & (unit > 0)):
        raise WrongUse(f"scale must be {size} positive numbers, not {short(scale)}")
    basis = np.eye(size) if along is None else np.atleast_2d(numbers_or_none(along))
    fits = basis.ndim == 2 and basis.shape[1] == size and bool(np.isfinite(basis).all())
    if not fits or np.linalg.matrix_rank(basis) != len(basis):
        raise WrongUse(f"along must be independent vectors of the section, not {short(along)}")
    return unit, np.linalg.qr((basis / unit).T)[0].T


def numbers_or_none(values: Any) -> Float[np.ndarray, "..."]:
    """An array of them; of NaN for what is none."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        return np.array(np.nan)


def returning(
    walker: Walker, gait: Gait | None, strides: int, tolerance: float | None
) -> tuple[Float[np.ndarray, "period section"], tuple]:
    """The states of a stable gait, and what walks share that are to come back to it, checked."""
    check_kind("walker", walker, Walker)
    check_whole("strides", strides)
    gait = find_gait(walker) if gait is None else gait
    if not isinstance(gait, Gait) or not (gait.found and gait.stable):
        raise WrongUse("gait must be a stable one, and found")
    states = np.asarray(gait.states)
    check_precision(states.dtype)
    if states.shape[1:] != (len(walker.section),):
        raise WrongUse(f"gait must be one of this walker, on {', '.join(walker.section)}")
    ends = take_strides(walker, states, tolerance=tolerance).state
    miss = np.abs(ends - np.roll(states, -1, axis=0)).max()
    if not miss < near(states.dtype):
        raise WrongUse(f"gait must be one of this walker, whose strides miss it by {miss:.2g}")
    finest = default_tolerance(states.dtype, tolerance)
    cycle = Attractor(len(states), states)
    (cycle,) = with_frames(walker, [cycle], float(finest), strides)
    to_dtype = lambda leaf: np.asarray(leaf, states.dtype)
    shared = jax.tree.map(to_dtype, (walker, finest, states, cycle.boxes()))
    return states, (*shared, np.int32(strides))


def until_settled(shared: tuple, starts: Float[np.ndarray, "*starts section"]) -> tuple:
    """What walks share that may end close to any gait to which walkers come from some starts.

    Those that come to another gait are not followed to their last stride then.
    """
    walker, tolerance, states, frames, limit = shared
    own = Attractor(len(states), states, frames)
    found = settle(walker, starts.reshape(-1, states.shape[1]), float(tolerance), [own])
    gaits = [one for one in found if one.period]
    if len(gaits) > 1:
        gaits = with_frames(walker, gaits, float(tolerance), int(limit))
        states = np.concatenate([one.states for one in gaits])
        frames = np.concatenate([one.boxes() for one in gaits])
    return walker, tolerance, states, frames, limit


class EndOfWalk(NamedTuple):
    """How a walk ends."""

    back: Bool[Array, "*cells"]
    """Whether the walker has come back to its gait, or to another that it may come to."""
    outcome: Int[Array, "*cells"]
    """Of its last stride."""
    strides: Int[Array, "*cells"]
    """Those completed."""


def which_walks(fall: bool) -> Callable[[EndOfWalk], Any]:
    """Tells of walks whether they end in a fall, or whether they do not lead back."""
    check_kind("fall", fall, bool)
    none = (Outcome.STRIDE, Outcome.UNDECIDED)
    return lambda walk: ~np.isin(walk.outcome, none) if fall else ~walk.back


def end_of_walk(shared: tuple, x: Float[Array, " section"]) -> EndOfWalk:
    """Walk on until a failure, or close to a gait, or for a number of strides."""
    walker, tolerance, states, frames, limit = shared

    def is_back(x):
        away = jnp.sum(frames * (x - states)[:, None], axis=2)
        return jnp.any(jnp.max(jnp.abs(away), axis=1) < 1)

    def going(carry):
        x, outcome, count = carry
        return (outcome == Outcome.STRIDE) & (count < limit) & ~is_back(x)

    def advance(carry):
        x, _, count = carry
        result = follow_stride(walker, x, tolerance)
        made = result.outcome == Outcome.STRIDE
        return result.state, result.outcome, count + made.astype(jnp.int32)

    first = x, jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.asarray(0, jnp.int32)
    x, outcome, count = lax.while_loop(going, advance, first)
    return EndOfWalk((outcome == Outcome.STRIDE) & is_back(x), outcome, count)


def end_after_step(shared: tuple, cell: tuple) -> EndOfWalk:
    """Step down from a state of the gait, and walk on, the stride down included in the count."""
    walker, tolerance, *_ = shared
    x, drop = cell
    down = follow_step_down(walker, x, drop, tolerance)
    after = follow_stride(walker, down.state, tolerance)
    rest = end_of_walk(shared, after.state)
    outcome = jnp.where(after.outcome == Outcome.STRIDE, rest.outcome, after.outcome)
    outcome = jnp.where(down.outcome == Outcome.STRIDE, outcome, down.outcome)
    count = rest.strides + sum(
        (one.outcome == Outcome.STRIDE).astype(jnp.int32) for one in (down, after)
    )
    return EndOfWalk(rest.back & (outcome == Outcome.STRIDE), outcome, count)


def change_of_margin(shared: tuple, cell: tuple) -> Scalar:
    """Derivative of the margin of the failure that ends a walk, after a number of strides.

    It is along tangents of the walker and of the start; NaN where the walk does not end there.
    """
    walker, tolerance = shared
    x, count, tangents = cell

    def margin(walker, x):
        step = lambda _, x: follow_stride(walker, x, tolerance).state
        return failed_by(follow_margins(walker, lax.fori_loop(0, count, step, x), tolerance))

    value, change = jax.jvp(margin, (walker, x), tangents)
    return jnp.where(jnp.isnan(value), jnp.nan, change)


def nearest_failure(
    fails: Callable[[Float[np.ndarray, "n size"]], Bool[np.ndarray, " n"]],
    basis: Float[np.ndarray, "rank size"],
    gradient: Callable[[Float[np.ndarray, "n size"]], Float[np.ndarray, "n size"]],
) -> Float[np.ndarray, " size"]:
    """The shortest vector in the span of a basis, of unit vectors at right angles, that fails.

    The origin does not. `gradient`, at points that fail just beyond the boundary, is at right
    angles to it, or NaN. `ComputationFailed` where nothing fails.
    """
    rank = len(basis)
    rays = directions(rank, RAYS)
    first = scanned(fails, rays @ basis, RADII)
    # Closer rays, then closer distances too: between those a nearer failure may have been missed.
    # A finger that was met may be missed by the next distances: then what was known is kept.
    dense = directions(rank, DENSE * RAYS)
    near = nearest_of(fails, dense, basis, 0.0, 1.01 * first.min(), SHELL)
    rays, first = near if near[1].size else (rays[np.isfinite(first)], first[np.isfinite(first)])
    near = nearest_of(fails, dense, basis, 0.9 * first.min(), 1.01 * first.min(), SHELL)
    rays, first = near if near[1].size else (rays, first)
    width = spacing(rank, DENSE * RAYS)
    if rank > 1:  # and more of them wherever the boundary is about as near
        arc = np.concatenate([fan(ray, width, CLOSER) for ray in rays[first.argsort()[:ARC]]])
        near = nearest_of(fails, arc, basis, 0.98 * first.min(), 1.003 * first.min(), 32)
        rays, first = near if near[1].size else (rays, first)
    width = 4 * width / CLOSER
    lowest_ones = lowest(rays, first, width)
    best, lengths = rays[lowest_ones], first[lowest_ones]
    for _ in range(ZOOMS if rank > 1 else 0):
        fans = np.concatenate([fan(ray, width, FAN) for ray in best])
        # The nearest failures of a fan lie a little before those of the wider one.
        least = lengths.min()
        rays, first = nearest_of(fails, fans, basis, 0.95 * least, 1.01 * least, 24)
        if first.size:
            lowest_ones = lowest(rays, first, width)
            best, lengths = rays[lowest_ones], first[lowest_ones]
        width *= 0.25

    gap = 1e-3 * lengths.min()
    closer = first_failures(fails, best @ basis, lengths.min() - gap, lengths.min() + gap, 8)
    closer = halved(fails, best @ basis, closer, gap / 4, HALVINGS[1])
    lengths = np.minimum(lengths, closer)
    for _ in range(POLISHES if rank > 1 else 0):
        with np.errstate(invalid="ignore", divide="ignore"):  # where there is no gradient
            normal = gradient(lengths[:, None] * best @ basis) @ basis.T
            along = normal / np.sum(normal * best, axis=1, keepdims=True) - best
        tried = best[:, None] + np.concatenate([[0.0], ALONG])[:, None] * along[:, None]
        tried = np.where(np.isfinite(tried), tried, best[:, None])
        tried /= np.linalg.norm(tried, axis=2, keepdims=True)
        flat, least = tried.reshape(-1, rank) @ basis, lengths.min()
        reached = first_failures(fails, flat, least - gap, least + gap, 8)
        reached = halved(fails, flat, reached, gap / 4, HALVINGS[1]).reshape(tried.shape[:2])
        reached[:, 0] = np.minimum(reached[:, 0], lengths)  # that ray is the best one so far
        best, lengths = tried[np.arange(len(best)), reached.argmin(axis=1)], reached.min(axis=1)
    least = lengths.min()
    ray = best[lengths.argmin()][None]
    while True:  # the first failure on its ray
        first = first_failures(fails, ray @ basis, 0.0, (1 - 1e-9) * least, LAST)
        if np.isinf(first[0]):
            return least * ray[0] @ basis
        least = halved(fails, ray @ basis, first, least / LAST, HALVINGS[1])[0]


def scanned(
    fails: Callable, rays: Float[np.ndarray, "n size"], count: int
) -> Float[np.ndarray, " n"]:
    """The first failure along each ray, up to where the nearest is between 1/4 and all of the way.

    `ComputationFailed` where nothing fails up to a length of a thousand.
    """
    reach = 0.1
    while True:
        first = first_failures(fails, rays, 0.0, reach, count)
        if np.isinf(first).all():
            if reach > 1e3:
                raise ComputationFailed(
                    "no failure found: the walker returns to its gait from all disturbances tried, "
                    f"of a size up to {reach:g}"
                )
            reach *= 4
        elif first.min() < reach / 4:
            reach = 2 * first.min()
        else:
            return first


def nearest_of(
    fails: Callable, rays: np.ndarray, basis: np.ndarray, low: float, high: float, count: int
) -> tuple[Float[np.ndarray, "n rank"], Float[np.ndarray, " n"]]:
    """Those of some rays along which the first failure is among the nearest, and its distance."""
    while True:
        gap = (high - low) / count
        first = first_failures(fails, rays @ basis, low, high, count)
        if low == 0 or first.min() > low + 1.5 * gap:
            break
        low, high = max(0.0, low - count * gap), low + gap  # there may be nearer ones
    near = first < max(first.min() + 1.5 * gap, (1 + KEPT) * first.min())
    return rays[near], halved(fails, rays[near] @ basis, first[near], gap, HALVINGS[0])


def first_failures(
    fails: Callable, rays: Float[np.ndarray, "n size"], low: Any, high: Any, count: int
) -> Float[np.ndarray, " n"]:
    """The first of some distances along each ray that fails; infinite where none does."""
    distances = np.linspace(low, high, count + 1)[1:]
    points = distances[:, None] * rays[:, None]
    failed = fails(points.reshape(-1, rays.shape[1])).reshape(len(rays), count)
    return np.where(failed.any(axis=1), distances[failed.argmax(axis=1)], np.inf)


def halved(
    fails: Callable,
    rays: Float[np.ndarray, "n size"],
    high: Float[np.ndarray, " n"],
    gap: float,
    times: int,
) -> Float[np.ndarray, " n"]:
    """Distances that fail, `gap` beyond ones that do not, brought down by halving."""
    known = np.isfinite(high)
    below, above = high[known] - gap, high[known]
    for _ in range(times):
        middle = (below + above) / 2
        failed = fails(middle[:, None] * rays[known])
        below, above = np.where(failed, below, middle), np.where(failed, middle, above)
    result = np.full(len(high), np.inf)
    result[known] = above
    return result


def directions(rank: int, count: int) -> Float[np.ndarray, "n rank"]:
    """Unit vectors, evenly spread, in three dimensions four times as many as in two."""
    if rank == 1:
        return np.array([[1.0], [-1.0]])
    if rank == 2:
        angles = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # a spiral of equal steps in height on a sphere, turned by the golden angle
    count *= 4
    height = 1 - (2 * np.arange(count) + 1) / count
    angles, radius = np.pi * (3 - np.sqrt(5)) * np.arange(count), np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=1)


def spacing(rank: int, count: int) -> float:
    """The angle between neighbours among them."""
    return 2 * np.pi / count if rank == 2 else float(np.sqrt(np.pi / count))


def fan(
    direction: Float[np.ndarray, " rank"], width: float, count: int
) -> Float[np.ndarray, "n rank"]:
    """Unit vectors within an angle of one, which is the first of them."""
    across = np.linalg.svd(direction[None])[2][1:]
    if len(across) == 1:
        offsets = np.linspace(-1, 1, count - 1)[:, None]
    else:
        angles = np.pi * (3 - np.sqrt(5)) * np.arange(count - 1)
        radius = np.sqrt((np.arange(count - 1) + 0.5) / (count - 1))
        offsets = radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rays = np.concatenate([direction[None], direction + width * offsets @ across])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def lowest(
    rays: Float[np.ndarray, "n rank"], lengths: Float[np.ndarray, " n"], angle: float
) -> Int[np.ndarray, " m"]:
    """Those of unit vectors that have a least length within an angle, the shortest first."""
    order = lengths.argsort()
    beside = rays[order] @ rays[order].T > np.cos(angle)
    shorter = np.tril(beside, -1).any(axis=1)
    return order[~shorter][:CANDIDATES]
