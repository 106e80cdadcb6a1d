"""The least step down of the ground from which a walker does not return to its gait."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import refuses_tracers
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.disturbances import BEYOND
from walker_jax.stability.gait_mapper import failure_test, mapper_of_gait
from walker_jax.stability.rays import FINE, bisect, first_failures, scan
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walking.iteration import strides as take_strides
from walker_jax.walking.stride import follow_step, stride

HEIGHTS = 4096
"""Number of heights that are tried, up to the least one from which the walker does not return."""


class LeastStepDown(NamedTuple):
    """The least step down from which a walker does not return to its gait, or falls."""

    size: float
    """Its height, at right angles to the slope, in the unit of length."""
    state: Float[np.ndarray, " full"]
    """(theta, phi, thetadot, phidot) just after heel strike on the lower ground; NaN if none."""
    phase: int
    """Number of the state of the gait from which the stride down begins."""
    failure: Outcome
    """Failure of the walker from just beyond it; `STRIDE` where it converges to another motion."""
    strides: int
    """Strides before the failing one, including the stride down."""


NO_STEP_DOWN = LeastStepDown(np.nan, np.full(4, np.nan), 0, Outcome.UNDECIDED, 0)
"""Result where no step down is known."""


@refuses_tracers()
def least_step_down(
    walker: Walker,
    gait: Gait | None = None,
    *,
    fall: bool = False,
    strides: int = 500,
    tolerance: float | None = None,
) -> LeastStepDown:
    """Find the least step down after which a walker does not return to its gait, or falls.

    One heel strike is on lower ground (`step_down`), and so are all that follow. The search tries
    `HEIGHTS` heights up to the least one; it may miss failures in narrower ranges. Arguments and
    errors are those of `least_disturbance`.

    ```python
    found = wj.least_step_down(wj.SimplestWalker(0.004))
    found.size  # in leg lengths
    found.failure
    ```
    """
    check_planar(walker)
    lost = failure_test(fall)
    mapper = mapper_of_gait(walker, gait, strides, tolerance)
    states = mapper.attractors[0].states

    def end(state, heights):
        starts = np.broadcast_to(state, (len(heights), len(state)))
        return labels_after_step(mapper, starts, heights.astype(states.dtype))

    up = np.ones((1, 1))
    found = []
    for state in states:
        fails = lambda heights, state=state: lost(end(state, heights[:, 0]))
        reach = scan(fails, up, HEIGHTS)[0]
        first = first_failures(fails, up, 0.0, reach, HEIGHTS)
        found.append(bisect(fails, up, first, reach / HEIGHTS, FINE)[0])
    phase = int(np.argmin(found))
    height = float(found[phase])
    beyond = end(states[phase], BEYOND * height)
    first = int(lost(beyond).argmax())
    failure, made = Outcome(int(beyond.fate[first])), int(beyond.strides[first])
    down = stride(walker, states[phase], step=-height, tolerance=tolerance)
    return LeastStepDown(height, np.asarray(down.state), phase, failure, made)


def labels_after_step(
    mapper: Mapper, x: Float[np.ndarray, "n section"], drops: Float[np.ndarray, " n"]
) -> Label:
    """Label walkers that step down by `drops` from x; the stride down counts."""
    walker, integrator = mapper.walker, mapper.integrator
    arguments = (
        in_dtype(walker, x.dtype),
        x,
        -drops,
        integrator.in_dtype(x.dtype),
    )
    down = map_cells(follow_step, arguments, (False, True, True, False))
    after = take_strides(walker, down.state, tolerance=integrator.tolerance)
    rest = mapper(np.asarray(after.state))
    fate = np.where(after.outcome == Outcome.STRIDE, rest.fate, after.outcome)
    fate = np.where(down.outcome == Outcome.STRIDE, fate, down.outcome)
    made = [(one.outcome == Outcome.STRIDE).astype(np.int32) for one in (down, after)]
    attractor = np.where(fate == Outcome.STRIDE, rest.attractor, -1)
    return Label(fate, attractor, rest.strides + sum(made), rest.state)
