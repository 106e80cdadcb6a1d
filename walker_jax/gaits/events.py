"""Location of folds, period doublings and Neimark-Sacker points on a branch."""

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
from walker_jax.gaits.derivatives import SecondDerivatives
from walker_jax.gaits.requests import Request, Response


class Bifurcation(NamedTuple):
    """A point of a branch at which a Floquet multiplier is 1 (fold) or -1 (period doubling).

    Or at which a pair of them, exp(+-i angle), is on the unit circle (Neimark-Sacker): there
    motions without a period, on closed curves of the section, branch off.
    """

    kind: str
    """"fold", "doubling" or "neimark-sacker"."""
    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    multipliers: Complex[np.ndarray, " section"]
    vectors: Float[np.ndarray, "period section"] | Complex[np.ndarray, "period section"]
    """v_1, ..., v_k with J_i v_i = v_{i+1}, and J_k v_k = v_1 (fold), -v_1 (doubling) or
    exp(i angle) v_1, with an angle from 0 to pi (Neimark-Sacker)."""
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
    if pair_test_function(one) * pair_test_function(other) < 0 and has_close_pair(one, other):
        kinds.append("neimark-sacker")
    found = []
    for kind in kinds:
        nearer = min(one, other, key=lambda point: multiplier_distance(kind, point))
        locate = locate_neimark_sacker if kind == "neimark-sacker" else locate_bifurcation
        bifurcation = yield from locate(kind, nearer, width)
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


def pair_test_function(point: Point) -> float:
    """The product of l_i l_j - 1 over all pairs of multipliers.

    Its sign changes where a pair of conjugate ones passes the unit circle; and where the product of
    two real ones passes 1, which is no bifurcation.
    """
    return float(np.real(np.prod(pair_products(multipliers_at(point)) - 1)))


def pair_products(multipliers: Complex[np.ndarray, " n"]) -> Complex[np.ndarray, " pairs"]:
    """l_i l_j of all pairs."""
    return np.multiply(*pairs_of(multipliers).T)


def pairs_of(multipliers: Complex[np.ndarray, " n"]) -> Complex[np.ndarray, "pairs 2"]:
    return multipliers[np.stack(np.triu_indices(len(multipliers), 1), axis=1)]


def has_close_pair(one: Point, other: Point) -> bool:
    """Whether the pair that passes 1 is one of conjugates, at the end where its product is nearer
    to 1."""
    ends = []
    for point in (one, other):
        multipliers = multipliers_at(point)
        distances = np.abs(pair_products(multipliers) - 1)
        one_of, other_of = pairs_of(multipliers)[distances.argmin()]
        ends.append((distances.min(), one_of.imag != 0 and one_of == np.conj(other_of)))
    return bool(min(ends)[1])


def multipliers_at(point: Point) -> Complex[np.ndarray, " section"]:
    return find_multipliers(multiply_jacobians(point.local.jacobian))[0]


def multiplier_distance(kind: str, point: Point) -> float:
    """Distance of the nearest multiplier from 1 (fold) or -1 (doubling), or from the circle."""
    multipliers = multipliers_at(point)
    if kind == "neimark-sacker":
        return float(np.abs(np.abs(multipliers[np.imag(multipliers) != 0]) - 1).min(initial=np.inf))
    multiplier = 1 if kind == "fold" else -1
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
        before, best = best, better(best, kind, Point(value, cycle, local), v, residual)
        if before is not None and best is before:
            break
        matrix = np.zeros((2 * count + 1, 2 * count + 1))
        matrix[:count, :count] = cycle_matrices(local.jacobian)[0]
        matrix[:count, -1] = local.by_parameter.ravel() * width
        fill_changes(matrix[count:-1], second, width, -1)
        matrix[count:-1, count:-1] = cycle_matrices(local.jacobian, multiplier)[0]
        matrix[-1, count:-1] = guess.ravel()
        step = solve_linear_systems(matrix[None], -mismatch[None])[0]
        cycle = cycle + step[:count].reshape(period, size)
        v = v + step[count:-1].reshape(period, size)
        value = value + float(step[-1]) * width
    return best


