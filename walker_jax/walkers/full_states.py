"""Checks that the methods of a user's own walker agree on the full state."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from walker_jax.checks import WrongUse, is_traced
from walker_jax.systems.trees import in_dtype, is_many
from walker_jax.walkers.phase import State, check_real, is_of_package

SAMPLE_POINT = {"theta": 0.3, "thetadot": -0.5, "phidot": -0.2}
"""A point of the section at which impacts are tried; any point without symmetry would do."""
MAX_LANDING_ERROR = 1e-4
"""Largest distance from the section, relative to the largest coordinate, due to rounding."""


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


def check_lands_on_section(walker: Any) -> None:
    """Raise `WrongUse` for a user's own walker whose impact leaves the section.

    `project` would hide that. With two coordinates the projection drops phidot, so a user's own
    masses matter too. phi is not checked: the user may choose which of several legs, or spokes, is
    the next swing leg.
    """
    methods = ("impact", "exchange_legs", "project", "lift")
    methods += ("system", "swing_foot") if len(walker.section) == 2 else ()
    if all(is_of_package(type(walker), method) for method in methods):
        return
    if is_many(walker) or is_traced(walker):
        return
    arrival, after, on_section = landing(walker)
    if isinstance(after.theta, Tracer):  # of a walker made in a function that JAX transforms
        return
    size = max(abs(float(value)) for value in after)
    for name in ("theta", "thetadot", "phidot"):
        error = float(getattr(after, name) - getattr(on_section, name))
        if abs(error) > MAX_LANDING_ERROR * size:
            raise WrongUse(
                f"impact of {type(walker).__name__} must lead to its section: {name} is "
                f"{error:.3g} off it after a heel strike at theta = {float(arrival.theta):.3g}"
            )


@jax.jit
def landing(walker: Any) -> tuple[State, State, State]:
    """Return a heel strike, the state after it, legs exchanged, and its place on the section."""
    to_array = lambda value: jnp.asarray(value, jnp.result_type(float))
    walker = in_dtype(walker, jnp.result_type(float), jnp.asarray)
    start = walker.lift(
        jnp.stack([to_array(SAMPLE_POINT.get(name, 0.1)) for name in walker.section])
    )
    check_full_state(type(walker), start)
    arrival = start._replace(theta=-start.theta, phi=-2 * start.theta)
    after = walker.exchange_legs(walker.impact(arrival)[1])
    return arrival, after, walker.lift(walker.project(after))
