"""How large a disturbance a gait survives.

A disturbance moves the walker from its gait to another point of the Poincaré section. The least one
from which it does not come back says more of a machine than the multipliers of its gait do (Schwab
and Wisse 2001, section 5).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basin import near
from walker_jax.gaits import Gait, find_gait
from walker_jax.integrate import default_tolerance
from walker_jax.stride import Outcome, follow_stride
from walker_jax.tiles import over_cells
from walker_jax.walkers import Walker

RAYS, RADII = 720, 128
"""Directions, of two dimensions, and distances along each, at which a walker is first tried."""
DENSE, SHELL = 16, 48
"""How many times as many directions are then tried, at how many distances up to the least found."""
FAN = 61
"""Directions that are tried at once around one of the nearest."""
CANDIDATES = 64
"""Directions that are nearer than their neighbours, of which as many are looked at more closely."""
ZOOMS = 7
"""How often."""
HALVINGS = 32
"""Of the distance between two points tried on a ray."""


class LeastDisturbance(NamedTuple):
    """The nearest point to a gait from which the walker does not come back."""

    size: float
    """Its distance from the gait, in the metric asked for."""
    direction: Float[np.ndarray, " section"]
    """Of it from the gait, of length one in that metric."""
    state: Float[np.ndarray, " section"]
    """The point."""
    phase: int
    """The state of the gait that it is nearest to."""
    failure: Outcome
    """How the walker fails from just beyond it; `STRIDE` where it comes to another motion."""
    strides: int
    """Strides before that, the failing one not counted."""


def least_disturbance(
    walker: Walker,
    gait: Gait | None = None,
    *,
    scale: Sequence[Any] | ArrayLike | None = None,
    along: Sequence[Any] | ArrayLike | None = None,
    strides: int = 500,
    tolerance: float | None = None,
) -> LeastDisturbance:
    """The nearest point of the section from which a walker does not return to its gait.

    Rays from the gait are followed outwards, all at once, to the first distance from which the
    walker does not return; then closer rays, up to the least of these; then fans of rays around
    those that are nearer than their neighbours, ever narrower. Fingers of failure that are thinner
    than the distance between points, some thousandths of the size, may be missed: where the
    boundary is fractal the size found is too large by about as much.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `gait`: a stable one; the most stable of period one, by default.
    - `scale`: what counts as one unit along each coordinate of the section, positive. The size is
      the length of the disturbance divided by it; by default it is plain length.
    - `along`: vectors, one a row, that disturbances are made of, such as (0, 1) for a push that
      changes thetadot alone. By default they have any direction.
    - `strides`: how many of them a walker may take to come back.
    - `tolerance`: of the integration, as in `stride`.

    `ValueError` for a gait that is not stable, or not found, and for a scale or vectors that are
    not of the section.
    """
    size = len(walker.section)
    unit = np.ones(size) if scale is None else np.asarray(scale, float)
    if unit.shape != (size,) or not np.all(np.isfinite(unit) & (unit > 0)):
        raise ValueError(f"scale must be {size} positive numbers, not {scale}")
    basis = np.eye(size) if along is None else np.atleast_2d(np.asarray(along, float))
    rank = np.linalg.matrix_rank(basis) if np.isfinite(basis).all() else 0
    if basis.ndim != 2 or basis.shape[1] != size or rank != len(basis):
        raise ValueError(f"along must be independent vectors of the section, not {along}")
    if strides < 1:
        raise ValueError(f"strides must be at least 1, not {strides}")
    gait = find_gait(walker) if gait is None else gait
    if not (gait.found and gait.stable):
        raise ValueError("gait must be a stable one, and found")
    basis = np.linalg.qr((basis / unit).T)[0].T
    states = np.asarray(gait.states, float)
    finest = default_tolerance(states.dtype, tolerance)
    to_dtype = lambda leaf: np.asarray(leaf, states.dtype)
    shared = jax.tree.map(to_dtype, (walker, finest, states, near(states.dtype)))
    shared = *shared, np.int32(strides)

    def fails(points: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        return ~over_cells(end_of_walk, shared, points).back

    found = [nearest_failure(lambda y, x=x: fails(x + y * unit), basis) for x in states]
    phase = int(np.argmin([np.linalg.norm(one) for one in found]))
    step = found[phase]
    length = float(np.linalg.norm(step))
    state = states[phase] + step * unit
    beyond = over_cells(end_of_walk, shared, state[None])
    failure, made = Outcome(int(beyond.outcome[0])), int(beyond.strides[0])
    return LeastDisturbance(length, step / length, state, phase, failure, made)


class EndOfWalk(NamedTuple):
    """How a walk ends."""

    back: Bool[Array, "*cells"]
    """Whether the walker has come back to its gait."""
    outcome: Int[Array, "*cells"]
    """Of its last stride."""
    strides: Int[Array, "*cells"]
    """Those completed."""


def end_of_walk(shared: tuple, x: Float[Array, " section"]) -> EndOfWalk:
    """Walk on until a failure, or close to a gait, or for a number of strides."""
    walker, tolerance, states, close, limit = shared

    def is_back(x):
        return jnp.any(jnp.max(jnp.abs(states - x), axis=1) < close)

    def going(carry):
        x, outcome, count = carry
        return (outcome == Outcome.STRIDE) & (count < limit) & ~is_back(x)

    def advance(carry):
        x, _, count = carry
        result = follow_stride(walker, x, tolerance)
        made = result.outcome == Outcome.STRIDE
        return result.state, result.outcome, count + made.astype(jnp.int32)

    first = x, jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.asarray(0, jnp.int32)
    x, outcome, count = lax.while_loop(going, advance, first)
    return EndOfWalk((outcome == Outcome.STRIDE) & is_back(x), outcome, count)


def nearest_failure(
    fails: Callable[[Float[np.ndarray, "n size"]], Bool[np.ndarray, " n"]],
    basis: Float[np.ndarray, "rank size"],
) -> Float[np.ndarray, " size"]:
    """The shortest vector in the span of a basis, of unit vectors at right angles, that fails.

    The origin does not. `ValueError` where nothing fails up to a length of a thousand.
    """
    rank, reach = len(basis), 0.1
    rays = directions(rank, RAYS)
    while True:
        first = first_failures(fails, rays @ basis, 0.0, reach, RADII)
        if np.isinf(first).all():
            if reach > 1e3:
                raise ValueError("along these directions the walker returns from everywhere")
            reach *= 4
        elif first.min() < reach / 4:
            reach = 2 * first.min()
        else:
            break
    # Closer rays, over the shell in which a nearer failure may have been missed.
    rays, gap = directions(rank, DENSE * RAYS), 0.16 * first.min() / SHELL
    first = first_failures(fails, rays @ basis, 0.85 * first.min(), 1.01 * first.min(), SHELL)
    near = first < first.min() + 2 * gap
    rays, first = rays[near], halved(fails, rays[near] @ basis, first[near], gap)
    width = spacing(rank, DENSE * RAYS)
    best = rays[lowest(rays, first, 2 * width)]
    centre, least = rays[first.argmin()], first.min()
    for _ in range(ZOOMS if rank > 1 else 0):
        fans = np.stack([around(ray, width) for ray in best])
        flat = fans.reshape(-1, rank) @ basis
        # The nearest failures of a fan lie a little before those of the wider one.
        tried = first_failures(fails, flat, 0.9 * least, 1.05 * least, 24)
        tried = halved(fails, flat, tried, 0.15 * least / 24).reshape(fans.shape[:2])
        best, lengths = fans[np.arange(len(fans)), tried.argmin(axis=1)], tried.min(axis=1)
        centre, least = best[lengths.argmin()], lengths.min()
        best = best[lengths < 1.01 * least]
        width *= 0.25
    return least * centre @ basis


def first_failures(
    fails: Callable, rays: Float[np.ndarray, "n size"], low: Any, high: Any, count: int
) -> Float[np.ndarray, " n"]:
    """The first of some distances along each ray that fails; infinite where none does."""
    distances = np.linspace(low, high, count + 1)[1:]
    points = distances[:, None] * rays[:, None]
    failed = fails(points.reshape(-1, rays.shape[1])).reshape(len(rays), count)
    return np.where(failed.any(axis=1), distances[failed.argmax(axis=1)], np.inf)


def halved(
    fails: Callable, rays: Float[np.ndarray, "n size"], high: Float[np.ndarray, " n"], gap: Any
) -> Float[np.ndarray, " n"]:
    """Distances that fail, `gap` beyond ones that do not, brought down to some ten digits."""
    known = np.isfinite(high)
    below, above = high[known] - gap, high[known]
    for _ in range(HALVINGS):
        middle = (below + above) / 2
        failed = fails(middle[:, None] * rays[known])
        below, above = np.where(failed, below, middle), np.where(failed, middle, above)
    result = np.full(len(high), np.inf)
    result[known] = above
    return result


def directions(rank: int, count: int) -> Float[np.ndarray, "n rank"]:
    """Unit vectors, evenly spread, in three dimensions four times as many as in two."""
    if rank == 1:
        return np.array([[1.0], [-1.0]])
    if rank == 2:
        angles = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # a spiral of equal steps in height on a sphere, turned by the golden angle
    count *= 4
    height = 1 - (2 * np.arange(count) + 1) / count
    angles, radius = np.pi * (3 - np.sqrt(5)) * np.arange(count), np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=1)


def spacing(rank: int, count: int) -> float:
    """The angle between neighbours among them."""
    return 2 * np.pi / count if rank == 2 else float(np.sqrt(np.pi / count))


def around(direction: Float[np.ndarray, " rank"], width: float) -> Float[np.ndarray, "n rank"]:
    """Unit vectors within an angle of one, which is the first of them."""
    across = np.linalg.svd(direction[None])[2][1:]
    if len(across) == 1:
        offsets = np.linspace(-1, 1, FAN - 1)[:, None]
    else:
        angles = np.pi * (3 - np.sqrt(5)) * np.arange(FAN - 1)
        radius = np.sqrt((np.arange(FAN - 1) + 0.5) / (FAN - 1))
        offsets = radius[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    fan = np.concatenate([direction[None], direction + width * offsets @ across])
    return fan / np.linalg.norm(fan, axis=1, keepdims=True)


def lowest(
    rays: Float[np.ndarray, "n rank"], lengths: Float[np.ndarray, " n"], angle: float
) -> Int[np.ndarray, " m"]:
    """Those of unit vectors that have a least length within an angle, the shortest first."""
    order = lengths.argsort()
    beside = rays[order] @ rays[order].T > np.cos(angle)
    shorter = np.tril(beside, -1).any(axis=1)
    return order[~shorter][:CANDIDATES]
