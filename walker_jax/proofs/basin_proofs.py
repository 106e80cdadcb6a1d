"""Proofs about basins: that all starts of a disc walk for ever, or which cells of a grid do."""

from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.checks import WrongUse, check_number, check_whole, refuses_tracers, short
from walker_jax.gaits.cycles import Gait, check_found, linearise, multiply_jacobians
from walker_jax.gaits.search import find_gait
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.proofs.atlas import FALLS, OPEN, WALKS, Window
from walker_jax.proofs.boxes import Trap
from walker_jax.proofs.provable import check_provable
from walker_jax.proofs.stores import prove_in_batches
from walker_jax.proofs.subdivision import BATCH, KeepFates, LevelCells, prove_cells
from walker_jax.proofs.traps import find_trap
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import Outcome, join_names, outcome_in_words
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import attributes_of
from walker_jax.walking.iteration import iterate

LEAST_TRAP = 1e-7
STARTS_OF_CIRCLE = 1024
"""Number of starts on a disc's circle that are tried before a proof. If the radius exceeds the
least disturbance by 1e-5 of it, an arc of some 1e-2 rad falls, longer than their spacing."""
CELLS_OF_DISC = 16
"""Number of cells along a diameter, before they are split."""
ROUNDING_OF_AREA = 1e-12
"""Bound on the relative rounding of an area, far above that of a sum of equal cells."""
REACH, LEAST_REACH = 1e-8, 1e-12
"""Relative and absolute amount by which a disc is enlarged, for the rounding of distances and of
the gait's state."""


@refuses_tracers()
def prove_basin(
    walker: System,
    region: Grid | float,
    *,
    gait: Gait | None = None,
    levels: int = 12,
    strides: int = 60,
    progress: bool = True,
    out: Path | str | None = None,
    request: dict | None = None,
    overwrite: bool = False,
) -> xr.Dataset:
    """Prove which starts walk for ever, into a trap about a gait, and which do not.

    ```python
    data = wj.prove_basin(wj.SimplestWalker(slope=0.004), 0.001)
    data.attrs["all_walk"]  # every start within 0.001 of the gait walks for ever
    ```

    First an ellipse about the gait is proved to be a trap: strides lead all of it into itself. Then
    rigorous interval arithmetic carries cells from stride to stride. A cell walks if all of it
    comes into the trap or into cells that walk. It falls if all of it falls or comes into cells
    that fall; starts that are not feasible count as fallen. Any other cell is split in four, up to
    `levels` times, and is `OPEN` in the end. On a boundary some cells always are.

    The theorem is about the equations of motion and the events of `docs/method.md`, for all numbers
    that round to the walker's parameters.

    **Arguments:**

    - `walker`: a `SimplestWalker`, `SpringWalker` or `PoweredWalker`.
    - `region`: a grid of the section; or the radius of a disc about the gait's first state, with
      distances in (theta, thetadot), as in `least_disturbance`.
    - `gait`: a stable gait; by default that of `find_gait`.
    - `levels`: most times that a cell is split.
    - `strides`: most strides that a cell is carried.
    - `progress`: whether to show progress bars on a terminal, after a second.
    - `out`, `overwrite`: as in `basin`. A piece holds the fates of some cells of a level. An
      interrupted proof resumes from there; on the same machine, the result is the same to the last
      bit.
    - `request`: by which the stored proof is recognised; by default, all that it depends on.

    **Returns** a data set of the kind `proof`. `proved` has the proved fate of each cell; the
    attribute `all_walk` is 1 if all cells provably walk, so all of the disc; `area_lower` and
    `area_upper` bound the area of the starts in the disc or window that walk for ever.

    **Raises** `ComputationFailed` if no trap is proved, as about an unstable gait; `WrongUse` for
    another walker, for float32, for arguments out of range, and for a disc with a start on its
    circle that falls, as plain strides show.
    """
    walker = check_provable(walker)
    check_whole("levels", levels, 0, 24)
    gait = find_gait(walker) if gait is None else gait
    check_found(gait)
    centre, period = np.asarray(gait.states[0], float), len(gait.states)
    wanted, radius, axes = None, 0.0, ("theta", "thetadot")
    if isinstance(region, Grid):
        window, axes = window_of_grid(region), region.names
    else:
        check_number("region", region)
        if not 0 < region < 1:
            raise WrongUse(
                f"region must be a Grid, or a radius above 0 and below 1, not {short(region)}"
            )
        radius = float(region)
        if gait.stable:  # no trap is about another
            check_disc(walker, centre, radius, strides)
        window = window_about_disc(centre, radius)
        wanted = partial(may_meet_disc, window, centre, radius)
    find = lambda: find_trap(walker, centre, jacobian_of(walker, gait), period, LEAST_TRAP)

    def prove(trap: Trap, keep: KeepFates) -> xr.Dataset:
        how = {"levels": levels, "strides": strides, "wanted": wanted, "progress": progress}
        found = prove_cells(walker, window, trap, keep=keep, **how)
        return dataset_of(walker, axes, window, trap, found, period, radius)

    if out is None:
        return prove(find(), lambda level, number, find: find())
    asked = {"radius": radius, "levels": levels, "strides": strides, "batch": BATCH}
    asked |= {"gait": np.asarray(gait.states).tolist()}
    asked |= {name: np.asarray(one).tolist() for name, one in window._asdict().items()}
    asked |= {"command": "prove", "walker": type(walker).__name__, **attributes_of(walker)}
    asked |= {"version": version("walker-jax")}
    return prove_in_batches(Path(out), request or asked, levels, find, prove, overwrite=overwrite)


