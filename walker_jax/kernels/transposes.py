"""Reverse mode of kernels: the Jacobian column by column, or the adjoint of a program."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad

from walker_jax.kernels.primitive import kernel_p, replace_some
from walker_jax.kernels.program import Program, apply_settings, is_real

FEWEST_FOR_ADJOINT = 16
"""Fewest numbers by which reverse mode differentiates by a program's adjoint.

By fewer, reverse mode computes the columns of the Jacobian in forward mode. That is slower: of the
simplest walker a column takes 2.3 strides, the adjoint 2.1 for 4 numbers and 2.2 for 7, and a fifth
longer to compile. But forward mode shortens steps by the direction itself, not by the rate of a
derivative in all directions, and drops derivatives of branches that are not taken.
"""


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

    def of_direction(*cotangents):
        return kernel_p.bind(*point, *cotangents, program=adjoint, mapped=over)

    if cotangents[0].shape[cells] == 1:
        parts = of_direction(*(jnp.squeeze(ct, cells) for ct in cotangents))
        parts = [jnp.expand_dims(part, cells) for part in parts]
    else:
        parts = jax.vmap(of_direction, cells, cells)(*cotangents)
    shared = [i for i in range(len(by)) if not mapped[count + i]]
    return [part.sum(axis=range(cells)) if i in shared else part for i, part in enumerate(parts)]


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
