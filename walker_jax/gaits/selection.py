"""Default gaits of commands, and reasons why a search finds none."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from walker_jax.checks import ComputationFailed
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import find_gait, find_gaits
from walker_jax.walkers.model import Walker, moves_like
from walker_jax.walkers.parameters import describe_in_words
from walker_jax.walkers.simplest import SimplestWalker

LARGE_RESIDUAL = 1e-6
"""Residual above which a failed search ended far from any gait. One that failed with a smaller
residual ended at a gait of a shorter period or at a bifurcation."""


def require_gait(walker: Walker, instead: Iterable[str]) -> Gait:
    """The gait that `find_gait` finds by default.

    Raises `ComputationFailed` where it finds none, and names the arguments `instead` of a gait.
    """
    gait = find_gait(walker)
    if not gait.found:
        raise ComputationFailed(
            f"no gait of period 1 found for {describe_in_words(walker)}: "
            f"give {', '.join(instead)}, or another slope"
        )
    return gait


def select_gaits(
    walker: Walker, period: int = 1, guess: Any = None, *, every: bool = False
) -> list[Gait]:
    """One gait of a period, or every gait of that period.

    **Arguments:**

    - `walker`, `period`, `guess`: as in `find_gait`.
    - `every`: whether to return all gaits that searches from the walker's `gait_region` find.

    **Returns** the gait to which the search converges from the guess, if there is a guess.
    Otherwise, for a period of one, the gait that `find_gait` finds by default, and after it, if
    `every`, the others; for a longer period the gait with the smallest multiplier, and after it,
    if `every`, the others.

    Raises `ComputationFailed` with the reason where none is found.
    """
    found, first = [], None
    if every or (period > 1 and guess is None):
        found = find_gaits(walker, period)
        found.sort(key=lambda gait: np.abs(gait.multipliers[0]))
        found = found if every else found[:1]
    # The long gait of period one is not the most stable one on every slope.
    if period == 1 or guess is not None:
        first = find_gait(walker, guess, period)
        same = lambda gait: np.allclose(gait.states, first.states, rtol=0, atol=1e-8)
        found = [first] * bool(first.found) + [gait for gait in found if not same(gait)]
    if not found:
        guessed = guess is not None
        raise ComputationFailed(
            f"no gait of period {period} found for {describe_in_words(walker)}: "
            f"{reason_without_gait(walker, period, None if every else first, guessed=guessed)}; "
            f"try {'another guess' if guessed else 'a guess'}, or another slope"
        )
    return found


def reason_without_gait(walker: Walker, period: int, search: Gait | None, *, guessed: bool) -> str:
    """Why no gait was found: by the end of one `search`, or None for searches from all cells."""
    single = guessed or (moves_like(walker, SimplestWalker) and period == 1)
    if search is None or not (np.isfinite(search.residual) or single):
        return "none of the searches over the section converged to one"
    if not np.isfinite(search.residual):
        start = "the guess" if guessed else "the state where the search begins"
        return f"the walker makes no stride from {start}"
    if search.residual > LARGE_RESIDUAL:
        return f"the search ended where a stride misses the next state by {search.residual:.2g}"
    if period > 1:
        return "the search ended in a gait of a shorter period, or too close to a bifurcation"
    return "the search ended too close to a bifurcation"
