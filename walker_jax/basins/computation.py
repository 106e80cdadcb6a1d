"""The basin of attraction: the fate of every start in a region of the Poincaré section.

There are two methods. Cell mapping (Hsu 1987; Schwab and Wisse 2001, section 4.3) makes one stride
from the centre of every cell, sends the cell to the cell where the stride ends, and follows the
cells. Direct iteration follows every centre itself, stride by stride. Direct iteration is exact up
to its number of strides. Cell mapping costs one stride a cell, and its errors are of the size of a
cell: it may show cycles of cells where no attractor is, and several cycles for one attractor. So
walkers from the centres of each cycle's cells are also followed, to the attractor that they
converge to.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr

from walker_jax.basins.methods import METHODS, DirectIteration, label_in_memory, work_of
from walker_jax.basins.own_labels import check_label
from walker_jax.basins.schema import to_dataset
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_memory,
    check_precision,
    refuses_tracers,
    short,
)
from walker_jax.execution.pieces import complete_store
from walker_jax.execution.workers import check_cluster
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import AnySolver, integrator_of
from walker_jax.storage.schema import names_in_use
from walker_jax.systems.system import System, warn_if_rounded
from walker_jax.walkers.model import Walker

BYTES_PER_CELL = {"cell-map": 25, "direct": 100}
"""Peak memory in bytes, for each cell of a grid."""
BYTES_STORED = {"cell-map": 16, "direct": 0}
"""Peak memory in bytes for each cell, as `BYTES_PER_CELL`, if the result goes into a store."""


@refuses_tracers("measure gives derivatives of a basin's area")
def basin(
    walker: System,
    grid: Grid,
    method: str | None = None,
    *,
    strides: int = 200,
    tolerance: float | None = None,
    solver: AnySolver | None = None,
    label: Any = None,
    progress: bool = True,
    out: Path | str | None = None,
    request: dict | None = None,
    overwrite: bool = False,
    cluster: Any = None,
) -> xr.Dataset:
    """Compute the fate of every cell of a grid on the walker's section.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 200))
    data = wj.basin(wj.SimplestWalker(0.004), grid)
    float(data.area.sum())  # of all attractors, in rad^2 per unit of time
    ```

    **Arguments:**

    - `walker`: its parameters are used in float64 if JAX has that turned on.
    - `grid`: its state coordinates are those of the section. It may be a slice. A window of a width
      from 1e-15 to 1e-9 keeps its digits by direct iteration: its centre is followed, with the
      Jacobian, until the window is wide enough (`Grid.zoom` makes one).
    - `method`: "cell-map" or "direct"; for a slice, "direct" only. By default, cell mapping for
      walkers, and direct iteration for other systems: on their fractal basins, a cell map of the
      same grid leads many cells to another attractor.
    - `strides`: number of strides for which direct iteration follows a walker. Undecided walks
      continue for some 16,000 more, if a cycle is known, only to identify their attractor.
    - `tolerance`, `solver`: of the integration, as in `stride`. A cluster takes no other solver.
    - `label`: for direct iteration, your own label of a walk that has made all its strides, in
      place of the attractor: a JAX function of its last state, which returns a whole number from 0
      on, or -1 for none; or `Clusters` of features of its orbit. No attractor is then looked for;
      `states` has one such state for each label.
    - `progress`: whether to show a progress bar on a terminal, after a second.
    - `out`: a place on disk, a Zarr store, into which the result is written piece by piece. Only
      one piece is in memory at a time, but the cell map takes 12 bytes for each cell at the end. An
      interrupted run is resumed from there, with the same result to the last bit. Until it has
      ended, cells of missing pieces have a fate of -1. The returned data set reads its arrays from
      the store when they are used.
    - `request`: by which the stored result is recognised; by default, all that it depends on.
    - `overwrite`: whether to remove another result that stands there.
    - `cluster`: who computes the pieces, as in `execution.workers.open_workers`: a number of worker
      processes on this machine, the address of a Dask scheduler, or a Dask client.

    **Returns** a data set. Over the grid's axes it has

    - `fate`: `Outcome` of the stride at which the walker fails; `STRIDE` where it converges to an
      attractor, or walks to the last stride (direct);
    - `attractor`: number of the attractor it converges to, -1 for none. If direct iteration finds
      motions without a period, walks that go on after `strides` have the number of the one that
      they are on, or of what they come to in 1000 more; a few of these may still fall or converge
      to a cycle. Walks on an unstable cycle have none;
    - `strides`: strides completed before the walker converges or fails.

    Over the attractors it has `period` (0 where the motion does not repeat itself) and `states`
    (NaN after the period), and for the basin within the grid `cells` and `area` (rad^2 per unit of
    time; over three dimensions a volume). Attractors are numbered by period, then by the angle of
    their first state, which is their smallest one. `at_border` counts the basins' cells at the
    border of the grid: the basin may go on beyond. Attributes say what was computed.

    The attractors of a cell map are those to which walkers converge from the centres of the cells
    in its cycles. If walkers from most of the centres of a cycle converge to one attractor, the
    cycle belongs to it, with all cells that lead there. Any other cycle is an `artefact` of the
    cells: its period and states are those of cells and their centres, and it comes after all
    attractors. Further arrays are `cycles`, the number of cycles of cells that belong to each
    attractor, and `falling`, the number of their cells' centres from which a walker falls.

    Raises `ValueError` for an unknown method, for a grid that does not fit the section or the
    memory of this machine, and for a place that holds something else, cannot be written to, or is
    in use by another run.
    """
    if method is None:
        method = "cell-map" if isinstance(walker, Walker) else "direct"
    if not isinstance(method, str) or method not in METHODS:
        raise WrongUse(f"method must be one of {', '.join(METHODS)}, not {short(method)}")
    strides = int(strides)
    each = (BYTES_PER_CELL if out is None else BYTES_STORED)[method]
    check_grid(walker, grid, method, each, kind="basin")
    dtype = jnp.result_type(float)
    check_precision(dtype)
    warn_if_rounded(walker)
    integrator = integrator_of(dtype, tolerance, solver)
    limit = {"strides": strides} if method == "direct" else {}
    settings = {"method": method, **limit, "tolerance": float(integrator.tolerance)}
    if solver is not None:
        settings["solver"] = repr(solver)
        if cluster is not None:
            raise WrongUse(
                f"solver must not be given with a cluster, unlike {solver!r}: leave out one of them"
            )
    work = METHODS[method](walker, grid, settings, integrator)
    if label is not None:
        if not isinstance(work, DirectIteration):
            raise WrongUse(f"method must be direct, not {method!r}, for a label of your own")
        settings |= check_label(label)
        work = replace(work, label=label)
    if out is None:
        check_cluster(cluster, out)
        return to_dataset(walker, grid, label_in_memory(work, progress), settings)
    by = {"overwrite": overwrite, "cluster": cluster, "progress": progress}
    return complete_store(work_of(work, request), Path(out), **by)


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
    check_memory(grid.size * each, f"grid of {grid.size} cells needs", "lower a count")


def lies_along(grid: Grid, place: int, coordinate: int) -> bool:
    """Return whether an axis of a grid is at its coordinate's place, or is that coordinate."""
    if place == coordinate:
        return True
    if place >= len(grid.names):
        return False
    alone = np.eye(grid.coordinates)[coordinate]
    return bool((np.asarray(grid.shear)[:, place] == alone).all())


@refuses_tracers()
def compare_methods(
    walker: System, grid: Grid, *, strides: int = 200, tolerance: float | None = None
) -> xr.Dataset:
    """Compare cell mapping with direct iteration on one grid: differences and artefacts.

    Arguments and errors are those of `basin`.

    **Returns** a data set with `mapped` and `direct` over the grid's axes: whether a cell has an
    attractor by either method. Over the attractors of cell mapping it has `cells`, `period`,
    `cycles`, `artefact` and `falling`, as in `basin`. `direct_attractors` is the number that direct
    iteration finds.

    ```python
    grid = wj.Grid.sheared(theta=(0, 0.4, 60), sum=(-0.04, 0.01, 60))
    found = wj.compare_methods(wj.SimplestWalker(0.004), grid)
    float((found.mapped != found.direct).mean())  # the share of cells where they differ
    ```
    """
    settings: Any = {"strides": strides, "tolerance": tolerance, "progress": False}
    mapped = basin(walker, grid, "cell-map", **settings)
    direct = basin(walker, grid, "direct", **settings)
    walks = {"mapped": mapped["attractor"] >= 0, "direct": direct["attractor"] >= 0}
    found = mapped[["cells", "period", "cycles", "artefact", "falling"]].assign(walks)
    found["direct_attractors"] = direct.sizes["number"]
    return found.assign_attrs(mapped.attrs | {"method": "cell-map against direct"})
