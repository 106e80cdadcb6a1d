"""The search for the least sum of squares, by Levenberg and Marquardt's method (optimistix)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from walker_jax.fitting.residuals import (
    Data,
    Layout,
    Motion,
    Unknowns,
    follow_steps,
    residuals,
    step_residuals,
)

TOLERANCE = 1e-7
"""Change of the unknowns, in their standard deviations with all others fixed, that ends a search;
and relative change of the sum of squares."""
MOST_TURNS = 200
"""Most evaluations of the residuals in one search."""


POLISHING_TURNS = 8
"""Turns in which the start of each step is fitted alone, before the search."""


class Solved(NamedTuple):
    """The end of a search."""

    unknowns: Unknowns
    motion: Motion
    cost: Float[Array, ""]
    """The sum of squares."""
    converged: Bool[Array, ""]
    turns: Int[Array, ""]
    jacobian: Float[Array, "residuals unknowns"]
    """Derivatives of the compressed residuals by the unknowns, in their order."""


@partial(jax.jit, static_argnums=0)
def solve(layout: Layout, begun: Unknowns, data: Data) -> Solved:
    """Search from `begun` on.

    Unknowns are scaled by the lengths of the Jacobian's columns there, so that the damping treats
    all alike.
    """
    flat, unflatten = ravel_pytree(begun)
    slopes = jax.jacfwd(lambda at: residuals(layout, unflatten(at), data))(flat)
    lengths = jnp.linalg.norm(slopes, axis=0)
    scale = jnp.where(lengths > 0, lengths, 1)
    place = lambda z: unflatten(flat + z / scale)
    solver: Any = optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE)
    found = optx.least_squares(
        lambda z, _: residuals(layout, place(z), data),
        solver,
        jnp.zeros_like(flat),
        max_steps=MOST_TURNS,
        throw=False,
    )
    end = place(found.value)
    of_all = lambda at: residuals(layout, unflatten(at), data)
    at_end = ravel_pytree(end)[0]
    last = of_all(at_end)
    return Solved(
        end,
        follow_steps(layout, end, data),
        jnp.sum(last**2),
        found.result == optx.RESULTS.successful,
        found.stats["num_steps"],
        jax.jacfwd(of_all)(at_end),
    )


@partial(jax.jit, static_argnums=0)
def polish_starts(
    layout: Layout, starts: Float[Array, "steps section"], values: Array, data: Data
) -> Float[Array, "steps section"]:
    """Fit the start of each step alone to its samples, with the parameters as they are.

    Each turn is one of Gauss and Newton, shortened where the last one made the fit worse.
    """
    size = starts.shape[1]

    def polish(x, begin, step):
        def turn(_, known):
            x, cost, change = known
            variables = jnp.concatenate([x + change, begin[None], values])
            found = step_residuals(layout, size, variables, step, (data.noise, data.integrator))
            now = jnp.sum(found.values**2)
            further = -jnp.linalg.lstsq(found.jacobian[:, :size], found.values)[0]
            better = now < cost
            pick = lambda a, b: jnp.where(better, a, b)
            return pick(x + change, x), pick(now, cost), pick(further, change / 4)

        begun = x, jnp.asarray(jnp.inf), jnp.zeros_like(x)
        return lax.fori_loop(0, POLISHING_TURNS, turn, begun)[0]

    steps = data.systems, data.times, data.values, data.known, data.weights
    return jax.vmap(polish)(starts, data.begins, steps)


@partial(jax.jit, static_argnums=0)
def solve_weighted(
    layout: Layout, begun: Unknowns, data: Data, weights: Float[Array, "draws steps"]
) -> tuple[Float[Array, "draws parameters"], Bool[Array, " draws"]]:
    """Solve again with other weights of steps, all draws in one call; return the parameters."""
    again = lambda one: solve(layout, begun, data._replace(weights=one))
    found = jax.vmap(again)(weights)
    return found.motion.values, found.converged
