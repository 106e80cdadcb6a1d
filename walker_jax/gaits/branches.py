"""Branches of gaits over a parameter of the walker: continuation and bifurcations.

Pseudo-arclength continuation (Keller 1977) passes folds: the cycle's states and the parameter p are
unknowns together, and the next point is where the branch meets a plane across its tangent. At a
fold a Floquet multiplier is 1, and two branches of gaits meet and end. At a period doubling a
multiplier is -1, and a gait of twice the period branches off. At a Neimark-Sacker point a conjugate
pair is on the unit circle, and motions without a period branch off. At a branch point a multiplier
is 1, and two branches cross. Newton's iteration locates all of these: its unknowns are the states,
the parameter and the vectors of the critical multipliers (`defining_systems`). It takes second
derivatives of the stride function by automatic differentiation, and normal forms (`normal_forms`)
take third ones.

Distances along a branch are sqrt(mean |dx|^2 + (dp / width of the range)^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import WrongUse, check_kind, check_precision, numbers, refuses_tracers, short
from walker_jax.execution.progress import bar
from walker_jax.gaits.arclength import CORRECTOR_STEPS
from walker_jax.gaits.continuation import BRANCH_CLOSES, Path, Start, follow_branch
from walker_jax.gaits.cycles import (
    MAX_RESIDUAL,
    Gait,
    check_found,
    find_multipliers,
    iterate_newton,
    multiply_jacobians,
)
from walker_jax.gaits.defining_systems import BRANCH, DOUBLING, FOLD, TORUS
from walker_jax.gaits.events import Bifurcation, add_normal_form
from walker_jax.gaits.requests import Request, compute_responses, run_batched
from walker_jax.gaits.selection import require_gait
from walker_jax.integrators.integrator import Integrator, default_tolerance
from walker_jax.integrators.roots import Real
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, value_of, with_parameter


class Branch(NamedTuple):
    """Gaits of one period over a parameter, in order along the branch."""

    parameter: str
    values: Float[np.ndarray, " points"]
    """Values of the parameter; they change direction at folds."""
    states: Float[np.ndarray, "points period section"]
    multipliers: Complex[np.ndarray, "points section"]
    """Floquet multipliers, the largest first."""
    step_times: Float[np.ndarray, "points period"]
    folds: list[Bifurcation]
    doublings: list[Bifurcation]
    ends: tuple[str, str]
    """The reasons why the branch ends, at its first point and at its last."""
    neimark_sackers: tuple[Bifurcation, ...] = ()
    branch_points: tuple[Bifurcation, ...] = ()
    """Points where another branch of gaits of the same period crosses this one."""

    @property
    def period(self) -> int:
        return self.states.shape[1]

    @property
    def events(self) -> list[Bifurcation]:
        """All bifurcations, kind by kind."""
        return [*self.folds, *self.doublings, *self.neimark_sackers, *self.branch_points]

    @property
    def stable(self) -> np.ndarray:
        """Whether each gait is stable, shape (points,)."""
        return np.abs(self.multipliers[:, 0]) < 1


@refuses_tracers()
def continue_gait(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    gait: Gait | None = None,
    *,
    normal_forms: bool = False,
    tolerance: Real | None = None,
    progress: bool = True,
) -> Branch:
    """Follow a gait over a range of a parameter, in both directions and past folds.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    branch = wj.continue_gait(walker, "slope", (0.002, 0.02))
    branch.doublings[0].value
    ```

    Steps are as long as the curvature of the branch allows. Two folds, or two doublings, within one
    step are missed. If a multiplier passes 1 without a fold, two branches cross: a branch point.
    This happens over gains of `Feedback`, as the gait does not depend on the gain. The branch ends
    where it leaves the range, where even the shortest step leads to a state that makes no stride,
    where it closes, or where it returns to the gait of half the period from which it doubled.

    **Arguments:**

    - `walker`: any walker.
    - `parameter`: name of one of its parameters.
    - `interval`: lowest and highest value of the parameter; the walker's own value must be within.
    - `gait`: a gait of this walker; by default, the one of `find_gait`.
    - `normal_forms`: whether to compute normal forms at bifurcations, which tell sub- from
      supercritical ones. Their third derivatives take ten seconds to compile, and minutes for
      walkers with knees.
    - `tolerance`: tolerance of the integration, as in `stride`.
    - `progress`: whether to show on a terminal how much of the interval is covered.

    **Returns** a `Branch`. It begins at the end towards which the parameter falls at first.

    Raises `ValueError` for a parameter that the walker does not have, a range without the walker's
    value, and a `gait` that is none, such as the result of a failed search.
    """
    check_interval(walker, parameter, interval)
    check_kind("normal_forms", normal_forms, bool)
    check_kind("progress", progress, bool)
    value = float(value_of(walker, parameter))
    gait = require_gait(walker, ["gait"], tolerance=tolerance) if gait is None else gait
    check_found(gait)
    start = Start(value, np.asarray(gait.states, float))
    label = "branch of gaits" if progress else None
    branches = continue_gaits(
        walker, parameter, interval, [start], tolerance=tolerance, progress=label
    )
    if normal_forms:
        branches = add_normal_forms(walker, parameter, branches, tolerance=tolerance)
    return branches[0]


def continue_gaits(
    walker: System,
    parameter: str,
    interval: tuple[float, float],
    starts: Sequence[Start],
    *,
    tolerance: Real | None = None,
    progress: str | None = None,
) -> list[Branch]:
    """Follow the branches through many starts of any periods, all at once.

    Otherwise as `continue_gait`. The walker gives the values of its other parameters. A start that
    is not a gait gives a branch without points.
    """
    tolerance = float64_tolerance(tolerance)
    low, high = check_interval(walker, parameter, interval)
    for start in starts:
        if not low <= start.value <= high:
            raise WrongUse(f"interval ({low}, {high}) must hold the {parameter} {start.value}")
    tasks = [
        follow_branch(start, sign, (low, high), turns_of(walker))
        for start in starts
        for sign in ((-1.0, 1.0) if start.direction is None else (1.0,))
    ]
    integrator = Integrator(tolerance).in_dtype(float)
    covered = [start.value for start in starts]
    with bar(progress or "", progress is not None, 100) as update:

        def compute(requests: list[Any]) -> list[Any]:
            covered.extend(one.value for one in requests if isinstance(one, Request))
            update(int(100 * (max(covered) - min(covered)) / (high - low)))
            return compute_responses(walker, [parameter], integrator, requests)

        paths = iter(run_batched(tasks, compute))
    branches = []
    for start in starts:
        backward = next(paths) if start.direction is None else Path([], [], "a period doubling")
        branches.append(join_paths(parameter, backward, next(paths), len(walker.section)))
    return branches


def add_normal_forms(
    walker: System, parameter: str, branches: Sequence[Branch], *, tolerance: Real | None = None
) -> list[Branch]:
    """Return the branches with the coefficients of the normal forms of all their bifurcations."""
    tasks = [add_normal_form(one) for branch in branches for one in branch.events]
    integrator = Integrator(float64_tolerance(tolerance))
    found = iter(run_batched(tasks, partial(compute_responses, walker, [parameter], integrator)))
    return [
        branch._replace(
            folds=[next(found) for _ in branch.folds],
            doublings=[next(found) for _ in branch.doublings],
            neimark_sackers=tuple(next(found) for _ in branch.neimark_sackers),
            branch_points=tuple(next(found) for _ in branch.branch_points),
        )
        for branch in branches
    ]


def check_interval(
    walker: System, parameter: str, interval: tuple[float, float]
) -> tuple[float, float]:
    """Return the two ends of an interval of a walker's parameter, checked."""
    check_parameter(walker, parameter)
    ends = numbers("interval", interval)
    if ends.shape != (2,) or not -np.inf < ends[0] < ends[1] < np.inf:
        raise WrongUse(f"interval must be (low, high) with low below high, not {short(interval)}")
    check_parameter(walker, parameter, *interval)
    return float(interval[0]), float(interval[1])


def float64_tolerance(tolerance: Real | None) -> Real:
    """Return the tolerance in float64; in float32, rounding errors would hide bifurcations."""
    check_precision(jnp.result_type(float), "following gaits over a parameter")
    return default_tolerance(jnp.float64, tolerance)


def join_paths(parameter: str, backward: Path, forward: Path, size: int) -> Branch:
    """Join the paths on both sides of a start into a branch; one may be the whole branch."""
    if forward.end == BRANCH_CLOSES:
        backward = Path(backward.points[:1], [], forward.end)
    points = [*reversed(backward.points[1:]), *forward.points]
    if not points:
        empty = np.zeros((0, 1, size))
        return Branch(
            parameter,
            empty[:, 0, 0],
            empty,
            empty[:, 0],
            empty[:, :, 0],
            [],
            [],
            (backward.end, forward.end),
        )
    local = [point.local for point in points]
    of_kind = lambda kind: [*reversed(backward.of_kind(kind)), *forward.of_kind(kind)]
    return Branch(
        parameter=parameter,
        values=np.array([point.value for point in points]),
        states=np.stack([point.cycle for point in points]),
        multipliers=find_multipliers(
            multiply_jacobians(np.concatenate([one.jacobian for one in local]))
        ),
        step_times=np.concatenate([one.time for one in local]),
        folds=of_kind(FOLD),
        doublings=of_kind(DOUBLING),
        ends=(backward.end, forward.end),
        neimark_sackers=tuple(of_kind(TORUS)),
        branch_points=tuple(of_kind(BRANCH)),
    )


def solve_at(
    walker: System,
    parameter: str,
    guesses: Sequence[tuple[float, Float[np.ndarray, "_ section"]]],
    tolerance: Real,
) -> list[Float[np.ndarray, "_ section"] | None]:
    """Find cycles from guesses by Newton's iteration, at given values of the parameter.

    None where it fails. The parameter keeps its value, unlike along a branch.
    """
    found: list[np.ndarray | None] = [None] * len(guesses)
    for period in {len(cycle) for _, cycle in guesses}:
        which = [i for i, (_, cycle) in enumerate(guesses) if len(cycle) == period]
        walkers = with_parameter(walker, parameter, np.array([guesses[i][0] for i in which]))
        cycles = np.stack([guesses[i][1] for i in which])
        ends = iterate_newton(walkers, cycles, Integrator(tolerance), CORRECTOR_STEPS)
        for i, states, residual in zip(which, ends.states, ends.residual, strict=True):
            if residual < MAX_RESIDUAL[states.dtype]:
                found[i] = states
    return found


def interpolate_cycles(branch: Branch, value: float) -> list[Float[np.ndarray, "period section"]]:
    """Interpolate the states of a branch's gaits at a value of the parameter."""
    cycles = []
    for i in np.flatnonzero((branch.values[:-1] - value) * (branch.values[1:] - value) <= 0):
        low, high = branch.values[i], branch.values[i + 1]
        share = 0.5 if low == high else (value - low) / (high - low)
        cycles.append((1 - share) * branch.states[i] + share * branch.states[i + 1])
    return cycles
