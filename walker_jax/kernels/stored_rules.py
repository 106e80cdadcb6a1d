"""Rules for long arrays in memory (`stored`): the same as for entries, in loops over them."""

import math
from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from jax import lax

from walker_jax.kernels.elementary import tanh_float64
from walker_jax.kernels.entries import ENTRYWISE, MOVES, params_of, split_axis, unstack
from walker_jax.kernels.products import pairs_of
from walker_jax.kernels.rules import REDUCTIONS
from walker_jax.kernels.shortcuts import SHORTCUTS
from walker_jax.kernels.stored import Stored
from walker_jax.kernels.stored_products import contract

VECTORISED = {("tanh", "float64"): tanh_float64}
"""Functions of all lanes at once, by primitive and type, for which programs in registers call the C
library."""


@no_type_check  # as the emitter
def elementwise(emitter, equation, operands: list) -> list:
    """Apply a primitive to one entry after the other."""
    primitive, params = equation.primitive, equation.params
    dtypes = [variable.aval.dtype for variable in equation.invars]
    like, name = equation.outvars[0].aval, primitive.name
    same = name in ("copy", "copy_p", "stop_gradient")
    if name == "convert_element_type":
        same = np.dtype(dtypes[0]) == np.dtype(params["new_dtype"])
    if same:
        return operands
    operands = [spread(emitter, x, d, like.shape) for x, d in zip(operands, dtypes, strict=True)]
    shorter = SHORTCUTS.get(name, lambda *_: None)(*operands)
    if shorter is not None:
        return [whole(shorter, like.shape)]
    vectorised = VECTORISED.get((name, str(dtypes[0])))
    if vectorised is None:
        work = lambda entries: emitter.term(primitive, params, entries, dtypes)
    else:
        work = lambda entries: emitter.inline(vectorised, *entries, dtype=dtypes[0])
    key = name, *dtypes, *params.values()
    return [map_entries(emitter, key, work, operands, like)]


@no_type_check
def add_products(emitter, equation, operands: list) -> list:
    """Add products of entries."""
    like = equation.outvars[0].aval
    operands = [spread(emitter, x, like.dtype, like.shape) for x in operands]

    def work(entries):
        total = entries[-1] if len(entries) % 2 else 0.0
        for a, b in pairs_of(entries):
            total = emitter.add_product(total, a, b, like.dtype)
        return total

    return [map_entries(emitter, ("sum_of_products",), work, operands, like)]


@no_type_check
def map_entries(emitter, key: tuple, work: Callable, operands: list, like) -> Any:
    """Compute an array by the same work for each of its entries, once for equal operands."""
    store = emitter.store
    if not any(isinstance(x, Stored) for x in operands):
        return whole(work(operands), like.shape)

    def compute():
        result = store.allocate(like.shape, like.dtype)
        views = [result, *(x if isinstance(x, Stored) else None for x in operands)]

        def act(offsets):
            pairs = zip(operands, offsets[1:], strict=True)
            loaded: dict = {}
            entries = [load_once(store, loaded, x, offset) for x, offset in pairs]
            value = emitter.vector(work(entries), like.dtype)
            store.store(result, offsets[0], value)

        store.for_each(like.shape, views, act)
        return result

    return store.once((*key, *map(emitter.identity, operands), like.shape), compute)


@no_type_check
def load_once(store, loaded: dict, operand: Any, offset: Any) -> Any:
    """Return an operand's entry; the same value for equal operands."""
    if not isinstance(operand, Stored):
        return operand
    key = operand.key()
    if key not in loaded:
        loaded[key] = store.load(operand, offset)
    return loaded[key]


@no_type_check
def spread(emitter, operand: Any, dtype, shape: tuple[int, ...]) -> Any:
    """Return an operand in memory and in a shape, or the one entry of which it consists."""
    found = emitter.store.in_memory(operand, dtype)
    return found.view(np.broadcast_to(found.places, shape)) if isinstance(found, Stored) else found


