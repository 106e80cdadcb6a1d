"""Images of a grid's cells by actions: of their centres, and boxes around those of whole cells.

A stride is made from the centre of each cell, and from each corner. A box encloses the images of a
cell's corners, widened by the distance of the centre's image from their mean. It holds the image of
the whole cell to first order in its size. To second order it holds an image that bends to one side;
opposite curvatures along two axes cancel at the centre.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int32

from walker_jax.cellmaps import cell_image
from walker_jax.control.actions import Actions
from walker_jax.controlled_maps import ImageBoxes
from walker_jax.execution.progress import track
from walker_jax.execution.tiles import map_cells
from walker_jax.execution.workers import Compute
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.stride import stride

TILE = (2**17, 2**20)
"""Most cells of a tile, and most of its strides from centres."""
Tile = tuple[tuple[int, int], ...]
"""Range of cells, and range of actions."""


class Task(NamedTuple):
    """Everything that images depend on."""

    walker: System
    actions: Actions
    integrator: Integrator
    grid: Grid
    """The grid whose cells are mapped."""
    finest: Grid
    """The grid of the images: the same, or a finer one that divides its cells."""
    bounds: bool
    """Whether to compute boxes."""


class MappedCells(NamedTuple):
    """The images of cells by all actions; boxes are empty if not requested."""

    image: Int32[np.ndarray, "n m"]
    """Cells of the finest grid, or sinks, to which strides from centres lead."""
    low: Int[np.ndarray, "boxes m d"]
    """First place of the box on each axis of the grid."""
    high: Int[np.ndarray, "boxes m d"]
    """Last place of the box on each axis."""
    whole: Bool[np.ndarray, "boxes m"]
    """Whether all of a cell makes a stride, and its box lies on the grid."""
    some: Bool[np.ndarray, "boxes m"]
    """Whether some of a cell makes a stride, and its box touches the grid."""

    @classmethod
    def empty(cls, task: Task, n: int) -> "MappedCells":
        """Allocate memory for the images of n cells."""
        m, d = len(task.actions.values), len(task.grid.names)
        boxes, place = n * task.bounds, np.min_scalar_type(-max(task.grid.shape))
        ends = [np.empty((boxes, m, d), place) for _ in range(2)]
        return cls(np.empty((n, m), np.int32), *ends, *np.empty((2, boxes, m), bool))

    def boxes(self, shape: tuple[int, ...], *, every: bool) -> ImageBoxes:
        """Return the boxes of the inner bound, or, if not `every`, of the outer one."""
        return ImageBoxes(self.low, self.high, self.whole if every else self.some, shape, every)


class Arrivals(NamedTuple):
    """Images of points by an action."""

    place: Float[np.ndarray, "n d"]
    """Place on each axis, in cells from the grid's lower end, if the stride was made."""
    made: Bool[np.ndarray, " n"]
    image: Int32[np.ndarray, " n"]
    """The cell of the finest grid, or the sink."""


def bytes_of_cell(actions: int, axes: int, *, bounds: bool) -> int:
    """Return the memory for each mapped cell: its images, its boxes, and its results."""
    return (5 + (2 + 8 * axes) * bounds) * actions + 25


