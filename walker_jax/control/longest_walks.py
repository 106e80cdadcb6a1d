"""The actions by which walks last longest under random disturbances, by dynamic programming.

Walking on rough ground is metastable: every walk ends in a fall (Byl and Tedrake 2009, Int. J.
Robot. Res. 28:1040-1064). The mean number V of strides that follow a state, with the best actions,
solves Bellman's equation V = max P (1 + V). P are the probabilities of the states after one stride
by an action; they sum to 1 less the probability of a fall. Between centres of cells, V is
interpolated linearly, which blurs it by about a cell. V is 0 outside the kernel.
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
"""Number of disturbances drawn, and of nodes that represent them if one quantity varies. Two
quantities take four times as many nodes, three take nine times as many."""
CONSTANT_SCATTER = 1e-6
"""Relative scatter below which draws differ by rounding only."""
SEED = 2009
"""Seed of these draws; walks have other random numbers."""
STRIDES_PER_ROUND, MAX_ROUNDS = 50, 60
"""Strides by which the horizon grows between choices of actions, and most choices."""
SETTLED_SHARE = 1e-3
"""Share of cells with changed actions at which the search ends."""
LEAST_IMPROVEMENT = 1e-12
"""Least relative improvement that counts; a smaller one is rounding."""


class Nodes(NamedTuple):
    """A few disturbances that represent a random one."""

    values: Float[np.ndarray, "nodes 3"]
    weights: Float[np.ndarray, " nodes"]


class Spread(NamedTuple):
    """Ends of strides from some cells, by each action and disturbance."""

    cells: Int[np.ndarray, " n"]
    place: Float[np.ndarray, "n m nodes d"]
    """Place on each axis of the grid, in cells from its lower end; NaN for a fall."""
    weights: Float[np.ndarray, " nodes"]
    shape: tuple[int, ...]
    """Shape of the grid."""


def find_longest(
    walker: Walker,
    grid: Grid,
    actions: Actions,
    kernel: Bool[np.ndarray, " n"],
    nodes: Nodes,
    integrator: Integrator,
) -> tuple[Int32[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find the best action of each cell of a kernel, else -1, and the mean strides from there.

    Strides count up to a horizon, which grows until the actions no longer change. That is the case
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
    """Choose disturbances spread over all draws, each with the share of draws nearest to it.

    The first is nearest to the mean of the draws; each next one is farthest from those before, as
    rare disturbances matter most for falls. The nodes have the variance of the draws.
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
    """Make strides from all cells of a kernel, by all actions, with all disturbances."""
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
    """Return the place where a disturbed stride from a cell's centre ends; NaN for a fall."""
    walker, grid, integrator = shared
    made = follow_disturbed(walker, grid.centre(cell), disturbance, integrator)
    end = walker.project(walker.state(*made.state))
    return jnp.where(made.outcome == Outcome.STRIDE, grid.position(end), jnp.nan)


def improve(
    spread: Spread, value: Float[np.ndarray, " all"], action: Int32[np.ndarray, " n"]
) -> Int32[np.ndarray, " n"]:
    """Return the best action of each cell, given the strides that follow; ties keep the old one."""
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
    """Return the probabilities of transitions within the kernel, by the action of each cell."""
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
    """Return the cells whose centres surround each place, and their shares; 0 off the grid."""
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
