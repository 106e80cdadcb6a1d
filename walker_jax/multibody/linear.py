"""Linear equations with small symmetric positive definite matrices, entry by entry."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse

WORST_PIVOT = {jnp.dtype("float64"): 1e-11, jnp.dtype("float32"): 1e-4}
"""Smallest pivot of a mass matrix, relative to its diagonal entry.

The pivot is the rest of a coordinate's inertia once those before it are eliminated. Below this
bound a result would have at most some five correct digits.
"""


def block(matrix: Float[Array, "n n"], places: Iterable[int]) -> list[list[Array]]:
    """Return the submatrix of rows and columns with the same indices."""
    places = list(places)
    return [[matrix[i, j] for j in places] for i in places]


class Factors(NamedTuple):
    """A = L D L^T, with V = L D."""

    L: list[list[Array]]
    """Below the diagonal."""
    V: list[list[Array]]
    """Below the diagonal."""
    inverse: list[Array]
    """1 / D, so that divisions are few: XLA repeats the computation of a shared divisor."""


def factorise(matrix: list[list[Array]]) -> Factors:
    """Factorise a symmetric positive definite matrix, which needs no pivoting.

    NaN if a pivot is too small (`WORST_PIVOT`).
    """
    n = len(matrix)
    factors = Factors([[] for _ in range(n)], [[] for _ in range(n)], [])
    L, V, inverse = factors
    for j in range(n):
        column = [matrix[i][j] - dot(L[j], V[i]) for i in range(j, n)]
        sound = column[0] > WORST_PIVOT[matrix[j][j].dtype] * matrix[j][j]
        inverse.append(jnp.where(sound, 1 / column[0], jnp.nan))
        for i in range(j + 1, n):
            V[i].append(column[i - j])
            L[i].append(column[i - j] * inverse[j])
    return factors


def solve_factored(factors: Factors, right: list[Array]) -> list[Array]:
    """Return A^-1 b: for two unknowns, two divisions and seven products in all."""
    L, V, inverse = factors
    n, y = len(inverse), []
    for i in range(n):
        y.append(right[i] - dot(L[i], y))
    x: list[Array] = []
    for i in reversed(range(n)):
        x.insert(0, (y[i] - dot([V[k][i] for k in range(i + 1, n)], x)) * inverse[i])
    return x


def dot(a: list[Array], b: list[Array]):
    """Return the inner product of two lists, up to the length of the shorter one."""
    terms = [x * y for x, y in zip(a, b, strict=False)]
    return sum(terms[1:], terms[0]) if terms else 0.0


def check_pivots(name: str, matrix: Array, places: Iterable[int], what: str, q) -> None:
    """Raise `WrongUse` for a matrix with too small a pivot, unless it is traced."""
    if isinstance(matrix, Tracer) or not np.isfinite(matrix).all():
        return
    places = list(places)
    worst, reduced = WORST_PIVOT[matrix.dtype], np.array(matrix)[np.ix_(places, places)]
    for k, (place, entry) in enumerate(zip(places, np.diag(reduced).copy(), strict=True)):
        pivot = reduced[k, k]
        if not pivot > worst * entry:
            kind = "ill-conditioned" if pivot > 0 else "singular"
            raise WrongUse(
                f"{name} is {kind} at q = {np.asarray(q).tolist()}: {what}[{place}] moves "
                f"{pivot:.3g} of its {entry:.3g} once those before it are given"
            )
        reduced[k + 1 :, k:] -= np.outer(reduced[k + 1 :, k] / pivot, reduced[k, k:])
