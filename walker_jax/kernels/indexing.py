"""Slices of arrays at computed indices, read and written by selection among all places.

An index may differ from lane to lane. Reading selects among all slices of the same shape, by
bisection of the index, so an axis of length n costs n selections for each entry. A table of known
numbers is kept in memory instead, and each lane loads its own entry. Writing selects, at every
place, between the old entry and the new one. Indices out of bounds are treated as in JAX: they are
clipped, or, for `FILL_OR_DROP`, reading returns a fill value and writing does nothing.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any, no_type_check

import jax.numpy as jnp
import numpy as np
from jax import lax
from llvmlite import ir

from walker_jax.kernels.entries import params_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive, changes_entries
from walker_jax.kernels.memory import entry_type
from walker_jax.kernels.shortcuts import is_known

BOOL = np.dtype(bool)
TABLE = 16
"""Fewest slices of known numbers for which a table in memory is used."""
MAX_ENTRIES = 128
"""Most entries of an array with computed indices; for larger arrays XLA is faster."""
COMBINATIONS = {
    "scatter": None,
    "scatter-add": (lax.add, lax.add_p),
    "scatter-sub": (lax.sub, lax.sub_p),
    "scatter-mul": (lax.mul, lax.mul_p),
    "scatter-min": (lax.min, lax.min_p),
    "scatter-max": (lax.max, lax.max_p),
}
"""How a scatter combines an entry with an update; None where the update replaces the entry."""


@no_type_check  # as the emitter
def select_entries(emitter, which, one: np.ndarray, other: np.ndarray, dtype) -> np.ndarray:
    """Select the entries of one array where a flag is true, and those of another elsewhere."""
    if is_known(which):
        return one if which else other
    result = np.empty(one.shape, object)
    for place in np.ndindex(one.shape):
        cases = other[place], one[place]
        same = cases[0] is cases[1]
        result[place] = (
            cases[0]
            if same
            else emitter.term(lax.select_n_p, {}, [which, *cases], [BOOL, dtype, dtype])
        )
    return result


@no_type_check
def compare(emitter, primitive, index, number: int, dtype) -> Any:
    return emitter.term(primitive, {}, [index, number], [dtype, np.dtype(dtype)])


@no_type_check
def conjunction(emitter, flags) -> Any:
    """Return whether all flags are true."""
    result = True
    for flag in flags:
        if is_known(flag):
            result = result if flag else False
        elif result is True:
            result = flag
        elif result is not False:
            result = emitter.term(lax.and_p, {}, [result, flag], [BOOL, BOOL])
    return result


@no_type_check
def slice_at(emitter, array: np.ndarray, axis: int, index, size: int, kind, dtype) -> np.ndarray:
    """Return array[index : index + size] along an axis, with the index clipped to its bounds."""
    last = array.shape[axis] - size

    def beginning(at: int):
        return np.take(array, range(at, at + size), axis=axis)

    def between(low: int, high: int):
        if low == high:
            return beginning(low)
        middle = (low + high) // 2
        left = compare(emitter, lax.le_p, index, middle, kind)
        return select_entries(emitter, left, between(low, middle), between(middle + 1, high), dtype)

    if is_known(index):
        return beginning(min(max(int(index), 0), last))
    if size == 1 and last >= TABLE and (tables := tables_of(emitter, array, axis, dtype)):
        return load_from_tables(emitter, tables, array, axis, index, kind, dtype)
    check_size(array)
    return between(0, last)


@no_type_check
def load_from_tables(
    emitter, tables: list, array: np.ndarray, axis: int, index, kind, dtype
) -> np.ndarray:
    """Load one slice of an array of known numbers at an index, clipped to its bounds."""
    builder, lane, long = emitter.builder, ir.IntType(32), ir.IntType(64)
    last, shape = array.shape[axis] - 1, np.delete(array.shape, axis)
    kinds = [np.dtype(kind)] * 2
    index = emitter.term(
        lax.min_p, {}, [emitter.term(lax.max_p, {}, [index, 0], kinds), last], kinds
    )
    index = builder.zext(index, ir.VectorType(long, emitter.lanes))
    element = entry_type(emitter, dtype)
    found = np.empty(shape, object)
    for place, table in zip(np.ndindex(*shape), tables, strict=True):
        vector = ir.Constant(ir.VectorType(element, emitter.lanes), ir.Undefined)
        for number in range(emitter.lanes):
            entry = builder.gep(table, [long(0), builder.extract_element(index, lane(number))])
            vector = builder.insert_element(vector, builder.load(entry), lane(number))
        found[place] = builder.trunc(vector, emitter.type(dtype)) if dtype == BOOL else vector
    return np.expand_dims(found, axis)


@no_type_check
def tables_of(emitter, array: np.ndarray, axis: int, dtype) -> list:
    """Return tables in memory along an axis of an array of known numbers; [] for other arrays."""
    key = id(array), axis
    if key not in emitter.tables:  # keeps the array alive, so that no other gets its id
        known = all(map(is_known, array.flat))
        rows = np.moveaxis(array, axis, -1).reshape(-1, array.shape[axis]) if known else ()
        tables = [put_in_memory(emitter, np.asarray(row.tolist(), dtype)) for row in rows]
        emitter.tables[key] = array, tables
    return emitter.tables[key][1]


@no_type_check
def put_in_memory(emitter, values: np.ndarray) -> Any:
    """Add a constant array to the program."""
    module, element = emitter.builder.module, entry_type(emitter, values.dtype)
    kind = ir.ArrayType(element, len(values))
    table = ir.GlobalVariable(module, kind, module.get_unique_name("table"))
    table.global_constant, table.linkage = True, "internal"
    whole = isinstance(element, ir.IntType)
    table.initializer = kind([element(int(x) if whole else x) for x in values.tolist()])
    return table


@no_type_check
def check_index_type(kind, array: np.ndarray) -> None:
    """Refuse an index of a type too small to reach the end of an array."""
    if array.size and max(array.shape) > np.iinfo(kind).max:
        raise UnsupportedPrimitive(f"{kind} indices of an array of {array.size}")


@no_type_check
def check_size(array: np.ndarray) -> None:
    if array.size > MAX_ENTRIES:
        raise UnsupportedPrimitive(f"computed indices of an array of {array.size}")


@no_type_check
def update_at(
    emitter, array: np.ndarray, window: np.ndarray, starts: list, kind, clip: bool, name: str, dtype
) -> np.ndarray:
    """Return a copy of an array, updated in a window that starts at computed indices."""
    if not all(map(is_known, starts)):
        check_size(array)
    combine = COMBINATIONS[name]
    lasts = [length - size for length, size in zip(array.shape, window.shape, strict=True)]

    def begins(index, at: int, last: int):
        """Return whether the window begins at a place, given its index."""
        if is_known(index):
            return (min(max(int(index), 0), last) if clip else int(index)) == at
        if clip and last == 0:
            return True
        compared = lax.eq_p
        if clip and at in (0, last):
            compared = lax.le_p if at == 0 else lax.ge_p
        return compare(emitter, compared, index, at, kind)

    result = array.copy()
    for corner in product(*(range(last + 1) for last in lasts)):
        here = conjunction(emitter, map(begins, starts, corner, lasts))
        if here is False:
            continue
        where = tuple(slice(at, at + size) for at, size in zip(corner, window.shape, strict=True))
        where = (*where, ...)
        new = window
        if combine is not None:
            function, primitive = combine
            new = np.empty(window.shape, object)
            for place in np.ndindex(window.shape):
                new[place] = emitter.term(
                    primitive,
                    params_of(function),
                    [array[where][place], window[place]],
                    [dtype, dtype],
                )
        result[where] = select_entries(emitter, here, new, result[where], dtype)
    return result


@no_type_check
def dynamic_slice(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    result, *starts = operands
    dtype = equation.outvars[0].aval.dtype
    for axis, size in enumerate(equation.params["slice_sizes"]):
        kind = equation.invars[1 + axis].aval.dtype
        check_index_type(kind, result)
        result = slice_at(emitter, result, axis, starts[axis][()], size, kind, dtype)
    return [result]


@no_type_check
def dynamic_update_slice(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    array, window, *starts = operands
    dtype = equation.outvars[0].aval.dtype
    starts = [start[()] for start in starts]
    kind = equation.invars[-1].aval.dtype
    return [update_at(emitter, array, window, starts, kind, True, "scatter", dtype)]


@no_type_check
def gather(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    array, indices = operands
    params, like = equation.params, equation.outvars[0].aval
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    kind = equation.invars[1].aval.dtype
    check_index_type(kind, array)
    filling = params["mode"] == lax.GatherScatterMode.FILL_OR_DROP
    dropped = (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)
    result = np.empty(like.shape, object)
    for place in np.ndindex(indices.shape[:-1]):
        chosen, inside = array, []
        for axis, batch in zip(
            numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True
        ):
            chosen = np.take(chosen, [place[batch]], axis=axis)
        for k, axis in enumerate(numbers.start_index_map):
            index, last = indices[(*place, k)], array.shape[axis] - sizes[axis]
            if filling:
                inside += [
                    compare(emitter, lax.ge_p, index, 0, kind),
                    compare(emitter, lax.le_p, index, last, kind),
                ]
            chosen = slice_at(emitter, chosen, axis, index, sizes[axis], kind, like.dtype)
        if filling:
            filler = np.full(
                chosen.shape, out_of_bounds_value(params["fill_value"], like.dtype), object
            )
            chosen = select_entries(
                emitter, conjunction(emitter, inside), chosen, filler, like.dtype
            )
        chosen = np.squeeze(chosen, dropped)
        result[window_at(place, result.ndim, numbers.offset_dims)] = chosen
    return [result]


def window_at(place: tuple[int, ...], rank: int, window: Sequence[int]) -> tuple:
    """Return the index of one window: all of the window's axes, one place on the others."""
    rest = iter(place)
    return *(slice(None) if axis in window else next(rest) for axis in range(rank)), ...


