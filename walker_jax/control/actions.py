"""Actions: values of parameters that may change from stride to stride."""

import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_kind, is_number, numbers, short
from walker_jax.grids import check_axis
from walker_jax.storage.schema import names_in_use
from walker_jax.systems.system import System, check_single
from walker_jax.walkers.parameters import check_parameter, value_of, with_values

MOST_ACTIONS = 10_000
"""Most combinations of values; a request for more is likely a mistake."""


class Actions(NamedTuple):
    """All combinations of values of some parameters, the last one fastest."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "m parameters"]
    own: int
    """Number of the action that leaves the system as it is."""

    def of(self, system: System, number: int) -> System:
        """Return the system during a stride by one of the actions."""
        dtype = jnp.result_type(float)
        arrays = (np.asarray(value, dtype) for value in self.values[number])
        return with_values(system, zip(self.names, arrays, strict=True))


def read_actions(system: System, actions: Any) -> Actions:
    """Return all combinations of the values that a user gives for each parameter.

    The system's own values are added as the last combination, unless they are among these.
    """
    check_single(system)
    check_kind("actions", actions, Mapping)
    if not actions:
        raise WrongUse("actions must name a parameter, such as {'push_off': (0, 0.1, 16)}, not {}")
    values = [values_of(name, given) for name, given in actions.items()]
    for name in (names_in_use("viability") | {"action_number"}).intersection(actions):
        raise WrongUse(f"actions must not be of {name}, as data sets have an array of that name")
    check_count(math.prod(len(row) for row in values))
    for name, row in zip(actions, values, strict=True):
        check_parameter(system, name, *row)
        if len(np.unique(row)) < len(row):
            raise WrongUse(f"actions of {name} must differ from one another")
    every = np.array(list(itertools.product(*values)))
    own = np.array([float(value_of(system, name)) for name in actions])
    among = np.flatnonzero(np.isclose(every, own, rtol=1e-12, atol=1e-15).all(axis=1))
    number = int(among[0]) if len(among) else len(every)
    every = every if len(among) else np.vstack([every, own])
    every[number] = own
    return Actions(tuple(actions), every, number)


def check_count(count: int) -> None:
    """Refuse more than `MOST_ACTIONS` combinations."""
    if count > MOST_ACTIONS:
        raise WrongUse(f"actions must be at most {MOST_ACTIONS} in all, not {count}: lower a count")


def values_of(name: str, given: Any) -> Float[np.ndarray, " values"]:
    """Return the values of a parameter, given as a list or as a range that includes both ends."""
    if isinstance(given, tuple) and len(given) == 3 and all(map(is_number, given)):
        low, high, count = check_axis(name, given)
        if count < 2:
            raise WrongUse(f"{name}={short(given)}: a range needs two values at least")
        check_count(count)
        return np.linspace(low, high, count)
    values = numbers(name, given)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise WrongUse(
            f"actions of {name} must be a tuple (low, high, count), or a list of finite values, "
            f"not {short(given)}"
        )
    return values