def tile_shape(n: int, m: int) -> tuple[int, int]:
    """Return the number of cells and of actions in a tile."""
    cells, strides = TILE
    cells = -(-n // -(-n // cells))
    return cells, min(m, max(1, strides // cells))


def map_in_tiles(
    task: Task, cells: Int[np.ndarray, " n"] | None, each: Compute, label: str, progress: bool
) -> MappedCells:
    """Compute the images of some cells of a grid, or of all."""
    n, m = task.grid.size if cells is None else len(cells), len(task.actions.values)
    found = MappedCells.empty(task, n)
    if not n:
        return found
    ranges = [
        [(start, min(start + size, whole)) for start in range(0, whole, size)]
        for whole, size in zip((n, m), tile_shape(n, m), strict=True)
    ]
    tiles = [(some, actions) for some in ranges[0] for actions in ranges[1]]
    values = each(functools.partial(map_tile, task, cells), tiles)
    for tile, part in track(values, label, progress, len(tiles)):
        insert_tile(found, tile, part._asdict())
    return found


def insert_tile(found: MappedCells, tile: Tile, part: Mapping[str, np.ndarray]) -> None:
    """Put the images of a tile where they belong."""
    at = tuple(slice(*ends) for ends in tile)
    for name, new in part.items():
        if len(new):
            getattr(found, name)[at] = new


def map_tile(task: Task, cells: Int[np.ndarray, " n"] | None, tile: Tile) -> MappedCells:
    """Compute the images of a tile's cells by its actions."""
    (first, end), (action, last) = tile
    starts = np.arange(first, end) if cells is None else cells[first:end]
    starts = starts.astype(np.int32)
    part = task._replace(actions=task.actions._replace(values=task.actions.values[action:last]))
    found = MappedCells.empty(part, len(starts))
    corners, of_cell = corners_of(starts, task.grid.shape) if task.bounds else (None, None)
    for number in range(last - action):
        acting = part.actions.of(task.walker, number)
        shared = acting, task.grid, task.grid, task.finest, task.integrator
        centres = Arrivals(*map_cells(take_stride, (shared, starts)))
        found.image[:, number] = centres.image
        if corners is not None:
            shared = acting, corner_grid(task.grid), *shared[2:]
            place, made, _ = map_cells(take_stride, (shared, corners))
            around = place.take(of_cell, axis=0), made.take(of_cell, axis=0)
            given = (task.grid, task.finest), centres, around
            boxes = map_cells(box_around, given, (False, True, True))
            for values, new in zip(found[1:], boxes, strict=True):
                values[:, number] = new
    return found


def corner_grid(grid: Grid) -> Grid:
    """Return the grid whose cells are centred on the corners of another grid's cells."""
    ends = zip(grid.names, grid.lower, grid.upper, grid.spacing / 2, grid.shape, strict=True)
    axes = {name: (low - half, high + half, count + 1) for name, low, high, half, count in ends}
    return Grid(axes, grid.shear, grid.origin)


def corners_of(
    cells: Int[np.ndarray, " n"], shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, " k"], Int32[np.ndarray, "n corners"]]:
    """Return the corners of cells, each once, as cells of `corner_grid`, and each cell's own."""
    places, more = np.unravel_index(cells, shape), tuple(count + 1 for count in shape)
    steps = np.ndindex((2,) * len(shape))
    ends = [
        np.ravel_multi_index([place + one for place, one in zip(places, step, strict=True)], more)
        for step in steps
    ]
    around = np.stack(ends, axis=-1)
    first = around.min()
    used = np.zeros(around.max() - first + 1, bool)
    used[around - first] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return (np.flatnonzero(used) + first).astype(np.int32), number[around - first]


def take_stride(
    shared: tuple[System, Grid, Grid, Grid, Integrator], index: Int[Array, ""]
) -> tuple[Float[Array, " d"], Bool[Array, ""], Int[Array, ""]]:
    """Return `Arrivals` of a cell's centre: its place on one grid, its image on a finer one."""
    walker, starts, grid, finest, integrator = shared
    by = {"tolerance": integrator.tolerance, "solver": integrator.solver}
    made = stride(walker, starts.centre(index), **by)
    image = cell_image(finest, made.state, made.outcome, leave=Outcome.LEFT_GRID)
    return grid.position(made.state), made.outcome == Outcome.STRIDE, image


def box_around(
    shared: tuple[Grid, Grid],
    centre: Arrivals,
    corners: tuple[Float[Array, "corners d"], Bool[Array, " corners"]],
) -> tuple[Int[Array, " d"], Int[Array, " d"], Bool[Array, ""], Bool[Array, ""]]:
    """Return the box around the image of a cell, to first order, and whether each bound counts it.

    The box is returned as its first and its last places on each axis. The inner bound counts it if
    all strides, from corners and centre, are made and the whole box lies on the grid. The outer
    bound counts it if some strides are made and the box touches the grid.
    """
    grid, finest = shared
    counts, finer = jnp.asarray(grid.counts), jnp.asarray(finest.counts)
    on_grid = centre.image < jnp.prod(finer, dtype=jnp.int32)
    arrived = [
        (place, made & jnp.isfinite(place).all())
        for place, made in (*zip(*corners, strict=True), (centre.place, centre.made))
    ]
    least, most = (
        functools.reduce(pick, [jnp.where(made, place, none) for place, made in arrived])
        for pick, none in ((jnp.minimum, jnp.inf), (jnp.maximum, -jnp.inf))
    )
    some, whole = (
        functools.reduce(pick, [made for _, made in arrived])
        for pick in (jnp.logical_or, jnp.logical_and)
    )
    bend = jnp.abs(centre.place - sum(corners[0]) / len(corners[0]))
    # If part of a cell fails, the extent of its image is known only to the size of that image.
    bend = jnp.where(whole, bend, jnp.maximum(most - least, 1))
    end = counts.astype(least.dtype)
    least, most = (
        jnp.where(place == end, end - 1, jnp.floor(place))  # the last cell has the upper border
        for place in (least - bend, most + bend)
    )
    inside, touches = ((least >= 0) & (most < end)).all(), ((most >= 0) & (least < end)).all()
    low, high = (jnp.clip(one, 0, end - 1).astype(jnp.int32) for one in (least, most))
    # The centre's image belongs to the box, however its place is rounded.
    held = finest.cell_place(jnp.where(on_grid, centre.image, 0)) // (finer // counts)
    low = jnp.where(on_grid, jnp.minimum(low, held), low)
    high = jnp.where(on_grid, jnp.maximum(high, held), high)
    counted = jnp.logical_and(whole & inside, on_grid), jnp.logical_or(some & touches, on_grid)
    return low, high, *counted
