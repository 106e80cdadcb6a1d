"""The loss of walking in a boundary crisis: the parameter value beyond which all walkers fall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from walker_jax.checks import WrongUse, check_kind, check_number, refuses_tracers
from walker_jax.gaits.branches import Branch, check_interval, float64_tolerance
from walker_jax.gaits.long_runs import iterate_to_cycles, starts_near_gaits
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import with_parameter

VALUES_PER_PASS = 32
"""Parts into which one pass of the search divides an interval: enough walkers to fill all cores."""


class Loss(NamedTuple):
    """The two values of a parameter between which walking is lost."""

    below: float
    """The highest value tried at which a walker made all strides; NaN if none ever did."""
    above: float
    """The next value tried, at which all fell; NaN if one walks at the end of the interval."""
    strides: int
    """Strides after which a walker counts as walking."""


@refuses_tracers()
def loss_of_walking(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    branches: Sequence[Branch],
    *,
    strides: int = 3000,
    resolution: float = 1e-5,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Loss:
    """Find the boundary crisis: the value of a parameter above which all walkers fall.

    ```python
    walker = wj.SimplestWalker(slope=0.015)
    branch = wj.continue_gait(walker, "slope", (0.014, 0.022))
    wj.loss_of_walking(walker, "slope", (0.014, 0.022), [branch])
    ```

    The interval is divided into a row of values. At each of them walkers start near the gaits of
    the branches there, stable or not: unstable gaits are dense in a chaotic attractor. The next
    interval lies between the highest value at which one still walks after `strides` strides and the
    value above it. This is repeated until the interval is no wider than `resolution`.

    The search misses attractors that exist only between two values of a row, such as a gait that
    doubles to chaos soon after the fold at which it was born. Beyond the loss of the main attractor
    there may be such gaits; the branches show them.

    **Returns** a `Loss`. Otherwise as `attractors`.
    """
    tolerance = float64_tolerance(tolerance)
    below, above = check_interval(walker, parameter, interval)
    check_kind("branches", branches, Sequence)
    for branch in branches:
        check_kind("branches", branch, Branch)
    check_number("resolution", resolution)
    if not resolution > np.spacing(above):
        raise WrongUse(
            f"resolution must be a distance, and larger than rounding errors, not {resolution}"
        )
    while True:
        count = min(VALUES_PER_PASS, int(np.ceil((above - below) / resolution)) + 1)
        values = np.linspace(below, above, count + 1)
        starts = starts_near_gaits(walker, parameter, branches, values, tolerance)
        keep = np.isfinite(starts).all(axis=2)
        where = np.nonzero(keep)[0]
        walks = np.zeros(len(values), bool)
        if len(where):
            walkers = with_parameter(walker, parameter, values[where])
            end = iterate_to_cycles(walkers, starts[keep], strides, Integrator(tolerance), progress)
            walks[where[end.outcome == Outcome.STRIDE]] = True
        if not walks.any():
            return Loss(np.nan, below, strides)
        last = int(np.flatnonzero(walks)[-1])
        if last == len(values) - 1:
            return Loss(above, np.nan, strides)
        below, above = float(values[last]), float(values[last + 1])
        if above - below <= resolution:
            return Loss(below, above, strides)
