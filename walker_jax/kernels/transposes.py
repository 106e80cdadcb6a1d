"""Reverse mode of kernels: the Jacobian column by column, or the adjoint of a program."""

import math
import os
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad

from walker_jax.kernels.ffi import CELLS_PER_PIECE
from walker_jax.kernels.primitive import cells_shape, kernel_p, replace_some
from walker_jax.kernels.program import Program, apply_settings, is_real

FEWEST_FOR_ADJOINT = 16
"""Fewest numbers by which reverse mode differentiates by a program's adjoint.

By fewer, reverse mode computes the columns of the Jacobian in forward mode. That is slower: of the
simplest walker a column takes 2.3 strides, the adjoint 2.1 for 4 numbers and 2.2 for 7, and a fifth
longer to compile. But forward mode shortens steps by the direction itself, not by the rate of a
derivative in all directions, and drops derivatives of branches that are not taken.
"""

MOST_SUMMED = 2**20
"""Most numbers, 8 MiB, of the results of a group of cells that are summed; but a group has cells
for every core."""


def pull_back(cotangents, *operands, program: Program, mapped: tuple[int, ...]):
    """Apply reverse mode: the cotangents of linear operands are those of the results times J."""
    with apply_settings(program.settings):
        return pull_back_derivative(cotangents, operands, program, mapped)


def pull_back_derivative(cotangents, operands, program: Program, mapped: tuple[int, ...]):
    """Return the cotangents of a derivative's directions, by the Jacobian of its program."""
    wanted = [i for i, x in enumerate(operands) if ad.is_undefined_primal(x)]
    given = [i for i, ct in enumerate(cotangents) if not isinstance(ct, ad.Zero)]
    if not given:
        return [None] * len(operands)
    if program.adjoint_of is not None and program.linear.issuperset(wanted):
        return pull_back_adjoint(cotangents, operands, wanted, program, mapped)
    if program.origin is None or not program.linear.issuperset(wanted):
        return pull_back_linear(cotangents, operands, wanted, program, mapped)
    origin, by, _ = program.origin
    count = len(origin.operands)
    point = operands[:count]
    some = tuple(by[i - count] for i in wanted)
    avals = [origin.operands[i] for i in some]
    shapes = [aval.shape for aval in avals]
    sizes = [math.prod(shape) for shape in shapes]
    if sum(sizes) >= FEWEST_FOR_ADJOINT:
        real = [i for i, aval in enumerate(origin.results) if is_real(aval)]
        adjoint = origin.adjoint(some, tuple(real[i] for i in given))
        if adjoint is not None:
            parts = call_adjoint(adjoint, point, [cotangents[i] for i in given], mapped)
            return replace_some([None] * len(operands), wanted, parts)
    cells, own = max(mapped), max(mapped[:count])  # axes of cells: of all, and of the point
    lacking = range(own, cells)

    def along(direction):
        """Differentiate each cell's results along one direction of all operands."""
        parts = jnp.split(direction, np.cumsum(sizes)[:-1])
        changes = kernel_p.bind(
            *point,
            *(
                part.reshape(1, *aval.shape).astype(aval.dtype)
                for part, aval in zip(parts, avals, strict=True)
            ),
            program=origin.derivative(some),
            mapped=(*mapped[:count], *[0] * len(parts)),
        )
        changes = [jnp.squeeze(changes[i], own).astype(dtype) for i in given]
        return [jnp.expand_dims(change, lacking) for change in changes]

    dtype = np.result_type(*(aval.dtype for aval in (*avals, *program.results)))
    columns = jax.vmap(along)(jnp.eye(sum(sizes), dtype=dtype))  # column, *cells, result
    total: Any = 0.0
    for i, column in zip(given, columns, strict=True):
        ct = cotangents[i].astype(dtype)  # *cells, direction, result
        result = math.prod(column.shape[1 + cells :])
        column = column.reshape(*column.shape[: 1 + cells], result)
        ct = ct.reshape(*ct.shape[: 1 + cells], result)
        # A zero cotangent drops a derivative, even if that is NaN.
        column = jnp.where((ct == 0).all(axis=-2), 0, column)
        total = total + jnp.einsum("c...r,...kr->...kc", column, ct, precision="highest")
    found: list[Any] = [None] * len(operands)
    ends = np.cumsum(sizes)
    for i, end, width, shape in zip(wanted, ends, sizes, shapes, strict=True):
        part = total[..., end - width : end]
        if not mapped[i]:
            part = part.sum(axis=range(cells))
        lead = part.shape[:-1]
        found[i] = part.reshape(*lead, *shape).astype(program.operands[i].dtype)
    return found


