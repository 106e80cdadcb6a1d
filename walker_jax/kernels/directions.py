"""Directions of a derivative that are computed at once.

A derivative along several directions is one program, in which `jax.vmap` maps over them. What all
share, such as the steps of an integration, must not depend on one of them.
"""

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array, Bool

mapping_directions = jax.make_user_context(False)
"""True while a derivative is traced, in which `jax.vmap` maps over directions, never over cells."""

holds_along_all_p = Primitive("holds_along_all")


def holds_along_all(condition: Bool[Array, ""]) -> Bool[Array, ""]:
    """Return whether a condition holds along all directions that are computed at once."""
    return holds_along_all_p.bind(condition)


def batch(operands, axes):
    """Reduce an axis of directions; keep one of cells."""
    (condition,), (axis,) = operands, axes
    if mapping_directions.value:
        return holds_along_all_p.bind(jnp.all(condition, axis)), None
    return holds_along_all_p.bind(condition), axis


holds_along_all_p.def_impl(lambda condition: condition)
holds_along_all_p.def_abstract_eval(lambda aval: aval)
batching.primitive_batchers[holds_along_all_p] = batch
mlir.register_lowering(holds_along_all_p, lambda ctx, condition: [condition])
