"""The basin of attraction: the fate of every start in a region of the Poincaré section.

Two methods. Cell mapping (Hsu 1987; Schwab and Wisse 2001, section 4.3) makes one stride from the
centre of every cell, sends each cell to the cell where that ends, and follows the cells. Direct
iteration follows every centre itself, stride by stride. Direct iteration is exact up to its number
of strides; cell mapping costs one stride a cell, and its errors are of the size of a cell.
"""

import itertools
import os
from importlib.metadata import version
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from walker_jax.cells import Grid, cell_image, resolve
from walker_jax.checks import check_kind, check_whole
from walker_jax.gaits import gait_at, search, walked
from walker_jax.integrate import Real, default_tolerance
from walker_jax.stride import Outcome, stride, strides
from walker_jax.tiles import order_of_cells, over_cells
from walker_jax.walkers import Walker

METHODS = ("cell-map", "direct")
SAMPLE = 2**14
"""Starts that are followed in search of attractors."""
BYTES_PER_CELL = 100
"""Memory at its peak, for each cell of a grid."""
LONGEST_PERIOD = 64
"""Strides in the longest cycle that is recognised as one."""
PATIENCE = 8
"""Times `LONGEST_PERIOD`: strides in which a walker is to settle into a cycle."""
CLOSE = 0.01
"""Distance from a cycle at which a walker counts as its, that is left when all others are there."""
ATTEMPTS = 8
"""Walkers that have not, for which a cycle is solved for."""
ORBIT = 3000
"""Strides of a motion that does not repeat itself that are compared with cells."""
CUBES = 1e-5 * 1.5 ** np.arange(20)
"""Half edges of boxes about a cycle's states that are tried, for one from which walkers come."""
STRETCHES = 1.5 ** np.arange(12)
"""How many times as long they are made in one direction."""
AROUND = 1000
"""Starts in a box."""
TURNS = 8
"""Periods after which walkers are left in the directions in which they come last."""