def call_adjoint(adjoint: Program, point: Sequence, cotangents: Sequence, mapped) -> list:
    """Return the cotangents of a derivative's directions, by the adjoint of its program."""
    assert adjoint.adjoint_of is not None
    (_, by, _), count, cells = adjoint.adjoint_of, len(point), max(mapped)
    over = (*mapped[:count], *[cells] * len(cotangents))
    shared = [not mapped[count + i] for i in range(len(by))]
    axes = [0 if one else cells for one in shared]

    def of_direction(*cotangents):
        return call_and_sum(adjoint, [*point, *cotangents], over, shared)

    if cotangents[0].shape[cells] == 1:
        parts = of_direction(*(jnp.squeeze(ct, cells) for ct in cotangents))
        return list(map(jnp.expand_dims, parts, axes))
    return jax.vmap(of_direction, cells, axes)(*cotangents)


def call_and_sum(program: Program, operands: Sequence, mapped, shared: Sequence[bool]) -> list:
    """Call a program, and sum its `shared` results over all cells.

    Results as long as the weights of a network, for each of many cells, would be written to memory
    and read from there. So cells are computed in groups, whose results fit in a cache.
    """

    def call(*operands, mapped):
        parts = kernel_p.bind(*operands, program=program, mapped=mapped)
        axes = range(max(mapped))
        return [x.sum(axes) if one else x for x, one in zip(parts, shared, strict=True)]

    cells = cells_shape(operands, mapped)
    sizes = [math.prod(x.shape) for x, one in zip(program.results, shared, strict=True) if one]
    count, size = groups_of(math.prod(cells), sum(sizes))
    if count == 1:
        return call(*operands, mapped=mapped)
    along = [i for i, axes in enumerate(mapped) if axes]
    over = tuple(min(1, axes) for axes in mapped)
    flat = [operands[i].reshape(-1, *operands[i].shape[len(cells) :]) for i in along]
    of_some = lambda some: call(*replace_some(operands, along, some), mapped=over)
    first = math.prod(cells) - (count - 1) * size
    # Cells of a group lie apart: so devices among which cells are divided have a part of each.
    split = lambda x: jnp.moveaxis(x[first:].reshape(size, count - 1, *x.shape[1:]), 1, 0)

    def add(totals, some):
        parts = of_some(some)
        pairs = [*zip(totals, parts, shared, strict=True)]
        return [a + b if one else a for a, b, one in pairs], [
            None if one else x for _, x, one in pairs
        ]

    begun = of_some([x[:first] for x in flat])
    totals, others = jax.lax.scan(add, begun, list(map(split, flat)))

    def joined(begun, x):
        x = jnp.moveaxis(x, 0, 1).reshape(size * (count - 1), *x.shape[2:])
        return jnp.concatenate([begun, x]).reshape(*cells, *x.shape[1:])

    pairs = zip(totals, others, shared, strict=True)
    return [total if one else joined(total, x) for total, x, one in pairs]


def groups_of(cells: Any, numbers: int) -> tuple[int, int]:
    """Return the number of groups of cells whose results are summed, and the size of all but one.

    There is one group of all cells on other devices than a CPU, where cells are divided by hand,
    and in an export, where their number may be a symbol.
    """
    alone = jax.default_backend() != "cpu" or not jax.sharding.get_abstract_mesh().empty
    if alone or not isinstance(cells, int) or not numbers:
        return 1, cells
    least = CELLS_PER_PIECE[0] * (os.cpu_count() or 1)
    count = max(1, cells // max(least, MOST_SUMMED // numbers))
    return count, cells // count


def pull_back_adjoint(cotangents, operands, wanted: list[int], program: Program, mapped) -> list:
    """Return the cotangents of an adjoint's cotangents: the derivative of its program."""
    assert program.adjoint_of is not None
    origin, by, of = program.adjoint_of
    count, cells = len(origin.operands), max(mapped)
    given = [i for i, ct in enumerate(cotangents) if not isinstance(ct, ad.Zero)]
    changes = kernel_p.bind(
        *operands[:count],
        *(jnp.expand_dims(cotangents[i], cells) for i in given),
        program=origin.derivative(tuple(by[i] for i in given)),
        mapped=(*mapped[:count], *[cells] * len(given)),
    )
    real = [i for i, aval in enumerate(origin.results) if is_real(aval)]
    found: list[Any] = [None] * len(operands)
    for i in wanted:
        part = jnp.squeeze(changes[real.index(of[i - count])], cells)
        found[i] = part if mapped[i] else part.sum(axis=range(cells))
    return found


def pull_back_linear(cotangents, operands, wanted: list[int], program: Program, mapped):
    """Return the cotangents of a linear function, which is its own derivative."""

    def of_wanted(*some):
        values = replace_some(operands, wanted, some)
        return kernel_p.bind(*values, program=program, mapped=mapped)

    anywhere = [jnp.zeros(operands[i].aval.shape, operands[i].aval.dtype) for i in wanted]
    _, pull = jax.vjp(of_wanted, *anywhere)
    parts = dict(zip(wanted, pull(list(map(ad.instantiate_zeros, cotangents))), strict=True))
    return [parts.get(i) for i in range(len(operands))]


ad.primitive_transposes[kernel_p] = pull_back
