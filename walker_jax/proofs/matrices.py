"""Interval matrices: the Krawczyk operator, and eigenvalues of 2 x 2 matrices.

A matrix is a list of rows of intervals: of `Enclosure`s without variables, with NumPy's numbers.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from walker_jax.proofs.enclosures import (
    BALLS,
    ROUNDING,
    Enclosure,
    ball,
    exactly,
    interval_between,
    lies_within,
)

Matrix = list[list[Enclosure]]


def point_interval(value: float) -> Enclosure:
    return exactly(np.float64(value), BALLS)


def from_floats(values: np.ndarray) -> Matrix:
    return [[point_interval(value) for value in row] for row in values]


def identity(size: int) -> Matrix:
    return from_floats(np.eye(size))


def product(a: Matrix, b: Matrix) -> Matrix:
    columns = range(len(b[0]))
    return [[inner(row, [other[j] for other in b]) for j in columns] for row in a]


def inner(a: Sequence[Enclosure], b: Sequence[Enclosure]) -> Enclosure:
    result = point_interval(0.0)
    for one, other in zip(a, b, strict=True):
        result = result + one * other
    return result


def difference(a: Matrix, b: Matrix) -> Matrix:
    return [[p - q for p, q in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def midpoints(matrix: Matrix) -> np.ndarray:
    return np.array([[float(one.midpoint) for one in row] for row in matrix])


def determinant(m: Matrix) -> Enclosure:
    return m[0][0] * m[1][1] - m[0][1] * m[1][0]


def trace(m: Matrix) -> Enclosure:
    return m[0][0] + m[1][1]


class Zero(NamedTuple):
    """Enclosed zero of a function."""

    within: list[Enclosure]
    """Intervals that hold it."""
    proved: bool
    """Whether exactly one zero is in the given box; it then lies in `within`."""


def krawczyk(centre: np.ndarray, radius: float, values: Matrix, jacobian: Matrix) -> Zero:
    """Prove that a function has exactly one zero in a box, and enclose it.

    For the box X about c and any matrix Y, the Krawczyk operator is

        K = c - Y F(c) + (I - Y F'(X)) (X - c).

    If K lies inside X, there is exactly one zero in X, and it lies in K (Krawczyk 1969).

    **Arguments:**

    - `centre`, `radius`: c, and half the side of X.
    - `values`: F(c), as one column.
    - `jacobian`: F'(X), an enclosure of the Jacobian on all of X.
    """
    inverse = from_floats(np.linalg.inv(midpoints(jacobian)))
    newton = product(inverse, values)
    left = difference(identity(len(centre)), product(inverse, jacobian))
    box = [[ball(np.float64(0), np.float64(radius))] for _ in centre]
    spread = product(left, box)
    within = [
        point_interval(c) - off[0] + rest[0]
        for c, off, rest in zip(centre, newton, spread, strict=True)
    ]
    known = [ball(np.float64(c), np.float64(radius)) for c in centre]
    inside = [bool(lies_within(one, box)) for one, box in zip(within, known, strict=True)]
    return Zero(within, all(inside))


def square_root(x: Enclosure) -> Enclosure:
    """Enclose the square root of a positive interval.

    The error of an IEEE square root is at most 2^-53 of the root.
    """
    low, high = np.sqrt(x.lower), np.sqrt(x.upper)
    return interval_between(low * (1 - ROUNDING), high * (1 + ROUNDING))


def enclose_eigenvalues(m: Matrix) -> list[tuple[Enclosure, Enclosure]] | None:
    """Enclose the real and imaginary parts of both eigenvalues.

    The result is None if it is not decided whether they are real.
    """
    half = trace(m) * point_interval(0.5)
    gap = half * half - determinant(m)
    if gap.lower > 0:
        root, zero = square_root(gap), point_interval(0.0)
        return [(half + root, zero), (half - root, zero)]
    if gap.upper < 0:
        root = square_root(-gap)
        return [(half, root), (half, -root)]
    return None


def is_contraction(m: Matrix) -> bool | None:
    """Return whether both eigenvalues lie inside the unit circle, by Jury's criterion.

    The result is None if that is not decided.
    """
    t, d = trace(m), determinant(m)
    size = max(abs(t.lower), abs(t.upper))
    if d.upper < 1 and size < (point_interval(1.0) + d).lower:
        return True
    least = max(t.lower, -t.upper, 0.0)
    return False if d.lower > 1 or least > (point_interval(1.0) + d).upper else None
