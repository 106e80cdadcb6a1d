"""Cycles of a walker enclosed: Krawczyk's operator on all states of a cycle at once.

The states x_1 ... x_n of a cycle are a zero of F_i = S(x_i) - x_{i+1}, with the stride function S.
So no enclosure is carried for more than one stride.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.proofs.enclosures import (
    BALLS,
    ROUNDING,
    Enclosure,
    Space,
    exactly,
    outward,
)
from walker_jax.proofs.matrices import (
    Matrix,
    Zero,
    difference,
    from_floats,
    identity,
    krawczyk,
    number,
    product,
)
from walker_jax.proofs.strides import STRIDE, VerifiedStride, verify_stride

LINES = Space(2, 1)
"""Polynomials of first degree: the boxes are so small that no more is needed."""
ERRORS = Space(4, 1)
"""The variables are errors of a point's state."""


class Accuracy(NamedTuple):
    """The order of remainders, and the size of the terms there."""

    order: int
    tolerance: float


POINTS = Accuracy(20, 1e-17)
"""For points, whose enclosures are as narrow as rounding allows."""
LINEAR = Accuracy(12, 1e-12)
"""For boxes, whose derivatives vary by more than that."""


class Cycle(NamedTuple):
    """A cycle in a box, proved or not."""

    zero: Zero
    jacobians: list[Matrix]
    """Jacobians of the stride function, over the box of each state."""


def strides_about(walker, centres: Float[np.ndarray, "period 2"]) -> VerifiedStride:
    """The verified strides of points."""
    return verify_stride(
        walker,
        (exactly(centres[:, 0], ERRORS), exactly(centres[:, 1], ERRORS)),
        order=POINTS.order,
        tolerance=POINTS.tolerance,
        align=aligned,
    )


def aligned(state: Any) -> Any:
    """A state whose radii have become new variables, along axes in which it is narrow.

    Errors then move as the motion does, and do not grow as intervals would (Lohner 1987). For
    nearly orthogonal Q, x = Q (Q^T x) + (I - Q Q^T) x: the bounds of Q^T x are the new variables'
    sizes, and the rest is left to the radii.
    """
    known = np.stack([np.stack(one.terms[1:], -1) for one in state], -2)
    radii = np.stack([one.radius for one in state], -1)
    order = np.argsort(-np.linalg.norm(known, axis=-2), axis=-1)
    axes = np.linalg.qr(np.take_along_axis(known, order[:, None, :], -1))[0]
    turned = np.abs(np.swapaxes(axes, -1, -2))
    rounding = 16 * ROUNDING * turned @ np.abs(known)
    along = np.abs(np.swapaxes(axes, -1, -2) @ known) + rounding
    sizes = outward(along.sum(-1) + np.einsum("nij,nj->ni", turned, radii))
    product = axes @ np.swapaxes(axes, -1, -2)
    off = np.abs(np.eye(len(state)) - product) + 16 * ROUNDING * turned.swapaxes(-1, -2) @ turned
    whole = np.abs(known).sum(-1) + radii
    new = axes * sizes[:, None, :]
    rest = np.einsum("nij,nj->ni", off, whole) + ROUNDING * np.abs(new).sum(-1)
    return type(state)._make(
        Enclosure([one.middle, *new[:, i].T], outward(rest[:, i]), ERRORS)
        for i, one in enumerate(state)
    )


def derivatives_about(
    walker, centres: Float[np.ndarray, "period 2"], radius: float
) -> VerifiedStride:
    """The verified strides of boxes, and their derivatives by theta in the first half of the
    results, by thetadot in the second."""
    count = len(centres)
    ones, zeros = np.ones(count), np.zeros(count)
    both = np.concatenate([centres, centres])
    half = np.full(2 * count, radius)
    theta = Enclosure([both[:, 0], half, None], 0.0, LINES)
    thetadot = Enclosure([both[:, 1], None, half], 0.0, LINES)
    tangent = tuple(
        exactly(np.concatenate(parts), LINES) for parts in ((ones, zeros), (zeros, ones))
    )
    return verify_stride(
        walker, (theta, thetadot), (tangent,), order=LINEAR.order, tolerance=LINEAR.tolerance
    )


def enclose_cycle(walker, states: Float[np.ndarray, "period 2"], radius: float) -> Cycle | None:
    """A cycle near some states, or None where a stride near them is not proved.

    **Arguments:**

    - `walker`: with intervals as its parameters.
    - `states`: about those of the cycle.
    - `radius`: of the box about each coordinate in which there is one such cycle.
    """
    states, period = np.asarray(states, float), len(states)
    thin = strides_about(walker, states)
    wide = derivatives_about(walker, states, radius)
    if not (np.all(thin.verdict == STRIDE) and np.all(wide.verdict == STRIDE)):
        return None
    at = lambda one, i: entry(one.range(), i)
    jacobians = [
        [[at(wide.tangents[0][row], i + j * period) for j in range(2)] for row in range(2)]
        for i in range(period)
    ]
    values, rows = [], from_floats(np.zeros((2 * period, 2 * period)))
    for i in range(period):
        following = (i + 1) % period
        for row in range(2):
            values.append([at(thin.state[row], i) - number(states[following, row])])
            for column in range(2):
                rows[2 * i + row][2 * i + column] = jacobians[i][row][column]
            place = 2 * following + row
            rows[2 * i + row][place] = rows[2 * i + row][place] - 1.0
    return Cycle(krawczyk(states.ravel(), radius, values, rows), jacobians)


def entry(one: Enclosure, i: int) -> Enclosure:
    """One of many intervals."""
    pick = lambda value: np.float64(np.broadcast_to(value, np.shape(one.middle))[i])
    return Enclosure([pick(one.terms[0])], pick(one.radius), BALLS)


def jacobian_of_return(jacobians: list[Matrix]) -> Matrix:
    """The product of a cycle's Jacobians, the first on the right."""
    result = identity(2)
    for one in jacobians:
        result = product(one, result)
    return result


def plus_identity(m: Matrix) -> Matrix:
    return difference(m, from_floats(-np.eye(2)))
