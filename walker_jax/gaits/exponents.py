"""Lyapunov exponents: the rates, per stride, at which neighbouring walks separate.

The derivative of a stride rotates and stretches the columns of an orthogonal matrix Q. After every
stride the product is factored anew, J Q = Q' R. The means of log |R_ii| are the exponents (Benettin
and others 1980, Meccanica 15, 9-20). Walks that start close together soon become independent if the
first exponent is positive; their scatter gives the errors. Those of a stable cycle follow from one
turn of it: they are the logarithms of the moduli of its multipliers, divided by its period.

J is as accurate as the integration, relative to its largest entries. What it shrinks below that is
not known, so the error of an exponent also has the mean of tolerance |J| / |R_ii|.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from walker_jax.checks import (
    WrongUse,
    array,
    check_kind,
    check_precision,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import find_multipliers, linearise, multiply_jacobians
from walker_jax.gaits.long_runs import RECORDED_STATES, SETTLED_DISTANCE, START_OFFSET
from walker_jax.integrators.integrator import AnySolver, Integrator, integrator_of
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome, Stride
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walking.iteration import as_arrays, orbits
from walker_jax.walking.scan import scan_strides
from walker_jax.walking.stride import follow_stride

LEAST_MULTIPLIER = 1e-4
"""Least modulus of a multiplier, in units of the norm of a cycle's Jacobian, that is used: rounding
leaves twelve digits of it, or fewer where two are nearly equal."""


class Lyapunov(NamedTuple):
    """Lyapunov exponents of one attractor, or of n, in natural logarithms per stride.

    They are NaN if any walk fails, as the walks are then on no attractor.
    """

    exponents: Float[np.ndarray, "*systems section"]
    """Exponents, the largest first."""
    errors: Float[np.ndarray, "*systems section"]
    """Standard errors: the scatter of the walks, 1/strides for the ends of a mean, and the
    tolerance of the derivatives, over how much they shrink that direction in a stride."""
    log_determinant: Float[np.ndarray, "*systems"]
    """The mean of log |det J|, which is their sum."""
    dimension: Float[np.ndarray, "*systems"]
    """Kaplan-Yorke dimension; an exponent within two errors of zero counts as zero."""
    dimension_error: Float[np.ndarray, "*systems"]
    """Its standard error."""
    states: Float[np.ndarray, "*systems walks section"]
    """Ends of the walks; NaN after a failure. On a stable cycle all are the same state."""
    outcome: Int[np.ndarray, "*systems"]
    """`Outcome` of the first walk that fails; `STRIDE` if none does."""


@refuses_tracers()
def lyapunov(
    system: System,
    x: Float[ArrayLike, "*systems section"] | Sequence[Any],
    strides: int = 2000,
    *,
    walks: int = 32,
    settling: int = 500,
    seed: int = 0,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
    progress: str | None = None,
) -> Lyapunov:
    """Compute all Lyapunov exponents of the attractor to which a state converges.

    ```python
    walker = wj.SimplestWalker(slope=0.0185)
    x = wj.find_gait(walker).states[0]
    wj.lyapunov(walker, x).exponents
    ```

    **Arguments:**

    - `system`: one system, or n: its parameters are numbers, or arrays of n, as in `strides`. So
      one call gives the exponents over a parameter.
    - `x`: a state on its section, of shape (section,), or one for each of n systems, (n, section).
      Of many, one that is not finite has the outcome `OUTSIDE`; the others have their exponents.
    - `strides`: strides of each walk over which the exponents are averaged.
    - `walks`: number of walks from near x, which start `START_OFFSET` apart. None are made from a
      stable cycle of at most `RECORDED_STATES` strides, unless rounding hides a multiplier: one
      turn of it gives its exponents.
    - `settling`: strides before these, which do not count.
    - `seed`: seed of the random starts.
    - `tolerance`, `solver`: tolerance and solver of the integration, as in `stride`.
    - `progress`: label of a progress bar, which is shown on a terminal only.

    **Returns** a `Lyapunov`. On a closed curve the walks keep step and do not scatter; the
    exponents are then accurate to about 1/strides. The exponents of a stable gait are the
    logarithms of the moduli of its multipliers, divided by its period. They are much more accurate
    than the errors say, if x is on the gait.

    Raises `ValueError` for states of a wrong shape, one that is not finite, and numbers out of
    range.
    """
    check_kind("system", system, System)
    x, size = array("x", x), len(system.section)
    if x.dtype.kind not in "fiu" or x.ndim not in (1, 2) or x.shape[-1] != size or not len(x):
        raise WrongUse(f"x must be states on the section {system.section}, not of shape {x.shape}")
    if x.ndim == 1 and not np.isfinite(x).all():
        raise WrongUse(f"x must be finite, not {short(x.tolist())}", of="x")
    check_precision(jnp.result_type(float), "a mean over many strides")
    check_whole("walks", walks, 2)
    check_whole("settling", settling, 0)
    starts = np.asarray(x, float).reshape(-1, size)
    system, many = as_arrays(system, len(starts), starts.dtype)
    integrator = integrator_of(jnp.float64, tolerance, solver).in_dtype(starts.dtype)
    every = lambda values: np.repeat(values[:, None], walks, axis=1)
    rates, determinant, states, hidden = map(
        every, find_cycle_exponents(system, starts, settling + strides, integrator)
    )
    outcome = np.full(determinant.shape, Outcome.STRIDE, np.int8)
    others = np.flatnonzero(np.isnan(rates).any(axis=(1, 2)))
    if len(others):
        offsets = START_OFFSET * np.random.default_rng(seed).standard_normal((walks, size))
        near = (starts[others, None] + offsets).reshape(-1, size)
        count = np.int32(settling), np.int32(settling + strides)
        found = map_cells(
            follow_frames,
            (select(system, np.repeat(others, walks)), near, count, integrator),
            (many, True, False, False),
            progress=progress,
        )
        states[others], logs, logs_of_determinant, ratios, outcome[others] = (
            values.reshape(len(others), walks, *values.shape[1:]) for values in found
        )
        rates[others], determinant[others] = logs / strides, logs_of_determinant / strides
        hidden[others] = ratios / strides
    shape = (*x.shape[:-1], walks)
    return summarise(
        strides,
        rates.reshape(*shape, size),
        determinant.reshape(shape),
        states.reshape(*shape, size),
        float(integrator.tolerance) * hidden.reshape(*shape, size).mean(axis=-2),
        outcome.reshape(shape),
    )


def find_cycle_exponents(
    system: System, x: Float[np.ndarray, "n section"], strides: int, integrator: Integrator
) -> tuple[
    Float[np.ndarray, "n section"],
    Float[np.ndarray, " n"],
    Float[np.ndarray, "n section"],
    Float[np.ndarray, "n section"],
]:
    """Find the exponents of stable cycles through n states, their sums, and ends of walks.

    The last result is the error of each exponent in units of the tolerance. Exponents and sums are
    NaN where a state is on no stable cycle of at most `RECORDED_STATES` strides, or where rounding
    hides a multiplier before the last. The last exponent is the sum less the others, as its own
    multiplier is lost first.
    """
    visited, _ = orbits(system, x, RECORDED_STATES, integrator)
    apart = np.abs(difference(visited[:, 1:], visited[:, :1], turns_of(system)))
    returns = apart.max(axis=2) < SETTLED_DISTANCE
    periods = np.where(returns.any(axis=1), returns.argmax(axis=1) + 1, 0)
    exponents, total, ends = np.full_like(x, np.nan), np.full(len(x), np.nan), x.copy()
    hidden = np.zeros_like(x)
    for period in np.unique(periods[periods > 0]):
        which = np.flatnonzero(periods == period)
        cycles = visited[which, :period]
        jacobian = linearise(select(system, which), cycles, integrator).jacobian
        finite = np.isfinite(jacobian).all(axis=(1, 2, 3))
        which, jacobian = which[finite], jacobian[finite]
        product = multiply_jacobians(jacobian)
        moduli = np.abs(find_multipliers(product))
        size = np.linalg.norm(product, axis=(1, 2))[:, None]
        known = (moduli[:, 0] < 1) & (moduli[:, :-1] > LEAST_MULTIPLIER * size).all(axis=1)
        which, moduli, size = which[known], moduli[known], size[known]
        with np.errstate(divide="ignore"):  # a stride may forget a coordinate
            logs = np.linalg.slogdet(jacobian[known])[1]
            total[which] = logs.mean(axis=1)
            exponents[which] = np.log(moduli) / period
        stretches = np.linalg.svd(jacobian[known], compute_uv=False)
        least = np.exp(logs) / np.prod(stretches[..., :-1], axis=-1)
        hidden[which] = ratio(size, moduli)
        hidden[which, -1] = ratio(stretches[..., 0], least).mean(axis=1)
        exponents[which, -1] = total[which] - exponents[which, :-1].sum(axis=1)
        ends[which] = visited[which, strides % period]
    return exponents, total, ends, hidden


def ratio(size: Any, shrunk: Any) -> Any:
    """Return how many times smaller numbers are than a size; zero for those that are exactly 0."""
    return jnp.where(shrunk == 0, 0, size / jnp.where(shrunk == 0, 1, shrunk))


def follow_frames(
    system: System,
    x: Float[Array, " section"],
    count: tuple[Int[Array, ""], Int[Array, ""]],
    integrator: Integrator,
) -> tuple[
    Float[Array, " section"],
    Float[Array, " section"],
    Float[Array, ""],
    Float[Array, " section"],
    Int[Array, ""],
]:
    """Follow a walk that carries an orthogonal matrix.

    Returns its end, sums of logs, of log |det J|, and of |J| / |R_ii|, and the outcome.
    `count` holds the number of the first stride that counts, and that of the stride after the last.
    """
    first, last = count

    def step(state: tuple, number: Int[Array, ""]) -> Stride:
        x, frame, logs, determinant, hidden = state

        def along(column):
            stride = lambda x: follow_stride(system, x, integrator)
            result, change = jax.jvp(stride, (x,), (column,))
            return result, change.state

        all_made, changes = lax.map(along, frame.T)
        made = jax.tree.map(lambda values: values[0], all_made)
        frame, factor = jnp.linalg.qr(changes.T)
        # no product with zero, as a logarithm may be infinite
        counts = lambda values: jnp.where(number >= first, values, 0)
        stretched = jnp.abs(jnp.diagonal(factor))
        logs = logs + counts(jnp.log(stretched))
        determinant = determinant + counts(jnp.linalg.slogdet(changes)[1])
        hidden = hidden + counts(ratio(jnp.linalg.norm(changes), stretched))
        return made._replace(state=(made.state, frame, logs, determinant, hidden))

    zeros = jnp.zeros_like(x)
    begun = x, jnp.eye(len(x), dtype=x.dtype), zeros, jnp.zeros_like(x[0]), zeros
    end, _ = scan_strides(step, begun, last)
    x, _, logs, determinant, hidden = end.state
    return x, logs, determinant, hidden, end.outcome


def summarise(
    strides: int,
    rates: Float[np.ndarray, "*systems walks section"],
    determinants: Float[np.ndarray, "*systems walks"],
    states: Float[np.ndarray, "*systems walks section"],
    hidden: Float[np.ndarray, "*systems section"],
    outcomes: Int[np.ndarray, "*systems walks"],
) -> Lyapunov:
    """Average over the walks, with standard errors; `hidden` are those of the derivatives."""
    failed = outcomes != Outcome.STRIDE
    known = np.where(failed.any(axis=-1), np.nan, 1.0)
    outcome = np.take_along_axis(outcomes, failed.argmax(axis=-1)[..., None], -1)[..., 0]
    walks = outcomes.shape[-1]
    with np.errstate(invalid="ignore"):
        mean = rates.mean(axis=-2) * known[..., None]
        order = np.argsort(-mean, axis=-1)
        alike = (rates == rates[..., :1, :]).all(axis=-2)  # infinite ones have no deviation
        deviation = np.where(alike, 0, rates.std(axis=-2, ddof=1))
        scatter = deviation / np.sqrt(walks) * known[..., None]
        error = np.hypot(scatter, 1 / strides)
        ordered = np.take_along_axis(rates, order[..., None, :], -1)
        dimensions = kaplan_yorke(ordered)
        spread = dimensions.std(axis=-1, ddof=1) / np.sqrt(walks) * known
    near, error = np.abs(mean) < 2 * error, np.hypot(error, hidden)
    mean, error, near = (np.take_along_axis(values, order, -1) for values in (mean, error, near))
    return Lyapunov(
        exponents=mean,
        errors=error,
        log_determinant=determinants.mean(axis=-1) * known,
        dimension=kaplan_yorke(np.where(near, 0.0, mean)),
        dimension_error=spread,
        states=states,
        outcome=outcome,
    )


def kaplan_yorke(exponents: Float[np.ndarray, "*systems section"]) -> Float[np.ndarray, "*systems"]:
    """Return k + (l_1 + ... + l_k) / |l_(k+1)|, with the largest k of a non-negative sum.

    It is 0 if all exponents are negative, and the number of exponents if their sum is not negative.
    """
    sums = np.cumsum(exponents, axis=-1)
    k = np.sum(sums >= 0, axis=-1)
    padded = np.concatenate([np.zeros_like(sums[..., :1]), sums], axis=-1)
    part = np.take_along_axis(padded, k[..., None], -1)[..., 0]
    beyond = np.concatenate([exponents, np.full_like(exponents[..., :1], np.inf)], axis=-1)
    following = np.take_along_axis(beyond, k[..., None], -1)[..., 0]
    return np.where(np.isnan(exponents[..., 0]), np.nan, k + part / np.abs(following))
