"""Normal forms of bifurcations: the coefficients that tell super- from subcritical ones.

On the centre manifold of a cycle the return map is, up to a change of coordinates,

    fold:            xi -> xi + s xi^2,
    doubling:        xi -> -xi + s xi^3,
    Neimark-Sacker:  z -> exp(i angle) z (1 + d |z|^2),  s = Re d,

with xi or z measured along the eigenvector of unit length at the first state of the cycle. At a
doubling with s > 0 a stable cycle of twice the period is born. At a Neimark-Sacker point with s < 0
a stable closed curve is born. Both bifurcations are supercritical. With the other sign they are
subcritical: the cycle or curve is unstable, and it exists while the first cycle is still stable
(Kuznetsov, Elements of Applied Bifurcation Theory, 3rd edition, equations 5.49 to 5.53). These
statements hold on the centre manifold. In the full space a new cycle or curve is stable only if all
other multipliers are inside the unit circle. If s is zero, the bifurcation has codimension two.
"""

from collections.abc import Generator
from functools import partial

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.jets import Curves, Jet

ANGLES = np.arange(4) * np.pi / 4
"""Directions in the plane of a pair of eigenvectors. Four directions separate the harmonics of
cubic terms, as opposite directions differ by a sign only."""
SUPERCRITICAL, SUBCRITICAL = "supercritical", "subcritical"
VANISHING = 1e-9
"""Size of a coefficient that is zero up to rounding errors, as at a Neimark-Sacker point of a map
that preserves areas."""


def criticality(kind: str, coefficient: float) -> str:
    """Return "supercritical" or "subcritical"; empty for other kinds, and if it is neither."""
    sign = {"doubling": 1.0, "neimark-sacker": -1.0}.get(kind, 0.0) * coefficient
    return SUPERCRITICAL if sign > VANISHING else SUBCRITICAL if sign < -VANISHING else ""


def find_coefficient(
    kind: str,
    values: Float[np.ndarray, " parameters"],
    cycle: Float[np.ndarray, "period section"],
    jacobian: Float[np.ndarray, "section section"],
    towards: Float[np.ndarray, " section"] | None = None,
) -> Generator[Curves, Jet, float]:
    """Find the coefficient s of a bifurcation at a cycle with this Jacobian.

    It is NaN for branch points, without a pair, and where eigenvectors coincide. The sign of s at a
    fold depends on the sign of the eigenvector, which points to the same side as `towards`.
    """
    if kind not in COEFFICIENTS:
        return np.nan
    multipliers, vectors = np.linalg.eig(jacobian.astype(complex))
    try:
        duals = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.nan
    which = critical_multiplier(kind, multipliers)
    if which is None:
        return np.nan
    q, dual = vectors[:, which], duals[which]
    ask = partial(Curves, values, cycle)
    if towards is not None and np.real(q) @ towards < 0:
        q, dual = -q, -dual
    return (yield from COEFFICIENTS[kind](ask, jacobian, multipliers[which], q, dual))


def critical_multiplier(kind: str, multipliers: Complex[np.ndarray, " section"]) -> int | None:
    """Return the index of the multiplier nearest to 1, -1, or the circle above the real axis.

    It is None if no multiplier is above the real axis.
    """
    if kind != "neimark-sacker":
        return int(np.abs(multipliers - (1 if kind == "fold" else -1)).argmin())
    above = np.flatnonzero(np.imag(multipliers) > 0)
    if len(above) == 0:
        return None
    return int(above[np.abs(np.abs(multipliers[above]) - 1).argmin()])


def fold_coefficient(ask, jacobian, multiplier, q, dual) -> Generator[Curves, Jet, float]:
    """Compute s = <p, B(q, q)> / 2."""
    curve = np.real(q)[None]
    jet = yield ask(curve, np.zeros_like(curve))
    return float(np.real(dual) @ jet.second[0]) / 2


def doubling_coefficient(ask, jacobian, multiplier, q, dual) -> Generator[Curves, Jet, float]:
    """Compute s = <p, C(q, q, q) + 3 B(q, h)> / 6, with h = (I - A)^-1 B(q, q)."""
    curve = np.real(q)[None]
    jet = yield ask(curve, np.zeros_like(curve))
    bend = solve(np.eye(len(jacobian)) - jacobian, jet.second[0])
    jet = yield ask(curve, bend[None])
    return float(np.real(dual) @ jet.third[0]) / 6


def torus_coefficient(ask, jacobian, multiplier, q, dual) -> Generator[Curves, Jet, float]:
    """Compute s = Re(<p, C(q, q, q*) + 2 B(q, h_11) + B(q*, h_20)> / multiplier) / 2.

    h_11 = (I - A)^-1 B(q, q*) and h_20 = (multiplier^2 I - A)^-1 B(q, q) bend the curves
    q exp(i angle) + its conjugate into the centre manifold. Harmonics over the angle separate the
    terms.
    """
    turn = np.exp(1j * ANGLES)[:, None]
    curves = 2 * np.real(q * turn)
    jet = yield ask(curves, np.zeros_like(curves))
    eye = np.eye(len(jacobian))
    flat = solve(eye - jacobian, jet.second.mean(axis=0) / 2)
    twice = solve(multiplier**2 * eye - jacobian, (jet.second * turn**-2).mean(axis=0))
    jet = yield ask(curves, 2 * np.real(twice * turn**2) + 2 * flat)
    cubic = (jet.third / turn).mean(axis=0) / 3
    return float(np.real(dual @ cubic / multiplier)) / 2


COEFFICIENTS = {
    "fold": fold_coefficient,
    "doubling": doubling_coefficient,
    "neimark-sacker": torus_coefficient,
}


def solve(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Solve a linear system, by least squares if it is singular."""
    return np.linalg.lstsq(matrix, vector, rcond=None)[0]
