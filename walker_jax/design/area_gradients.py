"""The area or volume of a basin, and its derivatives by parameters of the walker.

An area is the integral of an indicator, which has no derivative. But the basin's boundary is where
the margin m of some failure is zero. Per unit of a parameter p it moves outwards, at right angles
to itself, by v = (dm/dp) / |grad m|. So dA/dp is the integral of v along the boundary, and needs
only derivatives of strides and margins. In the same way the derivative of a volume is an integral
over a surface. At a fractal boundary the area changes by jumps, which the integral misses. There
only the average derivative over a band of the parameter is meaningful: the change of the area over
the band.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.basins.computation import check_grid
from walker_jax.basins.labels import Label
from walker_jax.basins.refinement import Refined, refine_cells
from walker_jax.checks import WrongUse, numbers, short
from walker_jax.design.grid_lines import boundary_pairs, compare_lines, inverse_chances
from walker_jax.design.measures import Measure
from walker_jax.execution.threads import side_by_side
from walker_jax.grids import Grid, cell_slices
from walker_jax.segments import Segments, narrow
from walker_jax.stability.margin_changes import margins_with_derivatives
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walkers.choices import Choice, numbers_chosen
from walker_jax.walkers.parameters import check_parameter, value_of, with_parameter

BISECTIONS = 8
"""Bisections that locate the boundary between two centres."""
JUMP = 4 / 2**BISECTIONS
"""Distance to a failure, in cells, by its margin and the margin's slope along a line, above which
the line crosses no boundary of that failure. A crossing is located to a quarter of it."""
LINE_GROUPS = 4
"""Groups of lines, each a coarser grid, whose scatter gives the error of sampling."""
MAX_WEIGHTS = {2: (2, 1), 3: (4, 2)}
"""Largest weights of a crossing, which stands for others that are missed: two sums, by dimension.
Without a limit there is no bias, but few crossings decide the sum. In two dimensions grids are so
fine that weights would add more noise than they remove bias: there all crossings count once."""
MAX_RELATIVE_ERROR = 0.05
"""Relative error above which a band, if given, replaces the integral along the boundary."""
INDEPENDENT = 1 / 8
"""How independent neighbouring crossings may be, from 0 to 1 (`Integral.independence`). On smooth
boundaries of seven walkers and a map it is at most 0.09, at fractal boundaries of eight others 0.23
or more, on grids of 40,000 to 2.6 million cells."""
MAX_BAND_HALVINGS = 20
"""Most halvings of a band on a side where the walker refuses the value."""


Density = Callable[[Float[np.ndarray, "n section"]], Float[np.ndarray, " n"]]
"""A density of starts on the section."""


def area_gradient(
    walker: System,
    grid: Grid,
    parameters: Choice = ("slope",),
    *,
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None = None,
    levels: int = 2,
    strides: int = 200,
    check: int = 100_000,
    seed: int = 0,
    tolerance: float | None = None,
    density: Density | None = None,
) -> Measure:
    """Compute the area of the basin within a grid, and its derivatives by parameters.

    With n the unit normal of the boundary,

        dA/dp = integral of v ds = sum over the axes i of the integral of v |n_i| |n_i| ds.

    Lines of the grid along axis i meet a piece ds of the boundary in proportion to |n_i| ds. So
    v |n_i| is summed over the points where lines through the cells' centres cross the boundary.
    Bisection locates each point. Beyond it the walker fails after a number of strides, and v
    follows from the forward-mode derivatives of that failure's margin. There is no smoothing.

    Lines miss parts of the basin, or gaps in it, that are thinner than a cell. A part of a line of
    length l < 1, in cells, holds a centre with probability l. So its ends count 1 / l times
    (Horvitz and Thompson 1952), but c times at most. In three dimensions the sums S(c) for c = 2
    and 4 are extrapolated to the sum without a limit, 2 S(4) - S(2). This is exact if all lengths
    below 1/2 are equally likely; S(4) - S(2) counts as an error. In two dimensions grids are fine
    enough for S(1), which has less noise, and S(2) - S(1) counts as an error.

    At a fractal boundary the derivative of the area is of little use: fingers of failure grow
    into the basin like the square root of the distance in p from the value at which they are born.
    The integral misses those that are born, and its error is infinite. If `bands` are given, the
    derivative is the average over a band of half width h, (A(p + h) - A(p - h)) / 2h, of refined
    areas. So it is where the error exceeds 1/20 of the integral.

    A boundary counts as fractal if neighbouring lines differ as if crossings moved independently:
    the sum of v |n_i| over a line changes from line to line by more than 1/8 of the sum of squares
    expected then. On a smooth boundary neighbouring crossings move alike.

    In three dimensions the same holds for the surface of the basin and its volume. With a `density`
    the integral over the basin is the basin stability, and its derivative the integral of density
    times v along the boundary.

    Arguments are those of `measure`. The measure has zeros if nothing walks.
    """
    parameters = numbers_chosen(walker, parameters)
    widths = check_bands(parameters, bands)
    check_grid(walker, grid, "direct")
    if len(grid.names) not in MAX_WEIGHTS:
        raise WrongUse(f"grid must have two axes or three, not {len(grid.names)}")
    how = AreaSettings(grid, levels, strides, check, seed, tolerance, density)
    area = how.measure(walker)
    return differentiate_area(area, parameters, None if bands is None else widths, how)


class AreaSettings(NamedTuple):
    """How areas are measured; the arguments of `area_gradient`."""

    grid: Grid
    levels: int
    strides: int
    check: int
    seed: int
    tolerance: float | None
    density: Density | None

    def measure(self, walker: System) -> MeasuredArea:
        """Measure the area of a walker's basin."""
        found = refine_cells(
            walker,
            self.grid,
            self.levels,
            strides=self.strides,
            check=self.check,
            seed=self.seed,
            tolerance=self.tolerance,
            by_centres=True,
        )
        return MeasuredArea(walker, found, integrate_over_basin(found, self.density), self.density)


