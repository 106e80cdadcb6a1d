"""Checks that the methods of a user's own walker agree on the full state."""

from typing import Any

from walker_jax.checks import WrongUse


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
