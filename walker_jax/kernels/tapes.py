"""Tapes: rows of numbers that one loop writes and another reads, at places that it computes.

A kernel keeps a tape in memory, not in registers, and writes it in place. So a tape that has been
written must not be read any more; only what the writing returns is. Rows are read that have been
written before. XLA has an array for it.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Int

new_tape_p, write_row_p, read_row_p = map(Primitive, ("new_tape", "write_row", "read_row"))
"""Primitives with a parameter `over`: how many axes, of directions, come before the rows."""


def new_tape(row: Array, rows: int) -> Array:
    """Return a tape of rows like this one, and with derivatives if this one has any."""
    return new_tape_p.bind(row, rows=rows, over=0)


def write_row(tape: Array, i: Int[Array, ""], row: Array) -> Array:
    """Return a tape with a row written."""
    return write_row_p.bind(tape, i, row, over=0)


def read_row(tape: Array, i: Int[Array, ""]) -> Array:
    """Return a row of a tape."""
    return read_row_p.bind(tape, i, over=0)


def compute_tape(row, *, rows: int, over: int):
    return jnp.zeros((*row.shape[:over], rows, *row.shape[over:]), row.dtype)


def compute_writing(tape, i, row, *, over: int):
    return lax.dynamic_update_index_in_dim(tape, row, i, over)


def compute_reading(tape, i, *, over: int):
    return lax.dynamic_index_in_dim(tape, i, over, keepdims=False)


def tape_shape(row, *, rows: int, over: int):
    return row.update(shape=(*row.shape[:over], rows, *row.shape[over:]), weak_type=False)


def row_shape(tape, i, *, over: int):
    return tape.update(shape=(*tape.shape[:over], *tape.shape[over + 1 :]))


for primitive, compute, shape in (
    (new_tape_p, compute_tape, tape_shape),
    (write_row_p, compute_writing, lambda tape, i, row, *, over: tape),
    (read_row_p, compute_reading, row_shape),
):
    primitive.def_impl(compute)
    primitive.def_abstract_eval(shape)
    mlir.register_lowering(primitive, mlir.lower_fun(compute, multiple_results=False))


def vary_tape(primals, tangents, **params):
    (row,), (change,) = primals, tangents
    return new_tape_p.bind(row, **params), new_tape_p.bind(change, **params)


def vary_writing(primals, tangents, *, over: int):
    (tape, i, row), (dtape, _, drow) = primals, tangents
    written = write_row_p.bind(tape, i, row, over=over)
    if isinstance(dtape, ad.Zero) and isinstance(drow, ad.Zero):
        return written, ad.Zero(jax.typeof(written).to_tangent_aval())
    drow = ad.instantiate_zeros(drow)
    if isinstance(dtape, ad.Zero):
        dtape = new_tape_p.bind(drow, rows=tape.shape[over], over=over)
    return written, write_row_p.bind(dtape, i, drow, over=over)


def vary_reading(primals, tangents, **params):
    (tape, i), (dtape, _) = primals, tangents
    found = read_row_p.bind(tape, i, **params)
    if isinstance(dtape, ad.Zero):
        return found, ad.Zero(jax.typeof(found).to_tangent_aval())
    return found, read_row_p.bind(dtape, i, **params)


ad.primitive_jvps[new_tape_p] = vary_tape
ad.primitive_jvps[write_row_p] = vary_writing
ad.primitive_jvps[read_row_p] = vary_reading


def batch(primitive: Primitive, compute) -> Any:
    """Map over directions, which share the place of a row; over cells, as JAX's own primitives."""

    def rule(operands, axes, *, over: int, **params):
        size = next(x.shape[a] for x, a in zip(operands, axes, strict=True) if a is not None)
        if len(axes) > 1 and axes[1] is not None:
            mapped = jax.vmap(lambda *one: compute(*one, over=over, **params), axes)
            return mapped(*operands), 0
        place = operands[1:2]
        moved = [
            jnp.broadcast_to(x, (size, *x.shape)) if a is None else jnp.moveaxis(x, a, 0)
            for k, (x, a) in enumerate(zip(operands, axes, strict=True))
            if k != 1
        ]
        first, *rest = moved
        return primitive.bind(first, *place, *rest, over=over + 1, **params), 0

    return rule


batching.primitive_batchers[new_tape_p] = batch(new_tape_p, compute_tape)
batching.primitive_batchers[write_row_p] = batch(write_row_p, compute_writing)
batching.primitive_batchers[read_row_p] = batch(read_row_p, compute_reading)
