"""Gaits that exist, by proof, with their Floquet multipliers."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import ComputationFailed, refuses_tracers
from walker_jax.gaits.search import find_gait
from walker_jax.proofs.enclosures import BALLS
from walker_jax.proofs.matrices import Matrix, eigenvalues, is_contraction
from walker_jax.proofs.provable import check_provable, parameters_of
from walker_jax.proofs.returns import Cycle, enclose_cycle, jacobian_of_return
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_in_words

RADII = (1e-12, 3e-11, 1e-9, 1e-7)
"""Of the boxes in which a gait is proved to be the only one; the first that holds one counts."""


class ProvedGait(NamedTuple):
    """A theorem: within `unique_within` of `states`, there is exactly one gait of this period.

    It is within `radii` of them.
    """

    states: Float[np.ndarray, "period section"]
    """About the start of each stride."""
    radii: Float[np.ndarray, "period section"]
    """How far the true states may be from these, by coordinate."""
    unique_within: float
    multipliers: Complex[np.ndarray, " section"]
    """About the Floquet multipliers; NaN where it is open whether they are real."""
    multiplier_radius: float
    """How far the true ones may be from these, in the real and in the imaginary part."""
    stable: bool | None
    """Whether all multipliers are inside the unit circle; None where that is open."""


@refuses_tracers()
def prove_gait(walker: System, guess: Any = None, period: int = 1) -> ProvedGait:
    """Prove that a walker has a gait, where it is, and whether it is stable.

    ```python
    proved = wj.prove_gait(wj.SimplestWalker(slope=0.004))
    proved.states, proved.radii, proved.stable
    ```

    `find_gait` finds the gait; then Krawczyk's operator on all states of the cycle proves, in
    arithmetic with rigorous bounds, that exactly one gait is near by. Each stride of it is a stride
    by all definitions: no event before heel strike, the ground pushes, the trailing foot lifts.

    The theorem is about the numbers that round to the walker's parameters, so for a slope of 0.004
    about 4/1000 too.

    **Arguments:**

    - `walker`: a `SimplestWalker`, `SpringWalker` or `PoweredWalker`.
    - `guess`, `period`: as in `find_gait`.

    **Returns** a `ProvedGait`.

    **Raises** `ComputationFailed` if no gait is found or none is proved, and `WrongUse` for another
    walker, for float32, and as `find_gait` does.
    """
    walker = check_provable(walker)
    known = parameters_of(walker, BALLS)
    states = np.asarray(find_gait(walker, guess, period).states, float)
    for radius in RADII:
        cycle = enclose_cycle(known, states, radius)
        if cycle is not None and cycle.zero.proved and has_no_shorter_period(cycle):
            if radius > RADII[0]:  # the gait is in a box that is smaller, where all is narrower
                near = enclose_cycle(known, middles(cycle), float(spreads(cycle).max()))
                cycle = cycle if near is None else near
            # The middle may be beside the centre of the box in which there is only one.
            moved = float(np.abs(middles(cycle) - states).max()) + 2.0**-52 * np.abs(states).max()
            within = float((radius - moved) * (1 - 2.0**-40))
            if within > float(spreads(cycle).max()):
                return gait_of(cycle, within)
    raise ComputationFailed(
        f"no gait of period {period} is proved near {states.tolist()}, {describe_in_words(walker)}"
    )


def gait_of(cycle: Cycle, within: float) -> ProvedGait:
    returns = jacobian_of_return(cycle.jacobians)
    multipliers, width = multipliers_of(returns)
    stable = is_contraction(returns)
    return ProvedGait(middles(cycle), spreads(cycle), within, multipliers, width, stable)


def middles(cycle: Cycle) -> Float[np.ndarray, "period section"]:
    return np.array([float(one.middle) for one in cycle.zero.within]).reshape(-1, 2)


def spreads(cycle: Cycle) -> Float[np.ndarray, "period section"]:
    return np.array([float(one.spread) for one in cycle.zero.within]).reshape(-1, 2)


def multipliers_of(returns: Matrix) -> tuple[Complex[np.ndarray, " section"], float]:
    """The eigenvalues of a return's Jacobian, the largest first, and how far they may be off."""
    found = eigenvalues(returns)
    if found is None:
        return np.full(2, np.nan + 0j), np.inf
    values = [complex(float(a.middle), float(b.middle)) for a, b in found]
    width = max(float(one.spread) for pair in found for one in pair)
    return np.array(sorted(values, key=abs, reverse=True)), width


def has_no_shorter_period(cycle: Cycle) -> bool:
    """Whether the first state of a cycle is certainly none of its others."""
    first, *others = zip(cycle.zero.within[::2], cycle.zero.within[1::2], strict=True)
    return all(any(not_equal(a, b) for a, b in zip(first, one, strict=True)) for one in others)


def not_equal(a, b) -> bool:
    apart = a - b
    return bool(apart.lower > 0 or apart.upper < 0)
