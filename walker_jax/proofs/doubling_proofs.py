"""Proofs of period doublings.

The Krawczyk operator is evaluated for all slopes of an interval at once. So for each slope exactly
one gait is in the box, and it depends smoothly on the slope. Let M be the Jacobian of its return.
At the ends of the interval det(M + I) has opposite signs, so it is zero in between, where M has
the multiplier -1.
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from walker_jax.checks import (
    ComputationFailed,
    WrongUse,
    check_number,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.gaits.search import find_gait
from walker_jax.proofs.enclosures import BALLS, Enclosure, interval_between, is_enclosure
from walker_jax.proofs.gait_proofs import has_no_shorter_period, midpoints_of, spreads_of
from walker_jax.proofs.matrices import determinant
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.returns import enclose_cycle, jacobian_of_return, plus_identity
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, with_parameter

BOX_PER_WIDTH = 200
"""Half the side of the gait's box, per width of the interval. Gaits move by several times as much
as the slope, and have to stay well within the box."""
SECANTS, SMALLER_BOXES = 60, 3
LEAST_DETERMINANT = 1e-10
"""Limit below which det(M + I) is mere rounding."""


class ProvedDoubling(NamedTuple):
    """Theorem: between `low` and `high` a multiplier of a gait passes through -1."""

    parameter: str
    low: float
    high: float
    states: Float[np.ndarray, "period section"]
    """Approximate states of the gait that doubles its period."""
    radius: float
    """Largest distance of the true states from these, by coordinate; within it there is no other
    gait of this period."""


@refuses_tracers()
def prove_doubling(
    walker: System,
    low: float,
    high: float,
    *,
    parameter: str = "slope",
    period: int = 1,
    width: float = 2e-8,
) -> ProvedDoubling:
    """Prove that a gait doubles its period between two close values of a parameter.

    ```python
    found = wj.prove_doubling(wj.SimplestWalker(slope=0.015), 0.0145, 0.0155)
    found.low, found.high
    ```

    The doubling is found by the secant method between `low` and `high`. At both, `find_gait`
    without a guess must find the gait: at one with no multiplier below -1, at the other with one.

    **Arguments:**

    - `walker`: a `SimplestWalker`, `SpringWalker` or `PoweredWalker`.
    - `low`, `high`: values of the parameter between which the period doubles.
    - `parameter`: name of the parameter.
    - `period`: period of the gait that doubles it.
    - `width`: width of the interval in which the doubling is proved.

    **Returns** a `ProvedDoubling`.

    **Raises** `ComputationFailed` if no doubling is found or proved; `WrongUse` as `prove_gait`
    does, for bounds that are not in order, and for a width outside 1e-14 to `high - low`.
    """
    walker = check_provable(walker)
    check_whole("period", period)
    for name, value in (("low", low), ("high", high), ("width", width)):
        check_number(name, value)
    check_parameter(walker, parameter, float(low), float(high))
    if not low < high:
        raise WrongUse(f"low={short(low)} must be below high={short(high)}", of="low high")
    if not 1e-14 < width < high - low:
        raise WrongUse(f"width must be above 1e-14 and below high - low, not {short(width)}")
    at, states = find_doubling(walker, parameter, period, float(low), float(high))
    ends, box = (at - width / 2, at + width / 2), BOX_PER_WIDTH * width
    signs = [sign_at(walker, parameter, states, box, end) for end in ends]
    between = interval_between(*map(np.float64, ends))
    whole = enclose_cycle(with_interval(walker, parameter, between), states, box)
    known = whole is not None and whole.zero.proved and has_no_shorter_period(whole)
    if not (known and signs[0] * signs[1] < 0):
        raise ComputationFailed(
            f"no period doubling is proved between {parameter}={ends[0]!r} and {ends[1]!r}"
        )
    return ProvedDoubling(parameter, *ends, states, box)


def with_interval(walker, parameter: str, value: Enclosure):
    """Return the walker with enclosed parameters, one of them anywhere in an interval."""
    known = enclose_parameters(walker, BALLS)
    return eqx.tree_at(lambda one: getattr(one, parameter), known, value, is_leaf=is_enclosure)


def sign_at(walker, parameter: str, states: np.ndarray, box: float, value: float) -> int:
    """Prove the sign of det(M + I) of the gait in a box about given states.

    The result is 0 if the sign is not decided.
    """
    at = interval_between(np.float64(value), np.float64(value))
    known = with_interval(walker, parameter, at)
    cycle = enclose_cycle(known, states, box)
    if cycle is None or not cycle.zero.proved:
        return 0
    for _ in range(SMALLER_BOXES):  # each holds the gait, and has narrower multipliers
        near = enclose_cycle(known, midpoints_of(cycle), float(spreads_of(cycle).max()))
        if near is None:
            return 0
        cycle = near
    found = determinant(plus_identity(jacobian_of_return(cycle.jacobians)))
    return int(found.lower > 0) - int(found.upper < 0)


def find_doubling(
    walker, parameter: str, period: int, low: float, high: float
) -> tuple[float, np.ndarray]:
    """Find about where det(M + I) is zero, and the gait there, by secants; nothing is proved."""

    def determinant_at(value: float, guess) -> tuple[float, np.ndarray]:
        there = with_parameter(walker, parameter, np.float64(value))
        gait = find_gait(there, guess, period)
        return float(np.real(np.prod(1 + np.asarray(gait.multipliers)))), np.asarray(gait.states)

    (left, states), (right, _) = determinant_at(low, None), determinant_at(high, None)
    if left * right >= 0:
        raise ComputationFailed(
            f"no gait of period {period} doubles it between {parameter}={low!r} and {high!r}"
        )
    value = low
    for _ in range(SECANTS):
        value = low - left * (high - low) / (right - left)
        last, states = determinant_at(value, states)
        if last * left > 0:
            low, left, right = value, last, right / 2
        else:
            high, right, left = value, last, left / 2
        if abs(last) < LEAST_DETERMINANT:
            break
    return value, states