def check_disc(
    walker: System, centre: Float[np.ndarray, " 2"], radius: float, strides: int
) -> None:
    """Refuse a disc with a start on its circle that falls, by plain strides: no proof is left."""
    angle = np.linspace(0, 2 * np.pi, STARTS_OF_CIRCLE, endpoint=False)
    starts = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    end = iterate(walker, starts, strides, integrator_of(starts.dtype, None))
    falls = np.flatnonzero((end.outcome != Outcome.STRIDE) & (end.outcome != Outcome.UNDECIDED))
    if len(falls):
        first = falls[np.argmin(end.strides[falls])]
        fall = outcome_in_words(Outcome(int(end.outcome[first])).name)
        where = ", ".join(f"{value:.9g}" for value in starts[first])
        raise WrongUse(
            f"region {radius:g} must be at most the least disturbance: the start ({where}) on the "
            f"circle {fall} in stride {end.strides[first] + 1}",
            of="region",
        )


def dataset_of(
    walker: System,
    axes: tuple[str, ...],
    window: Window,
    trap: Trap,
    found: list[LevelCells],
    period: int,
    radius: float,
) -> xr.Dataset:
    """Return the data set of a proof. Its open cells are those of the last level."""
    last = len(found) - 1
    kept = [(one, (one.fates != OPEN) | (i == last)) for i, one in enumerate(found)]
    joined = lambda values: np.concatenate([value[which] for value, which in values])
    fates = joined((one.fates, which) for one, which in kept)
    levels = np.concatenate([np.full(which.sum(), one.level) for one, which in kept])
    low, high = areas_of(window, kept)
    if radius:
        low, high = areas_in_disc(window, kept, trap.centre, radius)
    variables = {
        "proved": ("cell", fates),
        "strides": ("cell", joined((one.strides, which) for one, which in kept)),
        "level": ("cell", levels.astype(np.int8)),
        "place": (("cell", "axis"), joined((one.cells, which) for one, which in kept)),
        "lower": ("axis", window.low),
        "upper": ("axis", window.high),
        "count": ("axis", np.asarray(window.counts, np.int32)),
        "shear": (("coordinate", "axis"), window.shear),
        "trap_centre": ("coordinate", trap.centre),
        "trap_factor": (("coordinate", "column"), trap.factor),
        "trap_size": ((), trap.size),
    }
    attributes = {
        "period": period,
        "radius": radius,
        "all_walk": int(np.all(fates == WALKS)),
        "area_lower": float(low * (1 - ROUNDING_OF_AREA)),
        "area_upper": float(high * (1 + ROUNDING_OF_AREA)),
        "verified_strides": sum(int(one.strides.sum()) for one in found),
        "section": join_names(walker.section),
        "walker": type(walker).__name__,
        **attributes_of(walker),
    }
    return xr.Dataset(variables, {"axis": ("axis", np.array(axes, object))}, attributes)


