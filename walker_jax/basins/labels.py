"""The label of a walk, and the tests of walks that have made all their strides.

Walks are one, in arrays of JAX, or many, in arrays of NumPy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basins.attractor import Attractor, capture_radius, targets_of
from walker_jax.basins.motions import Clouds, clouds_of
from walker_jax.basins.runs import label_of
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.reductions import largest
from walker_jax.kernels.primitive import vary_together
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.systems.system import System
from walker_jax.walking.scan import scan_strides
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
EXTRA_STRIDES = 2**14
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
    def number(self) -> Int[np.ndarray, "*walks"]:
        """One number for the fate and the attractor, that of `label_of`."""
        return label_of(self.fate, self.attractor)

    @property
    def converged(self) -> Bool[Any, "*walks"]:
        return self.attractor >= 0

    @property
    def fallen(self) -> Bool[Any, "*walks"]:
        """Mark the walks that are known to have failed."""
        return (self.fate != Outcome.STRIDE) & (self.fate != Outcome.UNDECIDED)

    @property
    def undecided(self) -> Bool[Any, "*walks"]:
        """Mark the walks that neither failed nor converged."""
        return (self.fate == Outcome.STRIDE) & ~self.converged

    @property
    def remaining(self) -> Int[np.ndarray, " left"]:
        """Indices of walks that neither failed nor converged."""
        return np.flatnonzero(self.undecided)

    def filled(self, find: Callable) -> Label:
        """Return the labels with attractors of undecided walks, found from their states."""
        return self._replace(attractor=fill(self.attractor, self.undecided, self.state, find))

    @property
    def total_strides(self) -> int:
        """Number of strides computed, including the failing strides."""
        return int(self.strides.sum() + np.sum(self.fate != Outcome.STRIDE))


def fill(
    number: Int[Any, "*walks"],
    unknown: Bool[Any, "*walks"],
    x: Float[Any, "*walks section"],
    find: Callable[[Float[Any, "*walks section"]], Int[Any, "*walks"]],
) -> Int[Any, "*walks"]:
    """Return numbers in which those of some walks are found from their states.

    Of many walks, only these are followed; a single one starts from NaN if its number is known.
    """
    if isinstance(x, np.ndarray):
        number = number.copy()
        if unknown.any():
            number[unknown] = find(x[unknown])
        return number
    return jnp.where(unknown, find(jnp.where(unknown, x, jnp.nan)), number)


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
    apart = not any(one.stands_for_all for one in known)
    return clouds_of([one.cloud for one in known]) if apart else None


def repeats(walks: Float[Any, "*n states section"]) -> Bool[Any, "*n"]:
    """Return whether walks come back to their first states, to rounding."""
    exact = 1e3 * np.finfo(walks.dtype).eps
    return (abs(walks[..., 1:, :] - walks[..., :1, :]).max(axis=-1) < exact).any(axis=-1)
