"""Bifurcations of codimension two: the criteria that change sign at them along a curve.

The criteria follow Kuznetsov, Elements of Applied Bifurcation Theory, 3rd edition, chapter 9. With
the characteristic polynomial chi of the cycle's Jacobian and the coefficient s of the normal form,
they are

    fold:             cusp: s chi'(1); 1:1 resonance: chi'(1); fold-flip: chi(-1)
    doubling:         generalised flip: s chi'(-1) chi(1); 1:2 resonance: chi'(-1);
                      fold-flip: chi(1)
    Neimark-Sacker:   n:m resonances, by the cosine of the angle; Chenciner: s r(1), with r the
                      polynomial of the other multipliers

Two further kinds have a multiplier 1 or -1 and a pair on the unit circle: fold-Neimark-Sacker and
flip-Neimark-Sacker. Their criteria are the product of l_i l_j - 1 over the other multipliers (on
folds and doublings), and the polynomial of the other multipliers at 1 or -1 (on Neimark-Sacker
curves). The factors of s cancel its poles, so that the criteria are smooth.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.gaits.defining_systems import DOUBLING, FOLD, TORUS
from walker_jax.gaits.events import pair_products

RESONANCES = {"1:1 resonance": 1.0, "1:2 resonance": -1.0, "1:3 resonance": -0.5}
RESONANCES |= {"1:4 resonance": 0.0}
"""Cosines of the angle of the pair of multipliers at each resonance."""
CONFIRMED = 1e-5
"""Largest distance of multipliers from their values at a point of codimension two. Where two of
them coincide, they are known to the square root of rounding errors only."""
PAIRS = {FOLD: "fold-Neimark-Sacker", DOUBLING: "flip-Neimark-Sacker"}
"""Points at which a pair is on the unit circle too."""

SPECIAL = ("cusp", "generalised flip", "Chenciner", "fold-flip", *RESONANCES, *PAIRS.values())
"""Names of all points."""


class CodimensionTwo(NamedTuple):
    """A point of a curve of bifurcations at which a second condition holds."""

    kind: str
    """One of `SPECIAL`."""
    values: Float[np.ndarray, " 2"]
    """Values of both parameters."""
    states: Float[np.ndarray, "period section"]
    multipliers: Complex[np.ndarray, " section"]
    criterion: float
    """Residual value of the criterion, which is zero at the exact point."""
    residual: float
    """Largest error in the equations of the bifurcation."""


def criteria(
    kind: str,
    multipliers: Complex[np.ndarray, " section"],
    scalars: Float[np.ndarray, " scalars"],
    coefficient: float,
) -> dict[str, float]:
    """Compute the criteria, which are zero at points of codimension two, by the points' names."""
    polynomial = np.real(np.poly(multipliers))
    at = lambda x: float(np.polyval(polynomial, x))
    slope = lambda x: float(np.polyval(np.polyder(polynomial), x))
    found = {}
    if kind == FOLD:
        found = {"cusp": coefficient * slope(1), "1:1 resonance": slope(1), "fold-flip": at(-1)}
    elif kind == DOUBLING:
        found = {"1:2 resonance": slope(-1), "fold-flip": at(1)}
        found["generalised flip"] = coefficient * slope(-1) * at(1)
    elif kind == TORUS:
        cosine = float(scalars[0])
        found = {name: cosine - value for name, value in RESONANCES.items()}
        others, _ = np.polydiv(polynomial, [1, -2 * cosine, 1])
        found["Chenciner"] = coefficient * float(np.polyval(others, 1))
        if len(others) > 1:
            found["fold-Neimark-Sacker"] = float(np.polyval(others, 1))
            found["flip-Neimark-Sacker"] = float(np.polyval(others, -1))
    if kind in PAIRS and len(multipliers) > 2:
        critical = np.abs(multipliers - (1 if kind == FOLD else -1)).argmin()
        products = pair_products(np.delete(multipliers, critical))
        found[PAIRS[kind]] = float(np.real(np.prod(products - 1)))
    return found


def is_confirmed(name: str, multipliers: Complex[np.ndarray, " section"]) -> bool:
    """Return whether the multipliers are those of a point of codimension two.

    This excludes two real multipliers whose product is 1, and sign changes at poles.
    """
    ones, minus_ones = (np.abs(multipliers - value) < CONFIRMED for value in (1, -1))
    pair = (np.abs(np.abs(multipliers) - 1) < CONFIRMED) & (np.imag(multipliers) > CONFIRMED)
    if name in RESONANCES:
        if abs(RESONANCES[name]) == 1:
            return bool((ones if RESONANCES[name] > 0 else minus_ones).sum() >= 2)
        return bool(np.any(pair & (np.abs(np.real(multipliers) - RESONANCES[name]) < CONFIRMED)))
    needed = {"fold-flip": ones.any() and minus_ones.any(), "Chenciner": pair.any()}
    needed |= {"cusp": ones.any(), "generalised flip": minus_ones.any()}
    needed |= {PAIRS[FOLD]: ones.any() and pair.any()}
    needed |= {PAIRS[DOUBLING]: minus_ones.any() and pair.any()}
    return bool(needed[name])
