"""Power series of solutions of small linear systems, and of triangular factorisations.

The k-th coefficient of the solution of A(t) x(t) = b(t) solves

    A_0 x_k = b_k - sum_{j=1}^k A_j x_{k-j},

so all coefficients share the factors of A_0. Those of a factorisation A = L R follow from what is
left of A_k without the products of earlier ones, by its two triangles,

    L_0^-1 (A_k - sum_{j=1}^{k-1} L_j R_{k-j}) R_0^-1 = L_0^-1 L_k + R_k R_0^-1.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr
from jax.lax.linalg import triangular_solve

from walker_jax.integrators.series import (
    Series,
    add_terms,
    bilinear,
    constant,
    minus,
    parts,
    scale,
)
from walker_jax.kernels.jaxprs import binding

multiply = partial(jnp.matmul, precision=lax.Precision.HIGHEST)


def before(k: int, x: Series) -> Series:
    """Return a series without its coefficients from the k-th on."""
    return Series(lambda j: x[j] if j < k else None)


def solve_rule(
    expansion,
    equation,
    product: ClosedJaxpr,
    matrix: list[Series],
    right: list[Series],
    solve: Callable[..., Any],
) -> list[Series]:
    """Return the series of the solution x of A x = b.

    `product` computes A x from the series of `matrix` and x; `solve` divides by A at t = 0.
    """

    def rule(k):
        if k == 0:
            return solve(*(b[0] for b in right))
        known = expansion.interpret(product, [*matrix, *(before(k, x) for x in solution)])
        rest = [minus(k, [b, one]) for b, one in zip(right, known, strict=True)]
        if all(one is None for one in rest):
            return None
        filled = zip(rest, right, strict=True)
        return solve(*(jnp.zeros_like(b[0]) if one is None else one for one, b in filled))

    solution = parts(Series(rule), equation)
    expansion.interpret(product, [*matrix, *solution])  # records the kinks of A
    return solution


def linear_solve_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand `lax.custom_linear_solve`, of which `jnp.linalg.solve` and `inv` consist."""
    lengths, bind = equation.params["const_lengths"], binding(equation)
    constants, right = operands[: sum(lengths)], operands[sum(lengths) :]
    product, matrix = equation.params["jaxprs"].matvec, constants[: lengths.matvec]
    solve = lambda *right: bind(*(x[0] for x in constants), *right)
    return solve_rule(expansion, equation, product, matrix, right, solve)


def triangular_solve_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    params, (a, b), bind = equation.params, operands, binding(equation)
    unit = int(params["unit_diagonal"])

    def of_triangle(a, x):
        a = jnp.tril(a, -unit) if params["lower"] else jnp.triu(a, unit)
        a = a + jnp.eye(a.shape[-1], dtype=a.dtype) if unit else a
        a = a.mT if params["transpose_a"] else a
        a = a.conj() if params["conjugate_a"] else a
        return multiply(a, x) if params["left_side"] else multiply(x, a)

    product = jax.make_jaxpr(of_triangle)(a[0], b[0])
    return solve_rule(expansion, equation, product, [a], [b], lambda b: bind(a[0], b))


def cholesky_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand L of A = L L^T; as the primitive, it reads the lower triangle of A."""
    (a,), bind = operands, binding(equation)

    def rule(k):
        if k == 0:
            return jnp.tril(bind(a[0]))  # XLA leaves other numbers above the diagonal
        known, first = before(k, factor), factor[0]
        adjoint = Series(lambda j: None if known[j] is None else known[j].mT.conj())
        rest = add_terms([a[k], scale(bilinear(k, [known, adjoint], multiply), -1)])
        if rest is None:
            return None
        rest = jnp.tril(rest) + jnp.tril(rest, -1).mT.conj()
        inner = triangular_solve(first, rest, left_side=True, lower=True)
        inner = triangular_solve(first, inner, lower=True, transpose_a=True, conjugate_a=True)
        half = inner * jnp.eye(a[0].shape[-1], dtype=a[0].dtype) / 2
        return multiply(first, jnp.tril(inner, -1) + half)

    factor = Series(rule)
    return [factor]


def lu_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand P A = L U of a square matrix, both in one, with the pivots of t = 0.

    Where the largest pivot becomes another, this is still a factorisation, and serves as well.
    """
    (a,), bind = operands, binding(equation)
    if a[0].shape[-1] != a[0].shape[-2]:
        return expansion.default_rule(equation, operands)
    values = bind(a[0])
    identity = jnp.eye(a[0].shape[-1], dtype=a[0].dtype)

    def rule(k):
        if k == 0:
            return values[0]
        known, first = before(k, both), values[0]
        below = lambda j: None if known[j] is None else jnp.tril(known[j], -1)
        lower = Series(lambda j: below(j) if j else jnp.tril(first, -1) + identity)
        upper = Series(lambda j: None if known[j] is None else jnp.triu(known[j]))
        rows = None if a[k] is None else jnp.take_along_axis(a[k], values[2][..., None], -2)
        rest = add_terms([rows, scale(bilinear(k, [lower, upper], multiply), -1)])
        if rest is None:
            return None
        inner = triangular_solve(first, rest, left_side=True, lower=True, unit_diagonal=True)
        inner = triangular_solve(first, inner, lower=False)
        return multiply(lower[0], jnp.tril(inner, -1)) + multiply(jnp.triu(inner), upper[0])

    both = Series(rule)
    return [both, *map(constant, values[1:])]


LINEAR_ALGEBRA = {
    "cholesky": cholesky_rule,
    "custom_linear_solve": linear_solve_rule,
    "lu": lu_rule,
    "triangular_solve": triangular_solve_rule,
}
"""Rules by primitive."""
