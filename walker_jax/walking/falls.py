"""What a walker says of heel strikes and falls: where a foot comes down ahead, and what is a fall.

A walker says what a fall is by `falls`, true or false of each way to fall. The package's own falls
are those of a stance leg that stops or is down; a stride knows how these begin. Where a class
defines `falls` anew, an integration step ends just behind every zero of the functions that are
compared in it, its switching functions. So a fall begins at the end of a step, and no step hides
one.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.checks import WrongUse
from walker_jax.integrators.roots import derivative_of
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor import switching_series
from walker_jax.walkers.model import Scalar, Walker, is_planar
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walking.outcomes import Outcome

FAILURES = tuple(
    one.name
    for one in Outcome
    if one not in (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID)
)
"""The names that falls may have."""


def overrides(walker: Walker, name: str) -> bool:
    """Whether the class of a walker overrides a method of the package's own walkers."""
    usual = Walker if is_planar(walker) else SpatialWalker
    return getattr(type(walker), name) is not getattr(usual, name)


def has_own_falls(walker: Walker) -> bool:
    return overrides(walker, "falls")


def watched_falls(walker: Walker) -> tuple[Callable, ...]:
    """The falls at whose switching functions integration steps must end."""
    return (walker.falls,) if has_own_falls(walker) else ()


def fall_of(walker: Walker, state: Any) -> Int[Array, ""]:
    """The outcome of a walker that has fallen; `UNDECIDED` of one that has not."""
    outcome = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    for name, fallen in reversed(walker.falls(state).items()):
        outcome = jnp.where(fallen, Outcome[name], outcome).astype(jnp.int8)
    return outcome


def has_fallen(walker: Walker, state: Any) -> Bool[Array, ""]:
    return fall_of(walker, state) != Outcome.UNDECIDED


def has_own_is_ahead(walker: Walker) -> bool:
    return overrides(walker, "is_ahead")


def is_ahead_over_steps(walker: Walker, state: Any) -> Bool[Array, ""]:
    """Whether the swing foot is ahead where feet are at different heights."""
    ahead = state.phi < 0
    return ahead & walker.is_ahead(state) if has_own_is_ahead(walker) else ahead


def check_falls(walker: Walker, state: Any) -> None:
    """Refuse falls of a walker of a user's own that are not flags by the names of failures."""
    if not has_own_falls(walker):
        return
    for name, flag in jax.eval_shape(walker.falls, state).items():
        if name not in FAILURES:
            raise WrongUse(
                f"falls of {type(walker).__name__} must be named by a failure, one of "
                f"{', '.join(FAILURES)}, not {name!r}"
            )
        if flag.shape:
            raise WrongUse(
                f"falls of {type(walker).__name__} must be single flags, not {name} of shape "
                f"{flag.shape}"
            )


def makes_step(walker: Walker, state: Any) -> Bool[Array, ""]:
    """Whether a foot that comes down is at heel strike, of a walker that has not fallen."""
    return walker.is_ahead(state) & ~has_fallen(walker, state)


def ahead_by(walker: Walker, state: Any) -> Scalar:
    """How far the swing foot is ahead, zero where `is_ahead` changes: -theta by default."""
    if type(walker).is_ahead is Walker.is_ahead:
        return -state.theta
    distance = distance_to_change(walker.is_ahead, state)
    return jnp.where(walker.is_ahead(state), distance, -distance)


def distance_to_fall(walker: Walker, state: Any) -> Scalar:
    """The distance from where a fall of one's own begins or ends; infinite without any."""
    if has_own_falls(walker):
        return distance_to_change(walker.falls, state)
    return jnp.full_like(state.theta, jnp.inf)


def distance_to_change(function: Callable[[Any], Any], state: Any) -> Scalar:
    """The least absolute value of what is compared in a function that is true or false."""
    line = jax.tree.map(lambda value: [value, jnp.ones_like(value)], state)
    found = [jnp.abs(switch[0]) for switch in switching_series(function, line)]
    infinite = jnp.full_like(state.theta, jnp.inf)
    return jnp.min(jnp.stack([infinite, *found]))


def missing_slope(walker: Walker, series: PyTree[list], length: Scalar, rate: Scalar) -> Scalar:
    """Minus (ds/dt / rate)^2 / 2, of the function s whose zero is where a fall of one's own begins.

    It vanishes where s only just reaches zero. The step with this series ends there.
    """
    nearest, slope = jnp.full_like(length, jnp.inf), jnp.full_like(length, jnp.inf)
    for switch in switching_series(walker.falls, series):
        distance = jnp.abs(evaluate_polynomial(switch, length))
        nearer = distance < nearest
        slope = jnp.where(nearer, evaluate_polynomial(derivative_of(switch), length), slope)
        nearest = jnp.where(nearer, distance, nearest)
    return -((slope / rate) ** 2) / 2
