"""The actions that lead into a target with the least effort, by dynamic programming."""

import numpy as np
from jaxtyping import Bool, Float, Int32

from walker_jax.control.actions import Actions
from walker_jax.controlled_maps import Points, parts
from walker_jax.systems.system import System, numbers_of


def effort_of(walker: System, actions: Actions) -> Float[np.ndarray, " m"]:
    """The effort of a stride by each action.

    It is the square of how far each parameter is from the walker's own value, in parts of the range
    of all actions, summed over parameters.
    """
    own = np.array([float(numbers_of(walker)[name]) for name in actions.names])
    ranges = np.ptp(actions.values, axis=0)
    return (((actions.values - own) / np.where(ranges > 0, ranges, 1)) ** 2).sum(axis=1)


def find_least_effort(
    points: Points, target: Bool[np.ndarray, " n"], effort: Float[np.ndarray, " m"]
) -> tuple[Int32[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The action from each cell on the way of least effort into a target, and the effort in all.

    That is -1 and infinite where no way leads there; -1 and 0 in the target. An action changes only
    where that takes less effort, so no way goes round a cycle of strides without any.
    """
    n, m = points.shape
    total = np.where(target, 0.0, np.inf)
    action = np.full(n, -1, np.int32)
    changes = True
    while changes:
        following, changes = np.append(total, np.inf), False
        for cells in parts(np.flatnonzero(~target), m):
            each = effort + following[np.minimum(points.image[cells], n)]
            less = each.min(axis=1) < total[cells]
            action[cells[less]] = each[less].argmin(axis=1)
            total[cells[less]] = each[less].min(axis=1)
            changes |= bool(less.any())
    return action, total
