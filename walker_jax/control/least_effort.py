"""The actions that lead into a target with the least effort, by dynamic programming."""

import numpy as np
from jaxtyping import Bool, Float, Int32

from walker_jax.control.actions import Actions
from walker_jax.controlled_maps import Points, parts
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import value_of


def effort_of(walker: System, actions: Actions) -> Float[np.ndarray, " m"]:
    """Return the effort of a stride by each action.

    It is the sum over parameters of the squared deviation from the walker's own value, in units of
    the range of all actions.
    """
    own = np.array([float(value_of(walker, name)) for name in actions.names])
    ranges = np.ptp(actions.values, axis=0)
    return (((actions.values - own) / np.where(ranges > 0, ranges, 1)) ** 2).sum(axis=1)


def find_least_effort(
    points: Points, target: Bool[np.ndarray, " n"], effort: Float[np.ndarray, " m"]
) -> tuple[Int32[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find the action from each cell on the path of least effort into a target, and the effort.

    The action is -1 in the target, where the effort is 0, and where no path leads there, where the
    effort is infinite. An action changes only if that takes less effort, so no path goes round a
    cycle of strides without effort.
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
