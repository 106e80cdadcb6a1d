"""Matching of attractors of different walkers: near ones have the same number."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.motions import SPARSE, clouds_of, distances_from
from walker_jax.gaits.cycles import cycle_distance
from walker_jax.systems.angles import Turns

NONE = -1
"""Number of a cycle without a match."""
NEIGHBOURS_APART = 0.1
"""Distance within which cycles of neighbouring walkers count as one. It is half the distance
between the two states of the simplest walker's gaits of period one and two. It exceeds the change
of a gait between two values of a parameter that deserve separate basins."""


def match_cycles(
    cycles: Sequence[Float[np.ndarray, "_ section"]],
    known: Sequence[Float[np.ndarray, "_ section"]],
    within: float,
    turns: Turns = None,
) -> list[int]:
    """Find the index of the nearest known cycle of each cycle, each taken once; -1 for none."""
    pairs = [
        (distance, i, k)
        for i, cycle in enumerate(cycles)
        for k, one in enumerate(known)
        if (distance := cycle_distance(cycle, one, turns)) < within
    ]
    return match_pairs(pairs, len(cycles))


def match_clouds(
    clouds: Sequence[Float[np.ndarray, "_ section"]],
    known: Sequence[Float[np.ndarray, "_ section"]],
) -> list[int]:
    """Find the index of the nearest known cloud of each cloud, each taken once; -1 for none."""
    if not clouds or not known:
        return [NONE] * len(clouds)
    apart = clouds_of(known)
    pairs = [
        (distance, i, k)
        for i, cloud in enumerate(clouds)
        for k, distance in enumerate(distances_from(apart, cloud[SPARSE]).tolist())
    ]
    return match_pairs(pairs, len(clouds))


def match_pairs(pairs: list[tuple[float, int, int]], count: int) -> list[int]:
    """Match pairs (distance, i, k) from the nearest on, each i < count and each k once."""
    matches = [NONE] * count
    for _, i, k in sorted(pairs):
        if matches[i] == NONE and k not in matches:
            matches[i] = k
    return matches


def number_alike(
    periods: Int[np.ndarray, "*walkers number"],
    states: Float[np.ndarray, "*walkers number phase section"],
    turns: Turns = None,
) -> Int[np.ndarray, "*walkers number"]:
    """Give the attractors of a grid of walkers common numbers; -1 where there are fewer.

    `periods` are -1 where there are fewer, and 0 where the motion has no period. Attractors without
    a period share one number; of several, the first of each walker share one, then the second ones.
    For each number, a cycle is compared with the cycle of the nearest walker that has it. It takes
    the number of the nearest such cycle of the same period within `NEIGHBOURS_APART`, or a new one.
    """
    shape, most = periods.shape[:-1], periods.shape[-1]
    numbers = np.full((*shape, most), NONE)
    last: list[dict[tuple[int, ...], np.ndarray]] = []  # for each number, cycles by place
    for place in np.ndindex(*shape):
        apart = lambda at, place=place: np.abs(np.subtract(at, place)).sum()
        known = [cycles[min(cycles, key=apart)] for cycles in last]
        own = np.flatnonzero(periods[place] >= 0)
        # A motion without a period has no states of a cycle: all such motions are one empty cycle.
        cycles = [states[place][i, : periods[place][i]] for i in own]
        matches = match_cycles(cycles, known, NEIGHBOURS_APART, turns)
        for i, cycle, match in zip(own, cycles, matches, strict=True):
            if match == NONE:
                match = len(last)
                last.append({})
            last[match][place], numbers[place][i] = cycle, match
    return numbers
