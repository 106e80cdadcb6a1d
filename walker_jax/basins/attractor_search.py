"""The search for attractors: once, from starts that label them too.

A few scouts find the cycles with large basins. All starts are then labelled with these, and walks
that come to none of them lead to the other attractors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import (
    SAMPLE,
    Attractor,
    all_motions,
    capture_radius,
    in_order,
    match_attractor,
    new_cycle,
    sample_indices,
)
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.labels import BLOCKS, CLOSE, LONGEST_PERIOD, SURVIVAL, Label
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.motions import SPARSE, clouds_of, distinct_motions, nearest_motion
from walker_jax.gaits.cycles import (
    find_multipliers,
    gait_at,
    iterate_newton,
    linearise,
    multiply_jacobians,
)
from walker_jax.gaits.search import cycle_guesses
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import difference, turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.iteration import iterate, orbits

Points = Float[np.ndarray, "n section"]

SCOUTS = 2**8
"""Number of starts that are followed first; most of the others end on the cycles that these
find."""
PATIENCE = 8
"""Rounds of `LONGEST_PERIOD` strides in which a walker is to converge to a cycle."""
ATTEMPTS = 8
"""Number of undecided walkers from which Newton's iteration solves for a cycle."""
MAX_RETURN_DISTANCE = 1e-4
"""Distance to which a walker that approaches a cycle, however slowly, has returned after those
rounds. At a period doubling the distance from the cycle falls like n^-1/2 after n strides, and the
distance of a return like n^-3/2. A motion without a period returns to about 1e-3, the best of 64
tries."""
WITNESSES = 128
"""Number of walkers followed to see whether motions without a period last."""
MOST_MOTIONS = 16
"""Most motions without a period that count as attractors of their own. Walkers of a conservative
system have each their own motion: all of these count as one."""


def survey(
    walker: System, starts: Points, integrator: Integrator, strides: int, *, boxes: bool = False
) -> Found:
    """Find the attractors of starts, in the order in which a basin numbers them, and the labels."""
    scouts = starts[scouts_among(len(starts))]
    scouted = mapper_of_scouts(walker, scouts, integrator, strides, boxes=boxes)
    labels, mapper, made = label_and_find(scouted, starts, boxes=boxes)
    attractors, number = in_order(mapper.attractors)
    labels = labels._replace(attractor=number[labels.attractor])
    return Found(labels, mapper._replace(attractors=attractors), made)


def scouts_among(n: int) -> Int[np.ndarray, " m"]:
    """Return the indices of the scouts among n starts; few starts have none."""
    return sample_indices(n, SCOUTS if n > SCOUTS else 0)


def mapper_of_scouts(
    walker: System, scouts: Points, integrator: Integrator, strides: int, *, boxes: bool = False
) -> Mapper:
    """Return the mapper to the cycles to which scouts converge, perhaps with capture boxes."""
    cycles: list[Attractor] = []
    add_cycles(walker, scouts, cycles, integrator)
    mapper = Mapper(walker, cycles, integrator, strides)
    return with_capture_boxes(mapper) if boxes else mapper


class Found(NamedTuple):
    """The labels of starts, and the mapper to all attractors that they led to."""

    labels: Label
    mapper: Mapper
    made: int
    """Number of all strides made from the starts."""


def label_and_find(
    mapper: Mapper,
    starts: Points,
    *,
    boxes: bool = False,
    most: int = SAMPLE,
    progress: str | None = None,
) -> Found:
    """Label starts, and find the attractors of those that come to no known one.

    Other arguments are those of `complete`.
    """
    return complete(
        mapper, starts, mapper.follow(starts, progress=progress), boxes=boxes, most=most
    )


