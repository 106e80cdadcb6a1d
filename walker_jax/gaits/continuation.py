"""One branch of gaits, followed from a point to an end."""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.arclength import Point, between, corrected, moved, tangent
from walker_jax.gaits.events import Bifurcation, bifurcations_between, crosses_half_period
from walker_jax.gaits.requests import Answer, Ask

FIRST, LONGEST, SHORTEST = 0.005, 0.05, 1e-7
"""Distances along a branch: of the first step, of the longest, and of one too short to go on."""
NEAR = 1e-3
"""Distance at which a branch ends that comes back to the gait from which it doubled."""
POINTS = 2000
"""Points at most on each side of a branch."""
BEND = 0.95
"""Least cosine of the angle between a branch's directions at the ends of a step."""


class Start(NamedTuple):
    """A gait to continue from."""

    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    direction: Float[np.ndarray, "period section"] | None = None
    """In which to leave, the parameter standing still; both ways along the branch if none."""


def doubled(doubling: Bifurcation) -> Start:
    """Where the gait of twice the period leaves a period doubling."""
    cycle = np.concatenate([doubling.states, doubling.states])
    return Start(doubling.value, cycle, np.concatenate([doubling.vectors, -doubling.vectors]))


class Path(NamedTuple):
    """What was found on one side of a start."""

    points: list[Point]
    folds: list[Bifurcation]
    doublings: list[Bifurcation]
    end: str


def follow(start: Start, way: float, bounds: tuple[float, float]) -> Generator[Ask, Answer, Path]:
    """Follow a branch from a start, first with the parameter growing (way 1) or falling (-1)."""
    width = bounds[1] - bounds[0]
    path = Path([], [], [], "no gait")
    first = yield from corrected(start.value, start.states, None, width)
    if first is None:
        return path
    path.points.append(first)
    if start.direction is None:
        direction = tangent(first, width)
        direction *= way if direction[-1] >= 0 else -way
    else:
        direction = np.append(start.direction.ravel() / np.sqrt(len(start.states)), 0.0)
        direction /= np.linalg.norm(direction)
    point, length, end = first, FIRST, "too many points"
    while len(path.points) < POINTS:
        reach = ((bounds[1] if direction[-1] > 0 else bounds[0]) - point.value) / width
        if reach * direction[-1] <= 0 and direction[-1] != 0:  # there already
            end = "the end of the range"
            break
        last = length * abs(direction[-1]) >= abs(reach)
        if last:
            length = reach / direction[-1]
        row = np.append(np.zeros(len(direction) - 1), 1.0) if last else direction
        value, cycle = moved(point, direction * length, width)
        new = yield from corrected(value, cycle, row, width)
        found = None
        if new is not None:
            onward = tangent(new, width)
            onward *= np.sign(onward @ direction)
            close = np.linalg.norm(between(point, new, width) - direction * length) < length / 2
            if close and onward @ direction > BEND:
                found = yield from bifurcations_between(point, new, direction, onward, width)
        if new is None or found is None:
            length /= 2
            if length < SHORTEST:
                end = "a state makes no stride" if new is None else "the branch bends too sharply"
                break
            continue
        if crosses_half_period(point, new):
            if length > NEAR:
                length /= 2
                continue
            end = f"the gait of period {len(cycle) // 2} that it doubles"
            break
        path.folds.extend(b for b in found if b.kind == "fold")
        path.doublings.extend(b for b in found if b.kind == "doubling")
        path.points.append(new)
        if last:
            end = "the end of the range"
            break
        if len(path.points) > 4 and passes(point, new, first, width):
            end = "the branch closes"
            break
        point, direction, length = new, onward, min(1.5 * length, LONGEST)
    return path._replace(end=end)


def passes(one: Point, other: Point, start: Point, width: float) -> bool:
    """Whether a branch comes by its start, between two points."""
    step, offset = between(one, other, width), between(one, start, width)
    length = np.linalg.norm(step)
    along = offset @ step / length
    across = np.linalg.norm(offset - along * step / length)
    return bool(0 <= along <= length and across < 0.05 * length)
