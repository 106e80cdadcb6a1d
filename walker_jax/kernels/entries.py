"""An interpreter of jaxprs that computes arrays entry by entry.

Known zeros and ones drop out, equal terms are computed once, and operations that only move entries
cost nothing.
"""

import functools
import math
from collections.abc import Callable
from itertools import product
from typing import Any, no_type_check

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive

from walker_jax.kernels.jaxprs import CALLS, Interpreter, called_function
from walker_jax.kernels.products import pairs_of
from walker_jax.kernels.shortcuts import SHORTCUTS, is_known

ENTRYWISE = frozenset(
    "abs acos acosh add add_any and asin asinh atan atan2 atanh bitcast_convert_type cbrt ceil "
    "clamp convert_element_type copy copy_p cos cosh div eq erf erfc exp exp2 expm1 floor ge gt "
    "integer_pow is_finite le le_to log log1p log2 logistic lt lt_to max min mul ne neg nextafter "
    "not one_minus_square or polynomial pow rem round rsqrt select_n shift_left "
    "shift_right_arithmetic shift_right_logical sign sin sinh sqrt square stop_gradient sub tan "
    "tanh xor".split()
)
"""Primitives that act entry by entry."""


def assemble(entries: np.ndarray, like) -> jax.Array | np.ndarray:
    """Assemble an array from its entries; a NumPy array if all of them are known."""
    if all(map(is_known, entries.ravel())):
        return np.asarray(entries.tolist(), like.dtype).reshape(like.shape)
    scalars = [jnp.asarray(entry, like.dtype) for entry in entries.ravel()]
    return jnp.stack(scalars).reshape(like.shape) if like.shape else scalars[0]


