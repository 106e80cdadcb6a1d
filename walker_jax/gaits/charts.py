"""Charts of two parameters: curves of bifurcations, and the periods of attractors between them.

Continuation follows the gait of period one along each parameter, from the system's own values, and
the gaits that double from it. The bifurcations on these lines are the starts of the curves. Behind
the curves, a grid of parameter values shows the attractors of walkers that start near the gait.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.checks import WrongUse, check_memory, check_whole, refuses_tracers, short
from walker_jax.execution.progress import bar
from walker_jax.gaits.branches import Branch, continue_gaits, float64_tolerance
from walker_jax.gaits.codimension_two import SPECIAL
from walker_jax.gaits.continuation import Start, start_at_doubling
from walker_jax.gaits.cycles import Gait, check_found, iterate_newton
from walker_jax.gaits.defining_systems import KINDS
from walker_jax.gaits.diagrams import pad, real_and_imaginary
from walker_jax.gaits.event_curves import EventCurve, check_bounds, continue_events
from walker_jax.gaits.event_paths import Ranges
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.long_runs import START_OFFSET, settle
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import Turns, difference, turn_to, turns_of
from walker_jax.systems.outcomes import Outcome, join_names, names_in
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walkers.parameters import describe_source, value_of
from walker_jax.walking.iteration import with_parameters
from walker_jax.walking.stride import stride

BYTES_PER_CELL = 100
"""Peak memory in bytes for each cell, from which a walker is followed."""
SAME_GAIT = 1e-6
"""Largest error of a gait after one stride, in each coordinate."""
NO_GAIT = -1
"""Fate of cells in which no gait is found, so that no walker can start near it."""
SAME_CURVE = 0.01
"""Scaled distance within which a bifurcation is on a curve of its kind. A chord of the longest step
is nearer to its curve. Two curves of a kind are taken to be farther apart."""
NEWTON_STEPS = 8
"""Newton steps from each guess. A guess that needs more has failed."""
MOST_TRIES = 4
"""Most guesses for a cell. After a failure another neighbour may give a better guess."""
NEAR = 0.5
"""Largest distance of a gait from its guess in each coordinate, as a share of the range of that
coordinate over the branches. A gait farther off is another one."""


class Found(NamedTuple):
    """A bifurcation at values of both parameters."""

    values: Float[np.ndarray, " 2"]
    event: Bifurcation


@refuses_tracers()
def chart(
    system: System,
    bounds: Mapping[str, Any],
    gait: Gait | None = None,
    *,
    period_max: int = 4,
    cells: tuple[int, int] = (120, 90),
    strides: int = 1000,
    tolerance: Real | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Chart two parameters: where a gait is stable, its bifurcations, and the attractors.

    ```python
    walker = wj.SpringWalker(slope=0.012, hip_stiffness=0.2)
    bounds = {"slope": (0.01, 0.04), "hip_stiffness": (0.1, 0.4)}
    data = wj.chart(walker, bounds, period_max=1, cells=(12, 9), strides=200)
    figures.chart(data)
    ```

    The gait, and the gaits that double from it, are followed along each parameter, while the other
    one keeps the system's own value. The bifurcations found there are the starts of curves. The
    chart misses a curve that crosses neither line, and gaits that do not descend from this one.

    **Arguments:**

    - `system`: the search begins at its own values of the two parameters.
    - `bounds`: lowest and highest value of each of two parameters, by name.
    - `gait`: a gait of this system, of period one; by default, the one of `find_gait`.
    - `period_max`: longest period of the gaits whose bifurcations are followed.
    - `cells`: number of cells of the grid along each parameter.
    - `strides`: number of strides before the period of a walk is read.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** a data set over these dimensions:

    - `point`, the points of all curves, one curve after the other: `curve` (a number),
      `curve_value`, `curve_states`, `curve_multipliers` and `curve_coefficient` of the normal form;
    - `line`, the curves: `line_kind`, `line_period`, and `line_end`, the reasons why each ends.
      Kinds and reasons are indices into the attributes `line_kinds` and `line_ends`;
    - `special`, the points of codimension two: `special_kind`, an index into the attribute
      `special_kinds`, `special_curve`, `special_value`, `special_states` and
      `special_multipliers`;
    - `first` and `second`, the parameters at the centres of the cells: `cell_period`, the period
      of the attractor that walkers near the gait reach, 0 where it has none; and `cell_fate`, the
      `Outcome` of the last stride, `UNDECIDED` where there is no answer, -1 where there is no gait.

    Raises `ValueError` for wrong parameters, bounds or numbers, for a gait that is not one of this
    system, and for a system whose own values are outside the bounds.
    """
    names, ranges = check_bounds(system, [*bounds] if isinstance(bounds, Mapping) else (), bounds)
    check_whole("period_max", period_max, most=64)
    if not isinstance(cells, tuple | list) or len(cells) != 2:
        raise WrongUse(f"cells must be two numbers, not {short(cells)}")
    count = check_whole("cells", cells[0], 2) * check_whole("cells", cells[1], 2)
    check_memory(count * BYTES_PER_CELL, f"{count} cells need", "lower cells", of="cells")
    own = np.array([float(value_of(system, name)) for name in names])
    if not ranges.hold(own):
        told = " and ".join(f"{name} {value:g}" for name, value in zip(names, own, strict=True))
        raise WrongUse(f"bounds must hold the values of the system, {told}")
    tolerance = float64_tolerance(tolerance)
    gait = require_gait(system, ["gait"], tolerance=tolerance) if gait is None else gait
    check_found(gait)
    states = np.asarray(gait.states, float)
    if states.shape != (1, len(system.section)):
        raise WrongUse(
            f"gait must be one state on the section {', '.join(system.section)}, not of shape "
            f"{states.shape}",
            of="gait",
        )
    there = np.asarray(stride(system, states[0], tolerance=tolerance).state)
    if not np.abs(difference(there, states[0], turns_of(system))).max() < SAME_GAIT:
        raise WrongUse("gait must be one of this system: find_gait gives one", of="gait")
    with bar("gaits", progress):
        branches, events = follow_lines(system, names, own, ranges, gait, period_max, tolerance)
    with bar("curves", progress):
        curves = follow_curves(system, events, names, ranges, tolerance)
    with bar("attractors", progress):
        grid = attractors_on_grid(system, names, ranges, cells, branches, strides, tolerance)
    return assemble_chart(system, names, curves, grid)


