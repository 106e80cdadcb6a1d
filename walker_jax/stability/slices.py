"""The region around a gait in which `robustness` computes the basin."""

from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid
from walker_jax.systems.system import System


def default_region(walker: System, searched: Gait | None = None) -> Grid | None:
    """Return the default region of `robustness`; None where a gait is needed and not found.

    It is the system's `basin_region`, by default around the gait of `find_gait`.
    """

    def state():
        gait = search_gait(walker) if searched is None else searched
        return gait.states[0] if gait.found else None

    return walker.basin_region(state)
