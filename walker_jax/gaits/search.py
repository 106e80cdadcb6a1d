"""Searches for gaits: cycles of the stride function, and their stability.

A gait of period k is a cycle of k states, S(x_1) = x_2, ..., S(x_k) = x_1 (Schwab and Wisse 2001,
section 4.2). Newton's iteration solves the k equations at once, with all states as unknowns, as in
multiple shooting: errors do not grow from stride to stride. The Floquet multipliers of a gait are
the eigenvalues of the product of the strides' Jacobians, J_k ... J_1. The gait is stable if all of
them are inside the unit circle. Jacobians come from automatic differentiation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from walker_jax.checks import (
    WrongUse,
    array,
    check_kind,
    check_memory,
    check_number,
    check_whole,
    is_traced,
    refuses_tracers,
)
from walker_jax.execution.progress import bar
from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    SAME_STATE_DISTANCE,
    Gait,
    gait_at,
    iterate_newton,
    linearise,
    solve_cycle,
)
from walker_jax.gaits.reasons import no_gait_found
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import Turns, difference, turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System, warn_if_rounded
from walker_jax.walkers.model import moves_like
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking.iteration import follow_walk, orbits
from walker_jax.walking.starts import as_floating, prepare

MATRICES, MATRICES_OF_SEARCHES = 4, 40
"""Matrices as large as the Jacobian of a cycle that Newton's iteration holds at a time, from one
guess and from many, as measured at periods of 1600."""
FEW_STARTS = 2000
"""Most starts, about, of the first search: a stable gait attracts many of them."""


def find_gait(
    walker: System,
    guess: Float[ArrayLike, "..."] | Sequence | None = None,
    period: int = 1,
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Gait:
    """Find a gait of a walker by Newton's iteration (26), from a guess or a default.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    gait = wj.find_gait(walker)
    gait.states, gait.multipliers, gait.stable
    ```

    It works under JAX's transformations. Derivatives with respect to the walker's parameters, in
    forward and reverse mode, follow from the implicit function theorem: for a period of one,
    d(state)/dp = (I - J)^{-1} dS/dp, and the derivatives of multipliers and step times follow from
    it. They grow without bound towards a bifurcation with a multiplier of 1, and do not exist
    there. Multipliers have no derivatives where two of them are equal.

    **Arguments:**

    - `walker`: any walker.
    - `guess`: a point of the section, from which a walk gives the other states of the cycle; or all
      states, of shape (period, section). For the simplest walker and a period of one, the default
      is the long gait, which is stable at small slopes. Otherwise it is the most stable gait that
      searches from at most some 2000 starts over the walker's `gait_region` find; if none is
      stable, the most stable that `find_gaits` finds. If that is unstable, the walker's
      `further_gait_region` is searched likewise. Under a JAX transformation there is no such
      default.
    - `period`: number of strides in the cycle.
    - `tolerance`, `solver`: tolerance and solver of the integration, as in `stride`.

    **Returns** a `Gait`, stable or not. Under a JAX transformation a failed search raises nothing:
    `found` is then false, and states, multipliers and step times are NaN, with all derivatives.

    Raises `ComputationFailed` with the reason if the search fails, or ends in a gait of a shorter
    period; `ValueError` for a period below 1, for a guess of a wrong shape or one that is not
    finite, and for a missing guess where one is needed.
    """
    gait = search_gait(walker, guess, period, tolerance=tolerance, solver=solver)
    if not is_traced(gait) and not gait.found:
        raise no_gait_found(walker, period, gait, guessed=guess is not None)
    return gait


def search_gait(
    walker: System,
    guess: Any = None,
    period: int = 1,
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Gait:
    """`find_gait`, but a failed search returns `found` false and NaN instead of raising."""
    check_kind("walker", walker, System)
    check_period(walker, period)
    given = guess is not None
    guess = as_floating(guess if given else first_guess(walker, period, tolerance, solver), "guess")
    size = len(walker.section)
    if guess.shape not in ((size,), (period, size)):
        raise WrongUse(f"guess must have shape ({size},) or {(period, size)}, not {guess.shape}")
    if given and not isinstance(guess, Tracer) and not np.isfinite(np.asarray(guess)).all():
        raise WrongUse(f"guess must be finite, not {guess.tolist()}")
    walker, first, integrator = prepare(walker, guess.reshape(-1, size)[0], tolerance, solver)
    cycle = guess.reshape(-1, size).astype(first.dtype)
    traced = is_traced((walker, cycle, integrator))
    if len(cycle) < period and traced:
        cycle = follow_walk(walker, first, period - 1, integrator).states
    elif len(cycle) < period:
        _, cycles = cycle_guesses(walker, np.asarray(cycle), period, integrator)
        cycle = cycles[0] if len(cycles) else np.full((period, size), np.nan, first.dtype)
    if traced:
        return solve_cycle(walker, cycle, integrator)
    # The same iteration, in the program that is compiled for all searches.
    gaits = iterate_newton(walker, np.asarray(cycle)[None], integrator)
    gait = gait_at(confirm_gaits(walker, gaits, integrator), 0)
    if gait.found:
        return gait
    states, multipliers, times = (np.full_like(x, np.nan) for x in gait[:3])
    return gait._replace(states=states, multipliers=multipliers, step_times=times)


def check_period(walker: System, period: int, matrices: int = MATRICES) -> None:
    """Refuse a period whose equations, one for each coordinate in a cycle, exceed the memory."""
    check_whole("period", period)
    needed = matrices * 8 * (period * len(walker.section)) ** 2
    check_memory(needed, f"a gait of period {period} needs", "lower period", of="period")


def first_guess(
    walker: System, period: int, tolerance: Real | None, solver: AnySolver | None
) -> Float[Array | np.ndarray, "..."]:
    """Guess a gait of a period: the most stable of those found first."""
    warn_if_rounded(walker)
    if moves_like(walker, SimplestWalker) and period == 1:
        return approximate_long_gait(walker.slope)
    if is_traced((walker, tolerance)):
        raise WrongUse(
            f"guess must be given for a {walker.label()}'s gait of period {period} where JAX traces"
        )
    regions = walker.gait_region(), walker.further_gait_region()
    found: list[Gait] = []
    for grid in chain.from_iterable(coarse_and_fine(one) for one in regions if one is not None):
        if any(gait.stable for gait in found):
            break
        found += search_region(walker, period, grid, tolerance=tolerance, solver=solver)
    if not found:
        return np.full((period, len(walker.section)), np.nan)
    return min(found, key=lambda gait: np.abs(gait.multipliers[0])).states


def coarse_and_fine(region: Grid) -> list[Grid]:
    """Return a grid over a region, of about `FEW_STARTS` cells at most, and the region if finer.

    Along each axis, its cells are wider by the same whole number.
    """
    factor = math.ceil((region.size / FEW_STARTS) ** (1 / len(region.counts)))
    if factor <= 1:
        return [region]
    counts = -(-region.counts // factor)  # rounded up
    return [eqx.tree_at(lambda grid: grid.counts, region, counts), region]


def approximate_long_gait(slope: Float[ArrayLike, ""]) -> Float[Array, " 2"]:
    """Approximate the simplest walker's long period-one gait to 1e-5, up to a slope of 0.2597.

    This is a fit to the result of continuation, in the powers of slope^{1/3} of the expansion for
    small slopes (Garcia, Chatterjee, Ruina and Coleman 1998). At larger slopes there is no such
    gait.
    """
    u = jnp.cbrt(slope)
    powers = jnp.stack([jnp.ones_like(u), u**2, u**4, u**6])
    theta = u * (jnp.array([0.970951, -0.185540, 0.044417, 0.005397], u.dtype) * powers).sum()
    ratio = (jnp.array([-1.045203, 1.095118, 0.108861, 0.062005], u.dtype) * powers).sum()
    return jnp.stack([theta, ratio * theta])


@refuses_tracers("find_gait, given a guess, works within them")
def find_gaits(
    walker: System,
    period: int = 1,
    region: Grid | None = None,
    *,
    descent: int = 0,
    tolerance: Real | None = None,
    progress: bool = True,
) -> list[Gait]:
    """Find all gaits of a period to which Newton's iteration converges from a region's cells.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    gaits = wj.find_gaits(walker, period=1)
    [gait.stable for gait in gaits]  # only the long gait is stable
    ```

    All searches run at once, each from the states of a walk that starts at the centre of a cell. A
    finer region finds more gaits. A walk over the period must repeat each gait to `MAX_RESIDUAL`:
    gaits so unstable that rounding errors grow beyond it within a period are left out.

    **Arguments:**

    - `walker`: any walker.
    - `period`: number of strides in the cycle.
    - `region`: grid of the section, with a search from each cell; by default the walker's
      `gait_region`.
    - `descent`: number of steps of `descend` after which failed searches are repeated.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** a list of those that have a state in the region, each once, from its state with the
    smallest first coordinate, in ascending order of that coordinate.
    """
    check_kind("walker", walker, System)
    check_period(walker, period, MATRICES_OF_SEARCHES)
    check_whole("descent", descent, 0)
    check_kind("progress", progress, bool)
    grid = walker.gait_region() if region is None else region
    with bar("searches for gaits", progress):
        return search_region(walker, period, grid, descent, tolerance=tolerance)


def search_region(
    walker: System,
    period: int,
    grid: Grid,
    descent: int = 0,
    *,
    tolerance: Real | None,
    solver: AnySolver | None = None,
) -> list[Gait]:
    """`find_gaits` with any solver; a descent always uses series."""
    check_kind("region", grid, Grid)
    if not len(grid.names) == grid.coordinates == len(walker.section):
        raise WrongUse(
            f"region must have the {len(walker.section)} dimensions of the section, "
            f"{', '.join(walker.section)}, not {', '.join(grid.names)}"
        )
    starts = grid.centres(np.arange(grid.size))
    walker, _, integrator = prepare(walker, starts[0], tolerance, solver)
    # A period of one needs no walk, which would take one more program.
    cycles = starts[:, None]
    if period > 1:
        _, cycles = cycle_guesses(walker, starts, period, integrator)
    gaits = iterate_newton(walker, cycles, integrator)
    failed = ~gaits.found & np.isfinite(gaits.residual)
    if descent and failed.any():
        nearer = descend(walker, cycles[failed], descent, tolerance=tolerance)
        further = iterate_newton(walker, nearer, integrator)
        gaits = Gait(*map(np.concatenate, zip(gaits, further, strict=True)))
    turns = turns_of(walker)
    gaits = confirm_gaits(walker, remove_duplicates(gaits, turns), integrator)
    around = (0.0,) if turns is None else (-turns, 0.0, turns)
    inside = [grid.contains(np.asarray(gaits.states) + turn).any(axis=1) for turn in around]
    keep = gaits.found & np.any(inside, axis=0)
    return [gait_at(gaits, i) for i in np.flatnonzero(keep)]


@refuses_tracers()
def descend(
    walker: System,
    cycles: Float[ArrayLike, "n period section"] | Sequence[Any],
    steps: int = 300,
    *,
    rate: float = 0.003,
    tolerance: Real | None = None,
) -> Float[np.ndarray, "n period section"]:
    """Move guesses closer to gaits by gradient descent on the mismatch of their strides.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    cycles = wj.descend(walker, np.array([[[0.15, -0.15]]]))
    wj.find_gait(walker, cycles[0])
    ```

    Adam (optax) minimises |S(x_1) - x_2|^2 + ... + |S(x_k) - x_1|^2 for each of n cycles; its rate
    falls to zero over the steps. A step to a state that makes no stride is rejected, and the rate
    of that search is halved. Descent reaches gaits from guesses from which Newton's iteration
    diverges. It may also end at a local minimum of the mismatch above zero.

    **Arguments:**

    - `walker`: any walker.
    - `cycles`: guesses of all states of cycles, of shape (n, period, section); they need not be
      walks.
    - `steps`: number of steps.
    - `rate`: length of the first steps in each coordinate.
    - `tolerance`: tolerance of the integration, as in `stride`.

    **Returns** cycles of the same shape; unchanged if a state of the guess makes no stride.

    Raises `ValueError` for another shape, and for numbers that are not above 0.
    """
    import optax  # only here, as it takes a quarter of a second

    check_kind("walker", walker, System)
    cycles = array("cycles", cycles)
    if cycles.ndim != 3 or cycles.size == 0 or cycles.shape[2] != len(walker.section):
        raise WrongUse(
            f"cycles must have shape (n, period, {len(walker.section)}), not {cycles.shape}"
        )
    check_whole("steps", steps)
    check_number("rate", rate)
    rate = float(rate)
    if not 0 < rate < np.inf:
        raise WrongUse(f"rate must be positive and finite, not {rate}")
    walker, _, integrator = prepare(walker, cycles[0, 0], tolerance)
    optimiser = optax.adam(optax.cosine_decay_schedule(rate, steps), b1=0.5, b2=0.9)
    x, scale = cycles, np.ones(len(cycles), cycles.dtype)
    local = linearise(walker, x, integrator)
    with jax.numpy_dtype_promotion("standard"):  # as optax's own arithmetic needs
        state = optimiser.init(jnp.asarray(x))
    for _ in range(steps):
        mismatch = difference(local.state, np.roll(x, -1, axis=1), turns_of(walker))
        gradient = 2 * np.einsum("...ji,...j->...i", local.jacobian, mismatch)
        gradient -= 2 * np.roll(mismatch, 1, axis=1)
        with jax.numpy_dtype_promotion("standard"):
            update, state = optimiser.update(jnp.asarray(np.nan_to_num(gradient)), state)
        trial = x + scale[:, None, None] * np.asarray(update)
        trial_local = linearise(walker, trial, integrator)
        valid = np.isfinite(trial_local.state).all(axis=(1, 2)).reshape(-1)
        x = np.where(valid[:, None, None], trial, x)
        scale = np.where(valid, scale, scale / 2)
        for old, new in zip(local, trial_local, strict=True):
            old[valid] = new[valid]
    return x


def confirm_gaits(walker: System, gaits: Gait, integrator: Integrator) -> Gait:
    """Mark gaits that a walk over the period does not repeat as not found."""
    states, found = np.asarray(gaits.states), np.asarray(gaits.found)
    period = states.shape[1]
    if period > 1:  # of one stride, the residual is that of the walk
        walks, _ = orbits(walker, states[:, 0], period, integrator)
        mismatch = difference(walks[:, 1:], np.roll(states, -1, axis=1), turns_of(walker))
        found = found & (np.abs(mismatch).max(axis=(1, 2)) < MAX_RESIDUAL[states.dtype])
    return gaits._replace(found=found, stable=gaits.stable & found)


def cycle_guesses(
    walker: System, starts: Float[np.ndarray, "n section"], period: int, integrator: Integrator
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m period section"]]:
    """Return the indices of starts that make `period` strides, and the states of these walks.

    The walker's parameters may be arrays of n.
    """
    states, outcome = orbits(walker, starts, period, integrator)
    walking = np.flatnonzero(outcome == Outcome.STRIDE)
    return walking, states[walking, :period]


def remove_duplicates(gaits: Gait, turns: Turns = None) -> Gait:
    """Return each gait found once, from its state with the smallest first coordinate."""
    found = gait_at(gaits, np.asarray(gaits.found))
    states, times = np.asarray(found.states), np.asarray(found.step_times)
    first = states[..., 0].argmin(axis=1)
    order_in_cycle = (first[:, None] + np.arange(states.shape[1])) % states.shape[1]
    rotated = np.take_along_axis(states, order_in_cycle[..., None], axis=1)
    times = np.take_along_axis(times, order_in_cycle, axis=1)
    found = found._replace(states=rotated, step_times=times)
    order = np.argsort(rotated[:, 0, 0], kind="stable")
    kept = []
    while len(order):
        kept.append(order[0])
        first = rotated[order[0]]
        turned = (np.roll(first, shift, axis=0) for shift in range(len(first)))
        apart = [np.abs(difference(rotated[order], one, turns)).max(axis=(1, 2)) for one in turned]
        order = order[np.min(apart, axis=0) > SAME_STATE_DISTANCE[states.dtype]]
    return Gait(*(field[kept] for field in found))
