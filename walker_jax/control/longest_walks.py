"""The actions by which walks last longest under random disturbances, by dynamic programming.

Walking on rough ground is metastable: every walk ends in a fall (Byl and Tedrake 2009, Int. J.
Robot. Res. 28:1040-1064). The mean number V of strides that follow a state, with the best actions,
solves Bellman's equation V = max P (1 + V), where P are the chances of states after one stride by
an action, short of 1 by the chance to fall. Between centres of cells, V is interpolated linearly,
which blurs it by a cell about, and it is 0 off the kernel.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int32
from scipy.sparse import csr_array

from walker_jax.checks import WrongUse
from walker_jax.control.actions import Actions
from walker_jax.execution.tiles import map_cells
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.rough_ground import RandomDisturbance, draw
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Walker
from walker_jax.walking.disturbed import Disturbance, follow_disturbed

DRAWS, NODES = 2**16, 13
"""Disturbances that are drawn; and those that stand for them, if they vary in one way. In two ways
there are four times as many, in three nine times."""
CONSTANT_SCATTER = 1e-6
"""Scatter, relative, up to which draws are the same but for rounding."""
SEED = 2009
"""Of these draws: walks have other random numbers."""
STRIDES_PER_ROUND, MAX_ROUNDS = 50, 60
"""Strides by which the horizon grows from one choice of actions to the next, and most choices."""
SETTLED_SHARE = 1e-3
"""Share of cells with another action than before at which that ends."""
LEAST_IMPROVEMENT = 1e-12
"""By how much another action must be better, relative: less is rounding."""


class Nodes(NamedTuple):
    """A few disturbances that stand for a random one."""

    values: Float[np.ndarray, "nodes 3"]
    weights: Float[np.ndarray, " nodes"]


class Spread(NamedTuple):
    """Where the strides from some cells lead, by each action and disturbance."""

    cells: Int[np.ndarray, " n"]
    place: Float[np.ndarray, "n m nodes d"]
    """On each axis of the grid, in cells from its lower end; NaN for a fall."""
    weights: Float[np.ndarray, " nodes"]
    shape: tuple[int, ...]
    """Of the grid."""


def find_longest(
    walker: Walker,
    grid: Grid,
    actions: Actions,
    kernel: Bool[np.ndarray, " n"],
    nodes: Nodes,
    integrator: Integrator,
) -> tuple[Int32[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The best action of each cell of a kernel, else -1; and the mean strides of walks from there.

    These are strides up to a horizon, which grows until the actions no longer change. They do not
    as soon as walks forget where they began.
    """
    spread = disturbed_strides(walker, grid, actions, kernel, nodes, integrator)
    value = np.zeros(grid.size)
    action = np.zeros(len(spread.cells), np.int32)
    for number in range(MAX_ROUNDS):
        former, action = action, improve(spread, value, action)
        chain = transitions(spread, action)
        for _ in range(STRIDES_PER_ROUND):
            value[spread.cells] = chain @ (1 + value[spread.cells])
        if number and (action != former).mean() <= SETTLED_SHARE:
            break
    chosen = np.full(grid.size, -1, np.int32)
    chosen[spread.cells] = action
    return chosen, value


def choose_nodes(ground: RandomDisturbance) -> Nodes:
    """Disturbances spread over all that are drawn, each with the share of those nearest to it.

    The first is nearest to their mean; each next one is farthest from those before, as the rare
    ones count most for falls. Their variance is that of all.
    """
    drawn = np.asarray(draw(ground, jax.random.split(jax.random.key(SEED), DRAWS), 0, 1))[:, 0]
    if not np.isfinite(drawn).all():
        raise WrongUse("ground must be finite whenever it is drawn, and is not always")
    centre, scale = drawn.mean(axis=0), drawn.std(axis=0)
    varied = scale > CONSTANT_SCATTER * np.abs(centre)
    points = (drawn - centre)[:, varied] / scale[varied]
    farthest = int((points**2).sum(axis=1).argmin())
    distance, nearest = np.full(DRAWS, np.inf), np.zeros(DRAWS, int)
    for number in range(NODES * max(1, np.count_nonzero(varied)) ** 2):
        apart = ((points - points[farthest]) ** 2).sum(axis=1)
        nearest[apart < distance] = number
        distance = np.minimum(distance, apart)
        farthest = int(distance.argmax())
        if distance[farthest] == 0:
            break
    weights = np.bincount(nearest) / DRAWS
    sums = [np.bincount(nearest, column) for column in points.T]
    means = np.reshape(sums, (-1, len(weights))).T / (DRAWS * weights[:, None])
    values = np.tile(centre, (len(weights), 1))
    values[:, varied] += scale[varied] * means / np.sqrt(weights @ means**2)
    return Nodes(values.astype(drawn.dtype), weights)


