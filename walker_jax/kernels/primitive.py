"""The JAX primitive that stands for a function of one cell, and its transformations.

A program becomes one primitive of JAX. It is compiled separately, and works under `jit`, `vmap`,
`scan` and every other transformation. The primitive calls machine code, on a CPU (`ffi`) and on
NVIDIA GPUs (`gpu`). On other devices, and for a function without a kernel, XLA compiles the same
function.

Each `vmap` adds an axis of cells; all cells share an operand that no `vmap` maps over. Cells are
independent, so if they are sharded, each device computes its own. `jax.export` leaves programs to
XLA, since other processes and machines run them.

The derivative of a function of one cell along directions is again a function of one cell, linear in
the directions. It has a kernel of its own, and so have derivatives of any higher order. By few
numbers, reverse mode computes the Jacobian in forward mode, column by column, and multiplies it by
the cotangents, so no loop runs backwards. By many it is a program of its own, the adjoint, if the
function's loops can be transposed (`reverse`).
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.experimental import jet
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.sharding import PartitionSpec

from walker_jax.kernels import ffi
from walker_jax.kernels.jets import push_series
from walker_jax.kernels.program import (
    MAX_PROGRAMS,
    Program,
    apply_settings,
    is_real,
    nan_allowed,
    tracing_for_kernel,
)
from walker_jax.kernels.reverse import reversing
from walker_jax.kernels.sharding import is_divided, lower_divided
from walker_jax.kernels.shared_code import call_shared

MAX_OPERATIONS = 4000, 20000
"""Most operations in a derivative along two directions at once, and along more than two.

A larger program is long: LLVM takes seconds for it, and it serves calls for many cells alone. Three
directions at once take two thirds of the time of three separate ones. Two at once take four fifths,
which seldom repays the compilation.
"""
LONGEST = 80_000
"""Most operations of a long program; in still larger derivatives every direction is a cell.

LLVM takes some five seconds. Four directions at once then take half the time of four separate ones.
"""
LONG_CELLS = 4000
"""Fewest cells of a call on a CPU for which a long program is compiled.

In other calls, and on other devices, every direction becomes a cell of its own.
"""
MOST_COPIED = 2**20
"""Most numbers, 8 MiB, of which each cell of a call gets a copy: larger ones, as the weights of
many networks that walk from many starts, would be read from memory over and over."""
MAX_DIRECTIONS = 32
"""Most directions at once: each number of directions needs a program of its own."""

kernel_p = Primitive("kernel")
kernel_p.multiple_results = True


def call_program(program: Program, leaves: Sequence[jax.Array]) -> list[jax.Array]:
    """Call a program by its primitive; within another kernel, as `shared_code` says."""
    leaves = unify_varying_axes(list(map(without_weak_type, leaves)))
    if tracing_for_kernel.value:
        if reversing.value:
            return program.function_in_reverse(*leaves)
        return call_shared(program, leaves)
    return kernel_p.bind(*leaves, program=program, mapped=(0,) * len(leaves))


def cells_shape(values: Sequence, mapped: Sequence[int]) -> tuple[int, ...]:
    """Return the lengths of the axes of cells; () for a single cell."""
    return next((np.shape(x)[:axes] for x, axes in zip(values, mapped, strict=True) if axes), ())


@kernel_p.def_impl
def compute(*operands, program: Program, mapped: tuple[int, ...]):
    """Evaluate the primitive outside `jit`: call the machine code, on one core."""
    default = jnp.zeros(()).devices()
    here = all(x.devices() == default for x in operands if isinstance(x, jax.Array))
    on_cpu = all(device.platform == "cpu" for device in default)
    cells = cells_shape(operands, mapped)
    n = math.prod(cells)
    if is_long(program) and n < LONG_CELLS:
        return compute_directions_as_cells(*operands, program=program, mapped=mapped)
    if not (here and on_cpu) or program.compiled is None:
        with nan_allowed():
            return jit_call(program, mapped)(*operands)
    run, results = program.compiled.bind(operands, list(map(bool, mapped)), n)
    run(0, n)
    with apply_settings(program.settings):  # `jnp.asarray` would compile a copy for each shape
        return [jax.device_put(result.reshape((*cells, *result.shape[1:]))) for result in results]


@functools.lru_cache(MAX_PROGRAMS)
def jit_call(program: Program, mapped: tuple[int, ...]) -> Callable:
    """Return the primitive under `jax.jit`."""
    return jax.jit(lambda *operands: kernel_p.bind(*operands, program=program, mapped=mapped))


@kernel_p.def_abstract_eval
def abstract_results(*avals, program: Program, mapped: tuple[int, ...]):
    """Return shapes, types and sharding of the results."""
    cells = cells_shape(avals, mapped)
    specs = [x.sharding.spec[:axes] for x, axes in zip(avals, mapped, strict=True) if axes]
    over = [next(filter(None, names), None) for names in zip(*specs, strict=True)]
    like = max(
        avals,
        key=lambda aval: (len(varying_axes(aval)), not aval.sharding.mesh.empty),
        default=ShapedArray((), np.dtype(bool)),
    )

    def array(shape, dtype):
        sharding = like.sharding.update(spec=PartitionSpec(*over, *[None] * len(shape)))
        shape = (*cells, *shape)
        return like.update(shape=shape, dtype=dtype, weak_type=False, sharding=sharding)

    return [array(x.shape, x.dtype) for x in program.results]


def without_weak_type(leaf) -> jax.Array:
    """Return an array of the same dtype that is not weakly typed."""
    return jax.lax.convert_element_type(leaf, leaf.dtype)


def varying_axes(aval) -> frozenset:
    """Return the mesh axes along which a value varies, within `jax.shard_map`."""
    return aval.manual_axis_type.varying


def unify_varying_axes(leaves: list) -> list:
    """Make all values vary along every mesh axis along which any of them varies."""
    axes = frozenset().union(*(varying_axes(jax.typeof(leaf)) for leaf in leaves))
    missing = [tuple(axes - varying_axes(jax.typeof(leaf))) for leaf in leaves]
    return [
        jax.lax.pcast(leaf, more, to="varying") if more else leaf
        for leaf, more in zip(leaves, missing, strict=True)
    ]


def vary_together(tree: Any) -> Any:
    """Make all arrays of a tree vary alike, as those that a loop carries must."""
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, unify_varying_axes(leaves))


def estimate_operations(program: Program, directions: int) -> int:
    """Estimate the number of operations of a program's derivative along several directions."""
    return program.size * (directions + 1)


