"""The least disturbance of a gait, and its derivatives by parameters of the walker.

By the envelope theorem, its derivative follows from the nearest point of the boundary.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.design.area_gradients import check_bands, walkers_at_band_ends
from walker_jax.design.measures import Measure
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import GaitPull
from walker_jax.gaits.search import search_gait
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import default_tolerance
from walker_jax.stability.disturbances import BEYOND, LeastDisturbance, least_disturbance
from walker_jax.stability.margin_changes import margins_with_derivatives
from walker_jax.stability.rays import DENSE
from walker_jax.systems.system import System
from walker_jax.walkers.choices import Choice, numbers_chosen
from walker_jax.walkers.parameters import value_of

JUMP = 1e-6
"""Distance to a failure just beyond the nearest point, by its margin and the margin's slope along
the disturbance, over the size, above which the margin jumps there. Otherwise it is at most 1e-8,
which is how far beyond that is, but for errors of the integration."""


def disturbance_gradient(
    walker: System,
    parameters: Choice = ("slope",),
    gait: Gait | None = None,
    *,
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    fall: bool = False,
    directions: int = DENSE,
    strides: int = 500,
    tolerance: float | None = None,
) -> Measure:
    """Compute the least disturbance of a gait, and its derivatives by parameters of the walker.

    The least disturbance (the minimal fatal shock) is the smallest from which the walker does not
    return or, with `fall`, from which it falls.

    At the nearest point of the boundary, x = g + r u with g the gait's state and u of length one,
    the margin stays zero: dr/dp = -(dm/dp + grad m . dg/dp) / (grad m . u). The rotation of u is of
    second order. Where two points are equally near, the size has a kink, and the derivative is the
    one on the side of the point found.

    If the nearest point leads to another motion instead of a failure, it has no margin; and the
    margin of the failure may jump there, as where a strike is missed that would have led to another
    stride. The derivatives are then averages over `bands`, as in `area_gradient`, as far as the
    gait is stable there, or NaN without bands.

    Arguments and errors are those of `least_disturbance`, in its plain metric.
    """
    parameters = numbers_chosen(walker, parameters)
    widths, every = check_bands(parameters, bands), np.ones(len(parameters), bool)
    gait = require_gait(walker, ["gait"], tolerance=tolerance) if gait is None else gait
    search = partial(
        least_disturbance,
        along=along,
        fall=fall,
        directions=directions,
        strides=strides,
        tolerance=tolerance,
    )
    found = search(walker, gait)
    if not parameters:
        return Measure(found.size, np.zeros(0), averaged=~every)
    checked_tolerance = default_tolerance(found.state.dtype, tolerance)
    beyond = np.asarray(gait.states)[found.phase] + BEYOND[:, None] * found.size * found.direction
    made, axes = np.full(len(beyond), found.strides, np.int32), np.eye(beyond.shape[1])
    given = axes, parameters, checked_tolerance
    margins, changes = margins_with_derivatives(walker, beyond, made, *given)
    slopes_along = changes[:, : len(axes)] @ found.direction
    known = np.isfinite(changes).all(axis=1)
    known &= np.abs(margins) <= JUMP * found.size * np.abs(slopes_along)
    for change, slope in zip(changes[known], slopes_along[known], strict=True):
        by_state, by_parameter = np.zeros_like(gait.states), change[len(axes) :]
        by_state[found.phase] = change[: len(axes)]
        moved = GaitPull(walker, gait, parameters, tolerance).pull(
            by_state, np.zeros(len(by_state)), np.zeros(len(axes), complex)
        )
        gradient = -(by_parameter + moved) / slope
        return Measure(found.size, gradient, averaged=~every)
    if bands is None:
        return Measure(found.size, np.full(len(widths), np.nan), averaged=~every)
    pairs = zip(parameters, widths, strict=True)
    gradient = [mean_derivative_over_band(search, walker, gait, *pair, tolerance) for pair in pairs]
    return Measure(found.size, np.array(gradient), averaged=every)


def mean_derivative_over_band(
    search: Callable[[System, Gait], LeastDisturbance],
    walker: System,
    gait: Gait,
    parameter: str,
    width: float,
    tolerance: float | None,
) -> float:
    """Average the derivative of the least disturbance over a band whose ends have the gait."""
    ends = []
    for one in walkers_at_band_ends(walker, parameter, width):
        there = search_gait(one, gait.states, len(gait.states), tolerance=tolerance)
        one, there = (one, there) if there.found and there.stable else (walker, gait)
        ends.append((float(value_of(one, parameter)), search(one, there).size))
    (low, below), (high, above) = ends
    return (above - below) / (high - low) if high > low else np.nan