def disturbed_strides(
    walker: Walker,
    grid: Grid,
    actions: Actions,
    kernel: Bool[np.ndarray, " n"],
    nodes: Nodes,
    integrator: Integrator,
) -> Spread:
    """Strides from all cells of a kernel, by all actions, with all disturbances."""
    cells, count = np.flatnonzero(kernel), len(nodes.weights)
    place = np.empty((len(cells), len(actions.values), count, len(grid.names)), np.float32)
    starts = np.repeat(cells, count)
    disturbances = Disturbance(*np.tile(nodes.values, (len(cells), 1)).T.copy())
    for number in range(len(actions.values)):
        shared = actions.of(walker, number), grid, integrator
        found = map_cells(arrive, (shared, starts, disturbances), (False, True, True))
        place[:, number] = found.reshape(len(cells), count, -1)
    return Spread(cells, place, nodes.weights, grid.shape)


def arrive(
    shared: tuple[Walker, Grid, Integrator], cell: Int[Array, ""], disturbance: Disturbance
) -> Float[Array, " d"]:
    """Where a disturbed stride from the centre of a cell leads; NaN for a fall."""
    walker, grid, integrator = shared
    made = follow_disturbed(walker, grid.centre(cell), disturbance, integrator)
    end = walker.project(walker.state(*made.state))
    return jnp.where(made.outcome == Outcome.STRIDE, grid.position(end), jnp.nan)


def improve(
    spread: Spread, value: Float[np.ndarray, " all"], action: Int32[np.ndarray, " n"]
) -> Int32[np.ndarray, " n"]:
    """The best action of each cell, given the strides that follow each; as before, of equals."""
    lasting = np.zeros(value.shape)
    lasting[spread.cells] = 1 + value[spread.cells]
    found = np.empty((len(spread.cells), spread.place.shape[1]))
    for number in range(found.shape[1]):
        at, share = corners(spread.place[:, number], spread.shape)
        found[:, number] = (lasting[at] * share).sum(axis=-1) @ spread.weights
    best, row = found.argmax(axis=1), np.arange(len(found))
    better = found[row, best] > found[row, action] * (1 + LEAST_IMPROVEMENT)
    return np.where(better, best, action).astype(np.int32)


def transitions(spread: Spread, action: Int32[np.ndarray, " n"]) -> csr_array:
    """Chances to reach each cell of the kernel from each, by one action for each."""
    n = len(spread.cells)
    at, share = corners(spread.place[np.arange(n), action], spread.shape)
    chance = (share * spread.weights[:, None]).reshape(n, -1)
    number = np.full(int(np.prod(spread.shape)), -1)
    number[spread.cells] = np.arange(n)
    column = number[at].reshape(n, -1)
    kept = column >= 0
    row = np.broadcast_to(np.arange(n)[:, None], column.shape)
    return csr_array((chance[kept], (row[kept], column[kept])), (n, n))


def corners(place: Any, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The cells between whose centres places are, and the share of each; 0 off the grid."""
    first = np.floor(place - 0.5)
    share = place - 0.5 - first
    cells, shares = [], []
    for corner in np.ndindex(*(2,) * len(shape)):
        there = first + np.array(corner)
        inside = ((there >= 0) & (there < np.array(shape))).all(axis=-1)  # not so for NaN
        there = np.where(inside[..., None], there, 0).astype(np.int64)
        cells.append(np.ravel_multi_index(tuple(np.moveaxis(there, -1, 0)), shape))
        near = np.where(np.array(corner) == 1, share, 1 - share).prod(axis=-1)
        shares.append(np.where(inside, near, 0))
    return np.stack(cells, axis=-1), np.stack(shares, axis=-1)
