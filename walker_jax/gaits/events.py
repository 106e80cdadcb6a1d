"""Folds and period doublings on a branch: where they are."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.arclength import STEPS, Point, between
from walker_jax.gaits.cycles import RESIDUAL, cyclic, multipliers_of, product, solve
from walker_jax.gaits.requests import Answer, Ask


class Bifurcation(NamedTuple):
    """A point of a branch at which a multiplier is 1 (a fold) or -1 (a period doubling)."""

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
    """Whether a branch comes back, between two points, to a gait of half the period.

    Beyond that it goes on as itself, half a period later, the difference between states half a
    period apart turned round; or an iteration has left it for that gait, and there is none left.
    """
    period = len(one.cycle)
    if period % 2:
        return False
    before, after = (
        point.cycle - np.roll(point.cycle, period // 2, axis=0) for point in (one, other)
    )
    return bool(np.sum(before * after) < 0.01 * np.sum(before**2))


def bifurcations_between(
    one: Point,
    other: Point,
    before: Float[np.ndarray, " size"],
    after: Float[np.ndarray, " size"],
    width: float,
) -> Generator[Ask, Answer, list[Bifurcation] | None]:
    """The bifurcations on a step along a branch; None where the step is too long to tell."""
    kinds = []
    if before[-1] * after[-1] < 0 and not crosses_half_period(one, other):
        kinds.append("fold")
    if doubling_test(one) * doubling_test(other) < 0:
        kinds.append("doubling")
    found = []
    for kind in kinds:
        nearer = min(one, other, key=lambda point: distance_to(kind, point))
        bifurcation = yield from locate(kind, nearer, width)
        if bifurcation is None:
            return None
        place = Point(bifurcation.value, bifurcation.states, nearer.local)
        step = np.linalg.norm(between(one, other, width))
        if max(np.linalg.norm(between(end, place, width)) for end in (one, other)) > 1.1 * step:
            return None
        found.append(bifurcation)
    return found


def doubling_test(point: Point) -> float:
    """det(M + I), which changes sign where a multiplier passes -1."""
    jacobian = product(point.local.jacobian)[0]
    return float(np.linalg.det(jacobian + np.eye(len(jacobian))))


def distance_to(kind: str, point: Point) -> float:
    """How far the nearest multiplier is from 1 or -1."""
    aim = 1 if kind == "fold" else -1
    return float(np.abs(multipliers_of(product(point.local.jacobian))[0] - aim).min())


def locate(kind: str, point: Point, width: float) -> Generator[Ask, Answer, Bifurcation | None]:
    """Newton's iteration to a bifurcation near a point of the branch.

    S(x_i) = x_{i+1}; J_i v_i = v_{i+1}, but -v_1 (doubling) or v_1 (fold) at the end of the cycle;
    and v has length 1 along its first guess.
    """
    aim = 1.0 if kind == "fold" else -1.0
    period, size = point.cycle.shape
    count = period * size
    values, eigenvectors = np.linalg.eig(product(point.local.jacobian)[0])
    vector = np.real(eigenvectors[:, np.abs(values - aim).argmin()])
    vectors = [vector]
    for jacobian in point.local.jacobian[0][:-1]:
        vectors.append(jacobian @ vectors[-1])
    v = np.array(vectors) / np.linalg.norm(vectors)
    guess, value, cycle = v.copy(), point.value, point.cycle
    best = None
    for _ in range(STEPS):
        local, curved = yield Ask(value, cycle, v)
        assert curved is not None
        onward = np.roll(v, -1, axis=0)
        onward[-1] *= aim
        miss = np.concatenate(
            [
                (local.state[0] - np.roll(cycle, -1, axis=0)).ravel(),
                (curved.along[0] - onward).ravel(),
                [np.sum(v * guess) - 1],
            ]
        )
        residual = float(np.abs(miss).max())
        if not np.isfinite(residual):
            return None
        settled = best is not None and residual >= best.residual
        if residual < (best.residual if best else RESIDUAL[cycle.dtype]):
            multipliers = multipliers_of(product(local.jacobian))[0]
            best = Bifurcation(kind, float(value), cycle, multipliers, v, residual)
        if settled:
            break
        matrix = np.zeros((2 * count + 1, 2 * count + 1))
        matrix[:count, :count] = cyclic(local.jacobian)[0]
        matrix[:count, -1] = local.by_parameter.ravel() * width
        for i in range(period):
            rows = slice(count + i * size, count + (i + 1) * size)
            matrix[rows, i * size : (i + 1) * size] = curved.changes[0, i, :, :size]
        matrix[count:-1, count:-1] = cyclic(local.jacobian, aim)[0]
        matrix[count:-1, -1] = curved.changes[0, :, :, size].ravel() * width
        matrix[-1, count:-1] = guess.ravel()
        step = solve(matrix[None], -miss[None])[0]
        cycle = cycle + step[:count].reshape(period, size)
        v = v + step[count:-1].reshape(period, size)
        value = value + float(step[-1]) * width
    return best
