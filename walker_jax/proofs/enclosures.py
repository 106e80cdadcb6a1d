"""Arithmetic of enclosures: polynomials in a start, with a bound on what they leave out.

An `Enclosure` stands for a real function f of u, where |u_i| <= 1 for each of its variables:

    |f(u) - sum_k terms_k u^k| <= radius    for all u.

Without variables it is an interval, by its middle and radius. Results of operations enclose all
results of the same operations on what the operands enclose: `radius` grows by the terms of too high
a degree, and by all rounding errors.

Rounding. Numbers are float64, rounded to nearest. One operation is off by 2^-53 of its result at
most, and `ROUNDING` is a little more. The bounds still hold where a compiler contracts a product
and a sum to one operation, which saves a rounding. The error of a sum
of n products is at most n 2^-53 times the sum of their absolute values, up to second order (Higham
2002, section 3.1). Radii are sums and products of numbers that are not negative, so their own
relative error is at most 2^-53 for each operation: `GROWTH` has room for 32, more than any radius
here takes. `TINY` covers results so small that their digits, or all of them, are lost.

Arrays may be those of JAX, in a function that is traced, or of NumPy; all operations are element by
element. A number that is not finite makes all that follows NaN or infinite, and no comparison then
proves anything.
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
    """Polynomials of some number of variables, up to a degree."""

    variables: int
    degree: int


BALLS = Space(0, 0)
"""Without variables: intervals."""


@cache
def monomials(space: Space) -> list[tuple[int, ...]]:
    """The exponents of each monomial, by degree."""
    powers = itertools.product(range(space.degree + 1), repeat=space.variables)
    return sorted((p for p in powers if sum(p) <= space.degree), key=lambda p: (sum(p), p[::-1]))


@cache
def product_table(space: Space) -> list[list[tuple[int, int]]]:
    """For each monomial, the pairs of monomials whose product it is."""
    known = monomials(space)
    table: list[list[tuple[int, int]]] = [[] for _ in known]
    for (i, p), (j, q) in itertools.product(enumerate(known), repeat=2):
        both = tuple(map(add, p, q))
        if sum(both) <= space.degree:
            table[known.index(both)].append((i, j))
    return table


def outward(radius):
    """A radius that is certainly not smaller than what rounding has made of it."""
    return radius * GROWTH + TINY


def total(values: Sequence) -> Any:
    """The sum of values, those that are not None."""
    values = [value for value in values if value is not None]
    return reduce(add, values) if values else 0.0


class Enclosure:
    """A polynomial with an error bound. A term of None is zero."""

    def __init__(self, terms: Sequence, radius: Any, space: Space, size: Any = None):
        self.terms, self.radius, self.space = tuple(terms), radius, space
        self._size = size

    @cached_property
    def sizes(self) -> list:
        """By degree: the sum of the absolute values of its terms, None where there are none."""
        found: list[list] = [[] for _ in range(self.space.degree + 1)]
        for powers, term in zip(monomials(self.space), self.terms, strict=True):
            if term is not None:
                found[sum(powers)].append(abs(term))
        return [total(one) if one else None for one in found]

    @cached_property
    def norm(self):
        """The sum of the absolute values of all terms."""
        return total(self.sizes)

    @property
    def size(self):
        """At least the norm, from the operation that made it."""
        return self.norm if self._size is None else self._size

    @property
    def middle(self):
        return 0.0 if self.terms[0] is None else self.terms[0]

    @cached_property
    def spread(self):
        """How far its values are from the middle, at most."""
        return outward(total([*self.sizes[1:], self.radius]))

    @property
    def lower(self):
        """A number that no value is below."""
        return downward(self.middle - self.spread)

    @property
    def upper(self):
        return -downward(-self.middle - self.spread)

    @property
    def magnitude(self):
        """A number that no absolute value is above."""
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
        terms = [plus(p, q) for p, q in zip(self.terms, other.terms, strict=True)]
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
        """The same, with a larger radius."""
        return Enclosure(self.terms, outward(self.radius + radius), self.space, self._size)

    def range(self) -> "Enclosure":
        """The interval of its values."""
        return Enclosure([self.middle], self.spread, BALLS)

    def __repr__(self):
        return f"Enclosure({self.terms}, radius={self.radius}, {self.space})"


jax.tree_util.register_pytree_node(
    Enclosure,
    lambda one: ((one.terms, one.radius), one.space),
    lambda space, parts: Enclosure(*parts, space),
)


def downward(value):
    """A number below what rounding has made one."""
    return value - (abs(value) * (4 * ROUNDING) + TINY)


def plus(p, q):
    return q if p is None else p if q is None else p + q


def is_number_zero(value) -> bool:
    return isinstance(value, float) and bool(value == 0)


def is_zero(one: Enclosure) -> bool:
    """Whether it is known to be zero while a function is traced."""
    return is_number_zero(one.radius) and all(t is None for t in one.terms)


def is_enclosure(value: Any) -> bool:
    return isinstance(value, Enclosure)


def exactly(value, space: Space) -> Enclosure:
    """A number itself."""
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
    """The real numbers of which some float may be the rounding to nearest.

    Whole numbers are meant as they stand.
    """
    known = isinstance(value, (int, float)) and float(value).is_integer()
    one = exactly(value, space)
    return one if known else Enclosure(one.terms, outward(abs(value) * ROUNDING), space)


def ball(middle, radius) -> Enclosure:
    """An interval."""
    return Enclosure([middle], radius, BALLS)


def between(low, high) -> Enclosure:
    """The interval from one number to another."""
    middle = (low + high) / 2
    radius = outward(abs(high - low) / 2 + ROUNDING * (abs(low) + abs(high)))
    return ball(middle, radius)


def hull(a: Enclosure, b: Enclosure) -> Enclosure:
    """An interval that holds two."""
    low, high = least(a.lower, b.lower), greatest(a.upper, b.upper)
    return between(low, high)


def lies_within(inner: Enclosure, outer: Enclosure):
    """Whether an interval certainly lies in another one."""
    apart = abs(inner.middle - outer.middle)
    apart = apart + ROUNDING * (abs(inner.middle) + abs(outer.middle))
    return outward(apart + inner.spread) <= outer.radius


def library(*values):
    """The functions of arrays: NumPy's for its own and for numbers, JAX's for others."""
    return jax.numpy if any(isinstance(value, jax.Array) for value in values) else np


def greatest(a, b):
    return library(a, b).maximum(a, b)


def least(a, b):
    return library(a, b).minimum(a, b)


def choose(flag, a, b):
    return library(flag, a, b).where(flag, a, b)


def reciprocal(x: Enclosure) -> Enclosure:
    """1 / x, for x = m (1 - e): (1 + e + ... + e^d) / m, with e^{d+1} / (1 - e) left out."""
    inverse = 1 / x.middle
    e = exactly(1.0, x.space) - x * exactly(inverse, x.space)
    bound, result = e.magnitude, exactly(1.0, x.space)
    power = bound
    for _ in range(x.space.degree):
        result = exactly(1.0, x.space) + e * result
        power = outward(power * bound)
    gap = downward(1 - bound)
    radius = choose(gap > 0, power / choose(gap > 0, gap, 1.0), np.inf)
    return result.widened(outward(radius)) * exactly(inverse, x.space)
