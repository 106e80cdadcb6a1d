"""Edge states, which walkers approach that start exactly on the boundary between two fates.

On a smooth boundary that is a saddle, an unstable gait whose stable manifold the boundary is. But
the stride function is not continuous: the boundary may also be one of a stride's own failures, or
the starts that lead there. Walkers on that balance, as it were: the stance leg comes to rest
upright, or the swing foot only grazes the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Int

from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.edge_tracking import follow_edge
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.memory import check_state
from walker_jax.basins.runs import label_of
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_precision,
    check_whole,
    refuses_tracers,
)
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import Integrator, integrator_of
from walker_jax.systems.outcomes import Outcome, name_of_outcome
from walker_jax.systems.system import System, check_single
from walker_jax.walking.failure_margins import Margins, follow_margins
from walker_jax.walking.iteration import for_each_start
from walker_jax.walking.iteration import strides as take_strides

LONGEST_PERIOD = 16
"""Strides of the longest cycle that is recognised as one."""
NEAR = 1e-4
"""Distance from the end of the path, at most, of the saddle that Newton's iteration finds there."""
WAYS = Margins._fields[1:]
"""The margins of a stride, in the order in which ties are decided."""
ZERO = 1e-8
"""Size of a margin, at most, that is zero where the path is torn apart: starts 1e-13 beside the
boundary have about 1e-13 of it, or more where its slope is steep."""
SAMPLE = 257
"""Starts between the two, to whose attractors walkers are followed."""


class EdgeState(NamedTuple):
    """The state or set to which the boundary between two fates leads."""

    kind: str
    """"saddle", an unstable gait; the name of a margin that is zero there, for the boundary of a
    stride's own failure: "backward" (the stance leg comes to rest upright), "forward" (the swing
    foot grazes the ground), or another one of `Margins`; or "" where neither shows."""
    saddle: Gait | None
    """The gait, with its multipliers; None unless `kind` is "saddle"."""
    path: Float[np.ndarray, "n section"]
    """Points of the boundary, each a stride after the one before."""
    fates: tuple[Outcome, Outcome]
    """Of walkers just beside the path, on both sides, at its end: the fates of a and b, unless a
    third is between these everywhere. `STRIDE` for walkers that converge to an attractor."""
    margin: float
    """The smallest size of a margin at the path's end, in the unit of that margin; else NaN."""


@refuses_tracers("the saddle is a gait, which find_gait follows under transformations")
def edge_state(
    walker: System,
    a: Float[ArrayLike, " section"],
    b: Float[ArrayLike, " section"],
    *,
    rounds: int = 200,
    strides: int = 500,
    tolerance: float | None = None,
) -> EdgeState:
    """The state to which the boundary between two starts of different fates leads.

    By edge tracking: bisection finds a point of the boundary between a and b, to 1e-13; a stride
    moves the two starts beside it, and bisection brings these together again; and so on, until the
    path repeats itself, or a stride tears the two apart. Where the path repeats itself, Newton's
    iteration finds the gait. A boundary that is fractal has many edge states, and the path comes
    to one of them, or to none.

    **Arguments:**

    - `walker`: of one kind, with numbers for parameters.
    - `a`, `b`: starts on the section, of different fates, or that converge to different attractors.
    - `rounds`: strides of the path, at most.
    - `strides`: number of strides for which a walker is followed to its fate.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for starts of one fate, or that are not feasible, and in float32;
    `ComputationFailed` where rounding loses the boundary.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    check_precision(jnp.asarray(0.0).dtype, "edge_state, which brings starts 1e-13 together,")
    check_whole("rounds", rounds)
    check_whole("strides", strides)
    ends = [check_state(walker, "a", a), check_state(walker, "b", b)]
    for name, end in zip("ab", ends, strict=True):
        if not bool(walker.feasible(jnp.asarray(end))):
            raise WrongUse(f"{name} must be a feasible start, not {end.tolist()}")
    integrator = integrator_of(float, tolerance)
    share = np.linspace(0, 1, SAMPLE)[:, None]
    mapper = Mapper(walker, [], integrator, strides)
    mapper = mapper.with_attractors_from((1 - share) * ends[0] + share * ends[1])
    mapper = with_capture_boxes(mapper)

    def label_starts(x: Float[np.ndarray, "n section"]) -> Int[np.ndarray, " n"]:
        nonlocal mapper
        found, mapper = mapper.label_all(x)
        return label_of(found.fate, found.attractor)

    first, second = label_starts(np.stack(ends)).tolist()
    if first == second:
        fate = explain_fate(first, walker.failures)
        raise WrongUse(f"a and b must have different fates, not both {fate}")
    image = lambda x: np.asarray(take_strides(walker, x, tolerance=tolerance).state)

    saddle: Gait | None = None

    def is_saddle(states: Float[np.ndarray, "period section"]) -> bool:
        nonlocal saddle
        gait = search_gait(walker, states, len(states), tolerance=tolerance)
        near = np.abs(np.asarray(gait.states[0]) - states[0]).max() < NEAR
        saddle = gait if gait.found and near and not gait.stable else None
        return saddle is not None

    track = follow_edge(
        image,
        label_starts,
        *ends,
        rounds=rounds,
        longest=LONGEST_PERIOD,
        is_cycle=is_saddle,
    )
    fates = fate_of(track.labels[0]), fate_of(track.labels[1])
    if track.torn:
        name, margin = failing_margin(walker, track.sides, integrator)
        return EdgeState(name if margin < ZERO else "", None, track.path, fates, margin)
    return EdgeState("" if saddle is None else "saddle", saddle, track.path, fates, np.nan)


def fate_of(label: int) -> Outcome:
    """The fate of walkers with a label."""
    return Outcome(label) if label < len(Outcome) else Outcome.STRIDE


def explain_fate(label: int, failures: Sequence[str] = ()) -> str:
    """A fate that two starts share, and what to try instead of them."""
    name = name_of_outcome(fate_of(label), failures)
    if label == Outcome.UNDECIDED:
        return f"{name}: the integration gave no answer; try another tolerance, or other starts"
    where = ", to the same gait" if label >= len(Outcome) else ""
    return f"{name}{where}: try a start on the other side of the boundary"


def failing_margin(
    walker: System, x: Float[np.ndarray, "n section"], integrator: Integrator
) -> tuple[str, float]:
    """The margin that is nearest to zero in the strides from some starts, and its size."""
    found = for_each_start(follow_margins, walker, x, integrator.tolerance, integrator.solver)
    sizes = np.array([np.abs(getattr(found, name)) for name in WAYS])
    sizes = np.nanmin(np.where(np.isnan(sizes), np.inf, sizes), axis=1)
    return WAYS[int(sizes.argmin())], float(sizes.min())
