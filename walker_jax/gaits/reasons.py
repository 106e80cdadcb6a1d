"""Reasons why a search finds no gait, and the error that states them."""

from collections.abc import Iterable

import numpy as np

from walker_jax.checks import ComputationFailed
from walker_jax.gaits.cycles import Gait, linearise
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.system import System, numbers_of
from walker_jax.walkers.model import moves_like
from walker_jax.walkers.parameters import describe_briefly
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking.starts import prepare

LARGE_RESIDUAL = 1e-6
"""Residual above which a failed search ended far from any gait. A failed search with a smaller
residual ended at a gait of a shorter period or at a bifurcation."""


def no_gait_found(
    walker: System,
    period: int,
    search: Gait | None,
    *,
    guessed: bool,
    instead: str = "",
    arguments: Iterable[str] = (),
) -> ComputationFailed:
    """Return the error of a search that found no gait: the reason, and what to do `instead`.

    `search` is as in `reason_without_gait`; `arguments` are the ones named in `instead`.
    """
    reason = reason_without_gait(walker, period, search, guessed=guessed)
    instead = instead or f"try {'another guess' if guessed else 'a guess'}"
    other = "another slope" if "slope" in numbers_of(walker) else "other parameters"
    return ComputationFailed(
        f"no {nouns(walker)[0]} of period {period} found for {describe_briefly(walker)}: {reason}; "
        f"{instead}, or {other}",
        of=" ".join([*arguments, "slope"]),
    )


def nouns(system: System) -> tuple[str, str, str]:
    """Return the words for a cycle and a step of a system, and for one step; a map has no gait."""
    if isinstance(system, HybridSystem):
        return "gait", "stride", "a stride"
    return "cycle", "iterate", "an iterate"


def reason_without_gait(walker: System, period: int, search: Gait | None, *, guessed: bool) -> str:
    """Say why no gait was found, from the end of one `search`, or None if all cells were tried."""
    single = guessed or (moves_like(walker, SimplestWalker) and period == 1)
    cycle, step, one = nouns(walker)
    if search is None or not (np.isfinite(search.residual) or single):
        return reason_without_any_gait(walker)
    if not np.isfinite(search.residual):
        start = "the guess" if guessed else "where the search begins"
        made = f"no {step}" if period == 1 else f"fewer than {period} {step}s"
        return f"it makes {made} from {start} (explain says why)"
    if search.residual > LARGE_RESIDUAL:
        return f"Newton's iteration diverged: {one} misses the next state by {search.residual:.2g}"
    if period > 1:
        return f"the search ended in a {cycle} of a shorter period, or too close to a bifurcation"
    return "the search ended too close to a bifurcation"


def reason_without_any_gait(walker: System) -> str:
    """Say why searches from all cells of the walker's `gait_region` found no gait."""
    grid = walker.gait_region()
    starts = grid.centres(np.arange(grid.size))
    _, _, one = nouns(walker)
    walker, _, integrator = prepare(walker, starts[0], None)
    ends = linearise(walker, starts[:, None], integrator).state
    walking = int(np.isfinite(ends).all(axis=(1, 2)).sum())
    if walking == 0:
        return f"none of the {len(starts)} starts over the section makes {one} (explain says why)"
    return f"none of the searches from {walking} starts that make {one} converged"
