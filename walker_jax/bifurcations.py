"""Branches of gaits over a parameter of the walker: how gaits are born, lose stability and end.

Along a branch the cycle's states and the parameter p are unknowns together, and a point further on
is where the branch meets a plane across it (pseudo-arclength continuation, Keller 1977), so a
branch is followed round its folds. At a fold a multiplier is 1, and two branches of gaits meet and
end; at a period doubling one is -1, and a gait of twice the period leaves. Both are located by
Newton's iteration on the states, the parameter and the vector v that the cycle's Jacobian maps to
v or to -v, with second derivatives of the stride function by automatic differentiation.

Distances along a branch are sqrt(mean |dx|^2 + (dp / width of the range)^2).
"""

import operator
from collections.abc import Generator, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Complex, Float, Int

from walker_jax.gaits import (
    RESIDUAL,
    TILE,
    Curved,
    Gait,
    Linearised,
    check_parameter,
    curve,
    cyclic,
    distinct,
    find_gait,
    linearise,
    multipliers_of,
    product,
    search,
    solve,
    some,
    walked,
    with_parameter,
)
from walker_jax.integrate import Real, default_tolerance
from walker_jax.stride import Outcome, follow_stride, prepared, stacked
from walker_jax.stride import strides as many_strides
from walker_jax.tiles import over_cells
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
RECENT = 64
"""States of an orbit that are recorded, and the longest period that is recognised."""
ROUND = 64
"""Strides in a call, after which walkers that fell are left behind."""
PARTS = 32
"""In which an interval is divided, at once, in search of the loss of walking."""
OFFSET = 1e-3
"""Distance from a gait, in the first coordinate, at which they start."""
SAME = 1e-6
"""Distance, in every coordinate, at which an orbit has come back."""
SEARCHED = 6
"""Longest period of which gaits are searched that no doubling leads to."""
SAMPLES = 16
"""Values of the parameter at which gaits are searched."""
SPARSE = 32
"""One in how many cells of a gait region gaits are searched from there."""


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


def continue_gait(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    gait: Gait | None = None,
    *,
    tolerance: Real | None = None,
) -> Branch:
    """The branch of a gait over a range of a parameter, both ways, round its folds.

    Steps are as long as the branch is straight. The branch ends where it leaves the range, where
    a state no longer makes a stride however short the step, where it closes, or where it comes
    back to the gait of half the period from which it doubled.

    **Arguments:**

    - `walker`: any walker.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of it, with the walker's own between them.
    - `gait`: of this walker; by default, that of `find_gait`.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** a `Branch`, from the end that is reached with the parameter falling at first to the
    other. `ValueError` for a parameter that the walker does not have, a range without its value,
    and for what is not a gait.
    """
    check_parameter(walker, parameter)
    value = float(getattr(walker, parameter))
    gait = find_gait(walker, tolerance=tolerance) if gait is None else gait
    if not gait.found:
        raise ValueError(f"gait must be one, unlike the end of a failed search, {gait.states}")
    start = Start(value, np.asarray(gait.states))
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
    check_parameter(walker, parameter)
    tolerance = double_tolerance(tolerance)
    low, high = interval
    if not low < high:
        raise ValueError(f"interval must be (low, high) with low below high, not ({low}, {high})")
    for start in starts:
        if not low <= start.value <= high:
            raise ValueError(f"interval ({low}, {high}) must hold the {parameter} {start.value}")
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


def double_tolerance(tolerance: Real | None) -> Real:
    """The tolerance in float64, without which nothing here can be told from rounding."""
    if jnp.asarray(0.0).dtype != jnp.float64:
        raise ValueError("float64 is needed: jax.config.update('jax_enable_x64', True)")
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

    def batch(asks: list[Ask]):
        values = np.concatenate([np.full(len(ask.cycle), ask.value, dtype) for ask in asks])
        states = np.concatenate([ask.cycle for ask in asks])[:, None]
        return with_parameter(stacked(walker, len(values), dtype), parameter, values), states

    def split(values: Linearised | Curved, asks: list[Ask]) -> list[Any]:
        ends = np.cumsum([len(ask.cycle) for ask in asks])[:-1]
        parts = zip(*(np.split(np.moveaxis(v, 1, 0), ends, axis=1) for v in values), strict=True)
        return [type(values)(*part) for part in parts]

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
    first = yield from settle(start.value, start.states, None, width)
    if first is None:
        return path
    path.points.append(first)
    if start.direction is None:
        direction = tangent(first, width)
        direction *= way * np.sign(direction[-1])
    else:
        direction = np.append(start.direction.ravel() / np.sqrt(len(start.states)), 0.0)
        direction /= np.linalg.norm(direction)
    point, length, end = first, FIRST, "too many points"
    while len(path.points) < POINTS:
        reach = ((bounds[1] if direction[-1] > 0 else bounds[0]) - point.value) / width
        last = length * abs(direction[-1]) >= abs(reach)
        if last:
            length = reach / direction[-1]
        row = np.append(np.zeros(len(direction) - 1), 1.0) if last else direction
        value, cycle = moved(point, direction * length, width)
        new = yield from settle(value, cycle, row, width)
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


