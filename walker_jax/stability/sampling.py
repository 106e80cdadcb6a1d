"""Basin stability: the fraction of random disturbances from which a walker returns to its gait.

The same starts also show the way back: the number of strides, also per unit of the disturbance, and
the sizes of disturbances that the walker survives. The terms are those of the stability quantifiers
of Attractors.jl, but three definitions differ. Means here are over the starts that return; there,
sums over these are divided by the weight of all starts. The size of a disturbance here is its
distance from the nearest state of the gait; there, by default, from the centroid of the states. The
pace is undefined here at zero disturbance; there, up to a distance, it is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.basins.attractor import cubes
from walker_jax.basins.computation import check_grid
from walker_jax.checks import (
    WrongUse,
    check_number,
    check_whole,
    is_number,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.stability.gait_mapper import mapper_of_gait
from walker_jax.stability.metric import CurvedMetric, DistanceFunction, LinearMetric, metric_of
from walker_jax.systems.outcomes import OUTCOMES
from walker_jax.systems.system import System
from walker_jax.systems.trees import select, sizes_of_many
from walker_jax.walking.iteration import check_parameter_arrays

NOT_MEASURED = np.array(np.nan)
Sampler = Callable[[np.random.Generator, int], Float[np.ndarray, "n section"]]
"""Draws a number of starts on the section, of any distribution, by a generator."""


class BasinStability(NamedTuple):
    """Basin stability (Menck and others 2013), and measures of the return to the gait."""

    value: Float[np.ndarray, "*walkers"]
    """The fraction of the starts from which the walker returns to its gait."""
    low: Float[np.ndarray, "*walkers"]
    high: Float[np.ndarray, "*walkers"]
    """Ends of Wilson's confidence interval."""
    fates: Int[np.ndarray, "*walkers outcomes"]
    """Number of starts by the `Outcome` of their last stride. Of those with `STRIDE`, `elsewhere`
    still walk but did not return."""
    elsewhere: Int[np.ndarray, "*walkers"]
    median: Float[np.ndarray, "*walkers"]
    """Median strides, of the starts that return, to come within a distance of the gait."""
    slowest: Float[np.ndarray, "*walkers"]
    """The 95 % quantile of these strides; infinite where fewer come that close, NaN where none
    return."""
    mean: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """Mean of these strides; infinite where a walker does not come that close."""
    pace: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """Mean strides per unit of the disturbance, of the starts that return."""
    median_pace: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """Median strides per unit of the disturbance."""
    in_time: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """The fraction of the starts from which the walker is that close within `horizon` strides."""
    mean_shock: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """Mean size of the disturbances from which the walker returns: noncritical shocks."""
    largest_shock: Float[np.ndarray, "*walkers"] = NOT_MEASURED
    """The largest of these sizes. It grows with the samples, up to the reach of the basin."""


@refuses_tracers()
def basin_stability(
    walker: System,
    disturbances: float | Grid | Sampler,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    metric: Sequence[Any] | ArrayLike | DistanceFunction | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    within: float | None = 1e-6,
    horizon: int = 10,
    samples: int = 10_000,
    strides: int = 500,
    confidence: float = 0.95,
    seed: int = 0,
    tolerance: float | None = None,
) -> BasinStability:
    """Estimate the fraction of random disturbances from which a walker returns to its gait.

    ```python
    found = wj.basin_stability(wj.SimplestWalker(0.004), 0.02, samples=1000)
    found.value, found.low, found.high
    found.median  # strides in which half of those that return are back
    ```

    **Arguments:**

    - `walker`: its parameters are numbers, or arrays of n, as in `strides`. For arrays the results
      are arrays of n, NaN where there is no stable gait.
    - `disturbances`: largest length of disturbances of the gait's first state, uniformly
      distributed in the metric of `least_disturbance` with `scale` and `along`, or with a matrix as
      `metric`. Or a grid, in whose region of the section starts are uniformly distributed. Or a
      function of a NumPy generator and a number n, which draws n starts of any distribution.
    - `gait`: a stable gait, for a single walker; that of `find_gait` by default.
    - `metric`: as in `least_disturbance`. For a grid or a function it only measures the sizes of
      disturbances, from the nearest state of the gait.
    - `within`: distance of a state of the gait, in every coordinate, to which strides are counted.
      With None they are not counted, which spares most strides; all measures of the way back are
      then NaN.
    - `horizon`: number of strides within which a walker is `in_time`.
    - `samples`: number of starts for each walker, the same disturbances for all.
    - `strides`: number of strides in which a walker may come that close, or enter the gait's
      capture box, from which all walkers converge to it.
    - `confidence`: of the interval.
    - `seed`, `tolerance`: as in `refine`.

    Raises `ValueError` for a single walker without a stable gait, and for arguments out of range.
    """
    sizes = metric_of(walker, scale, along, metric)
    if within is not None:
        check_number("within", within)
        if not within > 0:
            raise WrongUse(f"within must be positive, not {within}")
    check_whole("horizon", horizon)
    count = count_walkers(walker, gait)
    rng, turned = np.random.default_rng(seed), scale is not None or along is not None
    about = starts_about(walker, disturbances, sizes, rng, samples, turned=turned)
    trial = Trial(about, sizes, within, horizon, strides, confidence, tolerance)
    if count is None:
        return BasinStability(*map(np.asarray, measure_returns(walker, gait, trial)))
    rows = []
    for i in range(count):
        single = select(walker, i)
        gait = search_gait(single, tolerance=tolerance)
        if gait.found and gait.stable:
            rows.append(measure_returns(single, gait, trial))
        else:
            rows.append((*3 * (np.nan,), np.zeros(OUTCOMES, int), 0, *8 * (np.nan,)))
    return BasinStability(*map(np.array, zip(*rows, strict=True)))


