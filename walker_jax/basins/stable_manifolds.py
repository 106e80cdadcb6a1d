"""The stable manifold of a saddle: the starts that converge to an unstable gait.

It begins along the stable direction of the saddle. Each further piece is the preimage of the one
before, point by point by Newton's iteration; preimages of errors shrink, as what is unstable
forwards is stable backwards.
"""

import numpy as np
from jaxtyping import Float

from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    check_precision,
    check_whole,
    refuses_tracers,
)
from walker_jax.gaits.cycles import Gait, multiply_jacobians
from walker_jax.gaits.derivatives import linearise
from walker_jax.integrators.solvers import default_tolerance
from walker_jax.walkers.model import Walker

FIRST = 1e-5
"""Distance from the saddle up to which the manifold is taken for straight: it bends by 1e-10."""
FIRST_POINTS = 9
"""Points of the first piece."""
STEPS = 12
"""Newton steps to a preimage: quadratic, from a guess beside it, they need three or four."""
EXACT = 1e-11
"""Residual of a preimage, at most."""


@refuses_tracers()
def stable_manifold(
    walker: Walker,
    gait: Gait,
    *,
    spacing: float = 2e-3,
    pieces: int = 40,
    tolerance: float | None = None,
) -> list[Float[np.ndarray, "n section"]]:
    """The stable manifold of an unstable gait on a section of two coordinates: two curves.

    Each goes out from the gait's first state, and ends where the manifold does: at a point with no
    preimage under the stride function, or outside the feasible starts.

    **Arguments:**

    - `walker`: that of the gait.
    - `gait`: a saddle, with one multiplier outside the unit circle and one inside.
    - `spacing`: of the points of a curve, at most, in the coordinates of the section.
    - `pieces`: how often the preimage of a piece is taken, at most.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for another gait or section, and in float32.
    """
    check_kind("walker", walker, Walker)
    check_kind("gait", gait, Gait)
    check_whole("pieces", pieces)
    check_number("spacing", spacing)
    if not 0 < spacing < np.inf:
        raise WrongUse(f"spacing must be positive and finite, not {spacing}")
    states = np.asarray(gait.states)
    check_precision(states.dtype, "stable_manifold, which inverts strides to 1e-11,")
    sizes = np.abs(np.asarray(gait.multipliers))
    if not gait.found or len(sizes) != 2 or not sizes[0] > 1 > sizes[1]:
        raise WrongUse(
            f"gait must be a saddle on a section of two coordinates, not one with multipliers "
            f"{np.asarray(gait.multipliers).tolist()}"
        )
    checked_tolerance = float(default_tolerance(states.dtype, tolerance))
    inverse = Preimages(walker, len(states), checked_tolerance)
    values, vectors = np.linalg.eig(inverse.jacobian_along(states))
    at = int(np.abs(values).argmin())
    rate, direction = float(values[at].real), vectors[:, at].real
    # twice round, where the manifold's halves change places
    turns = 1 if rate > 0 else 2
    curves = []
    for sign in (1, -1):
        shares = np.geomspace(rate**turns, 1, FIRST_POINTS)
        piece = states[0] + sign * FIRST * shares[:, None] * direction
        curve = [states[:1], piece]
        for _ in range(pieces):
            for _ in range(turns):
                piece = inverse.of_curve(piece)
            if len(piece) < 2:
                break
            curve.append(piece[1:])
            piece = spread(piece, spacing)
            piece = piece if len(piece) >= FIRST_POINTS else spread_evenly(piece, FIRST_POINTS)
        curves.append(np.concatenate(curve))
    return curves


class Preimages:
    """The inverse of a number of strides, by Newton's iteration."""

    def __init__(self, walker: Walker, strides: int, tolerance: float):
        self.walker, self.strides, self.tolerance = walker, strides, tolerance

    def jacobian_along(
        self, states: Float[np.ndarray, "period section"]
    ) -> Float[np.ndarray, "section section"]:
        """The Jacobian of the strides of a cycle."""
        return multiply_jacobians(linearise(self.walker, states[None], self.tolerance).jacobian)[0]

    def image(
        self, x: Float[np.ndarray, " section"]
    ) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "section section"]]:
        """The end of the strides from x, and its derivatives by x; NaN where one fails."""
        jacobian = np.eye(len(x))
        for _ in range(self.strides):
            if not np.isfinite(x).all():
                return x, jacobian
            local = linearise(self.walker, x[None, None], self.tolerance)
            x, jacobian = local.state[0, 0], local.jacobian[0, 0] @ jacobian
        return x, jacobian

    def of_curve(self, targets: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "m section"]:
        """Preimages of the points of a curve, one beside the other, as far as they are found.

        The last point of the curve is the preimage of its first, from which the next ones begin.
        """
        found = [targets[-1]]
        end, jacobian = self.image(found[0])
        for target in targets[1:]:
            x = found[-1]
            for _ in range(STEPS):
                step = np.linalg.solve(jacobian, target - end) if np.isfinite(end).all() else np.nan
                x = x + step
                if not np.isfinite(x).all():
                    break
                end, jacobian = self.image(x)
                if np.abs(end - target).max() < EXACT:
                    break
            if not np.abs(end - target).max() < EXACT:
                break
            found.append(x)
        return np.array(found)


def spread(
    points: Float[np.ndarray, "n section"], spacing: float
) -> Float[np.ndarray, "m section"]:
    """The same polygon with further points on its sides, at most a spacing apart."""
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    parts = np.maximum(1, np.ceil(gaps / spacing)).astype(int)
    sides = [
        first + (second - first) * (np.arange(count)[:, None] / count)
        for first, second, count in zip(points[:-1], points[1:], parts, strict=True)
    ]
    return np.concatenate([*sides, points[-1:]])


def spread_evenly(
    points: Float[np.ndarray, "n section"], count: int
) -> Float[np.ndarray, "count section"]:
    """So many points of a polygon, evenly spaced by its length."""
    lengths = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0, lengths[-1], count)
    return np.stack([np.interp(at, lengths, column) for column in points.T], axis=1)
