"""Attractors and their basins over a parameter: fractions of a region, with attractors matched.

Random starts in the region, the same for all values, show the share that converges to each
attractor. An attracting gait is followed over the whole range (`gaits.branches`), as far as it
exists. So it is known beforehand at every value, however small its basin, and it keeps its number.
A walker that converges to no known attractor leads to a new one. An attractor is thus born where
its branch becomes stable, as at a fold or a period doubling, and ends where it becomes unstable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.attractor_search import label_and_find
from walker_jax.basins.computation import check_grid
from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.matching import NONE, match_clouds, match_cycles
from walker_jax.basins.refinement import check_memory_of_starts
from walker_jax.basins.windows import default_region
from walker_jax.checks import (
    WrongUse,
    check_kind,
    numbers,
    refuses_tracers,
)
from walker_jax.execution.progress import track
from walker_jax.gaits.branches import (
    Branch,
    continue_gaits,
    float64_tolerance,
    interpolate_cycles,
    solve_at,
)
from walker_jax.gaits.continuation import Start
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.sampling import wilson_interval
from walker_jax.storage.schema import with_dims
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import OUTCOMES
from walker_jax.systems.system import System, check_single
from walker_jax.walkers.parameters import check_parameter, describe_source, with_parameter
from walker_jax.walking.iteration import orbits

SAME_CYCLE = 1e-6
"""Distance within which a cycle is the one of its branch: rounding errors, and the remaining
distance of a walker that converges slowly."""
CONFIDENCE = 0.95
"""Confidence of the intervals of fractions."""


STATES = 64
"""Number of states kept of a motion without a period."""


class Found(NamedTuple):
    """The attractors at one value, and the labels of the starts."""

    names: list[int]
    """Number of each attractor, the same over all values."""
    attractors: list[Attractor]
    labels: Label


@refuses_tracers()
def continue_basins(
    walker: System,
    parameter: str,
    values: Sequence[Any] | ArrayLike,
    region: Grid | None = None,
    *,
    samples: int = 100_000,
    strides: int = 500,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Follow attractors over a parameter, with the fraction of a region that each basin takes.

    A gait keeps its number along its branch; a gait of twice the period that branches off has
    another number. A motion without a period keeps its number from one value to the next; of
    several, each takes the number of the nearest.

    ```python
    walker, slopes = wj.SimplestWalker(0.004), [0.004, 0.009, 0.015]
    data = wj.continue_basins(walker, "slope", slopes, samples=2000)
    data.fraction.values  # one row a slope, one column an attractor
    ```

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of one of its parameters.
    - `values`: two or more values of it, in ascending order.
    - `region`: grid or slice whose region holds the starts; by default that of `robustness`.
    - `samples`: number of starts, uniformly distributed in the region, the same for all values.
    - `strides`, `seed`, `tolerance`, `progress`: as in `refine`.

    **Returns** a data set. Over the `value` and the `attractor` it has

    - `fraction`: share of the starts that converge to it, with the ends `fraction_low` and
      `fraction_high` of Wilson's 95 % interval; NaN at values where it does not attract;
    - `states`: its states there, or `STATES` states of a motion without a period.

    Over the attractors it has `period`, 0 for a motion without one, and the `first` and the `last`
    value at which each attracts. `failed` is the fraction that converges to no attractor, by the
    `Outcome` of the last stride; `STRIDE` stands for walkers still walking then. Over the
    bifurcations of the gaits' branches it has `event_attractor`, `event_value`, and `event_fold`,
    true for a fold and false for a period doubling.

    Raises `ValueError` for a wrong parameter, values that are not in order, and a region that does
    not fit the walker.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    values = numbers("values", values).astype(float)
    if values.ndim != 1 or len(values) < 2 or not (np.diff(values) > 0).all():
        raise WrongUse(f"values must be two or more in ascending order, not {values.tolist()}")
    check_parameter(walker, parameter, *values.tolist())
    tolerance = float(float64_tolerance(tolerance))
    check_memory_of_starts("samples", samples)
    first = with_parameter(walker, parameter, float(values[0]))
    region = default_region(first) if region is None else region
    if region is None:
        raise WrongUse("region is required where no gait of period one is found")
    check_grid(walker, region, "direct")
    shares = np.random.default_rng(seed).uniform(size=(samples, len(region.names)))
    starts = region.points_at(shares).astype(jnp.result_type(float))
    family = Family(walker, parameter, (float(values[0]), float(values[-1])), tolerance)
    found = [
        family.attractors_at(value, starts, strides) for value in track(values, parameter, progress)
    ]
    about = {
        "parameter": parameter,
        **describe_source(walker, without=[parameter]),
        "samples": int(samples),
        "strides": int(strides),
        "seed": int(seed),
        "tolerance": tolerance,
    }
    return assemble(values, found, family.branches, samples).assign_attrs(about)


class Family:
    """The attractors over a parameter so far, with a branch for each that has a period."""

    def __init__(
        self, walker: System, parameter: str, interval: tuple[float, float], tolerance: float
    ):
        self.walker, self.parameter, self.interval = walker, parameter, interval
        self.tolerance, self.integrator = tolerance, Integrator(tolerance)
        self.branches: list[Branch | None] = []
        self.without_period: dict[int, Attractor] = {}
        """The motions without a period at the last value, by their numbers."""

    def attractors_at(
        self, value: float, starts: Float[np.ndarray, "n section"], strides: int
    ) -> Found:
        """Find the attractors at a value above all previous ones, and the labels of starts."""
        there = with_parameter(self.walker, self.parameter, float(value))
        names, known = [], []
        for name, cycle in self.cycles_at(value):
            gait = search_gait(there, cycle, len(cycle), tolerance=self.tolerance)
            if gait.found and gait.stable:
                states = np.asarray(gait.states)
                names.append(name)
                states = np.roll(states, -int(states[:, 0].argmin()), axis=0)
                known.append(Attractor(states))
        mapper = Mapper(there, known, self.integrator, strides)
        labels, mapper, _ = label_and_find(mapper, starts)
        names += self.names_of(value, mapper.attractors[len(known) :], names)
        self.without_period = {
            name: one
            for name, one in zip(names, mapper.attractors, strict=True)
            if one.period is None
        }
        shown = [
            one
            if one.period
            else one._replace(states=orbits(there, one.states, STATES - 1, self.integrator)[0][0])
            for one in mapper.attractors
        ]
        return Found(names, shown, labels)

    def cycles_at(self, value: float) -> list[tuple[int, Float[np.ndarray, "_ section"]]]:
        """Return the gaits of all branches at a value, stable or not, with their numbers."""
        guesses = [
            (name, cycle)
            for name, branch in enumerate(self.branches)
            if branch is not None
            for cycle in interpolate_cycles(branch, value)
        ]
        at = [(float(value), cycle) for _, cycle in guesses]
        cycles = solve_at(self.walker, self.parameter, at, self.tolerance)
        return [
            (name, cycle)
            for (name, _), cycle in zip(guesses, cycles, strict=True)
            if cycle is not None
        ]

    def names_of(self, value: float, found: list[Attractor], taken: list[int]) -> list[int]:
        """Return the numbers of attractors that were not known beforehand at a value."""
        names: list[int] = []
        before = list(self.without_period)
        clouds = [one.points for one in found if one.period is None]
        matches = match_clouds(clouds, [one.points for one in self.without_period.values()])
        wandering = iter(matches)
        for one in found:
            branch, name = None, NONE
            if one.period is None:
                match = next(wandering)
                name = NONE if match == NONE else before[match]
            else:
                others = self.cycles_at(value)
                known = [cycle for _, cycle in others]
                turns = turns_of(self.walker)
                (match,) = match_cycles([one.states], known, SAME_CYCLE, turns)
                name = NONE if match == NONE else others[match][0]
                if name == NONE or name in (*taken, *names):
                    name, start = NONE, Start(float(value), one.states)
                    (branch,) = continue_gaits(
                        self.walker,
                        self.parameter,
                        self.interval,
                        [start],
                        tolerance=self.tolerance,
                    )
            if name == NONE:
                name = len(self.branches)
                self.branches.append(branch)
            names.append(name)
        return names


def assemble(
    values: Float[np.ndarray, " values"],
    at_values: list[Found],
    branches: list[Branch | None],
    samples: int,
) -> xr.Dataset:
    """Make the data set that `continue_basins` returns."""
    count, size = len(branches), at_values[0].labels.state.shape[1]
    longest = max((len(one.states) for each in at_values for one in each.attractors), default=1)
    period = np.zeros(count, int)
    states = np.full((len(values), count, longest, size), np.nan)
    shares = np.full((3, len(values), count), np.nan)
    failed = np.zeros((len(values), OUTCOMES))
    for i, (names, attractors, labels) in enumerate(at_values):
        lost = labels.fate[~labels.converged]
        failed[i] = np.bincount(lost, minlength=OUTCOMES) / samples
        for name in dict.fromkeys(names):  # a branch that turns back may have two stable gaits
            numbers = [number for number, other in enumerate(names) if other == name]
            reached = int(np.isin(labels.attractor, numbers).sum())
            one = attractors[numbers[0]]
            shares[:, i, name] = reached / samples, *wilson_interval(reached, samples, CONFIDENCE)
            states[i, name, : len(one.states)] = one.states
            period[name] = one.period or 0
    present = np.isfinite(shares[0])
    events = [
        (name, event)
        for name, branch in enumerate(branches)
        if branch is not None
        for event in (*branch.folds, *branch.doublings)
    ]
    found = {
        "fraction": shares[0],
        "fraction_low": shares[1],
        "fraction_high": shares[2],
        "failed": failed,
        "states": states,
        "period": period,
        "first": np.array([values[there][0] for there in present.T], float),
        "last": np.array([values[there][-1] for there in present.T], float),
        "event_attractor": np.array([name for name, _ in events], int),
        "event_value": np.array([event.value for _, event in events], float),
        "event_fold": np.array([event.kind == "fold" for _, event in events], bool),
    }
    coordinates = {"value": values, "attractor": np.arange(count)}
    return xr.Dataset(with_dims("basin fractions", found), coordinates)


def summarise_fractions(data: xr.Dataset) -> dict:
    """Return the attractors of `continue_basins` and their bifurcations, for JSON."""
    fraction = data["fraction"].values
    attractors = [
        {
            "number": i,
            "period": int(data["period"][i]) or None,
            "first": float(data["first"][i]),
            "last": float(data["last"][i]),
            "largest_fraction": float(np.nanmax(fraction[:, i])),
        }
        for i in range(data.sizes["attractor"])
    ]
    events = [
        {
            "attractor": int(data["event_attractor"][i]),
            "kind": "fold" if data["event_fold"][i] else "doubling",
            "value": float(data["event_value"][i]),
        }
        for i in range(data.sizes["event"])
    ]
    return {"attractors": attractors, "bifurcations": events}