def basin(
    walker: Walker,
    grid: Grid,
    method: str = "cell-map",
    *,
    strides: int = 200,
    tolerance: float | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Fate of every cell of a grid on the walker's section.

    **Arguments:**

    - `walker`: its parameters are used in float64 if JAX has that turned on.
    - `grid`: its state coordinates are those of the section. It may be a slice.
    - `method`: "cell-map" or "direct"; for a slice, "direct" only.
    - `strides`: how many of them direct iteration follows a walker for.
    - `tolerance`: of the integration, as in `stride`.
    - `progress`: whether to show a progress bar on a terminal.

    **Returns** a data set over the grid's axes:

    - `fate`: `Outcome` of the stride at which the walker fails; `STRIDE` where it walks for ever
      (cell mapping) or to the last stride (direct);
    - `attractor`: number of the attractor it comes to, -1 for none;
    - `strides`: strides completed before that, or before the failure;

    and over the attractors, numbered by period, then by the angle of their first state (the one
    of the smallest angle): `period` (0 where the motion does not repeat itself), `states` (NaN
    after the period), and of the basin within the grid `cells` and `area` (rad^2 per unit of
    time; over three dimensions it is a volume). Its attributes say what was computed.

    Raises `ValueError` for an unknown method, and for a grid that does not fit the section or
    that this machine has not the memory for.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    check_whole("strides", strides)
    check_grid(walker, grid, method)
    tolerance = float(default_tolerance(jnp.asarray(0.0).dtype, tolerance))
    if method == "cell-map":
        found = cell_mapping(walker, grid, tolerance, progress)
    else:
        found = direct_iteration(walker, grid, tolerance, strides, progress)
    limit = {"strides": strides} if method == "direct" else {}
    how = {"method": method, **limit, "tolerance": tolerance}
    return labelled(walker, grid, sort_attractors(found), how)


def check_grid(walker: Walker, grid: Grid, method: str, each: int = BYTES_PER_CELL) -> None:
    """Refuse a grid that is not of the walker's section, or too large for this machine's memory."""
    check_kind("walker", walker, Walker)
    check_kind("grid", grid, Grid)
    if grid.coordinates != len(walker.section):
        raise ValueError(
            f"grid must have the {len(walker.section)} dimensions of the section, "
            f"{', '.join(walker.section)}, not {', '.join((*grid.names, *grid.fixed))}"
        )
    if method == "cell-map" and len(grid.names) < grid.coordinates:
        raise ValueError(
            f"method must be direct for a slice, {' and '.join(grid.fixed)} fixed, which walkers "
            "leave, not 'cell-map'"
        )
    for place, name in enumerate((*grid.names, *grid.fixed)):
        wrong = name in walker.section and walker.section.index(name) != place
        if wrong or (name in grid.fixed and name not in walker.section):
            raise ValueError(
                f"grid must name coordinates in the order of the section, {walker.section}, "
                f"not {(*grid.names, *grid.fixed)}"
            )
    needed, memory = grid.size * each, memory_of_machine()
    if needed > memory:
        raise ValueError(
            f"grid of {grid.size} cells needs {needed / 2**30:.1f} GiB of memory, "
            f"and this machine has {memory / 2**30:.1f} GiB"
        )


def memory_of_machine() -> float:
    """Bytes of memory; without bound where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError):  # not a POSIX system
        return float("inf")


class Basins(NamedTuple):
    """What became of each of a grid's cells, in the order of their indices."""

    fate: Int[np.ndarray, " n"]
    attractor: Int[np.ndarray, " n"]
    strides: Int[np.ndarray, " n"]
    attractors: list["Attractor"]

    @property
    def made(self) -> int:
        """Strides that were made, the failing ones among them."""
        return int(self.strides.sum() + np.sum(self.fate != Outcome.STRIDE))


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    period: int | None
    """Strides in a cycle; none where the motion does not repeat itself."""
    states: Float[np.ndarray, "period section"]
    """The states of the cycle; otherwise, one state of the motion."""
    frames: Float[np.ndarray, "period section section"] | None = None
    """For each state, matrices that make displacements from it less than 1, in all coordinates,
    where a walker is taken to have arrived; none where that is `near`."""

    def boxes(self) -> Float[np.ndarray, "period section section"]:
        """The frames, also where there are none."""
        if self.frames is not None:
            return self.frames
        period, size = self.states.shape
        return np.tile(np.eye(size) / near(self.states.dtype), (period, 1, 1))


def cell_mapping(walker: Walker, grid: Grid, tolerance: float, progress: bool = False) -> Basins:
    """Simple cell mapping: one stride from the centre of each cell, then cells follow cells."""
    resolved = resolve(cell_map(walker, grid, tolerance, progress), sinks=len(Outcome))
    fate = np.maximum(np.asarray(resolved.sink), Outcome.STRIDE).astype(np.int8)
    lengths = [len(cycle) for cycle in resolved.attractors]
    cells = np.concatenate([np.zeros(0, np.int32), *resolved.attractors]).astype(np.int32)
    states = np.split(centres(grid, cells), np.cumsum(lengths)[:-1])
    attractors = [Attractor(*one) for one in zip(lengths, states, strict=False)]
    return Basins(fate, np.asarray(resolved.attractor), np.asarray(resolved.steps), attractors)


def compare_methods(
    walker: Walker, grid: Grid, *, strides: int = 200, tolerance: float | None = None
) -> xr.Dataset:
    """Cell mapping against direct iteration on one grid: where they differ, and what is made up.

    Arguments and errors are those of `basin`.

    **Returns** a data set over the grid's axes with `mapped` and `direct`, whether a cell walks for
    ever by either method; and over the attractors of cell mapping `cells`, `period`, and
    `artefact`: that no attractor of direct iteration has a state within a cell of one of theirs.
    `direct_attractors` is how many of those there are.
    """
    mapped = basin(walker, grid, strides=strides, tolerance=tolerance)
    direct = basin(walker, grid, "direct", strides=strides, tolerance=tolerance)
    cycles = zip(direct["states"].values, direct["period"].values, strict=True)
    real = [states[:n] if n else orbit(walker, states[:1]) for states, n in cycles]
    real = np.concatenate([np.zeros((0, grid.coordinates)), *real])
    own = mapped["states"].values[:, :, None] - real
    away = np.abs(own @ np.asarray(grid.unshear).T) / np.asarray(grid.spacing)
    near = (away.max(axis=3) <= 1).any(axis=(1, 2))
    walks = {"mapped": mapped["attractor"] >= 0, "direct": direct["attractor"] >= 0}
    found = mapped[["cells", "period"]].assign({"artefact": ("number", ~near), **walks})
    found["direct_attractors"] = direct.sizes["number"]
    return found.assign_attrs(mapped.attrs | {"method": "cell-map against direct"})


def orbit(walker: Walker, x: Float[np.ndarray, "1 section"]) -> Float[np.ndarray, "n section"]:
    """The states that follow on one, which is the first, for as long as the walker walks."""
    states = [x]
    for _ in range(ORBIT):
        x = np.asarray(strides(walker, x).state)
        if np.isnan(x).any():
            break
        states.append(x)
    return np.concatenate(states)


def cell_map(
    walker: Walker, grid: Grid, tolerance: float, progress: bool = False
) -> Int[np.ndarray, " n"]:
    """The cell, or the sink, to which a stride takes the centre of each cell."""
    order = order_of_cells(grid.shape)
    shared = walker, grid, tolerance
    image = np.empty_like(order)
    image[order] = over_cells(
        image_of_cell, shared, order, progress="strides" if progress else None
    )
    return image


def centres(grid: Grid, cells: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n section"]:
    """Centres of cells, given by their indices."""
    return over_cells(Grid.centre, grid, cells)


def image_of_cell(shared: tuple[Walker, Grid, Real], index: Int[Array, ""]) -> Int[Array, ""]:
    """The cell, or the sink, to which a stride takes the centre of a cell."""
    walker, grid, tolerance = shared
    result = stride(walker, grid.centre(index), tolerance=tolerance)
    return cell_image(grid, result.state, result.outcome, leave=Outcome.LEFT_GRID)


def direct_iteration(
    walker: Walker, grid: Grid, tolerance: float, limit: int, progress: bool = False
) -> Basins:
    """Follow every centre for a number of strides, until it fails or comes near an attractor.

    The attractors are those of a sample of the cells, and of cells that are left at the end. Close
    to a period doubling walkers are slow to come near: those left count where they are `CLOSE`.
    """
    order = order_of_cells(grid.shape)
    starts = centres(grid, order)
    attractors = settle(walker, sample(starts), tolerance, [])
    found = follow(walker, starts, attractors, tolerance, limit, progress)
    in_order = np.empty_like(order)
    in_order[order] = np.arange(grid.size, dtype=order.dtype)
    fate, attractor, count = (values[in_order] for values in found[:3])
    return Basins(fate, attractor, count, found.attractors)


def follow(
    walker: Walker,
    starts: Float[np.ndarray, "n section"],
    attractors: list[Attractor],
    tolerance: float,
    limit: int,
    progress: bool = False,
    *,
    explain: bool = True,
) -> Basins:
    """Follow every start for a number of strides, until it fails or comes near an attractor.

    The attractors are those given, and those to which starts come that are left at the end; but for
    `explain` these count as no attractor's.
    """
    fate = np.full(len(starts), Outcome.STRIDE, np.int8)
    attractor = np.full(len(starts), -1, np.int32)
    count = np.zeros(len(starts), np.int32)
    cells, x = np.arange(len(starts)), starts
    for k in range(limit + 1):
        reached = nearest(x, attractors)
        attractor[cells[reached >= 0]] = reached[reached >= 0]
        cells, x = cells[reached < 0], x[reached < 0]
        if k == limit or len(cells) == 0:
            break
        label = f"stride {k + 1}, {len(cells)} cells" if progress else None
        ends = strides(walker, x, tolerance=tolerance, progress=label)
        x, outcome = np.asarray(ends.state), np.asarray(ends.outcome)
        fate[cells] = outcome
        going = outcome == Outcome.STRIDE
        count[cells[going]] += 1
        cells, x = cells[going], x[going]

    if not explain:
        return Basins(fate, attractor, count, attractors)
    attractor[cells] = nearest(x, attractors, within=CLOSE)
    lost = attractor[cells] < 0
    cells, x = cells[lost], x[lost]
    if len(cells):
        attractors = settle(walker, sample(x), tolerance, attractors)
        attractor[cells] = nearest(x, attractors, within=CLOSE)
        for i, one in enumerate(attractors):
            if one.period is None:
                attractor[cells[attractor[cells] < 0]] = i
    return Basins(fate, attractor, count, attractors)


def sample(x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "m section"]:
    """Some of many points, evenly spread over their order."""
    return x[np.linspace(0, len(x) - 1, min(len(x), SAMPLE)).astype(int)]


def settle(
    walker: Walker,
    x: Float[np.ndarray, "n section"],
    tolerance: float,
    known: list[Attractor],
) -> list[Attractor]:
    """The known attractors, and those to which walkers come that start at x.

    They are followed until each has failed, or repeats itself to rounding. For those that do
    neither in some hundred strides, as close to a period doubling, a stable cycle is solved for.
    Where there is none they are on an attractor without a period; one is made for them all.
    """
    found, exact = list(known), 1e3 * np.finfo(x.dtype).eps
    period = np.ones(len(x), int)
    for _ in range(PATIENCE):
        orbit = [x]
        for _ in range(LONGEST_PERIOD):
            ends = strides(walker, orbit[-1], tolerance=tolerance)
            alive = np.asarray(ends.outcome) == Outcome.STRIDE
            orbit = [states[alive] for states in [*orbit, np.asarray(ends.state)]]
        x = orbit[-1]
        path = np.stack(orbit[::-1], axis=1)  # (walkers, strides back, coordinates)
        misses = np.abs(path[:, 1:] - path[:, :1]).max(axis=2)
        settled = (misses < exact).any(axis=1)
        for states, miss in zip(path[settled], misses[settled], strict=True):
            # a slow approach that alternates comes close to itself after two strides before one
            count = next(q for q in range(1, LONGEST_PERIOD + 1) if miss[q - 1] < near(x.dtype))
            add_cycle(found, states[:count][::-1])
        left = ~settled & (nearest(x, found) < 0)
        x, period = x[left], misses[left].argmin(axis=1) + 1
        if len(x) == 0:
            return found
    explained = False
    for start, count in zip(x[:ATTEMPTS], period[:ATTEMPTS], strict=True):
        _, cycles = walked(walker, start[None], int(count), tolerance)
        if len(cycles) == 0:
            continue
        gait = gait_at(search(walker, cycles, tolerance), 0)
        states = np.asarray(gait.states)
        stable = gait.residual < exact and np.abs(gait.multipliers[0]) < 1  # neither if NaN
        if stable and np.abs(states[0] - start).max() < CLOSE:
            misses = np.abs(np.roll(states, -1, axis=0) - states[0]).max(axis=1)
            count = next(q for q in range(1, count + 1) if misses[q - 1] < near(x.dtype))
            add_cycle(found, states[:count])
            explained = True
    if not explained and all(one.period for one in found):
        found.append(Attractor(None, x[:1]))
    return found


def add_cycle(found: list[Attractor], states: Float[np.ndarray, "period section"]) -> None:
    """Add a cycle, from its state of the smallest angle on, unless it is known."""
    states = np.roll(states, -int(states[:, 0].argmin()), axis=0)
    if nearest(states[:1], found)[0] < 0:
        found.append(Attractor(len(states), states))


def nearest(
    x: Float[np.ndarray, "n section"], attractors: list[Attractor], within: float | None = None
) -> Int[np.ndarray, " n"]:
    """Number of the cycle that each point is near to, -1 for none."""
    number = np.full(len(x), -1, np.int32)
    for i, attractor in enumerate(attractors):
        boxes = attractor.boxes() if within is None else np.eye(x.shape[1])[None] / within
        for state, frame in zip(attractor.states, itertools.cycle(boxes), strict=False):
            if attractor.period:
                number[np.abs((x - state) @ frame.T).max(axis=1) < 1] = i
    return number


def framed_attractors(
    walker: Walker, grid: Grid, tolerance: float, limit: int
) -> tuple[Float[np.ndarray, "n section"], list[Attractor]]:
    """The centres of a grid's cells, and the attractors of a sample of them, with their boxes."""
    starts = centres(grid, np.arange(grid.size, dtype=np.int32))
    attractors = settle(walker, sample(starts), tolerance, [])
    return starts, with_frames(walker, attractors, tolerance, limit)


def with_frames(
    walker: Walker, attractors: list[Attractor], tolerance: float, limit: int
) -> list[Attractor]:
    """The attractors, each with boxes about its states from which a sample of walkers came to it.

    Walkers need then be followed only until they are in one. The boxes lie along the directions in
    which walkers come last, and are half as large, as a sample may miss a few, as the largest from
    which all came: first cubes, then as long in each direction as may be.
    """
    rng = np.random.default_rng(0)
    return [
        framed(walker, attractors, i, tolerance, limit, rng) if one.period else one
        for i, one in enumerate(attractors)
    ]


def framed(
    walker: Walker,
    attractors: list[Attractor],
    number: int,
    tolerance: float,
    limit: int,
    rng: np.random.Generator,
) -> Attractor:
    """One attractor, a cycle, with its boxes, whose half edges are the rows of a matrix."""
    attractors = list(attractors)
    cycle = attractors[number].states
    period, size = cycle.shape
    u = rng.uniform(-1, 1, (period, AROUND, size))

    def largest(boxes: Float[np.ndarray, "tried period section section"]) -> int:
        """The last of growing boxes from which all walkers came; it frames the attractor."""
        starts = cycle[:, None] + u @ boxes
        starts = starts.reshape(-1, size)
        found = follow(walker, starts, attractors, tolerance, limit, explain=False)
        came = (found.attractor == number).reshape(len(boxes), -1).all(axis=1)
        best = int(np.logical_and.accumulate(came).sum()) - 1
        if best >= 0:
            frames = np.swapaxes(np.linalg.inv(boxes[best] / 2), 1, 2)
            attractors[number] = attractors[number]._replace(frames=frames)
        return best

    cubes = CUBES[:, None, None, None] * np.tile(np.eye(size), (period, 1, 1))
    best = largest(cubes)
    if best < 0:
        return attractors[number]
    x = (cycle[:, None] + u @ cubes[best]).reshape(-1, size)
    for _ in range(TURNS * period):
        x = np.asarray(strides(walker, x, tolerance=tolerance).state)
    axes = np.linalg.svd(x.reshape(u.shape) - cycle[:, None], full_matrices=False)[2]
    cubes = CUBES[:, None, None, None] * axes
    box = cubes[max(largest(cubes), 0)]
    for i in range(size):
        stretch = np.ones((len(STRETCHES), 1, size, 1))
        stretch[:, 0, i, 0] = STRETCHES
        box = (stretch * box)[max(largest(stretch * box), 0)]
    return attractors[number]


def near(dtype) -> float:
    """Distance, in every coordinate of the section, at which a walker has reached an attractor."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def sort_attractors(found: Basins) -> Basins:
    """The same, attractors numbered by period, then by angle; those without a period last."""
    key = [(one.period or np.inf, one.states[0, 0]) for one in found.attractors]
    order = sorted(range(len(key)), key=key.__getitem__)
    number = np.full(len(key) + 1, -1, np.int32)  # the last is that of no attractor
    number[order] = np.arange(len(key))
    attractors = [found.attractors[i] for i in order]
    return found._replace(attractor=number[found.attractor], attractors=attractors)


def labelled(walker: Walker, grid: Grid, found: Basins, how: dict) -> xr.Dataset:
    """The data set that `basin` returns; `how` it was made is among its attributes."""
    names = list(Outcome.__members__)
    cells = np.bincount(found.attractor[found.attractor >= 0], minlength=len(found.attractors))
    longest = max((len(one.states) for one in found.attractors), default=0)
    states = np.full((len(found.attractors), longest, len(walker.section)), np.nan)
    for one, row in zip(found.attractors, states, strict=True):
        row[: len(one.states)] = one.states

    def over_grid(values, **attributes):
        return grid.names, np.asarray(values).reshape(grid.shape), attributes

    data = xr.Dataset(
        {
            "fate": over_grid(
                found.fate, flag_values=list(range(len(names))), flag_meanings=" ".join(names)
            ),
            "attractor": over_grid(found.attractor, description="-1 for none"),
            "strides": over_grid(found.strides, description="before the attractor or the failure"),
            "period": ("number", np.array([one.period or 0 for one in found.attractors], np.int32)),
            "states": (("number", "phase", "coordinate"), states),
            "cells": ("number", cells),
            "area": ("number", cells * grid.cell_area),
        },
        coords={
            **grid.axes,
            **grid.held,
            "number": np.arange(len(found.attractors)),
        },
    )
    return data.assign_attrs(
        {
            "walker": type(walker).__name__,
            **{f"walker_{name}": float(value) for name, value in vars(walker).items()},
            **how,
            "section": list(walker.section),
            "area": data["area"].values.tolist(),
            "version": f"walker-jax {version('walker-jax')}",
        }
    )


def around(state: Float[ArrayLike, " section"], names: tuple[str, ...]) -> dict:
    """Axes of a window around a gait's state; with phidot among them, of a slice there."""
    theta, thetadot, *others = map(float, np.asarray(state))
    middle = theta + thetadot if names[1] == "sum" else thetadot
    below, above = (0.5, 0.3) if "phidot" in names else (0.25, 0.1)
    return {
        "theta": (0.0, 2.5 * theta, 200),
        names[1]: (middle - below * theta, middle + above * theta, 250),
        **({"phidot": others[0]} if "phidot" in names else {}),
    }
