"""Continuation of one branch of gaits, from a start to an end."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.arclength import Point, correct_point, displace, scaled_step, tangent
from walker_jax.gaits.events import Bifurcation, crosses_half_period, find_bifurcations
from walker_jax.gaits.requests import Task
from walker_jax.systems.angles import Turns

FIRST_STEP, LONGEST_STEP, SHORTEST_STEP = 0.005, 0.05, 1e-7
"""Lengths of the first, the longest and the shortest step along a branch, in widths of the range.
The branch ends if it needs a shorter step; it takes at least 20 steps over the range."""
HALF_PERIOD_RESOLUTION = 1e-3
"""Longest step at the end of a branch that returns to the gait from which it doubled."""
MAX_POINTS = 2000
"""Most points on each side of a branch: with the longest steps, a hundred times the range."""
BRANCH_CLOSES = "the branch closes"
"""Reason for the end of a path that comes back to its start."""
MIN_COSINE = 0.95
"""Smallest cosine of the angle between the tangents at both ends of a step (18 degrees)."""


class Start(NamedTuple):
    """A gait from which continuation starts."""

    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    direction: Float[np.ndarray, "period section"] | None = None
    """Direction of the first step, at a constant parameter; None for both along the branch."""


def start_at_doubling(doubling: Bifurcation) -> Start:
    """Return the start of the branch of twice the period at a period doubling."""
    cycle = np.concatenate([doubling.states, doubling.states])
    return Start(doubling.value, cycle, np.concatenate([doubling.vectors, -doubling.vectors]))


class Path(NamedTuple):
    """One side of a branch, from its start."""

    points: list[Point]
    events: list[Bifurcation]
    end: str

    def of_kind(self, kind: str) -> list[Bifurcation]:
        """Return its bifurcations of one kind."""
        return [one for one in self.events if one.kind == kind]


def follow_branch(
    start: Start, sign: float, bounds: tuple[float, float], turns: Turns = None
) -> Task:
    """Follow a branch from a start; the parameter at first grows (sign 1) or falls (-1)."""
    width = bounds[1] - bounds[0]
    path = Path([], [], "no gait")
    first = yield from correct_point(start.value, start.states, None, width)
    if first is None:
        return path
    path.points.append(first)
    if start.direction is None:
        direction = tangent(first, width)
        direction *= sign if direction[-1] >= 0 else -sign
    else:
        direction = np.append(start.direction.ravel() / np.sqrt(len(start.states)), 0.0)
        direction /= np.linalg.norm(direction)
    point, length, end = first, FIRST_STEP, "too many points"
    while len(path.points) < MAX_POINTS:
        distance = ((bounds[1] if direction[-1] > 0 else bounds[0]) - point.value) / width
        if distance * direction[-1] <= 0 and direction[-1] != 0:  # already at the end
            end = "the end of the range"
            break
        at_end = length * abs(direction[-1]) >= abs(distance)
        if at_end:
            length = distance / direction[-1]
        row = np.append(np.zeros(len(direction) - 1), 1.0) if at_end else direction
        value, cycle = displace(point, direction * length, width)
        new = yield from correct_point(value, cycle, row, width)
        found = None
        if new is not None:
            next_direction = tangent(new, width)
            next_direction *= np.sign(next_direction @ direction)
            error = np.linalg.norm(scaled_step(point, new, width) - direction * length)
            if error < length / 2 and next_direction @ direction > MIN_COSINE:
                found = yield from find_bifurcations(point, new, direction, next_direction, width)
        if new is None or found is None:
            length /= 2
            if length < SHORTEST_STEP:
                end = "a state makes no stride" if new is None else "the branch bends too sharply"
                break
            continue
        if crosses_half_period(point.cycle, new.cycle):
            if length > HALF_PERIOD_RESOLUTION:
                length /= 2
                continue
            end = f"the gait of period {len(cycle) // 2} that it doubles"
            break
        path.events.extend(found)
        path.points.append(new)
        if at_end:
            end = "the end of the range"
            break
        steps = (scaled_step(point, end, width, turns) for end in (new, first))
        if len(path.points) > 4 and passes_start(*steps):
            end = BRANCH_CLOSES
            break
        point, direction, length = new, next_direction, min(1.5 * length, LONGEST_STEP)
    return path._replace(end=end)


def passes_start(step: Float[np.ndarray, " size"], offset: Float[np.ndarray, " size"]) -> bool:
    """Return whether a step passes the branch's start, at an offset from the step's beginning."""
    length = np.linalg.norm(step)
    along = offset @ step / length
    across = np.linalg.norm(offset - along * step / length)
    return bool(0 <= along <= length and across < 0.05 * length)
