"""Errors of fitted parameters, and the combinations of them that recordings do not tell apart."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

SINGULAR = 1e-9
"""A direction whose information is less than this, squared, relative to the best known one, is
without any: rounding errors."""
LARGE_ERROR = 1.0
"""Relative error from which on a direction counts as unknown."""
SMALL_WEIGHT = 0.1
"""Parameters with less weight in a direction are left out of its words."""


class Direction(NamedTuple):
    """A combination of parameters, each relative to its own value, and its standard deviation."""

    weights: dict[str, float]
    """A unit vector."""
    deviation: float
    """Relative; infinite if the recordings tell nothing of it."""

    def __str__(self) -> str:
        shown = {name: w for name, w in self.weights.items() if abs(w) >= SMALL_WEIGHT}
        words = " ".join(f"{w:+.2f} {name}" for name, w in shown.items()).removeprefix("+")
        return f"{words}: {self.deviation:.2g}"


def unknown_among(directions: Sequence[Direction]) -> list[Direction]:
    """Return the directions that recordings tell too little of."""
    return [one for one in directions if one.deviation > LARGE_ERROR]


def information(
    jacobian: Float[np.ndarray, "residuals unknowns"], parameters: int
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the triangular root R of the information R^T R about the parameters alone.

    They are the first unknowns; all others are fitted along.
    """
    others_first = np.roll(jacobian, -parameters, axis=1)
    triangle = np.asarray(np.linalg.qr(others_first, mode="r"))
    return triangle[-parameters:, -parameters:]


def covariance_and_directions(
    root: Float[np.ndarray, "parameters parameters"],
    names: Sequence[str],
    sizes: Float[np.ndarray, " parameters"],
) -> tuple[Float[np.ndarray, "parameters parameters"], tuple[Direction, ...]]:
    """Return the covariance (R^T R)^-1, and its directions relative to `sizes`, the worst first.

    Entries of parameters without information are infinite: neither units nor values near zero, on
    which `sizes` depend, decide which these are.
    """
    norms = np.linalg.norm(root, axis=0)
    units = 1 / np.where(norms > 0, norms, 1)
    _, singular, rows = np.linalg.svd(root * units)
    lost = singular <= SINGULAR * singular[0]
    known = rows * np.where(lost, 0, 1 / np.where(lost, 1, singular))[:, None] * units
    covariance = known.T @ known
    unknown = (np.abs(rows[lost]) > 1e-6).any(axis=0)
    covariance[unknown, :], covariance[:, unknown] = np.nan, np.nan
    covariance[unknown, unknown] = np.inf
    _, singular, rows = np.linalg.svd(root * sizes)
    with np.errstate(divide="ignore"):
        deviations = np.where(lost, np.inf, 1 / singular)  # sorted: the last
    directions = []
    for row, deviation in zip(rows[::-1], deviations[::-1], strict=True):
        sign = np.sign(row[np.argmax(np.abs(row))])
        weights = dict(zip(names, (sign * row).tolist(), strict=True))
        directions.append(Direction(weights, float(deviation)))
    return covariance, tuple(directions)