def complete(
    mapper: Mapper, starts: Points, labels: Label, *, boxes: bool = False, most: int = SAMPLE
) -> Found:
    """Label walks that have made all strides, and find their attractors from `most` of them.

    Walks to a cycle that was unknown went on beyond its capture boxes, so their strides are counted
    again. With `boxes` the new cycles get boxes that shorten walks.
    """
    made, left, known = labels.total_strides, labels.remaining, len(mapper.attractors)
    if len(left):
        ends = labels.state[left]
        strange = ends[~mapper.on_known_motions(ends)]
        mapper = with_attractors_from(mapper, sample(strange, most))
        if boxes and len(mapper.attractors) > known:
            mapper = with_capture_boxes(mapper)
        number = labels.attractor[left] = mapper.identify(ends)
        cycles = [i for i, one in enumerate(mapper.attractors) if i >= known and one.period]
        late = left[np.isin(number, cycles)]
        labels.strides[late] = mapper.follow(starts[late]).strides
        made += int(labels.strides[late].sum())
    return Found(labels, mapper, made)


def with_attractors_from(mapper: Mapper, starts: Points) -> Mapper:
    """Return the mapper to the attractors of some starts too."""
    found = search(mapper.walker, starts, mapper.integrator, mapper.attractors)
    return mapper._replace(attractors=found)


def sample(x: Points, most: int = SAMPLE) -> Float[np.ndarray, "m section"]:
    """Return some of many points, evenly spread over their order."""
    return x[sample_indices(len(x), most)]


def search(
    walker: System, x: Points, integrator: Integrator, known: Sequence[Attractor] = ()
) -> list[Attractor]:
    """Find the attractors to which walkers converge from x, and add them to the known ones.

    Walkers are followed until each has failed, or repeats itself to rounding. Some do neither in
    some hundred strides, as close to a period doubling: for these a stable cycle is solved for. If
    there is none, and none of these walkers falls or converges to a cycle for long, they are on
    attractors without a period.
    """
    found = list(known)
    if len(x) > SCOUTS:
        add_cycles(walker, sample(x, SCOUTS), found, integrator)
        if any(one.period for one in found):
            mapper = Mapper(walker, found, integrator, PATIENCE * LONGEST_PERIOD)
            x = x[mapper.walk(x).undecided]
    x, solved = add_cycles(walker, x, found, integrator)
    if len(x) and not solved and not any(one.stands_for_all for one in found):
        found += lasting_motions(walker, sample(x, WITNESSES), found, integrator)
    return found


def add_cycles(
    walker: System, x: Points, found: list[Attractor], integrator: Integrator
) -> tuple[Float[np.ndarray, "m section"], bool]:
    """Add the cycles to which walkers converge.

    Returns the states of walkers that neither failed nor came to a cycle, and whether some of them
    approach a cycle that was solved for.
    """
    x, period, nearest = add_repeated(walker, x, found, integrator)
    slow = np.flatnonzero(nearest < MAX_RETURN_DISTANCE)[:ATTEMPTS]
    solved = [
        cycle
        for start, count in zip(x[slow], period[slow], strict=True)
        if (cycle := stable_cycle(walker, start, int(count), integrator)) is not None
    ]
    for states in solved:
        if cycle := new_cycle(states, found, turns_of(walker)):
            found.append(cycle)
    return x, bool(solved)


