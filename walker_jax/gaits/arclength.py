"""Pseudo-arclength steps along a branch: the tangent predicts, Newton's iteration corrects.

Points are measured in scaled coordinates: states over sqrt(period), the parameter over the width of
its range.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    Linearisation,
    cycle_matrices,
    solve_linear_systems,
)
from walker_jax.gaits.requests import Request, Task
from walker_jax.systems.angles import Turns, difference

CORRECTOR_STEPS = 12
"""Newton steps to a point or to a bifurcation. From a good prediction the corrector converges
quadratically, in a few steps; if it takes more, the step along the branch is halved."""


class Point(NamedTuple):
    """A gait on a branch."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    local: Linearisation


def correct_point(
    value: float,
    cycle: Float[np.ndarray, "period section"],
    row: Float[np.ndarray, " size"] | None,
    width: float,
) -> Task:
    """Correct a point by Newton's iteration to the branch, on the plane across `row`.

    Without a `row` the parameter keeps its value. Returns None if the iteration fails.
    """
    row = np.append(np.zeros(cycle.size), 1.0) if row is None else row
    period, size = cycle.shape
    rounding = 10 * float(np.finfo(cycle.dtype).eps)
    best, smallest = None, float(MAX_RESIDUAL[cycle.dtype])
    for _ in range(CORRECTOR_STEPS):
        local = yield Request(value, cycle)
        mismatch = local.state[0] - np.roll(cycle, -1, axis=0)
        residual = np.abs(mismatch).max()
        if not np.isfinite(residual):
            return None
        converged = best is not None and residual >= smallest
        if residual < smallest:
            best, smallest = Point(float(value), cycle, local), residual
        if converged or residual <= rounding:
            break
        matrix = np.concatenate([scaled_jacobian(local, width), row[None]])
        step = solve_linear_systems(matrix[None], np.append(-mismatch.ravel(), 0.0)[None])[0]
        cycle = cycle + step[:-1].reshape(period, size) * np.sqrt(period)
        value = value + step[-1] * width
    return best


def scaled_jacobian(local: Linearisation, width: float) -> Float[np.ndarray, "rows columns"]:
    """Return the derivatives of S(x_i) - x_{i+1} by the scaled states and parameter."""
    period = local.state.shape[1]
    by_states = cycle_matrices(local.jacobian)[0] * np.sqrt(period)
    return np.append(by_states, local.by_parameter.reshape(-1, 1) * width, axis=1)


def tangent(point: Point, width: float) -> Float[np.ndarray, " size"]:
    """Return the unit tangent of the branch, in scaled states and parameter; of either sign."""
    return np.linalg.svd(scaled_jacobian(point.local, width))[2][-1]


def displace(
    point: Point, step: Float[np.ndarray, " size"], width: float
) -> tuple[float, Float[np.ndarray, "period section"]]:
    """Predict the parameter and the states at a scaled step from a point."""
    change = step[:-1].reshape(point.cycle.shape) * np.sqrt(len(point.cycle))
    return point.value + float(step[-1]) * width, point.cycle + change


def scaled_step(
    one: Point, other: Point, width: float, turns: Turns = None
) -> Float[np.ndarray, " size"]:
    """Return the scaled step from one point to another."""
    change = difference(other.cycle, one.cycle, turns).ravel() / np.sqrt(len(one.cycle))
    return np.append(change, (other.value - one.value) / width)
