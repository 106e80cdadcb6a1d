"""Where walking is lost, a boundary crisis: the parameter beyond which all walkers fall."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from walker_jax.checks import WrongUse, check_kind, check_number, check_whole, refuses_tracers
from walker_jax.gaits.branches import Branch, check_interval, double_tolerance
from walker_jax.gaits.long_runs import starts_near_gaits
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.iteration import iterate
from walker_jax.walking.outcomes import Outcome

PARTS = 32
"""In which an interval is divided, at once, in search of the loss of walking."""


class Loss(NamedTuple):
    """Between which two values of a parameter walkers stop walking on."""

    below: float
    """The highest value tried at which one walked to the end; NaN where none did at any."""
    above: float
    """The next value tried, at which all fell; NaN where one walks on at the interval's end."""
    strides: int
    """That a walker had to make."""


@refuses_tracers()
def loss_of_walking(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    branches: Sequence[Branch],
    *,
    strides: int = 3000,
    resolution: float = 1e-5,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Loss:
    """Where walking is lost: the value of a parameter above which walkers fall.

    At each of a row of values walkers start beside the gaits of the branches there, stable or not:
    an attractor without a period has unstable gaits all through it. The interval between the
    highest value at which one still walks after `strides` strides and the next is divided again,
    until it is no wider than `resolution`. What attracts walkers between two values of a row only
    is missed, such as a gait that doubles to chaos soon after the fold it was born in: beyond the
    loss of the main attractor there may be such gaits, and the branches show them.

    **Returns** a `Loss`. As `attractors` otherwise.
    """
    tolerance = double_tolerance(tolerance)
    below, above = check_interval(walker, parameter, interval)
    check_whole("strides", strides)
    check_kind("branches", branches, Sequence)
    for branch in branches:
        check_kind("branches", branch, Branch)
    check_number("resolution", resolution)
    if not resolution > np.spacing(above):
        raise WrongUse(f"resolution must be a distance, and wider than rounding, not {resolution}")
    while True:
        parts = min(PARTS, int(np.ceil((above - below) / resolution)) + 1)
        values = np.linspace(below, above, parts + 1)
        starts = starts_near_gaits(walker, parameter, branches, values, tolerance)
        keep = np.isfinite(starts).all(axis=2)
        where = np.nonzero(keep)[0]
        walks = np.zeros(len(values), bool)
        if len(where):
            walkers = with_parameter(walker, parameter, values[where])
            end = iterate(walkers, starts[keep], strides, tolerance, progress=progress)
            walks[where[end.outcome == Outcome.STRIDE]] = True
        if not walks.any():
            return Loss(np.nan, below, strides)
        last = int(np.flatnonzero(walks)[-1])
        if last == len(values) - 1:
            return Loss(above, np.nan, strides)
        below, above = float(values[last]), float(values[last + 1])
        if above - below <= resolution:
            return Loss(below, above, strides)
