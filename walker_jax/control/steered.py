"""Systems whose parameters are chosen before each stride by a function of the state."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.systems.maps import Map
from walker_jax.systems.system import System, code_field, fields_of, numbers_of
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import value_of, with_values
from walker_jax.walking.stride import stride

Choice = Callable[[Float[Array, " section"], Float[Array, " parameters"]], Any]
"""Function from a state and the system's own parameters to the parameters of the next stride."""


def steer(system: System, names: tuple[str, ...], choose: Choice, tolerance: float) -> System:
    """Return the system with parameters chosen before each stride; a walker stays a walker.

    The policy of any other system is a map, whose strides have this `tolerance`.
    """
    if isinstance(system, Walker):
        return remake(type(system), names, choose, fields_of(system))

    def plain(parameters: dict[str, Any]) -> System:
        return with_values(system, parameters)

    def acting(x: Float[Array, " section"], parameters: dict[str, Any]) -> System:
        own = jnp.stack([jnp.asarray(parameters[name], x.dtype) for name in names])
        return plain(parameters | dict(zip(names, choose(x, own), strict=True)))

    def advance(x, **parameters):
        return stride(acting(x, parameters), x, tolerance=tolerance)[:3]

    advance.__name__ = f"Steered{system.label()}"
    return steered_map(tuple(system.failures))(advance, plain, acting, system)


class SteeredWalker(Walker):
    """A walker whose parameters are chosen at each heel strike."""

    chosen: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the chosen parameters."""
    steered: eqx.AbstractClassVar[type[Walker]]
    """The walker without a policy, which may have feedback of its own."""
    choose: eqx.AbstractVar[Choice]

    def during_stride(self, x):
        own = jnp.stack([jnp.asarray(value_of(self, name), x.dtype) for name in self.chosen])
        walker = with_values(self, zip(self.chosen, self.choose(x, own), strict=True))
        return self.steered.during_stride(walker, x)

    def __reduce__(self):
        values = {name: value for name, value in fields_of(self).items() if name != "choose"}
        return remake, (self.steered, self.chosen, self.choose, values)


def remake(kind: type[Walker], names: tuple[str, ...], choose: Choice, values: dict) -> Walker:
    """Rebuild a steered walker from its parameters."""
    return steered_class(kind, names)(**values | {"choose": choose})


@functools.cache
def steered_class(kind: type[Walker], names: tuple[str, ...]) -> type[Walker]:
    """Return the class of walkers of a kind with some chosen parameters."""
    namespace = {
        "__annotations__": {"choose": Any},
        "__module__": __name__,
        "__doc__": f"A `{kind.__name__}` whose {', '.join(names)} is chosen at each heel strike.",
        "choose": code_field(kw_only=True),
        "chosen": names,
        "steered": kind,
    }
    metaclass: Any = type(kind)
    return metaclass(f"Steered{kind.__name__}", (SteeredWalker, kind), namespace)


class Steered(Map):
    """A system, other than a walker, whose parameters are chosen before each stride."""

    plain: Callable[[dict[str, Any]], System] = code_field()
    """Returns the system without a policy, with these values of its parameters."""
    acting: Callable[[Any, dict[str, Any]], System] = code_field()
    """Returns the system during the stride from a point, given these values."""

    def __init__(self, advance: Callable, plain: Callable, acting: Callable, system: System):
        feasible = lambda x, **parameters: acting(x, parameters).feasible(x)
        own = numbers_of(system)
        super().__init__(advance, system.section, parameters=own, feasible=feasible)
        self.plain, self.acting = plain, acting

    def advance(self, x):
        return self.f(x, **self.parameters)

    def margin(self, x):
        return self.acting(x, self.parameters).margin(x)

    def gait_region(self):
        return self.plain(self.parameters).gait_region()

    def further_gait_region(self):
        return self.plain(self.parameters).further_gait_region()


@functools.cache
def steered_map(failures: tuple[str, ...]) -> type[Steered]:
    """Return `Steered` with a system's own failures."""
    return type("Steered", (Steered,), {"failures": failures}) if failures else Steered
