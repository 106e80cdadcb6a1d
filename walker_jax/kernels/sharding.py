"""Calls of kernels for cells that are sharded over several devices: each computes its own.

XLA can divide a custom call along leading axes if its target is registered for that. All operands
and results must have these axes, and one more. A rule tells Shardy, which finds the shardings,
which axes those are.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.interpreters import mlir


def is_divided(ctx: mlir.LoweringRuleContext) -> bool:
    """Return whether XLA divides the lowered call among devices, unless `jax.shard_map` does."""
    axes: Any = ctx.module_context.axis_context
    if (mesh := getattr(axes, "mesh", None)) is not None:
        return set(axes.manual_axes) != set(mesh.axis_names)
    return getattr(axes, "num_devices", 1) > 1


def lower_divided(
    ctx: mlir.LoweringRuleContext,
    operands: Sequence,
    target: str,
    mapped: Sequence[int],
    cells: tuple[int, ...],
) -> Sequence:
    """Lower the call of a kernel for cells of this shape; each gets a copy of shared operands."""
    avals: Sequence[Any] = ctx.avals_in
    shapes = [aval.shape[axes:] or (1,) for aval, axes in zip(avals, mapped, strict=True)]

    def spread(*values):
        each = zip(values, mapped, shapes, strict=True)
        values = [x if axes else jnp.broadcast_to(x, (*cells, *shape)) for x, axes, shape in each]
        return [x.reshape(*cells, *shape) for x, shape in zip(values, shapes, strict=True)]

    wide = [
        ShapedArray((*cells, *shape), aval.dtype) for aval, shape in zip(avals, shapes, strict=True)
    ]
    given = mlir.lower_fun(spread, multiple_results=True)(ctx.replace(avals_out=wide), *operands)
    rule = sharding_rule(len(cells), *([x.shape for x in some] for some in (wide, ctx.avals_out)))
    attributes = {
        "mhlo.frontend_attributes": mlir.ir_attribute({"num_batch_dims": str(len(cells))}),
        "sdy.sharding_rule": mlir.ir.Attribute.parse(rule),
    }
    call = jax.ffi.ffi_lowering(target, extra_attributes=attributes)
    return call(ctx.replace(avals_in=wide), *given)


def sharding_rule(cells: int, operands: Sequence, results: Sequence) -> str:
    """Write Shardy's rule: the first axes are those of cells; others stay whole on every device.

    Axes of the same letter are sharded alike; Shardy's letters are i, j, ... z, z_1, z_2, ...
    """
    letters = (*map(chr, range(ord("i"), ord("z") + 1)), *map("z_{}".format, range(1, 3000)))
    others, sizes = iter(letters[cells:]), {}

    def mapping(shape):
        names = [*letters[:cells], *itertools.islice(others, len(shape) - cells)]
        sizes.update(zip(names, shape, strict=True))
        return f"[{', '.join(names)}]"

    sides = "->".join(f"({', '.join(map(mapping, side))})" for side in (operands, results))
    lengths = ", ".join(f"{name}={size}" for name, size in sizes.items())
    whole = ", ".join(name for name in sizes if name not in letters[:cells])
    return f"#sdy.op_sharding_rule<{sides} {{{lengths}}} need_replication={{{whole}}}, custom>"
