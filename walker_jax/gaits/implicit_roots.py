"""Roots of functions of several variables, with derivatives by the implicit function theorem."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from walker_jax.kernels.primitive import vary_together

Function = Callable[[Float[Array, "..."]], Float[Array, "..."]]


def find_root(function: Function, guess: Float[Array, "..."], steps: int) -> Float[Array, "..."]:
    """Return the last of Newton's iterates; it may be no root.

    Its derivatives by all that the function depends on are those of a root, dx = -J^{-1} df, of any
    order. They are NaN or infinite where J is not finite or has no inverse. Nothing is raised: one
    search that fails would end a whole batch.
    """
    return lax.custom_root(function, guess, lambda f, x: newton(f, x, steps), solve_linear)


def newton(function: Function, guess: Float[Array, "..."], steps: int) -> Float[Array, "..."]:
    """Return the last of Newton's iterates."""
    accuracy = 500 * float(jnp.finfo(guess.dtype).eps)

    def unfinished(iterate):
        made, _, going = iterate
        return going & (made < steps)

    def advance(iterate):
        made, x, _ = iterate
        value, derivative = jax.linearize(function, x)
        change = solve_linear(derivative, value)
        converged = jnp.all(jnp.abs(change) <= accuracy * (1 + jnp.abs(x)))
        return made + 1, x - change, ~converged & jnp.all(jnp.isfinite(change))

    return lax.while_loop(unfinished, advance, (0, guess, jnp.all(jnp.isfinite(guess))))[1]


def solve_linear(function: Function, values: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return where a linear function has some values."""
    basis = jnp.eye(values.size, dtype=values.dtype).reshape(-1, *values.shape)
    basis, _ = vary_together((basis, values))
    columns = jax.vmap(function)(basis).reshape(values.size, -1)
    return jnp.linalg.solve(columns.T, values.ravel()).reshape(values.shape)
