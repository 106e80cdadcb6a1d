"""Checks that the methods of a user's own walker agree on the full state."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from walker_jax.checks import WrongUse
from walker_jax.walkers.phase import check_real, is_of_package


def named(state: Any) -> str:
    """Name a kind of full state, with its fields."""
    return f"{state.__name__}({', '.join(state._fields)})"


def check_full_state(kind: Any, start: Any) -> None:
    """Raise `WrongUse` for a class of walkers whose `lift` does not return its `state`.

    The same holds for methods inherited from a walker of the package with another state, unless the
    class has joints: the package's methods take any number of them.
    """
    expected = named(kind.state)
    if not isinstance(start, kind.state):
        raise WrongUse(
            f"lift of {kind.__name__} must return its state, {expected}, not a "
            f"{type(start).__name__} of {len(start)}"
        )
    if getattr(kind, "joints", ()):
        return
    for name in ("vector_field", "impact", "exchange_legs", "project"):
        owner: Any = next(base for base in kind.__mro__ if name in vars(base))
        taken = getattr(owner, "state", kind.state)  # a class that only adds methods has none
        if taken is not kind.state and owner.__module__.startswith("walker_jax."):
            raise WrongUse(
                f"{name} of {kind.__name__} must be its own, for its state {expected}: that of "
                f"{owner.__name__} takes a {taken.__name__}"
            )


def check_motion(walker: Any, state: Any) -> None:
    """Raise `WrongUse` for a user's own methods that return no rates, or no real number."""
    kind = type(walker)
    if not is_of_package(kind, "vector_field"):
        rates = jax.eval_shape(walker.vector_field, state)
        if not isinstance(rates, walker.state) or any(np.shape(rate) for rate in rates):
            found = " ".join(eqx.tree_pformat(rates, struct_as_array=True).split())
            raise WrongUse(
                f"vector_field of {kind.__name__} must return the rates of its state, "
                f"{named(walker.state)}, not {found}"
            )
    if not is_of_package(kind, "is_ahead"):
        check_real(f"is_ahead of {kind.__name__}", jax.eval_shape(walker.is_ahead, state))
