"""Branches of gaits over a parameter of the walker: continuation, folds, period doublings.

Along a branch the cycle's states and the parameter p are unknowns together, and a point further on
is where the branch meets a plane across it (pseudo-arclength continuation, Keller 1977), so a
branch is followed round its folds. At a fold a multiplier is 1, and two branches of gaits meet and
end; at a period doubling one is -1, and a gait of twice the period leaves. Both are located by
Newton's iteration on the states, the parameter and the vector v that the cycle's Jacobian maps to
v or to -v, with second derivatives of the stride function by automatic differentiation.

Distances along a branch are sqrt(mean |dx|^2 + (dp / width of the range)^2).
"""

from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import WrongUse, check_kind, check_precision, numbers, refuses_tracers, short
from walker_jax.gaits import (
    RESIDUAL,
    Curved,
    Gait,
    Linearised,
    check_parameter,
    curve,
    cyclic,
    find_gait,
    linearise,
    multipliers_of,
    product,
    solve,
    with_parameter,
)
from walker_jax.integrate import Real, default_tolerance
from walker_jax.stride import prepared, stacked
from walker_jax.walkers import Walker

FIRST, LONGEST, SHORTEST = 0.005, 0.05, 1e-7
"""Distances along a branch: of the first step, of the longest, and of one too short to go on."""
NEAR = 1e-3
"""Distance at which a branch ends that comes back to the gait from which it doubled."""
STEPS = 12
"""Newton steps at most, for a point and for a bifurcation."""
POINTS = 2000
"""Points at most on each side of a branch."""
BEND = 0.95
"""Least cosine of the angle between a branch's directions at the ends of a step."""


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


class Branch(NamedTuple):
    """Gaits of one period along a parameter, in the order in which they follow each other."""

    parameter: str
    values: Float[np.ndarray, " points"]
    """Values of the parameter; they turn round at folds."""
    states: Float[np.ndarray, "points period section"]
    multipliers: Complex[np.ndarray, "points section"]
    """The largest first."""
    step_times: Float[np.ndarray, "points period"]
    folds: list[Bifurcation]
    doublings: list[Bifurcation]
    ends: tuple[str, str]
    """Why the branch ends where it does, at its first point and at its last."""

    @property
    def period(self) -> int:
        return self.states.shape[1]

    @property
    def stable(self) -> np.ndarray:
        """Whether each gait is stable, shape (points,)."""
        return np.abs(self.multipliers[:, 0]) < 1


class Start(NamedTuple):
    """A gait to continue from."""

    value: float
    """Value of the parameter."""
    states: Float[np.ndarray, "period section"]
    direction: Float[np.ndarray, "period section"] | None = None
    """In which to leave, the parameter standing still; both ways along the branch if none."""


@refuses_tracers()
def continue_gait(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    gait: Gait | None = None,
    *,
    tolerance: Real | None = None,
) -> Branch:
    """The branch of a gait over a range of a parameter, both ways, round its folds.

    Steps are as long as the branch is straight; of two folds, or two doublings, within one step
    nothing is seen. The branch ends where it leaves the range, where
    a state no longer makes a stride however short the step, where it closes, or where it comes
    back to the gait of half the period from which it doubled.

    **Arguments:**

    - `walker`: any walker.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of it, with the walker's own between them or at one.
    - `gait`: of this walker; by default, that of `find_gait`.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** a `Branch`, from the end that is reached with the parameter falling at first to the
    other. `ValueError` for a parameter that the walker does not have, a range without its value,
    and for what is not a gait.
    """
    check_interval(walker, parameter, interval)
    value = float(getattr(walker, parameter))
    gait = find_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    if not gait.found:
        raise WrongUse(f"gait must be one, unlike the end of a failed search, {gait.states}")
    start = Start(value, np.asarray(gait.states, float))
    return continue_gaits(walker, parameter, interval, [start], tolerance=tolerance)[0]


def continue_gaits(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    starts: Sequence[Start],
    *,
    tolerance: Real | None = None,
) -> list[Branch]:
    """The branches through many starts, of any periods; all are followed together.

    As `continue_gait` otherwise. The walker gives the values of its other parameters. A start that
    is no gait gives a branch without points.
    """
    tolerance = double_tolerance(tolerance)
    low, high = check_interval(walker, parameter, interval)
    for start in starts:
        if not low <= start.value <= high:
            raise WrongUse(f"interval ({low}, {high}) must hold the {parameter} {start.value}")
    tasks = [
        follow(start, way, (low, high))
        for start in starts
        for way in ((-1.0, 1.0) if start.direction is None else (1.0,))
    ]
    paths = iter(together(walker, parameter, tasks, tolerance))
    branches = []
    for start in starts:
        back = next(paths) if start.direction is None else Path([], [], [], "a period doubling")
        branches.append(joined(parameter, back, next(paths), len(walker.section)))
    return branches


def check_interval(
    walker: Walker, parameter: str, interval: tuple[float, float]
) -> tuple[float, float]:
    """The two ends of an interval of a walker's parameter, checked."""
    check_parameter(walker, parameter)
    ends = numbers("interval", interval)
    if ends.shape != (2,) or not -np.inf < ends[0] < ends[1] < np.inf:
        raise WrongUse(f"interval must be (low, high) with low below high, not {short(interval)}")
    check_parameter(walker, parameter, *interval)
    return float(interval[0]), float(interval[1])


def double_tolerance(tolerance: Real | None) -> Real:
    """The tolerance in float64, without which nothing here can be told from rounding."""
    check_precision(jnp.asarray(0.0).dtype, "following gaits over a parameter")
    return default_tolerance(jnp.float64, tolerance)


