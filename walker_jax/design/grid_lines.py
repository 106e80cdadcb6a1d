"""Lines of a grid through the centres of its cells, and where they cross a basin's boundary.

Places are in cells: the centre of the first one is at 1/2 along each axis.
"""

import numpy as np
from jaxtyping import Float

from walker_jax.basins.refinement import Refined
from walker_jax.basins.runs import flat_index

Places = Float[np.ndarray, "n axes"]


def boundary_pairs(found: Refined, axis: int) -> tuple[Places, Places]:
    """Find neighbours along an axis, both followed, where one walks and the other does not.

    Returns the places of those that walk, and of the others.
    """
    runs, shape = found.runs, found.grid.shape
    walks = runs.attractor >= 0
    index = np.stack(np.unravel_index(found.cells, shape), axis=1)
    index = index[index[:, axis] + 1 < shape[axis]]
    step = np.eye(len(shape), dtype=int)[axis]
    here, ahead = (
        walks[runs.of_cells(flat_index(places.T, shape))] for places in (index, index + step)
    )
    differ = here != ahead
    first, ahead = index[differ] + 0.5, ahead[differ][:, None]
    return np.where(ahead, first + step, first), np.where(ahead, first, first + step)


def inverse_chances(places: Places, axis: int, most: int) -> Float[np.ndarray, " n"]:
    """Return the weight of each crossing on lines along an axis.

    A crossing at a distance l < 1, in cells, from the next on its line is found with probability l.
    """
    lines = np.floor(np.delete(places, axis, axis=1))
    order = np.lexsort([places[:, axis], *lines.T])
    lines, along = lines[order], places[order, axis]
    apart = np.where(np.any(lines[1:] != lines[:-1], axis=1), np.inf, np.diff(along))
    nearest = np.minimum(np.append(np.inf, apart), np.append(apart, np.inf))
    weights = np.empty(len(places))
    weights[order] = 1 / np.clip(nearest, 1 / most, 1)
    return weights


def compare_lines(
    places: Places, axis: int, shape: tuple[int, ...], moves: Float[np.ndarray, "n columns"]
) -> tuple[Float[np.ndarray, " columns"], Float[np.ndarray, " columns"]]:
    """Compare the sums of moves over neighbouring lines along an axis.

    Returns half the sum of their squared differences, and the sum of the squares of the moves. The
    two are equal on average for crossings that move independently, with a mean of zero.
    """
    lines = np.floor(np.delete(places, axis, axis=1)).astype(int)
    rows = np.delete(shape, axis)
    # One line more, so that the last of a row has no neighbour in the next row.
    numbers = np.ravel_multi_index(tuple(lines.T), (*rows[:-1], rows[-1] + 1))
    numbers, owner = np.unique(numbers, return_inverse=True)
    sums = np.zeros((len(numbers), moves.shape[1]))
    np.add.at(sums, owner, moves)
    # Lines without a crossing are neighbours too, but there is none beyond the ends of a row.
    inside = numbers % (rows[-1] + 1)
    neighbours = 2 - (inside == 0) - (inside == rows[-1] - 1)
    adjacent = np.flatnonzero(np.diff(numbers) == 1)
    products = np.sum(sums[adjacent] * sums[adjacent + 1], axis=0)
    differences = neighbours @ sums**2 / 2 - products
    return differences, np.sum(moves**2, axis=0)
