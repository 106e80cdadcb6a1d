"""Arithmetic that propagates signs apart from numbers, to avoid negations.

Derivatives are full of signs, as that of a cosine is the negative of a sine. Here a sign passes
through products and sums until it makes a sum a difference. Results are the same to the bit, but
for the sign of a zero, and what depends on that sign.
"""

from typing import Any, no_type_check

import jax
import numpy as np
from jax import lax
from jax.extend.core import Primitive

from walker_jax.kernels.entries import Unrolling, assemble, bind_primitive, params_of
from walker_jax.kernels.jaxprs import CALLS
from walker_jax.kernels.shortcuts import is_known
from walker_jax.kernels.stored import is_long


class Negative:
    """The negative of a number that is not known."""

    __slots__ = "dtype", "of"

    def __init__(self, of: Any, dtype: Any):
        self.of, self.dtype = of, dtype


def negative(entry: Any, dtype: Any) -> Any:
    """Return the negative of an entry, without computing it."""
    if isinstance(entry, Negative):
        return entry.of
    return -entry if is_known(entry) else Negative(entry, dtype)


class Whole:
    """A long array that depends on the arguments, in place of its entries."""

    __slots__ = ("array",)

    def __init__(self, array: Any):
        self.array = array

    def ravel(self) -> "list[Whole]":
        """Return the array as one entry, which is not known."""
        return [self]


@no_type_check  # as its base
class Signed(Unrolling):
    """Interprets a jaxpr entry by entry; an entry may be a `Negative` too."""

    def __init__(self, *, whole: bool = False):
        super().__init__()
        self.whole = whole
        """Whether long arrays are kept as they are, and primitives applied to them."""

    def apply(self, equation, operands: list) -> list:
        avals = [one.aval for one in (*equation.invars, *equation.outvars)]
        entries = not (self.whole and any(map(is_long, avals)))
        if entries or equation.primitive.name in CALLS or self.all_known(operands):
            return super().apply(equation, operands)
        pairs = zip(operands, avals, strict=False)
        arrays = [self.array_of(x, aval) for x, aval in pairs]
        results = bind_primitive(equation.primitive, equation.params, arrays, now=False)
        return [self.entries_of(result) for result in results]

    def all_known(self, operands: list) -> bool:
        return all(is_known(entry) for operand in operands for entry in operand.ravel())

    def array_of(self, entries: Any, aval) -> Any:
        """Return an array of JAX."""
        if isinstance(entries, Whole):
            return entries.array
        return assemble(self.all_computed(entries), aval)

    def entries_of(self, value) -> Any:
        if self.whole and isinstance(value, jax.Array) and is_long(value):
            return Whole(value)
        return super().entries_of(value)

    def term(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        if primitive.name in SIGNED and np.dtype(dtypes[0]).kind == "f":
            return SIGNED[primitive.name](self, primitive, params, *operands, dtypes)
        return super().term(primitive, params, list(map(self.computed, operands)), dtypes)

    def computed(self, entry) -> Any:
        """Return an entry that is no `Negative`."""
        if not isinstance(entry, Negative):
            return entry
        return super().term(lax.neg_p, params_of(lax.neg, 1), [entry.of], [entry.dtype])

    def all_computed(self, entries: np.ndarray) -> np.ndarray:
        result = np.empty(entries.shape, object)
        for place in np.ndindex(entries.shape):
            result[place] = self.computed(entries[place])
        return result

    def identity(self, entry) -> tuple:
        if isinstance(entry, Negative):
            return 2, "", super().identity(entry.of)
        return super().identity(entry)

    def default_rule(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        return super().default_rule(equation, list(map(self.all_computed, operands)))

    # Rules: (primitive, parameters, operands, types) -> result.

    def negate(self, primitive, params, x, dtypes):
        return negative(x, dtypes[0])

    def multiply_or_divide(self, primitive, params, a, b, dtypes):
        minus = isinstance(a, Negative) != isinstance(b, Negative)
        sizes = [one.of if isinstance(one, Negative) else one for one in (a, b)]
        result = super().term(primitive, params, sizes, dtypes)
        return negative(result, dtypes[0]) if minus else result

    def add(self, primitive, params, a, b, dtypes):
        if isinstance(b, Negative) and isinstance(a, Negative):
            return negative(super().term(primitive, params, [a.of, b.of], dtypes), dtypes[0])
        if isinstance(a, Negative):
            a, b = b, a
        if not isinstance(b, Negative):
            return super().term(primitive, params, [a, b], dtypes)
        if is_known(a) and a == 0:
            return b
        return super().term(lax.sub_p, params_of(lax.sub), [a, b.of], dtypes)

    def subtract(self, primitive, params, a, b, dtypes):
        if isinstance(a, Negative) or isinstance(b, Negative):
            return self.add(lax.add_p, params_of(lax.add), a, negative(b, dtypes[0]), dtypes)
        return super().term(primitive, params, [a, b], dtypes)


SIGNED = {
    "add": Signed.add,
    "add_any": Signed.add,
    "div": Signed.multiply_or_divide,
    "mul": Signed.multiply_or_divide,
    "neg": Signed.negate,
    "sub": Signed.subtract,
}
"""By primitive of real numbers: the rule for entries with signs."""
