"""Continuation of a bifurcation in two parameters: pseudo-arclength on its defining system.

Distances are measured in scaled states and parameters (`event_newton`). They leave out the vectors
and scalars, which depend on these.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.codimension_two import CodimensionTwo, criteria, is_confirmed
from walker_jax.gaits.continuation import (
    FIRST_STEP,
    LONGEST_STEP,
    MAX_POINTS,
    MIN_COSINE,
    SHORTEST_STEP,
    passes_start,
)
from walker_jax.gaits.defining_systems import BRANCH, TORUS, Frame, Unknowns, move
from walker_jax.gaits.event_newton import UNFOLDED, Solution, begin, correct_event, scales_of
from walker_jax.gaits.events import crosses_half_period
from walker_jax.gaits.normal_forms import VANISHING, find_coefficient
from walker_jax.gaits.requests import Task

CURVE_CLOSES = "the curve closes"
"""Reason for the end of a path that comes back to its start."""
LOCATING_STEPS = 60
"""Most trials to locate a point on a step; bisection alone would need about as many."""
LOCATED = 1e-13
"""Change of the trial, in scaled length, below which the point is located."""
REAL_PAIRS = "1:1 resonance", "1:2 resonance"
"""Points beyond which the pair is real, with a product of 1, so that there is no bifurcation."""


class EventPoint(NamedTuple):
    """A bifurcation on its curve."""

    unknowns: Unknowns
    frame: Frame
    tangent: Float[np.ndarray, " columns"]
    """Tangent of the curve in scaled states and parameters, of unit length and either sign."""
    residual: float
    multipliers: Complex[np.ndarray, " section"]
    coefficient: float
    """Coefficient of the normal form; NaN for branch points, and where multipliers coincide."""
    criteria: dict[str, float]
    """Functions that change sign at points of codimension two, by the names of the points."""


class EventPath(NamedTuple):
    """One side of a curve, from its start."""

    points: list[EventPoint]
    special: list[CodimensionTwo]
    end: str


class Ranges(NamedTuple):
    """Lowest and highest values of both parameters."""

    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]

    def hold(self, values: Float[np.ndarray, " 2"]) -> bool:
        """Return whether values are in the ranges, or within rounding errors of them."""
        room = 1e-12 * self.widths
        return bool(np.all((values >= self.low - room) & (values <= self.high + room)))

    @property
    def widths(self) -> Float[np.ndarray, " 2"]:
        return self.high - self.low

    def step(self, one: Unknowns, other: Unknowns) -> Float[np.ndarray, " columns"]:
        """Return the scaled step from one point to another; it is 0 for vectors and scalars."""
        others = np.zeros(one.vectors.size + one.scalars.size)
        change = (other.cycle - one.cycle).ravel(), others, other.values - one.values
        return np.concatenate(change) / scales_of(one, self.widths)


def measured(unknowns: Unknowns) -> Float[np.ndarray, " columns"]:
    """Return 1 for states and parameters, 0 for vectors and scalars."""
    others = np.zeros(unknowns.vectors.size + unknowns.scalars.size)
    return np.concatenate([np.ones(unknowns.cycle.size), others, np.ones(2)])


def first_point(
    kind: str,
    values: Float[np.ndarray, " 2"],
    cycle: Float[np.ndarray, "period section"],
    multipliers: Complex[np.ndarray, " section"],
    ranges: Ranges,
) -> Task:
    """Find the point of a curve next to a located bifurcation; None if there is none."""
    solution = yield from begin(kind, values, cycle, multipliers, ranges.widths)
    return None if solution is None else (yield from describe(kind, solution))


def advance(
    kind: str, point: EventPoint, step: np.ndarray, row: np.ndarray, ranges: Ranges
) -> Task:
    """Find the point where a curve meets the plane normal to `row` at a scaled step; or None."""
    unknowns = move(point.unknowns, step * scales_of(point.unknowns, ranges.widths))
    solution = yield from correct_event(kind, unknowns, point.frame, row, ranges.widths)
    return None if solution is None else (yield from describe(kind, solution))


def describe(kind: str, solution: Solution) -> Task:
    """Describe a solution as a point of a curve, with its tangent and its normal form."""
    unknowns, multipliers = solution.unknowns, solution.multipliers
    tangent = np.linalg.svd(solution.matrix)[2][-1] * measured(unknowns)
    towards = unknowns.vectors[0, 0]
    coefficient = yield from find_coefficient(
        kind, unknowns.values, unknowns.cycle, solution.jacobian, towards
    )
    return EventPoint(
        unknowns,
        solution.frame,
        tangent / np.linalg.norm(tangent),
        solution.residual,
        multipliers,
        coefficient,
        criteria(kind, multipliers, unknowns.scalars, coefficient),
    )


def follow_event(kind: str, first: EventPoint, sign: float, ranges: Ranges) -> Task:
    """Follow a curve from a point; the second parameter at first grows (sign 1) or falls (-1)."""
    path = EventPath([first], [], "too many points")
    direction = first.tangent * sign * (1 if first.tangent[-1] >= 0 else -1)
    point, length = first, FIRST_STEP
    while len(path.points) < MAX_POINTS:
        length, row = shorten(point, direction, length, ranges)
        if length == 0:
            return path._replace(end="the end of the range")
        at_end = row is not direction
        new = yield from advance(kind, point, direction * length, row, ranges)
        if new is None or not is_good_step(point, new, direction, length, ranges):
            length /= 2
            if length < SHORTEST_STEP:
                failed = "a state makes no stride" if new is None else "the curve bends too sharply"
                return path._replace(end=failed)
            continue
        if crosses_half_period(point.unknowns.cycle, new.unknowns.cycle):
            period = len(new.unknowns.cycle) // 2
            return path._replace(end=f"the gait of period {period} that it doubles")
        if kind == BRANCH and abs(new.unknowns.scalars[2]) > UNFOLDED:
            return path._replace(end="the branches no longer cross")
        found = yield from locate_special(kind, point, new, direction, ranges)
        for special, at in found:
            path.special.append(special)
            if kind == TORUS and special.kind in REAL_PAIRS:
                path.points.append(at)
                return path._replace(end=f"a {special.kind}, where the pair becomes real")
        path.points.append(new)
        if at_end:
            return path._replace(end="the end of the range")
        steps = (ranges.step(point.unknowns, end.unknowns) for end in (new, first))
        if len(path.points) > 4 and passes_start(*steps):
            return path._replace(end=CURVE_CLOSES)
        direction = new.tangent * np.sign(new.tangent @ direction)
        point, length = new, min(1.5 * length, LONGEST_STEP)
    return path


def shorten(
    point: EventPoint, direction: np.ndarray, length: float, ranges: Ranges
) -> tuple[float, np.ndarray]:
    """Shorten a step to the ranges; return its length and the normal of the corrector's plane."""
    row, part = direction, direction[-2:]
    for i in np.flatnonzero(part).tolist():
        end = (ranges.high if part[i] > 0 else ranges.low)[i]
        room = (end - point.unknowns.values[i]) / ranges.widths[i] / part[i]
        if room <= 1e-12:
            return 0.0, direction
        if room <= length:
            length, row = room, np.eye(1, len(direction), len(direction) - 2 + i)[0]
    return length, row


