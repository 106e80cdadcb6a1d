"""Pareto fronts: the walkers that no other one betters in two objectives at once.

Each objective is scaled to 0 at its optimum and to 1 where the other has its own. From points a on
the line between these two ends, the front is sought along the diagonal,

    minimise t,  with u1 <= a1 + t and u2 <= a2 + t

(Pascoletti and Serafini 1984, J. Optim. Theory Appl. 42:499-524). This is a weighted Chebyshev
problem. It reaches the concave parts of a front too, which no weighted sum does. SciPy's SLSQP
solves it, with exact derivatives.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_whole, refuses_tracers
from walker_jax.design.measures import GaitFunction
from walker_jax.design.posing import further_measures, pose_problem, with_grid
from walker_jax.design.problem import (
    Problem,
    default_levels,
    describe_problem,
    name_functions,
    parse_limits,
    parse_objective,
    read_bounds,
    starting_places,
)
from walker_jax.design.trace import Trace, string_array
from walker_jax.execution.progress import bar
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.choices import Choice

FAILED = 10.0
"""Scaled objective of a walker without a gait: far worse than both ends of the front."""
SOLVED, MOST_STEPS = 1e-12, 100
"""Change of t, of a range of 1, below which SLSQP ends, and the most steps it makes."""
SLACK = 1e-6
"""Relative violation of a limit that rounding in SLSQP may leave."""
TINY = 1e-9
"""Part of an objective's size below which a range is none."""
STAGE = 2
"""The stage of climbs by whose settings areas are measured."""
Goal = str | GaitFunction | Mapping[Any, Any]


class Search(NamedTuple):
    """Both objectives, and how they are scaled."""

    traces: tuple[Trace, Trace]
    best: Float[np.ndarray, " 2"]
    """Least cost of each; costs are objectives as numbers to minimise."""
    width: Float[np.ndarray, " 2"]
    """Range of each cost along the front."""

    def costs(self, place: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " 2"]:
        """Return both costs at a place; NaN where they are unknown."""
        rows = [one.measure(0, STAGE, place) for one in self.traces]
        return np.array(
            [-one.problem.sign * r.value for one, r in zip(self.traces, rows, strict=True)]
        )

    def slack(
        self, z: Float[np.ndarray, " n"], start: Float[np.ndarray, " 2"]
    ) -> Float[np.ndarray, " m"]:
        """Return a + t - u, and the slacks of the limits, for a start a and z = (place, t)."""
        scaled = np.nan_to_num((self.costs(z[:-1]) - self.best) / self.width, nan=FAILED)
        limits = [one.value for one in self.traces[0].limits.slacks(z[:-1])]
        counted = np.isfinite(start)
        over = (start + z[-1] - scaled)[counted]
        return np.concatenate([over, np.nan_to_num(limits, nan=-FAILED)])

    def slack_gradient(
        self, z: Float[np.ndarray, " n"], start: Float[np.ndarray, " 2"]
    ) -> Float[np.ndarray, "m n"]:
        """Return the derivatives of `slack`."""
        rows = [
            (one.problem.sign * one.measure(0, STAGE, z[:-1]).gradient * one.problem.scale) / width
            for one, width in zip(self.traces, self.width, strict=True)
        ]
        rows = [row for row, end in zip(rows, start, strict=True) if np.isfinite(end)]
        by_t = np.ones(len(rows))
        rows += [one.gradient for one in self.traces[0].limits.slacks(z[:-1])]
        by_t = np.append(by_t, np.zeros(len(rows) - len(by_t)))
        return np.nan_to_num(np.column_stack([np.array(rows), by_t]))

    def solve(
        self, place: Float[np.ndarray, " parameters"], start: Float[np.ndarray, " 2"]
    ) -> "Point":
        """Minimise t from a place on; an objective whose start is infinite does not count."""
        from scipy.optimize import minimize

        size, (low, high) = len(place), self.traces[0].problem.ends
        t = -float(np.min(self.slack(np.append(place, 0.0), start)[: np.isfinite(start).sum()]))
        found = minimize(
            lambda z: z[-1],
            np.append(place, t),
            jac=lambda z: np.eye(size + 1)[-1],
            bounds=[*zip(low, high, strict=True), (None, None)],
            constraints={
                "type": "ineq",
                "fun": self.slack,
                "jac": self.slack_gradient,
                "args": (start,),
            },
            method="SLSQP",
            options={"ftol": SOLVED, "maxiter": MOST_STEPS},
        )
        end = self.traces[0].problem.within(found.x[:-1])
        allowed = all(one.value >= -SLACK for one in self.traces[0].limits.slacks(end))
        costs = self.costs(end)
        return Point(end, costs if allowed else costs * np.nan, bool(found.success))


class Point(NamedTuple):
    """A point of a front."""

    place: Float[np.ndarray, " parameters"]
    costs: Float[np.ndarray, " 2"]
    """NaN where a limit is violated."""
    converged: bool