@no_type_check  # called for every number of a program: checks would take minutes
class Unrolling(Interpreter):
    """Interprets a jaxpr entry by entry: every value is a NumPy array of objects.

    An entry is a Python number where it is known, otherwise a JAX scalar.
    """

    def __init__(self):
        self.known: dict = {}
        """Results by primitive, parameters and operands, so that equal terms are computed once."""
        self.numbers: dict[int, tuple[tuple, Any]] = {}
        """By identity of a JAX scalar: its order of appearance, and the scalar."""

    def entries_of(self, value) -> np.ndarray:
        entries = np.empty(np.shape(value), object)
        if isinstance(value, (np.ndarray, np.generic, int, float, bool)):
            entries[...] = np.asarray(value).astype(object)
            return entries
        for place in np.ndindex(entries.shape):
            entries[place] = value[place] if entries.shape else value
        return entries

    def constant(self, value) -> np.ndarray:
        return self.entries_of(value if isinstance(value, jax.Array) else np.asarray(value))

    def default_rule(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Apply a primitive to whole arrays."""
        known = all(is_known(entry) for operand in operands for entry in operand.ravel())
        arrays = [assemble(x, v.aval) for x, v in zip(operands, equation.invars, strict=True)]
        results = bind_primitive(equation.primitive, equation.params, arrays, now=known)
        return [self.entries_of(result) for result in results]

    def call(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Interpret a function, once for all calls with the same operands."""
        function = called_function(equation)
        entries = [self.identity(entry) for operand in operands for entry in operand.ravel()]
        key = "call", id(function), *entries
        if key not in self.known:  # keeps the function alive, so that no other has its id
            self.known[key] = function, self.interpret(function, operands)
        return self.known[key][1]

    def entrywise(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        primitive, params = equation.primitive, equation.params
        dtypes = [variable.aval.dtype for variable in equation.invars]
        shape = equation.outvars[0].aval.shape
        result = np.empty(shape, object)
        if shape == ():  # nearly always
            result[()] = self.term(primitive, params, [x.item() for x in operands], dtypes)
            return [result]
        operands = [np.broadcast_to(operand, shape) for operand in operands]
        for place in np.ndindex(*shape):
            result[place] = self.term(primitive, params, [x[place] for x in operands], dtypes)
        return [result]

    def term(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        """Return one number; compute it unless it is known or has been computed already."""
        name = primitive.name
        if name in SHORTCUTS:
            shorter = SHORTCUTS[name](*operands)
            if shorter is not None:
                return shorter
        elif name in ("copy", "copy_p"):
            return operands[0]
        identities = [self.identity(operand) for operand in operands]
        if name in COMMUTATIVE and identities[1] < identities[0]:
            operands, identities = operands[::-1], identities[::-1]
        key = name, *identities, *dtypes, *params.values()
        result = self.known.get(key)
        if result is None:
            result = self.known[key] = self.evaluate_term(primitive, params, operands, dtypes)
        return result

    def identity(self, entry) -> tuple:
        """Return a key that equal entries share, and that sorts entries alike in every process.

        The order matters: the last bit of a sum of products depends on the order of its terms.
        """
        found = self.numbers.get(id(entry))
        if found is None:
            if is_known(entry):
                return 0, type(entry).__name__, repr(entry)
            found = self.numbers[id(entry)] = (1, "", len(self.numbers)), entry
        return found[0]

    def evaluate_term(
        self, primitive: Primitive, params: dict, operands: list, dtypes: list
    ) -> Any:
        """Apply a primitive to scalars; the result is a number if all operands are."""
        now = all(map(is_known, operands))
        if now and primitive.name in EXACT:
            return compute_exactly(primitive.name, operands, dtypes).item()
        scalars = [
            np.asarray(x, dtype) if is_known(x) else x
            for x, dtype in zip(operands, dtypes, strict=True)
        ]
        (result,) = bind_primitive(primitive, params, scalars, now=now)
        return result.item() if now else result

    def multiply(self, a, b, dtype):
        return self.term(lax.mul_p, params_of(lax.mul), [a, b], [dtype, dtype])

    def total(self, terms, dtype) -> Any:
        result = 0.0
        for term in terms:
            result = self.term(lax.add_p, params_of(lax.add), [result, term], [dtype, dtype])
        return result

    def add_products(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Evaluate a `sum_of_products` one product after the other."""
        aval = equation.outvars[0].aval
        result = np.empty(aval.shape, object)
        if aval.shape:
            operands = [np.broadcast_to(operand, aval.shape) for operand in operands]
        for place in np.ndindex(*aval.shape):
            entries = [operand[place] for operand in operands]
            total = entries[-1] if len(entries) % 2 else 0.0
            for a, b in pairs_of(entries):
                total = self.add_product(total, a, b, aval.dtype)
            result[place] = total
        return [result]

    def add_product(self, total, a, b, dtype):
        """Return total + a b."""
        return self.total([total, self.multiply(a, b, dtype)], dtype)

    def sum(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        dtype = equation.outvars[0].aval.dtype
        return self.fold(equation, operands, lambda entries: self.total(entries, dtype))

    def fold(self, equation, operands: list[np.ndarray], combine: Callable) -> list[np.ndarray]:
        """Combine the entries along the axes of a reduction."""
        axes, shape = equation.params["axes"], equation.outvars[0].aval.shape
        moved = np.moveaxis(operands[0], axes, range(len(axes)))
        result = np.empty(shape, object)
        for place in np.ndindex(*shape):
            result[place] = combine(moved[(..., *place)].ravel())
        return [result]

    def contract(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Multiply matrices; batch axes come first, then the free axes of either side."""
        dtypes = {variable.aval.dtype for variable in (*equation.invars, *equation.outvars)}
        if len(dtypes) > 1:
            return self.default_rule(equation, operands)
        (dtype,), (left, right) = dtypes, operands
        dimensions = equation.params["dimension_numbers"]
        (over_left, over_right), (batch_left, batch_right) = dimensions

        def arrange(x, over, batch):
            free = [axis for axis in range(x.ndim) if axis not in (*over, *batch)]
            sizes = [[x.shape[axis] for axis in axes] for axes in (batch, free, over)]
            matrices = x.transpose(*batch, *free, *over)
            return matrices.reshape(*map(math.prod, sizes)), sizes

        left, (batch, rows, _) = arrange(left, over_left, batch_left)
        right, (_, columns, _) = arrange(right, over_right, batch_right)
        result = np.empty((len(left), left.shape[1], right.shape[1]), object)
        for b, i, j in product(*map(range, result.shape)):
            pairs = zip(left[b, i], right[b, j], strict=True)
            result[b, i, j] = self.total((self.multiply(x, y, dtype) for x, y in pairs), dtype)
        return [result.reshape((*batch, *rows, *columns))]

    def index(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Return entries of an array at known places, all within bounds.

        If a place is computed or out of bounds, the primitive itself is applied.
        """
        entries, *indices = operands
        if not all(is_known(entry) for index in indices for entry in index.ravel()):
            return self.default_rule(equation, operands)
        params = equation.params
        numbers = np.arange(1, entries.size + 1).reshape(entries.shape)
        avals = [variable.aval for variable in equation.invars[1:]]
        indices = [assemble(x, like) for x, like in zip(indices, avals, strict=True)]
        params = params | {"fill_value": 0} if "fill_value" in params else params
        (places,) = bind_primitive(equation.primitive, params, [numbers, *indices], now=True)
        if not places.all():
            return self.default_rule(equation, operands)
        return [entries.ravel()[places.ravel() - 1].reshape(places.shape)]


COMMUTATIVE = frozenset(["mul", "add", "add_any"])
"""Primitives of two operands that may be exchanged."""


@functools.cache
def params_of(function: Callable, operands: int = 2) -> dict:
    """Return the parameters with which a JAX function of so many numbers binds its primitive."""
    number = jax.ShapeDtypeStruct((), np.float32)
    return jax.make_jaxpr(function)(*[number] * operands).eqns[0].params


def bind_primitive(primitive: Primitive, params: dict, operands, *, now: bool) -> list:
    """Bind a primitive; with `now`, evaluate it at once, to NumPy arrays."""
    if not now:
        results = primitive.bind(*operands, **primitive.get_bind_params(params))
        return list(results) if primitive.multiple_results else [results]
    if primitive.name == "convert_element_type":  # for which XLA would compile a program
        known, to = np.asarray(operands[0]), np.dtype(params["new_dtype"])
        if known.dtype.kind in "biu" or to.kind == "f":
            with np.errstate(all="ignore"):
                return [known.astype(to)]
    with jax.ensure_compile_time_eval():
        results = bind_primitive(primitive, params, [*map(jax.device_put, operands)], now=False)
        return list(map(np.asarray, results))


EXACT = {
    "abs": np.abs,
    "add": np.add,
    "add_any": np.add,
    "and": np.bitwise_and,
    "copy": np.copy,
    "eq": np.equal,
    "ge": np.greater_equal,
    "gt": np.greater,
    "is_finite": np.isfinite,
    "le": np.less_equal,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "nextafter": np.nextafter,
    "not": np.invert,
    "or": np.bitwise_or,
    "sub": np.subtract,
}
"""NumPy functions with the same results on known numbers; XLA would compile a program for each."""


def compute_exactly(name: str, operands, dtypes) -> np.ndarray:
    """Apply a primitive of `EXACT` to known numbers of these types."""
    with np.errstate(all="ignore"):
        return EXACT[name](*map(np.asarray, operands, dtypes))


def broadcast_entries(operands, params, shape):
    (operand, *_), dimensions = operands, params["broadcast_dimensions"]
    sizes = [1] * len(shape)
    for axis, size in zip(dimensions, operand.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(operand.reshape(sizes), shape)


def slice_entries(operands, params, shape):
    strides = params["strides"] or (1,) * len(shape)
    limits = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return operands[0][tuple(slice(*one) for one in limits)]


MOVES = {
    "broadcast_in_dim": broadcast_entries,
    "concatenate": lambda xs, params, shape: np.concatenate(xs, axis=params["dimension"]),
    "expand_dims": lambda xs, params, shape: xs[0].reshape(shape),
    "reshape": lambda xs, params, shape: xs[0].reshape(shape),
    "rev": lambda xs, params, shape: np.flip(xs[0], params["dimensions"]),
    "slice": slice_entries,
    "stack": lambda xs, params, shape: np.stack(xs, axis=params["axis"]),
    "squeeze": lambda xs, params, shape: xs[0].reshape(shape),
    "transpose": lambda xs, params, shape: xs[0].transpose(params["permutation"]),
}
"""Primitives that only move entries: (operands, parameters, shape) -> result."""


def entry_move(move: Callable) -> Callable:
    """Return the rule of a primitive that only moves entries."""

    def rule(unrolling, equation, operands):
        return [move(operands, equation.params, equation.outvars[0].aval.shape)]

    return rule


def pad_entries(unrolling, equation, operands):
    """Put a value around and between entries; negative padding removes entries."""
    entries, padding = operands
    for axis, (low, high, between) in enumerate(equation.params["padding_config"]):
        moved = np.moveaxis(entries, axis, 0)
        count = len(moved)
        size = max(low + count + max(count - 1, 0) * between + high, 0)
        result = np.empty((size, *moved.shape[1:]), object)
        result[...] = padding
        for i, entry in enumerate(moved):
            place = low + i * (between + 1)
            if 0 <= place < size:
                result[place] = entry
        entries = np.moveaxis(result, 0, axis)
    return [entries]


def split_axis(unrolling, equation, operands):
    ends = np.cumsum(equation.params["sizes"])[:-1]
    return np.split(operands[0], ends, axis=equation.params["axis"])


def unstack(unrolling, equation, operands):
    axis, parts = equation.params["axis"], equation.outvars
    if not parts:
        return []
    shape = parts[0].aval.shape
    return [part.reshape(shape) for part in np.split(operands[0], len(parts), axis=axis)]


Unrolling.rules = {
    **dict.fromkeys(CALLS, Unrolling.call),
    **dict.fromkeys(sorted(ENTRYWISE), Unrolling.entrywise),
    **dict.fromkeys(("dynamic_slice", "gather"), Unrolling.index),
    **{name: entry_move(move) for name, move in MOVES.items()},
    "dot_general": Unrolling.contract,
    "pad": pad_entries,
    "reduce_sum": Unrolling.sum,
    "split": split_axis,
    "holds_along_all": lambda unrolling, equation, operands: operands,
    "sum_of_products": Unrolling.add_products,
    "unstack": unstack,
}
