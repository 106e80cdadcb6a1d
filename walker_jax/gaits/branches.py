"""Branches of gaits over a parameter of the walker: continuation, folds, period doublings.

Along a branch the cycle's states and the parameter p are unknowns together, and a point further on
is where the branch meets a plane across it (pseudo-arclength continuation, Keller 1977), so a
branch is followed round its folds. At a fold a multiplier is 1, and two branches of gaits meet and
end; at a period doubling one is -1, and a gait of twice the period leaves. Both are located by
Newton's iteration on the states, the parameter and the vector v that the cycle's Jacobian maps to
v or to -v, with second derivatives of the stride function by automatic differentiation.

Distances along a branch are sqrt(mean |dx|^2 + (dp / width of the range)^2).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import WrongUse, check_kind, check_precision, numbers, refuses_tracers, short
from walker_jax.gaits.continuation import Path, Start, follow
from walker_jax.gaits.cycles import Gait, multipliers_of, product
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.requests import together
from walker_jax.gaits.search import find_gait
from walker_jax.integrators.solvers import Real, default_tolerance
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter


class Branch(NamedTuple):
    """Gaits of one period along a parameter, in the order in which they follow each other."""

    parameter: str
    values: Float[np.ndarray, " points"]
    """Values of the parameter; they turn round at folds."""
    states: Float[np.ndarray, "points period section"]
    multipliers: Complex[np.ndarray, "points section"]
    """The largest first."""
    step_times: Float[np.ndarray, "points period"]
    folds: list[Bifurcation]
    doublings: list[Bifurcation]
    ends: tuple[str, str]
    """Why the branch ends where it does, at its first point and at its last."""

    @property
    def period(self) -> int:
        return self.states.shape[1]

    @property
    def stable(self) -> np.ndarray:
        """Whether each gait is stable, shape (points,)."""
        return np.abs(self.multipliers[:, 0]) < 1


@refuses_tracers()
def continue_gait(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    gait: Gait | None = None,
    *,
    tolerance: Real | None = None,
) -> Branch:
    """The branch of a gait over a range of a parameter, both ways, round its folds.

    Steps are as long as the branch is straight; of two folds, or two doublings, within one step
    nothing is seen. The branch ends where it leaves the range, where
    a state no longer makes a stride however short the step, where it closes, or where it comes
    back to the gait of half the period from which it doubled.

    **Arguments:**

    - `walker`: any walker.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of it, with the walker's own between them or at one.
    - `gait`: of this walker; by default, that of `find_gait`.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** a `Branch`, from the end that is reached with the parameter falling at first to the
    other. `ValueError` for a parameter that the walker does not have, a range without its value,
    and for what is not a gait.
    """
    check_interval(walker, parameter, interval)
    value = float(getattr(walker, parameter))
    gait = find_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    if not gait.found:
        raise WrongUse(f"gait must be one, unlike the end of a failed search, {gait.states}")
    start = Start(value, np.asarray(gait.states, float))
    return continue_gaits(walker, parameter, interval, [start], tolerance=tolerance)[0]


def continue_gaits(
    walker: Walker,
    parameter: str,
    interval: tuple[float, float],
    starts: Sequence[Start],
    *,
    tolerance: Real | None = None,
) -> list[Branch]:
    """The branches through many starts, of any periods; all are followed together.

    As `continue_gait` otherwise. The walker gives the values of its other parameters. A start that
    is no gait gives a branch without points.
    """
    tolerance = double_tolerance(tolerance)
    low, high = check_interval(walker, parameter, interval)
    for start in starts:
        if not low <= start.value <= high:
            raise WrongUse(f"interval ({low}, {high}) must hold the {parameter} {start.value}")
    tasks = [
        follow(start, way, (low, high))
        for start in starts
        for way in ((-1.0, 1.0) if start.direction is None else (1.0,))
    ]
    paths = iter(together(walker, parameter, tasks, tolerance))
    branches = []
    for start in starts:
        back = next(paths) if start.direction is None else Path([], [], [], "a period doubling")
        branches.append(joined(parameter, back, next(paths), len(walker.section)))
    return branches


def check_interval(
    walker: Walker, parameter: str, interval: tuple[float, float]
) -> tuple[float, float]:
    """The two ends of an interval of a walker's parameter, checked."""
    check_parameter(walker, parameter)
    ends = numbers("interval", interval)
    if ends.shape != (2,) or not -np.inf < ends[0] < ends[1] < np.inf:
        raise WrongUse(f"interval must be (low, high) with low below high, not {short(interval)}")
    check_parameter(walker, parameter, *interval)
    return float(interval[0]), float(interval[1])


def double_tolerance(tolerance: Real | None) -> Real:
    """The tolerance in float64, without which nothing here can be told from rounding."""
    check_precision(jnp.asarray(0.0).dtype, "following gaits over a parameter")
    return default_tolerance(jnp.float64, tolerance)


def joined(parameter: str, back: Path, forth: Path, size: int) -> Branch:
    """The branch of the two sides of a start."""
    points = [*reversed(back.points[1:]), *forth.points]
    if not points:
        nothing = np.zeros((0, 1, size))
        return Branch(
            parameter,
            nothing[:, 0, 0],
            nothing,
            nothing[:, 0],
            nothing[:, :, 0],
            [],
            [],
            (back.end, forth.end),
        )
    local = [point.local for point in points]
    return Branch(
        parameter=parameter,
        values=np.array([point.value for point in points]),
        states=np.stack([point.cycle for point in points]),
        multipliers=multipliers_of(product(np.concatenate([one.jacobian for one in local]))),
        step_times=np.concatenate([one.time for one in local]),
        folds=[*reversed(back.folds), *forth.folds],
        doublings=[*reversed(back.doublings), *forth.doublings],
        ends=(back.end, forth.end),
    )


def crossings(branch: Branch, value: float) -> list[Float[np.ndarray, "period section"]]:
    """States of a branch's gaits at a value of the parameter, interpolated between its points."""
    cycles = []
    for i in np.flatnonzero((branch.values[:-1] - value) * (branch.values[1:] - value) <= 0):
        low, high = branch.values[i], branch.values[i + 1]
        share = 0.5 if low == high else (value - low) / (high - low)
        cycles.append((1 - share) * branch.states[i] + share * branch.states[i + 1])
    return cycles
