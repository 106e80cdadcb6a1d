"""Products of long arrays in memory, as functions that a program calls.

All products of the same shapes, such as those of a matrix with the coefficients of a series, call
one function. It computes a few entries of the result at once, so that each entry of an operand that
is loaded serves several of them.
"""

import math
from collections.abc import Sequence
from typing import Any, no_type_check

from llvmlite import ir

from walker_jax.kernels.builder import Builder
from walker_jax.kernels.memory import ADDRESS
from walker_jax.kernels.memory import LONG as INTEGER
from walker_jax.kernels.stored import Stored, is_long_product

AT_ONCE = 8
"""Most entries of a result that are computed at once: each needs a register, and the processor adds
to the others while it waits for the last sum of one."""


@no_type_check  # as the emitter
def contract(emitter, equation, operands: list) -> list | None:
    """Multiply matrices; batch axes come first, then the free axes of either side."""
    if not is_long_product(equation) and not any(isinstance(x, Stored) for x in operands):
        return None
    store, like = emitter.store, equation.outvars[0].aval
    dtype = like.dtype
    if any(v.aval.dtype != dtype for v in equation.invars) or dtype.kind != "f":
        return None
    left, right = matrices_of(store, equation, operands)
    shape = left.shape[0], left.shape[1], right.shape[1]

    def compute():
        result = store.allocate(shape, dtype)
        multiply(emitter, left, right, result)
        return result

    result = store.once(("product", left.key(), right.key()), compute)
    return [result.view(result.places.reshape(like.shape))]


@no_type_check
def add_product(emitter, equation, operands: list, total: Stored, flag: Any) -> None:
    """Add a product of matrices to an array in memory, in the lanes of a flag."""
    left, right = matrices_of(emitter.store, equation, operands)
    shape = left.shape[0], left.shape[1], right.shape[1]
    multiply(emitter, left, right, total.view(total.places.reshape(shape)), flag)


@no_type_check
def matrices_of(store, equation, operands: list) -> list[Stored]:
    over, batches = equation.params["dimension_numbers"]
    dtype = equation.outvars[0].aval.dtype
    pairs = zip(operands, over, batches, strict=True)
    return [as_matrices(store, x, axes, batch, dtype) for x, axes, batch in pairs]


@no_type_check
def as_matrices(store, operand: Any, over: Sequence[int], batch: Sequence[int], dtype) -> Stored:
    """Return an operand as an array of the axes batch, free and contracted."""
    if not isinstance(operand, Stored):
        found = store.in_memory(operand, dtype)
        operand = found if isinstance(found, Stored) else store.copied(operand, dtype)
    free = [axis for axis in range(operand.ndim) if axis not in (*over, *batch)]
    sizes = [math.prod(operand.shape[axis] for axis in axes) for axes in (batch, free, over)]
    places = operand.places.transpose(*batch, *free, *over)
    if not operand.is_view(places.reshape(sizes)):
        operand = store.copied(operand.view(places))
        places = operand.places
    return operand.view(places.reshape(sizes))


@no_type_check
def multiply(emitter, left: Stored, right: Stored, result: Stored, flag: Any = None) -> None:
    """Call the function that fills a result, with operands as cells hold them.

    With a flag, it adds to the result in the lanes of the flag.
    """
    builder = emitter.builder
    for side in (left, right):
        if side.shared is not None:
            same, twin = side.shared
            alone = side.view(side.places)
            alone.shared = None
            with builder.if_else(same) as (then, otherwise):
                for branch, mine in ((then, twin), (otherwise, alone)):
                    with branch:
                        pair = (mine, right) if side is left else (left, mine)
                        multiply(emitter, *pair, result, flag)
            return
    key = "product", left.steps, right.steps, left.for_all, right.for_all, result.shape
    key = *key, left.shape[-1], result.dtype, flag is not None
    functions = emitter.store.functions
    if key not in functions:
        functions[key] = define(emitter, left, right, result, flag)
    pointers = list(map(emitter.store.pointer, (left, right, result)))
    builder.call(functions[key], pointers if flag is None else [*pointers, flag])


@no_type_check
def define(emitter, left: Stored, right: Stored, result: Stored, flag: Any) -> ir.Function:
    """Write a function of the pointers to both operands and the result, and of a flag if any."""
    module, caller = emitter.builder.module, emitter.builder
    flags = [] if flag is None else [flag.type]
    kind = ir.FunctionType(ir.VoidType(), [*[ADDRESS] * 3, *flags])
    function = ir.Function(module, kind, module.get_unique_name("product"))
    function.linkage = "internal"
    emitter.builder = Builder(function.append_basic_block("begin"))
    batches, rows, columns = result.shape
    height = min(rows, AT_ONCE if columns == 1 else AT_ONCE // 2)
    width = min(columns, AT_ONCE // height)
    counting = emitter.store.counting
    for top, high, above in blocks(rows, height):
        for begin, wide, before in blocks(columns, width):
            with counting(batches) as batch, counting(above) as i, counting(before) as j:
                builder = emitter.builder
                row = builder.add(builder.mul(i, INTEGER(high)), INTEGER(top))
                column = builder.add(builder.mul(j, INTEGER(wide)), INTEGER(begin))
                places = (batch, row), (batch, column), (batch, row, column)
                bases = [
                    moved(emitter, base, one, place)
                    for base, one, place in zip(
                        function.args[:3], (left, right, result), places, strict=True
                    )
                ]
                chosen = function.args[3] if flags else None
                multiply_block(emitter, (left, right, result), bases, high, wide, chosen)
    emitter.builder.ret_void()
    emitter.builder = caller
    return function


def blocks(count: int, size: int) -> list[tuple[int, int, int]]:
    """Cut a range into blocks of a size, and a smaller last one: (first, size, how many)."""
    many, rest = divmod(count, size)
    found = [(0, size, many)] if many else []
    return [*found, (many * size, rest, 1)] if rest else found


@no_type_check
def moved(emitter, base: Any, array: Stored, place: Sequence[Any]) -> Any:
    """Return the pointer to an entry at a place along the first axes."""
    offset = emitter.store.offset(place, array.steps[: len(place)])
    return base if offset is None else emitter.builder.gep(base, [offset])


@no_type_check
def multiply_block(
    emitter, arrays: Sequence[Stored], bases: Sequence, high: int, wide: int, flag: Any
):
    """Compute a block of the result, of so many rows and columns; add it where a flag is set."""
    store, (left, right, result) = emitter.store, arrays
    dtype, count = result.dtype, left.shape[-1]
    places = [(i, j) for i in range(high) for j in range(wide)]

    def turn(k, totals):
        """Add the products of one column of the left operand with one of the right."""

        def entries(array, base, number):
            base = moved(emitter, base, array, (INTEGER(0), INTEGER(0), k))
            steps = [i * array.steps[1] for i in range(number)]
            return [store.load_from(base, step, dtype, array.for_all) for step in steps]

        lefts, rights = entries(left, bases[0], high), entries(right, bases[1], wide)
        pairs = zip(totals, places, strict=True)
        return [emitter.builder.fused(lefts[i], rights[j], total) for total, (i, j) in pairs]

    steps = [i * result.steps[1] + j * result.steps[2] for i, j in places]
    totals = store.repeat(count, [emitter.vector(0.0, dtype)] * len(places), turn)
    for step, total in zip(steps, totals, strict=True):
        if flag is not None:
            old = store.load_from(bases[2], step, dtype, False)
            total = emitter.builder.select(
                flag, emitter.builder.arithmetic("fadd", old, total), old
            )
        store.store_to(bases[2], step, dtype, total)
