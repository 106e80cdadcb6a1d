"""What is asked of the explorer's server."""

import numpy as np

import walker_jax as wj
from walker_jax.explorer import measures, pictures
from walker_jax.explorer.lattice import HOME_CELLS, TILE

WHOLE = [[0, i, j] for i in range(HOME_CELLS[0] // TILE) for j in range(HOME_CELLS[1] // TILE)]
FIRST = pictures.FIRST_ATTRACTOR
SIMPLEST = {"walker": "simplest", "parameters": {"slope": 0.004}}
GRID = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))


def few(values, strides, period_max=2):
    """Settings of a diagram of few values, to replace those of `measures`."""
    return {
        "PERIOD_MAX": period_max,
        "DIAGRAM": measures.DIAGRAM | {"strides": strides, "scan": values},
    }


def parts_and_result(growing):
    """What a measure yields as it grows, and what it returns."""
    parts = []
    while True:
        try:
            parts.append(next(growing))
        except StopIteration as end:
            return parts, end.value


def joined(tiles, shape=HOME_CELLS):
    """Labels and strides of tiles, in the order of `WHOLE`, over the whole grid."""
    cells = np.stack([np.frombuffer(one, np.uint8).reshape(2, TILE, TILE) for one in tiles])
    rows = shape[1] // TILE
    cells = cells.reshape(-1, rows, 2, TILE, TILE).transpose(2, 0, 3, 1, 4)
    return cells.reshape(2, *shape)
