"""Derivatives of strides along gaits, and of gaits by a parameter of the walker."""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Complex, Float

from walker_jax.checks import WrongUse, check_kind, refuses_tracers
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import RESIDUAL, Gait, cyclic, largest_first, product, solve
from walker_jax.integrators.solvers import Real
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter, parameter_direction
from walker_jax.walking.iteration import stacked
from walker_jax.walking.stepping import follow_stride, prepare


class GaitDerivatives(NamedTuple):
    """How a gait changes with a parameter p of its walker, along its branch."""

    states: Float[np.ndarray, "period section"]
    """d(state)/dp."""
    multipliers: Complex[np.ndarray, " section"]
    """d(multiplier)/dp."""
    step_times: Float[np.ndarray, " period"]
    """d(step time)/dp."""


@refuses_tracers("find_gait can be differentiated within them")
def gait_derivatives(
    walker: Walker, gait: Gait, parameter: str, *, tolerance: Real | None = None
) -> GaitDerivatives:
    """Derivatives of a gait's states, multipliers and step times by a parameter of the walker.

    By the implicit function, the states change by the solution dx of
    J_i dx_i - dx_{i+1} = -dS(x_i)/dp. With M = J_k ... J_1, whose derivative takes second
    derivatives of the stride function, and v and w the right and left eigenvectors of M, a
    multiplier changes by (w dM v) / (w v).

    At a bifurcation with a multiplier of 1 there is no derivative, as there the system for dx is
    singular: towards a fold all of them grow like the inverse square root of the distance in p.
    A period doubling does them no harm, but where two multipliers meet theirs do not exist.

    **Arguments:**

    - `walker`: with its parameters.
    - `gait`: of this walker.
    - `parameter`: name of the walker's parameter.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** `GaitDerivatives`. `ValueError` for a parameter that the walker does not have, and
    for what is not a gait.
    """
    check_parameter(walker, parameter)
    check_kind("gait", gait, Gait)
    if not gait.found:
        raise WrongUse(f"gait must be one, unlike the end of a failed search, {gait.states}")
    cycle = np.asarray(gait.states)[None]
    walker, _, tolerance = prepare(walker, cycle[0, 0], tolerance)
    local = linearise(walker, cycle, tolerance, parameter)
    miss = np.abs(local.state - np.roll(cycle, -1, axis=1)).max()
    if not miss < RESIDUAL[cycle.dtype]:
        raise WrongUse(f"gait must be one of this walker: a stride misses the next state by {miss}")
    dx = solve(cyclic(local.jacobian), -local.by_parameter.reshape(1, -1)).reshape(cycle.shape)
    along = np.concatenate([dx, np.ones_like(dx[..., :1])], axis=-1)
    bend = curve(walker, cycle, along, tolerance, parameter)
    period, size = cycle.shape[1:]
    change = np.zeros((size, size))
    for i in range(period):
        factors = local.jacobian[0].copy()
        factors[i] = bend.changes[0, i, :, :size]
        change = change + product(factors[None])[0]
    values, vectors = np.linalg.eig(product(local.jacobian)[0])
    order = largest_first(values.astype(complex))
    rates = np.diag(np.linalg.solve(vectors, change @ vectors))
    return GaitDerivatives(dx[0], rates[order].astype(complex), bend.time[0])


class Linearised(NamedTuple):
    """Strides from n cycles of states, and how their ends change with start and parameter."""

    state: Float[np.ndarray, "n period section"]
    """Ends of the strides; NaN where one fails."""
    time: Float[np.ndarray, "n period"]
    """Durations of the strides."""
    jacobian: Float[np.ndarray, "n period section section"]
    """Derivatives of the ends by the starts, a matrix J for each stride."""
    by_parameter: Float[np.ndarray, "n period section"]
    """Derivatives of the ends by the parameter; zero where none is given."""


