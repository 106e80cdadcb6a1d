"""Arithmetic with signs apart from numbers, so that hardly a number is negated.

Derivatives are full of signs, as that of a cosine is the negative of a sine. Here a sign passes
through products and sums until it makes a sum a difference. Results are the same to the bit, but
for the sign of a zero, and what depends on that sign.
"""

from typing import Any, no_type_check

import numpy as np
from jax import lax
from jax.extend.core import Primitive

from walker_jax.kernels.entries import Unrolling, params_of
from walker_jax.kernels.shortcuts import is_known


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


@no_type_check  # as its base
class Signed(Unrolling):
    """Interprets a jaxpr entry by entry; an entry may be a `Negative` too."""

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

    def keep(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        return super().keep(equation, list(map(self.all_computed, operands)))

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
