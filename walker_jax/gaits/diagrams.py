"""Bifurcation diagrams: all gaits over a parameter of the walker, and what walkers come to.

Gaits are searched for at some values of the parameter and followed from there (`branches`), which
shows how each is born, loses its stability and ends. What walkers come to, gaits or motions that
never repeat themselves, is seen by following walkers that start close to the gaits, stable or not.
"""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.checks import check_whole, refuses_tracers
from walker_jax.gaits.arclength import corrected
from walker_jax.gaits.branches import (
    Branch,
    check_interval,
    continue_gaits,
    crossings,
    double_tolerance,
)
from walker_jax.gaits.continuation import Start, doubled
from walker_jax.gaits.crises import Loss, loss_of_walking
from walker_jax.gaits.cycles import Gait, distinct
from walker_jax.gaits.long_runs import SAME, attractors, starts_near_gaits
from walker_jax.gaits.requests import together
from walker_jax.gaits.search import cycle_guesses, search
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.iteration import select_walkers

NO_START = -1
"""Fate where there are fewer starts than at other values."""
SEARCHED = 6
"""Longest period of which gaits are searched that no doubling leads to."""
SAMPLES = 16
"""Values of the parameter at which gaits are searched."""
SPARSE = 32
"""One in how many cells of a gait region gaits are searched from there."""


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
    starts = starts_near_gaits(walker, parameter, branches, values, tolerance)
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
    left, cycles = cycle_guesses(walkers, np.concatenate(points), period, tolerance)
    walkers = select_walkers(walkers, left)
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
