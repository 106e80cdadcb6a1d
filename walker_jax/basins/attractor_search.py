"""The search for attractors: cycles of strides, and sets that never repeat."""

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import CLOSE, Attractor, near, nearest, until_near
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import gait_at
from walker_jax.gaits.search import search, walked
from walker_jax.grids import Grid
from walker_jax.walkers.model import Walker
from walker_jax.walking.iteration import strides
from walker_jax.walking.outcomes import Outcome

SAMPLE = 2**14
"""Starts that are followed in search of attractors."""
LONGEST_PERIOD = 64
"""Strides in the longest cycle that is recognised as one."""
PATIENCE = 8
"""Times `LONGEST_PERIOD`: strides in which a walker is to settle into a cycle."""
ATTEMPTS = 8
"""Walkers that have not, for which a cycle is solved for."""
CUBES = 1e-5 * 1.5 ** np.arange(20)
"""Half edges of boxes about a cycle's states that are tried, for one from which walkers come."""
STRETCHES = 1.5 ** np.arange(12)
"""How many times as long they are made in one direction."""
AROUND = 1000
"""Starts in a box."""
TURNS = 8
"""Periods after which walkers are left in the directions in which they come last."""


def sample(x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "m section"]:
    """Some of many points, evenly spread over their order."""
    return x[spread(len(x))]


def spread(n: int) -> Int[np.ndarray, " m"]:
    """Places of a sample of n things, evenly spread over their order."""
    return np.linspace(0, n - 1, min(n, SAMPLE)).astype(int)


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
        found = until_near(walker, starts, attractors, tolerance, limit)
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


def centres(grid: Grid, cells: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n section"]:
    """Centres of cells, given by their indices."""
    return map_cells(Grid.centre, (grid, cells))
