"""The label of a start: what becomes of a walk, as a pure JAX function of one start.

A walker is followed until it fails, until it is in a capture box of a cycle, or for a number of
strides. A walk that has made all its strides belongs to the cycle that it comes ever nearer to;
otherwise, to the nearest motion without a period, if one is known; otherwise, to the cycle that it
comes to much later. `label` makes these steps one after the other for one start. `Mapper` makes
each of them for those of many starts that the one before left open.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basins.attractor import Attractor, capture_radius, targets_of
from walker_jax.basins.motions import Clouds, clouds_of, nearest_motion
from walker_jax.checks import WrongUse, check_whole, short
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import Real
from walker_jax.kernels.primitive import nan_allowed, vary_together
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.systems.system import System
from walker_jax.walking.iteration import Targets, walk_on
from walker_jax.walking.scan import scan_strides
from walker_jax.walking.starts import prepare
from walker_jax.walking.stride import follow_stride

CLOSE = 0.01
"""Distance from a cycle within which a walk that has made all its strides may still be approaching
it: near a period doubling, convergence is too slow to come within `capture_radius`."""
LONGEST_PERIOD = 64
"""Longest cycle, in strides, that is recognised as one."""
BLOCKS = 4
"""Number of stretches of `LONGEST_PERIOD` strides, over which walkers come nearer to a cycle or
leave it."""
VISITED = 16
"""Strides whose states show on which motion without a period a walker is."""
SKIPPED = 4
"""Number of strides between those of these states whose distances are computed."""
SURVIVAL = 1000, 2000
"""Strides after which all walkers that show whether motions without a period last are on one, and
further strides in which none of those on it may fall or converge to a cycle. This tells an
attractor from a transient whose mean life is below some 85,000 strides."""
FURTHER = 2**14
"""Further strides for which undecided walkers are followed to a cycle. They end all but one in ten
million transients with a mean life of 1000 strides, and half of those with 24,000."""


class Label(NamedTuple):
    """The end of walks: numbers for one, or arrays over many, of JAX or of NumPy."""

    fate: Int[Any, "*walks"]
    """`Outcome` of the last stride; `STRIDE` where the walker did not fail."""
    attractor: Int[Any, "*walks"]
    """Number of the attractor that it converges to; -1 for none."""
    strides: Int[Any, "*walks"]
    """Strides completed before it converged or failed."""
    state: Float[Any, "*walks section"]
    """State after these strides; NaN after a failure."""

    @property
    def converged(self) -> Bool[Any, "*walks"]:
        return self.attractor >= 0

    @property
    def fallen(self) -> Bool[Any, "*walks"]:
        """Mark the walks that are known to have failed."""
        return (self.fate != Outcome.STRIDE) & (self.fate != Outcome.UNDECIDED)

    @property
    def remaining(self) -> Int[np.ndarray, " left"]:
        """Indices of walks that neither failed nor converged."""
        return np.flatnonzero((self.fate == Outcome.STRIDE) & ~self.converged)

    @property
    def total_strides(self) -> int:
        """Number of strides computed, including the failing strides."""
        return int(self.strides.sum() + np.sum(self.fate != Outcome.STRIDE))


def label(
    system: System,
    attractors: Sequence[Attractor],
    start: Float[ArrayLike, " section"] | Sequence[Any],
    *,
    strides: int = 200,
    further: int = FURTHER,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Label:
    """Return what becomes of one start: how it fails, or the attractor that it converges to.

    It is a pure function for `jax.jit` and `jax.vmap`; the system and the attractors may be
    operands. Derivatives of the state are in forward mode.

    ```python
    walker = wj.SimplestWalker(0.004)
    attractors = wj.find_attractors(walker, [(0.2, -0.2), (0.15, -0.15)])
    found = wj.label(walker, attractors, (0.2, -0.2))
    found.fate, found.attractor, found.strides  # numbers of `Outcome`, attractor, strides
    ```

    **Arguments:**

    - `system`: one system, with numbers for parameters.
    - `attractors`: of `find_attractors`; a walk's attractor is its place among them.
    - `start`: a point of the section.
    - `strides`: number of strides for which the walker is followed.
    - `further`: further strides of a walker that is then undecided, to identify its cycle only.
    - `tolerance`, `solver`: of the integration, as in `stride`.

    Raises `ValueError` for a start that is no point of the section.
    """
    strides, further = check_whole("strides", strides), check_whole("further", further, 0)
    system, x, integrator = prepare(system, start, tolerance, solver)
    if x.shape != (len(system.section),):
        raise WrongUse(f"start must be on the section {system.section}, not of shape {x.shape}")
    attractors = jax.tree.map(jnp.asarray, check_attractors(attractors))
    with nan_allowed():
        return follow_label(system, attractors, x, strides, further, integrator)


def check_attractors(attractors: Any) -> list[Attractor]:
    """Return attractors as a list; raise `WrongUse` for anything else."""
    found = list(attractors) if isinstance(attractors, Sequence) else [attractors]
    if not all(isinstance(one, Attractor) for one in found):
        raise WrongUse(f"attractors must be those of find_attractors, not {short(attractors)}")
    return found


def follow_label(
    system: System,
    attractors: Sequence[Attractor],
    x: Float[Array, " section"],
    strides: int,
    further: int,
    integrator: Integrator,
) -> Label:
    """Follow one start to its label, unchecked."""
    found = walk_to_cycle(system, attractors, x, strides, integrator)
    left = (found.fate == Outcome.STRIDE) & ~found.converged
    x = jnp.where(left, found.state, jnp.nan)
    number = identify(system, attractors, x, further, integrator)
    return found._replace(attractor=jnp.where(left, number, found.attractor))


def walk_to_cycle(
    system: System,
    attractors: Sequence[Attractor],
    x: Float[Array, " section"],
    most: int | Int[Array, ""],
    integrator: Integrator,
) -> Label:
    """Follow one start until it fails, is in a capture box, or has made `most` strides."""
    targets, owner = targets_of(attractors, len(x))
    if len(owner) == 1:
        targets = Targets(jnp.full((1, len(x)), jnp.nan), jnp.zeros((1, len(x), len(x))))
    end = walk_on(system, x, targets, jnp.asarray(most, jnp.int32), integrator)
    number = jnp.where(end.target < 0, -1, jnp.asarray(owner)[end.target])
    return Label(end.outcome, number, end.strides, end.state)


def identify(
    system: System,
    attractors: Sequence[Attractor],
    x: Float[Array, " section"],
    further: int,
    integrator: Integrator,
) -> Int[Array, ""]:
    """Return the attractor of a walk that has made all its strides; -1 for none, and for NaN."""

    def approached(x: Float[Array, " section"]) -> Int[Array, ""]:
        cycles = cycles_of(attractors, len(x), x.dtype)
        number, farthest = follow_near(system, x, cycles, integrator)
        return jnp.where(comes_nearer(farthest), number, -1)

    number = approached(x)
    x = jnp.where(number < 0, x, jnp.nan)
    if without_period(attractors):
        return jnp.where(number < 0, follow_motion(system, attractors, x, integrator), number)
    if not attractors or not further:
        return number
    later = walk_to_cycle(system, attractors, x, further, integrator)
    reached = jnp.where(later.converged, later.attractor, approached(later.state))
    return jnp.where(number < 0, reached, number)


class Cycles(NamedTuple):
    """The states of all cycles in one table, and the number of the attractor that each is of."""

    states: Float[Any, "m section"]
    owner: Int[Any, " m"]


def cycles_of(attractors: Sequence[Attractor], size: int, dtype: Any) -> Cycles:
    """Return the table of cycles, repeated up to a power of two, so that programs are few."""
    targets, owner = targets_of(attractors, size)
    count = len(owner) - 1
    if count == 0:
        return Cycles(np.full((1, size), np.nan, dtype), owner)
    repeated = np.arange(1 << (count - 1).bit_length()) % count
    return Cycles(targets.states[repeated].astype(dtype), owner[repeated])


def follow_near(
    system: System, x: Float[Array, " section"], cycles: Cycles, integrator: Integrator
) -> tuple[Int[Array, ""], Float[Array, " blocks"]]:
    """Follow a walk that is `CLOSE` to a cycle; return the cycle's attractor, or -1.

    It also returns the largest distance from that cycle in each of `BLOCKS` stretches of strides;
    NaN if the walk fails, or is close to none.
    """
    turns, count = turns_of(system), len(cycles.states)
    states, owner = map(jnp.asarray, cycles)
    blocks = jnp.arange(BLOCKS, dtype=jnp.int32)
    away = lambda x, i: largest(jnp.abs(difference(x, states[i], turns)))

    def nearest(i: Int[Array, ""], best: tuple) -> tuple:
        closer = away(x, i) < best[0]
        return jnp.where(closer, away(x, i), best[0]), jnp.where(closer, owner[i], best[1])

    begun = vary_together((x, jnp.asarray(CLOSE, x.dtype), jnp.asarray(-1, jnp.int32)))[1:]
    _, number = lax.fori_loop(0, count, nearest, begun)

    def distance(x: Float[Array, " section"]) -> Float[Array, ""]:
        own = lambda i: jnp.where(owner[i] == number, away(x, i), jnp.inf)
        far = jnp.full_like(x[0], jnp.inf)
        return lax.fori_loop(0, count, lambda i, least: jnp.minimum(least, own(i)), far)

    def step(walk: tuple, made: Int[Array, ""]) -> Stride:
        stride = follow_stride(system, walk[0], integrator)
        now = jnp.where(blocks == made // LONGEST_PERIOD, distance(stride.state), 0)
        return stride._replace(state=(stride.state, jnp.maximum(walk[1], now)))

    most = jnp.where(number < 0, 0, jnp.int32(BLOCKS * LONGEST_PERIOD))
    end, _ = scan_strides(step, (x, jnp.zeros(BLOCKS, x.dtype)), most)
    known = (number >= 0) & (end.outcome == Outcome.STRIDE)
    return number, jnp.where(known, end.state[1], jnp.nan)


def comes_nearer(farthest: Float[Any, "*walks blocks"]) -> Bool[Any, "*walks"]:
    """Return whether walks that are `CLOSE` to a cycle come ever nearer to it.

    They do if the largest distance from the cycle falls from one stretch of strides to the next, or
    if they arrive. A walker on another motion, which passes by, moves away again.
    """
    falls = (farthest[..., 1:] < farthest[..., :-1]).all(axis=-1)
    return (falls & (farthest[..., 0] < 2 * CLOSE)) | (
        farthest[..., -1] < capture_radius(farthest.dtype)
    )


def without_period(attractors: Sequence[Attractor]) -> list[int]:
    """Return the numbers of the attractors without a period."""
    return [i for i, one in enumerate(attractors) if one.period is None]


def motions_apart(attractors: Sequence[Attractor]) -> Clouds | None:
    """Return the clouds of all motions without a period; None where one stands for all."""
    known = [one for one in attractors if one.period is None]
    return (
        None
        if any(one.stands_for_all for one in known)
        else clouds_of([one.cloud for one in known])
    )


def follow_motion(
    system: System,
    attractors: Sequence[Attractor],
    x: Float[Array, " section"],
    integrator: Integrator,
) -> Int[Array, ""]:
    """Return the number of the motion without a period that is nearest to a walk.

    It is -1 for walks that repeat themselves, as on an unstable cycle. Of several motions, it is
    the one that a walk on none of them comes to in more strides.
    """
    clouds, numbers = motions_apart(attractors), jnp.asarray(without_period(attractors), jnp.int32)
    walk, number = visited(system, x, integrator), numbers[0]
    if clouds is not None and len(numbers) > 1:
        closest = lambda walk: nearest_motion(clouds, walk[::SKIPPED])
        nearest, near = closest(walk)
        later = walk_to_cycle(system, [], x, jnp.where(near, 0, SURVIVAL[0]), integrator)
        come, _ = closest(visited(system, later.state, integrator))
        number = numbers[jnp.where(near | (later.fate != Outcome.STRIDE), nearest, come)]
    return jnp.where(repeats(walk), -1, number)


def visited(
    system: System, x: Float[Array, " section"], integrator: Integrator
) -> Float[Array, "states section"]:
    """Return the states of a few strides of a walk, NaN after a failure."""
    step = lambda x, _: follow_stride(system, x, integrator)
    _, states = scan_strides(step, x, VISITED, record=lambda stride: stride.state)
    return jnp.concatenate([x[None], states])


def repeats(walks: Float[Any, "*n states section"]) -> Bool[Any, "*n"]:
    """Return whether walks come back to their first states, to rounding."""
    exact = 1e3 * np.finfo(walks.dtype).eps
    return (abs(walks[..., 1:, :] - walks[..., :1, :]).max(axis=-1) < exact).any(axis=-1)
