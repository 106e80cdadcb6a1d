"""A sum of products as one primitive of JAX.

The coefficients of a product of two power series are sums of products. In the program of a long
series most operations are such products and sums, and tracing and differentiating them one by one
would take most of the time until its first use. As one primitive, a sum is traced at once, and its
derivative is a sum of products too.
"""

import operator
from collections.abc import Sequence
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

sum_of_products_p = Primitive("sum_of_products")
"""a_1 b_1 + a_2 b_2 + ... + c, of operands a_1, b_1, a_2, b_2, ..., and c if their number is odd.

All operands have the same type, and the same shape unless they are scalars.
"""


def sum_of_products(*operands) -> Any:
    """Return a_1 b_1 + a_2 b_2 + ... + c of operands a_1, b_1, a_2, b_2, ..., and c if given.

    JAX's own operations promote and broadcast operands of several types or shapes. Within
    `jax.shard_map` they also keep track of the axes along which values vary.
    """
    if is_one_type(operands) and not jax.sharding.get_abstract_mesh().manual_axes:
        return sum_of_products_p.bind(*operands)
    return add_one_by_one(*operands)


def is_one_type(operands: Sequence) -> bool:
    """Return whether operands are arrays of one shape and one type."""
    try:
        return len({(x.shape, x.dtype) for x in operands}) == 1
    except AttributeError:  # a number of Python
        return False


def pairs_of(operands: Sequence) -> list[tuple]:
    """Return the factors of each product."""
    return list(zip(operands[::2], operands[1::2], strict=False))


def add_one_by_one(*operands):
    """Compute the sum by the operators of its operands, beginning with c."""
    start = operands[len(operands) // 2 * 2 :]
    return reduce(operator.add, [*start, *(a * b for a, b in pairs_of(operands))])


# numbers of Python, which JAX passes on as they are, give an array too
sum_of_products_p.def_impl(lambda *operands: jnp.asarray(add_one_by_one(*operands)))


@sum_of_products_p.def_abstract_eval
def abstract_sum(*avals):
    like = max(avals, key=lambda aval: (aval.ndim, len(aval.manual_axis_type.varying)))
    return like.update(weak_type=all(aval.weak_type for aval in avals))


def push_forward(operands, tangents):
    """Return the sum and its derivative: the sum of da b + a db over all pairs, and dc."""
    total, changes = sum_of_products_p.bind(*operands), []
    for (a, b), (da, db) in zip(pairs_of(operands), pairs_of(tangents), strict=True):
        for pair in ((da, b), (a, db)):
            if not any(isinstance(x, ad.Zero) for x in pair):
                changes += pair
    if len(tangents) % 2 and not isinstance(tangents[-1], ad.Zero):
        changes.append(tangents[-1])
    change = changes[0] if len(changes) == 1 else sum_of_products_p.bind(*changes)
    return total, change if change.shape == total.shape else jnp.broadcast_to(change, total.shape)


def pull_back(cotangent, *operands):
    """Return the cotangents of the operands in which the sum is linear."""
    found: list = [None] * len(operands)
    for i, x in enumerate(operands):
        if ad.is_undefined_primal(x) and not isinstance(cotangent, ad.Zero):
            alone = i == len(operands) - 1 and len(operands) % 2
            change = cotangent if alone else cotangent * operands[i ^ 1]
            found[i] = change if x.aval.shape else jnp.sum(change)
    return found


def batch(operands, axes):
    """Map over an axis. Among scalars, those that are not mapped remain scalars."""
    pairs = list(zip(operands, axes, strict=True))
    rank = max(np.ndim(x) - (axis is not None) for x, axis in pairs)
    if rank > 0:
        moved = [
            x if axis is None else lead_by(jnp.moveaxis(x, axis, 0), rank) for x, axis in pairs
        ]
        shape = jnp.broadcast_shapes(*map(np.shape, moved))  # of jax.export's symbols, too
        operands = [jnp.broadcast_to(x, shape) for x in moved]
    return sum_of_products_p.bind(*operands), 0


def lead_by(x: jax.Array, rank: int) -> jax.Array:
    """Give an array `rank` axes after its first one."""
    return x.reshape(x.shape + (1,) * (rank + 1 - x.ndim))


ad.primitive_jvps[sum_of_products_p] = push_forward
ad.primitive_transposes[sum_of_products_p] = pull_back
batching.primitive_batchers[sum_of_products_p] = batch
mlir.register_lowering(sum_of_products_p, mlir.lower_fun(add_one_by_one, multiple_results=False))
