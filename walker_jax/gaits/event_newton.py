"""Newton's iteration to a bifurcation, on its defining system.

Unknowns are measured in scaled coordinates: states over sqrt(period), each parameter over the width
of its range.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.arclength import CORRECTOR_STEPS
from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    find_multipliers,
    multiply_jacobians,
    solve_linear_systems,
)
from walker_jax.gaits.defining_systems import (
    BRANCH,
    TORUS,
    Frame,
    Unknowns,
    assemble,
    frame_at,
    move,
    request_of,
)
from walker_jax.gaits.requests import Task

Widths = Float[np.ndarray, " parameters"] | Sequence[float]
UNFOLDED = 1e-8
"""Unfolding of a branch point above which two branches do not cross; it exceeds rounding errors."""


class Solution(NamedTuple):
    """A bifurcation to which Newton's iteration has converged."""

    unknowns: Unknowns
    frame: Frame
    """Conditions on its vectors, for the next iteration along a curve."""
    matrix: Float[np.ndarray, "rows columns"]
    """Derivatives of the equations by scaled unknowns."""
    residual: float
    """Largest error in the equations."""
    jacobian: Float[np.ndarray, "section section"]
    """Jacobian of the whole cycle."""

    @property
    def multipliers(self) -> Complex[np.ndarray, " section"]:
        return find_multipliers(self.jacobian[None])[0]

    @property
    def vectors(
        self,
    ) -> Float[np.ndarray, "period section"] | Complex[np.ndarray, "period section"]:
        """Eigenvector of the critical multiplier along the cycle; complex for a pair."""
        vectors, scalars = self.unknowns.vectors, self.unknowns.scalars
        if len(vectors) == 1:
            return vectors[0]
        if len(scalars) == 3:  # a branch point: the combination at a constant parameter
            chosen = scalars[1] * vectors[0] - scalars[0] * vectors[1]
        else:
            cosine = complex(np.clip(scalars[0], -1, 1))
            chosen = vectors[1] - (cosine - 1j * np.sqrt(1 - cosine**2)) * vectors[0]
        return chosen / np.linalg.norm(chosen)


def begin(
    kind: str,
    values: Float[np.ndarray, " parameters"],
    cycle: Float[np.ndarray, "period section"],
    multipliers: Complex[np.ndarray, " section"],
    widths: Widths,
) -> Task:
    """Find the bifurcation near a gait with these multipliers; None if there is none.

    With two parameters it is a nearby point of a curve of bifurcations.
    """
    number, scalars = 1, np.zeros(0)
    if kind == TORUS:
        above = multipliers[np.imag(multipliers) > 0]
        if len(above) == 0:
            return None
        nearest = above[np.abs(np.abs(above) - 1).argmin()]
        number, scalars = 2, np.array([nearest.real / abs(nearest)])
    elif kind == BRANCH:
        number, scalars = 2, np.zeros(3)
    unknowns = Unknowns(values, cycle, np.zeros((number, *cycle.shape)), scalars)
    local = yield request_of(kind, unknowns)
    if not np.isfinite(local.by_columns).all():
        return None
    unknowns, frame = frame_at(kind, unknowns, local)
    return (yield from correct_event(kind, unknowns, frame, None, widths))


def correct_event(
    kind: str,
    unknowns: Unknowns,
    frame: Frame,
    row: Float[np.ndarray, " columns"] | None,
    widths: Widths,
) -> Task:
    """Iterate to a `Solution` on the plane normal to `row`; None without convergence.

    Without a `row` each step is the shortest solution of the linearised equations.
    """
    scales, best = scales_of(unknowns, widths), None
    smallest = float(MAX_RESIDUAL[unknowns.cycle.dtype])
    rounding = 10 * float(np.finfo(unknowns.cycle.dtype).eps)
    for _ in range(CORRECTOR_STEPS):
        local = yield request_of(kind, unknowns)
        error, matrix = assemble(kind, unknowns, frame, local)
        residual, matrix = float(np.abs(error).max()), matrix * scales
        if not (np.isfinite(residual) and np.isfinite(matrix).all()):
            return None
        converged = best is not None and residual >= smallest
        if residual < smallest:
            best, smallest = (unknowns, local, matrix), residual
        if converged or residual <= rounding:
            break
        if row is None:
            step = np.linalg.lstsq(matrix, -error, rcond=None)[0]
        else:
            whole = np.concatenate([matrix, row[None]])
            step = solve_linear_systems(whole[None], np.append(-error, 0.0)[None])[0]
        unknowns = move(unknowns, step * scales)
    if best is None:
        return None
    unknowns, local, matrix = best
    jacobians = local.by_columns[:1, :, :, : unknowns.cycle.shape[1]]
    unknowns, frame = frame_at(kind, unknowns, local)
    return Solution(unknowns, frame, matrix, smallest, multiply_jacobians(jacobians)[0])


def scales_of(unknowns: Unknowns, widths: Widths) -> Float[np.ndarray, " columns"]:
    """Return the units of the unknowns."""
    states = np.full(unknowns.cycle.size, np.sqrt(len(unknowns.cycle)))
    others = np.ones(unknowns.vectors.size + unknowns.scalars.size)
    return np.concatenate([states, others, widths])
