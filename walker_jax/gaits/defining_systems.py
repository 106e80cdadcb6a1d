"""Equations of bifurcations, for Newton's iteration to them and their continuation.

The unknowns are the states x_i of a cycle, one or two vectors v_i along it, scalars, and one or two
parameters. For every kind the states form a cycle, S(x_i) = x_{i+1}, and

    fold, doubling:   J_i v_i = v_{i+1}, with J_k v_k = v_1 or -v_1
    Neimark-Sacker:   J_i v_i = v_{i+1} and J_i w_i = w_{i+1}, with J_k v_k = w_1 and
                      J_k w_k = 2 c w_1 - v_1, where c is the cosine of the angle
    branch point:     J_i v_i + S_p a = v_{i+1} closes for two pairs (v, a) with the first
                      parameter p, and S(x_k) + b e = x_1 with b = 0

Linear conditions fix the vectors, which these equations leave free. For a Neimark-Sacker point the
plane of v and w is invariant under the Jacobian of the cycle. The equations stay regular where the
angle is 0 or pi and the pair becomes real. In two parameters a branch point persists only where the
unfolding b stays zero, for example by a symmetry.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.gaits.cycles import cycle_matrices, multiply_jacobians
from walker_jax.gaits.derivatives import SecondDerivatives
from walker_jax.gaits.requests import SecondOrderRequest

FOLD, DOUBLING, TORUS, BRANCH = "fold", "doubling", "neimark-sacker", "branch point"
KINDS = FOLD, DOUBLING, TORUS, BRANCH


class Unknowns(NamedTuple):
    """The unknowns of a bifurcation."""

    values: Float[np.ndarray, " parameters"]
    """Values of one or two parameters."""
    cycle: Float[np.ndarray, "period section"]
    vectors: Float[np.ndarray, "vectors period section"]
    scalars: Float[np.ndarray, " scalars"]
    """Cosine of a Neimark-Sacker point; for a branch point a of both vectors, and b."""


class Frame(NamedTuple):
    """Conditions on the vectors, and the direction in which a branch point unfolds."""

    rows: Float[np.ndarray, "conditions columns"]
    """Linear functions of the vectors, then of the scalars."""
    right: Float[np.ndarray, " conditions"]
    """Values of these functions."""
    unfolding: Float[np.ndarray, "period section"]
    """Direction e of the unfolding; zero for other kinds."""


def request_of(kind: str, unknowns: Unknowns) -> SecondOrderRequest:
    """Return the request whose response `assemble` takes."""
    vectors, count = unknowns.vectors, len(unknowns.values)
    directions = np.concatenate([vectors, np.zeros((*vectors.shape[:2], count))], axis=2)
    if kind == BRANCH:
        directions[:, :, -count] = unknowns.scalars[:2, None]
    return SecondOrderRequest(unknowns.values, unknowns.cycle, directions)


def frame_at(kind: str, unknowns: Unknowns, local: SecondDerivatives) -> tuple[Unknowns, Frame]:
    """Return the unknowns with vectors that fit the cycle, and the conditions on these vectors.

    The vector v has unit length, and so has each pair (v, a) of a branch point. For a
    Neimark-Sacker point the cosine must be known. A single vector keeps its orientation.
    """
    period, size = unknowns.cycle.shape
    count = period * size
    jacobians = local.by_columns[:1, :, :, :size]
    unfolding = np.zeros_like(unknowns.cycle)
    if kind == BRANCH:
        by_parameter = local.by_columns[0, :, :, size].reshape(count, 1)
        left, _, right = np.linalg.svd(np.append(cycle_matrices(jacobians)[0], by_parameter, 1))
        vectors, unfolding = right[-2:, :count].reshape(2, period, size), left[:, -1]
        scalars = np.append(right[-2:, count], unknowns.scalars[2:])
        rows = np.zeros((4, 2 * count + 3))
        for i, row in enumerate(right[-2:]):
            for j in range(2):
                rows[2 * i + j, j * count : (j + 1) * count] = row[:count]
                rows[2 * i + j, 2 * count + j] = row[count]
        frame = Frame(rows, np.eye(2).ravel(), unfolding.reshape(period, size))
        return unknowns._replace(vectors=vectors, scalars=scalars), frame
    product = multiply_jacobians(jacobians)[0]
    if kind == TORUS:
        first = vector_of_pair(product, unknowns.scalars[0])
        v = along_cycle(first, jacobians[0])
        w = along_cycle(product @ first, jacobians[0])
        v, w = v / np.linalg.norm(v), w / np.linalg.norm(v)
        other = w - np.sum(v * w) * v
        rows = np.zeros((2, 2 * count + 1))
        rows[:, :count] = v.ravel(), other.ravel() / np.linalg.norm(other)
        return unknowns._replace(vectors=np.stack([v, w])), Frame(rows, np.eye(2)[0], unfolding)
    multiplier = 1.0 if kind == FOLD else -1.0
    first = np.linalg.svd(product - multiplier * np.eye(size))[2][-1]
    v = along_cycle(first, jacobians[0])
    v = v / np.linalg.norm(v) * (-1 if np.sum(v * unknowns.vectors[0]) < 0 else 1)
    return unknowns._replace(vectors=v[None]), Frame(v.reshape(1, -1), np.ones(1), unfolding)


def along_cycle(first: np.ndarray, jacobians: np.ndarray) -> Float[np.ndarray, "period section"]:
    """Return a vector at the first state of a cycle, and its images at the others."""
    vectors = [first]
    for jacobian in jacobians[:-1]:
        vectors.append(jacobian @ vectors[-1])
    return np.array(vectors)


def vector_of_pair(product: np.ndarray, cosine: float) -> Float[np.ndarray, " section"]:
    """Choose a vector in the plane of a pair of multipliers.

    Of eight directions it is the one that the Jacobian turns farthest from its own line.
    """
    square = product @ product - 2 * cosine * product + np.eye(len(product))
    plane = np.linalg.svd(square)[2][-2:]
    candidates = np.array([[np.cos(t), np.sin(t)] for t in np.arange(8) * np.pi / 8]) @ plane
    images = candidates @ product.T
    inside = np.sum(candidates * images, axis=1)
    spread = np.sum(images**2, axis=1) - inside**2
    return candidates[(spread / np.sum(images**2, axis=1)).argmax()]


def closing(kind: str, scalars: np.ndarray) -> Float[np.ndarray, "vectors vectors"]:
    """Return the matrix from the vectors at the first state to those after the last stride."""
    if kind == TORUS:
        return np.array([[0.0, 1.0], [-1.0, 2 * scalars[0]]])
    return np.eye(2) if kind == BRANCH else np.array([[1.0 if kind == FOLD else -1.0]])


def assemble(
    kind: str, unknowns: Unknowns, frame: Frame, local: SecondDerivatives
) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, "rows columns"]]:
    """Assemble the error in the equations, and its derivatives by all unknowns in their order.

    Columns are the states, the vectors, the scalars and the parameters. With one parameter there
    are as many columns as rows, with two there is one more.
    """
    values, cycle, vectors, scalars = unknowns
    (number, period, size), count = vectors.shape, cycle.size
    by_states, by_parameters = local.by_columns[0, ..., :size], local.by_columns[0, ..., size:]
    turn = closing(kind, scalars)
    onward = np.roll(vectors, -1, axis=1)
    onward[:, -1] = turn @ vectors[:, 0]
    gap = local.state[0] - np.roll(cycle, -1, axis=0)
    if kind == BRANCH:
        gap = gap + scalars[2] * frame.unfolding
    conditions = frame.rows @ np.append(vectors, scalars)[: frame.rows.shape[1]] - frame.right
    error = np.concatenate([gap.ravel(), (local.along - onward).ravel(), conditions])
    known = len(scalars) + len(values)
    matrix = np.zeros((len(error), count * (1 + number) + known))
    matrix[:count, :count] = cycle_matrices(by_states[None])[0]
    matrix[:count, -len(values) :] = by_parameters.reshape(count, -1)
    for m in range(number):
        rows = slice(count * (m + 1), count * (m + 2))
        matrix[rows, -len(values) :] = local.changes[m, :, :, size:].reshape(count, -1)
        for i in range(period):
            part = slice(rows.start + i * size, rows.start + (i + 1) * size)
            matrix[part, i * size : (i + 1) * size] = local.changes[m, i, :, :size]
        matrix[rows, rows] = cycle_matrices(by_states[None], 0.0)[0]
        last = slice(rows.stop - size, rows.stop)
        for other in range(number):
            first = slice(count * (other + 1), count * (other + 1) + size)
            matrix[last, first] -= turn[m, other] * np.eye(size)
        if kind == BRANCH:
            matrix[rows, count * (number + 1) + m] = by_parameters[..., 0].ravel()
    if kind == TORUS:
        matrix[last, count * 3] = -2 * vectors[1, 0]
    if kind == BRANCH:
        matrix[:count, -len(values) - 1] = frame.unfolding.ravel()
    matrix[count * (1 + number) :, count : count + frame.rows.shape[1]] = frame.rows
    return error, matrix


def move(unknowns: Unknowns, step: Float[np.ndarray, " columns"]) -> Unknowns:
    """Return the unknowns with a step added."""
    values, cycle, vectors, scalars = unknowns
    parts = np.split(step, np.cumsum([cycle.size, vectors.size, scalars.size]))
    return Unknowns(
        values + parts[3],
        cycle + parts[0].reshape(cycle.shape),
        vectors + parts[1].reshape(vectors.shape),
        scalars + parts[2],
    )