def out_of_bounds_value(value, dtype) -> bool | int | float:
    """Return the value that a gather gives for an entry out of bounds."""
    if value is not None:
        return np.asarray(value, dtype).item()
    if jnp.issubdtype(dtype, jnp.inexact):
        return float("nan")
    if dtype == BOOL:
        return True
    return int(jnp.iinfo(dtype).min if dtype.kind == "i" else jnp.iinfo(dtype).max)


@no_type_check
def scatter(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    array, indices, updates = operands
    if changes_entries(equation.primitive.name, equation.params):
        raise UnsupportedPrimitive("scatter with a function of the entries")
    numbers, kind = equation.params["dimension_numbers"], equation.invars[1].aval.dtype
    dtype = equation.outvars[0].aval.dtype
    clip = equation.params["mode"] == lax.GatherScatterMode.CLIP
    inserted = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
    for place in np.ndindex(indices.shape[:-1]):
        window = updates[window_at(place, updates.ndim, numbers.update_window_dims)]
        window = np.expand_dims(window, sorted(inserted))
        starts = [0] * array.ndim
        for axis, dim in zip(
            numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True
        ):
            starts[axis] = place[dim]
        for k, axis in enumerate(numbers.scatter_dims_to_operand_dims):
            starts[axis] = indices[(*place, k)]
        name = equation.primitive.name
        array = update_at(emitter, array, window, starts, kind, clip, name, dtype)
    return [array]
