"""A search for all branches of gaits over an interval of a parameter.

Searches find gaits at some values of the parameter. Continuation follows each to the ends of its
branch, and then the gaits of twice the period that branch off there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from walker_jax.execution.progress import track
from walker_jax.gaits.branches import Branch, continue_gaits, interpolate_cycles, solve_at
from walker_jax.gaits.continuation import Start, start_at_doubling
from walker_jax.gaits.cycles import Gait, cycle_distance, iterate_newton
from walker_jax.gaits.long_runs import RECURRENCE_DISTANCE
from walker_jax.gaits.search import cycle_guesses, remove_duplicates
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walkers.parameters import check_parameter, value_of, with_parameter

LONGEST_SEARCHED_PERIOD = 6
"""Longest period for which gaits are searched; longer ones are reached by doublings only. A longer
period makes every search longer."""
SEARCH_VALUES = 16
"""Values of the parameter at which gaits are searched, equally spaced over the interval."""
CELLS_PER_SEARCH = 32
"""Number of cells for each guess of a search; continuation needs only one gait of a branch."""


def grow_branches(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    period_max: int,
    *,
    tolerance: Real,
    progress: bool = False,
) -> Iterator[tuple[list[Branch], list[int]]]:
    """Search for branches; yield them as more are found, with the numbers of their parents.

    The parent is the branch from which a branch doubles, or -1. The lists grow. The last ones hold
    all branches up to the period `period_max`, in ascending order of period.
    """
    branches: list[Branch] = []
    parents: list[int] = []

    def follow_all(starts: list[Start], parent: int) -> None:
        """Add the branches of starts to the known ones, each once."""
        for start, branch in zip(
            starts,
            continue_gaits(walker, parameter, interval, starts, tolerance=tolerance),
            strict=True,
        ):
            new = start.direction is not None or select_new_starts(
                walker, parameter, branches, [start], tolerance
            )
            if len(branch.values) > 1 and new:
                branches.append(branch)
                parents.append(parent)

    for period in track(range(1, period_max + 1), "gaits and branches, by period", progress):
        for i, branch in enumerate(list(branches)):
            if 2 * branch.period == period:
                follow_all([start_at_doubling(doubling) for doubling in branch.doublings], i)
                yield branches, parents
        if period > LONGEST_SEARCHED_PERIOD:
            continue
        values = np.linspace(*interval, SEARCH_VALUES)
        starts = find_starts(walker, parameter, values, period, tolerance)
        while starts := select_new_starts(walker, parameter, branches, starts, tolerance):
            first = starts[0].value
            follow_all([start for start in starts if start.value == first], -1)
            starts = [start for start in starts if start.value != first]
            yield branches, parents

    for i, branch in enumerate(branches):
        if parents[i] < 0 and branch.period in (2, 4, 8, 16, 32, 64):
            parents[i] = find_parent_below(walker, parameter, branches, i, interval, tolerance)
    yield branches, parents


def find_parent_below(
    walker: System,
    parameter: str,
    branches: list[Branch],
    number: int,
    interval: tuple[float, float],
    tolerance: Real,
) -> int:
    """Find the branch from which a branch doubles at a value below the interval; -1 if none.

    The branch is followed down to the doubling, and the gait of half the period back up into the
    interval.
    """
    branch, (low, high) = branches[number], interval
    wider = widen_downwards(walker, parameter, low, high)
    lowest = int(branch.values.argmin())
    start = Start(float(branch.values[lowest]), branch.states[lowest])
    (down,) = continue_gaits(walker, parameter, wider, [start], tolerance=tolerance)
    half = branch.period // 2
    for end, reason in ((0, down.ends[0]), (-1, down.ends[1])):
        if reason.startswith("the gait of period"):
            states = (down.states[end][:half] + down.states[end][half:]) / 2
            parent = Start(float(down.values[end]), states)
            (up,) = continue_gaits(walker, parameter, wider, [parent], tolerance=tolerance)
            inside = np.flatnonzero((up.values >= low) & (up.values <= high))
            for i, other in enumerate(branches):
                if other.period == half and len(inside):
                    point = Start(float(up.values[inside[0]]), up.states[inside[0]])
                    if not select_new_starts(walker, parameter, [other], [point], tolerance):
                        return i
    return -1


def widen_downwards(walker: System, parameter: str, low: float, high: float) -> tuple[float, float]:
    """Return an interval that begins lower; the same one if the walker refuses that value."""
    below = low / 2 if low > 0 else 2 * low - high
    try:
        check_parameter(walker, parameter, below)
    except ValueError:
        return low, high
    return below, high


def find_descendants(branches: list[Branch], parents: list[int]) -> list[int]:
    """Return the numbers of the most stable branch of period one and of all its descendants."""
    period_one = [i for i, branch in enumerate(branches) if branch.period == 1]
    members = sorted(period_one, key=lambda i: np.abs(branches[i].multipliers[:, 0]).min())[:1]
    for member in members:
        members += [i for i, parent in enumerate(parents) if parent == member]
    return members


def find_starts(
    walker: System,
    parameter: str,
    values: Float[np.ndarray, " values"],
    period: int,
    tolerance: Real,
) -> list[Start]:
    """Search for gaits of a period at many values; starts are in the order of the values."""
    points = []
    for value in values:
        grid = with_parameter(walker, parameter, value).gait_region()
        points.append(grid.centres(np.arange(0, grid.size, CELLS_PER_SEARCH)))
    walkers = with_parameter(walker, parameter, np.repeat(values, [len(p) for p in points]))
    integrator = Integrator(tolerance).in_dtype(float)
    walking, cycles = cycle_guesses(walkers, np.concatenate(points), period, integrator)
    walkers = select(walkers, walking)
    found = iterate_newton(walkers, cycles, integrator)
    at = value_of(walkers, parameter)
    starts = []
    for value in values:
        gaits = Gait(*(field[at == value] for field in found))
        gaits = remove_duplicates(gaits, turns_of(walker))
        starts += [Start(float(value), states) for states in gaits.states]
    return starts


def select_new_starts(
    walker: System,
    parameter: str,
    branches: Sequence[Branch],
    starts: Sequence[Start],
    tolerance: Real,
) -> list[Start]:
    """Return the starts that lie on none of the branches."""
    guesses = [
        (i, start.value, cycle)
        for i, start in enumerate(starts)
        for branch in branches
        if branch.period == len(start.states)
        for cycle in interpolate_cycles(branch, start.value)
    ]
    cycles = solve_at(walker, parameter, [guess[1:] for guess in guesses], tolerance)
    new = np.ones(len(starts), bool)
    for (i, *_), cycle in zip(guesses, cycles, strict=True):
        if cycle is not None:
            apart = cycle_distance(cycle, np.asarray(starts[i].states), turns_of(walker))
            new[i] &= apart > RECURRENCE_DISTANCE
    return [start for start, keep in zip(starts, new, strict=True) if keep]