class Trial(NamedTuple):
    """The starts of `basin_stability` around a state, and the settings of the measurement."""

    about: Callable[[Any], Float[np.ndarray, "n section"]]
    sizes: LinearMetric | CurvedMetric
    within: float | None
    horizon: int
    strides: int
    confidence: float
    tolerance: float | None


def count_walkers(walker: System, gait: Gait | None) -> int | None:
    """Return the number of walkers that array parameters describe; None for a single walker."""
    counts = sizes_of_many(walker)
    if not counts:
        return None
    if gait is not None:
        raise WrongUse("gait must be left out for walkers with arrays for parameters")
    check_parameter_arrays(walker, max(counts))
    if 0 in counts:
        raise WrongUse("walker must be one or more, and its parameters are arrays of none")
    return max(counts)


def starts_about(
    walker: System,
    disturbances: float | Grid | Sampler,
    sizes: LinearMetric | CurvedMetric,
    rng: np.random.Generator,
    samples: int,
    *,
    turned: bool,
) -> Callable[[Any], Float[np.ndarray, "n section"]]:
    """Return a function from a state to starts; those of a grid or a function are fixed.

    Raises `WrongUse` for wrong disturbances, and a metric or directions that do not fit them.
    """
    if is_number(disturbances) and 0 < disturbances < np.inf:
        if isinstance(sizes, CurvedMetric):
            raise WrongUse("metric must be a matrix where disturbances is a number, not a function")
        y = draw_from_ball(rng, samples, len(sizes.basis)) @ sizes.basis
        return lambda state: state + sizes.disturbance(state, y) * disturbances
    starts = draw_starts(walker, "disturbances", disturbances, rng, samples, "a positive number, ")
    if turned:
        raise WrongUse("scale and along must be left out where disturbances is not a number")
    return lambda state: starts


def measure_returns(walker: System, gait: Gait | None, trial: Trial) -> tuple:
    """Measure the fields of `BasinStability` for one walker, in their order."""
    mapper = mapper_of_gait(walker, gait, trial.strides, trial.tolerance)
    (own,) = mapper.attractors
    starts = trial.about(own.states[0]).astype(own.states.dtype)
    labels, samples = mapper(starts), len(starts)
    fates = np.bincount(labels.fate, minlength=OUTCOMES)
    returned = int(labels.converged.sum())
    interval = wilson_interval(returned, samples, trial.confidence)
    counts = returned / samples, *interval, fates, len(labels.remaining)
    back = starts[labels.converged]
    shocks = nan_if_none(np.min([trial.sizes.size(x, back) for x in own.states], axis=0))
    shock = shocks.mean(), shocks.max()
    if trial.within is None:
        return *counts, *6 * (np.nan,), *shock
    close = mapper._replace(attractors=[own._replace(capture_boxes=cubes(own, trial.within))])
    closer = close.walk(back)
    made = nan_if_none(np.where(closer.converged, closer.strides, np.inf))
    late = np.percentile(made, (50, 95), method="inverted_cdf")
    beyond = shocks > 0  # a start at the gait itself has no pace
    paces = nan_if_none(made[beyond] / shocks[beyond])
    pace = paces.mean(), np.percentile(paces, 50, method="inverted_cdf")
    in_time = np.sum(made <= trial.horizon) / samples
    return *counts, *late, made.mean(), *pace, in_time, *shock


def draw_starts(
    walker: System, name: str, draw: Any, rng: np.random.Generator, samples: int, or_else: str = ""
) -> Float[np.ndarray, "n section"]:
    """Draw starts in the region of a grid, or by a function; `name` is that of the argument.

    Raises `WrongUse` for anything else, and says which kinds there are besides.
    """
    if isinstance(draw, Grid):
        check_grid(walker, draw, "direct")
        return draw.points_at(rng.uniform(size=(samples, len(draw.names))))
    if not callable(draw):
        raise WrongUse(
            f"{name} must be {or_else}a grid, or a function that draws starts, not {short(draw)}"
        )
    starts = numbers(f"starts that {name} returns", draw(rng, samples))
    if starts.shape != (samples, len(walker.section)) or not np.isfinite(starts).all():
        raise WrongUse(
            f"{name} must return {samples} finite starts on the section "
            f"{', '.join(walker.section)}, not an array of shape {starts.shape}"
        )
    return starts


def nan_if_none(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the values, or one NaN if there are none."""
    return values if values.size else np.full(1, np.nan)


def draw_from_ball(rng: np.random.Generator, n: int, rank: int) -> Float[np.ndarray, "n rank"]:
    """Draw points uniformly distributed in the unit ball."""
    x = rng.normal(size=(n, rank))
    radius = rng.uniform(size=(n, 1)) ** (1 / rank)
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True)


def wilson_interval(successes: int, n: int, confidence: float) -> tuple[float, float]:
    """Compute Wilson's interval for a probability, from the number of successes in n trials."""
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    centre, spread = successes + z**2 / 2, z * np.sqrt(successes * (1 - successes / n) + z**2 / 4)
    return float((centre - spread) / (n + z**2)), float((centre + spread) / (n + z**2))
