"""Bifurcation diagrams: all gaits over a parameter of the walker, and what walkers come to.

Gaits are searched for at some values of the parameter and followed from there (`branches`), which
shows how each is born, loses its stability and ends. What walkers come to, gaits or motions that
never repeat themselves, is seen by following walkers that start close to the gaits, stable or not.
"""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.branches import (
    Branch,
    Start,
    check_interval,
    continue_gaits,
    corrected,
    crossings,
    double_tolerance,
    doubled,
    together,
)
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    check_whole,
    numbers,
    refuses_tracers,
)
from walker_jax.gaits import (
    Gait,
    check_parameter,
    distinct,
    search,
    some,
    walked,
    with_parameter,
)
from walker_jax.integrate import Real
from walker_jax.stride import Outcome, follow_stride, stacked
from walker_jax.stride import strides as many_strides
from walker_jax.tiles import map_cells
from walker_jax.walkers import Walker

RECENT = 64
"""States of an orbit that are recorded, and the longest period that is recognised."""
ROUND = 64
"""Strides in a call, after which walkers that fell are left behind."""
NO_START = -1
"""Fate where there are fewer starts than at other values."""
PARTS = 32
"""In which an interval is divided, at once, in search of the loss of walking."""
BESIDE = 1e-6
"""Distance from a gait, in the first coordinate, at which walkers start.

Stable ones draw them in: their basins are no wider than this where they are born. From unstable
ones they leave for what attracts them.
"""
SAME = 1e-6
"""Distance, in every coordinate, at which an orbit has come back."""
SEARCHED = 6
"""Longest period of which gaits are searched that no doubling leads to."""
SAMPLES = 16
"""Values of the parameter at which gaits are searched."""
SPARSE = 32
"""One in how many cells of a gait region gaits are searched from there."""