class MeasuredArea(NamedTuple):
    """The basin of a walker and its area, from which derivatives follow."""

    walker: System
    found: Refined
    size: Size
    density: Density | None


def differentiate_area(
    area: MeasuredArea,
    parameters: Sequence[str],
    widths: Float[np.ndarray, " parameters"] | None,
    at_band_ends: AreaSettings,
) -> Measure:
    """Differentiate a measured area, over bands of some half widths where the integral is unsure.

    The areas at the ends of bands may have settings of their own.
    """
    walker, found, size, density = area
    integral = integrate_along_boundary(walker, found, parameters, density)
    gradient, error, made = (
        integral.gradient,
        integral.error,
        found.total_strides + integral.strides,
    )
    fractal = integral.independence > INDEPENDENT
    unsure = ~(error <= MAX_RELATIVE_ERROR * np.abs(gradient)) & (found.area > 0)
    averaged = (unsure | fractal) & (widths is not None)
    error[fractal] = np.inf
    half_widths = np.zeros(len(parameters)) if widths is None else widths
    chosen = np.flatnonzero(averaged).tolist()
    ends = [walkers_at_band_ends(walker, parameters[k], half_widths[k]) for k in chosen]
    sizes = [*side_by_side(lambda one: at_band_ends.measure(one).size, itertools.chain(*ends))]
    for k, (low, high), below, above in zip(chosen, ends, sizes[::2], sizes[1::2], strict=True):
        width = float(value_of(high, parameters[k]) - value_of(low, parameters[k])) or np.nan
        gradient[k] = (above.area - below.area) / width
        error[k] = np.hypot(above.area_error, below.area_error) / width
        made += below.strides + above.strides
    return Measure(
        value=size.area,
        gradient=gradient,
        value_error=size.area_error,
        gradient_error=error,
        averaged=averaged,
        crossings=integral.crossings,
        lost=integral.lost,
        strides=made,
        fractal=fractal,
    )


class Integral(NamedTuple):
    """The integral of v along the boundary, for each parameter."""

    gradient: Float[np.ndarray, " parameters"]
    error: Float[np.ndarray, " parameters"]
    crossings: int
    lost: int
    strides: int
    independence: Float[np.ndarray, " parameters"]
    """Squared differences between neighbouring lines, over those expected if all crossings moved
    independently: 0 on a boundary that moves evenly, about 1 where it is fractal; NaN if nothing
    moves, and in three dimensions, where sheets thinner than a cell are met at random."""


class Size(NamedTuple):
    """The area of a basin, or the probability of starts in it, with its error, and the strides."""

    area: float
    area_error: float
    strides: int


def integrate_over_basin(found: Refined, density: Density | None) -> Size:
    """Compute the area, or the integral of a density at the cells' centres, corrected alike.

    Wrong cells are at the boundary, so the error of the integral is that of the area, at the mean
    density of the cells that were followed.
    """
    if density is None:
        return Size(found.area, found.area_error, found.total_strides)
    runs, grid = found.runs, found.grid
    walks = runs.attractor >= 0
    first, lengths = runs.first[walks], runs.lengths[walks]
    cells = np.repeat(first - np.cumsum(lengths) + lengths, lengths) + np.arange(lengths.sum())
    total = sum(
        float(density_at(density, grid.centres(cells[part])).sum())
        for part in cell_slices(len(cells))
    )
    if found.mistaken:
        total += float(density_at(density, grid.centres(found.mistakes)) @ found.missing)
    near = density_at(density, grid.centres(found.cells)) if len(found.cells) else np.zeros(1)
    error = found.area_error * float(near.mean())
    return Size(total * grid.cell_area, error, found.total_strides)


