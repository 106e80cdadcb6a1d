"""Arithmetic of enclosures: polynomials in the start, each with a bound on its error.

An `Enclosure` stands for a real function f of variables u_i in [-1, 1]:

    |f(u) - sum_k terms_k u^k| <= radius    for all u.

Without variables it is an interval, given by its midpoint and radius. The result of an operation
encloses all results of that operation on the functions that the operands enclose: its `radius`
includes the terms of too high a degree and all rounding errors.

Rounding. Numbers are float64, rounded to nearest. The error of one operation is at most 2^-53 of
its result; `ROUNDING` is a little more. A compiler may contract a product and a sum to one
operation; that saves a rounding, so the bounds still hold. The error of a sum of n products is at
most n 2^-53 times the sum of their absolute values, up to second order (Higham 2002, section 3.1).
Radii are sums and products of nonnegative numbers, so each operation adds a relative error of at
most 2^-53: `GROWTH` allows for 32 operations, more than any radius here takes. `TINY` covers
results so small that some or all of their digits are lost.

Arrays are those of JAX, in a traced function, or those of NumPy; all operations act elementwise. A
number that is not finite makes all later results NaN or infinite, and then no comparison proves
anything.
"""

import itertools
from collections.abc import Sequence
from functools import cache, cached_property, reduce
from operator import add
from typing import Any, NamedTuple

import jax
import numpy as np

ROUNDING = 1.001 * 2.0**-53
GROWTH = 1 + 2.0**-48
TINY = 2.0**-1000


class Space(NamedTuple):
    """Space of polynomials in some number of variables, up to a degree."""

    variables: int
    degree: int


BALLS = Space(0, 0)
"""Space without variables: that of intervals."""


@cache
def monomials(space: Space) -> list[tuple[int, ...]]:
    """Return the exponents of each monomial, ordered by degree."""
    powers = itertools.product(range(space.degree + 1), repeat=space.variables)
    return sorted((p for p in powers if sum(p) <= space.degree), key=lambda p: (sum(p), p[::-1]))


@cache
def product_table(space: Space) -> list[list[tuple[int, int]]]:
    """Return for each monomial the pairs of monomials whose product it is."""
    known = monomials(space)
    table: list[list[tuple[int, int]]] = [[] for _ in known]
    for (i, p), (j, q) in itertools.product(enumerate(known), repeat=2):
        both = tuple(map(add, p, q))
        if sum(both) <= space.degree:
            table[known.index(both)].append((i, j))
    return table


def outward(radius):
    """Enlarge a computed radius so that it is certainly not below the exact one."""
    return radius * GROWTH + TINY


def total(values: Sequence) -> Any:
    """Return the sum of those values that are not None."""
    values = [value for value in values if value is not None]
    return reduce(add, values) if values else 0.0


class Enclosure:
    """Polynomial with an error bound. A term of None is zero."""

    def __init__(self, terms: Sequence, radius: Any, space: Space, size: Any = None):
        self.terms, self.radius, self.space = tuple(terms), radius, space
        self._size = size

    @cached_property
    def sizes(self) -> list:
        """Sum of the absolute values of the terms of each degree; None if it has no terms."""
        found: list[list] = [[] for _ in range(self.space.degree + 1)]
        for powers, term in zip(monomials(self.space), self.terms, strict=True):
            if term is not None:
                found[sum(powers)].append(abs(term))
        return [total(one) if one else None for one in found]

    @cached_property
    def norm(self):
        """Sum of the absolute values of all terms."""
        return total(self.sizes)

    @property
    def size(self):
        """Norm, or an upper bound on it from the operation that made the enclosure."""
        return self.norm if self._size is None else self._size

    @property
    def midpoint(self):
        """Constant term, which is the midpoint of `range`."""
        return 0.0 if self.terms[0] is None else self.terms[0]

    @cached_property
    def spread(self):
        """Upper bound on the distance of any value from the midpoint."""
        return outward(total([*self.sizes[1:], self.radius]))

    @property
    def lower(self):
        """Lower bound on all values."""
        return downward(self.midpoint - self.spread)

    @property
    def upper(self):
        """Upper bound on all values."""
        return -downward(-self.midpoint - self.spread)

    @property
    def magnitude(self):
        """Upper bound on all absolute values."""
        return outward(self.norm + self.radius)

    def __neg__(self):
        return Enclosure(
            [None if t is None else -t for t in self.terms], self.radius, self.space, self._size
        )

    def __add__(self, other: "Enclosure | float") -> "Enclosure":
        other = as_enclosure(other, self.space)
        if is_zero(other):
            return self
        if is_zero(self):
            return other
        terms = [add_coefficients(p, q) for p, q in zip(self.terms, other.terms, strict=True)]
        size = self.size + other.size
        return Enclosure(
            terms, outward(self.radius + other.radius + ROUNDING * size), self.space, size
        )

    def __sub__(self, other: "Enclosure | float") -> "Enclosure":
        return self + (-as_enclosure(other, self.space))

    def __mul__(self, other: "Enclosure | float") -> "Enclosure":
        other = as_enclosure(other, self.space)
        space = self.space
        if is_zero(self) or is_zero(other):
            return exactly(0.0, space)
        terms, most = [], 0
        for pairs in product_table(space):
            parts = [
                self.terms[i] * other.terms[j]
                for i, j in pairs
                if self.terms[i] is not None and other.terms[j] is not None
            ]
            terms.append(reduce(add, parts) if parts else None)
            most = max(most, len(parts))
        size = self.norm * other.norm
        lost = [
            a * b
            for (g, a), (h, b) in itertools.product(enumerate(self.sizes), enumerate(other.sizes))
            if g + h > space.degree and a is not None and b is not None
        ]
        errors = [*lost, most * ROUNDING * size]
        if not is_number_zero(other.radius):
            errors.append(self.norm * other.radius)
        if not is_number_zero(self.radius):
            errors.append(self.radius * (other.norm + other.radius))
        return Enclosure(terms, outward(total(errors)), space, size)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other):
        return as_enclosure(other, self.space) + (-self)

    def __truediv__(self, other: "Enclosure | float") -> "Enclosure":
        return self * reciprocal(as_enclosure(other, self.space))

    def __rtruediv__(self, other):
        return as_enclosure(other, self.space) * reciprocal(self)

    def widened(self, radius) -> "Enclosure":
        """Return the enclosure with `radius` added to its own."""
        return Enclosure(self.terms, outward(self.radius + radius), self.space, self._size)

    def range(self) -> "Enclosure":
        """Return an interval that holds all values."""
        return Enclosure([self.midpoint], self.spread, BALLS)

    def __repr__(self):
        return f"Enclosure({self.terms}, radius={self.radius}, {self.space})"


