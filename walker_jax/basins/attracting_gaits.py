"""The attracting gait: the cycle with the largest basin, as Newton's iteration finds it.

Measures reported beside a basin, such as the speed, are measures of this gait. A search without a
guess may end in another gait, unstable or with a smaller basin.
"""

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.basins.attractor import all_motions, capture_radius
from walker_jax.basins.attractor_search import sample_indices, with_attractors_from
from walker_jax.basins.mapper import Mapper
from walker_jax.gaits.cycles import Gait, cycle_distance
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.angles import Turns
from walker_jax.systems.system import System

STARTS = 2**11, 2**13, 2**15
"""Sizes of the samples of a grid in which its gait is looked for. A larger sample follows if the
one before does not tell which basin is the largest. A basin of 1 % of the cells has about twenty
starts in the first."""
LEAD = 3.0
"""Standard errors by which the largest basin of a sample must exceed the next."""


def gait_of_basins(walker: System, data: xr.Dataset, tolerance: float | None) -> Gait | None:
    """Find the gait with the most cells in a data set of `basin` or `refine`; None without one."""
    cells = data["cells"].values * (data["period"].values > 0)
    if cells.sum() == 0:
        return None
    largest = int(cells.argmax())
    states = data["states"].values[largest, : int(data["period"][largest])]
    return stable_gait(walker, states, tolerance)


def gait_of_grid(walker: System, grid: Grid, strides: int, tolerance: float | None) -> Gait | None:
    """Find the gait to which most of a sample of a grid's cells converge; None if none do."""
    integrator = integrator_of(jnp.result_type(float), tolerance)
    largest = None
    for count in STARTS:
        starts = grid.centres(sample_indices(grid.size, count))
        # The first attractor stands for all motions without a period, whether they last or not.
        mapper = Mapper(walker, [all_motions(starts[:1])], integrator, strides)
        mapper = with_attractors_from(mapper, starts)
        labels = mapper.follow(starts)
        sizes = np.bincount(labels.attractor[labels.converged], minlength=2)
        if sizes.any():
            largest = mapper.attractors[int(sizes.argmax())].states
        elif len(labels.remaining):  # a motion without a period
            return None
        *_, second, first = np.sort(sizes)
        if count >= grid.size or first - second > LEAD * np.sqrt(first + second):
            break
    return None if largest is None else stable_gait(walker, largest, tolerance)


def stable_gait(
    walker: System, states: Float[np.ndarray, "period section"], tolerance: float | None
) -> Gait | None:
    """Find the stable gait of an attractor with these states; None if Newton's iteration fails."""
    gait = search_gait(walker, states, len(states), tolerance=tolerance)
    return gait if gait.found and gait.stable else None


def compare_with_search(attracting: Gait | None, searched: Gait, turns: Turns = None) -> str:
    """Say how a gait found without a guess differs from the attracting one; empty if it does not.

    Where none attracts, a search that finds no stable gait agrees.
    """
    if attracting is None:
        agrees = not searched.stable
    else:
        agrees = bool(searched.found) and is_same_cycle(attracting, searched, turns)
    if agrees:
        return ""
    if not searched.found:
        return "find_gait without a guess finds no gait"
    state = ", ".join(f"{value:.6g}" for value in np.asarray(searched.states[0]))
    kind = "a stable" if searched.stable else "an unstable"
    size = float(np.abs(searched.multipliers[0]))
    return (
        f"find_gait without a guess finds {kind} gait, multiplier {size:.6g}, at ({state}), "
        f"{'to which no cell converges' if attracting is None else 'not that of the basin'}"
    )


def is_same_cycle(one: Gait, other: Gait, turns: Turns = None) -> bool:
    """Return whether two gaits have the same states, whichever comes first."""
    states, others = np.asarray(one.states), np.asarray(other.states)
    return cycle_distance(states, others, turns) < capture_radius(states.dtype)
