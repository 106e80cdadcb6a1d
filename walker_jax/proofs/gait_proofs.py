"""Proofs that gaits exist, with bounds on their Floquet multipliers."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import ComputationFailed, refuses_tracers
from walker_jax.gaits.search import find_gait
from walker_jax.proofs.enclosures import BALLS
from walker_jax.proofs.matrices import Matrix, enclose_eigenvalues, is_contraction
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.returns import Cycle, enclose_cycle, jacobian_of_return
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_in_words

RADII = (1e-12, 3e-11, 1e-9, 1e-7)
"""Radii of boxes, tried in order until exactly one gait is proved to be in one."""


class ProvedGait(NamedTuple):
    """Theorem: exactly one gait of this period is within `unique_within` of `states`.

    Its states are within `radii` of them.
    """

    states: Float[np.ndarray, "period section"]
    """Approximate start of each stride."""
    radii: Float[np.ndarray, "period section"]
    """Largest distance of the true states from these, by coordinate."""
    unique_within: float
    multipliers: Complex[np.ndarray, " section"]
    """Approximate Floquet multipliers; NaN if it is not decided whether they are real."""
    multiplier_radius: float
    """Largest distance of the true multipliers from these, in the real and the imaginary part."""
    stable: bool | None
    """Whether all multipliers are inside the unit circle; None if that is not decided."""


@refuses_tracers()
def prove_gait(walker: System, guess: Any = None, period: int = 1) -> ProvedGait:
    """Prove that a walker has a gait, where it is, and whether it is stable.

    ```python
    proved = wj.prove_gait(wj.SimplestWalker(slope=0.004))
    proved.states, proved.radii, proved.stable
    ```

    `find_gait` finds the gait. The Krawczyk operator on all states of the cycle then proves, in
    rigorous interval arithmetic, that exactly one gait is nearby. Each of its strides is one by all
    definitions: no event comes before heel strike, the ground pushes, and the trailing foot lifts.

    The theorem holds for all numbers that round to the walker's parameters; for a slope of 0.004,
    these include 4/1000.

    **Arguments:**

    - `walker`: a `SimplestWalker`, `SpringWalker` or `PoweredWalker`.
    - `guess`, `period`: as in `find_gait`.

    **Returns** a `ProvedGait`.

    **Raises** `ComputationFailed` if no gait is found or none is proved, and `WrongUse` for another
    walker, for float32, and as `find_gait` does.
    """
    walker = check_provable(walker)
    known = enclose_parameters(walker, BALLS)
    states = np.asarray(find_gait(walker, guess, period).states, float)
    for radius in RADII:
        cycle = enclose_cycle(known, states, radius)
        if cycle is not None and cycle.zero.proved and has_no_shorter_period(cycle):
            if radius > RADII[0]:  # the gait lies in a smaller box, where all bounds are narrower
                near = enclose_cycle(known, midpoints_of(cycle), float(spreads_of(cycle).max()))
                cycle = cycle if near is None else near
            # The gait is the only one in a box about `states`. The result is given about the
            # midpoints instead, and a box about these that lies in the former is smaller.
            moved = (
                float(np.abs(midpoints_of(cycle) - states).max()) + 2.0**-52 * np.abs(states).max()
            )
            within = float((radius - moved) * (1 - 2.0**-40))
            if within > float(spreads_of(cycle).max()):
                return gait_of(cycle, within)
    raise ComputationFailed(
        f"no gait of period {period} is proved near {states.tolist()}, {describe_in_words(walker)}"
    )


def gait_of(cycle: Cycle, within: float) -> ProvedGait:
    returns = jacobian_of_return(cycle.jacobians)
    multipliers, width = multipliers_of(returns)
    stable = is_contraction(returns)
    return ProvedGait(midpoints_of(cycle), spreads_of(cycle), within, multipliers, width, stable)


def midpoints_of(cycle: Cycle) -> Float[np.ndarray, "period section"]:
    return np.array([float(one.midpoint) for one in cycle.zero.within]).reshape(-1, 2)


def spreads_of(cycle: Cycle) -> Float[np.ndarray, "period section"]:
    return np.array([float(one.spread) for one in cycle.zero.within]).reshape(-1, 2)


def multipliers_of(returns: Matrix) -> tuple[Complex[np.ndarray, " section"], float]:
    """Return the eigenvalues of a return's Jacobian, the largest first, and a bound on their error.

    They are NaN if it is not decided whether they are real.
    """
    found = enclose_eigenvalues(returns)
    if found is None:
        return np.full(2, np.nan + 0j), np.inf
    values = [complex(float(a.midpoint), float(b.midpoint)) for a, b in found]
    width = max(float(one.spread) for pair in found for one in pair)
    return np.array(sorted(values, key=abs, reverse=True)), width


def has_no_shorter_period(cycle: Cycle) -> bool:
    """Return whether the first state of a cycle certainly differs from all others."""
    first, *others = zip(cycle.zero.within[::2], cycle.zero.within[1::2], strict=True)
    return all(any(not_equal(a, b) for a, b in zip(first, one, strict=True)) for one in others)


def not_equal(a, b) -> bool:
    apart = a - b
    return bool(apart.lower > 0 or apart.upper < 0)
