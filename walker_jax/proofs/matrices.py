"""Matrices of intervals, Krawczyk's operator, and the eigenvalues of matrices of two rows.

All are lists of rows of `Enclosure` without variables, with NumPy's numbers.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from walker_jax.proofs.enclosures import (
    BALLS,
    ROUNDING,
    Enclosure,
    ball,
    between,
    exactly,
    lies_within,
)

Matrix = list[list[Enclosure]]


def number(value: float) -> Enclosure:
    return exactly(np.float64(value), BALLS)


def from_floats(values: np.ndarray) -> Matrix:
    return [[number(value) for value in row] for row in values]


def identity(size: int) -> Matrix:
    return from_floats(np.eye(size))


def product(a: Matrix, b: Matrix) -> Matrix:
    columns = range(len(b[0]))
    return [[inner(row, [other[j] for other in b]) for j in columns] for row in a]


def inner(a: Sequence[Enclosure], b: Sequence[Enclosure]) -> Enclosure:
    result = number(0.0)
    for one, other in zip(a, b, strict=True):
        result = result + one * other
    return result


def difference(a: Matrix, b: Matrix) -> Matrix:
    return [[p - q for p, q in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def middles(matrix: Matrix) -> np.ndarray:
    return np.array([[float(one.middle) for one in row] for row in matrix])


def determinant(m: Matrix) -> Enclosure:
    return m[0][0] * m[1][1] - m[0][1] * m[1][0]


def trace(m: Matrix) -> Enclosure:
    return m[0][0] + m[1][1]


class Zero(NamedTuple):
    """A zero of a function, enclosed."""

    within: list[Enclosure]
    """It is in here."""
    proved: bool
    """Whether there is exactly one in the box that was looked at, and so in `within`."""


def krawczyk(centre: np.ndarray, radius: float, values: Matrix, jacobian: Matrix) -> Zero:
    """Whether a function has exactly one zero within a radius of a point, and where.

    K = c - Y F(c) + (I - Y F'(X)) (X - c), for the box X about c and any matrix Y; if K lies inside
    X, there is one zero in X, and it is in K (Krawczyk 1969).

    **Arguments:**

    - `centre`, `radius`: c, and half the sides of X.
    - `values`: F(c), one column.
    - `jacobian`: F' of all of X.
    """
    inverse = from_floats(np.linalg.inv(middles(jacobian)))
    newton = product(inverse, values)
    left = difference(identity(len(centre)), product(inverse, jacobian))
    box = [[ball(np.float64(0), np.float64(radius))] for _ in centre]
    spread = product(left, box)
    within = [
        number(c) - off[0] + rest[0] for c, off, rest in zip(centre, newton, spread, strict=True)
    ]
    known = [ball(np.float64(c), np.float64(radius)) for c in centre]
    inside = [bool(lies_within(one, box)) for one, box in zip(within, known, strict=True)]
    return Zero(within, all(inside))


def square_root(x: Enclosure) -> Enclosure:
    """The root of an interval above zero. IEEE arithmetic is off by 2^-53 of a root at most."""
    low, high = np.sqrt(x.lower), np.sqrt(x.upper)
    return between(low * (1 - ROUNDING), high * (1 + ROUNDING))


def eigenvalues(m: Matrix) -> list[tuple[Enclosure, Enclosure]] | None:
    """Real and imaginary parts of both eigenvalues; None where it is open if they are real."""
    half = trace(m) * number(0.5)
    gap = half * half - determinant(m)
    if gap.lower > 0:
        root, zero = square_root(gap), number(0.0)
        return [(half + root, zero), (half - root, zero)]
    if gap.upper < 0:
        root = square_root(-gap)
        return [(half, root), (half, -root)]
    return None


def is_contraction(m: Matrix) -> bool | None:
    """Whether both eigenvalues lie inside the unit circle (Jury); None if that is open."""
    t, d = trace(m), determinant(m)
    size = max(abs(t.lower), abs(t.upper))
    if d.upper < 1 and size < (number(1.0) + d).lower:
        return True
    least = max(t.lower, -t.upper, 0.0)
    return False if d.lower > 1 or least > (number(1.0) + d).upper else None
