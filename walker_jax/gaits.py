"""Gaits: cycles of the stride function, how they are found, and their stability.

A gait of period k is a cycle of k states, S(x_1) = x_2, ..., S(x_k) = x_1 (Schwab and Wisse 2001,
section 4.2). All its states are unknowns at once, and Newton's iteration solves the k equations
together: what one stride amplifies is not amplified again by the next. Its multipliers are the
eigenvalues of the product of the strides' Jacobians, J_k ... J_1; it is stable where all are inside
the unit circle. Jacobians come from automatic differentiation.

`find_gait` is one search, a pure function of the walker and the guess that can be differentiated.
`find_gaits` is thousands of them at once.
"""

import inspect
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax import lax
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float, Int

from walker_jax.cells import Grid
from walker_jax.checks import (
    WrongUse,
    array,
    check_kind,
    check_number,
    check_whole,
    is_traced,
    refuses_tracers,
    short,
)
from walker_jax.integrate import AnySolver, Real, solved_by
from walker_jax.series import evaluate
from walker_jax.stride import (
    Outcome,
    as_floating,
    follow_stride,
    follow_walk,
    prepared,
    stacked,
    strides,
)
from walker_jax.tiles import map_cells
from walker_jax.walkers import SimplestWalker, Walker, moves_like

RESIDUAL = {jnp.dtype("float64"): 1e-10, jnp.dtype("float32"): 1e-4}
"""By how much a stride of what is called a gait may miss the next state."""
DISTINCT = {jnp.dtype("float64"): 1e-8, jnp.dtype("float32"): 1e-3}
"""States closer than this, in every coordinate, are one."""
NEWTON_STEPS = 40


class Gait(NamedTuple):
    """A cycle of strides; or what a search that found none ended with."""

    states: Float[Array | np.ndarray, "period section"]
    """Start of each stride."""
    multipliers: Complex[Array | np.ndarray, " section"]
    """Eigenvalues of the Jacobian of the cycle, the largest first."""
    step_times: Float[Array | np.ndarray, " period"]
    """Duration of each stride."""
    stable: Bool[Array | np.ndarray, ""]
    """Whether this is a gait with all multipliers inside the unit circle."""
    residual: Float[Array | np.ndarray, ""]
    """Largest distance, in any coordinate, from the end of a stride to the next state."""
    found: Bool[Array | np.ndarray, ""]
    """Whether this is a gait, of its period and no shorter one; a walk over the period repeats it.

    The residual is rounding, and rounding does not move the states: within about 1e-9 of a
    bifurcation with a multiplier of 1 it does, and nothing is found.
    """


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
    with solved_by(solver):
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
    walker, first, tolerance = prepared(walker, guess.reshape(-1, size)[0], tolerance)
    cycle = guess.reshape(-1, size).astype(first.dtype)
    traced = is_traced((walker, cycle, tolerance))
    if len(cycle) < period and traced:
        cycle = follow_walk(walker, first, period - 1, tolerance).states
    elif len(cycle) < period:
        _, cycles = walked(walker, np.asarray(cycle), period, tolerance)
        cycle = cycles[0] if len(cycles) else np.full((period, size), np.nan, first.dtype)
    if traced:
        return solve_cycle(walker, cycle, tolerance)
    # The same iteration, on what is compiled for all searches.
    gaits = search(walker, np.asarray(cycle)[None], tolerance)
    gait = gait_at(confirmed(walker, gaits, tolerance), 0)
    return gait if gait.found else nowhere(gait)


def nowhere(gait: Gait) -> Gait:
    """NaN for what only a gait has."""
    states, multipliers, times = (np.full_like(x, np.nan) for x in gait[:3])
    return gait._replace(states=states, multipliers=multipliers, step_times=times)


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


@jax.jit
def solve_cycle(
    walker: Walker, states: Float[Array, "period section"], tolerance: Float[Array, ""]
) -> Gait:
    """Newton's iteration on all states of a cycle, and what there is to know of the result."""
    dtype = states.dtype
    accuracy = 500 * float(jnp.finfo(dtype).eps)
    solution = optimistix.root_find(
        mismatch,
        optimistix.Newton(rtol=accuracy, atol=accuracy),
        states,
        args=(walker, tolerance),
        max_steps=NEWTON_STEPS,
        throw=False,
    )
    states = solution.value
    along = lambda states: advance(walker, states, tolerance)
    (ends, times), derivative = jax.linearize(along, states)
    basis = jnp.eye(states.shape[1], dtype=dtype)
    one_by_one = lambda direction: derivative(jnp.broadcast_to(direction, states.shape))[0]
    jacobian = basis
    for factor in jax.vmap(one_by_one, out_axes=2)(basis):
        jacobian = factor @ jacobian
    multipliers = eigenvalues(jacobian)
    multipliers = multipliers[jnp.lexsort((-multipliers.imag, -jnp.abs(multipliers)))]
    residual = jnp.abs(ends - jnp.roll(states, -1, axis=0)).max()
    found = (residual < RESIDUAL[dtype]) & ~repeats(states)
    unit = jnp.eye(states.size, dtype=dtype).reshape(-1, *states.shape)
    rows = jax.vmap(lambda change: derivative(change)[0] - jnp.roll(change, -1, axis=0))(unit)
    found &= uncertainty(residual, rows.reshape(states.size, -1)) < DISTINCT[dtype] / 10
    # Multiplied, so that derivatives are NaN too.
    known = jnp.where(found, 1, jnp.nan).astype(dtype)
    return Gait(
        states=states * known,
        multipliers=multipliers * known.astype(multipliers.dtype),
        step_times=times * known,
        stable=found & (jnp.abs(multipliers[0]) < 1),
        residual=residual,
        found=found,
    )