def doubled(doubling: Bifurcation) -> Start:
    """Where the gait of twice the period leaves a period doubling."""
    cycle = np.concatenate([doubling.states, doubling.states])
    return Start(doubling.value, cycle, np.concatenate([doubling.vectors, -doubling.vectors]))


# How a branch is followed. Each path is a generator that asks for strides and their derivatives
# and is sent the answer, so that one call computes what all paths ask for.


class Ask(NamedTuple):
    """A cycle of states at a value of the parameter, of which the derivatives are wanted."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    vectors: Float[np.ndarray, "period section"] | None = None
    """Directions along which second derivatives are wanted too."""


class Answer(NamedTuple):
    """Derivatives at a cycle of states, as `linearise` and `curve` give them."""

    local: Linearised
    curved: Curved | None


Task = Generator[Ask, Answer, Any]


def together(
    walker: Walker, parameter: str, tasks: Sequence[Task], tolerance: Real | None
) -> list[Any]:
    """Run tasks side by side, what they ask for computed in batches; returns what they return."""
    results: list[Any] = [None] * len(tasks)
    asked: dict[int, Ask] = {}

    def advance(i: int, answer: Answer | None):
        try:
            asked[i] = next(tasks[i]) if answer is None else tasks[i].send(answer)
        except StopIteration as stop:
            results[i] = stop.value

    for i in range(len(tasks)):
        advance(i, None)
    while asked:
        asks, asked = asked, {}
        answers = answer_all(walker, parameter, list(asks.values()), tolerance)
        for i, answer in zip(asks, answers, strict=True):
            advance(i, answer)
    return results


def answer_all(
    walker: Walker, parameter: str, asks: list[Ask], tolerance: Real | None
) -> list[Answer]:
    """What is asked for, every state of every cycle a cell of its own."""
    dtype = asks[0].cycle.dtype
    walker, _, tolerance = prepared(walker, asks[0].cycle[0], tolerance)
    batch = lambda asks: cells_of(walker, parameter, asks, dtype)
    locals_ = split(linearise(*batch(asks), tolerance, parameter), asks)
    bent = [ask for ask in asks if ask.vectors is not None]
    curves: list[Curved] = []
    if bent:
        vectors = np.concatenate([ask.vectors for ask in bent if ask.vectors is not None])
        directions = np.concatenate([vectors, np.zeros_like(vectors[:, :1])], axis=1)[:, None]
        walkers, states = batch(bent)
        curves = split(curve(walkers, states, directions, tolerance, parameter), bent)
    curved = iter(curves)
    return [
        Answer(local, next(curved) if ask.vectors is not None else None)
        for ask, local in zip(asks, locals_, strict=True)
    ]


def cells_of(
    walker: Walker, parameter: str, asks: list[Ask], dtype: Any
) -> tuple[Walker, Float[np.ndarray, "n 1 section"]]:
    """Walkers and states of all cycles asked about, one after the other."""
    values = np.concatenate([np.full(len(ask.cycle), ask.value, dtype) for ask in asks])
    states = np.concatenate([ask.cycle for ask in asks])[:, None]
    return with_parameter(stacked(walker, len(values), dtype), parameter, values), states


def split(values: Linearised | Curved, asks: list[Ask]) -> list[Any]:
    """What was found at all states, cycle by cycle."""
    ends = np.cumsum([len(ask.cycle) for ask in asks])[:-1]
    parts = zip(*(np.split(np.moveaxis(v, 1, 0), ends, axis=1) for v in values), strict=True)
    return [type(values)(*part) for part in parts]


class Point(NamedTuple):
    """A gait on a branch."""

    value: float
    cycle: Float[np.ndarray, "period section"]
    local: Linearised


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


def passes(one: Point, other: Point, start: Point, width: float) -> bool:
    """Whether a branch comes by its start, between two points."""
    step, offset = between(one, other, width), between(one, start, width)
    length = np.linalg.norm(step)
    along = offset @ step / length
    across = np.linalg.norm(offset - along * step / length)
    return bool(0 <= along <= length and across < 0.05 * length)


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


def joined(parameter: str, back: Path, forth: Path, size: int) -> Branch:
    """The branch of the two sides of a start."""
    points = [*reversed(back.points[1:]), *forth.points]
    if not points:
        nothing = np.zeros((0, 1, size))
        return Branch(
            parameter,
            nothing[:, 0, 0],
            nothing,
            nothing[:, 0],
            nothing[:, :, 0],
            [],
            [],
            (back.end, forth.end),
        )
    local = [point.local for point in points]
    return Branch(
        parameter=parameter,
        values=np.array([point.value for point in points]),
        states=np.stack([point.cycle for point in points]),
        multipliers=multipliers_of(product(np.concatenate([one.jacobian for one in local]))),
        step_times=np.concatenate([one.time for one in local]),
        folds=[*reversed(back.folds), *forth.folds],
        doublings=[*reversed(back.doublings), *forth.doublings],
        ends=(back.end, forth.end),
    )


def crossings(branch: Branch, value: float) -> list[Float[np.ndarray, "period section"]]:
    """States of a branch's gaits at a value of the parameter, interpolated between its points."""
    cycles = []
    for i in np.flatnonzero((branch.values[:-1] - value) * (branch.values[1:] - value) <= 0):
        low, high = branch.values[i], branch.values[i + 1]
        share = 0.5 if low == high else (value - low) / (high - low)
        cycles.append((1 - share) * branch.states[i] + share * branch.states[i + 1])
    return cycles
