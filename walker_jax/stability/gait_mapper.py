"""The mapper to a stable gait, and the test of its failures."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from walker_jax.basins.attractor import Attractor, capture_radius
from walker_jax.basins.attractor_search import with_attractors_from
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import WrongUse, check_kind, check_precision
from walker_jax.gaits.cycles import Gait, check_cycle, check_found
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import AnySolver, integrator_of
from walker_jax.systems.system import System, check_single
from walker_jax.walking.iteration import strides as take_strides


def mapper_of_gait(
    walker: System,
    gait: Gait | None,
    strides: int,
    tolerance: float | None,
    solver: AnySolver | None = None,
) -> Mapper:
    """Return the mapper whose only attractor is a stable gait, with its capture boxes.

    Raises `ValueError` for a gait that is not stable, not found, or not one of this walker;
    `ComputationFailed` where none is given and none is found.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    by: Any = {"tolerance": tolerance, "solver": solver}
    gait = require_gait(walker, ["gait"], **by) if gait is None else gait
    check_found(gait)
    if not gait.stable:
        size = float(np.abs(gait.multipliers).max())
        raise WrongUse(
            f"gait must be stable, not with a multiplier of size {size:.6g}: give find_gait "
            "another guess, or take another slope"
        )
    states = np.asarray(gait.states)
    check_precision(states.dtype)
    if states.shape[1:] != (len(walker.section),):
        raise WrongUse(f"gait must be one of this walker, on {', '.join(walker.section)}")
    ends = np.asarray(take_strides(walker, states, **by).state)
    check_cycle(walker, states, ends, capture_radius(states.dtype))
    integrator = integrator_of(states.dtype, tolerance, solver)
    return with_capture_boxes(Mapper(walker, [Attractor(states)], integrator, strides, 0))


def with_other_gaits(mapper: Mapper, starts: Float[np.ndarray, "n section"]) -> Mapper:
    """Add to a mapper the other gaits to which walkers from some starts converge.

    Walkers that converge to one of these need not be followed to their last stride.
    """
    found = with_attractors_from(mapper, starts)
    gaits = [one for one in found.attractors if one.period]
    if len(gaits) == 1:
        return mapper
    return with_capture_boxes(found._replace(attractors=gaits))


def failure_test(fall: bool) -> Callable[[Label], Bool[np.ndarray, " n"]]:
    """Return a test of labels: whether walkers fall or, unless `fall`, do not return."""
    check_kind("fall", fall, bool)
    return lambda labels: labels.fallen if fall else labels.attractor != 0
