"""What walkers are designed for, and how it changes with any of their parameters.

Area. That of a basin is the integral of an indicator, which has no derivative; but the basin's
boundary is where the margin m of some failure is zero, and moves outwards, at right angles to
itself, by v = (dm/dp) / |grad m| for each unit of a parameter p. So dA/dp is the integral of v
along the boundary, by derivatives of strides and margins alone. Where the boundary is fractal the
area falls by jumps, whose sum that integral misses; there a derivative means something only as its
average over a band of the parameter, which is the change of the area over the band.

Least disturbance. By the envelope theorem it changes as the nearest point of the boundary does.

Gaits. Their speed, step length, largest multiplier and cost of transport follow from the gait, and
so do the derivatives, by the implicit function.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from walker_jax.basins.refinement import Refined, refine_cells
from walker_jax.checks import WrongUse, check_kind, numbers, refuses_tracers, short
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import find_gait
from walker_jax.grids import Grid
from walker_jax.integrators.solvers import default_tolerance
from walker_jax.stability.disturbances import BEYOND, least_disturbance
from walker_jax.stability.margin_changes import margin_changes
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter, with_parameter

HALVINGS = 8
"""Of the distance between two centres, on the way to the boundary between them."""
SHARES = 4
"""Parts of the lines, each a grid of its own, by whose scatter the error is told."""
NARROWINGS = 20
"""Times that a band is halved on a side on which the walker refuses it."""
UNSURE = 0.05
"""Error of an integral along the boundary, to its value, from which on it is not trusted."""


class AreaGradient(NamedTuple):
    """The area of a basin, and how it changes with parameters of the walker."""

    area: float
    """Within the grid, of all attractors together (rad^2 per unit of time); of a slice, in it."""
    gradient: Float[np.ndarray, " parameters"]
    """Its derivatives."""
    area_error: float
    error: Float[np.ndarray, " parameters"]
    """Standard errors; of the gradient, by the scatter between lines of the grid."""
    averaged: Bool[np.ndarray, " parameters"]
    """Which derivatives are averages over a band."""
    crossings: int
    """Points of the boundary that were met."""
    lost: int
    """Those among them beyond which no failure lies, but another motion: they count as fixed."""
    strides: int
    """That were made in all, those with derivatives once for each direction."""


@refuses_tracers("it gives derivatives itself, by the parameters named")
def area_gradient(
    walker: Walker,
    grid: Grid,
    parameters: Sequence[str] = ("slope",),
    *,
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None = None,
    levels: int = 2,
    strides: int = 200,
    check: int = 100_000,
    seed: int = 0,
    tolerance: float | None = None,
) -> AreaGradient:
    """The area of the basin within a grid, and its derivatives by parameters of the walker.

    With n the unit normal of the boundary,

        dA/dp = integral of v ds = sum over the axes i of the integral of v |n_i| |n_i| ds,

    and lines of the grid along axis i meet a piece ds of the boundary in proportion to |n_i| ds: so
    v |n_i| is summed over the points in which lines through the cells' centres cross the boundary.
    Each is found by halving; beyond it the walker makes some number of strides and then fails, and
    v follows from the forward-mode derivatives of that failure's margin. There is no smoothing.

    Parts of the basin thinner than a cell are met too rarely for this. Where they matter, as where
    the boundary is fractal, they have no derivative worth the name either: fingers of failure grow
    into the basin like the square root of the distance in p from where each is born. Then, that is
    where the error is more than 1/20 of the integral, and with `bands` given, the derivative is
    the average over a band of half width h, (A(p + h) - A(p - h)) / 2h, of refined areas.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `grid`: as in `refine`, by which it is cut where the boundary is; its borders are fixed.
    - `parameters`: names of the walker's.
    - `bands`: a half width for each of them, above 0; less on a side on which the walker takes no
      such value.
    - `levels`: how many times cells on the boundary are cut in two.
    - `strides`: how many of them a walker is followed for.
    - `check`, `seed`: of the areas, as in `refine`.
    - `tolerance`: of the integration, as in `stride`.

    Returns zeros where nothing walks. `ValueError` for parameters that the walker does not have,
    for bands that are not such numbers, and as for `refine`.
    """
    widths = checked_bands(walker, parameters, bands)

    def basin_of(walker: Walker) -> Refined:
        return refine_cells(
            walker,
            grid,
            levels,
            strides=strides,
            check=check,
            seed=seed,
            tolerance=tolerance,
            by_centres=True,
        )

    found = basin_of(walker)
    integral = along_boundary(walker, found, parameters)
    gradient, error, made = (
        integral.gradient,
        integral.error,
        found.total_strides + integral.strides,
    )
    unsure = ~(error <= UNSURE * np.abs(gradient)) & (found.area > 0)
    averaged = unsure & (bands is not None)
    for k in map(int, np.flatnonzero(averaged)):
        low, high = ends_of_band(walker, parameters[k], widths[k])
        below, above = basin_of(low), basin_of(high)
        width = float(getattr(high, parameters[k]) - getattr(low, parameters[k])) or np.nan
        gradient[k] = (above.area - below.area) / width
        error[k] = np.hypot(above.area_error, below.area_error) / width
        made += below.total_strides + above.total_strides
    return AreaGradient(
        area=found.area,
        gradient=gradient,
        area_error=found.area_error,
        error=error,
        averaged=averaged,
        crossings=integral.crossings,
        lost=integral.lost,
        strides=made,
    )


def checked_bands(
    walker: Walker,
    parameters: Sequence[str],
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None,
) -> Float[np.ndarray, " parameters"]:
    """The widths of bands, of any size where none are given; parameters and they are checked."""
    check_kind("parameters", parameters, Sequence)
    for name in parameters:
        check_parameter(walker, name)
    widths = np.ones(len(parameters)) if bands is None else numbers("bands", bands)
    if widths.shape != (len(parameters),) or not np.all((widths > 0) & (widths < np.inf)):
        raise WrongUse(f"bands must be a number above 0 for each parameter, not {short(bands)}")
    return widths


def ends_of_band(walker: Walker, parameter: str, width: float) -> tuple[Walker, Walker]:
    """The walkers with a parameter lower and higher by a width, or less if they are none."""
    value, ends = float(getattr(walker, parameter)), []
    for step in (-width, width):
        for _ in range(NARROWINGS):
            try:
                check_parameter(walker, parameter, value + step)
                break
            except ValueError:
                step /= 2
        else:
            step = 0.0
        ends.append(with_parameter(walker, parameter, jnp.asarray(value + step)))
    return ends[0], ends[1]


class Integral(NamedTuple):
    """That of v along the boundary, for each parameter."""

    gradient: Float[np.ndarray, " parameters"]
    error: Float[np.ndarray, " parameters"]
    crossings: int
    lost: int
    strides: int


def along_boundary(walker: Walker, found: Refined, parameters: Sequence[str]) -> Integral:
    """The sum of v |n_i| over the points in which lines of a grid cross the boundary."""
    if not parameters:
        return Integral(np.zeros(0), np.zeros(0), 0, 0, 0)
    walks, fine = found.attractor >= 0, found.grid
    shape, count = np.array(fine.shape), len(parameters)
    tangents = np.asarray(fine.shear) * np.asarray(fine.spacing)  # columns: from cell to cell
    totals = np.zeros((SHARES, count))
    crossings = lost = made = 0

    def walk(places: Float[np.ndarray, "n axes"]) -> tuple[np.ndarray, np.ndarray]:
        """Whether walkers converge to an attractor, and after how many strides they do or fail."""
        nonlocal made
        labels, _ = found.mapper.label_all(fine.states(places / shape))
        made += labels.total_strides
        return labels.converged, labels.strides

    for axis in range(len(shape)):
        inside, outside = crossings_along(walks, axis)
        for _ in range(HALVINGS):
            middle = (inside + outside) / 2
            stays = walk(middle)[0][:, None]
            inside, outside = np.where(stays, middle, inside), np.where(stays, outside, middle)
        x = fine.states(outside / shape)
        beyond = walk(outside)[1]
        change = margin_changes(walker, x, beyond, tangents.T, parameters, found.mapper.tolerance)
        made += int((beyond + 1).sum()) * change.shape[1]
        slopes, by_parameter = change[:, : len(shape)], change[:, len(shape) :]
        with np.errstate(invalid="ignore", divide="ignore"):
            steepness = np.sum(slopes**2, axis=1)
            moves = by_parameter * (np.abs(slopes[:, axis]) / steepness)[:, None]
        known = np.isfinite(moves).all(axis=1)
        crossings, lost = crossings + len(x), lost + int(np.sum(~known))
        line = np.delete(np.floor(outside).astype(int), axis, axis=1).sum(axis=1) % SHARES
        np.add.at(totals, line[known], moves[known])
    cell = fine.cell_area
    error = np.sqrt(SHARES) * np.std(totals, axis=0, ddof=1) * cell
    return Integral(totals.sum(axis=0) * cell, error, crossings, lost, made)


def crossings_along(
    walks: Bool[np.ndarray, "*shape"], axis: int
) -> tuple[Float[np.ndarray, "n axes"], Float[np.ndarray, "n axes"]]:
    """Neighbours along an axis of which one walks: that one, and the other.

    As places in the grid, in cells; centres are at halves.
    """
    rises = np.delete(walks, 0, axis=axis)
    index = np.argwhere(rises != np.delete(walks, -1, axis=axis))
    first, step = index + 0.5, np.eye(walks.ndim)[axis]
    ahead = rises[tuple(index.T)][:, None]
    return np.where(ahead, first + step, first), np.where(ahead, first, first + step)


class DisturbanceGradient(NamedTuple):
    """The least disturbance of a gait, and how it changes with parameters of the walker."""

    size: float
    gradient: Float[np.ndarray, " parameters"]
    averaged: bool
    """Whether the derivatives are averages over bands."""


@refuses_tracers("it gives derivatives itself, by the parameters named")
def disturbance_gradient(
    walker: Walker,
    parameters: Sequence[str] = ("slope",),
    gait: Gait | None = None,
    *,
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None = None,
    fall: bool = False,
    strides: int = 500,
    tolerance: float | None = None,
) -> DisturbanceGradient:
    """The least disturbance, and its derivatives by parameters of the walker.

    It is that from which the walker does not come back, or with `fall` that from which it falls.

    At the nearest point of the boundary, x = g + r u with g the gait's state and u of length one,
    the margin stays zero: dr/dp = -(dm/dp + grad m . dg/dp) / (grad m . u). That u turns matters to
    second order only. Where two points are as near as each other, the size has a kink; this is the
    derivative on the side of the one found.

    Where the nearest point leads to another motion instead of a failure it has no margin. Then,
    with `bands` given, as for `area_gradient`, derivatives are averages over these, as far as the
    gait is stable there; NaN otherwise.

    Other arguments and errors are those of `least_disturbance`, in its plain metric.
    """
    widths = checked_bands(walker, parameters, bands)
    gait = find_gait(walker, tolerance=tolerance) if gait is None else gait
    found = least_disturbance(walker, gait, fall=fall, strides=strides, tolerance=tolerance)
    finest = float(default_tolerance(found.state.dtype, tolerance))
    beyond = np.asarray(gait.states)[found.phase] + BEYOND[:, None] * found.size * found.direction
    made, axes = np.full(len(beyond), found.strides, np.int32), np.eye(beyond.shape[1])
    changes = margin_changes(walker, beyond, made, axes, parameters, finest)
    changes_of_gait = [
        gait_derivatives(walker, gait, name, tolerance=tolerance) for name in parameters
    ]
    moves = [change.states[found.phase] for change in changes_of_gait]
    moves = np.array(moves).reshape(len(parameters), len(axes))
    for change in changes[np.isfinite(changes).all(axis=1)]:
        slopes, by_parameter = change[: len(axes)], change[len(axes) :]
        gradient = -(by_parameter + moves @ slopes) / (slopes @ found.direction)
        return DisturbanceGradient(found.size, gradient, False)
    if bands is None:
        return DisturbanceGradient(found.size, np.full(len(widths), np.nan), False)
    pairs = zip(parameters, widths, strict=True)
    gradient = [size_over_band(walker, gait, *pair, fall, strides, tolerance) for pair in pairs]
    return DisturbanceGradient(found.size, np.array(gradient), True)


def size_over_band(
    walker: Walker,
    gait: Gait,
    parameter: str,
    width: float,
    fall: bool,
    strides: int,
    tolerance: float | None,
) -> float:
    """Average derivative of the least disturbance over a band, where its ends have the gait."""
    ends = []
    for one in ends_of_band(walker, parameter, width):
        there = find_gait(one, gait.states, len(gait.states), tolerance=tolerance)
        one, there = (one, there) if there.found and there.stable else (walker, gait)
        found = least_disturbance(one, there, fall=fall, strides=strides, tolerance=tolerance)
        ends.append((float(getattr(one, parameter)), found.size))
    (low, below), (high, above) = ends
    return (above - below) / (high - low) if high > low else np.nan