FinalCells = list[tuple[LevelCells, Bool[np.ndarray, " cells"]]]
"""Cells of each level, with flags of those that are not split further."""


def areas_of(window: Window, kept: FinalCells) -> tuple[float, float]:
    """Bound the area of the starts that walk: by cells that walk, and by these and open cells."""
    areas = {
        fate: sum(np.sum(one.fates[which] == fate) * window.area(one.level) for one, which in kept)
        for fate in (WALKS, OPEN)
    }
    return areas[WALKS], areas[WALKS] + areas[OPEN]


def areas_in_disc(
    window: Window, kept: FinalCells, centre: Float[np.ndarray, " 2"], radius: float
) -> tuple[float, float]:
    """Bound the area of a disc's starts that walk.

    A cell that reaches beyond the disc counts in the upper bound alone.
    """
    whole = np.pi * radius**2
    if all(np.all(one.fates[which] == WALKS) for one, which in kept):
        return whole, whole
    inside = [(one, which & is_in_disc(window, one, centre, radius)) for one, which in kept]
    return areas_of(window, inside)[0], min(areas_of(window, kept)[1], whole)


def is_in_disc(
    window: Window, cells: LevelCells, centre: Float[np.ndarray, " 2"], radius: float
) -> Bool[np.ndarray, " cells"]:
    """Return whether all of each cell certainly lies in a disc."""
    widths = window.widths(cells.level)
    apart = np.abs(window.centres(cells.level, cells.cells) - centre) + widths / 2
    return np.hypot(*apart.T) <= radius * (1 - REACH) - LEAST_REACH


def summarise_proof(data: xr.Dataset) -> dict[str, Any]:
    """Summarise the theorem, with counts and areas, for JSON."""
    check_dataset(data, "proof")
    proved = data["proved"].values
    attributes = {
        name: data.attrs[name]
        for name in ("radius", "area_lower", "area_upper", "verified_strides")
    }
    return {
        "all_walk": bool(data.attrs["all_walk"]),
        **attributes,
        "cells": {
            "walk": int(np.sum(proved == WALKS)),
            "fall": int(np.sum(proved == FALLS)),
            "open": int(np.sum(proved == OPEN)),
        },
        "trap": {
            "centre": data["trap_centre"].values.tolist(),
            "factor": data["trap_factor"].values.tolist(),
            "size": float(data["trap_size"]),
        },
    }


def jacobian_of(walker, gait: Gait) -> Float[np.ndarray, "2 2"]:
    """Return the Jacobian of a gait's return, not proved; no proof rests on it."""
    cycle = np.asarray(gait.states, float)[None]
    return multiply_jacobians(linearise(walker, cycle, integrator_of(cycle.dtype, None)).jacobian)[
        0
    ]


def window_of_grid(grid: Grid) -> Window:
    """Return the window with the cells of a grid of the plane section."""
    if len(grid.names) != 2 or grid.coordinates != 2 or np.any(np.asarray(grid.origin) != 0):
        raise WrongUse(
            "region must be a grid along both coordinates of the section, with its origin at zero",
            of="region",
        )
    arrays = (np.asarray(one, float) for one in (grid.lower, grid.upper, grid.shear))
    lower, upper, shear = arrays
    first, second = map(int, grid.counts)
    return Window(lower, upper, (first, second), shear)


def window_about_disc(centre: Float[np.ndarray, " 2"], radius: float) -> Window:
    """Return a window that holds a disc."""
    reach = radius * (1 + 2 * REACH) + 2 * LEAST_REACH
    return Window(centre - reach, centre + reach, (CELLS_OF_DISC, CELLS_OF_DISC), np.eye(2))


def may_meet_disc(
    window: Window,
    centre: Float[np.ndarray, " 2"],
    radius: float,
    level: int,
    cells: Int[np.ndarray, "cells 2"],
) -> Bool[np.ndarray, " cells"]:
    """Return whether each cell may have a point in a disc."""
    apart = np.abs(window.centres(level, cells) - centre) - window.widths(level) / 2
    return np.hypot(*np.maximum(apart, 0).T) <= radius * (1 + REACH) + LEAST_REACH
