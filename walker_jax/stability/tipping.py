"""Tipping: walkers that end elsewhere because a parameter jumps from one value to another.

Of the walkers that converge to one attractor before the jump, some converge to another after it, or
fall. Their share is the share of the basin that another basin covers at the new value (Kaszas,
Feudel and Tel 2019, Scientific Reports 9, 8654). Walkers on the attractor itself at the jump are
followed too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.attractor_search import survey
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.runs import attractors_of, labels_among
from walker_jax.checks import (
    check_kind,
    check_number,
    check_precision,
    refuses_tracers,
)
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.sampling import Sampler, draw_starts, wilson_interval
from walker_jax.systems.outcomes import OUTCOMES, Outcome, name_of_outcome
from walker_jax.systems.system import System, check_single
from walker_jax.walkers.parameters import check_parameter, with_parameter
from walker_jax.walking.iteration import orbits

RUN = 2000
"""Number of states of a motion without a period that are followed after the jump."""


class Tipping(NamedTuple):
    """Ends of walkers after a jump of a parameter, by their ends without the jump."""

    probability: Float[np.ndarray, "n m"]
    """[i, j]: share of the starts with end i before the jump that have end j after it."""
    low: Float[np.ndarray, "n m"]
    high: Float[np.ndarray, "n m"]
    """Ends of Wilson's confidence interval of each share."""
    starts: Int[np.ndarray, "n m"]
    """Number of starts behind each estimate."""
    on_attractor: Float[np.ndarray, "n m"]
    """[i, j]: share of the states of attractor i from which a walker has end j after the jump; NaN
    for ends that are failures."""
    before: tuple[str, ...]
    after: tuple[str, ...]
    """Names of the ends that occur: "attractor 0" ..., or the name of an `Outcome`; "unknown
    attractor" for walkers that walk to the last stride without coming near one."""
    attractors_before: list[Float[np.ndarray, "period section"]]
    attractors_after: list[Float[np.ndarray, "period section"]]
    """States of the attractors, by number; one state of a motion that does not repeat itself."""


@refuses_tracers()
def tipping_probability(
    walker: System,
    parameter: str,
    value: float,
    region: Grid | Sampler,
    *,
    samples: int = 10_000,
    strides: int = 500,
    confidence: float = 0.95,
    seed: int = 0,
    tolerance: float | None = None,
) -> Tipping:
    """Estimate the chance to end elsewhere after a parameter jumps to another value.

    P(i -> j) = |B_i(p-) and B_j(p+)| / |B_i(p-)|

    with B_i(p-) the basin of attractor i before the jump, within a region, and B_j(p+) the basin of
    j after it. Failures count as ends, too.

    ```python
    region = wj.Grid.sheared(theta=(0, 0.4, 2), sum=(-0.04, 0.01, 2))
    found = wj.tipping_probability(wj.SimplestWalker(0.004), "slope", 0.012, region, samples=2000)
    found.before, found.after, found.probability
    ```

    **Arguments:**

    - `walker`: the walker before the jump.
    - `parameter`, `value`: the parameter that jumps, and its value after the jump.
    - `region`: a grid, in whose region starts are uniformly distributed; or a function that draws
      starts, as in `basin_stability`.
    - `samples`: number of starts, followed before and after the jump.
    - `strides`: number of strides for which a walker is followed.
    - `confidence`: of the intervals.
    - `seed`, `tolerance`: as in `refine`.

    Raises `ValueError` for arguments out of range, and for values that the walker refuses.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    check_number("value", value)
    check_parameter(walker, parameter, float(value))
    dtype = jnp.result_type(float)
    check_precision(dtype)
    integrator = integrator_of(dtype, tolerance)
    rng = np.random.default_rng(seed)
    starts = draw_starts(walker, "region", region, rng, samples).astype(dtype)
    labels_before, before, _ = survey(walker, starts, integrator, strides, boxes=True)
    jumped = [states_on(before, attractor) for attractor in before.attractors]
    other = with_parameter(walker, parameter, float(value))
    labels, after, _ = survey(
        other, np.concatenate([starts, *jumped]), integrator, strides, boxes=True
    )
    own, *others = np.split(labels.number, np.cumsum([samples, *map(len, jumped)])[:-1])
    return assemble_tipping(labels_before.number, own, others, before, after, confidence)


def assemble_tipping(
    first: Int[np.ndarray, " starts"],
    second: Int[np.ndarray, " starts"],
    jumped: list[Int[np.ndarray, " states"]],
    before: Mapper,
    after: Mapper,
    confidence: float,
) -> Tipping:
    """Assemble the result of `tipping_probability`.

    The ends of starts before and after the jump, and after it from the states of each attractor,
    are numbers of labels.
    """
    rows, columns = labels_among(first), labels_among(np.concatenate([second, *jumped]))
    counts = (first == rows[:, None]).astype(int) @ (second[:, None] == columns)
    total = counts.sum(axis=1, keepdims=True)
    intervals = np.array(
        [
            [wilson_interval(hits, n, confidence) for hits in row]
            for row, n in zip(counts.tolist(), total[:, 0].tolist(), strict=True)
        ]
    )
    on_attractor = np.full(counts.shape, np.nan)
    for row, attractor in zip(on_attractor, attractors_of(rows), strict=True):
        if attractor >= 0:
            row[:] = (jumped[attractor][:, None] == columns).mean(axis=0)
    names = lambda found: tuple(name_of(end, before.walker.failures) for end in found.tolist())
    return Tipping(
        probability=counts / total,
        low=intervals[..., 0],
        high=intervals[..., 1],
        starts=counts,
        on_attractor=on_attractor,
        before=names(rows),
        after=names(columns),
        attractors_before=[one.states for one in before.attractors],
        attractors_after=[one.states for one in after.attractors],
    )


def name_of(end: int, failures: Sequence[str]) -> str:
    """Return the name of an end."""
    if end >= OUTCOMES:
        return f"attractor {end - OUTCOMES}"
    return "unknown attractor" if end == Outcome.STRIDE else name_of_outcome(end, failures)


def states_on(mapper: Mapper, attractor: Attractor) -> Float[np.ndarray, "n section"]:
    """Return the states of a cycle, or many of a motion that does not repeat itself."""
    if attractor.period:
        return attractor.states
    states, _ = orbits(mapper.walker, attractor.states[:1], RUN, mapper.integrator)
    return states[0][np.isfinite(states[0]).all(axis=1)]
