"""The lattice of cells in pictures: levels, each twice as fine as the one before, and square tiles.

At level 0 the home window of a walker has `HOME_CELLS` cells. At level k cells are smaller by a
factor of 2^k. Tile (k, i, j) has the cells i * TILE ... (i + 1) * TILE - 1 along the first axis,
counted from the lower corner of the home window, and likewise j along the second.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from walker_jax.basins.windows import PAPER_WINDOW, grid_along
from walker_jax.checks import WrongUse, short
from walker_jax.explorer.offers import Offer, window_of
from walker_jax.explorer.subjects import Subject, whole
from walker_jax.gaits.search import search_gait
from walker_jax.gaits.selection import select_gaits
from walker_jax.grids import Grid, axes_around
from walker_jax.robots.robots import Robot, ends_around
from walker_jax.systems.system import has_gait_region
from walker_jax.walkers.simplest import SimplestWalker

HOME_CELLS = (200, 250)
"""Cells of the home window along each axis, as in the paper's grid."""
TILE = 50
"""Cells along an edge of a tile; its 2500 cells take about 7 ms."""
LEVELS = (-3, 34)
"""Coarsest and finest level; in finer cells float64 could not separate states."""
FARTHEST = 2**20
"""Farthest place that can be shown, in home windows to either side."""
MAX_TILES = 600
"""Most tiles in a request, more than a large screen shows."""
MAX_CELLS = 2**20
"""Most cells in a rectangle."""


class Tile(NamedTuple):
    level: int
    i: int
    j: int


class Rectangle(NamedTuple):
    """A rectangle of cells of one level."""

    level: int
    first: tuple[int, int]
    """Number of its first cell along each axis."""
    shape: tuple[int, int]


class Home(NamedTuple):
    """The window in which a walker, or another system, is first shown."""

    lower: tuple[float, float]
    upper: tuple[float, float]
    gait: tuple[float, ...]
    """First state of its default gait; for a system without a known gait, the window's middle."""

    def axes(self, subject: Subject, cells: Rectangle, at: tuple[float, ...]) -> dict[str, Any]:
        """Return the axes of a rectangle of cells, with the fixed coordinates of the plane."""
        plane = subject.plane
        axes: dict[str, Any] = dict(zip(plane.others, at, strict=True))
        for k, name in enumerate(plane.axes):
            first, across = cells.first[k], HOME_CELLS[k] * 2.0**cells.level
            shares = (end / across for end in (first, first + cells.shape[k]))
            low, high = (self.lower[k] * (1 - one) + self.upper[k] * one for one in shares)
            axes[name] = (float(low), float(high), cells.shape[k])
        return {name: axes[name] for name in plane.names}

    def grid(self, subject: Subject, cells: Rectangle, at: tuple[float, ...]) -> Grid:
        """Return the grid of a rectangle of cells, in the plane at these other coordinates."""
        return grid_along(self.axes(subject, cells, at))


@functools.cache
def home_of(offered: Offer, section: str) -> Home:
    """Return the home window of an offer on a section.

    For the simplest walker in the sheared plane it is the paper's window. For any other walker in
    the plane, and for a robot, it lies around the default gait. For other systems it is that of
    `window_of`.
    """
    gait = first_state(offered)
    if not offered.has_film:
        window = window_of(offered)
        if isinstance(offered.kind, Robot) and not offered.axes:
            window = ends_around(offered.kind, gait)
        (x0, x1), (y0, y1) = (window[name] for name in offered.planes[section].axes)
        return Home((x0, y0), (x1, y1), gait)
    if section == "plain":
        x, y = (0.0, 2.5 * gait[0]), (2.5 * gait[1], 0.0)
    elif offered.kind is SimplestWalker:
        x, y = (axis[:2] for axis in PAPER_WINDOW.values())
    else:
        axes = axes_around(np.array(gait), ("theta", "sum", *offered.section[2:]))
        x, y = axes["theta"][:2], axes["sum"][:2]
    (x0, x1), (y0, y1) = ([float(f"{end:.2g}") for end in ends] for ends in (x, y))
    return Home((x0, y0), (x1, y1), gait)


@functools.cache
def first_state(offered: Offer) -> tuple[float, ...]:
    """Return the first state of the default gait; without a gait, the middle of the window."""
    walker = offered.build(offered.defaults)
    if offered.has_film:
        (gait,) = select_gaits(walker, instead="give another walker")
    elif not has_gait_region(walker) or not (gait := search_gait(walker)).found:
        return tuple((low + high) / 2 for low, high in window_of(offered).values())
    return tuple(np.asarray(gait.states[0]).tolist())


def read_tiles(asked: Any) -> list[Tile]:
    """Return the tiles of a request, checked."""
    if not isinstance(asked, list) or not 1 <= len(asked) <= MAX_TILES:
        raise WrongUse(f"tiles must be a list of 1 to {MAX_TILES}, not {short(asked)}")
    tiles = []
    for one in asked:
        if not isinstance(one, list) or len(one) != 3:
            raise WrongUse(f"a tile must be [level, i, j], not {short(one)}")
        level = whole("level", one[0], *LEVELS)
        tiles.append(Tile(level, *(read_place(value, level, TILE) for value in one[1:])))
    return tiles


def read_rectangle(asked: Any) -> Rectangle:
    """Return the rectangle of a request, [level, i, j, cells along i, cells along j], checked."""
    if not isinstance(asked, list) or len(asked) != 5:
        raise WrongUse(f"cells must be [level, i, j, columns, rows], not {short(asked)}")
    level = whole("level", asked[0], *LEVELS)
    i, j = (read_place(value, level, 1) for value in asked[1:3])
    columns, rows = (whole("cells", value, 2, MAX_CELLS // 2) for value in asked[3:])
    if columns * rows > MAX_CELLS:
        raise WrongUse(f"cells must be at most {MAX_CELLS}, not {columns} x {rows}: zoom out less")
    return Rectangle(level, (i, j), (columns, rows))


def read_place(value: Any, level: int, cells: int) -> int:
    """Return the number, along an axis, of a cell or of a tile that is `cells` wide; checked."""
    most = int(FARTHEST * max(HOME_CELLS) * 2.0**level) // cells
    return whole("place", value, -most, most)


def cells_of(tile: Tile) -> Rectangle:
    """Return the cells of a tile."""
    return Rectangle(tile.level, (tile.i * TILE, tile.j * TILE), (TILE, TILE))
