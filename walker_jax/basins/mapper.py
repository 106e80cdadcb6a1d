"""What attracts walkers, a cycle of strides or another set, and which walkers come to it."""

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import CLOSE, Attractor, Basins, nearest, until_near
from walker_jax.basins.attractor_search import sample, settle
from walker_jax.walkers.model import Walker


def follow(
    walker: Walker,
    starts: Float[np.ndarray, "n section"],
    attractors: list[Attractor],
    tolerance: float,
    limit: int,
    progress: bool = False,
) -> Basins:
    """Follow every start for a number of strides, until it fails or comes near an attractor.

    The attractors are those given, and those to which starts come that are left at the end.
    """
    found = until_near(walker, starts, attractors, tolerance, limit, progress)
    found.attractor[found.left], attractors = explain(walker, found.ends, attractors, tolerance)
    return Basins(*found[:3], attractors)


def explain(
    walker: Walker,
    x: Float[np.ndarray, "left section"],
    attractors: list[Attractor],
    tolerance: float,
) -> tuple[Int[np.ndarray, " left"], list[Attractor]]:
    """The attractor of each walker that is left at the end, and all attractors.

    That is the one it is `CLOSE` to, or one that is found by following it on. Close to a period
    doubling walkers are slow to come near.
    """
    number = nearest(x, attractors, within=CLOSE)
    lost = number < 0
    if lost.any():
        attractors = settle(walker, sample(x[lost]), tolerance, attractors)
        number[lost] = nearest(x[lost], attractors, within=CLOSE)
        for i, one in enumerate(attractors):
            if one.period is None:
                number[number < 0] = i
    return number, attractors
