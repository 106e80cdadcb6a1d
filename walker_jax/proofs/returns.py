"""Enclosed cycles of a walker: the Krawczyk operator on all states of a cycle at once.

The states x_1 ... x_n of a cycle are a zero of

    F_i = S(x_i) - x_{i+1},    where x_{n+1} = x_1 and S is the stride function.

So no enclosure is carried through more than one stride.
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
    point_interval,
    product,
)
from walker_jax.proofs.strides import STRIDE, VerifiedStride, verify_stride

FIRST_DEGREE = Space(2, 1)
"""Space of polynomials of first degree, which suffice for boxes as small as these."""
ERRORS = Space(4, 1)
"""Space whose four variables are errors of the full state that a point leads to."""


class Accuracy(NamedTuple):
    """Order of the remainders, and size of the last terms."""

    order: int
    tolerance: float


POINT_ACCURACY = Accuracy(20, 1e-17)
"""Accuracy for points, whose enclosures are as narrow as rounding allows."""
BOX_ACCURACY = Accuracy(12, 1e-12)
"""Accuracy for boxes, within which derivatives vary by more than that."""


class Cycle(NamedTuple):
    """Cycle in a box, proved or not."""

    zero: Zero
    jacobians: list[Matrix]
    """Jacobians of the stride function, each over the box of one state."""


def verify_points(walker, centres: Float[np.ndarray, "period 2"]) -> VerifiedStride:
    """Carry points through one verified stride each."""
    return verify_stride(
        walker,
        (exactly(centres[:, 0], ERRORS), exactly(centres[:, 1], ERRORS)),
        **POINT_ACCURACY._asdict(),
        align=align_errors,
    )


def align_errors(state: Any) -> Any:
    """Turn the radii of a state into new variables, along axes in which the state is narrow.

    Errors then move with the motion and do not grow as intervals would (Lohner 1987). For a nearly
    orthogonal Q,

        x = Q (Q^T x) + (I - Q Q^T) x.

    The bounds on Q^T x are the sizes of the new variables; the rest goes into the radii.
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
        Enclosure([one.midpoint, *new[:, i].T], outward(rest[:, i]), ERRORS)
        for i, one in enumerate(state)
    )


def verify_boxes(walker, centres: Float[np.ndarray, "period 2"], radius: float) -> VerifiedStride:
    """Carry boxes about points through one verified stride each, with derivatives.

    The first half of the results has the derivatives with respect to theta, the second half those
    with respect to thetadot.
    """
    count = len(centres)
    ones, zeros = np.ones(count), np.zeros(count)
    both = np.concatenate([centres, centres])
    half = np.full(2 * count, radius)
    theta = Enclosure([both[:, 0], half, None], 0.0, FIRST_DEGREE)
    thetadot = Enclosure([both[:, 1], None, half], 0.0, FIRST_DEGREE)
    tangent = tuple(
        exactly(np.concatenate(parts), FIRST_DEGREE) for parts in ((ones, zeros), (zeros, ones))
    )
    return verify_stride(walker, (theta, thetadot), (tangent,), **BOX_ACCURACY._asdict())


def enclose_cycle(walker, states: Float[np.ndarray, "period 2"], radius: float) -> Cycle | None:
    """Enclose a cycle near given states; return None if a stride near them is not proved.

    **Arguments:**

    - `walker`: has intervals as its parameters.
    - `states`: approximate states of the cycle.
    - `radius`: half the side of the box about the states in which one cycle is sought.
    """
    states, period = np.asarray(states, float), len(states)
    thin = verify_points(walker, states)
    wide = verify_boxes(walker, states, radius)
    if not (np.all(thin.verdict == STRIDE) and np.all(wide.verdict == STRIDE)):
        return None
    at = lambda one, i: interval_at(one.range(), i)
    jacobians = [
        [[at(wide.tangents[0][row], i + j * period) for j in range(2)] for row in range(2)]
        for i in range(period)
    ]
    values, rows = [], from_floats(np.zeros((2 * period, 2 * period)))
    for i in range(period):
        following = (i + 1) % period
        for row in range(2):
            values.append([at(thin.state[row], i) - point_interval(states[following, row])])
            for column in range(2):
                rows[2 * i + row][2 * i + column] = jacobians[i][row][column]
            place = 2 * following + row
            rows[2 * i + row][place] = rows[2 * i + row][place] - 1.0
    return Cycle(krawczyk(states.ravel(), radius, values, rows), jacobians)


def interval_at(one: Enclosure, i: int) -> Enclosure:
    """Return one interval of an array of them."""
    pick = lambda value: np.float64(np.broadcast_to(value, np.shape(one.midpoint))[i])
    return Enclosure([pick(one.terms[0])], pick(one.radius), BALLS)


def jacobian_of_return(jacobians: list[Matrix]) -> Matrix:
    """Return the product of a cycle's Jacobians, the first on the right."""
    result = identity(2)
    for one in jacobians:
        result = product(one, result)
    return result


def plus_identity(m: Matrix) -> Matrix:
    return difference(m, from_floats(-np.eye(2)))
