"""Capture boxes: regions around the states of a cycle from which all walkers converge to it.

A walker is followed only until it is in such a box. Convergence is checked on a sample of starts,
and not proved; so a box is half as large as the largest from which the whole sample converges.
"""

import numpy as np
from jaxtyping import Float

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.systems.angles import difference, turns_of
from walker_jax.walking.iteration import iterate

HALF_EDGES = 1e-5 * 1.5 ** np.arange(20)
"""Half edges of the cubes that are tried, up to 0.022 in all coordinates."""
STRETCHES = 1.5 ** np.arange(12)
"""Factors by which boxes are stretched along one direction."""
LEAP = 4
"""Number of sizes by which boxes grow at once, until one is too large. Each call takes longer to
start than its walks."""
STARTS, FEWEST_STARTS = 1000, 100
"""Number of random starts in the boxes of a cycle, and the fewest in each box."""
STARTS_IN_SPACE, PLAIN_SECTION = 300, 3
"""Number of starts on sections with more coordinates than this, where strides take longer. Boxes
then cost about what they save to a few thousand walks."""
SETTLING_PERIODS = 8
"""Periods after which walkers are left in the directions along which they approach a cycle last."""


def with_capture_boxes(mapper: Mapper) -> Mapper:
    """Return the mapper with capture boxes for all cycles; those that a cycle has are kept."""
    rng = np.random.default_rng(0)
    boxed = [
        find_capture_boxes(mapper, i, rng) if one.period and one.capture_boxes is None else one
        for i, one in enumerate(mapper.attractors)
    ]
    return mapper._replace(attractors=boxed)


def find_capture_boxes(mapper: Mapper, number: int, rng: np.random.Generator) -> Attractor:
    """Grow capture boxes for an attractor, as long as a sample of starts in them converges to it.

    Boxes are cubes at first. They then lie along the directions in which walkers approach the cycle
    last, and are stretched along each. Half edges are the rows of a matrix.
    """
    attractors = list(mapper.attractors)
    cycle = attractors[number].states
    period, size = cycle.shape
    starts = STARTS if size <= PLAIN_SECTION else STARTS_IN_SPACE
    u = rng.uniform(-1, 1, (period, max(starts // period, FEWEST_STARTS), size))

    def capture_in(boxes: Float[np.ndarray, "period section section"]) -> None:
        frames = np.swapaxes(np.linalg.inv(boxes), 1, 2)
        attractors[number] = attractors[number]._replace(capture_boxes=frames)

    def largest(boxes: Float[np.ndarray, "tried period section section"], small: int) -> int:
        """Return the index of the largest of growing boxes from which all converge, or -1.

        Half of that box becomes the attractor's. The first `small` boxes are tried at once, the
        others in turn: walks end in the box before. If all converge from the end of a leap, so they
        do from the boxes between, it is assumed.
        """

        def count_converging(tried: Float[np.ndarray, "tried period section section"]) -> int:
            starts = (cycle[:, None] + u @ tried).reshape(-1, size)
            found = mapper._replace(attractors=attractors).follow(starts).attractor
            converge = (found == number).reshape(len(tried), -1).all(axis=1)
            return int(np.logical_and.accumulate(converge).sum())

        best, leap = count_converging(boxes[:small]) - 1, LEAP
        end = len(boxes) if best == small - 1 else best + 1
        while best + 1 < end:
            if best >= 0:
                capture_in(boxes[best])
            tried = min(best + leap, end - 1)
            if count_converging(boxes[tried, None]):
                best = tried
            else:
                end, leap = tried, 1
        if best >= 0:
            capture_in(boxes[best] / 2)
        return best

    cubes = HALF_EDGES[:, None, None, None] * np.tile(np.eye(size), (period, 1, 1))
    best = largest(cubes, 1)
    if best < 0:
        return attractors[number]
    x = (cycle[:, None] + u @ cubes[best]).reshape(-1, size)
    x = iterate(mapper.walker, x, SETTLING_PERIODS * period, mapper.integrator).state
    apart = difference(x.reshape(u.shape), cycle[:, None], turns_of(mapper.walker))
    axes = np.linalg.svd(apart, full_matrices=False)[2]
    cubes = HALF_EDGES[:, None, None, None] * axes
    box = cubes[max(largest(cubes, best + 1), 0)]
    for i in range(size):
        stretch = np.ones((len(STRETCHES), 1, size, 1))
        stretch[:, 0, i, 0] = STRETCHES
        box = (stretch * box)[max(largest(stretch * box, 1), 0)]
    return attractors[number]