jax.tree_util.register_pytree_node(
    Enclosure,
    lambda one: ((one.terms, one.radius), one.space),
    lambda space, parts: Enclosure(*parts, space),
)


def downward(value):
    """Reduce a computed number so that it is certainly not above the exact one."""
    return value - (abs(value) * (4 * ROUNDING) + TINY)


def add_coefficients(p, q):
    return q if p is None else p if q is None else p + q


def is_number_zero(value) -> bool:
    return isinstance(value, float) and bool(value == 0)


def is_zero(one: Enclosure) -> bool:
    """Return whether an enclosure is known to be zero while a function is traced."""
    return is_number_zero(one.radius) and all(t is None for t in one.terms)


def is_enclosure(value: Any) -> bool:
    return isinstance(value, Enclosure)


def exactly(value, space: Space) -> Enclosure:
    """Return the enclosure of a number without error."""
    first = None if is_number_zero(value) else value
    return Enclosure([first, *[None] * (len(monomials(space)) - 1)], 0.0, space)


def as_enclosure(value, space: Space) -> Enclosure:
    if not isinstance(value, Enclosure):
        return exactly(value, space)
    if value.space == space:
        return value
    assert value.space == BALLS, "enclosures of two spaces have no operation"
    return Enclosure(exactly(value.terms[0], space).terms, value.radius, space)


def rounded_once(value, space: Space) -> Enclosure:
    """Enclose all real numbers that may round to `value`.

    A known whole number counts as exact.
    """
    known = isinstance(value, (int, float)) and float(value).is_integer()
    one = exactly(value, space)
    return one if known else Enclosure(one.terms, outward(abs(value) * ROUNDING), space)


def ball(middle, radius) -> Enclosure:
    """Return the interval with a midpoint and a radius."""
    return Enclosure([middle], radius, BALLS)


def interval_between(low, high) -> Enclosure:
    """Return an interval that holds all numbers from one to another."""
    middle = (low + high) / 2
    radius = outward(abs(high - low) / 2 + ROUNDING * (abs(low) + abs(high)))
    return ball(middle, radius)


def lies_within(inner: Enclosure, outer: Enclosure):
    """Return whether an interval certainly lies in another one."""
    return outward(abs(inner.midpoint - outer.midpoint) + inner.spread) <= outer.radius


def array_module(*values):
    """Return `jax.numpy` if any value is an array of JAX, else NumPy."""
    return jax.numpy if any(isinstance(value, jax.Array) for value in values) else np


def greatest(a, b):
    return array_module(a, b).maximum(a, b)


def least(a, b):
    return array_module(a, b).minimum(a, b)


def choose(flag, a, b):
    return array_module(flag, a, b).where(flag, a, b)


def reciprocal(x: Enclosure) -> Enclosure:
    """Enclose 1 / x = c / (1 - e), for c about 1 / midpoint and e = 1 - c x.

    The polynomial is c (1 + e + ... + e^d). The remainder of the sum is at most
    |e|^(d+1) / (1 - |e|); it counts as infinite unless |e| < 1.
    """
    inverse = 1 / x.midpoint
    e = exactly(1.0, x.space) - x * exactly(inverse, x.space)
    bound, result = e.magnitude, exactly(1.0, x.space)
    power = bound
    for _ in range(x.space.degree):
        result = exactly(1.0, x.space) + e * result
        power = outward(power * bound)
    gap = downward(1 - bound)
    radius = choose(gap > 0, power / choose(gap > 0, gap, 1.0), np.inf)
    return result.widened(outward(radius)) * exactly(inverse, x.space)
