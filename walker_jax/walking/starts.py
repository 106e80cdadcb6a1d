"""The start of a stride: a walker and a point of its section, or a full state, checked."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.integrators.integrator import AnySolver, Integrator, integrator_of
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.system import AnySystem, System, check_single
from walker_jax.walkers.full_states import named
from walker_jax.walkers.masses import MultibodyMotion
from walker_jax.walkers.model import Walker
from walker_jax.walkers.phase import check_real, is_planar
from walker_jax.walkers.spatial import SpatialWalker


def prepare(
    walker: AnySystem,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    tolerance: Real | None,
    solver: AnySolver | None = None,
) -> tuple[AnySystem, Float[Array, " coordinates"], Integrator]:
    """Return walker, start and integrator, checked, in the dtype of the start."""
    check_kind("walker", walker, System)
    check_single(walker)
    x = as_floating(x)
    sizes = sizes_of_starts(walker)
    if x.ndim != 1 or x.shape[0] not in sizes:
        full = " or ".join(f"({size},)" for size in sizes[1:])
        raise WrongUse(
            f"x must have shape ({sizes[0]},), on the section {walker.section}, "
            + (f"or {full}, a full state, " if full else "")
            + f"not {x.shape}"
        )
    integrator = integrator_of(x.dtype, tolerance, solver).in_dtype(x.dtype)
    walker = jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), walker)
    return walker, x, integrator


def sizes_of_starts(walker: System) -> tuple[int, ...]:
    """Return the sizes of a section's point, and of the full states a walker may start from."""
    full = state_kinds(walker) if isinstance(walker, Walker) else []
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


def during_stride(walker: AnySystem, x: Float[Array, " coordinates"]) -> AnySystem:
    """Return the walker during the stride from x; a full state is projected on the section."""
    if not isinstance(walker, Walker) or type(walker).during_stride is Walker.during_stride:
        return walker
    x = x if on_section(walker, x) else walker.project(full_state(walker, x))
    return walker.during_stride(x)  # pyright: ignore[reportReturnType]: of the same kind


def state_kinds(walker: Walker) -> list[type]:
    """Return the kinds of full states for a start: the walker's, and its first phase's."""
    if not (phases := walker.phases()):
        return [walker.state]
    number: Any = jax.ShapeDtypeStruct((), jnp.asarray(0.0).dtype)
    like = walker.state(*[number] * len(walker.state._fields))
    return [walker.state, type(jax.eval_shape(phases[0].begin, like))]


def full_state(walker: HybridSystem, x: Float[Array, " coordinates"]) -> Any:
    """Return the full state of a start, which may be one already; of the first phase, if any."""
    if not isinstance(walker, Walker):
        return walker.lift(x)
    if on_section(walker, x):
        start = walker.lift(x)
    else:
        start = next(kind for kind in state_kinds(walker) if len(kind._fields) == len(x))(*x)
    if isinstance(start, walker.state):
        check_vector_field(walker, start)
        check_is_ahead(walker, start)
        return walker.phases()[0].begin(start) if walker.phases() else start
    return start


def is_feasible(
    walker: HybridSystem, x: Float[Array, " coordinates"], start: Any
) -> Bool[Array, ""]:
    """Return whether a stride can begin at x, with the full state `start`."""
    if not isinstance(walker, Walker) or on_section(walker, x):
        return walker.feasible(x)
    feasible = jnp.all(jnp.isfinite(x)) & (jnp.abs(start.theta) < np.pi / 2)
    if phases := walker.phases():
        feasible &= phases[0].event(start) <= 0
    return feasible


def check_vector_field(walker: Walker, start: Any) -> None:
    """Raise `WrongUse` for a user's own vector field that does not return rates."""
    if type(walker).vector_field is MultibodyMotion.vector_field:
        return
    rates = jax.eval_shape(walker.vector_field, start)
    if not isinstance(rates, walker.state) or any(np.shape(rate) for rate in rates):
        found = " ".join(eqx.tree_pformat(rates, struct_as_array=True).split())
        raise WrongUse(
            f"vector_field of {type(walker).__name__} must return the rates of its state, "
            f"{named(walker.state)}, not {found}"
        )


def overrides_is_ahead(walker: Walker) -> bool:
    """Return whether the class of a walker has a rule of its own of when a foot is ahead."""
    usual = Walker if is_planar(walker) else SpatialWalker
    return type(walker).is_ahead is not usual.is_ahead


def check_is_ahead(walker: Walker, state: Any) -> None:
    """Raise `WrongUse` for a user's own rule that is not a real number."""
    if overrides_is_ahead(walker):
        label = f"is_ahead of {type(walker).__name__}"
        check_real(label, jax.eval_shape(walker.is_ahead, state))
