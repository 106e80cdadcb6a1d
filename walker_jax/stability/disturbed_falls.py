"""Sequences of disturbances that topple a walker, and the gradient of their boundary."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basins.attractor import targets_of
from walker_jax.basins.mapper import Mapper
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.systems.trees import in_dtype, names_in_tree
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walking.disturbed import (
    Disturbance,
    follow_disturbed,
    follow_disturbed_margins,
    follow_disturbed_walk,
)
from walker_jax.walking.iteration import Targets, distances
from walker_jax.walking.scan import Walked, scan_strides

PULLED_BACK = 8
"""Number of walks whose derivatives are computed in one call: a search asks for a few at a time."""


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
        walker = in_dtype(self.mapper.walker, dtype)
        return walker, self.mapper.integrator.in_dtype(dtype)

    def follow(self, w: Float[np.ndarray, "n size"]) -> Walked:
        """Follow walks until they fall, or return to the gait after the disturbances."""
        (walker, integrator), rows = self.arrays(), self.rows(w)
        targets, _ = targets_of(self.mapper.attractors, len(self.mapper.walker.section))
        limit = np.int32(rows.shape[1] + self.mapper.strides)
        given = walker, self.start, rows, targets, limit, integrator
        return map_cells(walk_disturbed_on, given, (False, False, True, False, False, False))

    def falls(self, end: Walked) -> Bool[np.ndarray, " n"]:
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
        """Call `pull_walks` in batches of one size, so that one program is compiled."""
        walker, integrator = self.arrays()
        slopes = np.empty_like(rows)
        for first in range(0, len(rows), PULLED_BACK):
            batch = np.minimum(np.arange(first, first + PULLED_BACK), len(rows) - 1)
            given = walker, self.start, rows[batch], change[batch], integrator
            slopes[batch] = pull_walks(*given)[-1]
        return slopes


def walk_disturbed_on(
    walker: Walker,
    start: Float[Array, " full"],
    rows: Float[Array, "strides 3"],
    targets: Targets,
    limit: Int[Array, ""],
    integrator: Integrator,
) -> Walked:
    """Follow disturbed strides and then even ones, until a failure, a target or the limit."""

    def step(state: Float[Array, " full"], number: Int[Array, ""]) -> Stride:
        row, even = rows[jnp.minimum(number, len(rows) - 1)], number >= len(rows)
        disturbance = Disturbance(*[jnp.where(even, 0, one) for one in row])
        return follow_disturbed(walker, state, disturbance, integrator)

    def stop(walk: Walked) -> Bool[Array, ""]:
        x = walker.project(walker.state(*walk.state))
        near = jnp.any(distances(x, targets, turns_of(walker)) < 1)
        return (walk.strides > len(rows)) & near

    return scan_strides(step, start, limit, stop)[0]


@partial(jax.jit, static_argnames="leaves")
def pull_walks(
    walker: Walker,
    start: Float[Array, " full"],
    rows: Float[Array, "n strides 3"],
    change: Float[Array, "n section"],
    integrator: Integrator,
    *,
    leaves: tuple[str, ...] = (),
) -> tuple[Any, Float[Array, "n full"], Float[Array, "n strides 3"]]:
    """Compute derivatives of n walks' margins by leaves, their start and the disturbances.

    The margin is that of the failing stride. If no stride fails, the derivative `change` by the
    last state on the section is given. Those by the walker are in the leaves of these names; its
    other leaves keep their values.
    """

    def margin(walker: Walker, start: Any, rows: Any, change: Float[Array, " section"]) -> Scalar:
        def step(now: tuple, number: Int[Array, ""]) -> Stride:
            state, disturbance = now[0], Disturbance(*rows[number])
            found = follow_disturbed_margins(walker, state, disturbance, integrator)
            outcome = found.stride.outcome
            # After a fall walks start again: derivatives of unused values must be finite too.
            state = jnp.where(outcome == Outcome.STRIDE, found.stride.state, start)
            return found.stride._replace(state=(state, found.failed))

        begun = start, jnp.zeros((), start.dtype)
        end, margins = scan_strides(step, begun, len(rows), record=lambda made: made.state[1])
        later = walker.project(walker.state(*end.state[0])) @ change
        return jnp.where(end.outcome == Outcome.STRIDE, later, margins[end.strides])

    named = jax.tree.structure(walker).unflatten(one in leaves for one in names_in_tree(walker))
    own, fixed = eqx.partition(walker, named)

    def pull(rows: Float[Array, "strides 3"], change: Float[Array, " section"]) -> tuple:
        number = lambda own, start, rows: margin(eqx.combine(own, fixed), start, rows, change)
        return jax.grad(number, (0, 1, 2))(own, start, rows)

    by_own, by_start, by_rows = jax.vmap(pull)(rows, change)
    return eqx.combine(by_own, fixed), by_start, by_rows
