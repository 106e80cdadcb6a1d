"""Functions of small arrays, computed as functions of scalars.

Equations are best written with vectors and matrices of two or four entries, but computed number by
number. Most of these entries are zero, one, or equal to another entry. Also, XLA vectorises over
the cells of a tile only if the numbers of one cell are not vectors themselves. `unroll` interprets
the jaxpr of a function entry by entry (`entries`), with signs apart from numbers (`signs`).
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.identity import FunctionByCode
from walker_jax.kernels.program_cache import code_of_program, identify_by_code
from walker_jax.kernels.signs import Signed
from walker_jax.kernels.stored import multiplies_long_matrices

LAYER = 32
"""Fewest entries along an axis of a product that make a function one of long arrays, as of a
network. The masses of a walker in space have 18 coordinates, and few of their products differ."""


def unroll(function: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Rewrite a function of small arrays as operations on scalars.

    Results and derivatives agree to rounding, with two exceptions. A product with an entry known to
    be zero is zero, even if the other factor is not finite. A zero may have the other sign, and so
    what depends on that sign, as 1 / 0 does. Operations that do not act entry by entry, such as
    factorisations and loops, are kept; so are functions with custom derivatives, and, in a function
    that multiplies matrices as long as those of a network, long arrays.
    """

    code = identify_by_code(function)

    def scalar(*args):
        args = jax.tree.map(jnp.asarray, args)
        if code is not None and code_of_program.value is not None:
            return unroll_once(code, *args)
        return unrolled(function, *args)

    return scalar


@partial(jax.jit, static_argnums=0, inline=True)
def unroll_once(code: FunctionByCode, *args) -> PyTree:
    """Evaluate `unrolled`, traced once for all functions with the same code."""
    return unrolled(code.value, *args)


def unrolled(function: Callable[..., PyTree], *args) -> PyTree:
    """Compute the results of a function of small arrays entry by entry."""
    leaves, structure = jax.tree.flatten(args)
    flat = lambda *leaves: function(*jax.tree.unflatten(structure, leaves))
    closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*leaves)
    entries = Signed(whole=multiplies_long_matrices(closed.jaxpr, LAYER))
    inputs = [entries.entries_of(leaf) for leaf in leaves]
    results = entries.interpret(closed, inputs)
    pairs = zip(results, jax.tree.leaves(shapes), strict=True)
    outputs = [jnp.asarray(entries.array_of(x, like)) for x, like in pairs]
    return jax.tree.unflatten(jax.tree.structure(shapes), outputs)
