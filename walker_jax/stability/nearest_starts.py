"""The nearest starts from which a walker does not return to its gait, from `robustness`."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.systems.outcomes import Outcome, names_in


class NearestStart(NamedTuple):
    """The nearest start from which a walker does not return to its gait, or falls."""

    gait_state: Float[np.ndarray, " section"]
    """The nearest state of the gait."""
    distance: float
    state: Float[np.ndarray, " section"]
    outcome: Outcome
    """Failure of the walker; `STRIDE` where it converges to another attractor."""
    strides: int
    """Strides before the failing one."""


def has_plane_disturbance(data: xr.Dataset) -> bool:
    """Return whether a data set has a least disturbance and fates over one section of two axes."""
    known = {"fate", "least_disturbance", "failing_state", "gait_state"} <= set(data)
    if not known or data["fate"].ndim != 2 or data["least_disturbance"].ndim:
        return False
    return len(names_in(data, "section")) == 2 and bool(np.isfinite(data["least_disturbance"]))


def nearest_starts(data: xr.Dataset) -> list[NearestStart]:
    """Return the nearest start that does not return, and the nearest that falls, if another."""
    nearest = NearestStart(
        data["gait_state"].values,
        float(data["least_disturbance"]),
        data["failing_state"].values,
        Outcome(int(data["failure"])),
        int(data["failing_strides"]),
    )
    if nearest.outcome != Outcome.STRIDE:
        return [nearest]
    distance, state = float(data["least_fall"]), data["fall_state"].values
    if not np.isfinite(distance):  # nothing falls
        return [nearest]
    fall = NearestStart(
        state - distance * data["fall_direction"].values,
        distance,
        state,
        Outcome(int(data["fall_failure"])),
        int(data["fall_strides"]),
    )
    return [nearest, fall]


def circle(
    centre: Float[np.ndarray, " 2"], radius: float, points: int = 400
) -> Float[np.ndarray, "points 2"]:
    """Return states at a distance from another, on a section of two coordinates."""
    turn = np.linspace(0, 2 * np.pi, points)
    return centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