def follow_lines(
    system: System,
    names: tuple[str, str],
    own: Float[np.ndarray, " 2"],
    ranges: Ranges,
    gait: Gait,
    period_max: int,
    tolerance: Real,
) -> tuple[list[Branch], list[Found]]:
    """Follow the gait over each parameter, and the gaits that double from it.

    Return the branches of period one, and the bifurcations on all branches.
    """
    branches, found = [], []
    for i, name in enumerate(names):
        interval = float(ranges.low[i]), float(ranges.high[i])
        starts = [Start(float(own[i]), np.asarray(gait.states, float))]
        while starts:
            followed = continue_gaits(system, name, interval, starts, tolerance=tolerance)
            starts = []
            for branch in followed:
                for event in branch.events:
                    values = own.copy()
                    values[i] = event.value
                    found.append(Found(values, event))
                if 2 * branch.period <= period_max:
                    starts += [start_at_doubling(one) for one in branch.doublings]
            branches += [branch for branch in followed if branch.period == 1]
    return branches, found


def follow_curves(
    system: System,
    events: list[Found],
    names: tuple[str, str],
    ranges: Ranges,
    tolerance: Real,
) -> list[EventCurve]:
    """Follow the curves through bifurcations, each curve once."""
    curves: list[EventCurve] = []
    turns = turns_of(system)
    is_new = lambda one: not any(lies_on(curve, one, ranges, turns) for curve in curves)
    while events := [one for one in events if is_new(one)]:
        first = {(one.event.kind, len(one.event.states)): one for one in reversed(events)}
        chosen = [*first.values()]
        found = continue_events(system, chosen, names, ranges, tolerance=tolerance)
        curves += [curve for curve in found if curve is not None]
        events = [one for one in events if not any(one is tried for tried in chosen)]
    return sorted(curves, key=lambda curve: curve.period)


