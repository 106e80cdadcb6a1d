"""Walks of disturbed walkers to their end: which come back to the gait, and by what margin."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.basins.attractor import Attractor, near
from walker_jax.basins.attractor_search import settle, with_frames
from walker_jax.checks import WrongUse, check_kind, check_precision, check_whole, short
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import find_gait
from walker_jax.integrators.solvers import default_tolerance
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walking.failure_margins import failure_margin, follow_margins
from walker_jax.walking.iteration import strides as take_strides
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.stepping import follow_step_down, follow_stride


def metric(
    walker: Walker, scale: Sequence[Any] | ArrayLike | None, along: Sequence[Any] | ArrayLike | None
) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "rank section"]]:
    """The units of a walker's section, and unit vectors at right angles in these that span `along`.

    `ValueError` for what is not of the section.
    """
    check_kind("walker", walker, Walker)
    size = len(walker.section)
    unit = np.ones(size) if scale is None else numbers_or_none(scale)
    if unit.shape != (size,) or not np.all(np.isfinite(unit) & (unit > 0)):
        raise WrongUse(f"scale must be {size} positive numbers, not {short(scale)}")
    basis = np.eye(size) if along is None else np.atleast_2d(numbers_or_none(along))
    fits = basis.ndim == 2 and basis.shape[1] == size and bool(np.isfinite(basis).all())
    if not fits or np.linalg.matrix_rank(basis) != len(basis):
        raise WrongUse(f"along must be independent vectors of the section, not {short(along)}")
    return unit, np.linalg.qr((basis / unit).T)[0].T


def numbers_or_none(values: Any) -> Float[np.ndarray, "..."]:
    """An array of them; of NaN for what is none."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        return np.array(np.nan)


def returning(
    walker: Walker, gait: Gait | None, strides: int, tolerance: float | None
) -> tuple[Float[np.ndarray, "period section"], tuple]:
    """The states of a stable gait, and what walks share that are to come back to it, checked."""
    check_kind("walker", walker, Walker)
    check_whole("strides", strides)
    gait = find_gait(walker) if gait is None else gait
    if not isinstance(gait, Gait) or not (gait.found and gait.stable):
        raise WrongUse("gait must be a stable one, and found")
    states = np.asarray(gait.states)
    check_precision(states.dtype)
    if states.shape[1:] != (len(walker.section),):
        raise WrongUse(f"gait must be one of this walker, on {', '.join(walker.section)}")
    ends = take_strides(walker, states, tolerance=tolerance).state
    miss = np.abs(ends - np.roll(states, -1, axis=0)).max()
    if not miss < near(states.dtype):
        raise WrongUse(f"gait must be one of this walker, whose strides miss it by {miss:.2g}")
    finest = default_tolerance(states.dtype, tolerance)
    cycle = Attractor(len(states), states)
    (cycle,) = with_frames(walker, [cycle], float(finest), strides)
    to_dtype = lambda leaf: np.asarray(leaf, states.dtype)
    shared = jax.tree.map(to_dtype, (walker, finest, states, cycle.boxes()))
    return states, (*shared, np.int32(strides))


def until_settled(shared: tuple, starts: Float[np.ndarray, "*starts section"]) -> tuple:
    """What walks share that may end close to any gait to which walkers come from some starts.

    Those that come to another gait are not followed to their last stride then.
    """
    walker, tolerance, states, frames, limit = shared
    own = Attractor(len(states), states, frames)
    found = settle(walker, starts.reshape(-1, states.shape[1]), float(tolerance), [own])
    gaits = [one for one in found if one.period]
    if len(gaits) > 1:
        gaits = with_frames(walker, gaits, float(tolerance), int(limit))
        states = np.concatenate([one.states for one in gaits])
        frames = np.concatenate([one.boxes() for one in gaits])
    return walker, tolerance, states, frames, limit


class EndOfWalk(NamedTuple):
    """How a walk ends."""

    back: Bool[Array, "*cells"]
    """Whether the walker has come back to its gait, or to another that it may come to."""
    outcome: Int[Array, "*cells"]
    """Of its last stride."""
    strides: Int[Array, "*cells"]
    """Those completed."""


def which_walks(fall: bool) -> Callable[[EndOfWalk], Any]:
    """Tells of walks whether they end in a fall, or whether they do not lead back."""
    check_kind("fall", fall, bool)
    none = (Outcome.STRIDE, Outcome.UNDECIDED)
    return lambda walk: ~np.isin(walk.outcome, none) if fall else ~walk.back


def end_of_walk(shared: tuple, x: Float[Array, " section"]) -> EndOfWalk:
    """Walk on until a failure, or close to a gait, or for a number of strides."""
    walker, tolerance, states, frames, limit = shared

    def is_back(x):
        away = jnp.sum(frames * (x - states)[:, None], axis=2)
        return jnp.any(jnp.max(jnp.abs(away), axis=1) < 1)

    def going(carry):
        x, outcome, count = carry
        return (outcome == Outcome.STRIDE) & (count < limit) & ~is_back(x)

    def advance(carry):
        x, _, count = carry
        result = follow_stride(walker, x, tolerance)
        made = result.outcome == Outcome.STRIDE
        return result.state, result.outcome, count + made.astype(jnp.int32)

    first = x, jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.asarray(0, jnp.int32)
    x, outcome, count = lax.while_loop(going, advance, first)
    return EndOfWalk((outcome == Outcome.STRIDE) & is_back(x), outcome, count)


def end_after_step(shared: tuple, cell: tuple) -> EndOfWalk:
    """Step down from a state of the gait, and walk on, the stride down included in the count."""
    walker, tolerance, *_ = shared
    x, drop = cell
    down = follow_step_down(walker, x, drop, tolerance)
    after = follow_stride(walker, down.state, tolerance)
    rest = end_of_walk(shared, after.state)
    outcome = jnp.where(after.outcome == Outcome.STRIDE, rest.outcome, after.outcome)
    outcome = jnp.where(down.outcome == Outcome.STRIDE, outcome, down.outcome)
    count = rest.strides + sum(
        (one.outcome == Outcome.STRIDE).astype(jnp.int32) for one in (down, after)
    )
    return EndOfWalk(rest.back & (outcome == Outcome.STRIDE), outcome, count)


def change_of_margin(shared: tuple, cell: tuple) -> Scalar:
    """Derivative of the margin of the failure that ends a walk, after a number of strides.

    It is along tangents of the walker and of the start; NaN where the walk does not end there.
    """
    walker, tolerance = shared
    x, count, tangents = cell

    def margin(walker, x):
        step = lambda _, x: follow_stride(walker, x, tolerance).state
        return failure_margin(follow_margins(walker, lax.fori_loop(0, count, step, x), tolerance))

    value, change = jax.jvp(margin, (walker, x), tangents)
    return jnp.where(jnp.isnan(value), jnp.nan, change)