def linearise(
    walker: Walker,
    cycles: Float[np.ndarray, "n period section"],
    tolerance: Real,
    parameter: str | None = None,
) -> Linearised:
    """One stride from each state, with its derivatives, a cell for each of their columns.

    The walker's parameters may be arrays of n. The first column shows which strides there are, and
    the others are computed of these alone.
    """
    size, shared = (
        cycles.shape[2],
        (tolerance, parameter_direction(walker, parameter, cycles.dtype)),
    )
    directions = np.eye(size + (parameter is not None), size + 1, dtype=cycles.dtype)
    walkers, starts = repeated(walker, cycles, 1)

    def along(columns, which):
        each = lambda leaf: np.repeat(leaf[which], len(columns), axis=0)
        cells = *jax.tree.map(each, (walkers, starts)), np.tile(columns, (len(which), 1))
        return map_cells(push, (shared, cells))

    (state, time), (first, _) = along(directions[:1], np.arange(len(starts)))
    by = np.full((len(starts), len(directions), size), np.nan, cycles.dtype)
    by[:, 0] = first
    walking = np.flatnonzero(np.isfinite(state).all(axis=1))
    _, (others, _) = along(directions[1:], walking)
    by[walking, 1:] = others.reshape(len(walking), len(directions) - 1, size)
    shaped = lambda values: values.reshape(*cycles.shape[:2], *values.shape[1:])
    return Linearised(
        state=shaped(state),
        time=shaped(time),
        jacobian=np.swapaxes(shaped(by[:, :size]), 2, 3),
        by_parameter=shaped(by[:, size]) if parameter else np.zeros_like(cycles),
    )


class Curved(NamedTuple):
    """How strides from n cycles change along a direction, and how that change changes."""

    along: Float[np.ndarray, "n period section"]
    """Derivatives of the ends along the direction."""
    time: Float[np.ndarray, "n period"]
    """Derivatives of the durations along it."""
    changes: Float[np.ndarray, "n period section columns"]
    """Derivatives of `along` by each coordinate of the start, and by the parameter."""


def curve(
    walker: Walker,
    cycles: Float[np.ndarray, "n period section"],
    directions: Float[np.ndarray, "n period columns"],
    tolerance: Real,
    parameter: str,
) -> Curved:
    """Second derivatives of one stride from each state, along a direction (start, parameter)."""
    n, period, size = cycles.shape
    columns = size + 1
    cells = (
        *repeated(walker, cycles, columns),
        np.repeat(directions.reshape(-1, columns), columns, axis=0),
        np.tile(np.eye(columns, dtype=cycles.dtype), (n * period, 1)),
    )
    shared = tolerance, parameter_direction(walker, parameter, cycles.dtype)
    (_, (along, time)), (_, (changes, _)) = map_cells(push_twice, (shared, cells))
    shape = n, period, columns
    return Curved(
        along=along.reshape(*shape, size)[:, :, 0],
        time=time.reshape(shape)[:, :, 0],
        changes=np.swapaxes(changes.reshape(*shape, size), 2, 3),
    )


def repeated(
    walker: Walker, cycles: Float[np.ndarray, "n period section"], columns: int
) -> tuple[Walker, Float[np.ndarray, "cells section"]]:
    """The walker and the start of every stride of the cycles, once for each of its columns."""
    n, period, size = cycles.shape
    walkers = stacked(walker, n, cycles.dtype)
    return (
        jax.tree.map(lambda leaf: np.repeat(leaf, period * columns), walkers),
        np.repeat(cycles.reshape(-1, size), columns, axis=0),
    )


def push(shared: tuple[Real, Walker], cell):
    """A stride, and its derivative along a direction (start, parameter) of one cell."""
    tolerance, axis = shared
    walker, x, direction = cell
    tangent = jax.tree.map(lambda leaf: leaf * direction[-1], axis), direction[:-1]
    return jax.jvp(partial(timed_stride, tolerance), (walker, x), tangent)


def timed_stride(tolerance: Real, walker: Walker, x: Float[Array, " section"]):
    result = follow_stride(walker, x, tolerance)
    return result.state, result.time


def push_twice(shared: tuple[Real, Walker], cell):
    """((stride, derivative along one direction), (derivative along another, second one))."""
    walker, x, first, second = cell
    _, axis = shared
    tangent = jax.tree.map(lambda leaf: leaf * second[-1], axis), second[:-1]

    along = lambda walker, x: push(shared, (walker, x, first))
    return jax.jvp(along, (walker, x), tangent)