def density_at(density: Density, x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, " n"]:
    """Return the density of states, checked."""
    values = np.asarray(density(x), float)
    if values.shape != (len(x),) or not (np.isfinite(values) & (values >= 0)).all():
        raise WrongUse(
            f"density must return {len(x)} numbers, finite and not negative, not an array of shape "
            f"{values.shape}"
        )
    return values


def integrate_along_boundary(
    walker: System, found: Refined, parameters: Sequence[str], density: Density | None = None
) -> Integral:
    """Sum v |n_i|, times the density if given, over the points where lines cross the boundary."""
    if not parameters:
        return Integral(np.zeros(0), np.zeros(0), 0, 0, 0, np.zeros(0))
    fine = found.grid
    shape, count = np.array(fine.shape), len(parameters)
    tangents = np.asarray(fine.shear) * np.asarray(fine.spacing)  # columns: from cell to cell
    totals, extrapolated = np.zeros((LINE_GROUPS, count)), np.zeros(count)
    squares, differences = np.zeros(count), np.zeros(count)
    crossings, lost, unknown_count, made = 0, 0, 0, 0
    limits = MAX_WEIGHTS[len(shape)]

    def follow(places: Float[np.ndarray, "n axes"]) -> Label:
        nonlocal made
        labels = found.mapper(fine.points_at(places / shape))
        made += labels.total_strides
        return labels

    for axis in range(len(shape)):
        ends = np.stack(boundary_pairs(found, axis), axis=1)
        segments = Segments(ends, np.tile([True, False], (len(ends), 1)))
        for _ in range(BISECTIONS):
            segments = narrow(lambda places: follow(places).converged, segments)
        outside = segments.ends[:, 1]
        x = fine.points_at(outside / shape)
        labels = follow(outside)
        beyond = labels.strides
        given = tangents.T, parameters, found.mapper.integrator.tolerance
        margins, change = margins_with_derivatives(walker, x, beyond, *given)
        made += int((beyond + 1).sum()) * (change.shape[1] + 1)
        slopes, by_parameter = change[:, : len(shape)], change[:, len(shape) :]
        with np.errstate(invalid="ignore", divide="ignore"):
            steepness = np.sum(slopes**2, axis=1)
            moves = by_parameter * (np.abs(slopes[:, axis]) / steepness)[:, None]
            distance = np.abs(margins / slopes[:, axis])
        moves[distance > JUMP] = np.nan
        if density is not None and len(x):
            moves = moves * density_at(density, x)[:, None]
        known = np.isfinite(moves).all(axis=1)
        crossings, lost = crossings + len(x), lost + int(np.sum(~known))
        fixed = (labels.fate == Outcome.OUTSIDE) & (labels.strides == 0)
        unknown_count += int(np.sum(~known & ~fixed))
        between, within = compare_lines(outside[known], axis, fine.shape, moves[known])
        differences, squares = differences + between, squares + within
        most, half = (inverse_chances(outside, axis, c)[known, None] for c in limits)
        weight = 2 * most - half if len(shape) == 3 else half
        group = np.delete(np.floor(outside).astype(int), axis, axis=1).sum(axis=1) % LINE_GROUPS
        np.add.at(totals, group[known], moves[known] * weight)
        extrapolated += np.sum(moves[known] * (most - half), axis=0)
    cell = fine.cell_area
    scatter = np.sqrt(LINE_GROUPS) * np.std(totals, axis=0, ddof=1)
    error = np.hypot(scatter, extrapolated) * cell
    if unknown_count:  # they may all move the same way
        known_count = crossings - lost
        typical = np.sqrt(squares / known_count) if known_count else np.full(count, np.inf)
        error = np.hypot(error, unknown_count * typical * cell)
    with np.errstate(invalid="ignore"):
        independence = differences / squares if len(shape) == 2 else np.full(count, np.nan)
    return Integral(totals.sum(axis=0) * cell, error, crossings, lost, made, independence)


def check_bands(
    parameters: Sequence[str],
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None,
) -> Float[np.ndarray, " parameters"]:
    """Return the half widths of bands, 1 if none are given; refuse wrong parameters and widths."""
    widths = np.ones(len(parameters)) if bands is None else numbers("bands", bands)
    if widths.shape != (len(parameters),) or not np.all((widths > 0) & (widths < np.inf)):
        raise WrongUse(f"bands must be a number above 0 for each parameter, not {short(bands)}")
    return widths


def walkers_at_band_ends(walker: System, parameter: str, width: float) -> tuple[System, System]:
    """Return walkers with a parameter lower and higher by a width, or by less if refused."""
    value, ends = float(value_of(walker, parameter)), []
    for step in (-width, width):
        for _ in range(MAX_BAND_HALVINGS):
            try:
                check_parameter(walker, parameter, value + step)
                break
            except ValueError:
                step /= 2
        else:
            step = 0.0
        ends.append(with_parameter(walker, parameter, jnp.asarray(value + step)))
    return ends[0], ends[1]