@refuses_tracers()
def pareto(
    walker: System,
    bounds: Mapping[str, Any] | None,
    objectives: tuple[Goal, Goal],
    *,
    points: int = 9,
    parameters: Choice | None = None,
    at_least: Mapping[Any, Any] | None = None,
    at_most: Mapping[Any, Any] | None = None,
    grid: Grid | None = None,
    starts: int = 3,
    levels: int | None = None,
    strides: int = 200,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Find walkers that no other one betters in two objectives at once: their Pareto front.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    front = wj.pareto(walker, {"slope": (0.002, 0.015)}, ("speed", "spectral-radius"), points=3)
    front["objectives"]
    ```

    Each objective is as in `optimise`, as are the other arguments. Both ends of the front are the
    best walkers by each objective alone, found from all `starts`. Further points are found from
    there and from their neighbours. The front may be convex or concave; where it has gaps, points
    are fewer. As any search by gradients, it may miss better walkers far from these.

    - `points`: number of points, ends included.

    **Returns** a data set over `point`, from the best by the first objective to the best by the
    second: `parameters` over `parameter`, `objectives` over `objective`, and whether the search has
    `converged`. Points that others better are left out.

    Raises `ValueError` as `optimise` does; `ComputationFailed` where no start has both objectives.
    """
    check_kind("walker", walker, System)
    check_kind("objectives", objectives, tuple)
    if len(objectives) != 2:
        raise WrongUse(f"objectives must be two, not {len(objectives)}")
    check_whole("points", points, 3)
    check_whole("starts", starts)
    (*named, low, high), functions = name_functions(*objectives, at_least, at_most)
    further = further_measures(walker, functions)
    goals = [parse_objective(one, further) for one in named]
    limits = parse_limits(low, high, further)
    free = read_bounds(walker, bounds, parameters)
    problems = []
    for goal in goals:
        finest = default_levels(goal[0]) if levels is None else levels
        how = (grid, finest, strides, seed, tolerance, None, functions)
        problems.append(pose_problem(walker, free, goal, limits, how))
    places = starting_places(problems[0], starts)
    problems = [with_grid(one, places) for one in problems]
    traces = [Trace(one, None, None, False, 1) for one in problems]
    traces[1].gaits = traces[0].gaits  # found once for both
    with bar(f"{points} points of a front", progress):
        found = follow_front((traces[0], traces[1]), places, points)
    return describe_front(problems, found)


def follow_front(
    traces: tuple[Trace, Trace], places: list[Float[np.ndarray, " parameters"]], points: int
) -> list[Point]:
    """Find both ends of a front, and points between them, each also from its neighbour."""
    plain = Search(traces, np.zeros(2), np.ones(2))
    known = [costs for place in places if np.isfinite(costs := plain.costs(place)).all()]
    if not known:
        raise ComputationFailed("no start has a gait and both objectives: give other bounds")
    scale = np.maximum(np.abs(known).max(axis=0), TINY)
    rough = Search(traces, np.zeros(2), scale)
    ends = []
    for alone in np.where(np.eye(2), 0.0, np.inf):
        tried = [rough.solve(place, alone) for place in places]
        ends.append(least(tried, lambda one, counted=alone == 0: float(one.costs[counted][0])))
    best = np.array([ends[0].costs[0], ends[1].costs[1]])
    width = np.array([ends[1].costs[0], ends[0].costs[1]]) - best
    if not (width > TINY * scale).all():  # one walker is the best by both
        return [least(ends, lambda one: float(np.sum(one.costs / scale)))]
    search, front = Search(traces, best, width), [ends[0]]
    for share in np.linspace(0, 1, points)[1:-1]:
        start = np.array([share, 1 - share])
        tried = [search.solve(place, start) for place in (front[-1].place, ends[1].place)]
        height = lambda one, start=start: float(np.max((one.costs - best) / width - start))
        front.append(least(tried, height))
    front.append(ends[1])
    return [one for one in front if not any(np.all(o.costs < one.costs) for o in front)]


def least(points: list[Point], height: Callable[[Point], float]) -> Point:
    """Return the point of least height; one that violates a limit is the last."""
    return min(points, key=lambda one: np.nan_to_num(height(one), nan=np.inf))


def describe_front(problems: list[Problem], front: list[Point]) -> xr.Dataset:
    """Return a front as a data set."""
    signs = np.array([one.sign for one in problems])
    about = describe_problem(problems[0])
    about |= {"objective": json.dumps([one.weights for one in problems])}
    names = [" + ".join(one.weights) for one in problems]
    return xr.Dataset(
        {
            "parameters": (
                ("point", "parameter"),
                [problems[0].values(one.place) for one in front],
            ),
            "objectives": (("point", "objective"), [-signs * one.costs for one in front]),
            "converged": ("point", [one.converged for one in front]),
        },
        {"parameter": string_array(problems[0].names), "objective": string_array(names)},
        about,
    )
