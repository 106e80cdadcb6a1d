"""The boundary between fates and attractors: how fractal it is, whether Wada, where it leads."""

from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from walker_jax.basins.cell_classes import unmatched_cells
from walker_jax.basins.computation import basin, check_grid
from walker_jax.basins.edge_states import EdgeState, edge_state, fate_of
from walker_jax.basins.runs import attractors_of, fates_of, label_of, labels_among
from walker_jax.basins.schema import padded
from walker_jax.basins.stable_manifolds import stable_manifold
from walker_jax.checks import ComputationFailed, WrongUse, check_whole, refuses_tracers
from walker_jax.execution.progress import bar, track
from walker_jax.fractals.entropies import BOX, basin_entropy
from walker_jax.fractals.wada import MIN_REGIONS, RADIUS, check_radius, merge_regions
from walker_jax.gaits.cycles import Gait
from walker_jax.grids import Grid
from walker_jax.storage.schema import with_dims
from walker_jax.systems.outcomes import Outcome, failures_of, name_of_outcome
from walker_jax.systems.system import System, check_single

NO_REGION = (Outcome.UNDECIDED, Outcome.LEFT_GRID)
"""Fates of cells in no region, as no walk is known. Cells that are not feasible starts are in none
either, nor are those that walk to no known attractor, where some are known."""
HALVINGS = 3
"""Number of coarser grids on which boundaries of merged regions are compared, if the grid is fine
enough."""
MIN_CELLS = 3
"""Fewest cells along an axis: a cell and its neighbours, as `merge_regions` requires."""
SPACING = 5e-3
"""Spacing of the points of a stable manifold: the error of a cubic between them is too small to
see."""
LONGEST_CURVED = 4
"""Longest period of a saddle whose stable manifold is drawn. Saddles of longer periods contract so
strongly along it that one preimage leads all over the section."""