@refuses_tracers()
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
    values, starts = numbers("values", values), numbers("starts", starts)
    if values.ndim != 1:
        raise WrongUse(f"values must be one row of numbers, not of shape {values.shape}")
    check_parameter(walker, parameter, *values)
    tolerance = double_tolerance(tolerance)
    if starts.ndim != 3 or starts.shape[::2] != (len(values), len(walker.section)):
        shape = f"({len(values)}, starts, {len(walker.section)})"
        raise WrongUse(f"starts must have shape {shape}, not {starts.shape}")
    check_whole("strides", strides)
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
    tolerance: Real,
    progress: str | None = None,
) -> tuple[Float[np.ndarray, "n section"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Where walkers are after `limit` strides, the outcome of their last, and how many they made.

    Those that fall are left behind every `ROUND` strides. The walker's parameters may be arrays.
    """
    x, walkers = x.copy(), stacked(walker, len(x), x.dtype)
    fate, count = np.zeros(len(x), np.int8), np.zeros(len(x), np.int32)
    left = np.arange(len(x))
    for done in range(0, limit, ROUND):
        more = min(ROUND, limit - done)
        shared = jnp.asarray(tolerance, x.dtype), np.int32(more)
        cells = some(walkers, left), x[left]
        label = progress and f"{progress}: stride {done}, {len(left)} walkers"
        x[left], fate[left], made = map_cells(persist_cell, (shared, cells), progress=label)
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


@refuses_tracers()
def loss_of_walking(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    branches: Sequence[Branch],
    *,
    strides: int = 3000,
    resolution: float = 1e-5,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Loss:
    """Where walking is lost: the value of a parameter above which walkers fall.

    At each of a row of values walkers start beside the gaits of the branches there, stable or not:
    an attractor without a period has unstable gaits all through it. The interval between the
    highest value at which one still walks after `strides` strides and the next is divided again,
    until it is no wider than `resolution`. What attracts walkers between two values of a row only
    is missed, such as a gait that doubles to chaos soon after the fold it was born in: beyond the
    loss of the main attractor there may be such gaits, and the branches show them.

    **Returns** a `Loss`. As `attractors` otherwise.
    """
    tolerance = double_tolerance(tolerance)
    below, above = check_interval(walker, parameter, interval)
    check_whole("strides", strides)
    check_kind("branches", branches, Sequence)
    for branch in branches:
        check_kind("branches", branch, Branch)
    check_number("resolution", resolution)
    if not resolution > np.spacing(above):
        raise WrongUse(f"resolution must be a distance, and wider than rounding, not {resolution}")
    while True:
        parts = min(PARTS, int(np.ceil((above - below) / resolution)) + 1)
        values = np.linspace(below, above, parts + 1)
        starts = starts_near(walker, parameter, branches, values, tolerance)
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
    walker: Walker,
    parameter: str,
    branches: Sequence[Branch],
    values: Float[np.ndarray, " values"],
    tolerance: Real,
) -> Float[np.ndarray, "values starts section"]:
    """Starts beside the gaits of branches, for each value; NaN to make up their number."""
    guesses = [
        (i, cycle)
        for i, value in enumerate(values)
        for branch in branches
        for cycle in crossings(branch, value)
    ]
    tasks = [corrected(float(values[i]), cycle, None, 1.0) for i, cycle in guesses]
    rows: list[list[np.ndarray]] = [[] for _ in values]
    for (i, _), point in zip(guesses, together(walker, parameter, tasks, tolerance), strict=True):
        if point is not None:
            rows[i].append(point.cycle[0] + BESIDE * np.eye(1, point.cycle.shape[1])[0])
    starts = np.full((len(values), max(map(len, rows)), len(walker.section)), np.nan)
    for i, row in enumerate(rows):
        if row:
            starts[i, : len(row)] = row
    return starts


@refuses_tracers()
def bifurcation_diagram(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    *,
    period_max: int = 8,
    strides: int = 3000,
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
      `strides`, `orbit` and `attractor_period`, each over `start` too; a fate of -1 fills up the
      starts, one beside each gait;
    - `lost`: the values between which walking is lost, as `Loss`.

    `ValueError` for a wrong parameter, range or number.
    """
    tolerance = double_tolerance(tolerance)
    low, high = check_interval(walker, parameter, interval)
    for name, number in {"period_max": period_max, "strides": strides, "scan": scan}.items():
        check_whole(name, number)
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

    for i, branch in enumerate(branches):
        if stems[i] < 0 and branch.period in (2, 4, 8, 16, 32, 64):
            stems[i] = stem_outside(walker, parameter, branches, i, (low, high), tolerance)
    members = family(branches, stems)
    options: Any = dict(tolerance=tolerance, progress="walkers" if progress else None)
    loss = loss_of_walking(walker, parameter, (low, high), branches, strides=strides, **options)
    values = np.linspace(low, high, scan)
    doublings = [b.value for i in members for b in branches[i].doublings]
    if doublings and min(doublings) < loss.above:
        values = np.union1d(values, np.linspace(min(doublings), loss.above, scan))
    starts = starts_near(walker, parameter, branches, values, tolerance)
    scanned = attractors(walker, parameter, values, starts, strides=strides, **options)
    scanned["fate"] = scanned["fate"].where(np.isfinite(starts).all(axis=2), NO_START)
    return diagram(walker, parameter, branches, members, scanned, loss)


def stem_outside(
    walker: Walker,
    parameter: str,
    branches: list[Branch],
    number: int,
    interval: tuple[float, float],
    tolerance: Real,
) -> int:
    """The branch that a branch doubles at a value below the interval, or -1.

    It is followed down to its doubling, and the gait of half the period back up into the interval.
    """
    branch, (low, high) = branches[number], interval
    wider = (low / 2 if low > 0 else 2 * low - high, high)
    lowest = int(branch.values.argmin())
    start = Start(float(branch.values[lowest]), branch.states[lowest])
    (down,) = continue_gaits(walker, parameter, wider, [start], tolerance=tolerance)
    half = branch.period // 2
    for end, reason in ((0, down.ends[0]), (-1, down.ends[1])):
        if reason.startswith("the gait of period"):
            states = (down.states[end][:half] + down.states[end][half:]) / 2
            stem = Start(float(down.values[end]), states)
            (up,) = continue_gaits(walker, parameter, wider, [stem], tolerance=tolerance)
            inside = np.flatnonzero((up.values >= low) & (up.values <= high))
            for i, other in enumerate(branches):
                if other.period == half and len(inside):
                    point = Start(float(up.values[inside[0]]), up.states[inside[0]])
                    if not unknown(walker, parameter, [other], [point], tolerance):
                        return i
    return -1


def family(branches: list[Branch], stems: list[int]) -> list[int]:
    """Numbers of the most stable period-one branch, of those that stem from it, and so on."""
    singles = [i for i, branch in enumerate(branches) if branch.period == 1]
    members = sorted(singles, key=lambda i: np.abs(branches[i].multipliers[:, 0]).min())[:1]
    for member in members:
        members += [i for i, stem in enumerate(stems) if stem == member]
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
        points.append(grid.centres(np.arange(0, grid.size, SPARSE)))
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
        tasks = [corrected(start.value, cycle, None, 1.0) for cycle in guesses]
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
