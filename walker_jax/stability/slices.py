"""Slices around a gait, in which `robustness` looks at the basin."""

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.grids import Grid, axes_around
from walker_jax.walkers.model import Walker
from walker_jax.walkers.spatial import SpatialWalker

SLICE_YAW, SLICE_LEAN_RATE, SLICE_CELLS = 0.2, 0.04, 100
"""Half widths of a slice in space, of yaw in rad and of the rate of lean for legs of length 1, and
its cells along an axis: the toy's basin there, with a margin."""


def slice_around(walker: Walker, state: Float[ArrayLike, " section"]) -> Grid:
    """The slice around a gait's state, in space over yaw and rate of lean.

    There the walker is turned, and pushed from the side.
    """
    if not isinstance(walker, SpatialWalker):
        return Grid.sheared(**axes_around(state, ("theta", "sum", "phidot")))
    point = dict(zip(walker.section, map(float, np.asarray(state)), strict=True))
    around = lambda name, half: (point[name] - half, point[name] + half, SLICE_CELLS)
    rate = float(np.sqrt(walker.leg_length))
    return Grid.through(
        point, yaw=around("yaw", SLICE_YAW), leandot=around("leandot", SLICE_LEAN_RATE / rate)
    )