@no_type_check
def whole(value: Any, shape: tuple[int, ...]) -> Any:
    """Return an array that may be one entry everywhere."""
    if isinstance(value, Stored):
        return value
    result = np.empty(shape, object)
    result[...] = value
    return result


def move(function: Callable) -> Callable:
    """Return the rule of a primitive that only moves entries of one array."""

    @no_type_check
    def rule(emitter, equation, operands: list) -> list:
        (operand, *rest), outputs = operands, equation.outvars
        if not isinstance(operand, Stored):
            operand = emitter.store.in_memory(operand, equation.invars[0].aval.dtype)
            if not isinstance(operand, Stored):
                return [whole(operand, one.aval.shape) for one in outputs]
        places = function(emitter, equation, [operand.places, *rest])
        if not all(map(operand.is_view, places)):
            operand = emitter.store.copied(operand)
            places = function(emitter, equation, [operand.places, *rest])
        return [operand.view(one) for one in places]

    return rule


def one_result(function: Callable) -> Callable:
    return lambda emitter, equation, operands: [
        function(operands, equation.params, equation.outvars[0].aval.shape)
    ]


def joined(name: str) -> Callable:
    """Return the rule of a primitive that joins arrays along an axis."""

    @no_type_check
    def rule(emitter, equation, operands: list) -> list:
        like = equation.outvars[0].aval
        result = emitter.store.allocate(like.shape, like.dtype)
        axis, begin = equation.params[name], 0
        for operand in operands:
            size = operand.shape[axis] if name == "dimension" else 1
            places = np.moveaxis(result.places, axis, 0)[begin : begin + size]
            places = np.moveaxis(places, 0, axis) if name == "dimension" else places[0, ...]
            emitter.store.copy(result.view(places), operand)
            begin += size
        return [result]

    return rule


@no_type_check
def reduce(emitter, equation, operands: list) -> list | None:
    """Combine the entries along some axes."""
    store, name, like = emitter.store, equation.primitive.name, equation.outvars[0].aval
    axes, (operand,) = equation.params["axes"], operands
    dtype = equation.invars[0].aval.dtype
    operand = spread(emitter, operand, dtype, operand.shape)
    if not isinstance(operand, Stored):  # of equal entries, as of zeros
        return None
    primitive = REDUCTIONS.get(name, lax.add_p)
    params = params_of(lax.add) if name == "reduce_sum" else {}
    count = math.prod(operand.shape[axis] for axis in axes)
    places = np.moveaxis(operand.places, axes, range(len(axes)))
    flat = places.reshape(count, *like.shape)
    if not operand.is_view(flat):
        operand = store.copied(operand.view(places))
        flat = operand.places.reshape(count, *like.shape)
    combine = lambda a, b: emitter.term(primitive, params, [a, b], [dtype, dtype])

    def compute():
        result = store.allocate(like.shape, like.dtype)
        store.copy(result, operand.view(flat[0, ...]))
        if count == 1:
            return result
        rest = operand.view(flat[1:])
        totals = result.view(np.broadcast_to(result.places, rest.shape))

        def act(offsets):
            total = combine(store.load(totals, offsets[0]), store.load(rest, offsets[1]))
            store.store(totals, offsets[0], emitter.vector(total, like.dtype))

        store.for_each(rest.shape, [totals, rest], act)
        return result

    return [store.once((name, emitter.identity(operand.view(flat))), compute)]


STORED_RULES: dict[str, Callable] = {
    **dict.fromkeys(sorted(ENTRYWISE), elementwise),
    **{
        name: move(one_result(MOVES[name]))
        for name in MOVES
        if name not in ("concatenate", "stack")
    },
    **dict.fromkeys((*REDUCTIONS, "reduce_sum"), reduce),
    "concatenate": joined("dimension"),
    "dot_general": contract,
    "holds_along_all": lambda emitter, equation, operands: operands,
    "split": move(split_axis),
    "stack": joined("axis"),
    "sum_of_products": add_products,
    "unstack": move(unstack),
}
"""By primitive: (emitter, equation, operands) -> results, each in memory or as entries; None where
the rule for entries must do."""