def fill_changes(
    rows: np.ndarray, second: SecondDerivatives, width: float, parameter: int = -2
) -> None:
    """Write how J_i v_i changes with the states, and with the parameter, into rows of a matrix."""
    _, period, size, _ = second.changes.shape
    for i in range(period):
        part = slice(i * size, (i + 1) * size)
        rows[part, part] = second.changes[0, i, :, :size]
    rows[:, parameter] = second.changes[0, :, :, size].ravel() * width


def better(
    best: Bifurcation | None, kind: str, point: Point, vectors: np.ndarray, residual: float
) -> Bifurcation | None:
    """The present iterate, if its residual is below that of the best one so far, or that one."""
    if residual < (best.residual if best else MAX_RESIDUAL[point.cycle.dtype]):
        return Bifurcation(
            kind, float(point.value), point.cycle, multipliers_at(point), vectors, residual
        )
    return best


def locate_neimark_sacker(
    kind: str, point: Point, width: float
) -> Generator[Request, Response, Bifurcation | None]:
    """Newton's iteration to a Neimark-Sacker point near a point of the branch.

    Unknowns are the states, the parameter, the angle and the complex v_i = a_i + i b_i. It solves
    S(x_i) = x_{i+1}; J_i v_i = v_{i+1}, with J_k v_k = exp(i angle) v_1; and the product of v with
    the conjugate of its first guess is 1. Returns None where the iteration fails.
    """
    period, size = point.cycle.shape
    count = period * size
    values, eigenvectors = np.linalg.eig(multiply_jacobians(point.local.jacobian)[0])
    above = np.flatnonzero(np.imag(values) > 0)
    if len(above) == 0:
        return None
    number = above[np.abs(np.abs(values[above]) - 1).argmin()]
    angle, vectors = float(np.angle(values[number])), [eigenvectors[:, number]]
    for jacobian in point.local.jacobian[0][:-1]:
        vectors.append(jacobian @ vectors[-1])
    v = np.array(vectors) / np.linalg.norm(vectors)
    guess, value, cycle = v.copy(), point.value, point.cycle
    first, last = slice(0, size), slice(count - size, count)
    best = None
    for _ in range(CORRECTOR_STEPS):
        local, real = yield Request(value, cycle, np.ascontiguousarray(v.real))
        _, imaginary = yield Request(value, cycle, np.ascontiguousarray(v.imag))
        assert real is not None and imaginary is not None
        onward = np.roll(v, -1, axis=0)
        onward[-1] *= np.exp(1j * angle)
        along = real.along[0] + 1j * imaginary.along[0] - onward
        length = np.vdot(guess, v) - 1
        mismatch = np.concatenate(
            [
                (local.state[0] - np.roll(cycle, -1, axis=0)).ravel(),
                along.real.ravel(),
                along.imag.ravel(),
                [length.real, length.imag],
            ]
        )
        residual = float(np.abs(mismatch).max())
        if not np.isfinite(residual):
            return None
        before, best = best, better(best, kind, Point(value, cycle, local), v, residual)
        if before is not None and best is before:
            break
        c, s = np.cos(angle), np.sin(angle)
        matrix = np.zeros((3 * count + 2, 3 * count + 2))
        of_states, of_real, of_imaginary = (slice(i * count, (i + 1) * count) for i in range(3))
        matrix[of_states, of_states] = cycle_matrices(local.jacobian)[0]
        matrix[of_states, -2] = local.by_parameter.ravel() * width
        for part, second in ((of_real, real), (of_imaginary, imaginary)):
            fill_changes(matrix[part], second, width)
            matrix[part, part] = cycle_matrices(local.jacobian, c)[0]
        matrix[of_real, of_imaginary][last, first] += s * np.eye(size)
        matrix[of_imaginary, of_real][last, first] -= s * np.eye(size)
        turned = 1j * np.exp(1j * angle) * v[0]
        matrix[of_real, -1][last], matrix[of_imaginary, -1][last] = -turned.real, -turned.imag
        matrix[-2, of_real], matrix[-2, of_imaginary] = guess.real.ravel(), guess.imag.ravel()
        matrix[-1, of_real], matrix[-1, of_imaginary] = -guess.imag.ravel(), guess.real.ravel()
        step = solve_linear_systems(matrix[None], -mismatch[None])[0]
        cycle = cycle + step[of_states].reshape(period, size)
        v = v + (step[of_real] + 1j * step[of_imaginary]).reshape(period, size)
        value, angle = value + float(step[-2]) * width, angle + float(step[-1])
    return best