def lies_on(curve: EventCurve, found: Found, ranges: Ranges, turns: Turns = None) -> bool:
    """Return whether a bifurcation is on a curve, whichever state of its cycle comes first."""
    kind, states = found.event.kind, np.asarray(found.event.states)
    if kind != curve.kind or len(states) != curve.period:
        return False
    flat = curve.states.reshape(len(curve.states), -1) / np.sqrt(curve.period)
    points = np.concatenate([curve.values / ranges.widths, flat], axis=1)
    values = np.broadcast_to(found.values / ranges.widths, curve.values.shape)
    step = np.diff(points, axis=0)
    for shift in range(curve.period):
        cycle = turn_to(np.roll(states, shift, axis=0), curve.states, turns)
        state = np.broadcast_to(cycle, curve.states.shape).reshape(flat.shape)
        state = state / np.sqrt(curve.period)
        target = np.concatenate([values, state], axis=1)
        offset = (target - points)[:-1]
        share = np.sum(offset * step, axis=1) / np.maximum(np.sum(step**2, axis=1), 1e-300)
        nearest = offset - np.clip(share, 0, 1)[:, None] * step
        distances = np.linalg.norm(nearest, axis=1), np.linalg.norm(target - points, axis=1)
        if min(one.min(initial=np.inf) for one in distances) < SAME_CURVE:
            return True
    return False


class Cells(NamedTuple):
    """Attractors on a grid of two parameters."""

    axes: tuple[Float[np.ndarray, " first"], Float[np.ndarray, " second"]]
    fate: Int[np.ndarray, "first second"]
    period: Int[np.ndarray, "first second"]


def attractors_on_grid(
    system: System,
    names: tuple[str, str],
    ranges: Ranges,
    cells: tuple[int, int],
    branches: list[Branch],
    strides: int,
    tolerance: Real,
) -> Cells:
    """Find the attractors of walkers that start near the gait in each cell, in one batch.

    A stable gait is the attractor itself, so no walk is computed in its cell.
    """
    axes = tuple(
        low + (np.arange(count) + 0.5) * (high - low) / count
        for low, high, count in zip(ranges.low, ranges.high, cells, strict=True)
    )
    values = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    integrator = Integrator(tolerance)
    systems = with_parameters(system, names, values)
    known = known_points(names, np.array([float(value_of(system, one)) for one in names]), branches)
    gaits, stable = spread_gaits(systems, values, known, cells, ranges, integrator)
    fate = np.where(np.isfinite(gaits[:, 0]), int(Outcome.STRIDE), NO_GAIT)
    period = np.where(stable, 1, 0)
    walking = np.flatnonzero(np.isfinite(gaits[:, 0]) & ~stable)
    if len(walking):
        starts = gaits[walking] + START_OFFSET * np.eye(1, gaits.shape[1])[0]
        found = settle(select(systems, walking), starts, strides, integrator)
        fate[walking], period[walking] = found.fate, found.period
    return Cells(axes, fate.reshape(cells), period.reshape(cells))


def known_points(
    names: tuple[str, str], own: Float[np.ndarray, " 2"], branches: list[Branch]
) -> Float[np.ndarray, "n columns"]:
    """Return rows of both parameters and the state of the gaits on branches, stable gaits last."""
    rows = []
    for branch in branches:
        values = np.tile(own, (len(branch.values), 1))
        values[:, names.index(branch.parameter)] = branch.values
        rows.append(np.column_stack([branch.stable, values, branch.states[:, 0]]))
    joined = np.concatenate(rows)
    return joined[np.argsort(joined[:, 0], kind="stable"), 1:]


def spread_gaits(
    systems: System,
    values: Float[np.ndarray, "n 2"],
    known: Float[np.ndarray, "m columns"],
    cells: tuple[int, int],
    ranges: Ranges,
    integrator: Integrator,
) -> tuple[Float[np.ndarray, "n section"], Bool[np.ndarray, " n"]]:
    """Find the gait in each cell, NaN where the search fails, and whether it is stable.

    The gait spreads from the branches: first to the cells that hold their points, then in rounds
    from each cell to its neighbours without a gait.
    """
    size = known.shape[1] - 2
    gaits, stable = np.full((len(values), size), np.nan), np.zeros(len(values), bool)
    place = (known[:, :2] - ranges.low) / ranges.widths * cells
    index = np.ravel_multi_index(np.clip(place.astype(int), 0, np.array(cells) - 1).T, cells)
    guesses = np.full((len(values), size), np.nan)
    guesses[index] = known[:, 2:]
    near = NEAR * np.maximum(np.ptp(known[:, 2:], axis=0), SAME_GAIT)
    tries, gap = np.zeros(len(values), int), np.full(len(values), True)
    while len(chosen := np.flatnonzero(np.isfinite(guesses[:, 0]) & gap & (tries < MOST_TRIES))):
        tries[chosen] += 1
        found = iterate_newton(
            select(systems, chosen), guesses[chosen][:, None], integrator, NEWTON_STEPS
        )
        moved = np.abs(difference(found.states[:, 0], guesses[chosen], turns_of(systems)))
        good = found.found & (moved < near).all(axis=1)
        gaits[chosen[good]], stable[chosen[good]] = found.states[good, 0], found.stable[good]
        gap = np.isnan(gaits[:, 0])
        straight = (tries % 2 == 0).reshape(*cells, 1)
        guesses = guess_from_neighbours(gaits.reshape(*cells, size), straight).reshape(-1, size)
    return gaits, stable


