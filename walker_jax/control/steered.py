"""Systems whose parameters are chosen before each stride by a function of the state."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.systems.system import System, code_field
from walker_jax.walkers.parameters import value_of, with_values

Choice = Callable[[Float[Array, " section"], Float[Array, " parameters"]], Any]
"""Function from a state and the system's own parameters to the parameters of the next stride."""


def steer(system: System, names: tuple[str, ...], choose: Choice) -> System:
    """Return the system with parameters chosen before each stride; a walker stays a walker."""
    return remake(type(system), names, vars(system) | {"choose": choose})


class Steered(eqx.Module):
    """A part of systems whose parameters are chosen as each stride begins."""

    chosen: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the chosen parameters."""
    steered: eqx.AbstractClassVar[type[System]]
    """The system without a policy, which may have feedback of its own."""
    choose: eqx.AbstractVar[Choice]

    def during_stride(self: Any, x):
        own = jnp.stack([jnp.asarray(value_of(self, name), x.dtype) for name in self.chosen])
        plain = with_fields(self.steered, vars(self))
        chosen = with_values(plain, zip(self.chosen, self.choose(x, own), strict=True))
        return chosen.during_stride(x)

    def feasible(self, x):
        return self.during_stride(x).feasible(x)

    def margin(self, x):
        return self.during_stride(x).margin(x)

    def label(self: Any):
        return f"Steered{self.steered.label(self).removeprefix('Steered')}"

    def __reduce__(self):
        return remake, (self.steered, self.chosen, dict(vars(self)))


def remake(kind: type[System], names: tuple[str, ...], values: dict[str, Any]) -> System:
    """Rebuild a steered system from the values of its fields, which are not checked again."""
    return with_fields(steered_class(kind, names), values)


def with_fields(kind: type[System], values: dict[str, Any]) -> Any:
    """Make a system of a class from values of its fields, which are not checked again."""
    made = object.__new__(kind)
    for name in {field.name for field in dataclasses.fields(kind)} & values.keys():
        object.__setattr__(made, name, values[name])
    return made


@functools.cache
def steered_class(kind: type[System], names: tuple[str, ...]) -> type[System]:
    """Return the class of systems of a kind with some chosen parameters."""
    namespace = {
        "__annotations__": {"choose": Any},
        "__module__": __name__,
        "__doc__": f"A `{kind.__name__}` whose {', '.join(names)} is chosen before each stride.",
        "choose": code_field(kw_only=True),
        "chosen": names,
        "steered": kind,
    }
    metaclass: Any = type(kind)
    return metaclass(f"Steered{kind.__name__}", (Steered, kind), namespace)
