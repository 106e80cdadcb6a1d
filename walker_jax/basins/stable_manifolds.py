"""The stable manifold of a saddle: the starts that converge to an unstable gait.

It begins along the stable direction of the saddle, and is a curve that the stride function maps
into itself: S(x) = c(t) for every point x of the curve c, with c(t) nearer to the saddle, along the
curve. So what is known of the curve determines its next point: this is the pseudo-arclength
continuation of x and t together (the idea of England, Krauskopf and Osinga 2004, SIAM Journal on
Applied Dynamical Systems 3, 161). It goes on where the stride function folds the section and t
turns back, as it does for walkers.
"""

from typing import NamedTuple

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
CORRECTIONS = 8
"""Newton steps to a point of the curve, from one beside it; a shorter step is tried after them."""
EXACT = 1e-10
"""Residual of a point, at most, along the curve that it is mapped to and across."""
SHORTEST = 1e-7
"""Length of a step, at least: where none so short succeeds the curve ends."""
GROWTH = 1.5
"""Of a step after one that succeeds."""
SHARPEST = 0.9
"""Cosine of the angle between two steps, at least."""


@refuses_tracers()
def stable_manifold(
    walker: Walker,
    gait: Gait,
    *,
    spacing: float = 2e-3,
    points: int = 1000,
    tolerance: float | None = None,
) -> list[Float[np.ndarray, "n section"]]:
    """The stable manifold of an unstable gait on a section of two coordinates: two curves.

    Each goes out from the gait's first state, and ends where the stride function does. Between its
    points a curve is a straight line, which errs by the square of the spacing, times
    the curvature over eight.

    **Arguments:**

    - `walker`: that of the gait.
    - `gait`: a saddle, with one multiplier outside the unit circle and one inside.
    - `spacing`: of the points of a curve, at most, in the coordinates of the section.
    - `points`: of a curve, at most.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for another gait or section, and in float32.
    """
    check_kind("walker", walker, Walker)
    check_kind("gait", gait, Gait)
    check_whole("points", points, 2)
    check_number("spacing", spacing)
    if not FIRST <= spacing < np.inf:
        raise WrongUse(f"spacing must be at least {FIRST:g} and finite, not {spacing}")
    states = np.asarray(gait.states)
    check_precision(states.dtype, "stable_manifold, which inverts strides to 1e-10,")
    sizes = np.abs(np.asarray(gait.multipliers))
    if not gait.found or len(sizes) != 2 or not sizes[0] > 1 > sizes[1]:
        raise WrongUse(
            "gait must be a saddle on a section of two coordinates, not one with multipliers "
            f"{np.asarray(gait.multipliers).tolist()}"
        )
    checked_tolerance = float(default_tolerance(states.dtype, tolerance))
    jacobian = multiply_jacobians(linearise(walker, states[None], checked_tolerance).jacobian)[0]
    values, vectors = np.linalg.eig(jacobian)
    at = int(np.abs(values).argmin())
    direction = np.real(vectors[:, at])
    # twice round where the two halves of the manifold change places
    strides = len(states) * (1 if np.real(values[at]) > 0 else 2)
    image = Image(walker, strides, checked_tolerance)
    return [
        follow_manifold(image, states[0], side * direction, spacing, points) for side in (1, -1)
    ]


class Image(NamedTuple):
    """A number of strides, as a map with derivatives."""

    walker: Walker
    strides: int
    tolerance: float

    def __call__(
        self, x: Float[np.ndarray, " section"]
    ) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "section section"]]:
        """The end of the strides from x, and its derivatives by x; NaN where one fails."""
        jacobian = np.eye(len(x))
        for _ in range(self.strides):
            if not np.isfinite(x).all():
                break
            local = linearise(self.walker, x[None, None], self.tolerance)
            x, jacobian = local.state[0, 0], local.jacobian[0, 0] @ jacobian
        return x, jacobian


def follow_manifold(
    image: Image,
    saddle: Float[np.ndarray, " 2"],
    direction: Float[np.ndarray, " 2"],
    spacing: float,
    points: int,
) -> Float[np.ndarray, "n 2"]:
    """One half of the stable manifold of a fixed point of a map, from the saddle on."""
    curve = np.zeros((points, 2))
    curve[:2] = saddle, saddle + FIRST * direction
    lengths = np.zeros(points)
    lengths[1] = FIRST
    count, step = 2, FIRST
    along = direction
    x = curve[1]
    end, jacobian = image(x)
    t = float(np.dot(end - saddle, direction))
    while count < points and step > SHORTEST:
        tangent, rate = tangent_of(jacobian, slope_at(curve, lengths, count, t))
        if tangent @ along < 0:
            tangent, rate = -tangent, -rate
        found = correct(image, curve, lengths, count, x + step * tangent, t + step * rate, tangent)
        if found is not None:
            new_x, new_t, new_jacobian = found
            gap = float(np.linalg.norm(new_x - x))
            turned = (new_x - x) @ tangent < SHARPEST * gap or tangent @ along < SHARPEST
            if gap <= 2 * step and (not turned or step < 4 * SHORTEST):
                along, x, t, jacobian = tangent, new_x, new_t, new_jacobian
                curve[count], lengths[count] = x, lengths[count - 1] + gap
                count, step = count + 1, min(GROWTH * step, spacing)
                continue
        step /= 2
    return curve[:count]


def tangent_of(
    jacobian: Float[np.ndarray, "2 2"], slope: Float[np.ndarray, " 2"]
) -> tuple[Float[np.ndarray, " 2"], float]:
    """The direction dx, of length one, and dt, for which J dx = slope dt."""
    first, second = np.column_stack([jacobian, -slope])
    null = np.cross(first, second)
    null /= np.linalg.norm(null[:2])
    return null[:2], float(null[2])


def slope_at(
    curve: Float[np.ndarray, "n 2"], lengths: Float[np.ndarray, " n"], count: int, t: float
) -> Float[np.ndarray, " 2"]:
    """The direction of the side of a polygon at a length."""
    i = int(np.clip(np.searchsorted(lengths[:count], t, "right") - 1, 0, count - 2))
    return (curve[i + 1] - curve[i]) / (lengths[i + 1] - lengths[i])


def correct(
    image: Image,
    curve: Float[np.ndarray, "n 2"],
    lengths: Float[np.ndarray, " n"],
    count: int,
    x: Float[np.ndarray, " 2"],
    t: float,
    tangent: Float[np.ndarray, " 2"],
) -> tuple[Float[np.ndarray, " 2"], float, Float[np.ndarray, "2 2"]] | None:
    """The point across the tangent at x that is mapped to the curve, at a length; None for none."""
    start = x
    for _ in range(CORRECTIONS):
        if not 0 <= t <= lengths[count - 1]:
            return None
        end, jacobian = image(x)
        if not np.isfinite(jacobian).all():
            return None
        slope = slope_at(curve, lengths, count, t)
        at = np.array([np.interp(t, lengths[:count], one) for one in curve[:count].T])
        miss = end - at
        if np.abs(miss).max() < EXACT:
            return x, t, jacobian
        matrix = np.zeros((3, 3))
        matrix[:2, :2], matrix[:2, 2], matrix[2, :2] = jacobian, -slope, tangent
        change = np.linalg.solve(matrix, -np.append(miss, tangent @ (x - start)))
        x, t = x + change[:2], t + float(change[2])
    return None