def eigenvalues(matrix: Float[Array, "n n"]) -> Complex[Array, " n"]:
    """Eigenvalues of a matrix, with derivatives up to the third order where they are distinct.

    Those that LAPACK finds are roots of the characteristic polynomial (Faddeev and LeVerrier), and
    two steps of Newton's say how these depend on the matrix.
    """
    n = len(matrix)
    minors, coefficients = jnp.zeros_like(matrix), [jnp.ones_like(matrix[0, 0])]
    for k in range(1, n + 1):
        minors = matrix @ minors + coefficients[-1] * jnp.eye(n, dtype=matrix.dtype)
        coefficients.append(-jnp.trace(matrix @ minors) / k)
    slopes = [(n - k) * c for k, c in enumerate(coefficients[:-1])]
    roots = jnp.linalg.eigvals(lax.stop_gradient(matrix))
    lower = lambda terms: [c.astype(roots.dtype) for c in terms[::-1]]
    remainder = lax.stop_gradient(evaluate(lower(coefficients), roots))
    for _ in range(2):
        miss = evaluate(lower(coefficients), roots) - remainder
        roots = roots - miss / evaluate(lower(slopes), roots)
    return roots


def mismatch(
    states: Float[Array, "period section"], args: tuple[Walker, Float[Array, ""]]
) -> Float[Array, "period section"]:
    """S(x_i) - x_{i+1} for the states of a cycle; zero for a gait."""
    walker, tolerance = args
    ends, _ = advance(walker, states, tolerance)
    return ends - jnp.roll(states, -1, axis=0)


def advance(
    walker: Walker, states: Float[Array, "n section"], tolerance: Float[Array, ""]
) -> tuple[Float[Array, "n section"], Float[Array, " n"]]:
    """The ends of strides, and their durations."""
    ends = jax.vmap(follow_stride, (None, 0, None))(walker, states, tolerance)
    return ends.state, ends.time


def uncertainty(residual, matrix):
    """How far the states of a cycle may be from those of a gait.

    As far as the residual, and rounding, move the solution of the linear equations that Newton's
    iteration solves: divided by the smallest singular value of their matrix.
    """
    linalg = jnp.linalg if isinstance(matrix, jax.Array) else np.linalg
    smallest = linalg.svd(matrix, compute_uv=False)[..., -1]
    return (residual + 4 * float(jnp.finfo(residual.dtype).eps)) / smallest


def repeats(states) -> Bool[Array | np.ndarray, "..."]:
    """Whether cycles, of shape (..., period, section), repeat themselves within their period."""
    period, numpy = states.shape[-2], jnp if isinstance(states, jax.Array) else np
    shorter = numpy.zeros(states.shape[:-2], bool)
    for shift in range(1, period):
        if period % shift == 0:
            moved = numpy.abs(states - numpy.roll(states, shift, axis=-2)).max(axis=(-2, -1))
            shorter = shorter | (moved < DISTINCT[jnp.dtype(states.dtype)])
    return shorter


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
    walker, _, tolerance = prepared(walker, starts[0], tolerance)
    # Without `strides` for a period of one, which would be one more program to compile.
    cycles = starts[:, None] if period == 1 else walked(walker, starts, period, tolerance)[1]
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
    walker, _, tolerance = prepared(walker, cycles[0, 0], tolerance)
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


def gait_at(gaits: Gait, index: int | np.integer | Bool[np.ndarray, " n"]) -> Gait:
    """One of many gaits, or some of them."""
    return Gait(*(field[index] for field in gaits))


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


