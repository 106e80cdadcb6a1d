"""How large a disturbance a gait survives.

A disturbance moves the walker from its gait to another point of the Poincaré section. The least one
from which it does not return, or falls (the minimal fatal shock), says more of a machine than the
Floquet multipliers of its gait do (Schwab and Wisse 2001, section 5).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from walker_jax.checks import refuses_tracers
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.gait_mapper import failure_test, mapper_of_gait, with_other_gaits
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.stability.metric import metric
from walker_jax.stability.rays import directions, nearest_failure
from walker_jax.walkers.model import Walker
from walker_jax.walking.outcomes import Outcome

BEYOND = 1 + np.array([1e-8, 1e-10, 0.0])
"""Of the least disturbance, those of which the first that fails says how: rounding is less."""
OTHER_GAITS_DIRECTIONS, OTHER_GAITS_DISTANCES = 90, 0.1 * 0.5 ** np.arange(12.0)[:, None]
"""Of starts from which walkers may converge to other gaits."""


class LeastDisturbance(NamedTuple):
    """The nearest point to a gait from which the walker does not return, or falls."""

    size: float
    """Its distance from the gait, in the metric asked for."""
    direction: Float[np.ndarray, " section"]
    """Of it from the gait, of length one in that metric."""
    state: Float[np.ndarray, " section"]
    """The point."""
    phase: int
    """The state of the gait that it is nearest to."""
    failure: Outcome
    """How the walker fails from just beyond it; `STRIDE` where it converges to another motion."""
    strides: int
    """Strides before that, the failing one not counted."""


@refuses_tracers("disturbance_gradient gives derivatives of the least disturbance")
def least_disturbance(
    walker: Walker,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    fall: bool = False,
    strides: int = 500,
    tolerance: float | None = None,
) -> LeastDisturbance:
    """The nearest point of the section from which a walker does not return to its gait, or falls.

    From the nearest point at which it does not return it may converge to another: the `failure`
    is `STRIDE` then, and the nearest at which it falls, found with `fall`, is farther. Otherwise
    these are the same.

    Rays from the gait are followed outwards, all at once, to the first distance from which the
    walker does not return; then closer rays, up to the least of these; then fans of rays around
    those that are nearer than their neighbours, ever narrower, and along the boundary's gradient.
    Fingers of failure may be missed that pass between the points tried, in 11,520 directions at
    distances 1.6 % of the size apart, or 0.16 % close to it, where directions are 8 times as close
    too: then the size found is too large by as much as such a finger comes nearer.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `gait`: a stable one; the most stable of period one, by default.
    - `scale`: what counts as one unit along each coordinate of the section, positive. The size is
      the length of the disturbance divided by it; by default it is plain length.
    - `along`: vectors, one a row, that disturbances are made of, such as (0, 1) for a push that
      changes thetadot alone. By default they have any direction.
    - `fall`: whether the walker is to fall, and no other motion counts.
    - `strides`: how many of them a walker may take to return, or to fall.
    - `tolerance`: of the integration, as in `stride`.

    `ValueError` for a gait that is not stable, or not found, and for a scale or vectors that are
    not of the section; `ComputationFailed` where no disturbance up to a size of a thousand is
    found from which the walker does not return.
    """
    unit, basis = metric(walker, scale, along)
    lost = failure_test(fall)
    mapper = mapper_of_gait(walker, gait, strides, tolerance)
    states = mapper.attractors[0].states
    if fall:
        rays = directions(len(basis), OTHER_GAITS_DIRECTIONS) @ basis * unit
        starts = states[:, None, None] + OTHER_GAITS_DISTANCES * rays[:, None]
        mapper = with_other_gaits(mapper, starts.reshape(-1, len(unit)))

    def fails(points: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        return lost(mapper(points))

    def gradient(points: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n section"]:
        count = mapper(points).strides
        return differentiate_margins(walker, points, count, np.eye(len(unit)), (), mapper.tolerance)

    found = [
        nearest_failure(
            lambda y, x=x: fails(x + y * unit), basis, lambda y, x=x: gradient(x + y * unit) * unit
        )
        for x in states
    ]
    phase = int(np.argmin([np.linalg.norm(one) for one in found]))
    step = found[phase]
    length = float(np.linalg.norm(step))
    state = states[phase] + step * unit
    beyond = mapper(states[phase] + BEYOND[:, None] * step * unit)
    first = int(lost(beyond).argmax())
    failure, made = Outcome(int(beyond.fate[first])), int(beyond.strides[first])
    return LeastDisturbance(length, step / length, state, phase, failure, made)
