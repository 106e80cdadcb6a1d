"""Policies: actions as a function of the state."""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from walker_jax.basins.volumes import grid_of
from walker_jax.checks import WrongUse, check_kind
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.maps import Map
from walker_jax.systems.outcomes import names_in
from walker_jax.systems.system import System, check_single, code_field, numbers_of
from walker_jax.walkers.parameters import with_parameter
from walker_jax.walking.stride import stride


class Steered(Map):
    """A system whose parameters are set anew before each stride."""

    steered: Callable[[dict[str, Any]], System] = code_field()
    """The system without a policy, with values of its parameters."""

    def __init__(self, advance: Callable, steered: Callable, walker: System):
        feasible = lambda x, **parameters: steered(parameters).feasible(x)
        own = numbers_of(walker)
        super().__init__(advance, walker.section, parameters=own, feasible=feasible)
        self.steered = steered

    def advance(self, x):
        return self.f(x, **self.parameters)

    def margin(self, x):
        return self.steered(self.parameters).margin(x)

    def gait_region(self):
        return self.steered(self.parameters).gait_region()

    def further_gait_region(self):
        return self.steered(self.parameters).further_gait_region()


@functools.cache
def steered_with(failures: tuple[str, ...]) -> type[Steered]:
    """`Steered`, with the failures that a system has of its own."""
    return type("Steered", (Steered,), {"failures": failures}) if failures else Steered


def Policy(walker: System, data: xr.Dataset) -> System:
    """The system with the actions that `viable` found, chosen anew before each stride.

    In a cell with an action, parameters are interpolated linearly along each axis between the
    centres of that cell and of neighbours with actions, so they have derivatives. Elsewhere, in the
    target and off the kernel, they are the system's own: a walker in the target converges to its
    attractor.

    The result is a system like any other, with the parameters of `walker`: its basin, its
    robustness and all else are computed as usual.

    **Arguments:**

    - `walker`: the one that `viable` was given, or one like it with other parameters.
    - `data`: what `viable` returned.

    Raises `ValueError` for another data set, or one of another section.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    check_kind("data", data, xr.Dataset)
    check_dataset(data, "viability")
    section, names = names_in(data, "section"), names_in(data, "actions")
    if section != tuple(walker.section):
        raise WrongUse(
            f"data must be of the section {', '.join(walker.section)}, not of {', '.join(section)}"
        )
    for name in {*names} - {*numbers_of(walker)}:
        raise WrongUse(f"walker must have the parameter {name}, which the actions set")
    tolerance = float(data.attrs["tolerance"])
    table = np.stack([data[name].values[data["action"].values] for name in names], axis=-1)
    choose = interpolate_actions(data, table)

    def steered(parameters):
        acting = walker
        for name, value in parameters.items():
            acting = with_parameter(acting, name, value)
        return acting

    def advance(x, **parameters):
        own = jnp.stack([jnp.asarray(parameters[name], x.dtype) for name in names])
        chosen = dict(zip(names, choose(x, own), strict=True))
        return stride(steered(parameters | chosen), x, tolerance=tolerance)[:3]

    advance.__name__ = f"Steered{walker.label()}"
    return steered_with(tuple(walker.failures))(advance, steered, walker)


def interpolate_actions(
    data: xr.Dataset, table: Float[np.ndarray, "*shape parameters"]
) -> Callable[[Array, Array], Array]:
    """A function of a point and of own values of parameters: the values between cells with actions,
    and the own ones elsewhere."""
    acts = data["action"].values >= 0
    grid = grid_of(data)
    counts, d = np.array(acts.shape), acts.ndim
    flat, has = table.reshape(-1, table.shape[-1]), acts.ravel()
    steps = np.append(np.cumprod(counts[:0:-1])[::-1], 1).astype(np.int32)

    def choose(x: Float[Array, " section"], own: Float[Array, " parameters"]) -> Any:
        to = lambda values: jnp.asarray(values, x.dtype)
        values, acting = to(flat), jnp.asarray(has)
        u = grid.position(x).astype(x.dtype)
        inside = jnp.all((u >= 0) & (u < to(counts)))  # not so for NaN
        u = jnp.where(inside, u, 0.5)
        cell = jnp.clip(jnp.floor(u), 0, to(counts - 1)).astype(jnp.int32)
        held = inside & acting[(cell * steps).sum()]
        first = jnp.floor(u - 0.5)
        share = u - 0.5 - first
        total, weight = jnp.zeros_like(own), jnp.zeros((), x.dtype)
        for corner in np.ndindex(*(2,) * d):
            place = first.astype(jnp.int32) + jnp.asarray(corner, jnp.int32)
            there = jnp.clip(place, 0, jnp.asarray(counts - 1, jnp.int32))
            number = (there * steps).sum()
            near = jnp.prod(jnp.where(jnp.asarray(corner) == 1, share, 1 - share))
            near = jnp.where(acting[number] & jnp.all(place == there), near, 0)
            total = total + near * values[number]
            weight = weight + near
        return jnp.where(held, total / jnp.where(held, weight, 1), own)

    return choose
