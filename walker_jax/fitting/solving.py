"""The search for the least sum of squares, by Levenberg and Marquardt's method (optimistix)."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from walker_jax.fitting.residuals import (
    Data,
    Layout,
    Motion,
    Unknowns,
    residuals,
    step_residuals,
)

TOLERANCE = 1e-7
"""Last change of any residual, in standard deviations of its noise. Unknowns change last by less
than a thousandth of theirs, mostly by some 1e-5, which is what rounding errors leave."""
FIRST_TOLERANCE = 3.0
"""The same for steps that are fitted apart, whose result is a first guess."""
FIRST_DAMPING = 1e-10
"""Damping that a search begins with, over the squared length of each column of the Jacobian: next
to none, as each step is fitted already."""
ROUNDING = 1e-11
"""Rounding errors of the sum of squares, relative to it, at most."""
MOST_TURNS = 200
"""Most evaluations of the residuals in one search."""
POLISHING_TURNS = 8
"""Most turns in which the start of each step is fitted alone, before the search."""
POLISHED = 0.01
"""These turns end where no sum of squares changes by more than this share."""


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


class TrustRegion(optx.ClassicalTrustRegion):
    """Takes steps whose effect on the sum of squares is less than its rounding errors, too.

    A search that is rejected there goes on in vain, with ever more damping.
    """

    def predict_reduction(self, y_diff, f_info):
        """Compute the change of half the sum of squares that is expected of a step."""
        expected = super().predict_reduction(y_diff, f_info)
        rounding = ROUNDING * (f_info.as_min() + 1)
        return jnp.where(expected < -rounding, expected, rounding / self.low_cutoff)


@partial(jax.jit, static_argnums=0)
def solve(layout: Layout, begun: Unknowns, data: Data) -> Solved:
    """Search from `begun` on.

    Unknowns are scaled by the lengths of the Jacobian's columns there, so that the damping treats
    all alike, and the normal equations suffice: their rounding errors change the way of the search,
    not its end, and a QR decomposition takes tens of times as long.
    """
    flat, unflatten = ravel_pytree(begun)
    slopes, _ = jax.jacfwd(lambda at: residuals(layout, unflatten(at), data), has_aux=True)(flat)
    lengths = jnp.linalg.norm(slopes, axis=0)
    scale = FIRST_DAMPING**0.5 * jnp.where(lengths > 0, lengths, 1)
    place = lambda z: unflatten(flat + z / scale)
    tolerance: Any = jnp.where(data.apart, FIRST_TOLERANCE, TOLERANCE)
    method = optx.LevenbergMarquardt(ROUNDING, tolerance, linear_solver=lx.Normal(lx.Cholesky()))
    found = optx.least_squares(
        lambda z, _: residuals(layout, place(z), data),
        eqx.tree_at(lambda one: one.search, method, TrustRegion()),
        jnp.zeros_like(flat),
        has_aux=True,
        max_steps=MOST_TURNS,
        throw=False,
    )
    last = found.state.f_info  # residuals and their derivatives where the search ended
    return Solved(
        place(found.value),
        found.state.aux,
        jnp.sum(last.residual**2),
        found.result == optx.RESULTS.successful,
        found.stats["num_steps"],
        last.jac.as_matrix() * scale[None],
    )


@partial(jax.jit, static_argnums=0)
def polish_starts(
    layout: Layout, starts: Float[Array, "steps section"], values: Array, data: Data
) -> Float[Array, "steps section"]:
    """Fit the start of each step alone to its samples, with the parameters as they are.

    Each turn is one of Gauss and Newton, shortened where the last one made the fit worse.
    """
    size = starts.shape[1]

    def turn_one(known, begin, step):
        x, cost, change = known
        variables = jnp.concatenate([x + change, begin[None], values])
        found = step_residuals(layout, size, variables, step, (data.noise, data.integrator))
        now = jnp.sum(found.values**2)
        further = -jnp.linalg.lstsq(found.jacobian[:, :size], found.values)[0]
        pick = lambda a, b: jnp.where(now < cost, a, b)
        changes = (now < (1 - POLISHED) * cost) | (now > (1 + POLISHED) * cost)
        return (pick(x + change, x), pick(now, cost), pick(further, change / 4)), changes

    def turn(carry):
        known, _, turns = carry
        known, changes = jax.vmap(turn_one)(known, data.steps.begins, steps)
        return known, changes.any(), turns + 1

    steps = data.systems, *data.steps[:3], data.weights  # times, values, known
    nowhere = starts, jnp.full(len(starts), jnp.inf), jnp.zeros_like(starts)
    going = lambda carry: carry[1] & (carry[2] < POLISHING_TURNS)
    return lax.while_loop(going, turn, (nowhere, jnp.array(True), jnp.array(0)))[0][0]
