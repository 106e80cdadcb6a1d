"""Bifurcation diagrams: all gaits of a walker over a parameter, and its attractors.

Searches find gaits at some values of the parameter. Continuation from these (`branches`) shows how
each gait is born, loses its stability and ends. Walkers that start near the gaits, stable or not,
converge to the attractors, which are gaits or aperiodic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from walker_jax.checks import check_kind, check_whole, refuses_tracers
from walker_jax.execution.progress import bar
from walker_jax.gaits.branch_search import find_descendants, grow_branches
from walker_jax.gaits.branches import (
    Branch,
    add_normal_forms,
    check_interval,
    float64_tolerance,
)
from walker_jax.gaits.crises import Loss, loss_of_walking
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.exponents import lyapunov
from walker_jax.gaits.long_runs import attractors, starts_near_gaits
from walker_jax.integrators.roots import Real
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_source, with_parameter

NO_START = -1
"""Fate of missing starts, at values with fewer starts than others."""
WALKS, SETTLING = 4, 100
"""Walks for the exponents at each value of the scan, and strides before they count. The walks begin
on the attractor, so only their frames have to settle."""


@refuses_tracers()
def bifurcation_diagram(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    *,
    period_max: int = 8,
    strides: int = 3000,
    scan: int = 300,
    exponents: int = 400,
    normal_forms: bool = False,
    tolerance: Real | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Compute the gaits over a range of a parameter, their bifurcations, and the attractors.

    ```python
    walker = wj.SimplestWalker(slope=0.015)
    diagram = wj.bifurcation_diagram(walker, "slope", (0.012, 0.02))
    diagram["event_value"], diagram["lost"]
    ```

    Searches from the walker's `gait_region`, at `SEARCH_VALUES` values in the range, find gaits of
    all periods up to `period_max` or `LONGEST_SEARCHED_PERIOD`. Their branches are followed, and
    so are the branches that leave them at period doublings, up to `period_max`. Then walkers start
    near the gaits at `scan` values, and at more values where walking is lost. The diagram may miss
    a branch between two neighbouring values, and a gait to which no search converges.

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of the parameter.
    - `period_max`: longest period of the branches.
    - `strides`: number of strides before a walker counts as converging to an attractor.
    - `scan`: number of values at which the attractors are recorded; as many again lie between the
      first doubling of the cascade and the loss of walking.
    - `exponents`: number of strides over which Lyapunov exponents are averaged, at the same values;
      0 for none.
    - `normal_forms`: whether to compute normal forms at bifurcations, as in `continue_gait`.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** a data set over these dimensions:

    - `gait`, the points of all branches, one branch after the other: `branch` (a number), `period`,
      `value` of the parameter, `states`, `step_times`, `multipliers` (real and imaginary part),
      `stable`, and whether it is `on_cascade`; NaN after the period;
    - `event`, the bifurcations: `event_fold` (a fold, or a doubling), `event_branch`,
      `event_period`, `event_value`, `event_states`, `event_multipliers`, `event_coefficient` of the
      normal form (`gaits.normal_forms`), and whether it belongs to the `cascade`, the doublings of
      the most stable period-one gait (the simplest walker's long one) and of its descendants;
    - `torus`, the Neimark-Sacker points, where a pair of multipliers leaves the unit circle:
      `torus_branch`, `torus_period`, `torus_value`, `torus_states`, `torus_multipliers` and
      `torus_coefficient`;
    - `sample`, the values of the scan: `sample_value`, and the results of `attractors`: `fate`,
      `strides`, `orbit` and `attractor_period`, each over `start` too, with one start near each
      gait; a fate of -1 marks missing starts; and the Lyapunov `exponents` of the first attractor
      among these, with their errors `exponent_errors`.

    `lost` has the two values between which walking is lost, as `Loss`.

    Raises `ValueError` for a wrong parameter, range or number.
    """
    tolerance = float64_tolerance(tolerance)
    interval = check_interval(walker, parameter, interval)
    check_whole("period_max", period_max)
    check_whole("scan", scan)
    check_whole("exponents", exponents, 0)
    check_kind("normal_forms", normal_forms, bool)
    how: Any = {"tolerance": tolerance, "progress": progress}
    *_, found = grow_branches(walker, parameter, interval, period_max, **how)
    how |= {"strides": strides, "scan": scan, "exponents": exponents, "normal_forms": normal_forms}
    return complete_diagram(walker, parameter, interval, *found, **how)


def complete_diagram(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    branches: list[Branch],
    parents: list[int],
    *,
    strides: int,
    scan: int,
    exponents: int,
    normal_forms: bool,
    tolerance: Real,
    progress: bool = False,
) -> xr.Dataset:
    """Complete the diagram of these branches: the cascade, the loss of walking, the attractors."""
    low, high = interval
    members = find_descendants(branches, parents)
    if normal_forms:
        with bar("normal forms", progress):
            branches = add_normal_forms(walker, parameter, branches, tolerance=tolerance)
    options: Any = dict(tolerance=tolerance, progress="walkers" if progress else None)
    with bar("where walking is lost", progress):
        loss = loss_of_walking(walker, parameter, (low, high), branches, strides=strides, **options)
    values = np.linspace(low, high, scan)
    doublings = [b.value for i in members for b in branches[i].doublings]
    if doublings and min(doublings) < loss.above:
        values = np.union1d(values, np.linspace(min(doublings), loss.above, scan))
    with bar("gaits at each value", progress):
        starts = starts_near_gaits(walker, parameter, branches, values, tolerance)
    with bar("attractors", progress):
        scanned = attractors(walker, parameter, values, starts, strides=strides, **options)
    scanned["fate"] = scanned["fate"].where(np.isfinite(starts).all(axis=2), NO_START)
    if exponents:
        with bar("Lyapunov exponents", progress):
            add_exponents(walker, parameter, scanned, exponents, tolerance)
    return assemble_diagram(walker, parameter, branches, members, scanned, loss)