def is_long(program: Program) -> bool:
    """Return whether a program is a derivative along several directions, and long to compile."""
    if program.origin is None or program.origin[2] == 1:
        return False
    origin, _, directions = program.origin
    return estimate_operations(origin, directions) > MAX_OPERATIONS[directions > 2]


def compute_directions_as_cells(*operands, program: Program, mapped: tuple[int, ...]) -> list:
    """Compute a derivative along several directions, each of which becomes a cell of its own.

    Those of one cell are neighbours: they take the same turns of loops, in one vector.
    """
    assert program.origin is not None
    origin, by, directions = program.origin
    cells = max(mapped)
    shape = *cells_shape(operands, mapped), directions

    def spread(i, x):
        """Return an operand with an axis of directions after those of cells."""
        x = jnp.expand_dims(x, mapped[i] + (i in program.linear))  # a tangent has one already
        return jnp.broadcast_to(x, (*shape, *x.shape[mapped[i] + 1 :]))

    over = tuple(cells + 1 if i in program.linear or axes else 0 for i, axes in enumerate(mapped))
    given = [spread(i, x) if over[i] else x for i, x in enumerate(operands)]
    outputs = kernel_p.bind(*given, program=origin.derivative(by), mapped=over)
    return [jnp.squeeze(x, cells + 1) for x in outputs]


def compute_by_xla(*operands, program: Program, mapped: tuple[int, ...]):
    """Compute the results by JAX's own primitives; those of a long program by a shorter one."""
    if is_long(program):
        return compute_directions_as_cells(*operands, program=program, mapped=mapped)
    function = program.function
    for _ in cells_shape(operands, mapped):
        function = jax.vmap(function, [0 if axes else None for axes in mapped])
    with apply_settings(program.settings), tracing_for_kernel(True):
        return function(*operands)


def lower_on_cpu(ctx, *operands, program: Program, mapped: tuple[int, ...]):
    exported = ctx.module_context.lowering_parameters.for_export
    cells = cells_shape(ctx.avals_in, mapped)  # its lengths may be symbols if exported
    few = not exported and is_long(program) and math.prod(cells) < LONG_CELLS
    if exported or few or program.compiled is None or not ffi.available():
        return lower_to_xla(ctx, *operands, program=program, mapped=mapped)
    target = ffi.target(program.compiled)
    if any(mapped) and is_divided(ctx):
        return lower_divided(ctx, operands, target, mapped, cells)
    return jax.ffi.ffi_lowering(target)(ctx, *operands)


def lower_to_xla(ctx, *operands, program: Program, mapped: tuple[int, ...]):
    """Lower to JAX's own primitives of plain arrays, as `jax.shard_map` has checked the others."""
    plain = ctx.replace(avals_in=[ShapedArray(x.shape, x.dtype) for x in ctx.avals_in])
    lower = mlir.lower_fun(compute_by_xla, multiple_results=True)
    return lower(plain, *operands, program=program, mapped=mapped)


mlir.register_lowering(kernel_p, lower_to_xla)
mlir.register_lowering(kernel_p, lower_on_cpu, platform="cpu")


