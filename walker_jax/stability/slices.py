"""The regions and slices around a gait in which `robustness` computes the basin."""

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.grids import Grid, axes_around
from walker_jax.systems.system import System
from walker_jax.walkers.abstract_point_foot import AbstractPointFootWalker
from walker_jax.walkers.model import Walker, moves_like
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walkers.spatial import SpatialWalker

SLICE_YAW, SLICE_LEAN_RATE, SLICE_CELLS = 0.2, 0.04, 100
"""Half widths of a slice in space, of yaw in rad and of the rate of lean for legs of length 1, and
its cells along an axis: they hold the toy's basin there, with a margin."""


def slice_around(walker: Walker, state: Float[ArrayLike, " section"]) -> Grid:
    """Return a slice around a gait's state; in space it is over yaw and rate of lean.

    In space the starts are thus turned walkers, pushed from the side.
    """
    if not isinstance(walker, SpatialWalker):
        return Grid.sheared(**axes_around(state, ("theta", "sum", *walker.section[2:])))
    point = dict(zip(walker.section, map(float, np.asarray(state)), strict=True))
    around = lambda name, half: (point[name] - half, point[name] + half, SLICE_CELLS)
    rate = float(np.sqrt(walker.leg_length))
    return Grid.through(
        point, yaw=around("yaw", SLICE_YAW), leandot=around("leandot", SLICE_LEAN_RATE / rate)
    )


def default_region(walker: System, searched: Gait | None = None) -> Grid | None:
    """Return the default region of `robustness`; None where a gait is needed and not found.

    For a walker on point feet it has all feasible angles, and rates around the simplest walker's
    basins, or more for other walkers. For any other walker it is a slice around a gait, by default
    that of `find_gait`. For a system that is no walker it is its `gait_region`.
    """
    if not isinstance(walker, Walker):
        return walker.gait_region()
    if isinstance(walker, AbstractPointFootWalker):
        rates = (-0.12, 0.06, 200) if moves_like(walker, SimplestWalker) else (-1.1, 0.1, 800)
        return Grid.sheared(theta=(0, np.pi / 4, 200), sum=rates)
    gait = search_gait(walker) if searched is None else searched
    return slice_around(walker, gait.states[0]) if gait.found else None
