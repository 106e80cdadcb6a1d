"""Gaits: cycles of the stride function, how they are found, and their stability.

A gait of period k is a cycle of k states, S(x_1) = x_2, ..., S(x_k) = x_1 (Schwab and Wisse 2001,
section 4.2). All its states are unknowns at once, and Newton's iteration solves the k equations
together: what one stride amplifies is not amplified again by the next. Its multipliers are the
eigenvalues of the product of the strides' Jacobians, J_k ... J_1; it is stable where all are inside
the unit circle. Jacobians come from automatic differentiation.

`find_gait` is one search, a pure function of the walker and the guess that can be differentiated.
`find_gaits` is thousands of them at once.
"""

from collections.abc import Sequence
from typing import Any

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
    check_number,
    check_whole,
    is_traced,
    refuses_tracers,
)
from walker_jax.gaits.cycles import (
    DISTINCT,
    NEWTON_STEPS,
    RESIDUAL,
    Gait,
    cyclic,
    distinct,
    gait_at,
    multipliers_of,
    nowhere,
    product,
    repeats,
    solve,
    solve_cycle,
    uncertainty,
)
from walker_jax.gaits.derivatives import linearise
from walker_jax.grids import Grid
from walker_jax.integrators.solvers import AnySolver, Real, using_solver
from walker_jax.walkers.model import Walker, moves_like
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking.iteration import follow_walk, orbits, select_walkers, strides
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.stepping import as_floating, prepare