def guess_from_neighbours(
    gaits: Float[np.ndarray, "first second section"], straight: Bool[np.ndarray, "first second 1"]
) -> Float[np.ndarray, "first second section"]:
    """Guess the gait of each cell: a neighbour's; if `straight`, extrapolated from two in line."""
    guesses = np.full_like(gaits, np.nan)
    for axis in (0, 1):
        for shift in (1, -1):
            one, two = (shifted(gaits, shift * by, axis) for by in (1, 2))
            line = np.where(straight & np.isfinite(two), 2 * one - two, one)
            guesses = np.where(np.isfinite(guesses), guesses, line)
    return guesses


def shifted(values: np.ndarray, by: int, axis: int) -> np.ndarray:
    """Return values moved along an axis, with NaN in the places they leave."""
    moved = np.roll(values, by, axis)
    outside = np.arange(values.shape[axis])
    outside = outside < by if by > 0 else outside >= values.shape[axis] + by
    return np.where(np.expand_dims(outside, tuple({0, 1, 2} - {axis})), np.nan, moved)


def assemble_chart(
    system: System, names: tuple[str, str], curves: list[EventCurve], grid: Cells
) -> xr.Dataset:
    """Assemble the data set that `chart` returns."""
    counts, size = [len(curve.values) for curve in curves], len(system.section)
    phases = max((curve.period for curve in curves), default=1)
    special = [(i, one) for i, curve in enumerate(curves) for one in curve.special]
    reasons = sorted({end for one in curves for end in one.ends}) or [""]
    joined = lambda arrays, *shape: np.concatenate([np.zeros((0, *shape)), *arrays])
    return xr.Dataset(
        {
            "curve": ("point", np.repeat(np.arange(len(curves)), counts)),
            "curve_value": (("point", "parameter"), joined([one.values for one in curves], 2)),
            "curve_states": (
                ("point", "phase", "coordinate"),
                pad([one.states for one in curves], phases, size),
            ),
            "curve_multipliers": (
                ("point", "order", "part"),
                real_and_imaginary([one.multipliers for one in curves], size),
            ),
            "curve_coefficient": ("point", joined([one.coefficients for one in curves])),
            "line_kind": ("line", numbers_of([one.kind for one in curves], KINDS)),
            "line_period": ("line", np.array([one.period for one in curves], int)),
            "line_end": (
                ("line", "end"),
                numbers_of([end for one in curves for end in one.ends], reasons).reshape(-1, 2),
            ),
            "special_kind": ("special", numbers_of([one.kind for _, one in special], SPECIAL)),
            "special_curve": ("special", np.array([i for i, _ in special], int)),
            "special_value": (
                ("special", "parameter"),
                joined([one.values[None] for _, one in special], 2),
            ),
            "special_states": (
                ("special", "phase", "coordinate"),
                pad([one.states[None] for _, one in special], phases, size),
            ),
            "special_multipliers": (
                ("special", "order", "part"),
                real_and_imaginary([one.multipliers[None] for _, one in special], size),
            ),
            "cell_fate": (("first", "second"), grid.fate),
            "cell_period": (("first", "second"), grid.period),
        },
        coords={
            "parameter": np.array(names, object),
            "first": grid.axes[0],
            "second": grid.axes[1],
        },
        attrs={
            **describe_source(system, without=names),
            "line_kinds": join_names(KINDS),
            "line_ends": join_names(reasons),
            "special_kinds": join_names(SPECIAL),
        },
    )


def numbers_of(found: Sequence[str], names: Sequence[str]) -> Int[np.ndarray, " n"]:
    """Return the indices of the found names in a list of all names."""
    return np.array([names.index(one) for one in found], int)


def words_in(data: xr.Dataset, name: str) -> list[Any]:
    """Return the names for the indices in "line_kind", "line_end" or "special_kind"."""
    words = np.array(names_in(data, f"{name}s"), object)
    return words[data[name].values].tolist()
