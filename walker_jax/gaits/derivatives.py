"""Derivatives of strides along gaits, and of gaits with respect to a parameter of the walker."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    Gait,
    check_cycle,
    check_found,
    cycle_matrices,
    jvp,
    linearise,
    multiply_jacobians,
    order_by_modulus,
    repeat_cells,
    solve_linear_systems,
    split,
)
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.system import System
from walker_jax.walkers.choices import MANY, values_of
from walker_jax.walkers.parameters import check_parameter, parameter_directions
from walker_jax.walking.pulling import pull_back, pull_in_batches, pull_strides
from walker_jax.walking.starts import prepare

MOST_PARAMETERS = 2
"""Parameters of second derivatives: the same program serves one or two."""


class GaitDerivatives(NamedTuple):
    """Derivatives of a gait by a parameter p of its walker, along its branch."""

    states: Float[np.ndarray, "period section"]
    """d(state)/dp."""
    multipliers: Complex[np.ndarray, " section"]
    """d(multiplier)/dp; NaN if they are left out."""
    step_times: Float[np.ndarray, " period"]
    """d(step time)/dp."""


def gait_derivatives(
    walker: System,
    gait: Gait,
    parameter: str,
    *,
    multipliers: bool = True,
    tolerance: Real | None = None,
) -> GaitDerivatives:
    """Differentiate a gait's states, multipliers and step times by a parameter of the walker.

    By the implicit function theorem, dx solves J_i dx_i - dx_{i+1} = -dS(x_i)/dp. The derivative
    of a multiplier is (w dM v) / (w v), where M = J_k ... J_1, v and w are the right and left
    eigenvectors of M, and dM takes second derivatives of the stride function, which are most of the
    work.

    At a bifurcation with a multiplier of 1 the system for dx is singular, and the derivatives do
    not exist: towards a fold they grow like the inverse square root of the distance in p. They
    exist at a period doubling. Multipliers have no derivatives where two of them meet.

    **Arguments:**

    - `walker`: a walker with its parameters.
    - `gait`: a gait of this walker.
    - `parameter`: name of the walker's parameter.
    - `multipliers`: whether to differentiate the multipliers too.
    - `tolerance`: tolerance of the integration, as in `stride`.

    **Returns** `GaitDerivatives`.

    Raises `ValueError` for a parameter that the walker does not have, and for a gait that is not
    one of this walker.
    """
    check_parameter(walker, parameter)
    check_found(gait)
    cycle = np.asarray(gait.states)[None]
    period, size = cycle.shape[1:]
    walker, _, integrator = prepare(walker, cycle[0, 0], tolerance)
    local = linearise(walker, cycle, integrator, parameter)
    check_cycle(walker, cycle[0], local.state[0], MAX_RESIDUAL[cycle.dtype])
    dx = solve_linear_systems(
        cycle_matrices(local.jacobian), -local.by_parameter.reshape(1, -1)
    ).reshape(cycle.shape)
    along = np.concatenate([dx, np.ones_like(dx[..., :1])], axis=-1)
    found = GaitDerivatives(
        states=dx[0],
        multipliers=np.full(size, np.nan, complex),
        step_times=np.sum(local.of_time * along, axis=-1)[0],
    )
    if not multipliers:
        return found
    second = differentiate_twice(walker, cycle, along, integrator, [parameter])
    change = np.zeros((size, size))
    for i in range(period):
        factors = local.jacobian[0].copy()
        factors[i] = second.changes[0, i, :, :size]
        change = change + multiply_jacobians(factors[None])[0]
    values, vectors = np.linalg.eig(multiply_jacobians(local.jacobian)[0])
    order = order_by_modulus(values.astype(complex))
    rates = np.diag(np.linalg.solve(vectors, change @ vectors))
    return found._replace(multipliers=rates[order].astype(complex))


class GaitPull:
    """Derivatives by numbers of a walker, of what depends on them by way of a gait.

    By few numbers they follow from `gait_derivatives`; by many in reverse, from the transposed
    system.
    """

    def __init__(
        self, walker: System, gait: Gait, parameters: Sequence[str], tolerance: Real | None = None
    ):
        self.walker, self.gait, self.parameters = walker, gait, parameters
        self.tolerance = tolerance

    @cached_property
    def changes(self) -> list[GaitDerivatives]:
        """Derivatives of the gait by each number."""
        return self.differentiate()

    @cached_property
    def motions(self) -> list[GaitDerivatives]:
        """The same without multipliers, which take second derivatives."""
        return self.differentiate(multipliers=False)

    def differentiate(self, **how: bool) -> list[GaitDerivatives]:
        """Return derivatives of the gait by each number."""
        each = partial(gait_derivatives, self.walker, self.gait, tolerance=self.tolerance, **how)
        return [each(name) for name in self.parameters]

    def pull(
        self,
        by_states: Float[np.ndarray, "period section"],
        by_times: Float[np.ndarray, " period"],
        by_multipliers: Complex[np.ndarray, " section"],
    ) -> Float[np.ndarray, " parameters"]:
        """Return derivatives by the numbers, given those by states, step times and multipliers.

        A change by dm of the multipliers is Re(by_multipliers . dm). Those that have no derivatives
        do no harm where nothing depends on them.
        """
        given = by_states, by_times, by_multipliers
        if len(self.parameters) < MANY:
            pairs = [*zip(given, ("states", "step_times", "multipliers"), strict=True)]
            used = [(by, name) for by, name in pairs if by.any()]
            along = lambda one: sum(np.sum(by * getattr(one, name)).real for by, name in used)
            changes = self.changes if by_multipliers.any() else self.motions
            return np.array([along(one) for one in changes], by_states.dtype)
        total = self.pull_states(by_states, by_times)
        if by_multipliers.any():
            cycle = jnp.asarray(self.gait.states)
            by_walker = pull_multipliers(self.walker, cycle, by_multipliers, self.tolerance)
            total = total + values_of(by_walker, self.parameters)
        return total

    def pull_states(
        self,
        by_states: Float[np.ndarray, "period section"],
        by_times: Float[np.ndarray, " period"],
    ) -> Float[np.ndarray, " parameters"]:
        """Do the work of `pull` in reverse, without multipliers."""
        cycle = np.asarray(self.gait.states)
        walker, _, integrator = prepare(self.walker, cycle[0], self.tolerance)
        local = linearise(walker, cycle[None], integrator)
        check_cycle(walker, cycle, local.state[0], MAX_RESIDUAL[cycle.dtype])
        given = [cycle, np.zeros_like(cycle), by_times.astype(cycle.dtype)]
        _, by_start = pull_in_batches(pull_strides, walker, integrator, given, ())
        # J_i dx_i - dx_{i+1} = -dS/dp, transposed
        transposed = np.swapaxes(cycle_matrices(local.jacobian), 1, 2)
        right = (by_states + by_start).reshape(1, -1)
        given[1] = -solve_linear_systems(transposed, right).reshape(cycle.shape)
        pulled, _ = pull_in_batches(pull_strides, walker, integrator, given, self.parameters)
        return pulled.sum(axis=0)


@partial(jax.jit, static_argnums=3)
def pull_multipliers(
    walker: System,
    states: Float[Array, "period section"],
    change: Complex[Array, " section"],
    tolerance: Real | None,
) -> Any:
    """Compute derivatives by a walker, given those by the multipliers of its gait."""
    search = partial(search_gait, period=len(states), tolerance=tolerance)
    of = lambda walker, states: search(walker, states).multipliers
    return pull_back(of, walker, states, change)[0]


class SecondDerivatives(NamedTuple):
    """Derivatives of strides from n cycles along a direction, and their own derivatives.

    Columns are the coordinates of the start, then the parameters.
    """

    state: Float[np.ndarray, "n period section"]
    """Ends of the strides; NaN where one fails."""
    by_columns: Float[np.ndarray, "n period section columns"]
    """Derivatives of the ends by each column."""
    along: Float[np.ndarray, "n period section"]
    """Derivatives of the ends along the direction."""
    changes: Float[np.ndarray, "n period section columns"]
    """Derivatives of `along` by each column."""


def differentiate_twice(
    walker: System,
    cycles: Float[np.ndarray, "n period section"],
    directions: Float[np.ndarray, "n period columns"],
    integrator: Integrator,
    parameters: Sequence[str],
) -> SecondDerivatives:
    """Return second derivatives of one stride from each state, along a direction.

    A direction has an entry for each column: the coordinates of the start, then the parameters.
    """
    n, period, size = cycles.shape
    columns, full = size + len(parameters), size + MOST_PARAMETERS
    filled = np.zeros((n * period, full), cycles.dtype)
    filled[:, :columns] = directions.reshape(-1, columns)
    cells = (
        *repeat_cells(walker, cycles, columns),
        np.repeat(filled, columns, axis=0),
        np.tile(np.eye(columns, full, dtype=cycles.dtype), (n * period, 1)),
    )
    axes = parameter_directions(walker, parameters, cycles.dtype, MOST_PARAMETERS)
    shared = integrator.in_dtype(cycles.dtype), axes
    found = map_cells(second_jvp, (shared, cells))
    (state, along), (by_columns, changes) = found
    shape = n, period, columns
    each = lambda values: values.reshape(*shape, size)
    return SecondDerivatives(
        state=each(state)[:, :, 0],
        by_columns=np.swapaxes(each(by_columns), 2, 3),
        along=each(along)[:, :, 0],
        changes=np.swapaxes(each(changes), 2, 3),
    )


def second_jvp(shared: tuple[Integrator, System], cell):
    """Return ((end, its derivative along first), (its derivatives along second, along both))."""
    walker, x, first, second = cell

    def derivative(walker, x):
        (state, _), (along, _) = jvp(shared, (walker, x, first))
        return state, along

    return jax.jvp(derivative, (walker, x), split(shared[1], walker, x, second))
