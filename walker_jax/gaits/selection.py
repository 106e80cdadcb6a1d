"""Default gaits of commands."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from walker_jax.gaits.cycles import Gait, cycle_distance
from walker_jax.gaits.reasons import no_gait_found
from walker_jax.gaits.search import find_gaits, search_gait
from walker_jax.integrators.integrator import AnySolver
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import System


def require_gait(
    walker: System,
    instead: Iterable[str],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Gait:
    """Return the gait that `find_gait` finds by default.

    Raises `ComputationFailed` if it finds none, and names the arguments to use `instead`.
    """
    gait = search_gait(walker, tolerance=tolerance, solver=solver)
    if not gait.found:
        names = [*instead]
        told = f"give {', '.join(names)}"
        raise no_gait_found(walker, 1, gait, guessed=False, instead=told, arguments=names)
    return gait


def select_gaits(
    walker: System,
    period: int = 1,
    guess: Any = None,
    *,
    every: bool = False,
    instead: str = "",
) -> list[Gait]:
    """Return one gait of a period, or every gait of that period.

    **Arguments:**

    - `walker`, `period`, `guess`: as in `find_gait`.
    - `every`: whether to return all gaits that searches from the walker's `gait_region` find.
    - `instead`: the error's advice in place of trying another guess.

    **Returns** the gait to which the search converges from the guess, if there is a guess.
    Otherwise the first gait is, for a period of one, the default of `find_gait`, and for a longer
    period the gait with the smallest multiplier. With `every`, the others follow.

    Raises `ComputationFailed` with the reason if none is found.
    """
    found, first = [], None
    if every or (period > 1 and guess is None):
        found = find_gaits(walker, period, progress=False)
        found.sort(key=lambda gait: np.abs(gait.multipliers[0]))
        found = found if every else found[:1]
    # The long gait of period one is not the most stable on every slope.
    if period == 1 or guess is not None:
        first = search_gait(walker, guess, period)
        turns = turns_of(walker)
        apart = lambda gait: cycle_distance(gait.states, np.asarray(first.states), turns)
        same = lambda gait: apart(gait) < 1e-8
        found = [first] * bool(first.found) + [gait for gait in found if not same(gait)]
    if not found:
        search = None if every else first
        guessed = guess is not None
        raise no_gait_found(walker, period, search, guessed=guessed, instead=instead)
    return found
