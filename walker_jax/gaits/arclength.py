"""Steps along a branch: the tangent, and the correction on a plane across it."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.cycles import RESIDUAL, cyclic, solve
from walker_jax.gaits.derivatives import Linearised
from walker_jax.gaits.requests import Answer, Ask

STEPS = 12
"""Newton steps at most, for a point and for a bifurcation."""


class Point(NamedTuple):
    """A gait on a branch."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    local: Linearised


def corrected(
    value: float,
    cycle: Float[np.ndarray, "period section"],
    row: Float[np.ndarray, " size"] | None,
    width: float,
) -> Generator[Ask, Answer, Point | None]:
    """Newton's iteration to the branch, across `row`; with the parameter standing still if none."""
    row = np.append(np.zeros(cycle.size), 1.0) if row is None else row
    period, size = cycle.shape
    rounding = 10 * float(np.finfo(cycle.dtype).eps)
    best, least = None, float(RESIDUAL[cycle.dtype])
    for _ in range(STEPS):
        local = (yield Ask(value, cycle)).local
        miss = local.state[0] - np.roll(cycle, -1, axis=0)
        residual = np.abs(miss).max()
        if not np.isfinite(residual):
            return None
        settled = best is not None and residual >= least
        if residual < least:
            best, least = Point(float(value), cycle, local), residual
        if settled or residual <= rounding:
            break
        matrix = np.concatenate([derivatives(local, width), row[None]])
        step = solve(matrix[None], np.append(-miss.ravel(), 0.0)[None])[0]
        cycle = cycle + step[:-1].reshape(period, size) * np.sqrt(period)
        value = value + step[-1] * width
    return best


def derivatives(local: Linearised, width: float) -> Float[np.ndarray, "rows columns"]:
    """Of x -> S(x_i) - x_{i+1}, by the scaled states and parameter."""
    period = local.state.shape[1]
    by_states = cyclic(local.jacobian)[0] * np.sqrt(period)
    return np.append(by_states, local.by_parameter.reshape(-1, 1) * width, axis=1)


def tangent(point: Point, width: float) -> Float[np.ndarray, " size"]:
    """Unit vector along the branch, in scaled states and parameter; of either sign."""
    return np.linalg.svd(derivatives(point.local, width))[2][-1]


def moved(
    point: Point, step: Float[np.ndarray, " size"], width: float
) -> tuple[float, Float[np.ndarray, "period section"]]:
    """Value of the parameter and states at a scaled step from a point."""
    change = step[:-1].reshape(point.cycle.shape) * np.sqrt(len(point.cycle))
    return point.value + float(step[-1]) * width, point.cycle + change


def between(one: Point, other: Point, width: float) -> Float[np.ndarray, " size"]:
    """The scaled step from one point to another."""
    change = (other.cycle - one.cycle).ravel() / np.sqrt(len(one.cycle))
    return np.append(change, (other.value - one.value) / width)
