"""The nearest starts from which a walker does not return to its gait, from `robustness`."""

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.stability.disturbances import LeastDisturbance
from walker_jax.stability.robustness_fields import LEAST_DISTURBANCE, LEAST_FALL
from walker_jax.systems.outcomes import Outcome, names_in


def has_plane_disturbance(data: xr.Dataset) -> bool:
    """Return whether a data set has a least disturbance and fates over one section of two axes."""
    known = {"fate", "least_disturbance", "failing_state", "gait_state"} <= set(data)
    if not known or data["fate"].ndim != 2 or data["least_disturbance"].ndim:
        return False
    return len(names_in(data, "section")) == 2 and bool(np.isfinite(data["least_disturbance"]))


def nearest_starts(data: xr.Dataset) -> list[LeastDisturbance]:
    """Return the nearest start that does not return, and the nearest that falls, if another."""
    nearest = read_disturbance(data, LEAST_DISTURBANCE)
    if nearest.failure != Outcome.STRIDE or not np.isfinite(data["least_fall"]):
        return [nearest]
    return [nearest, read_disturbance(data, LEAST_FALL)]


def read_disturbance(data: xr.Dataset, group: dict[str, str]) -> LeastDisturbance:
    """Return a disturbance from the variables of its group."""
    size, direction, state, failure, strides = (data[name].values for name in group.values())
    return LeastDisturbance(float(size), direction, state, 0, Outcome(int(failure)), int(strides))


def circle(
    centre: Float[np.ndarray, " 2"], radius: float, points: int = 400
) -> Float[np.ndarray, "points 2"]:
    """Return states at a distance from another, on a section of two coordinates."""
    turn = np.linspace(0, 2 * np.pi, points)
    return centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