def add_repeated(
    walker: System, x: Points, found: list[Attractor], integrator: Integrator
) -> tuple[Float[np.ndarray, "m section"], Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Add the cycles on which walkers repeat themselves to rounding, in `PATIENCE` rounds.

    For walkers that neither failed nor came to a cycle, it returns their states, the strides after
    which each came nearest to its present state, and that distance. Walkers repeat themselves on
    unstable cycles too, if they start there or come exactly along the stable manifold.
    """
    exact, unstable, turns = 1e3 * np.finfo(x.dtype).eps, [], turns_of(walker)
    period, nearest = np.ones(len(x), int), np.zeros(len(x))
    for _ in range(PATIENCE):
        states, outcome = orbits(walker, x, LONGEST_PERIOD, integrator)
        walks = outcome == Outcome.STRIDE
        back = states[walks, ::-1]  # (walkers, strides back, coordinates)
        misses = np.abs(difference(back[:, 1:], back[:, :1], turns)).max(axis=2)
        repeated = (misses < exact).any(axis=1)
        for path, miss in zip(back[repeated], misses[repeated], strict=True):
            # A slow approach that alternates returns close after two strides before it does after
            # one.
            count = first_period(miss, capture_radius(x.dtype))
            if cycle := new_cycle(path[:count][::-1], [*found, *unstable], turns):
                stable = attracts(walker, cycle.states, integrator)
                (found if stable else unstable).append(cycle)
        x = back[:, 0]
        left = ~repeated & (match_attractor(x, found, turns=turns) < 0)
        x, misses = x[left], misses[left]
        period, nearest = misses.argmin(axis=1) + 1, misses.min(axis=1)
        if len(x) == 0:
            break
    return x, period, nearest


def lasting_motions(
    walker: System, x: Points, found: Sequence[Attractor], integrator: Integrator
) -> list[Attractor]:
    """Return the motions without a period on which walkers last, apart from those already found.

    On such a motion walkers neither fall nor converge to a cycle for long, and none of them does so
    later either.
    """
    early, late = SURVIVAL
    end = iterate(walker, x, early, integrator)
    x = end.state[end.outcome == Outcome.STRIDE]
    mapper = Mapper(walker, [*found], integrator, early)
    x = x[mapper.approached(x) < 0]
    walks, outcome = orbits(walker, x, late, integrator)
    lasts = outcome == Outcome.STRIDE
    lasts[lasts] = mapper.approached(walks[lasts, -1]) < 0
    known = [one.cloud for one in found if one.cloud is not None]
    new = distinct_motions(walks[lasts], known, MOST_MOTIONS + 1)
    if new and not lasts.all():  # walkers leave the nearest motion, which is then a transient
        left, _ = nearest_motion(clouds_of([*known, *new]), walks[~lasts][:, SPARSE])
        new = [cloud for i, cloud in enumerate(new, len(known)) if i not in left]
    first = [cloud[[cloud[:, 0].argmin()]] for cloud in new]
    if len(new) > MOST_MOTIONS:
        return [all_motions(first[0])]
    return [Attractor(one, cloud=cloud) for one, cloud in zip(first, new, strict=True)]


def attracts(
    walker: System, cycle: Float[np.ndarray, "period section"], integrator: Integrator
) -> bool:
    """Return whether a cycle attracts: it does unless a multiplier is outside the unit circle.

    Multipliers are computed where walkers from all sides do not stay near and come clearly nearer.
    If there are none, as the stride has no derivative there, walkers must stay near.
    """
    radius, axes = capture_radius(cycle.dtype), np.eye(len(cycle[0]))
    beside = cycle[0] + radius * np.concatenate([axes, -axes])
    walks, _ = orbits(walker, beside, BLOCKS * LONGEST_PERIOD, integrator)
    apart = np.abs(difference(walks[:, 1:, None], cycle, turns_of(walker))).max(axis=3).min(axis=2)
    largest = apart.reshape(-1, BLOCKS, LONGEST_PERIOD).max(axis=(0, 2))  # in each stretch
    if largest[0] < CLOSE and largest[-1] < radius / (2 * len(axes)):  # False for NaN
        return True
    jacobians = linearise(walker, cycle[None], integrator).jacobian
    if np.isfinite(jacobians).all():
        return bool(np.abs(find_multipliers(multiply_jacobians(jacobians))).max() < 1 + radius)
    return bool(largest[-1] <= radius)


def stable_cycle(
    walker: System, start: Float[np.ndarray, " section"], period: int, integrator: Integrator
) -> Float[np.ndarray, "period section"] | None:
    """Find a stable cycle `CLOSE` to a walker, by Newton's iteration; None if it fails."""
    _, cycles = cycle_guesses(walker, start[None], period, integrator)
    if len(cycles) == 0:
        return None
    gait = gait_at(iterate_newton(walker, cycles, integrator), 0)
    states = np.asarray(gait.states)
    exact = gait.residual < 1e3 * np.finfo(start.dtype).eps
    stable = exact and np.abs(gait.multipliers[0]) < 1  # both False for NaN
    turns = turns_of(walker)
    if not stable or not np.abs(difference(states[0], start, turns)).max() < CLOSE:
        return None
    misses = np.abs(difference(np.roll(states, -1, axis=0), states[0], turns)).max(axis=1)
    return states[: first_period(misses, capture_radius(start.dtype))]


def first_period(misses: Float[np.ndarray, " strides"], within: float) -> int:
    """Return the strides to the first return within a distance, given all distances."""
    return int(np.flatnonzero(misses < within)[0]) + 1
