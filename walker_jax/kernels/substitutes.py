"""JAX functions that replace primitives of small arrays: linear algebra, scans, cumulative sums.

Each takes the parameters of a primitive and returns a function of its operands, to be unrolled into
scalars. Factorisations follow LAPACK's conventions. Batches of matrices are mapped over.
"""

from collections.abc import Callable
from functools import reduce

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import jaxpr_as_fun

from walker_jax.kernels.jaxprs import UnsupportedPrimitive, scan_counts


def scan_as_while(params: dict) -> Callable:
    """Replace a scan by a while loop with a counter."""
    body, length, reverse = jaxpr_as_fun(params["jaxpr"]), params["length"], params["reverse"]
    constants, carried = scan_counts(params)
    stacked = params["jaxpr"].out_avals[carried:]

    def function(*operands):
        fixed, carry = operands[:constants], operands[constants : constants + carried]
        inputs = operands[constants + carried :]

        def turn(state):
            i, carry, outputs = state
            place = length - 1 - i if reverse else i
            here = [lax.dynamic_index_in_dim(x, place, keepdims=False) for x in inputs]
            results = body(*fixed, *carry, *here)
            pairs = zip(outputs, results[carried:], strict=True)
            outputs = [lax.dynamic_update_index_in_dim(all, one, place, 0) for all, one in pairs]
            return i + 1, results[:carried], outputs

        outputs = [jnp.zeros((length, *aval.shape), aval.dtype) for aval in stacked]
        if length == 0:
            return [*carry, *outputs]
        start = jnp.int32(0), list(carry), outputs
        _, carry, outputs = lax.while_loop(lambda state: state[0] < length, turn, start)
        return [*carry, *outputs]

    return function


def cumulate(combine: Callable) -> Callable:
    def substitute(params: dict) -> Callable:
        axis, reverse = params["axis"], params["reverse"]

        def function(x):
            parts = [lax.index_in_dim(x, i, axis) for i in range(x.shape[axis])]
            parts = parts[::-1] if reverse else parts
            results = parts[:1]
            for one in parts[1:]:
                results.append(combine(results[-1], one))
            return [lax.concatenate(results[::-1] if reverse else results, axis)]

        return function

    return substitute


def index_of_extremum(beyond: Callable) -> Callable:
    """Find the first index of the largest or smallest entry; NaN is beyond all others."""

    def substitute(params: dict) -> Callable:
        (axis,), dtype = params["axes"], params["index_dtype"]

        def function(x):
            best = lax.index_in_dim(x, 0, axis, keepdims=False)
            place = jnp.zeros(best.shape, dtype)
            for i in range(1, x.shape[axis]):
                one = lax.index_in_dim(x, i, axis, keepdims=False)
                better = (beyond(one, best) | (one != one)) & (best == best)
                best = jnp.where(better, one, best)
                place = jnp.where(better, jnp.asarray(i, dtype), place)
            return [place]

        return function

    return substitute


# Linear algebra


def map_batches(substitute: Callable[..., Callable], ranks: tuple[int, ...]) -> Callable:
    """Map a substitute for operands of these ranks over their leading axes."""

    def batched(params: dict) -> Callable:
        single = substitute(**params)

        def function(*operands):
            mapped = single
            for _ in range(operands[0].ndim - ranks[0]):
                mapped = jax.vmap(mapped)
            return mapped(*operands)

        return function

    return batched


def reflect(c, v, tau):
    """Return (1 - tau v v^T) c."""
    return c - tau * v * jnp.sum(v * c)


def unit_vectors(a, k: int):
    """Return the vector of the k-th reflection, stored below the diagonal of a factorisation."""
    return jnp.concatenate([jnp.zeros(k, a.dtype), jnp.ones(1, a.dtype), a[k + 1 :, k]])


def geqrf() -> Callable:
    """Factorise by Householder reflections: R, with their vectors below the diagonal; tau."""

    def function(a):
        m, n = a.shape
        columns, taus = [a[:, j] for j in range(n)], []
        for k in range(min(m, n)):
            above, x, rest = columns[k][:k], columns[k][k], columns[k][k + 1 :]
            below = jnp.sum(rest * rest)
            turns = below != 0
            end = jnp.where(turns, -jnp.copysign(jnp.sqrt(x * x + below), x), x)
            tau = jnp.where(turns, (end - x) / jnp.where(turns, end, 1), 0)
            rest = rest / jnp.where(turns, x - end, 1)
            v = jnp.concatenate([jnp.ones(1, a.dtype), rest])
            for j in range(k + 1, n):
                new = reflect(columns[j][k:], v, tau)
                columns[j] = jnp.concatenate([columns[j][:k], new])
            columns[k] = jnp.concatenate([above, end[None], rest])
            taus.append(tau)
        return [jnp.stack(columns, 1), jnp.stack(taus)]

    return function


