"""Walkers designed for their basins: how area and least disturbance change with any parameter.

The area of a basin is the integral of an indicator, which has no derivative; but its boundary is
where the margin m of some failure is zero, and moves outwards, at right angles to itself, by
v = (dm/dp) / |grad m| for each unit of a parameter p. So dA/dp is the integral of v along the
boundary, by derivatives of strides and margins alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basin import (
    Attractor,
    check_grid,
    follow,
    framed_attractors,
)
from walker_jax.cells import Grid
from walker_jax.gaits import Gait, check_parameter, find_gait, gait_derivatives
from walker_jax.integrate import default_tolerance
from walker_jax.refinement import BYTES_PER_CELL, cut, edge, finer, neighbours
from walker_jax.robustness import BEYOND, change_of_margin, least_disturbance
from walker_jax.tiles import over_cells
from walker_jax.walkers import Walker

HALVINGS = 14
"""Of the distance between two centres, on the way to the boundary between them."""
SHARES = 4
"""Parts of the lines, each a grid of its own, by whose scatter the error is told."""


class AreaGradient(NamedTuple):
    """The area of a basin, and how it changes with parameters of the walker."""

    area: float
    """Within the grid, of all attractors together (rad^2 per unit of time); of a slice, in it."""
    gradient: Float[np.ndarray, " parameters"]
    """Its derivatives."""
    area_error: float
    error: Float[np.ndarray, " parameters"]
    """Standard errors, by the scatter between lines of the grid."""
    crossings: int
    """Points of the boundary that were met."""
    lost: int
    """Those among them beyond which no failure lies, but another motion: they count as fixed."""


def area_gradient(
    walker: Walker,
    grid: Grid,
    parameters: Sequence[str] = ("slope",),
    *,
    levels: int = 2,
    strides: int = 200,
    tolerance: float | None = None,
) -> AreaGradient:
    """The area of the basin within a grid, and its derivatives by parameters of the walker.

    With n the unit normal of the boundary,

        dA/dp = integral of v ds = sum over the axes i of the integral of v |n_i| |n_i| ds,

    and lines of the grid along axis i meet a piece ds of the boundary in proportion to |n_i| ds: so
    v |n_i| is summed over the points in which lines through the cells' centres cross the boundary.
    Each is found by halving; beyond it the walker makes some number of strides and then fails, and
    v follows from the forward-mode derivatives of that failure's margin. The area is that between
    the crossings on the lines of the axis that has most of them.

    There is no smoothing: an error comes from parts of the basin that are missed between lines, by
    some per cent of the area where its tails are thin. Where the boundary is fractal the area falls
    by jumps, its derivative at one value of a parameter tells little of those nearby, and a few
    crossings that move fast make the error large.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `grid`: as in `refine`, by which it is cut where the boundary is; its borders are fixed.
    - `parameters`: names of the walker's.
    - `levels`: how many times cells on the boundary are cut in two.
    - `strides`: how many of them a walker is followed for.
    - `tolerance`: of the integration, as in `stride`.

    Returns zeros where nothing walks. `ValueError` for parameters that the walker does not have,
    and as for `refine`.
    """
    for name in parameters:
        check_parameter(walker, name)
    if levels < 0:
        raise ValueError(f"levels must not be negative, not {levels}")
    if strides < 1:
        raise ValueError(f"strides must be at least 1, not {strides}")
    fine = finer(grid, levels)
    check_grid(walker, fine, "direct", each=BYTES_PER_CELL)
    tolerance = float(default_tolerance(jnp.asarray(0.0).dtype, tolerance))
    _, attractors = framed_attractors(walker, grid, tolerance, strides)
    walks = cells_that_walk(walker, grid, attractors, levels, strides, tolerance)

    shape, count = np.array(fine.shape), len(parameters)
    tangents = np.asarray(fine.shear) * np.asarray(fine.spacing)  # columns: from cell to cell
    measures, totals, crossings, lost = [], [], 0, 0
    for axis in range(len(shape)):
        inside, outside, rises = crossings_along(walks, axis)
        for _ in range(HALVINGS):
            middle = (inside + outside) / 2
            found = follow(walker, fine.states(middle / shape), attractors, tolerance, strides)
            stays = (found.attractor >= 0)[:, None]
            inside, outside = np.where(stays, middle, inside), np.where(stays, outside, middle)
        x = fine.states(outside / shape)
        beyond = follow(walker, x, attractors, tolerance, strides)
        change = margin_changes(walker, x, beyond.strides, tangents.T, parameters, tolerance)
        slopes, by_parameter = change[:, : len(shape)], change[:, len(shape) :]
        with np.errstate(invalid="ignore", divide="ignore"):
            steepness = np.sum(slopes**2, axis=1)
            moves = by_parameter * (np.abs(slopes[:, axis]) / steepness)[:, None]
        known = np.isfinite(moves).all(axis=1)
        crossings, lost = crossings + len(x), lost + int(np.sum(~known))
        moves = np.where(known[:, None], moves, 0.0)
        # the length of each line that walks: to the crossings at which it ends, from the others
        place = np.where(rises, -1, 1) * outside[:, axis]
        line = np.delete(np.floor(outside).astype(int), axis, axis=1).sum(axis=1)
        ends = np.take(walks, -1, axis=axis) * shape[axis]
        borders = np.indices(ends.shape).sum(axis=0).ravel()
        summed = lambda values, at: np.bincount(at % SHARES, values, minlength=SHARES)
        length = summed(place, line) + summed(ends.ravel(), borders)
        measures.append((len(x), length))
        totals.append(np.stack([summed(moves[:, k], line) for k in range(count)], axis=1))
    _, length = max(measures, key=lambda one: one[0])
    total = np.sum(totals, axis=0)
    cell = fine.cell_area
    scatter = lambda shares: np.sqrt(SHARES) * np.std(shares, axis=0, ddof=1) * cell
    return AreaGradient(
        float(length.sum() * cell),
        total.sum(axis=0) * cell,
        float(scatter(length)),
        scatter(total),
        crossings,
        lost,
    )


def cells_that_walk(
    walker: Walker,
    grid: Grid,
    attractors: list[Attractor],
    levels: int,
    strides: int,
    tolerance: float,
) -> Bool[np.ndarray, "*shape"]:
    """Whether a walker comes to an attractor from the centres of the cells of a finer grid.

    Cells are cut where they are on the boundary, as in `refine`.
    """
    walks, on_edge = np.zeros(grid.shape, bool), np.ones(grid.shape, bool)
    for level in range(levels + 1):
        fine = finer(grid, level)
        if level:
            walks, on_edge = cut(walks), cut(on_edge)
        known, cells = np.zeros(fine.shape, bool), np.flatnonzero(on_edge)
        while cells.size:
            places = np.stack(np.unravel_index(cells, fine.shape), axis=1)
            x = fine.states((places + 0.5) / np.array(fine.shape))
            found = follow(walker, x, attractors, tolerance, strides)
            walks.ravel()[cells], known.ravel()[cells] = found.attractor >= 0, True
            beside = neighbours(cells, fine.shape)
            unlike = walks.ravel()[beside] != walks.ravel()[cells][:, None]
            cells = np.unique(beside[unlike & ~known.ravel()[beside]])
        on_edge = edge(walks.astype(np.int8))
    return walks


def crossings_along(
    walks: Bool[np.ndarray, "*shape"], axis: int
) -> tuple[Float[np.ndarray, "n axes"], Float[np.ndarray, "n axes"], Bool[np.ndarray, " n"]]:
    """Neighbours along an axis of which one walks: it, the other, and whether that comes first.

    As places in the grid, in cells; centres are at halves.
    """
    ahead = np.delete(walks, 0, axis=axis)
    behind = np.delete(walks, -1, axis=axis)
    index = np.argwhere(ahead != behind)
    first, step = index + 0.5, np.eye(walks.ndim)[axis]
    rises = ahead[tuple(index.T)]
    inside = np.where(rises[:, None], first + step, first)
    return inside, np.where(rises[:, None], first, first + step), rises


def margin_changes(
    walker: Walker,
    x: Float[np.ndarray, "n section"],
    made: Int[np.ndarray, " n"],
    directions: Float[np.ndarray, "axes section"],
    parameters: Sequence[str],
    tolerance: float,
) -> Float[np.ndarray, "n columns"]:
    """Derivatives of the margins of the failures of walks from x, along directions and parameters.

    Each walk has `made` some strides when it fails. They are NaN where it does not.
    """
    dtype, n = x.dtype, len(x)
    columns = len(directions) + len(parameters)
    zero = np.zeros((len(parameters), x.shape[1]), dtype)
    along = np.tile(np.concatenate([directions.astype(dtype), zero]), (n, 1))
    names = [None] * len(directions) + list(parameters)
    by = {name: np.array([name == one for one in names], dtype) for name in vars(walker)}
    fields = jax.tree.unflatten(
        jax.tree.structure(walker), [np.tile(by[name], n) for name in vars(walker)]
    )
    cells = np.repeat(x, columns, axis=0), np.repeat(made, columns), (fields, along)
    shared = jax.tree.map(lambda leaf: np.asarray(leaf, dtype), (walker, tolerance))
    return over_cells(change_of_margin, shared, cells).reshape(n, columns)


class DisturbanceGradient(NamedTuple):
    """The least disturbance of a gait, and how it changes with parameters of the walker."""

    size: float
    gradient: Float[np.ndarray, " parameters"]


def disturbance_gradient(
    walker: Walker,
    parameters: Sequence[str] = ("slope",),
    gait: Gait | None = None,
    *,
    strides: int = 500,
    tolerance: float | None = None,
) -> DisturbanceGradient:
    """The least disturbance, and its derivatives by parameters of the walker.

    At the nearest point of the boundary, x = g + r u with g the gait's state and u of length one,
    the margin stays zero: dr/dp = -(dm/dp + grad m . dg/dp) / (grad m . u). That u turns matters to
    second order only. Where two points are as near as each other, the size has a kink; this is the
    derivative on the side of the one found.

    Arguments and errors are those of `least_disturbance`, in its plain metric.
    """
    for name in parameters:
        check_parameter(walker, name)
    gait = find_gait(walker) if gait is None else gait
    found = least_disturbance(walker, gait, strides=strides, tolerance=tolerance)
    finest = float(default_tolerance(found.state.dtype, tolerance))
    beyond = np.asarray(gait.states)[found.phase] + BEYOND[0] * found.size * found.direction
    made = np.array([found.strides], np.int32)
    names, axes = list(parameters), np.eye(len(beyond))
    change = margin_changes(walker, beyond[None], made, axes, names, finest)[0]
    slopes, by_parameter = change[: len(axes)], change[len(axes) :]
    moves = [gait_derivatives(walker, gait, name).states[found.phase] for name in names]
    gradient = -(by_parameter + np.array(moves) @ slopes) / (slopes @ found.direction)
    return DisturbanceGradient(found.size, gradient)
