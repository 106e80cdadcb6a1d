"""The mapper: from starts to labels, for one start within JAX, or for many on all cores.

A walker is followed until it fails, until it is in a capture box of a cycle, or for a number of
strides. A walk that has made all its strides belongs to the cycle that it comes ever nearer to;
otherwise, to the nearest motion without a period, if one is known; otherwise, to the cycle that it
comes to much later. Each step is made for all walks that the one before left open: so few walks
wait for the longest ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basins.attractor import Attractor, match_attractor, targets_of
from walker_jax.basins.labels import (
    CLOSE,
    EXTRA_STRIDES,
    SKIPPED,
    SURVIVAL,
    VISITED,
    Label,
    comes_nearer,
    cycles_of,
    fill,
    follow_near,
    motions_apart,
    repeats,
    without_period,
)
from walker_jax.basins.motions import nearest_motion
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import System
from walker_jax.systems.trees import in_dtype, with_static_functions
from walker_jax.walking.iteration import iterate, orbits, pad_to_power_of_two, record_walk, walk_on


class Mapper(NamedTuple):
    """Maps starts to the attractors to which walkers converge: labels = mapper(starts).

    Starts are one, an array of JAX that may be traced, or many, an array of NumPy.
    """

    walker: System
    """One walker, with numbers for parameters."""
    attractors: list[Attractor]
    integrator: Integrator
    strides: int
    """Most strides for which a walker is followed."""
    further: int = EXTRA_STRIDES
    """Further strides for which the remaining walkers are followed to their cycles; a later fall
    does not count."""

    def __call__(self, x: Float[Any, "*n section"], *, progress: str | None = None) -> Label:
        """Return the labels of starts."""
        return self.walk(x, progress=progress).filled(self.identify)

    def follow(self, x: Float[Any, "*n section"], *, progress: str | None = None) -> Label:
        """Label walkers that fail, or come to a cycle or ever nearer to it, in their strides."""
        return self.walk(x, progress=progress).filled(self.approached)

    def walk(self, x: Float[Any, "*n section"], *, progress: str | None = None) -> Label:
        """Follow walkers until they fail, are in a capture box, or have made all strides."""
        targets, owner = targets_of(self.attractors, x.shape[-1])
        if isinstance(x, np.ndarray):
            end = iterate(self.walker, x, self.strides, self.integrator, targets, progress=progress)
            return Label(end.outcome, owner[end.target], end.strides, end.state)
        targets = targets if len(owner) > 1 else pad_to_power_of_two(None, len(x), x.dtype)
        end = walk_on(self.walker, x, targets, jnp.int32(self.strides), self.integrator)
        number = jnp.where(end.target < 0, -1, jnp.asarray(owner)[end.target])
        return Label(end.outcome, number, end.strides, end.state)

    def identify(self, x: Float[Any, "*n section"]) -> Int[Any, "*n"]:
        """Return the attractors of walks that have made all strides; -1 for none, and for NaN."""
        number = self.approached(x)
        if without_period(self.attractors):
            return fill(number, number < 0, x, self.nearest_motions)
        if not self.attractors or not self.further:
            return number
        later = self._replace(strides=self.further)
        return fill(number, number < 0, x, lambda x: later.follow(x).attractor)

    def approached(self, x: Float[Any, "*n section"]) -> Int[Any, "*n"]:
        """Return the numbers of the cycles that walkers come ever nearer to; -1 for none."""

        def find(x: Float[Any, "*n section"]) -> Int[Any, "*n"]:
            number, farthest = self.follow_near(x)
            return x.__array_namespace__().where(comes_nearer(farthest), number, -1)

        if not isinstance(x, np.ndarray):
            return find(x)
        near = match_attractor(x, self.attractors, CLOSE, turns_of(self.walker)) >= 0
        return fill(np.full(len(x), -1, np.int32), near, x, find)

    def follow_near(self, x: Float[Any, "*n section"]) -> tuple[Int[Any, "*n"], Float[Any, "..."]]:
        """Return the cycles that walks are `CLOSE` to, and the distances by stretches."""
        cycles = cycles_of(self.attractors, x.shape[-1], x.dtype)
        if not isinstance(x, np.ndarray):
            return follow_near(self.walker, x, cycles, self.integrator)
        walker = in_dtype(with_static_functions(self.walker), x.dtype)
        given = walker, x, cycles, self.integrator.in_dtype(x.dtype)
        return map_cells(follow_near, given, (False, True, False, False))

    def nearest_motions(self, x: Float[Any, "*n section"]) -> Int[Any, "*n"]:
        """Return the motions without a period that are nearest to walks.

        They are -1 for walks that repeat themselves, as on an unstable cycle. A walk on no known
        motion belongs to the cycle or the motion that it comes to in more strides.
        """
        xp, clouds, walks = x.__array_namespace__(), motions_apart(self.attractors), self.visited(x)
        numbers = xp.asarray(without_period(self.attractors), dtype=xp.int32)
        none = xp.full(x.shape[:-1], -1, dtype=xp.int32)
        number = xp.full_like(none, numbers[0])
        if clouds is not None and (self.further or len(numbers) > 1):
            closest = lambda walks: nearest_motion(clouds, walks[..., ::SKIPPED, :])
            ahead = self._replace(strides=SURVIVAL[0])
            at_end = lambda x: numbers[closest(self.visited(x))[0]]
            nearest, near = closest(walks)
            later = fill(none, ~near, x, lambda x: ahead.follow(x).filled(at_end).attractor)
            number = xp.where(later < 0, numbers[nearest], later)
        return xp.where(repeats(walks), -1, number)

    def on_known_motions(self, x: Float[np.ndarray, "n section"]) -> Bool[np.ndarray, " n"]:
        """Return whether each walker is on one of the known motions without a period."""
        if not without_period(self.attractors) or not len(x):
            return np.zeros(len(x), bool)
        clouds = motions_apart(self.attractors)
        if clouds is None:
            return np.ones(len(x), bool)
        return nearest_motion(clouds, self.visited(x)[:, ::SKIPPED])[1]

    def visited(self, x: Float[Any, "*n section"]) -> Float[Any, "*n states section"]:
        """Return the states of a few more strides of walkers, NaN after a failure."""
        if isinstance(x, np.ndarray):
            return orbits(self.walker, x, VISITED, self.integrator)[0]
        walk, _, _ = record_walk(self.walker, x, jnp.int32(VISITED), self.integrator)
        return jnp.concatenate([x[None], walk[:VISITED]])