def batch(operands, axes, *, program: Program, mapped: tuple[int, ...]):
    """Add an axis of cells, or of directions to a derivative mapped over its tangents alone."""
    batched = [axis is not None for axis in axes]
    pairs = list(zip(operands, axes, strict=True))
    size = next(np.shape(x)[axis] for x, axis in pairs if axis is not None)
    operands = [x if axis is None else jnp.moveaxis(x, axis, 0) for x, axis in pairs]
    if program.origin is not None and program.linear.issuperset(np.flatnonzero(batched)):
        origin, by, directions = program.origin
        count = directions * size
        most = MAX_OPERATIONS[count > 2]
        if count > 2 and (directions == 1 or is_long(program)):
            most = max(most, LONGEST)
        if count <= MAX_DIRECTIONS and estimate_operations(origin, count) <= most:
            more = origin.derivative(by, count)
            return batch_directions(operands, batched, (size, directions), more, mapped)
    each = zip(operands, mapped, batched, strict=True)
    cells = next((x.shape[over : over + own] for x, own, over in each if own), ())
    alike = [x.size for x, own, over in zip(operands, mapped, batched, strict=True) if over > own]
    copied = math.prod(cells) * sum(alike)
    if cells and isinstance(copied, int) and copied > MOST_COPIED:  # not symbolic, for an export
        return batch_one_by_one(operands, batched, program, mapped)

    def spread(x, own, over):
        """Return an operand of some cells with the axes of all cells."""
        if not own and not over:
            return x
        rest = x.shape[own + over :]
        x = x if over else x[None]
        x = x if own else jnp.expand_dims(x, range(1, 1 + len(cells)))
        return jnp.broadcast_to(x, (size, *cells, *rest))

    operands = list(map(spread, operands, mapped, batched))
    either = tuple(1 + len(cells) if a or b else 0 for a, b in zip(mapped, batched, strict=True))
    outputs = kernel_p.bind(*operands, program=program, mapped=either)
    return outputs, [0] * len(outputs)


def batch_one_by_one(operands, batched, program: Program, mapped: tuple[int, ...]):
    """Add an axis of calls, one after the other: the cells of each share some operands."""
    along = [i for i, one in enumerate(batched) if one]

    def call(some):
        values = replace_some(operands, along, some)
        return kernel_p.bind(*values, program=program, mapped=mapped)

    outputs = jax.lax.map(call, [operands[i] for i in along])
    return outputs, [0] * len(outputs)


def batch_directions(operands, batched, sizes: tuple[int, int], program: Program, mapped):
    """Merge a new axis of tangents with the directions of a derivative."""
    cells = max(mapped)

    def merge_axes(i, x):
        if i not in program.linear:
            return x
        x = x if batched[i] else jnp.broadcast_to(x, (sizes[0], *x.shape))
        x = jnp.moveaxis(x, 0, mapped[i])  # after the axes of cells
        return x.reshape(*x.shape[: mapped[i]], math.prod(sizes), *x.shape[mapped[i] + 2 :])

    operands = [merge_axes(i, x) for i, x in enumerate(operands)]
    outputs = kernel_p.bind(*operands, program=program, mapped=mapped)
    parted = [x.reshape(*x.shape[:cells], *sizes, *x.shape[cells + 1 :]) for x in outputs]
    return parted, [cells] * len(outputs)


batching.primitive_batchers[kernel_p] = batch


def push_forward(primals, tangents, *, program: Program, mapped: tuple[int, ...]):
    """Apply forward mode: one call for the results, one for their tangents."""
    along = [i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero) and is_real(t)]
    if is_long(program) and along:

        def of_some(*some):
            values = replace_some(primals, along, some)
            return compute_directions_as_cells(*values, program=program, mapped=mapped)

        return jax.jvp(of_some, [primals[i] for i in along], [tangents[i] for i in along])
    results = kernel_p.bind(*primals, program=program, mapped=mapped)
    total: list[Any] = [None] * sum(map(is_real, results))

    # A function is its own derivative in its linear operands.
    if any(i in program.linear for i in along):
        changed = [
            ad.instantiate_zeros(t) if i in program.linear else x
            for i, (x, t) in enumerate(zip(primals, tangents, strict=True))
        ]
        total = list(kernel_p.bind(*changed, program=program, mapped=mapped))
    others = tuple(i for i in along if i not in program.linear)
    if others and total:
        directions = [jnp.expand_dims(tangents[i], mapped[i]) for i in others]
        changes = kernel_p.bind(
            *primals,
            *directions,
            program=program.derivative(others),
            mapped=(*mapped, *(mapped[i] for i in others)),
        )
        changes = [jnp.squeeze(change, max(mapped)) for change in changes]
        total = [a if b is None else a + b for a, b in zip(changes, total, strict=True)]
    reals = iter(total)
    changes = [next(reals) if is_real(x) else None for x in results]
    none = lambda x: ad.Zero(jax.typeof(x).to_tangent_aval())
    return results, [none(x) if t is None else t for x, t in zip(results, changes, strict=True)]


ad.primitive_jvps[kernel_p] = push_forward
jet.jet_rules[kernel_p] = functools.partial(push_series, kernel_p)


def replace_some(operands: Sequence, places: Sequence[int], values: Sequence) -> list:
    """Return the operands with other values at some places."""
    replaced = list(operands)
    for i, value in zip(places, values, strict=True):
        replaced[i] = value
    return replaced