def settle(
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


# What walkers come to.


def attractors(
    walker: Walker,
    parameter: str,
    values: Float[ArrayLike, " values"],
    starts: Float[ArrayLike, "..."],
    *,
    strides: int = 1000,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> xr.Dataset:
    """What walkers come to at each of many values of a parameter, from many starts.

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of the one that changes.
    - `values`: of the parameter.
    - `starts`: points of the section for each value, of shape (values, starts, section).
    - `strides`: for which every walker is followed before its states are recorded.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: what to call the work in a progress bar, shown on a terminal only.

    **Returns** a data set over `value` and `start`: `fate`, the `Outcome` of the stride at which a
    walker fails, `STRIDE` where it does not; `strides` before that; `orbit`, the `RECENT` states
    that follow, NaN after a failure; and `period` of that orbit, 0 where none up to `RECENT` shows.
    """
    check_parameter(walker, parameter)
    values, starts = np.asarray(values, float), np.asarray(starts, float)
    if starts.ndim != 3 or starts.shape[::2] != (len(values), len(walker.section)):
        shape = f"({len(values)}, starts, {len(walker.section)})"
        raise ValueError(f"starts must have shape {shape}, not {starts.shape}")
    if operator.index(strides) < 1:
        raise ValueError(f"strides must be at least 1, not {strides}")
    n, m, size = starts.shape
    walkers = with_parameter(walker, parameter, np.repeat(values, m))
    x, fate, count = persist(walkers, starts.reshape(-1, size), strides, tolerance, progress)
    orbit = np.full((n * m, RECENT, size), np.nan)
    left = np.flatnonzero(fate == Outcome.STRIDE)
    x = x[left]
    for i in range(RECENT):
        orbit[left, i] = x
        ends = many_strides(some(walkers, left), x, tolerance=tolerance)
        alive = ends.outcome == Outcome.STRIDE
        fate[left] = ends.outcome
        count[left] += alive
        left, x = left[alive], ends.state[alive]
    misses = np.abs(orbit[:, :-1] - orbit[:, -1:]).max(axis=2)[:, ::-1] < SAME
    period = np.where(misses.any(axis=1), misses.argmax(axis=1) + 1, 0)
    over = ("value", "start")
    return xr.Dataset(
        {
            "fate": (over, fate.reshape(n, m)),
            "strides": (over, count.reshape(n, m)),
            "period": (over, period.reshape(n, m)),
            "orbit": ((*over, "recent", "coordinate"), orbit.reshape(n, m, RECENT, size)),
        },
        coords={"value": values},
        attrs={"parameter": parameter, "section": list(walker.section), "strides": strides},
    )


def persist(
    walker: Walker,
    x: Float[np.ndarray, "n section"],
    limit: int,
    tolerance: Real | None,
    progress: str | None = None,
) -> tuple[Float[np.ndarray, "n section"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Where walkers are after `limit` strides, the outcome of their last, and how many they made.

    Those that fall are left behind every `ROUND` strides. The walker's parameters may be arrays.
    """
    x, walkers = x.copy(), stacked(walker, len(x), x.dtype)
    fate, count = np.zeros(len(x), np.int8), np.zeros(len(x), np.int32)
    tolerance = default_tolerance(x.dtype, tolerance)
    left = np.arange(len(x))
    for done in range(0, limit, ROUND):
        more = min(ROUND, limit - done)
        shared = jnp.asarray(tolerance, x.dtype), np.int32(more)
        cells = some(walkers, left), x[left]
        label = progress and f"{progress}: stride {done}, {len(left)} walkers"
        x[left], fate[left], made = over_cells(
            persist_cell, shared, cells, progress=label, tile=TILE
        )
        count[left] += made
        left = left[fate[left] == Outcome.STRIDE]
        if len(left) == 0:
            break
    return x, fate, count


def persist_cell(shared, cell):
    """State after a number of strides, outcome of the last and how many of them were made."""
    tolerance, limit = shared
    walker, x = cell

    def going(carry):
        _, outcome, count = carry
        return (outcome == Outcome.STRIDE) & (count < limit)

    def advance(carry):
        x, _, count = carry
        result = follow_stride(walker, x, tolerance)
        made = result.outcome == Outcome.STRIDE
        return jnp.where(made, result.state, x), result.outcome, count + made.astype(count.dtype)

    outcome = jnp.asarray(Outcome.STRIDE, jnp.int8)
    return lax.while_loop(going, advance, (x, outcome, jnp.zeros((), jnp.int32)))


class Loss(NamedTuple):
    """Between which two values of a parameter walkers stop walking on."""

    below: float
    """The highest value tried at which one walked to the end; NaN where none did at any."""
    above: float
    """The next value tried, at which all fell; NaN where one walks on at the interval's end."""
    strides: int
    """That a walker had to make."""


def loss_of_walking(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    branches: Sequence[Branch],
    *,
    strides: int = 5000,
    resolution: float = 1e-5,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Loss:
    """The value of a parameter above which no attractor is left.

    At each of a row of values walkers start close to the gaits of the branches there, stable or
    not: an attractor without a period has unstable gaits all through it. The interval between the
    highest value at which one still walks after `strides` strides and the next is divided again,
    until it is no wider than `resolution`. An attractor that exists between two values of a row
    only, such as a gait that doubles to chaos soon after a fold, is missed; the branches show it.

    **Returns** a `Loss`. As `attractors` otherwise.
    """
    below, above = interval
    while True:
        parts = min(PARTS, int(np.ceil((above - below) / resolution)) + 1)
        values = np.linspace(below, above, parts + 1)
        starts = starts_near(branches, values, len(walker.section))
        keep = np.isfinite(starts).all(axis=2)
        where = np.nonzero(keep)[0]
        walks = np.zeros(len(values), bool)
        if len(where):
            walkers = with_parameter(walker, parameter, values[where])
            _, fate, _ = persist(walkers, starts[keep], strides, tolerance, progress)
            walks[where[fate == Outcome.STRIDE]] = True
        if not walks.any():
            return Loss(np.nan, below, strides)
        last = int(np.flatnonzero(walks)[-1])
        if last == len(values) - 1:
            return Loss(above, np.nan, strides)
        below, above = float(values[last]), float(values[last + 1])
        if above - below <= resolution:
            return Loss(below, above, strides)


def starts_near(
    branches: Sequence[Branch], values: Float[np.ndarray, " values"], size: int
) -> Float[np.ndarray, "values starts section"]:
    """Starts on both sides of the gaits of branches, for each value; NaN to make up their number."""
    rows = []
    for value in values:
        gaits = [cycle[0] for branch in branches for cycle in crossings(branch, value)]
        moves = np.array([[OFFSET], [-OFFSET]]) * np.eye(1, size)
        rows.append([state + move for state in gaits for move in moves])
    starts = np.full((len(values), max(map(len, rows), default=0), size), np.nan)
    for i, row in enumerate(rows):
        if row:
            starts[i, : len(row)] = row
    return starts


# The whole story of a parameter.


def bifurcation_diagram(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    *,
    period_max: int = 8,
    strides: int = 5000,
    scan: int = 300,
    tolerance: Real | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Every gait over a range of a parameter, how each is born and lost, and what walkers come to.

    Gaits are searched at `SAMPLES` values in the range, from the walker's `gait_region`, for all
    periods up to `period_max` or `SEARCHED`. Their branches are followed, and those that leave them
    at period doublings, up to `period_max`. Then walkers start close to the gaits at `scan` values,
    and at more where walking is lost. A branch that is shorter than the samples are apart may be
    missed, and so may a gait that no search comes to.

    **Arguments:**

    - `walker`: gives the values of its other parameters.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of it.
    - `period_max`: longest period of the branches.
    - `strides`: that a walker makes before it counts as walking for ever.
    - `scan`: number of values at which the attractors are recorded, and once more that many
      between the first doubling of the cascade and the loss of walking.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show progress on a terminal.

    **Returns** a data set of

    - `gait`, the points of all branches, one branch after the other: `branch` (a number), `period`,
      `value` of the parameter, `states`, `step_times`, `multipliers` (real and imaginary part),
      `stable`, and whether it is `on_cascade`; NaN after the period;
    - `event`, the bifurcations: `event_fold` (a fold, or a doubling), `event_branch`,
      `event_period`, `event_value`, `event_states`, `event_multipliers`, and whether it belongs to
      the `cascade`: the doublings of the most stable period-one gait (the simplest walker's long
      one), and of the gaits that stem from it;
    - `sample`, the values of the scan: `sample_value`, and what `attractors` gives: `fate`,
      `strides`, `orbit` and `attractor_period`, each over `start` too;
    - `lost`: the values between which walking is lost, as `Loss`.

    `ValueError` for a wrong parameter, range or number.
    """
    check_parameter(walker, parameter)
    tolerance = double_tolerance(tolerance)
    low, high = map(float, interval)
    if not low < high:
        raise ValueError(f"interval must be (low, high) with low below high, not ({low}, {high})")
    for name, number in {"period_max": period_max, "strides": strides, "scan": scan}.items():
        if operator.index(number) < 1:
            raise ValueError(f"{name} must be at least 1, not {number}")
    branches: list[Branch] = []
    stems: list[int] = []

    def follow_all(starts: list[Start], stem: int) -> None:
        """Add the branches of starts to the known ones, each once."""
        for start, branch in zip(
            starts,
            continue_gaits(walker, parameter, (low, high), starts, tolerance=tolerance),
            strict=True,
        ):
            own = start.direction is not None or unknown(
                walker, parameter, branches, [start], tolerance
            )
            if len(branch.values) > 1 and own:
                branches.append(branch)
                stems.append(stem)

    for period in range(1, period_max + 1):
        for i, branch in enumerate(list(branches)):
            if 2 * branch.period == period:
                follow_all([doubled(doubling) for doubling in branch.doublings], i)
        if period > SEARCHED:
            continue
        for starts in gaits_at(
            walker, parameter, np.linspace(low, high, SAMPLES), period, tolerance
        ):
            follow_all(unknown(walker, parameter, branches, starts, tolerance), -1)

    members = family(branches, stems)
    options: Any = dict(tolerance=tolerance, progress="walkers" if progress else None)
    loss = loss_of_walking(walker, parameter, (low, high), branches, strides=strides, **options)
    values = np.linspace(low, high, scan)
    doublings = [b.value for i in members for b in branches[i].doublings]
    if doublings and min(doublings) < loss.above:
        values = np.union1d(values, np.linspace(min(doublings), loss.above, scan))
    starts = starts_near(branches, values, len(walker.section))
    scanned = attractors(walker, parameter, values, starts, **options)
    return diagram(walker, parameter, branches, members, scanned, loss)


def family(branches: list[Branch], stems: list[int]) -> list[int]:
    """Numbers of the most stable period-one branch, of those that stem from it, and so on."""
    singles = [i for i, branch in enumerate(branches) if branch.period == 1]
    members = sorted(singles, key=lambda i: np.abs(branches[i].multipliers[:, 0]).min())[:1]
    for i, stem in enumerate(stems):
        if stem in members:
            members.append(i)
    return members


def gaits_at(
    walker: Walker,
    parameter: str,
    values: Float[np.ndarray, " values"],
    period: int,
    tolerance: Real,
) -> list[list[Start]]:
    """The gaits of a period that searches from some cells find, for each of many values."""
    points = []
    for value in values:
        grid = with_parameter(walker, parameter, value).gait_region()
        cells = np.arange(0, grid.size, SPARSE, dtype=np.int32)
        points.append(np.asarray(jax.vmap(grid.centre)(cells)))
    walkers = with_parameter(walker, parameter, np.repeat(values, [len(p) for p in points]))
    left, cycles = walked(walkers, np.concatenate(points), period, tolerance)
    walkers = some(walkers, left)
    found = search(walkers, cycles, tolerance)
    at = getattr(walkers, parameter)
    starts = []
    for value in values:
        gaits = distinct(Gait(*(field[at == value] for field in found)))
        starts.append([Start(float(value), states) for states in gaits.states])
    return starts


def unknown(
    walker: Walker,
    parameter: str,
    branches: Sequence[Branch],
    starts: Sequence[Start],
    tolerance: Real | None,
) -> list[Start]:
    """Those of many starts that are on none of the branches."""
    left = []
    for start in starts:
        period = len(start.states)
        guesses = [
            cycle
            for branch in branches
            if branch.period == period
            for cycle in crossings(branch, start.value)
        ]
        tasks = [settle(start.value, cycle, None, 1.0) for cycle in guesses]
        points = [point for point in together(walker, parameter, tasks, tolerance) if point]
        turned = [np.roll(start.states, shift, axis=0) for shift in range(period)]
        if all(np.abs(p.cycle - states).max() > SAME for p in points for states in turned):
            left.append(start)
    return left


def diagram(
    walker: Walker,
    parameter: str,
    branches: list[Branch],
    members: list[int],
    scanned: xr.Dataset,
    loss: Loss,
) -> xr.Dataset:
    """The data set that `bifurcation_diagram` returns."""
    size = len(walker.section)
    phases = max((branch.period for branch in branches), default=1)

    def padded(arrays: list[np.ndarray], *shape: int) -> np.ndarray:
        """Arrays over (points, period, ...) below each other, NaN after each period."""
        full = [np.full((len(a), phases, *shape), np.nan) for a in arrays]
        for whole, a in zip(full, arrays, strict=True):
            whole[:, : a.shape[1]] = a
        return np.concatenate([np.zeros((0, phases, *shape)), *full])

    def flat(arrays: list[Any], dtype=float) -> np.ndarray:
        return np.concatenate([np.zeros(0, dtype), *arrays]).astype(dtype)

    def parts(multipliers: list[np.ndarray]) -> np.ndarray:
        whole = np.concatenate([np.zeros((0, size), complex), *multipliers])
        return np.stack([np.real(whole), np.imag(whole)], axis=-1)

    counts = [len(branch.values) for branch in branches]
    events = [(i, b) for i, one in enumerate(branches) for b in (*one.folds, *one.doublings)]
    numbers = np.arange(len(branches))
    return xr.Dataset(
        {
            "branch": ("gait", np.repeat(numbers, counts)),
            "period": ("gait", np.repeat([b.period for b in branches], counts).astype(int)),
            "value": ("gait", flat([b.values for b in branches])),
            "states": (("gait", "phase", "coordinate"), padded([b.states for b in branches], size)),
            "step_times": (("gait", "phase"), padded([b.step_times for b in branches])),
            "multipliers": (
                ("gait", "order", "part"),
                parts([b.multipliers for b in branches]),
            ),
            "stable": ("gait", flat([b.stable for b in branches], bool)),
            "on_cascade": ("gait", np.repeat(np.isin(numbers, members), counts)),
            "event_fold": ("event", np.array([b.kind == "fold" for _, b in events], bool)),
            "event_branch": ("event", np.array([i for i, _ in events], int)),
            "event_period": ("event", np.array([len(b.states) for _, b in events], int)),
            "event_value": ("event", np.array([b.value for _, b in events], float)),
            "event_states": (
                ("event", "phase", "coordinate"),
                padded([b.states[None] for _, b in events], size),
            ),
            "event_multipliers": (
                ("event", "order", "part"),
                parts([b.multipliers[None] for _, b in events]),
            ),
            "cascade": ("event", np.array([i in members for i, _ in events], bool)),
            "sample_value": ("sample", scanned["value"].values),
            "fate": (("sample", "start"), scanned["fate"].values),
            "strides": (("sample", "start"), scanned["strides"].values),
            "attractor_period": (("sample", "start"), scanned["period"].values),
            "orbit": (("sample", "start", "recent", "coordinate"), scanned["orbit"].values),
            "lost": ("side", np.array([loss.below, loss.above])),
        },
        attrs={
            "section": list(walker.section),
            "walker": type(walker).__name__,
            **{f"walker_{k}": float(v) for k, v in vars(walker).items() if k != parameter},
            "parameter": parameter,
            "lost_strides": loss.strides,
            "scan_strides": scanned.attrs["strides"],
            "version": f"walker-jax {version('walker-jax')}",
        },
    )
