"""Heel strikes and falls, as the hooks of a walker say them.

`falls` returns functions of the state that are negative before a fall, and `is_ahead` one that is
positive where a foot that comes down takes a step.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from walker_jax.checks import WrongUse
from walker_jax.walkers.model import Walker, is_planar
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


def fall_of(walker: Walker, state: Any) -> Int[Array, ""]:
    """The outcome of a walker that has fallen; `UNDECIDED` of one that has not."""
    outcome = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    for name, value in reversed(walker.falls(state).items()):
        outcome = jnp.where(value >= 0, Outcome[name], outcome).astype(jnp.int8)
    return outcome


def has_fallen(walker: Walker, state: Any) -> Bool[Array, ""]:
    return fall_of(walker, state) != Outcome.UNDECIDED


def check_falls(walker: Walker, state: Any) -> None:
    """Refuse rules of a user's own that are not real numbers, by the names of failures."""
    kind, values = type(walker).__name__, {}
    if has_own_falls(walker):
        for name, shape in jax.eval_shape(walker.falls, state).items():
            values[f"falls of {kind}: {name}"] = shape
            if name not in FAILURES:
                raise WrongUse(
                    f"falls of {kind} must be named by a failure, one of {', '.join(FAILURES)}, "
                    f"not {name!r}"
                )
    if overrides(walker, "is_ahead"):
        values[f"is_ahead of {kind}"] = jax.eval_shape(walker.is_ahead, state)
    for label, value in values.items():
        if value.shape or not jnp.issubdtype(value.dtype, jnp.floating):
            raise WrongUse(
                f"{label} must be one real number, such as -theta, not {value.dtype} of shape "
                f"{value.shape}"
            )


def makes_step(walker: Walker, state: Any) -> Bool[Array, ""]:
    """Whether a foot that comes down is at heel strike, of a walker that has not fallen."""
    return (walker.is_ahead(state) > 0) & ~has_fallen(walker, state)
