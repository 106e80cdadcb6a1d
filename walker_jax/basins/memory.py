"""Checks that a grid or a state fits a walker's section, and a grid the memory of the machine."""

import os
from typing import Any

import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_kind, numbers, short
from walker_jax.grids import Grid
from walker_jax.storage.schema import names_in_use
from walker_jax.systems.system import System

BYTES_PER_CELL = {"cell-map": 25, "direct": 100}
"""Peak memory in bytes, for each cell of a grid."""


class TooLarge(WrongUse, MemoryError):
    """A computation needs more memory than this machine has."""


def lies_along(grid: Grid, place: int, coordinate: int) -> bool:
    """Return whether an axis of a grid is at its coordinate's place, or is that coordinate."""
    if place == coordinate:
        return True
    if place >= len(grid.names):
        return False
    alone = np.eye(grid.coordinates)[coordinate]
    return bool((np.asarray(grid.shear)[:, place] == alone).all())


def check_grid(
    walker: System,
    grid: Grid,
    method: str,
    each: int = BYTES_PER_CELL["direct"],
    *,
    kind: str | None = None,
) -> None:
    """Raise `WrongUse` for a grid that does not fit the walker's section, or the memory.

    The names of its axes must differ from names of arrays in the `kind` of data set to be made.
    """
    check_kind("walker", walker, System)
    check_kind("grid", grid, Grid)
    if grid.coordinates != len(walker.section):
        raise WrongUse(
            f"grid must have the {len(walker.section)} dimensions of the section, "
            f"{', '.join(walker.section)}, not {', '.join((*grid.names, *grid.fixed))}"
        )
    if method == "cell-map" and len(grid.names) < grid.coordinates:
        raise WrongUse(
            f"method must be direct, not 'cell-map', for a slice ({', '.join(grid.fixed)} fixed), "
            "as walkers leave it"
        )
    for place, name in enumerate((*grid.names, *grid.fixed)):
        wrong = name in walker.section and not lies_along(grid, place, walker.section.index(name))
        if wrong or (name in grid.fixed and name not in walker.section):
            raise WrongUse(
                f"grid must name coordinates in the order of the section, {walker.section}, "
                f"not {(*grid.names, *grid.fixed)}"
            )
        if kind is not None and name in names_in_use(kind):
            raise WrongUse(
                f"grid must not have an axis called {name}, as data sets have an array or a "
                "dimension of that name: call it another"
            )
    needed, memory = grid.size * each, memory_of_machine()
    if needed > memory:
        raise TooLarge(
            f"grid of {grid.size} cells needs {needed / 2**30:.1f} GiB of memory, "
            f"and this machine has {memory / 2**30:.1f} GiB: lower a count"
        )


def check_level(levels: int, level: int, count: int, each: int) -> None:
    """Raise `TooLarge` for a level of refinement with more cells than fit the memory."""
    needed, memory = count * each, memory_of_machine()
    if needed > memory:
        raise TooLarge(
            f"levels={levels}: level {level} follows {count} cells, "
            f"which need {needed / 2**30:.1f} GiB of memory, "
            f"and this machine has {memory / 2**30:.1f} GiB: lower levels"
        )


def check_state(walker: System, name: str, x: Any) -> Float[np.ndarray, " section"]:
    """Return a state on the walker's section as float64; raise `WrongUse` for any other value."""
    values = numbers(name, x)
    if values.shape != (len(walker.section),) or not np.isfinite(values).all():
        section = ", ".join(walker.section)
        raise WrongUse(f"{name} must be finite numbers on the section, {section}, not {short(x)}")
    return values


def memory_of_machine() -> float:
    """Return the bytes of memory; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError):  # not a POSIX system
        return float("inf")
