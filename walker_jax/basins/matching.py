"""Attractors of different walkers, matched: the same number for those that are near."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

NONE = -1
"""Number of a cycle that matches none."""
NEIGHBOURS_APART = 0.1
"""Distance within which cycles of neighbouring walkers count as one: half the distance between the
two states of the simplest walker's gaits of period one and two, and more than a gait moves between
values of a parameter that are worth a row of basins."""


def cycle_distance(
    one: Float[np.ndarray, "period section"], other: Float[np.ndarray, "other section"]
) -> float:
    """Largest difference of any coordinate of two cycles; infinite where their periods differ.

    The cycles are turned so that it is smallest. That of two without a state is 0.
    """
    if one.shape != other.shape:
        return np.inf
    turned = (np.roll(other, shift, axis=0) for shift in range(len(other)))
    return min((float(np.abs(one - cycle).max()) for cycle in turned), default=0.0)


def match_cycles(
    cycles: Sequence[Float[np.ndarray, "_ section"]],
    known: Sequence[Float[np.ndarray, "_ section"]],
    within: float,
) -> list[int]:
    """Find the nearest known cycle of each cycle: its index, each taken once; -1 for none."""
    matches = [NONE] * len(cycles)
    pairs = [
        (cycle_distance(cycle, one), i, k)
        for i, cycle in enumerate(cycles)
        for k, one in enumerate(known)
    ]
    for distance, i, k in sorted(pairs):
        if distance < within and matches[i] == NONE and k not in matches:
            matches[i] = k
    return matches


def number_alike(
    periods: Int[np.ndarray, "*walkers number"],
    states: Float[np.ndarray, "*walkers number phase section"],
) -> Int[np.ndarray, "*walkers number"]:
    """Common numbers of the attractors of a grid of walkers, -1 where there are fewer.

    `periods` are -1 where there are fewer, and 0 where the motion has none: a walker has one such
    attractor at most, and all of these have one number. A cycle has the number of the cycle of the
    same period that is nearest, within `NEIGHBOURS_APART`, among those of the nearest walker that
    has each number; or a new one.
    """
    shape, most = periods.shape[:-1], periods.shape[-1]
    numbers = np.full((*shape, most), NONE)
    last: list[dict[tuple[int, ...], np.ndarray]] = []  # of each number: cycles by place
    for place in np.ndindex(*shape):
        apart = lambda at, place=place: np.abs(np.subtract(at, place)).sum()
        known = [cycles[min(cycles, key=apart)] for cycles in last]
        own = np.flatnonzero(periods[place] >= 0)
        # of a motion without a period no state is a cycle's: all are the same empty one
        cycles = [states[place][i, : periods[place][i]] for i in own]
        matches = match_cycles(cycles, known, NEIGHBOURS_APART)
        for i, cycle, match in zip(own, cycles, matches, strict=True):
            if match == NONE:
                match = len(last)
                last.append({})
            last[match][place], numbers[place][i] = cycle, match
    return numbers