def find_gait(
    walker: Walker,
    guess: Float[ArrayLike, "..."] | Sequence | None = None,
    period: int = 1,
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Gait:
    """The gait to which Newton's iteration (26) leads from a guess.

    Works under JAX's transformations. Derivatives with respect to the walker's parameters, in
    forward and reverse mode, are those of the implicit function: d(state)/dp = (I - J)^{-1} dS/dp
    for a period of one, and through it those of multipliers and step times. At a bifurcation with
    a multiplier of 1 they do not exist, and grow without bound towards it, as the gait folds back
    or others leave it; the derivatives of two multipliers do not exist where they are equal.

    **Arguments:**

    - `walker`: any walker.
    - `guess`: a point of the section, from which the other states of the cycle are walked; or all
      states, of shape (period, section). By default one is made. For the simplest walker and a
      period of one it is the long gait, the one that is stable at small slopes. Otherwise it is the
      most stable gait that `find_gaits` finds, which cannot be done while JAX traces.
    - `period`: strides in a cycle.
    - `tolerance`, `solver`: of the integration, as in `stride`.

    **Returns** a `Gait`. Its `found` is false where the search fails, or ends in a gait of a
    shorter period; then states, multipliers and step times are NaN. `ValueError` for a period
    below 1, a guess of a wrong shape, one that is not finite, or none where one is needed.
    """
    with using_solver(solver):
        return gait_near(walker, guess, period, tolerance)


def gait_near(walker: Walker, guess: Any, period: int, tolerance: Real | None) -> Gait:
    """`find_gait` by the solver in use."""
    check_kind("walker", walker, Walker)
    check_whole("period", period)
    given = guess is not None
    guess = as_floating(guess if given else first_guess(walker, period, tolerance), "guess")
    size = len(walker.section)
    if guess.shape not in ((size,), (period, size)):
        raise WrongUse(f"guess must have shape ({size},) or {(period, size)}, not {guess.shape}")
    if given and not isinstance(guess, Tracer) and not np.isfinite(np.asarray(guess)).all():
        raise WrongUse(f"guess must be finite, not {guess.tolist()}")
    walker, first, tolerance = prepare(walker, guess.reshape(-1, size)[0], tolerance)
    cycle = guess.reshape(-1, size).astype(first.dtype)
    traced = is_traced((walker, cycle, tolerance))
    if len(cycle) < period and traced:
        cycle = follow_walk(walker, first, period - 1, tolerance).states
    elif len(cycle) < period:
        _, cycles = cycle_guesses(walker, np.asarray(cycle), period, tolerance)
        cycle = cycles[0] if len(cycles) else np.full((period, size), np.nan, first.dtype)
    if traced:
        return solve_cycle(walker, cycle, tolerance)
    # The same iteration, on what is compiled for all searches.
    gaits = search(walker, np.asarray(cycle)[None], tolerance)
    gait = gait_at(confirmed(walker, gaits, tolerance), 0)
    return gait if gait.found else nowhere(gait)


def first_guess(
    walker: Walker, period: int, tolerance: Real | None
) -> Float[Array | np.ndarray, "..."]:
    """A guess of the most stable gait of a period."""
    if moves_like(walker, SimplestWalker) and period == 1:
        return long_gait(walker.slope)
    if is_traced((walker, tolerance)):
        raise WrongUse(
            f"guess must be given for a {type(walker).__name__}'s gait of period {period} where "
            "JAX traces"
        )
    found = find_gaits(walker, period, tolerance=tolerance)
    if not found:
        return np.full((period, len(walker.section)), np.nan)
    return min(found, key=lambda gait: np.abs(gait.multipliers[0])).states


def long_gait(slope: Float[ArrayLike, ""]) -> Float[Array, " 2"]:
    """The long period-one gait of the simplest walker to 1e-5, up to a slope of 0.2597.

    A fit to what continuation gives, in the powers of slope^{1/3} of the expansion for small slopes
    (Garcia, Chatterjee, Ruina and Coleman 1998). Beyond that slope there is no such gait.
    """
    u = jnp.cbrt(slope)
    powers = jnp.stack([jnp.ones_like(u), u**2, u**4, u**6])
    theta = u * (jnp.array([0.970951, -0.185540, 0.044417, 0.005397], u.dtype) * powers).sum()
    ratio = (jnp.array([-1.045203, 1.095118, 0.108861, 0.062005], u.dtype) * powers).sum()
    return jnp.stack([theta, ratio * theta])


@refuses_tracers("find_gait, given a guess, works within them")
def find_gaits(
    walker: Walker,
    period: int = 1,
    region: Grid | None = None,
    *,
    descent: int = 0,
    tolerance: Real | None = None,
) -> list[Gait]:
    """All gaits of a period to which Newton's iteration leads from the cells of a region.

    The searches run together, each from the states of a walk from the centre of a cell. A gait is
    found if a search comes to it; a finer region finds more. Each is checked by a walk over its
    period, which it must repeat to `RESIDUAL`: one so unstable that rounding grows larger within
    a period is left out.

    **Arguments:**

    - `walker`: any walker.
    - `period`: strides in a cycle.
    - `region`: of the section, a search from each of its cells; by default the walker's
      `gait_region`.
    - `descent`: steps of `descend` for searches in which Newton's iteration fails, before it is
      tried again.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** the gaits that have a state in the region, each once, from its state of the
    smallest first coordinate on, in ascending order of that.
    """
    check_kind("walker", walker, Walker)
    check_whole("period", period)
    check_whole("descent", descent, 0)
    grid = walker.gait_region() if region is None else region
    check_kind("region", grid, Grid)
    if not len(grid.names) == grid.coordinates == len(walker.section):
        raise WrongUse(
            f"region must have the {len(walker.section)} dimensions of the section, "
            f"{', '.join(walker.section)}, not {', '.join(grid.names)}"
        )
    starts = grid.centres(np.arange(grid.size))
    walker, _, tolerance = prepare(walker, starts[0], tolerance)
    # Without `strides` for a period of one, which would be one more program to compile.
    cycles = starts[:, None]
    if period > 1:
        _, cycles = cycle_guesses(walker, starts, period, tolerance)
    gaits = search(walker, cycles, tolerance)
    failed = ~gaits.found & np.isfinite(gaits.residual)
    if descent and failed.any():
        nearer = descend(walker, cycles[failed], descent, tolerance=tolerance)
        further = search(walker, nearer, tolerance)
        gaits = Gait(*map(np.concatenate, zip(gaits, further, strict=True)))
    gaits = confirmed(walker, distinct(gaits), tolerance)
    keep = gaits.found & grid.contains(np.asarray(gaits.states)).any(axis=1)
    return [gait_at(gaits, i) for i in np.flatnonzero(keep)]


@refuses_tracers()
def descend(
    walker: Walker,
    cycles: Float[np.ndarray, "n period section"],
    steps: int = 300,
    *,
    rate: float = 0.003,
    tolerance: Real | None = None,
) -> Float[np.ndarray, "n period section"]:
    """Guesses closer to gaits than the given ones: descent along the gradient of the mismatch.

    Minimises |S(x_1) - x_2|^2 + ... + |S(x_k) - x_1|^2 for each of n cycles by Adam, whose rate
    falls to zero over the steps (optax). A step to where a state makes no stride is not made; that
    search goes on half as fast. It reaches gaits from starts from which Newton's iteration
    diverges; it may also end in a least mismatch above zero, where there is none.

    **Arguments:**

    - `walker`: any walker.
    - `cycles`: guesses of all the states of cycles. They need not be walks.
    - `steps`: how many.
    - `rate`: length of the first steps, in each coordinate.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** cycles of the same shape; as given where a state of the guess makes no stride.
    `ValueError` for another shape, and for numbers that are not above 0.
    """
    import optax  # here alone: it takes a quarter of a second

    check_kind("walker", walker, Walker)
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
    walker, _, tolerance = prepare(walker, cycles[0, 0], tolerance)
    optimiser = optax.adam(optax.cosine_decay_schedule(rate, steps), b1=0.5, b2=0.9)
    x, scale = cycles, np.ones(len(cycles), cycles.dtype)
    local = linearise(walker, x, tolerance)
    with jax.numpy_dtype_promotion("standard"):  # as optax's own arithmetic needs
        state = optimiser.init(jnp.asarray(x))
    for _ in range(steps):
        miss = local.state - np.roll(x, -1, axis=1)
        gradient = 2 * np.einsum("...ji,...j->...i", local.jacobian, miss)
        gradient -= 2 * np.roll(miss, 1, axis=1)
        with jax.numpy_dtype_promotion("standard"):
            update, state = optimiser.update(jnp.asarray(np.nan_to_num(gradient)), state)
        tried = x + scale[:, None, None] * np.asarray(update)
        there = linearise(walker, tried, tolerance)
        good = np.isfinite(there.state).all(axis=(1, 2)).reshape(-1)
        x = np.where(good[:, None, None], tried, x)
        scale = np.where(good, scale, scale / 2)
        for old, new in zip(local, there, strict=True):
            old[good] = new[good]
    return x


def confirmed(walker: Walker, gaits: Gait, tolerance: Real) -> Gait:
    """The same gaits, but those not found that a walk over the period does not repeat."""
    states, found = np.asarray(gaits.states), np.asarray(gaits.found)
    period = states.shape[1]
    last = states[:, 0]
    for i in range(period if period > 1 else 0):  # of one stride, the residual is that of the walk
        last = strides(walker, last, tolerance=tolerance).state
        miss = np.abs(last - states[:, (i + 1) % period]).max(axis=1)
        found = found & (miss < RESIDUAL[states.dtype])
    return gaits._replace(found=found, stable=gaits.stable & found)


def cycle_guesses(
    walker: Walker, starts: Float[np.ndarray, "n section"], period: int, tolerance: Real
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m period section"]]:
    """The starts from which `period` strides can be made, and the states of these walks.

    The walker's parameters may be arrays of n.
    """
    states, outcome = orbits(walker, starts, period, tolerance)
    walking = np.flatnonzero(outcome == Outcome.STRIDE)
    return walking, states[walking, :period]


def search(walker: Walker, cycles: Float[np.ndarray, "n period section"], tolerance: Real) -> Gait:
    """Newton's iteration from many guesses of cycles at once; fields have the searches first.

    The walker's parameters may be arrays of n. A search ends when it has met the rounding errors,
    or when a state makes no stride.
    """
    n, period, size = cycles.shape
    cycles = cycles.copy()
    best = Gait(
        states=np.full_like(cycles, np.nan),
        multipliers=np.full((n, size), np.nan, np.result_type(cycles, np.complex64)),
        step_times=np.full((n, period), np.nan, cycles.dtype),
        stable=np.zeros(n, bool),
        residual=np.full(n, np.nan, cycles.dtype),
        found=np.zeros(n, bool),
    )
    best.states[:] = cycles
    jacobians = np.full((n, period, size, size), np.nan, cycles.dtype)
    left = np.flatnonzero(np.isfinite(cycles).all(axis=(1, 2)))
    rounding = 10 * float(np.finfo(cycles.dtype).eps)
    for _ in range(NEWTON_STEPS):
        local = linearise(select_walkers(walker, left), cycles[left], tolerance)
        miss = local.state - np.roll(cycles[left], -1, axis=1)
        residual = np.abs(miss).max(axis=(1, 2))
        # near rounding a step no longer helps
        better = ~(residual >= best.residual[left]) & np.isfinite(residual)
        improved = left[better]
        best.states[improved] = cycles[improved]
        best.residual[improved] = residual[better]
        best.step_times[improved] = local.time[better]
        jacobians[improved] = local.jacobian[better]
        ended = (residual <= rounding) | (~better & (best.residual[left] < RESIDUAL[cycles.dtype]))
        going = np.isfinite(residual) & ~ended
        left, miss, jacobian = left[going], miss[going], local.jacobian[going]
        if len(left) == 0:
            break
        step = solve(cyclic(jacobian), -miss.reshape(len(left), -1))
        cycles[left] += step.reshape(len(left), period, size)
    known = np.flatnonzero(np.isfinite(best.residual))
    best.multipliers[known] = multipliers_of(product(jacobians[known]))
    near = (best.residual < RESIDUAL[cycles.dtype]) & ~repeats(best.states)
    with np.errstate(divide="ignore"):
        error = uncertainty(best.residual[near], cyclic(jacobians[near]))
    best.found[near] = error < DISTINCT[cycles.dtype] / 10
    best.stable[:] = best.found & (np.abs(best.multipliers[:, 0]) < 1)
    return best