@refuses_tracers()
def boundary(
    walker: System,
    grid: Grid,
    *,
    side: int = BOX,
    radius: float | int = RADIUS,
    strides: int = 500,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Analyse the boundary between fates and attractors: entropy, Wada property and edge states.

    Each attractor has a region, the cells that converge to it, and so has each failure. Cells that
    are not feasible starts are in none, nor are walkers that come to no known attractor.

    ```python
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.04, 0.01, 40))
    data = wj.boundary(walker, grid)
    ```

    **Arguments:**

    - `walker`: as in `basin`.
    - `grid`: region or slice, and its cells, which are followed directly.
    - `side`: cells along a side of the boxes of `basin_entropy`.
    - `radius`: as in `merge_regions`, in cells.
    - `strides`, `tolerance`, `progress`: as in `refine`.

    **Returns** the data set of `basin`, and

    - `basin_entropy`, `boundary_entropy` and its standard error `boundary_entropy_error`;
    - `boundary_crowded`: the share of the boxes on the boundary with three regions or more;
    - `boundary_excess` and its standard error `boundary_excess_error`: by how much the dimension of
      the boundary exceeds that of a plane, as in `BasinEntropy`;
    - `boundary_fractal`: whether that shows a fractal boundary;
    - `region`, `region_attractor`: the fates of the regions, and their attractors, -1 for failures;
    - `wada_share`: over the `spacing` of the grid's points, the largest share of a region's
      boundary that another region's boundary lacks; empty with fewer than three regions.

    Over the pairs of regions that touch on the grid (`edge`) it has the results of `edge_state`
    between two neighbouring cells, the nearest to the first attractor, or to the middle of the
    grid:

    - `edge_fates`, `edge_attractors`: the fates of the two regions, and their attractors;
    - `edge_kind`, `edge_between`, `edge_path`: the kind, fates and path of the edge state;
    - `edge_period`, `edge_saddle`, `edge_multipliers`: the period, states and multipliers of a
      saddle;
    - `stable_manifold`: on a section of two coordinates, the two curves from the saddle's first
      state; empty for periods longer than `LONGEST_CURVED`.

    Raises `ValueError` as `basin`, `basin_entropy` and `merge_regions` do.
    """
    check_grid(walker, grid, "direct", kind="boundary")
    check_single(walker)
    if min(grid.shape) < MIN_CELLS:
        raise WrongUse(
            f"grid must have {MIN_CELLS} cells or more along each axis, not {grid.shape}"
        )
    check_whole("side", side, 2, min(grid.shape))
    check_radius(radius)
    with bar("basin", progress):
        data = basin(
            walker, grid, "direct", strides=strides, tolerance=tolerance, progress=progress
        )
    label = label_regions(walker, grid, data)
    regions = labels_among(label[label >= 0])
    number = np.full(label.shape, -1)
    for i, region in enumerate(regions):
        number[label == region] = i
    entropy = basin_entropy(number, side)
    spacings, shares = np.zeros(0, int), np.zeros(0)
    if len(regions) >= MIN_REGIONS:
        halvings = min(HALVINGS, int(np.log2(min(label.shape) / MIN_CELLS)))
        merged = merge_regions(number, radius, halvings=halvings)
        spacings, shares = merged.spacings, merged.share
    pairs, edges, near = [], [], nearest_to(data, grid)
    for first, second in track([*combinations(regions.tolist(), 2)], "edge states", progress):
        cells = touching_cells(label, (first, second), near)
        if cells is None:
            continue
        ends = grid.points_at((cells + 0.5) / np.array(grid.shape))
        try:
            edges.append(edge_state(walker, *ends, strides=strides, tolerance=tolerance))
        except (ComputationFailed, WrongUse):  # rounding lost this boundary: the others count
            edges.append(EdgeState("", None, ends[:1], (fate_of(first), fate_of(second)), np.nan))
        pairs.append((first, second))
    found = {
        "basin_entropy": entropy.value,
        "boundary_entropy": entropy.boundary,
        "boundary_entropy_error": entropy.boundary_error,
        "boundary_crowded": entropy.crowded / entropy.mixed if entropy.mixed else np.nan,
        "boundary_excess": entropy.excess,
        "boundary_excess_error": entropy.excess_error,
        "boundary_fractal": entropy.fractal,
        "region": fates_of(regions),
        "region_attractor": attractors_of(regions),
        "spacing": spacings,
        "wada_share": shares,
        **edge_arrays(walker, pairs, edges, tolerance, progress),
    }
    data = data.assign(with_dims("boundary", found))
    return data.assign_attrs(side=side, radius=float(radius))


def label_regions(walker: System, grid: Grid, data: xr.Dataset) -> Int[np.ndarray, "*cells"]:
    """Return the label of each cell's region, as `label_of` numbers them; -1 for cells in none."""
    fate, attractor = data["fate"].values, data["attractor"].values
    begins = np.ones(fate.shape, bool)
    outside = np.flatnonzero(fate == Outcome.OUTSIDE)
    begins.flat[outside] = jax.vmap(walker.feasible)(jnp.asarray(grid.centres(outside)))
    known = begins & ~np.isin(fate, NO_REGION)
    if data.sizes["number"]:
        known &= ~unmatched_cells(fate, attractor)
    return np.where(known, label_of(fate, attractor), -1)


def region_name(data: xr.Dataset, fate: int, attractor: int) -> str:
    """Name a region: an attractor among several by its number, others by their fate."""
    if attractor >= 0 and int((data["region_attractor"] >= 0).sum()) > 1:
        return f"attractor {attractor}"
    return name_of_outcome(fate, failures_of(data))


def nearest_to(data: xr.Dataset, grid: Grid) -> Float[np.ndarray, " axes"]:
    """Return the place, in cells, of the first attractor's first state, or the middle."""
    middle = (np.array(grid.shape) - 1) / 2
    if data.sizes["number"] == 0 or len(grid.names) < grid.coordinates:
        return middle
    place = grid.place(data["states"].values[0, 0])
    return place if ((place >= 0) & (place <= 2 * middle)).all() else middle


def touching_cells(
    label: Int[np.ndarray, "*cells"], pair: tuple[int, int], near: Float[np.ndarray, " axes"]
) -> Int[np.ndarray, "2 axes"] | None:
    """Return two neighbouring cells with these labels, the nearest to a place; or None."""
    found = []
    for axis in range(label.ndim):
        swapped = np.moveaxis(label, axis, 0)
        for first, second, step in ((0, 1, 1), (1, 0, -1)):
            lower, upper = swapped[:-1], swapped[1:]
            hits = np.argwhere((lower == pair[first]) & (upper == pair[second]))
            cells = np.stack([hits, hits + np.eye(label.ndim, dtype=int)[0]], axis=1)
            found.append(np.insert(cells[..., 1:], axis, cells[..., 0], axis=2)[:, ::step])
    cells = np.concatenate(found)
    if len(cells) == 0:
        return None
    return cells[np.linalg.norm(cells.mean(axis=1) - near, axis=1).argmin()]


def edge_arrays(
    walker: System,
    pairs: list[tuple[int, int]],
    edges: list[EdgeState],
    tolerance: float | None,
    progress: bool,
) -> dict[str, Any]:
    """Return the values over the pairs of regions that touch."""
    size = len(walker.section)
    saddles = [one.saddle for one in edges]
    multipliers = [np.zeros(0) if one is None else np.asarray(one.multipliers) for one in saddles]
    followed = track(saddles, "stable manifolds", progress)
    curves = [curves_of(walker, one, tolerance) for one in followed]
    none = np.zeros((0, size))
    both = [curve for pair in curves for curve in (pair or [none, none])]
    vertices = padded(both, size)
    labels = np.array(pairs, int).reshape(-1, 2)
    return {
        "edge_fates": fates_of(labels),
        "edge_attractors": attractors_of(labels),
        "edge_between": np.array([one.fates for one in edges], int).reshape(-1, 2),
        "edge_kind": np.array([one.kind for one in edges], object),
        "edge_period": np.array([0 if one is None else len(one.states) for one in saddles], int),
        "edge_saddle": padded([none if one is None else one.states for one in saddles], size),
        "edge_multipliers": padded(
            [np.stack([np.real(one), np.imag(one)], axis=1) for one in multipliers], 2
        ),
        "edge_path": padded([one.path for one in edges], size),
        "stable_manifold": vertices.reshape(len(edges), 2, vertices.shape[1], size),
    }


def curves_of(
    walker: System, saddle: Gait | None, tolerance: float | None
) -> list[Float[np.ndarray, "n section"]]:
    """Return the two curves of a saddle's stable manifold; none where it is not drawn."""
    if saddle is None or len(walker.section) != 2 or len(saddle.states) > LONGEST_CURVED:
        return []
    try:
        return stable_manifold(walker, saddle, spacing=SPACING, tolerance=tolerance)
    except (WrongUse, np.linalg.LinAlgError):  # two multipliers beyond 1, or a singular Jacobian
        return []


def summarise_boundary(data: xr.Dataset) -> dict:
    """Return the results of `boundary` for JSON, with regions by name."""
    failures = failures_of(data)
    names = lambda codes: [name_of_outcome(int(code), failures) for code in codes.values]
    regions = lambda fates, attractors: [
        region_name(data, int(fate), int(number))
        for fate, number in zip(fates.values, attractors.values, strict=True)
    ]
    finite = lambda value: float(value) if np.isfinite(value) else None
    shares = zip(data["spacing"].values.tolist(), data["wada_share"].values.tolist(), strict=True)
    edges = []
    for i in range(data.sizes["edge"]):
        one = data.isel(edge=i)
        known = lambda name, one=one: one[name].values[np.isfinite(one[name].values).all(axis=1)]
        sides = regions(one["edge_fates"], one["edge_attractors"])
        third = not np.array_equal(one["edge_between"], one["edge_fates"])
        edges.append(
            {
                "regions": sides,
                "between": names(one["edge_between"]) if third else sides,
                "kind": str(one["edge_kind"].values),
                "period": int(one["edge_period"]),
                "states": known("edge_saddle"),
                "multipliers": known("edge_multipliers"),
            }
        )
    return {
        "basin_entropy": float(data["basin_entropy"]),
        "boundary_entropy": {
            "value": finite(data["boundary_entropy"]),
            "error": float(data["boundary_entropy_error"]),
            "excess": finite(data["boundary_excess"]),
            "excess_error": finite(data["boundary_excess_error"]),
            "fractal": bool(data["boundary_fractal"]),
            "crowded": finite(data["boundary_crowded"]),
        },
        "regions": regions(data["region"], data["region_attractor"]),
        "wada": [{"spacing": spacing, "share": share} for spacing, share in shares],
        "edges": edges,
    }