def walked(
    walker: Walker, starts: Float[np.ndarray, "n section"], period: int, tolerance: Real
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m period section"]]:
    """The starts of walks of `period` strides and more, and the states of those walks.

    The walker's parameters may be arrays of n.
    """
    left = np.arange(len(starts))
    states = [starts]
    for _ in range(period):
        ends = strides(some(walker, left), states[-1], tolerance=tolerance)
        alive = ends.outcome == Outcome.STRIDE
        left = left[alive]
        states = [state[alive] for state in (*states, ends.state)]
    return left, np.stack(states[:-1], axis=1)


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
        local = linearise(some(walker, left), cycles[left], tolerance)
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
    walker, _, tolerance = prepared(walker, cycle[0, 0], tolerance)
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


def check_parameter(walker: Walker, parameter: str, *values: float) -> None:
    """Refuse a parameter that the walker does not have, and values that its constructor refuses."""
    check_kind("walker", walker, Walker)
    if not isinstance(parameter, str) or parameter not in vars(walker):
        names = ", ".join(vars(walker))
        raise WrongUse(f"parameter must be one of the walker's, {names}, not {short(parameter)}")
    if set(vars(walker)) <= set(inspect.signature(type(walker)).parameters):
        for value in values:
            type(walker)(**{**vars(walker), parameter: value})


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
    size, shared = cycles.shape[2], (tolerance, axis_of(walker, parameter, cycles.dtype))
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
    shared = tolerance, axis_of(walker, parameter, cycles.dtype)
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


def axis_of(walker: Walker, parameter: str | None, dtype) -> Walker:
    """A walker with 1 for the parameter and 0 for all others: the direction of the parameter."""
    zeros = jax.tree.map(lambda leaf: np.zeros((), dtype), walker)
    return zeros if parameter is None else with_parameter(zeros, parameter, np.ones((), dtype))


def with_parameter(walker: Walker, parameter: str, value) -> Walker:
    """The walker with another value of one parameter, unchecked; an array makes many walkers."""
    return eqx.tree_at(lambda walker: getattr(walker, parameter), walker, value)


def some(walker: Walker, indices: Int[np.ndarray, " m"]) -> Walker:
    """Some of many walkers; the one, where all have it in common."""
    return jax.tree.map(lambda leaf: leaf[indices] if np.ndim(leaf) else leaf, walker)


def cyclic(
    jacobians: Float[np.ndarray, "n period section section"], multiplier: float = 1.0
) -> Float[np.ndarray, "n size size"]:
    """The matrices of x -> (J_i x_i - x_{i+1}) over a cycle, with x_{k+1} = multiplier x_1."""
    n, period, size, _ = jacobians.shape
    matrix = np.zeros((n, period, size, period, size), jacobians.dtype)
    for i in range(period):
        following = (i + 1) % period
        matrix[:, i, :, i] += jacobians[:, i]
        matrix[:, i, :, following] -= np.eye(size) * (1.0 if following else multiplier)
    return matrix.reshape(n, period * size, period * size)


def solve(
    matrices: Float[np.ndarray, "n size size"], vectors: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "n size"]:
    """Solutions of many linear systems; of each that is singular, by least squares."""
    solutions = np.empty_like(vectors)
    singular = np.linalg.det(matrices) == 0
    regular, right = matrices[~singular], vectors[..., None]
    solutions[~singular] = np.linalg.solve(regular, right[~singular])[..., 0]
    solutions[singular] = (np.linalg.pinv(matrices[singular]) @ right[singular])[..., 0]
    return solutions


def product(
    jacobians: Float[np.ndarray, "n period section section"],
) -> Float[np.ndarray, "n section section"]:
    """J_k ... J_1, the Jacobians of whole cycles."""
    whole = jacobians[:, 0]
    for i in range(1, jacobians.shape[1]):
        whole = jacobians[:, i] @ whole
    return whole


def multipliers_of(
    whole: Float[np.ndarray, "n section section"],
) -> Complex[np.ndarray, "n section"]:
    """Eigenvalues of the Jacobians of whole cycles, the largest first."""
    values = np.linalg.eigvals(whole)
    values = values.astype(np.result_type(whole, np.complex64))
    return np.take_along_axis(values, largest_first(values), axis=-1)


def largest_first(values: Complex[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
    """The order of multipliers along the last axis; of a conjugate pair, the upper one first."""
    return np.lexsort((-np.imag(values), -np.abs(values)), axis=-1)


def distinct(gaits: Gait) -> Gait:
    """The gaits found, each once, from its state of the smallest first coordinate on."""
    chosen = gait_at(gaits, np.asarray(gaits.found))
    states, times = np.asarray(chosen.states), np.asarray(chosen.step_times)
    first = states[..., 0].argmin(axis=1)
    turns = (first[:, None] + np.arange(states.shape[1])) % states.shape[1]
    turned = np.take_along_axis(states, turns[..., None], axis=1)
    chosen = chosen._replace(states=turned, step_times=np.take_along_axis(times, turns, axis=1))
    order = np.argsort(turned[:, 0, 0], kind="stable")
    kept = []
    while len(order):
        kept.append(order[0])
        far = np.abs(turned[order] - turned[order[0]]).max(axis=(1, 2)) > DISTINCT[states.dtype]
        order = order[far]
    return Gait(*(field[kept] for field in chosen))
