"""The volume of a basin in more dimensions than a grid can hold, by nested sampling.

Most of a basin in many dimensions is far from its attractor, in arms that a ball around it misses,
and random starts in the region around it may hit none of it. So the volume grows from the attractor
outwards: with K_j the part of the basin within a distance r_j,

    V(K_m) = V(K_0) * product over j of V(K_j+1) / V(K_j)

The innermost ball is sampled at random. For each ratio, points uniform in K_j+1 are made from
those of K_j by hit-and-run, and counted within r_j. (Dyer, Frieze and Kannan 1991, J. ACM 38, 1, of
convex bodies; Martiniani and others 2016, Physical Review E 94, 031301, of basins.) Hit-and-run
moves a point along a random line to a random place of the basin on it (Smith 1984; with the
shrinking brackets of Neal 2003, Annals of Statistics 31, 705, section 4.1, it needs no step
length). Half of the lines join two points of another group: they lie along a long basin.
"""

from collections.abc import Callable
from math import lgamma
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.attractor_search import attracts
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.computation import check_grid
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_kind,
    check_precision,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.execution.progress import bar
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.sampling import draw_from_ball
from walker_jax.systems.system import System, check_single

GROUPS = 8
"""Groups of points that are independent but for the lines along which they move; their scatter
gives the error."""
FILLED = 0.5
"""Least share of the innermost ball that is in the basin."""
SMALLEST = 2.0**-40
"""Radius of the smallest ball that is tried, in lengths of the region."""
FEWEST = 8
"""Fewest points in a group."""

Inside = Callable[[Float[np.ndarray, "n d"]], Bool[np.ndarray, " n"]]


class BasinVolume(NamedTuple):
    """The volume of a basin within a region."""

    value: float
    """In the coordinates of the section."""
    error: float
    """Standard error."""
    share: float
    """Share of the region's volume."""
    radii: Float[np.ndarray, " balls"]
    """Radii of the balls around the attractor, in lengths of the region's axes."""
    within: Float[np.ndarray, " balls"]
    """Volume of the basin within each."""