def add_exponents(
    walker: System, parameter: str, scanned: xr.Dataset, strides: int, tolerance: Real
) -> None:
    """Add the exponents of the first attractor at each value to the result of `attractors`."""
    walks = scanned["fate"].values == Outcome.STRIDE
    chosen = np.arange(len(walks)), walks.argmax(axis=1)
    known = walks.any(axis=1)
    values = np.full((2, len(walks), len(walker.section)), np.nan)
    if known.any():
        found = lyapunov(
            with_parameter(walker, parameter, scanned["value"].values[known]),
            scanned["orbit"].values[:, :, -1][chosen][known],
            strides,
            walks=WALKS,
            settling=SETTLING,
            tolerance=tolerance,
        )
        values[:, known] = found.exponents, found.errors
    for name, value in zip(("exponents", "exponent_errors"), values, strict=True):
        scanned[name] = ("value", "order"), value


def assemble_diagram(
    walker: System,
    parameter: str,
    branches: list[Branch],
    members: list[int],
    scanned: xr.Dataset,
    loss: Loss,
) -> xr.Dataset:
    """Assemble the data set that `bifurcation_diagram` returns."""
    events = [(i, b) for i, one in enumerate(branches) for b in (*one.folds, *one.doublings)]
    tori = [(i, b) for i, one in enumerate(branches) for b in one.neimark_sackers]
    shape = max((branch.period for branch in branches), default=1), len(walker.section)
    return xr.Dataset(
        {
            **variables_of_branches(branches, members, shape),
            "event_fold": ("event", np.array([b.kind == "fold" for _, b in events], bool)),
            **variables_of_events(events, "event", shape),
            **variables_of_events(tori, "torus", shape),
            "cascade": ("event", np.array([i in members for i, _ in events], bool)),
            "sample_value": ("sample", scanned["value"].values),
            "fate": (("sample", "start"), scanned["fate"].values),
            "strides": (("sample", "start"), scanned["strides"].values),
            "attractor_period": (("sample", "start"), scanned["period"].values),
            "orbit": (("sample", "start", "recent", "coordinate"), scanned["orbit"].values),
            "lost": ("side", np.array([loss.below, loss.above])),
            **{
                name: (("sample", "order"), scanned[name].values)
                for name in ("exponents", "exponent_errors")
                if name in scanned
            },
        },
        attrs={
            **describe_source(walker, without=[parameter]),
            "parameter": parameter,
            "lost_strides": loss.strides,
            "scan_strides": scanned.attrs["strides"],
        },
    )


def variables_of_branches(
    branches: list[Branch], members: list[int], shape: tuple[int, int]
) -> dict[str, tuple]:
    """Return the gaits of all branches, one after the other; `shape` is that of a cycle."""
    counts, numbers = [len(branch.values) for branch in branches], np.arange(len(branches))
    joined = lambda arrays, dtype: np.concatenate([np.zeros(0, dtype), *arrays]).astype(dtype)
    multipliers = real_and_imaginary([b.multipliers for b in branches], shape[1])
    return {
        "branch": ("gait", np.repeat(numbers, counts)),
        "period": ("gait", np.repeat([b.period for b in branches], counts).astype(int)),
        "value": ("gait", joined([b.values for b in branches], float)),
        "states": (("gait", "phase", "coordinate"), pad([b.states for b in branches], *shape)),
        "step_times": (("gait", "phase"), pad([b.step_times for b in branches], shape[0])),
        "multipliers": (("gait", "order", "part"), multipliers),
        "stable": ("gait", joined([b.stable for b in branches], bool)),
        "on_cascade": ("gait", np.repeat(np.isin(numbers, members), counts)),
    }


def variables_of_events(
    events: list[tuple[int, Bifurcation]], name: str, shape: tuple[int, int]
) -> dict[str, tuple]:
    """Return bifurcations with the numbers of their branches, over a dimension of this name."""
    found = [b for _, b in events]
    multipliers = real_and_imaginary([b.multipliers[None] for b in found], shape[1])
    states = pad([b.states[None] for b in found], *shape)
    return {
        f"{name}_branch": (name, np.array([i for i, _ in events], int)),
        f"{name}_period": (name, np.array([len(b.states) for b in found], int)),
        f"{name}_value": (name, np.array([b.value for b in found], float)),
        f"{name}_states": ((name, "phase", "coordinate"), states),
        f"{name}_multipliers": ((name, "order", "part"), multipliers),
        f"{name}_coefficient": (name, np.array([b.coefficient for b in found], float)),
    }


def pad(arrays: list[np.ndarray], phases: int, *shape: int) -> np.ndarray:
    """Concatenate arrays over (points, period, ...), padded with NaN after each period."""
    full = [np.full((len(a), phases, *shape), np.nan) for a in arrays]
    for padded, a in zip(full, arrays, strict=True):
        padded[:, : a.shape[1]] = a
    return np.concatenate([np.zeros((0, phases, *shape)), *full])


def real_and_imaginary(multipliers: list[np.ndarray], size: int) -> np.ndarray:
    """Concatenate rows of `size` multipliers, each as its real and imaginary part."""
    whole = np.concatenate([np.zeros((0, size), complex), *multipliers])
    return np.stack([np.real(whole), np.imag(whole)], axis=-1)
