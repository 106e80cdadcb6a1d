"""Sequences of disturbances that topple a walker, and the gradient of their boundary."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basins.mapper import Mapper, targets_of
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walking.disturbed import (
    Disturbance,
    follow_disturbed,
    follow_disturbed_margins,
    follow_disturbed_walk,
)
from walker_jax.walking.failure_margins import failure_margin
from walker_jax.walking.iteration import Targets, WalkEnd, distances

PULLED_BACK = 64
"""Number of walks whose derivatives are computed in one call."""


class DisturbedWalks(NamedTuple):
    """Walks from a gait, with disturbances in the first strides and none later.

    Disturbances are in standard deviations, ordered by stride.
    """

    mapper: Mapper
    """Maps states to the gait, for the walks after the disturbances."""
    start: Float[np.ndarray, " full"]
    deviations: Float[np.ndarray, " 3"]
    """Standard deviations of steps, slope and pushes; 0 for kinds that do not occur."""
    strides: int
    """Most strides with disturbances; the last strides of a shorter sequence have none."""
    outcome: Outcome | None
    """The fall that counts; None for any."""

    def rows(self, w: Float[np.ndarray, "n size"]) -> Float[np.ndarray, "n strides 3"]:
        """Return the step, slope and push of each stride."""
        kinds = np.flatnonzero(self.deviations)
        count = w.shape[1] // len(kinds)
        rows = np.zeros((len(w), self.strides, 3))
        rows[:, :count, kinds] = w.reshape(len(w), count, len(kinds)) * self.deviations[kinds]
        return rows

    def arrays(self) -> tuple[Walker, Integrator]:
        """Return the walker and the integrator, with numbers of one dtype."""
        dtype = self.start.dtype
        walker = jax.tree.map(lambda leaf: np.asarray(leaf, dtype), self.mapper.walker)
        return walker, self.mapper.integrator.in_dtype(dtype)

    def follow(self, w: Float[np.ndarray, "n size"]) -> WalkEnd:
        """Follow walks until they fall, or return to the gait after the disturbances."""
        (walker, integrator), rows = self.arrays(), self.rows(w)
        targets, _ = targets_of(self.mapper.attractors, len(self.mapper.walker.section))
        limit = np.int32(rows.shape[1] + self.mapper.strides)
        given = walker, self.start, rows, targets, limit, integrator
        return map_cells(walk_disturbed_on, given, (False, False, True, False, False, False))

    def falls(self, end: WalkEnd) -> Bool[np.ndarray, " n"]:
        """Mark the walks that end in a fall that counts."""
        if self.outcome is not None:
            return end.outcome == self.outcome
        return ~np.isin(end.outcome, (Outcome.STRIDE, Outcome.UNDECIDED))

    def fails(self, w: Float[np.ndarray, "n size"]) -> Bool[np.ndarray, " n"]:
        """Mark the sequences that topple the walker."""
        return self.falls(self.follow(w))

    def gradient(self, w: Float[np.ndarray, "n size"]) -> Float[np.ndarray, "n size"]:
        """Return derivatives of the margins of the falls that end walks; NaN without a fall."""
        end, rows = self.follow(w), self.rows(w)
        fallen, (walker, integrator) = self.falls(end), self.arrays()
        rows = np.concatenate([rows, np.zeros((len(rows), 1, 3))], axis=1)
        later = fallen & (end.strides >= rows.shape[1])
        size = len(walker.section)
        change = np.zeros((len(rows), size))
        if later.any():
            starts = np.broadcast_to(self.start, (later.sum(), len(self.start)))
            given = walker, starts, rows[later], integrator
            made = map_cells(follow_disturbed_walk, given, (False, True, True, False))
            x = np.asarray(jax.vmap(lambda y: walker.project(walker.state(*y)))(made.state))
            count = end.strides[later] - rows.shape[1]
            own = self.mapper.integrator.tolerance
            change[later] = differentiate_margins(walker, x, count, np.eye(size), (), own)
        slopes = self.pull_back(rows, change)[:, : self.strides] * self.deviations
        slopes[~fallen] = np.nan
        return slopes[:, :, self.deviations > 0].reshape(len(w), -1)[:, : w.shape[1]]

    def pull_back(
        self, rows: Float[np.ndarray, "n strides 3"], change: Float[np.ndarray, "n section"]
    ) -> Float[np.ndarray, "n strides 3"]:
        """Call `pull_back` in batches of one size, so that one program is compiled."""
        walker, integrator = self.arrays()
        slopes = np.empty_like(rows)
        for first in range(0, len(rows), PULLED_BACK):
            batch = np.minimum(np.arange(first, first + PULLED_BACK), len(rows) - 1)
            given = walker, self.start, rows[batch], change[batch], integrator
            slopes[batch] = pull_back(*given)
        return slopes


def walk_disturbed_on(
    walker: Walker,
    start: Float[Array, " full"],
    rows: Float[Array, "strides 3"],
    targets: Targets,
    limit: Int[Array, ""],
    integrator: Integrator,
) -> WalkEnd:
    """Follow disturbed strides and then even ones, until a failure, a target or the limit."""

    def unfinished(walk):
        return (walk.outcome == Outcome.STRIDE) & (walk.strides < limit) & (walk.target < 0)

    def advance(walk):
        even = walk.strides >= len(rows)
        row = rows[jnp.minimum(walk.strides, len(rows) - 1)]
        disturbance = Disturbance(*[jnp.where(even, 0, one) for one in row])
        result = follow_disturbed(walker, walk.state, disturbance, integrator)
        x = walker.project(walker.state(*result.state))
        near = even & jnp.any(distances(x, targets, turns_of(walker)) < 1)
        made = walk.strides + (result.outcome == Outcome.STRIDE).astype(jnp.int32)
        return WalkEnd(result.state, result.outcome, made, jnp.where(near, 0, -1).astype(jnp.int32))

    zero = jnp.zeros((), jnp.int32)
    begun = WalkEnd(start, jnp.asarray(Outcome.STRIDE, jnp.int8), zero, zero - 1)
    return lax.while_loop(unfinished, advance, begun)


@jax.jit
def pull_back(
    walker: Walker,
    start: Float[Array, " full"],
    rows: Float[Array, "n strides 3"],
    change: Float[Array, "n section"],
    integrator: Integrator,
) -> Float[Array, "n strides 3"]:
    """Compute derivatives of n margins by the disturbances before them.

    The margin is that of the failing stride. If a later stride fails, its derivative `change` by
    the state on the section is given.
    """

    def margin(rows: Float[Array, "strides 3"], change: Float[Array, " section"]) -> Scalar:
        def advance(walk, row):
            state, outcome, margin = walk
            found = follow_disturbed_margins(walker, state, Disturbance(*row), integrator)
            going, now = outcome == Outcome.STRIDE, found.stride.outcome
            falls = going & (now != Outcome.STRIDE)
            margin = jnp.where(falls, failure_margin(found), margin)
            # After a fall walks start again: derivatives of unused values must be finite too.
            state = jnp.where(now == Outcome.STRIDE, found.stride.state, start)
            return (state, jnp.where(going, now, outcome), margin), None

        begun = start, jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.zeros((), start.dtype)
        (state, outcome, margin), _ = lax.scan(advance, begun, rows)
        later = walker.project(walker.state(*state)) @ change
        return jnp.where(outcome == Outcome.STRIDE, later, margin)

    return jax.vmap(jax.grad(margin))(rows, change)
