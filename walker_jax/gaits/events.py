"""Location of folds, period doublings, Neimark-Sacker and branch points on a branch."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.arclength import Point, scaled_jacobian, scaled_step
from walker_jax.gaits.cycles import find_multipliers, has_shorter_period, multiply_jacobians
from walker_jax.gaits.defining_systems import BRANCH, DOUBLING, FOLD, TORUS
from walker_jax.gaits.event_newton import UNFOLDED, begin
from walker_jax.gaits.normal_forms import criticality, find_coefficient
from walker_jax.gaits.requests import Request, Task


class Bifurcation(NamedTuple):
    """A point of a branch at which Floquet multipliers are on the unit circle.

    One multiplier is 1 at a fold, and -1 at a period doubling. At a Neimark-Sacker point a pair is
    exp(+-i angle): there motions without a period branch off, on closed curves of the section. At a
    branch point one multiplier is 1 and another branch crosses.
    """

    kind: str
    """"fold", "doubling", "neimark-sacker" or "branch point"."""
    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    multipliers: Complex[np.ndarray, " section"]
    vectors: Float[np.ndarray, "period section"] | Complex[np.ndarray, "period section"]
    """v_1, ..., v_k with J_i v_i = v_{i+1}, and J_k v_k = v_1 (fold, branch point),
    -v_1 (doubling) or exp(i angle) v_1, with an angle from 0 to pi (Neimark-Sacker)."""
    residual: float
    """Largest error in these equations and in those of the cycle."""
    coefficient: float = np.nan
    """Coefficient of the normal form (`normal_forms`); NaN where multipliers coincide, for branch
    points, and where normal forms were not requested."""

    @property
    def criticality(self) -> str:
        """ "supercritical" or "subcritical"; empty for folds and branch points."""
        return criticality(self.kind, self.coefficient)


SAME = 1e-10
"""Largest difference of states that are the same but for errors, relative to the largest state."""


def crosses_half_period(
    one: Float[np.ndarray, "period section"], other: Float[np.ndarray, "period section"]
) -> bool:
    """Return whether a branch reaches, between two of its cycles, a gait of half the period.

    Beyond that gait the branch retraces itself, shifted by half a period: the difference between
    states half a period apart changes its sign. The difference vanishes where the corrector
    converges to that gait. A branch that begins at that gait, but for rounding, has not reached it.
    """
    period = len(one)
    if period % 2:
        return False
    before, after = (cycle - np.roll(cycle, period // 2, axis=0) for cycle in (one, other))
    begins_there = np.abs(before).max() < SAME * np.abs(one).max()
    return not begins_there and bool(np.sum(before * after) < 0.01 * np.sum(before**2))


def find_bifurcations(
    one: Point,
    other: Point,
    before: Float[np.ndarray, " size"],
    after: Float[np.ndarray, " size"],
    width: float,
) -> Task:
    """Find the bifurcations on a step along a branch; None if the step is too long for that."""
    kinds = []
    if before[-1] * after[-1] < 0 and not crosses_half_period(one.cycle, other.cycle):
        kinds.append(FOLD)
    elif branch_sign(one, before, width) != branch_sign(other, after, width):
        kinds += [] if crosses_half_period(one.cycle, other.cycle) else [BRANCH]
    if doubling_test_function(one) * doubling_test_function(other) < 0:
        kinds.append(DOUBLING)
    if pair_test_function(one) * pair_test_function(other) < 0 and has_close_pair(one, other):
        kinds.append(TORUS)
    found = []
    for kind in kinds:
        nearer = min(one, other, key=lambda point: multiplier_distance(kind, point))
        bifurcation = yield from locate_bifurcation(kind, nearer, width)
        if bifurcation is None and kind == BRANCH:
            continue
        if bifurcation is None:
            return None
        located = Point(bifurcation.value, bifurcation.states, nearer.local)
        step = np.linalg.norm(scaled_step(one, other, width))
        distances = [np.linalg.norm(scaled_step(end, located, width)) for end in (one, other)]
        if max(distances) > 1.1 * step:
            return None
        found.append(bifurcation)
    return found


def branch_sign(point: Point, direction: Float[np.ndarray, " size"], width: float) -> float:
    """Return the sign of det [cycle equations; tangent], which changes where branches cross."""
    whole = np.concatenate([scaled_jacobian(point.local, width), direction[None]])
    return float(np.linalg.slogdet(whole)[0])


def doubling_test_function(point: Point) -> float:
    """Return det(M + I), the test function of a period doubling.

    Its sign changes where a multiplier passes -1.
    """
    jacobian = multiply_jacobians(point.local.jacobian)[0]
    return float(np.linalg.det(jacobian + np.eye(len(jacobian))))


def pair_test_function(point: Point) -> float:
    """Return the product of l_i l_j - 1 over all pairs of multipliers.

    Its sign changes where a pair of conjugate multipliers crosses the unit circle. It also changes
    where the product of two real multipliers passes 1, which is no bifurcation.
    """
    return float(np.real(np.prod(pair_products(multipliers_at(point)) - 1)))


def pair_products(multipliers: Complex[np.ndarray, " n"]) -> Complex[np.ndarray, " pairs"]:
    """Return l_i l_j of all pairs."""
    return np.multiply(*pairs_of(multipliers).T)


def pairs_of(multipliers: Complex[np.ndarray, " n"]) -> Complex[np.ndarray, "pairs 2"]:
    return multipliers[np.stack(np.triu_indices(len(multipliers), 1), axis=1)]


def has_close_pair(one: Point, other: Point) -> bool:
    """Return whether the pair whose product passes 1 is a pair of conjugates.

    The answer is that at the end of the step where the product is nearer to 1.
    """
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
    """Return the distance of the nearest multiplier from its place at the bifurcation.

    That place is 1 (fold, branch point), -1 (doubling), or the unit circle, for a pair.
    """
    multipliers = multipliers_at(point)
    if kind == TORUS:
        return float(np.abs(np.abs(multipliers[np.imag(multipliers) != 0]) - 1).min(initial=np.inf))
    multiplier = -1 if kind == DOUBLING else 1
    return float(np.abs(multipliers - multiplier).min())


def locate_bifurcation(kind: str, point: Point, width: float) -> Task:
    """Locate a bifurcation by Newton's iteration from a point of the branch; None if it fails."""
    value = np.array([point.value])
    found = yield from begin(kind, value, point.cycle, multipliers_at(point), [width])
    if found is None or (kind == BRANCH and abs(found.unknowns.scalars[2]) > UNFOLDED):
        return None
    values, cycle, *_ = found.unknowns
    if kind == BRANCH and has_shorter_period(cycle[None])[0]:
        return None  # the gait of half the period doubles there
    return Bifurcation(
        kind, float(values[0]), cycle, found.multipliers, found.vectors, found.residual
    )


def add_normal_form(event: Bifurcation) -> Task:
    """Return a bifurcation with the coefficient of its normal form."""
    local = yield Request(event.value, event.states)
    jacobian = multiply_jacobians(local.jacobian)[0]
    values = np.array([event.value])
    coefficient = yield from find_coefficient(event.kind, values, event.states, jacobian)
    return event._replace(coefficient=coefficient)
