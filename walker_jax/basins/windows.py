"""Default windows of the section, around the basin of a gait."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import is_number
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.gaits.selection import require_gait
from walker_jax.grids import Grid, axes_around
from walker_jax.systems.system import System, has_gait_region
from walker_jax.walkers.model import moves_like
from walker_jax.walkers.simplest import SimplestWalker

PAPER_WINDOW = {"theta": (0.0, 0.4, 200), "sum": (-0.04, 0.01, 250)}
"""The window of Schwab and Wisse (2001), Figure 4."""
WHOLE_SECTION = {"theta": (0.0, 1.4, 84), "sum": (-1.0, 0.2, 72), "phidot": (-2.5, 1.0, 84)}
"""A window that holds the basin of walkers similar to the default ones, with legs of length 1."""
PLACEHOLDERS = {"phidot": 0.0}
"""Values of axes that a gait is still to give; any other is `ANY_AXIS`."""
ANY_AXIS = (0.0, 1.0, 2)


def fill_from_paper(walker: System, axes: Mapping[str, Any]) -> dict[str, Any]:
    """Fill axes that are None with those of the paper's window, for the simplest walker."""
    known = PAPER_WINDOW if moves_like(walker, SimplestWalker) else {}
    return {name: known.get(name) if axis is None else axis for name, axis in axes.items()}


def fill_around_gait(walker: System, axes: Mapping[str, Any]) -> dict[str, Any]:
    """Fill axes that are None around the walker's gait.

    Raises `ComputationFailed` where such a gait is needed and not found.
    """
    missing = [name for name, axis in axes.items() if axis is None]
    if not missing:
        return dict(axes)
    window = axes_around(require_gait(walker, missing).states[0], tuple(axes))
    return {name: window[name] if axis is None else axis for name, axis in axes.items()}


def window_of_region(walker: System, cells: int) -> dict[str, Any] | None:
    """Return axes over the region of a system's gaits, of `cells` cells each.

    None where there is no such region, or it is not plain, or has not two axes.
    """
    region = walker.gait_region() if has_gait_region(walker) else None
    if region is None or region.names != walker.section or len(region.names) != 2:
        return None
    if np.any(region.shear != np.eye(2)):
        return None
    ends = zip(region.names, region.lower, region.upper, strict=True)
    return {name: (float(low), float(high), cells) for name, low, high in ends}


def window_of_basin(system: System) -> dict[str, Any] | None:
    """Return the axes of a system's `basin_region`, along some coordinates, the others fixed.

    None where there is no such region, or it is not along coordinates.
    """
    region = system.basin_region(lambda: require_gait(system, ["axis"]).states[0])
    if region is None or not {*region.names} <= {*system.section}:
        return None
    ends = zip(region.names, region.lower, region.upper, region.shape, strict=True)
    ranges = {name: (float(low), float(high), count) for name, low, high, count in ends}
    at = dict(zip(system.section, map(float, np.asarray(region.origin)), strict=True))
    return at | ranges


def default_region(walker: System, searched: Gait | None = None) -> Grid | None:
    """Return the default region of `robustness`; None where a gait is needed and not found.

    It is the system's `basin_region`, by default around the gait of `find_gait`.
    """

    def state():
        gait = search_gait(walker) if searched is None else searched
        return gait.states[0] if gait.found else None

    return walker.basin_region(state)


def whole_section(walker: System) -> dict[str, Any] | None:
    """Return the axes of a window of three dimensions that holds most of a walker's basin, or all.

    The window is `WHOLE_SECTION`, with rates in units of 1 / sqrt(leg length). There is none for a
    system that makes no steps, or has another section.
    """
    if walker.section != ("theta", "thetadot", "phidot"):
        return None
    angle = 1e-4  # so small that a step is 2 angle leg lengths long, also on round feet
    x = jnp.array([angle, -angle, 0.0])
    step = walker.step_length(x, lambda: None)
    if step is None:
        return None
    unit = round(float(2 * angle / step) ** 0.5, 6)
    (narrowest, widest, _), (low, high, count) = WHOLE_SECTION["theta"], WHOLE_SECTION["sum"]
    ends = [unit * end + (1 - unit) * a for a in (narrowest, widest) for end in (low, high)]
    backward, forward, turns = WHOLE_SECTION["phidot"]
    return {
        "theta": WHOLE_SECTION["theta"],
        "sum": (min(ends), max(ends), count),
        "phidot": (unit * backward, unit * forward, turns),
    }


def grid_along(axes: Mapping[str, Any]) -> Grid:
    """Make a sheared grid if an axis is `sum`, else a plain one; numbers fix their coordinates."""
    if "sum" in axes:
        return Grid.sheared(**axes)
    ranges = {name: axis for name, axis in axes.items() if not is_number(axis)}
    if ranges and list(axes)[: len(ranges)] != list(ranges):
        point = {name: 0.0 if name in ranges else float(axes[name]) for name in axes}
        return Grid.through(point, **ranges)
    return Grid.plain(**axes)


def outline(axes: Mapping[str, Any]) -> Grid:
    """Make a grid of these axes, with arbitrary ones for None, to check the given ones."""
    return grid_along(
        {
            name: PLACEHOLDERS.get(name, ANY_AXIS) if axis is None else axis
            for name, axis in axes.items()
        }
    )


def film_window(walker: System, x: Float[ArrayLike, " section"]) -> Grid:
    """Return the paper's window for the simplest walker, else one around the gait, or around x."""
    if moves_like(walker, SimplestWalker):
        return grid_along(PAPER_WINDOW)
    gait = search_gait(walker)
    state = gait.states[0] if gait.found else x
    return grid_along(axes_around(state, ("theta", "sum", *walker.section[2:])))