def ormqr(left: bool, transpose: bool) -> Callable:
    """Multiply a matrix by Q or its transpose, from the left or the right."""

    def function(a, taus, c):
        lines = list(c.T if left else c)
        order = range(taus.shape[0])
        for k in order if left == transpose else reversed(order):
            lines = [reflect(line, unit_vectors(a, k), taus[k]) for line in lines]
        return [jnp.stack(lines, 1 if left else 0)]

    return function


def qr(*, full_matrices: bool, pivoting: bool, use_magma: bool | None) -> Callable:
    del use_magma
    if pivoting:
        raise UnsupportedPrimitive("qr with pivoting")

    def function(a):
        m, n = a.shape
        packed, taus = geqrf()(a)
        columns = m if full_matrices else min(m, n)
        eye = jnp.eye(m, columns, dtype=a.dtype)
        (q,) = ormqr(left=True, transpose=False)(packed, taus, eye)
        return [q, jnp.triu(packed[:columns])]

    return function


def triangular_solve(
    *, left_side: bool, lower: bool, transpose_a: bool, conjugate_a: bool, unit_diagonal: bool
) -> Callable:
    """Solve a triangular system by substitution."""
    del conjugate_a

    def function(a, b):
        # x a = b means a^T x^T = b^T.
        a = a.T if transpose_a == left_side else a
        b = b if left_side else b.T
        n = a.shape[0]
        forwards = lower != (transpose_a == left_side)
        rows = {}
        for i in range(n) if forwards else reversed(range(n)):
            row = b[i] - sum((a[i, j] * rows[j] for j in rows), jnp.zeros_like(b[i]))
            rows[i] = row if unit_diagonal else row / a[i, i]
        x = jnp.stack([rows[i] for i in range(n)])
        return [x if left_side else x.T]

    return function


def lu() -> Callable:
    """Factorise by Gaussian elimination with the largest entry of a column as its pivot."""

    def function(a):
        m, n = a.shape
        pivots, order = [], jnp.arange(m, dtype=jnp.int32)
        for k in range(min(m, n)):
            pivot = (k + jnp.argmax(jnp.abs(a[k:, k]))).astype(jnp.int32)
            pivots.append(pivot)
            order = swap(order, k, pivot)
            a = swap(a, k, pivot)
            factors = a[k + 1 :, k] / jnp.where(a[k, k] == 0, 1, a[k, k])
            rest = a[k + 1 :, k + 1 :] - factors[:, None] * a[k, k + 1 :]
            below = jnp.concatenate([a[k + 1 :, :k], factors[:, None], rest], 1)
            a = jnp.concatenate([a[: k + 1], below])
        return [a, jnp.stack(pivots), order]

    return function


def swap(a, i: int, j):
    """Exchange rows i and j >= i of an array."""
    first, other = a[i], lax.dynamic_index_in_dim(a, j, keepdims=False)
    a = lax.dynamic_update_index_in_dim(a, first, j, 0)
    return jnp.concatenate([a[:i], other[None], a[i + 1 :]])


def lu_pivots_to_permutation(*, permutation_size: int) -> Callable:
    def function(pivots):
        order = jnp.arange(permutation_size, dtype=jnp.int32)
        return [reduce(lambda order, k: swap(order, k, pivots[k]), range(len(pivots)), order)]

    return function


def cholesky(**_) -> Callable:
    """Return the lower factor; NaN if the matrix is not positive definite."""

    def function(a):
        n = a.shape[0]
        rows = [[jnp.zeros((), a.dtype)] * n for _ in range(n)]
        for j in range(n):
            square = a[j, j] - sum(rows[j][k] * rows[j][k] for k in range(j))
            rows[j][j] = jnp.sqrt(jnp.where(square > 0, square, jnp.nan))
            for i in range(j + 1, n):
                products = sum(rows[i][k] * rows[j][k] for k in range(j))
                rows[i][j] = (a[i, j] - products) / rows[j][j]
        factor = jnp.stack([jnp.stack(row) for row in rows])
        definite = jnp.all(jnp.isfinite(jnp.diagonal(factor)))
        return [jnp.where(definite, factor, jnp.nan)]

    return function


SUBSTITUTES: dict[str, Callable[[dict], Callable]] = {
    "scan": scan_as_while,
    "cumsum": cumulate(lambda a, b: a + b),
    "cumprod": cumulate(lambda a, b: a * b),
    "cummax": cumulate(jnp.maximum),
    "cummin": cumulate(jnp.minimum),
    "cumlogsumexp": cumulate(jnp.logaddexp),
    "argmax": index_of_extremum(lambda a, b: a > b),
    "argmin": index_of_extremum(lambda a, b: a < b),
    "geqrf": map_batches(geqrf, (2,)),
    "ormqr": map_batches(ormqr, (2, 1, 2)),
    "qr": map_batches(qr, (2,)),
    "triangular_solve": map_batches(triangular_solve, (2, 2)),
    "lu": map_batches(lu, (2,)),
    "lu_pivots_to_permutation": map_batches(lu_pivots_to_permutation, (1,)),
    "cholesky": map_batches(cholesky, (2,)),
}
"""By primitive: parameters -> function of the operands."""
