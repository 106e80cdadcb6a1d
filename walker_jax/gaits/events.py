"""Location of folds and period doublings on a branch."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.arclength import CORRECTOR_STEPS, Point, scaled_step
from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    cycle_matrices,
    find_multipliers,
    multiply_jacobians,
    solve_linear_systems,
)
from walker_jax.gaits.requests import Request, Response


class Bifurcation(NamedTuple):
    """A point of a branch at which a Floquet multiplier is 1 (fold) or -1 (period doubling)."""

    kind: str
    """"fold" or "doubling"."""
    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    multipliers: Complex[np.ndarray, " section"]
    vectors: Float[np.ndarray, "period section"]
    """v_1, ..., v_k with J_i v_i = v_{i+1}, and J_k v_k = v_1 (fold) or -v_1 (doubling)."""
    residual: float
    """Largest error in these equations and in those of the cycle."""


def crosses_half_period(one: Point, other: Point) -> bool:
    """Whether a branch reaches, between two points, a gait of half the period.

    Beyond that gait the branch retraces itself half a period later: the difference between states
    half a period apart changes its sign. It vanishes where the corrector converges to that gait.
    """
    period = len(one.cycle)
    if period % 2:
        return False
    before, after = (
        point.cycle - np.roll(point.cycle, period // 2, axis=0) for point in (one, other)
    )
    return bool(np.sum(before * after) < 0.01 * np.sum(before**2))


def find_bifurcations(
    one: Point,
    other: Point,
    before: Float[np.ndarray, " size"],
    after: Float[np.ndarray, " size"],
    width: float,
) -> Generator[Request, Response, list[Bifurcation] | None]:
    """The bifurcations on a step along a branch; None where the step is too long to locate them."""
    kinds = []
    if before[-1] * after[-1] < 0 and not crosses_half_period(one, other):
        kinds.append("fold")
    if doubling_test_function(one) * doubling_test_function(other) < 0:
        kinds.append("doubling")
    found = []
    for kind in kinds:
        nearer = min(one, other, key=lambda point: multiplier_distance(kind, point))
        bifurcation = yield from locate_bifurcation(kind, nearer, width)
        if bifurcation is None:
            return None
        located = Point(bifurcation.value, bifurcation.states, nearer.local)
        step = np.linalg.norm(scaled_step(one, other, width))
        distances = [np.linalg.norm(scaled_step(end, located, width)) for end in (one, other)]
        if max(distances) > 1.1 * step:
            return None
        found.append(bifurcation)
    return found


def doubling_test_function(point: Point) -> float:
    """The test function of a period doubling, det(M + I): its sign changes where a multiplier
    passes -1."""
    jacobian = multiply_jacobians(point.local.jacobian)[0]
    return float(np.linalg.det(jacobian + np.eye(len(jacobian))))


def multiplier_distance(kind: str, point: Point) -> float:
    """Distance of the nearest multiplier from 1 (fold) or -1 (doubling)."""
    multiplier = 1 if kind == "fold" else -1
    multipliers = find_multipliers(multiply_jacobians(point.local.jacobian))[0]
    return float(np.abs(multipliers - multiplier).min())


def locate_bifurcation(
    kind: str, point: Point, width: float
) -> Generator[Request, Response, Bifurcation | None]:
    """Newton's iteration to a bifurcation near a point of the branch.

    It solves S(x_i) = x_{i+1}; J_i v_i = v_{i+1}, with J_k v_k = v_1 (fold) or -v_1 (doubling); and
    v . (its first guess) = 1. Returns None where the iteration fails.
    """
    multiplier = 1.0 if kind == "fold" else -1.0
    period, size = point.cycle.shape
    count = period * size
    values, eigenvectors = np.linalg.eig(multiply_jacobians(point.local.jacobian)[0])
    vector = np.real(eigenvectors[:, np.abs(values - multiplier).argmin()])
    vectors = [vector]
    for jacobian in point.local.jacobian[0][:-1]:
        vectors.append(jacobian @ vectors[-1])
    v = np.array(vectors) / np.linalg.norm(vectors)
    guess, value, cycle = v.copy(), point.value, point.cycle
    best = None
    for _ in range(CORRECTOR_STEPS):
        local, second = yield Request(value, cycle, v)
        assert second is not None
        onward = np.roll(v, -1, axis=0)
        onward[-1] *= multiplier
        mismatch = np.concatenate(
            [
                (local.state[0] - np.roll(cycle, -1, axis=0)).ravel(),
                (second.along[0] - onward).ravel(),
                [np.sum(v * guess) - 1],
            ]
        )
        residual = float(np.abs(mismatch).max())
        if not np.isfinite(residual):
            return None
        converged = best is not None and residual >= best.residual
        if residual < (best.residual if best else MAX_RESIDUAL[cycle.dtype]):
            multipliers = find_multipliers(multiply_jacobians(local.jacobian))[0]
            best = Bifurcation(kind, float(value), cycle, multipliers, v, residual)
        if converged:
            break
        matrix = np.zeros((2 * count + 1, 2 * count + 1))
        matrix[:count, :count] = cycle_matrices(local.jacobian)[0]
        matrix[:count, -1] = local.by_parameter.ravel() * width
        for i in range(period):
            rows = slice(count + i * size, count + (i + 1) * size)
            matrix[rows, i * size : (i + 1) * size] = second.changes[0, i, :, :size]
        matrix[count:-1, count:-1] = cycle_matrices(local.jacobian, multiplier)[0]
        matrix[count:-1, -1] = second.changes[0, :, :, size].ravel() * width
        matrix[-1, count:-1] = guess.ravel()
        step = solve_linear_systems(matrix[None], -mismatch[None])[0]
        cycle = cycle + step[:count].reshape(period, size)
        v = v + step[count:-1].reshape(period, size)
        value = value + float(step[-1]) * width
    return best
