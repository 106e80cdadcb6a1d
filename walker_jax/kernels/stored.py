"""Long arrays, such as the layers of a network, that are in memory instead of registers.

A program that multiplies long matrices keeps every array with an axis of `LONG` entries or more in
memory, and loops run over their entries (`store`), so it has as many instructions for a wide
network as for a narrow one. All other programs, and those for GPUs, keep every number in a
register. An entry in memory is a vector with a value for each lane; an entry of a table, or of an
operand that all cells share, is one value for all lanes.
"""

import math
from typing import Any

import numpy as np
from jax.extend.core import Jaxpr

from walker_jax.kernels.jaxprs import equations_in
from walker_jax.kernels.lifetimes import Span

LONG = 16
"""Fewest entries along an axis of a long array. Products of shorter vectors, as of the coordinates
of a walker, are faster in registers."""


def is_long(aval, least: int = LONG) -> bool:
    """Return whether an array has an axis of many entries."""
    return math.prod(aval.shape) > 0 and max(aval.shape, default=0) >= least


def multiplies_long_matrices(jaxpr: Jaxpr, least: int = LONG) -> bool:
    """Return whether a function, or one that it calls, multiplies a matrix that is long."""
    return any(is_long_product(equation, least) for equation in equations_in(jaxpr))


def keeps_arrays_in_memory(jaxpr: Jaxpr, bits: int) -> bool:
    """Return whether the program of a function, for registers of so many bits, has a `Store`."""
    return bits > 0 and multiplies_long_matrices(jaxpr)


def is_long_product(equation, least: int = LONG) -> bool:
    """Return whether an equation is a product of floating-point arrays with a long result."""
    return (
        equation.primitive.name == "dot_general"
        and is_long(equation.outvars[0].aval, least)
        and all(v.aval.dtype == equation.outvars[0].aval.dtype for v in equation.invars)
        and np.dtype(equation.outvars[0].aval.dtype).kind == "f"
    )


class Stored:
    """An array in memory, or some entries of one.

    `places` is a view of an array of the same shape as the whole, so the functions of NumPy that
    only move entries act on it.
    """

    __slots__ = "base", "bytes", "dtype", "for_all", "number", "places", "shared", "span", "whole"

    def __init__(self, base: Any, places: np.ndarray, dtype: np.dtype, number: int):
        self.base = base
        """The pointer to the whole array, or to the memory of all arrays that have a span."""
        self.span: Span | None = None
        self.places, self.whole = places, places
        self.dtype, self.number = dtype, number
        """The number tells arrays apart."""
        self.bytes: int = 0
        """Distance between entries."""
        self.for_all = False
        """Whether an entry is one value for all lanes."""
        self.shared: tuple | None = None
        """A flag, and the array to read where it is true; of an operand that cells may share."""

    @property
    def shape(self) -> tuple[int, ...]:
        return self.places.shape

    @property
    def size(self) -> int:
        return self.places.size

    @property
    def ndim(self) -> int:
        return self.places.ndim

    def ravel(self) -> "list[Stored]":
        """Return the array as one entry, which is not known."""
        return [self]

    @property
    def start(self) -> int:
        """The byte of the whole array where these entries begin."""
        return (address_of(self.places) - address_of(self.whole)) * self.bytes

    @property
    def steps(self) -> tuple[int, ...]:
        """Bytes between entries along each axis."""
        return tuple(step * self.bytes for step in self.places.strides)

    def is_view(self, places: np.ndarray) -> bool:
        """Return whether NumPy has moved entries without copying any."""
        return np.may_share_memory(places, self.whole)

    def view(self, places: np.ndarray) -> "Stored":
        """Return the entries in these places, of a view of its own."""
        found = object.__new__(Stored)
        for name in ("base", "span", "whole", "dtype", "number", "bytes", "for_all"):
            setattr(found, name, getattr(self, name))
        found.places, found.shared = places, None
        if self.shared is not None:
            flag, twin = self.shared
            found.shared = flag, twin.view(places)
        return found

    def key(self) -> tuple:
        """Return a key that equal views share."""
        return 3, "", self.number, self.start, self.shape, self.places.strides


def address_of(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]
