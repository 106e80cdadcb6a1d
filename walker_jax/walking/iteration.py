"""The stride function over many starts, and over many strides."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, array, check_kind, check_whole, refuses_tracers
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.solvers import AnySolver, Real, default_tolerance, solved_by
from walker_jax.walkers.model import State, Walker
from walker_jax.walkers.parameters import parameters
from walker_jax.walking.outcomes import Outcome, Stride, Walk
from walker_jax.walking.stepping import follow_stride, prepare


@refuses_tracers("within them use jax.vmap(lambda x: wj.stride(walker, x))(xs)")
def strides(
    walker: Walker,
    xs: Float[ArrayLike, "n coordinates"],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
    progress: str | None = None,
) -> Stride:
    """`stride` for each of n starts, on all devices and cores; NumPy arrays.

    The walker's parameters are numbers, or arrays of n, as `jax.vmap(RoundFootWalker)(slopes)`
    makes them: then every start has a walker of its own.
    It is fastest where neighbours in `xs` are close on the section.
    `progress` is what to call the work in a progress bar, shown on a terminal only.
    """
    with solved_by(solver):
        return for_each_start(follow_stride, walker, xs, tolerance, progress)


def for_each_start(
    function: Callable,
    walker: Walker,
    xs: Float[ArrayLike, "n coordinates"],
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Any:
    """function(walker, x, tolerance) for n starts, and one walker or n; NumPy arrays."""
    check_kind("walker", walker, Walker)
    xs = array("xs", xs)
    if xs.dtype.kind not in "fiub":
        raise WrongUse(f"xs must be real numbers, not of type {xs.dtype}")
    if xs.ndim != 2:
        raise WrongUse(f"xs must have shape (n, coordinates), not {xs.shape}")
    sizes = len(walker.section), len(State._fields)
    if xs.shape[1] not in sizes:
        raise WrongUse(
            f"xs must have shape (n, {sizes[0]}), on the section {walker.section}, or "
            f"(n, {sizes[1]}), full states, not {xs.shape}"
        )
    dtype = xs.dtype if np.issubdtype(xs.dtype, np.floating) else float
    xs = xs.astype(jax.dtypes.canonicalize_dtype(dtype), copy=False)
    # Of one dtype, whatever numbers they were given as: another would be compiled anew.
    to_dtype = lambda leaf: np.asarray(leaf, xs.dtype)
    walker, finest = jax.tree.map(to_dtype, (walker, default_tolerance(xs.dtype, tolerance)))
    many = any(np.ndim(leaf) for leaf in jax.tree.leaves(walker))
    if many:
        check_parameters(walker, len(xs))
        walker = stacked(walker, len(xs), xs.dtype)
    return map_cells(function, (walker, xs, finest), (many, True, False), progress=progress)


def stacked(walker: Walker, n: int, dtype) -> Walker:
    """A walker, or n of them, with every parameter as an array of n."""
    return jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf, dtype), (n,)), walker)


def check_parameters(walker: Walker, n: int) -> None:
    """Refuse parameters that are neither one number nor n, or that a constructor refuses."""
    for name, values in vars(walker).items():
        if np.shape(values) not in ((), (n,)):
            raise WrongUse(f"{name} must be one number or {n}, not of shape {np.shape(values)}")
    for one in parameters(walker):
        values = getattr(walker, one.name)
        for value in (np.min(values), np.max(values)) if np.size(values) else ():
            one.checked(value)


def walk(
    walker: Walker,
    x: Float[ArrayLike, " section"],
    n: int,
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Walk:
    """n strides, one after the other, from x on the section. As `stride` otherwise."""
    check_whole("n", n)
    walker, x, tolerance = prepare(walker, x, tolerance)
    if x.shape != (len(walker.section),):
        raise WrongUse(f"x must be on the section {walker.section}, not of shape {x.shape}")
    with solved_by(solver):
        return follow_walk(walker, x, n, tolerance)


@partial(jax.jit, static_argnums=2)
def follow_walk(
    walker: Walker, x: Float[Array, " section"], n: int, tolerance: Float[Array, ""]
) -> Walk:
    def follow(carry, _):
        x, fate = carry
        result = follow_stride(walker, x, tolerance)
        fate = jnp.where(fate == Outcome.STRIDE, result.outcome, fate)
        return (result.state, fate), (result.state, fate, result.time)

    first = (x, jnp.asarray(Outcome.STRIDE, jnp.int8))
    _, (states, outcomes, times) = lax.scan(follow, first, length=n)
    return Walk(jnp.concatenate([x[None], states]), outcomes, times)
