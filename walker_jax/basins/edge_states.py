"""Edge states: the states approached by walkers started exactly on the boundary between two fates.

On a smooth boundary the edge state is a saddle: an unstable gait whose stable manifold is the
boundary. But the stride function is not continuous. The boundary may also be the boundary of a
stride's own failure, or the starts that lead there. Walkers on it are just balanced: the stance leg
comes to rest upright, or the swing foot only grazes the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.basins.attractor_search import survey
from walker_jax.basins.edge_tracking import follow_edge
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_precision,
    check_whole,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.gaits.cycles import Gait, cycle_distance
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.systems.angles import turn_to, turns_of
from walker_jax.systems.outcomes import OUTCOMES, Outcome, name_of_outcome
from walker_jax.systems.system import System, check_single
from walker_jax.walking.failure_margins import WAYS, follow_margins
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.iteration import strides as take_strides

LONGEST_PERIOD = 16
"""Longest cycle, in strides, that is recognised as one."""
NEAR = 1e-4
"""Largest distance between the end of the path and the saddle that Newton's iteration finds
there."""
ZERO = 1e-8
"""Largest size of a margin that counts as zero where the path is torn apart. Starts 1e-13 beside
the boundary have a margin of about 1e-13, or more where it changes steeply."""
SAMPLE = 257
"""Number of starts between a and b whose attractors are looked for."""


class EdgeState(NamedTuple):
    """The state or set to which the boundary between two fates leads."""

    kind: str
    """"saddle" for an unstable gait. For the boundary of a stride's own failure, the name of the
    margin that is zero there: "backward" (the stance leg comes to rest upright), "forward" (the
    swing foot grazes the ground), another attribute of `Margins`, or the name of a failure of the
    system's own. "" where neither shows."""
    saddle: Gait | None
    """The gait, with its multipliers; None unless `kind` is "saddle"."""
    path: Float[np.ndarray, "n section"]
    """Points of the boundary, each one stride after the previous one."""
    fates: tuple[Outcome, Outcome]
    """Fates of walkers just beside the path's end, on both sides: the fates of a and b, unless a
    third fate lies between these everywhere. `STRIDE` for walkers that converge to an attractor."""
    margin: float
    """The smallest size of a margin at the path's end, in the unit of that margin; NaN
    otherwise."""


@refuses_tracers("the saddle is a gait, which find_gait follows under transformations")
def edge_state(
    walker: System,
    a: Float[ArrayLike, " section"] | Sequence[Any],
    b: Float[ArrayLike, " section"] | Sequence[Any],
    *,
    rounds: int = 200,
    strides: int = 500,
    tolerance: float | None = None,
) -> EdgeState:
    """Find the state to which the boundary between two starts of different fates leads.

    The method is edge tracking. Bisection finds a point of the boundary between a and b, to 1e-13.
    A stride moves the two starts beside it, and bisection brings these together again. This repeats
    until the path repeats itself, or a stride tears the two apart. Where the path repeats itself,
    Newton's iteration finds the gait. A fractal boundary has many edge states: the path comes to
    one of them, or to none.

    ```python
    walker = wj.SimplestWalker(0.004)
    state = wj.edge_state(walker, (0.2, -0.2), (0.2, -0.15))  # one start walks, one falls
    state.kind, state.path[-1]
    ```

    **Arguments:**

    - `walker`: one walker, with numbers for parameters.
    - `a`, `b`: starts on the section with different fates, or that converge to different
      attractors.
    - `rounds`: most strides of the path.
    - `strides`, `tolerance`: as in `refine`.

    Raises `ValueError` for starts of one fate, for starts that are not feasible, and in float32;
    `ComputationFailed` where rounding loses the boundary.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    check_precision(jnp.result_type(float), "edge_state, which brings starts 1e-13 together,")
    check_whole("rounds", rounds)
    ends = [check_state(walker, "a", a), check_state(walker, "b", b)]
    for name, end in zip("ab", ends, strict=True):
        if not bool(walker.feasible(jnp.asarray(end))):
            raise WrongUse(f"{name} must be a feasible start, not {end.tolist()}")
    integrator = integrator_of(float, tolerance)
    share = np.linspace(0, 1, SAMPLE)[:, None]
    between = (1 - share) * ends[0] + share * ends[1]
    mapper = survey(walker, between, integrator, strides, boxes=True).mapper
    label_starts = lambda x: mapper(x).number
    first, second = label_starts(np.stack(ends)).tolist()
    if first == second:
        fate = explain_fate(first, walker.failures)
        raise WrongUse(f"a and b must have different fates, not both {fate}")
    turns = turns_of(walker)

    def image(x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "n section"]:
        found = np.asarray(take_strides(walker, x, tolerance=tolerance).state)
        return turn_to(found, found[:1], turns)

    def saddle_at(states: Float[np.ndarray, "period section"]) -> Gait | None:
        gait = search_gait(walker, states, len(states), tolerance=tolerance)
        near = cycle_distance(np.asarray(gait.states[:1]), states[:1], turns) < NEAR
        return gait if gait.found and near and not gait.stable else None

    is_cycle = lambda states: saddle_at(states) is not None
    how: Any = {"rounds": rounds, "longest": LONGEST_PERIOD, "is_cycle": is_cycle}
    track = follow_edge(image, label_starts, *ends, **how)
    saddle = saddle_at(track.path[-track.period :]) if track.period else None
    fates = fate_of(track.labels[0]), fate_of(track.labels[1])
    if track.torn:
        name, margin = failing_margin(walker, track.sides, integrator)
        return EdgeState(name if margin < ZERO else "", None, track.path, fates, margin)
    return EdgeState("" if saddle is None else "saddle", saddle, track.path, fates, np.nan)


def fate_of(label: int) -> Outcome:
    """Return the fate of walkers with a label."""
    return Outcome(label) if label < OUTCOMES else Outcome.STRIDE


def explain_fate(label: int, failures: Sequence[str] = ()) -> str:
    """Name a fate that two starts share, and suggest other starts."""
    name = name_of_outcome(fate_of(label), failures)
    if label == Outcome.UNDECIDED:
        return f"{name}: the integration gave no answer; try another tolerance, or other starts"
    where = ", to the same gait" if label >= OUTCOMES else ""
    return f"{name}{where}: try a start on the other side of the boundary"


def failing_margin(
    walker: System, x: Float[np.ndarray, "n section"], integrator: Integrator
) -> tuple[str, float]:
    """Return the margin that is nearest to zero in the strides from some starts, and its size."""
    found = for_each_start(follow_margins, walker, x, integrator.tolerance, integrator.solver)
    sizes = {
        name: np.min(np.abs(values), where=~np.isnan(values), initial=np.inf)
        for name, values in found.by_name.items()
    }
    nearest = min([*WAYS, *sizes], key=lambda name: sizes.get(name, np.inf))
    return WAYS.get(nearest, nearest), float(sizes.get(nearest, np.inf))


def check_state(walker: System, name: str, x: Any) -> Float[np.ndarray, " section"]:
    """Return a state on the walker's section as float64; raise `WrongUse` for any other value."""
    values = numbers(name, x)
    if values.shape != (len(walker.section),) or not np.isfinite(values).all():
        section = ", ".join(walker.section)
        raise WrongUse(f"{name} must be finite numbers on the section, {section}, not {short(x)}")
    return values
