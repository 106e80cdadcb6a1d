"""Derivatives of the margin of the failure that ends a walk, by its start and by parameters."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator, Solver
from walker_jax.integrators.roots import Real
from walker_jax.systems.system import System
from walker_jax.systems.trees import in_dtype, zeros_like
from walker_jax.walkers.choices import MANY
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameters import as_tangent, with_values
from walker_jax.walking.failure_margins import follow_margins
from walker_jax.walking.iteration import orbits
from walker_jax.walking.pulling import pull_back, pull_in_batches, pull_strides
from walker_jax.walking.scan import scan_strides
from walker_jax.walking.stride import follow_stride


def margins_with_derivatives(
    walker: System,
    x: Float[np.ndarray, "n section"],
    made: Int[np.ndarray, " n"],
    directions: Float[np.ndarray, "axes section"],
    parameters: Sequence[str],
    tolerance: Real,
    solver: Solver | None = None,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n columns"]]:
    """Compute margins of failing walks from x, and derivatives along directions and by parameters.

    Each walk fails after the strides that it has `made`. Its margin is about zero beside the
    boundary of that failure. It is not where the boundary is a jump: a strike that is missed leads
    to another stride, and that to the failure. All is NaN where a walk does not fail. By many
    parameters derivatives are computed in reverse.
    """
    dtype, n = x.dtype, len(x)
    if n and len(parameters) >= MANY and solver is None:
        by_numbers, by_start = pull_margins(walker, x, made, parameters, tolerance)
        changes = np.concatenate([by_start @ directions.T.astype(dtype), by_numbers], axis=1)
        return margins_after(walker, x, made, tolerance), changes
    columns = len(directions) + len(parameters)
    zero = np.zeros((len(parameters), x.shape[1]), dtype)
    along = np.tile(np.concatenate([directions.astype(dtype), zero]), (n, 1))
    names = [None] * len(directions) + list(parameters)
    column = lambda name: np.tile(np.array([name == one for one in names], dtype), n)
    zeros = zeros_like(walker, n * columns, dtype)
    tangent = with_values(zeros, {name: column(name) for name in parameters})
    cells = np.repeat(x, columns, axis=0), np.repeat(made, columns), (tangent, along)
    shared = in_dtype(walker, dtype), Integrator(tolerance, solver).in_dtype(dtype)
    found, changes = map_cells(margin_jvp, (shared, cells))
    return found[::columns], changes.reshape(n, columns)


def differentiate_margins(*given: Any) -> Float[np.ndarray, "n columns"]:
    """Return the derivatives of `margins_with_derivatives` alone."""
    return margins_with_derivatives(*given)[1]


def pull_margins(
    walker: System,
    x: Float[np.ndarray, "n section"],
    made: Int[np.ndarray, " n"],
    parameters: Sequence[str],
    tolerance: Real,
) -> tuple[Float[np.ndarray, "n numbers"], Float[np.ndarray, "n section"]]:
    """Compute derivatives of the margins of failing walks by numbers of the walker and by starts.

    From the failing stride on, all strides are pulled back one by one.
    """
    integrator, made = Integrator(tolerance).in_dtype(x.dtype), np.asarray(made)
    walker = in_dtype(walker, x.dtype)
    states, _ = orbits(walker, x, int(made.max(initial=0)), integrator)
    lasts = states[np.arange(len(x)), made]
    by_numbers, change = pull_in_batches(pull_failures, walker, integrator, [lasts], parameters)
    for number in range(int(made.max(initial=0)) - 1, -1, -1):
        later = np.flatnonzero(made > number)
        cells = states[later, number], change[later], np.zeros(len(later), x.dtype)
        more, change[later] = pull_in_batches(pull_strides, walker, integrator, cells, parameters)
        by_numbers[later] += more
    return by_numbers, change


@jax.jit
def pull_failures(
    walker: System, integrator: Integrator, x: Float[Array, "n section"]
) -> tuple[Any, Float[Array, "n section"]]:
    """Compute derivatives of the margins of strides that fail; NaN where a stride does not."""

    def one(x):
        margin = lambda walker, x: follow_margins(walker, x, integrator).failed
        return pull_back(margin, walker, x, lambda found: jnp.where(jnp.isnan(found), found, 1))

    return jax.vmap(one)(x)


def margins_after(
    walker: System, x: Float[np.ndarray, "n section"], made: Int[np.ndarray, " n"], tolerance: Real
) -> Float[np.ndarray, " n"]:
    """Return the margins of `margins_with_derivatives` alone."""
    shared = in_dtype(walker, x.dtype), Integrator(tolerance).in_dtype(x.dtype)
    return map_cells(margin_after, (shared, (x, np.asarray(made))))


def margin_after(shared: tuple, cell: tuple) -> Scalar:
    """Return the margin of the failure that ends a walk after `count` strides."""
    walker, integrator = shared
    x, count = cell
    end, _ = scan_strides(lambda x, _: follow_stride(walker, x, integrator), x, count)
    return follow_margins(walker, end.state, integrator).failed


def margin_jvp(shared: tuple, cell: tuple) -> tuple[Scalar, Scalar]:
    """Compute the margin of the failure that ends a walk after `count` strides, and a derivative.

    The derivative is along tangents of the walker and of the start. Both are NaN where the walk
    does not end in that stride.
    """
    walker, integrator = shared
    x, count, tangents = cell

    margin = lambda walker, x: margin_after((walker, integrator), (x, count))
    value, change = jax.jvp(margin, (walker, x), (as_tangent(walker, tangents[0]), tangents[1]))
    return value, jnp.where(jnp.isnan(value), jnp.nan, change)
