"""Curves of bifurcations in two parameters.

A fold, a doubling, a Neimark-Sacker or a branch point of a gait is located over one parameter. As a
second parameter changes, it moves along a curve, which may bound a region where the gait is stable.
Pseudo-arclength continuation follows the curve. The unknowns of its equations are the gait, the
eigenvectors of its critical multipliers, and both parameters (`defining_systems`). Each point of
the curve has the coefficient of its normal form (`normal_forms`). Points of codimension two, where
curves meet or end or where the bifurcation changes its type, are located too (`codimension_two`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from walker_jax.checks import WrongUse, check_kind, numbers, refuses_tracers, short
from walker_jax.gaits.branches import float64_tolerance
from walker_jax.gaits.codimension_two import CodimensionTwo
from walker_jax.gaits.event_paths import CURVE_CLOSES, EventPath, Ranges, first_point, follow_event
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.normal_forms import criticality
from walker_jax.gaits.requests import compute_responses, run_batched
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, value_of


class EventCurve(NamedTuple):
    """Bifurcations of one kind over two parameters, in their order along the curve."""

    kind: str
    """"fold", "doubling", "neimark-sacker" or "branch point"."""
    parameters: tuple[str, str]
    values: Float[np.ndarray, "points 2"]
    """Values of both parameters."""
    states: Float[np.ndarray, "points period section"]
    multipliers: Complex[np.ndarray, "points section"]
    """Floquet multipliers, the largest in modulus first."""
    coefficients: Float[np.ndarray, " points"]
    """Coefficients of the normal forms (`normal_forms`); NaN for branch points."""
    special: list[CodimensionTwo]
    """Points of codimension two."""
    ends: tuple[str, str]
    """Reasons why the curve ends at its first and at its last point."""

    @property
    def period(self) -> int:
        return self.states.shape[1]

    @property
    def criticality(self) -> list[str]:
        """ "supercritical" or "subcritical" at each point; empty for folds and branch points."""
        return [criticality(self.kind, one) for one in self.coefficients.tolist()]


@refuses_tracers()
def continue_event(
    system: System,
    event: Bifurcation,
    parameters: Sequence[str] = ("slope", "hip_stiffness"),
    bounds: Mapping[str, Any] | None = None,
    *,
    tolerance: Real | None = None,
) -> EventCurve:
    """Follow a bifurcation over two parameters, in both directions.

    ```python
    walker = wj.SpringWalker(slope=0.012, hip_stiffness=0.2)
    branch = wj.continue_gait(walker, "slope", (0.01, 0.04))
    bounds = {"slope": (0.01, 0.04), "hip_stiffness": (0.1, 0.4)}
    curve = wj.continue_event(walker, branch.doublings[0], bounds=bounds)
    curve.values, curve.criticality
    ```

    Steps are as long as the curvature allows. Two points of codimension two of one kind within one
    step are missed. The curve ends where it leaves the bounds, where a state no longer makes a
    stride, where it closes, where a gait returns to the one of half its period, where the pair of
    multipliers of a Neimark-Sacker point becomes real, or where two branches no longer cross.

    **Arguments:**

    - `system`: gives the value of the second parameter at the event, and those of all others.
    - `event`: a bifurcation of this system over the first parameter, as `continue_gait` finds it.
    - `parameters`: names of two parameters.
    - `bounds`: lowest and highest value of each parameter, by name.
    - `tolerance`: tolerance of the integration, as in `stride`.

    **Returns** an `EventCurve`. It begins at the end towards which the second parameter falls at
    first.

    Raises `ValueError` for parameters that the system does not have, for bounds that do not hold
    the event, and for an event that is not one of this system.
    """
    check_kind("system", system, System)
    check_kind("event", event, Bifurcation)
    names, ranges = check_bounds(system, parameters, bounds)
    if np.shape(event.states)[1:] != (len(system.section),):
        raise WrongUse(f"event must be one on the section {', '.join(system.section)}", of="event")
    values = np.array([event.value, float(value_of(system, names[1]))])
    if not ranges.hold(values):
        raise WrongUse(
            f"bounds must hold the event, at {names[0]} {values[0]:g} and {names[1]} {values[1]:g}"
        )
    asked = [(values, event)]
    (curve,) = continue_events(system, asked, names, ranges, tolerance=tolerance, within=1e-6)
    if curve is None:
        raise WrongUse(
            f"event must be one of this system, at {names[0]} {values[0]:g} and {names[1]} "
            f"{values[1]:g}: continue_gait locates them"
        )
    return curve


def check_bounds(system: System, parameters: Any, bounds: Any) -> tuple[tuple[str, str], Ranges]:
    """Return two different parameters of a system, and their ranges, checked."""
    names = tuple(parameters) if isinstance(parameters, Sequence) else ()
    words = all(isinstance(name, str) for name in names) and not isinstance(parameters, str)
    if not words or len(names) != 2 or names[0] == names[1]:
        raise WrongUse(f"parameters must be two different names, not {short(parameters)}")
    if not isinstance(bounds, Mapping) or set(bounds) != set(names):
        raise WrongUse(
            f"bounds must give the lowest and highest {names[0]} and {names[1]} by name, not "
            f"{short(bounds)}"
        )
    for name in names:
        check_parameter(system, name)
        ends = numbers("bounds", bounds[name])
        if ends.shape != (2,) or not -np.inf < ends[0] < ends[1] < np.inf:
            raise WrongUse(
                f"bounds of {name} must be (low, high) with low below high, not "
                f"{short(bounds[name])}"
            )
        check_parameter(system, name, *ends.tolist())
    return (names[0], names[1]), Ranges(*np.array([bounds[name] for name in names], float).T)


def continue_events(
    system: System,
    events: Sequence[tuple[Float[np.ndarray, " 2"], Bifurcation]],
    names: tuple[str, str],
    ranges: Ranges,
    *,
    tolerance: Real | None = None,
    within: float = np.inf,
) -> list[EventCurve | None]:
    """Follow the curves of many bifurcations, each at values of both parameters, all at once.

    A curve is None where there is no such bifurcation, or none `within` a share of the ranges.
    """
    integrator = Integrator(float64_tolerance(tolerance)).in_dtype(float)
    compute = partial(compute_responses, system, names, integrator)
    starts = [
        first_point(one.kind, values, np.asarray(one.states, float), one.multipliers, ranges)
        for values, one in events
    ]
    first = run_batched(starts, compute)
    off = lambda point, values: np.abs((point.unknowns.values - values) / ranges.widths).max()
    known = [
        i
        for i, (point, (values, _)) in enumerate(zip(first, events, strict=True))
        if point is not None and off(point, values) < within
    ]
    tasks = [
        follow_event(events[i][1].kind, first[i], sign, ranges)
        for i in known
        for sign in (-1.0, 1.0)
    ]
    paths = run_batched(tasks, compute)
    curves: list[EventCurve | None] = [None] * len(events)
    for n, i in enumerate(known):
        kind, sides = events[i][1].kind, paths[2 * n : 2 * n + 2]
        curves[i] = join_paths(kind, names, ranges, *sides)
    return curves


def join_paths(
    kind: str, names: tuple[str, str], ranges: Ranges, backward: EventPath, forward: EventPath
) -> EventCurve:
    """Join the two sides of a curve, from its start; all its values are in the ranges.

    A path that comes back to the start is the whole curve.
    """
    if forward.end == CURVE_CLOSES:
        backward = backward._replace(points=backward.points[:1], special=[], end=forward.end)
    points = [*reversed(backward.points[1:]), *forward.points]
    return EventCurve(
        kind,
        names,
        np.clip([one.unknowns.values for one in points], ranges.low, ranges.high),
        np.array([one.unknowns.cycle for one in points]),
        np.array([one.multipliers for one in points]),
        np.array([one.coefficient for one in points]),
        [*reversed(backward.special), *forward.special],
        (backward.end, forward.end),
    )
