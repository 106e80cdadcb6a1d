"""The stable manifold of a saddle: the starts that converge to an unstable gait.

The manifold begins along the stable direction of the saddle. It is a curve c that the stride
function maps into itself: S(x) = c(t) for every point x of the curve, with c(t) nearer to the
saddle along the curve. So the known part of the curve determines its next point. This is a
pseudo-arclength continuation of x and t together (the idea of England, Krauskopf and Osinga 2004,
SIAM Journal on Applied Dynamical Systems 3, 161). It also passes places where the stride function
folds the section and t turns back, as it does for walkers.
"""

from bisect import bisect_right
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.basins.attractor import capture_radius
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    check_precision,
    check_whole,
    refuses_tracers,
)
from walker_jax.gaits.cycles import Gait, check_cycle, linearise, multiply_jacobians
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.systems.angles import Turns, difference, turns_of
from walker_jax.systems.system import System
from walker_jax.walking.iteration import orbits

FIRST = 1e-5
"""Distance from the saddle up to which the manifold counts as straight: it bends by 1e-10."""
CORRECTIONS = 8
"""Newton steps to a point of the curve from one beside it; a shorter step is tried after them."""
EXACT = 1e-10
"""Largest residual of a point, along the curve that it is mapped to and across."""
SHORTEST = 1e-7
"""Length of the shortest step: if it fails too, the curve ends."""
GROWTH = 1.5
"""Growth of the step after one that succeeds."""
SHARPEST = 0.9
"""Least cosine of the angle between two steps."""

Point = Float[np.ndarray, " 2"]
Matrix = Float[np.ndarray, "2 2"]
ImageOf = Callable[[Point], tuple[Point, Matrix]]
"""A map with its derivatives, such as `Image`."""


@refuses_tracers()
def stable_manifold(
    walker: System,
    gait: Gait,
    *,
    spacing: float = 2e-3,
    points: int = 1000,
    tolerance: float | None = None,
) -> list[Float[np.ndarray, "n section"]]:
    """Compute the stable manifold of an unstable gait on a section of two coordinates: two curves.

    Each curve starts at the gait's first state. It ends where the stride function does, or where it
    leads to the other curve. Between its points a curve is approximated by a cubic.

    ```python
    walker = wj.SimplestWalker(0.004)
    saddle = next(gait for gait in wj.find_gaits(walker) if not gait.stable)
    one, other = wj.stable_manifold(walker, saddle)  # arrays of shape (n, 2)
    ```

    **Arguments:**

    - `walker`: the walker of the gait.
    - `gait`: a saddle, with one multiplier outside the unit circle and one inside.
    - `spacing`: largest distance of neighbouring points, in the coordinates of the section.
    - `points`: most points of a curve.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for another gait or section, a gait of another walker, and in float32.
    """
    check_kind("walker", walker, System)
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
            f"{np.asarray(gait.multipliers).tolist()}: find_gaits gives all"
        )
    integrator = integrator_of(states.dtype, tolerance)
    local = linearise(walker, states[None], integrator)
    check_cycle(walker, states, local.state[0], capture_radius(states.dtype))
    jacobian = multiply_jacobians(local.jacobian)[0]
    values, vectors = np.linalg.eig(jacobian)
    at = int(np.abs(values).argmin())
    direction = np.real(vectors[:, at])
    # Two periods, if one exchanges the two halves of the manifold.
    strides = len(states) * (1 if np.real(values[at]) > 0 else 2)
    image = Image(walker, strides, integrator)
    return [
        follow_manifold(image, states[0], side * direction, spacing, points, turns_of(walker))
        for side in (1, -1)
    ]


class Image(NamedTuple):
    """A number of strides, as a map with derivatives."""

    walker: System
    strides: int
    integrator: Integrator

    def __call__(
        self, x: Float[np.ndarray, " section"]
    ) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "section section"]]:
        """Return the end of the strides from x, and its derivatives by x; NaN after a failure."""
        states, _ = orbits(self.walker, x[None], self.strides - 1, self.integrator)
        local = linearise(self.walker, states, self.integrator)
        return local.state[0, -1], multiply_jacobians(local.jacobian)[0]


class Curve:
    """A curve that grows point by point: cubics with given tangents join its points."""

    def __init__(self, first: Point, tangent: Point):
        self.points, self.tangents, self.lengths = [first], [tangent], [0.0]

    def add(self, point: Point, tangent: Point) -> None:
        """Add a point at the end."""
        gap = float(np.linalg.norm(point - self.points[-1]))
        self.points.append(point)
        self.tangents.append(tangent)
        self.lengths.append(self.lengths[-1] + gap)

    def at(self, t: float) -> tuple[Point, Point]:
        """Return the point at a length t, and its derivative by t (Hermite's interpolation)."""
        from scipy.interpolate import CubicHermiteSpline

        i = min(max(bisect_right(self.lengths, t) - 1, 0), len(self.points) - 2)
        ends = slice(i, i + 2)
        cubic = CubicHermiteSpline(self.lengths[ends], self.points[ends], self.tangents[ends])
        return cubic(t), cubic(t, 1)


def follow_manifold(
    image: ImageOf,
    saddle: Point,
    direction: Point,
    spacing: float,
    points: int,
    turns: Turns = None,
) -> Float[np.ndarray, "n 2"]:
    """Follow one half of the stable manifold of a fixed point of a map, from the saddle on."""
    curve = Curve(saddle, direction)
    x, along, step = saddle + FIRST * direction, direction, FIRST
    curve.add(x, along)
    end, jacobian = image(x)
    t = float(np.dot(difference(end, saddle, turns), direction))
    while len(curve.points) < points and step > SHORTEST:
        tangent, rate = tangent_of(jacobian, curve.at(t)[1], along)
        found = find_preimage(image, curve, x + step * tangent, t + step * rate, tangent, turns)
        if found is not None:
            new_x, new_t, new_jacobian = found
            gap = float(np.linalg.norm(new_x - x))
            new_tangent, _ = tangent_of(new_jacobian, curve.at(new_t)[1], tangent)
            if gap <= 2 * step and new_tangent @ tangent > SHARPEST:
                along, x, t, jacobian = new_tangent, new_x, new_t, new_jacobian
                curve.add(x, along)
                step = min(GROWTH * step, spacing)
                continue
        step /= 2
    return np.array(curve.points)


def tangent_of(jacobian: Matrix, slope: Point, along: Point) -> tuple[Point, float]:
    """Return a direction dx of length one, not against `along`, and dt with J dx = slope dt."""
    null = np.cross(*np.column_stack([jacobian, -slope]))
    null = null / np.linalg.norm(null[:2])
    null = null if null[:2] @ along >= 0 else -null
    return null[:2], float(null[2])


def find_preimage(
    image: ImageOf, curve: Curve, x: Point, t: float, tangent: Point, turns: Turns = None
) -> tuple[Point, float, Matrix] | None:
    """Find the point across the tangent at x that is mapped to the curve, and where; or None."""
    start = x
    for _ in range(CORRECTIONS):
        if not 0 <= t <= curve.lengths[-1]:
            return None
        end, jacobian = image(x)
        if not np.isfinite(jacobian).all():
            return None
        at, slope = curve.at(t)
        miss = difference(end, at, turns)
        if np.abs(miss).max() < EXACT:
            return x, t, jacobian
        matrix = np.zeros((3, 3))
        matrix[:2, :2], matrix[:2, 2], matrix[2, :2] = jacobian, -slope, tangent
        change = np.linalg.solve(matrix, -np.append(miss, tangent @ (x - start)))
        x, t = x + change[:2], t + float(change[2])
    return None
