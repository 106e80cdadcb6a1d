"""The least disturbance of a gait.

A disturbance moves the walker from its gait to another point of the Poincaré section. The least
disturbance from which it does not return, or falls, is the minimal fatal shock. It tells more about
a machine than the Floquet multipliers of its gait (Schwab and Wisse 2001, section 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from walker_jax.basins.mapper import Mapper
from walker_jax.checks import ComputationFailed, check_kind, refuses_tracers
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.stability.descents import nearest_failure
from walker_jax.stability.gait_mapper import failure_test, mapper_of_gait, with_other_gaits
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.stability.metric import DistanceFunction, metric_of
from walker_jax.stability.rays import DENSE, spread_directions
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System

BEYOND = 1 + np.array([1e-8, 1e-10, 0.0])
"""Multiples of the least disturbance; the first that fails gives the failure. They exceed it by
more than rounding errors, unless it fails itself."""
SEARCH_TOLERANCE = 1e-9
"""Tolerance of the integration in searches, whose results are then measured at the given one. It
takes half as long as the default, and moves a boundary by far less than the distances that searches
try."""
OTHER_GAITS_DIRECTIONS, OTHER_GAITS_DISTANCES = 90, 0.1 * 0.5 ** np.arange(12.0)[:, None]
"""Directions and distances of starts from which walkers may converge to other gaits."""


class LeastDisturbance(NamedTuple):
    """The nearest point to a gait from which the walker does not return, or falls."""

    size: float
    """Its distance from the gait, in the given metric."""
    direction: Float[np.ndarray, " section"]
    """Its direction from the gait: the disturbance divided by its size. With `scale`, it is in
    those units, in which it has length one."""
    state: Float[np.ndarray, " section"]
    """The point itself, on the section."""
    phase: int
    """Number of the nearest state of the gait."""
    failure: Outcome
    """Failure of the walker from just beyond it; `STRIDE` where it converges to another motion."""
    strides: int
    """Strides before the failing one."""


@refuses_tracers("measure gives derivatives of the least disturbance")
def least_disturbance(
    walker: System,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    metric: Sequence[Any] | ArrayLike | DistanceFunction | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    fall: bool = False,
    directions: int = DENSE,
    strides: int = 500,
    tolerance: float | None = None,
    solver: AnySolver | None = None,
    progress: bool = True,
) -> LeastDisturbance:
    """Find the least disturbance after which a walker does not return to its gait, or falls.

    The result is the nearest such point to the gait, on the section. From there the walker may
    converge to another attractor: then the `failure` is `STRIDE`, and the nearest point from which
    it falls, found with `fall`, is farther. Otherwise the two points are the same.

    The search follows rays from the gait outwards, all at once, to the first distance from which
    the walker does not return. It then follows closer rays, up to the smallest of these distances.
    Last come ever narrower fans around the rays that are nearer than their neighbours, and steps
    along the boundary's gradient. It tries all directions at distances 1.6 % of the size apart, or
    0.16 % close to it, where directions are 8 times as close. It may miss a finger of failures
    between these points; the size is then too large by as much as the finger is nearer.

    In more than three dimensions, as for a walker in space, not all directions can be tried. There
    random rays find failures. Descents along the boundary's gradient lead from the nearest of them
    to minima of the distance, and the least is returned: another one may be nearer.

    ```python
    walker = wj.SimplestWalker(0.004)
    found = wj.least_disturbance(walker, wj.find_gait(walker))
    found.size, found.direction, found.failure
    ```

    **Arguments:**

    - `walker`: one walker, with numbers for parameters.
    - `gait`: a stable gait; that of `find_gait` by default.
    - `scale`: unit of length along each coordinate of the section, positive. The size is the length
      of the disturbance in these units; by default they are 1.
    - `metric`: instead of a scale, a symmetric positive definite matrix M: the size of a
      disturbance d is sqrt(d^T M d). Or a function, written with JAX, of a state of the gait and a
      disturbance; it is zero for no disturbance and grows along every ray.
    - `along`: vectors, one a row, that span the disturbances, such as (0, 1) for a push that
      changes thetadot alone. By default disturbances have any direction.
    - `fall`: whether only falls count, and not convergence to another attractor.
    - `directions`: number of directions in a plane. Three dimensions have four times as many, and
      more dimensions a sixteenth, at random.
    - `strides`: number of strides in which a walker may return, or fall.
    - `tolerance`, `solver`: of the integration, as in `stride`.
    - `progress`: whether to show progress on a terminal, after a second.

    Raises `ValueError` for a gait that is not stable, or not found, and for a scale or vectors that
    do not fit the section; `ComputationFailed` where the walker returns from all disturbances up to
    a size of a thousand.
    """
    sizes = metric_of(walker, scale, along, metric)
    lost = failure_test(fall)
    check_kind("progress", progress, bool)
    mapper = mapper_of_gait(walker, gait, strides, tolerance, solver)
    states = mapper.attractors[0].states
    rays = spread_directions(len(sizes.basis), OTHER_GAITS_DIRECTIONS) @ sizes.basis
    y = (OTHER_GAITS_DISTANCES * rays[:, None]).reshape(-1, rays.shape[1])
    around = [x + sizes.disturbance(x, y) for x in states]
    all_gaits = with_other_gaits(mapper, np.concatenate(around))
    loose = all_gaits._replace(
        integrator=Integrator(
            max(mapper.integrator.tolerance, SEARCH_TOLERANCE), mapper.integrator.solver
        )
    )

    def fails(
        points: Float[np.ndarray, "n section"], mapper: Mapper = all_gaits
    ) -> Bool[np.ndarray, " n"]:
        return lost(mapper(points, progress="disturbances" if progress else None))

    def gradient(points: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n section"]:
        count = all_gaits(points).strides
        axes = np.eye(points.shape[1])
        by = mapper.integrator
        return differentiate_margins(walker, points, count, axes, (), by.tolerance, by.solver)

    def nearest(x: Float[np.ndarray, " section"]) -> Float[np.ndarray, " section"]:
        def gradient_along(y: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n section"]:
            return sizes.pull_back(x, y, gradient(x + sizes.disturbance(x, y)))

        return nearest_failure(
            lambda y: fails(x + sizes.disturbance(x, y)),
            sizes.basis,
            gradient_along,
            directions,
            lambda y: fails(x + sizes.disturbance(x, y), loose),
        )

    found = [nearest(x) for x in states]
    phase = int(np.argmin([np.linalg.norm(one) for one in found]))
    x, step = states[phase], found[phase]
    length = float(np.linalg.norm(step))
    tried = sizes.disturbance(x, BEYOND[:, None] * step)
    beyond = (all_gaits if fall else mapper)(x + tried)
    first = int(lost(beyond).argmax())
    failure, made = Outcome(int(beyond.fate[first])), int(beyond.strides[first])
    disturbance = tried[-1]
    direction = (disturbance if scale is None else step) / length
    return LeastDisturbance(length, direction, x + disturbance, phase, failure, made)


def least_disturbance_if_any(walker: System, gait: Gait, **about: Any) -> LeastDisturbance:
    """Find `least_disturbance`; NaN, and a failure of -1, where all tried disturbances return."""
    try:
        return least_disturbance(walker, gait, progress=False, **about)
    except ComputationFailed:
        unknown = np.full(len(walker.section), np.nan)
        none: Any = -1
        return LeastDisturbance(np.nan, unknown, unknown, 0, none, -1)