@refuses_tracers()
def basin_volume(
    system: System,
    attractor: Attractor,
    region: Grid,
    *,
    samples: int = 1024,
    moves: int = 32,
    strides: int = 500,
    seed: int = 0,
    tolerance: float | None = None,
    progress: bool = True,
) -> BasinVolume:
    """Estimate the volume of an attractor's basin within a region, in any number of dimensions.

    It is the part of the basin that is connected to the attractor, or nearly: moves along a line
    cross gaps, but a part that hardly any line through the others meets is missed.

    ```python
    system = wj.Map(lambda x: x**3, ("a", "b", "c", "d"))  # attracts from (-1, 1) along each
    (origin,) = wj.find_attractors(system, [(0.1, 0.1, 0.1, 0.1)])
    region = wj.Grid.plain(a=(-2, 2, 1), b=(-2, 2, 1), c=(-2, 2, 1), d=(-2, 2, 1))
    found = wj.basin_volume(system, origin, region, samples=256)
    found.value, found.error  # 16 = 2^4
    ```

    **Arguments:**

    - `system`: one system, with numbers for parameters.
    - `attractor`: a cycle, of `find_attractors`; its first state is the middle of all balls.
    - `region`: a grid, in whose region the volume lies; its cells do not matter.
    - `samples`: number of points in each ball. The error falls with its root.
    - `moves`: moves of each point from one ball to the next. The error does not show that there
      were too few: half as many made a cube in 20 dimensions too small by half.
    - `strides`: number of strides in which a walker may converge.
    - `seed`, `tolerance`, `progress`: as in `refine`.

    Raises `ValueError` for an attractor that has no period, repels, or is outside the region;
    `ComputationFailed` where no ball around it is in its basin.
    """
    check_kind("system", system, System)
    check_single(system)
    check_kind("attractor", attractor, Attractor)
    check_grid(system, region, "direct")
    check_whole("moves", moves)
    check_whole("samples", samples, GROUPS * FEWEST)
    states = np.asarray(attractor.states)
    check_precision(states.dtype)
    place = (region.place(states[0]) + 0.5) / region.shape if attractor.period else np.array([-1.0])
    integrator = integrator_of(states.dtype, tolerance)
    if not ((place > 0) & (place < 1)).all() or not attracts(system, states, integrator):
        raise WrongUse(
            "attractor must be a stable cycle whose first state is in the region, "
            f"not one at {short(states[0].tolist())}"
        )
    mapper = Mapper(system, [attractor], integrator, strides, 0)
    mapper = with_capture_boxes(mapper)

    def inside(shares: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
        return mapper(region.points_at(shares)).attractor == 0

    with bar("volume of the basin", progress):
        rng = np.random.default_rng(seed)
        radii, logs, error = grow(inside, place, rng, samples // GROUPS, moves)
    whole = region.size * region.cell_area
    within = whole * np.exp(logs)
    return BasinVolume(
        float(within[-1]), float(within[-1] * error), float(within[-1] / whole), radii, within
    )


def grow(
    inside: Inside, centre: Float[np.ndarray, " d"], rng: np.random.Generator, each: int, moves: int
) -> tuple[Float[np.ndarray, " balls"], Float[np.ndarray, " balls"], float]:
    """Return radii of balls, logarithms of the volumes of a set within them, and their last error.

    The set lies within the unit cube. Each ball has twice the volume of the one before.
    """
    d, reach = len(centre), float(np.linalg.norm(np.maximum(centre, 1 - centre)))
    radius, points = fill(inside, centre, rng, each)
    filled = np.array([len(group) for group in points]) / each
    ball = d * np.log(radius) + d / 2 * np.log(np.pi) - lgamma(d / 2 + 1)
    radii, logs = [radius], [ball + np.log(filled.mean())]
    scatter = np.log(filled)
    groups = np.stack([group[rng.integers(len(group), size=each)] for group in points])
    while radius < reach:
        before, radius = radius, radius * 2 ** (1 / d)
        for _ in range(moves):
            groups = move(inside, groups, centre, radius, rng)
        shares = (np.linalg.norm(groups - centre, axis=2) <= before).mean(axis=1)
        radii.append(radius)
        logs.append(logs[-1] - np.log(shares.mean()))
        scatter = scatter - np.log(np.maximum(shares, 0.5 / each))
    error = float(np.std(scatter, ddof=1) / np.sqrt(GROUPS))
    return np.array(radii), np.array(logs), error


def fill(
    inside: Inside, centre: Float[np.ndarray, " d"], rng: np.random.Generator, each: int
) -> tuple[float, list[Float[np.ndarray, "n d"]]]:
    """Return the largest ball, by halves, that is mostly in a set, and its points in the set."""
    radius = float(np.minimum(centre, 1 - centre).min())  # within the cube
    while radius > SMALLEST:
        points = centre + radius * draw_from_ball(rng, GROUPS * each, len(centre))
        found = inside(points).reshape(GROUPS, each)
        if (found.mean(axis=1) > FILLED).all():
            pairs = zip(points.reshape(GROUPS, each, -1), found, strict=True)
            return radius, [group[mine] for group, mine in pairs]
        radius /= 2
    raise ComputationFailed("no ball around the attractor is mostly in its basin")


def move(
    inside: Inside,
    groups: Float[np.ndarray, "groups n d"],
    centre: Float[np.ndarray, " d"],
    radius: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "groups n d"]:
    """Move each point of a set along a line, to a random place of the set within a ball.

    Even groups move along lines through points of odd ones, and then odd ones through even ones:
    the lines must not depend on the points that move.
    """
    groups = groups.copy()
    for mine, others in ((slice(0, None, 2), 1), (slice(1, None, 2), 0)):
        x, lines = groups[mine], groups[others::2]
        shape = x.shape[:2]
        first, second = (rng.integers(shape[1], size=shape) for _ in range(2))
        row = np.arange(shape[0])[:, None]
        along = lines[row, first] - lines[row, second]
        anywhere = rng.normal(size=x.shape)
        alone = (rng.uniform(size=shape) < 0.5) | ~along.any(axis=2)
        lines = np.where(alone[..., None], anywhere, along).reshape(-1, x.shape[2])
        groups[mine] = slide(inside, x.reshape(lines.shape), lines, centre, radius, rng).reshape(
            x.shape
        )
    return groups


def slide(
    inside: Inside,
    x: Float[np.ndarray, "n d"],
    lines: Float[np.ndarray, "n d"],
    centre: Float[np.ndarray, " d"],
    radius: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n d"]:
    """Return random points of a set on lines through points of it, within a ball and the cube.

    A point that is not in the set cuts off what lies beyond it, seen from x.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.stack([(0 - x) / lines, (1 - x) / lines])
    low, high = np.nanmax(walls.min(axis=0), axis=1), np.nanmin(walls.max(axis=0), axis=1)
    away, square = x - centre, np.sum(lines**2, axis=1)
    middle = -np.sum(away * lines, axis=1) / square
    half = np.sqrt(np.maximum(middle**2 + (radius**2 - np.sum(away**2, axis=1)) / square, 0))
    low, high = (
        np.minimum(np.maximum(low, middle - half), 0),
        np.maximum(np.minimum(high, middle + half), 0),
    )
    found, left = x.copy(), np.arange(len(x))
    while len(left):
        t = rng.uniform(low[left], high[left])
        tried = x[left] + t[:, None] * lines[left]
        ends = inside(tried)
        found[left[ends]] = tried[ends]
        left, t = left[~ends], t[~ends]
        low[left], high[left] = np.where(t < 0, t, low[left]), np.where(t < 0, high[left], t)
        left = left[high[left] - low[left] > SMALLEST]
    return found
