"""Traps: ellipses about a stable gait that strides provably map into themselves.

A trap is a disc |L^T (x - centre)| <= size of a norm that is adapted to the gait:

    L L^T = sum_k (M^T)^k M^k / r^2k,

for the Jacobian M of the gait's return and some r between the largest modulus of its multipliers
and 1. In this norm M contracts by a factor of at most r (a discrete Lyapunov equation). Squares in
the coordinates L^T x cover the ellipse, and each has to come back into the ellipse. No proof rests
on how L and the size were found.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_discrete_lyapunov

from walker_jax.checks import ComputationFailed
from walker_jax.proofs.boxes import TRAPPED, Boxes, Trap, boxes_of, carry, upright_boxes
from walker_jax.proofs.enclosures import exactly
from walker_jax.proofs.strides import STRIDE

SQUARES = 24
"""Number of squares along a diameter of the ellipse."""
SLACK = 1e-8
"""Part of its size by which the cover reaches beyond the ellipse, for the rounding of L's inverse,
and of theirs by which its squares overlap, for the rounding of their corners."""
SHRINKING = 0.8
"""Ratio of successive sizes that are tried."""
LARGEST_TRAP = 1.0


def adapted_factor(jacobian: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "2 2"] | None:
    """Return L, with det L = 1, such that the Jacobian contracts the norm |L^T x|.

    The result is None if the gait is not stable.
    """
    radius = max(abs(np.linalg.eigvals(jacobian)))
    if not radius < 1:
        return None
    scaled = jacobian / ((1 + radius) / 2)
    factor = np.linalg.cholesky(solve_discrete_lyapunov(scaled.T, np.eye(2)))
    return factor / np.sqrt(np.prod(np.diag(factor)))


def cover(trap: Trap) -> Boxes:
    """Return parallelograms that cover a trap; none if float64 cannot represent L's inverse."""
    inverse = np.linalg.inv(trap.factor.T)
    if not is_inverse(trap.factor, inverse):
        return Boxes(np.zeros((0, 2, 3)), np.zeros((0, 2)))
    reach = trap.size * (1 + SLACK)
    half = reach / SQUARES
    ticks = -reach + half * (2 * np.arange(SQUARES) + 1)
    z = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)
    nearest = np.maximum(np.abs(z) - half, 0)
    z = z[np.hypot(*nearest.T) <= reach]
    p, q = upright_boxes(z.T, [np.full(len(z), half * (1 + SLACK))] * 2)
    exact = lambda value: exactly(np.float64(value), p.space)
    return boxes_of(
        *(
            exact(c) + exact(row[0]) * p + exact(row[1]) * q
            for c, row in zip(trap.centre, inverse, strict=True)
        )
    )


def is_inverse(factor: np.ndarray, inverse: np.ndarray) -> bool:
    """Return whether L^T times its computed inverse is the identity, to far below `SLACK`."""
    off = np.abs(factor.T @ inverse - np.eye(2)).max()
    sizes = (np.abs(factor.T) @ np.abs(inverse)).max()
    return bool(off + 8 * 2.0**-53 * sizes < SLACK / 16)


def is_trap(walker, trap: Trap, period: int) -> bool:
    """Return whether `period` strides certainly lead all of an ellipse into itself."""
    boxes = cover(trap)
    if not boxes.count:
        return False
    for stride in range(period):
        last = stride == period - 1
        found = carry(walker, boxes, trap if last else Trap.nowhere())
        if not np.all(found.verdicts == (TRAPPED if last else STRIDE)):
            return False
        boxes = found.boxes
    return True


def find_trap(walker, centre: np.ndarray, jacobian: np.ndarray, period: int, least: float) -> Trap:
    """Find the largest trap about a stable gait among the tried ellipses of one shape.

    Raises `ComputationFailed` if none larger than `least` is proved.
    """
    factor, size = adapted_factor(jacobian), LARGEST_TRAP
    while factor is not None and size > least:
        trap = Trap(np.asarray(centre, float), factor, size)
        if is_trap(walker, trap, period):
            return trap
        size *= SHRINKING
    raise ComputationFailed(
        "no trap about the gait is proved: it must be stable by more than the rounding of float64"
    )
