"""The start of a stride: a walker and a point of its section, or a full state; and its ground."""

from collections.abc import Sequence
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_kind, check_number, short
from walker_jax.integrators.integrator import AnySolver, Integrator, integrator_of
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem, has_ground
from walker_jax.systems.system import AnySystem, System, check_single
from walker_jax.systems.trees import in_dtype, with_static_functions


def prepare(
    walker: AnySystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    tolerance: Real | None,
    solver: AnySolver | None = None,
) -> tuple[AnySystem, Float[Array, " coordinates"], Integrator]:
    """Return walker, start and integrator, checked, in the dtype of the start."""
    check_kind("walker", walker, System)
    walker = with_static_functions(walker)
    check_single(walker)
    x = as_floating(x)
    check_size(walker, "x", x.shape, rank=1)
    integrator = integrator_of(x.dtype, tolerance, solver).in_dtype(x.dtype)
    walker = in_dtype(walker, x.dtype, jnp.asarray)
    return walker, x, integrator


def check_size(walker: System, name: str, shape: tuple[int, ...], rank: int) -> None:
    """Raise `WrongUse` unless a start, or each of n, is on the section, or is a full state."""
    sizes = sizes_of_starts(walker)
    if len(shape) == rank and shape[-1] in sizes:
        return
    first, *others = [f"(n, {size})" if rank == 2 else f"({size},)" for size in sizes]
    states = "full states" if rank == 2 else "a full state"
    raise WrongUse(
        f"{name} must have shape {first}, on the section {walker.section}, "
        + (f"or {' or '.join(others)}, {states}, " if others else "")
        + f"not {shape}"
    )


def sizes_of_starts(walker: System) -> tuple[int, ...]:
    """Return the sizes of a section's point, and of the full states a walker may start from."""
    full = walker.full_states() if isinstance(walker, HybridSystem) else ()
    return len(walker.section), *(len(kind._fields) for kind in full)


def as_floating(x: Any, name: str = "x") -> Float[Array, "..."]:
    """Return x as an array; a floating dtype is kept."""
    try:
        values = jnp.asarray(x)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(f"{name} must be real numbers, not {short(x)}") from None
    if jnp.iscomplexobj(values):
        raise WrongUse(f"{name} must be real, not of type {values.dtype}")
    return values if jnp.issubdtype(values.dtype, jnp.floating) else values.astype(float)


def on_section(walker: System, x: Float[Array, " coordinates"]) -> bool:
    """Return whether a start is a point of the section, and no full state."""
    return x.shape == (len(walker.section),)


def check_ground(walker: System) -> HybridSystem:
    """Raise `WrongUse` for a system without ground that may be raised."""
    if not has_ground(walker):
        raise WrongUse(f"walker must be planar, not a {type(walker).__name__}", of="walker")
    return cast("HybridSystem", walker)


def height_of_step(step: Any, dtype) -> Float[Array, ""]:
    """Return a step's height, checked."""
    if not isinstance(step, Tracer):
        check_number("step", step)
        if not abs(step) <= np.finfo(float).max:
            raise WrongUse(f"step must be one finite number, not {short(step)}")
    return jnp.asarray(step, dtype)


def during_stride(walker: AnySystem, x: Float[Array, " coordinates"]) -> AnySystem:
    """Return the walker during the stride from x; a full state is projected on the section."""
    if type(walker).during_stride is System.during_stride:
        return walker
    if isinstance(walker, HybridSystem) and not on_section(walker, x):
        x = walker.project(walker.launch(x))
    return walker.during_stride(x)