def is_good_step(
    one: EventPoint, other: EventPoint, direction: np.ndarray, length: float, ranges: Ranges
) -> bool:
    """Return whether a step is near its prediction, bends little, and ends in the ranges."""
    error = np.linalg.norm(ranges.step(one.unknowns, other.unknowns) - direction * length)
    straight = abs(other.tangent @ direction) > MIN_COSINE
    return bool(error < length / 2 and straight and ranges.hold(other.unknowns.values))


def locate_special(
    kind: str, one: EventPoint, other: EventPoint, direction: np.ndarray, ranges: Ranges
) -> Task:
    """Locate the points of codimension two on a step that their multipliers confirm.

    Each is returned as a `CodimensionTwo` and as a point of the curve.
    """
    found = []
    for name, before in one.criteria.items():
        largest = max(abs(before), abs(other.criteria[name]))
        if before * other.criteria[name] < 0 and largest > VANISHING:
            point = yield from locate(kind, name, one, other, direction, ranges)
            if point is None or not is_confirmed(name, point.multipliers):
                continue
            left = point.criteria[name]
            if abs(left) < 1e-3 * largest:  # it is no pole
                values, cycle, *_ = point.unknowns
                special = name, values, cycle, point.multipliers, left, point.residual
                found.append((CodimensionTwo(*special), point))
    along = lambda pair: direction[-2:] @ (pair[0].values / ranges.widths)
    return sorted(found, key=along)


def locate(
    kind: str,
    name: str,
    one: EventPoint,
    other: EventPoint,
    direction: np.ndarray,
    ranges: Ranges,
) -> Task:
    """Find the point between two points at which a criterion is zero, by the Illinois method.

    A secant goes through the ends of the bracket. The value at an end that stays is halved. If the
    corrector fails, the best point so far is returned, or None.
    """
    low, high = 0.0, float(ranges.step(one.unknowns, other.unknowns) @ direction)
    at_low, at_high, best = one.criteria[name], other.criteria[name], None
    for _ in range(LOCATING_STEPS):
        length = (low * at_high - high * at_low) / (at_high - at_low)
        point = yield from advance(kind, one, direction * length, direction, ranges)
        if point is None or not np.isfinite(value := point.criteria[name]):
            return best
        if best is None or abs(value) < abs(best.criteria[name]):
            best = point
        if value * at_high < 0:
            low, at_low = high, at_high
        else:
            at_low /= 2
        if abs(high - length) < LOCATED or value == 0:
            break
        high, at_high = length, value
    return best
