"""Attractors of strides, and the search for them.

Attractors are cycles of strides, and attracting sets that never repeat. A walker has reached a
cycle once it is in one of its capture boxes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.basins.motions import Clouds, distinct_motions
from walker_jax.gaits.cycles import (
    find_multipliers,
    gait_at,
    iterate_newton,
    linearise,
    multiply_jacobians,
)
from walker_jax.gaits.search import cycle_guesses
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.angles import Turns, difference, turns_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walking.iteration import Targets, iterate, nearest_target, orbits

CLOSE = 0.01
"""Distance from a cycle within which a walk that has made all its strides may still be approaching
it: near a period doubling, convergence is too slow to come within `capture_radius`."""
SAMPLE = 2**14
"""Number of starts that are followed in search of attractors."""
SCOUTS = 2**8
"""Number of starts that are followed first; most of the others end on the cycles that these
find."""
LONGEST_PERIOD = 64
"""Longest cycle, in strides, that is recognised as one."""
PATIENCE = 8
"""Rounds of `LONGEST_PERIOD` strides in which a walker is to converge to a cycle."""
ATTEMPTS = 8
"""Number of undecided walkers from which Newton's iteration solves for a cycle."""
NEARLY = 1e-4
"""Distance to which a walker that approaches a cycle, however slowly, has returned after those
rounds. At a period doubling the distance from the cycle falls like n^-1/2 after n strides, and the
distance of a return like n^-3/2. A motion without a period returns to about 1e-3, the best of 64
tries."""
BLOCKS = 4
"""Number of stretches of `LONGEST_PERIOD` strides, over which walkers come nearer to a cycle or
leave it."""
MAX_DISTANCES = 2**24
"""Most distances from the states of a cycle that are held at once: an eighth of a gigabyte."""
WITNESSES = 128
"""Number of walkers followed to see whether motions without a period last."""
SURVIVAL = 1000, 2000
"""Strides after which all of these walkers are on one, and further strides in which none of those
on it may fall or converge to a cycle. This tells an attractor from a transient whose mean life is
below some 85,000 strides."""
MOST_MOTIONS = 16
"""Most motions without a period that count as attractors of their own. Walkers of a conservative
system have each their own motion: all of these count as one."""


class Attractor(NamedTuple):
    """A cycle of strides, from its state of the smallest angle on; or another attracting set."""

    period: int | None
    """Strides in a cycle; None where the motion does not repeat itself."""
    states: Float[np.ndarray, "period section"]
    """The states of the cycle; otherwise, one state of the motion, of the smallest angle."""
    capture_boxes: Float[np.ndarray, "period section section"] | None = None
    """For each state, a matrix M: a walker at x has converged where |M (x - state)| < 1 in all
    coordinates. None where these are cubes of half edge `capture_radius`."""
    cycles: int = 0
    """By cell mapping: number of cycles of cells that belong to it, or make up this artefact."""
    falling: int = 0
    """Number of centres of those cells from which a walker falls."""
    artefact: bool = False
    """Whether it is a cycle of cells alone: walkers from most of its centres do not converge to one
    attractor. Its states are those centres."""
    cloud: Float[np.ndarray, "points section"] | None = None
    """Points of a motion without a period, one stride apart. None for a cycle, and for an attractor
    that stands for all motions without a period."""

    @property
    def points(self) -> Float[np.ndarray, "points section"]:
        """All known points of the attractor."""
        return self.states if self.cloud is None else self.cloud


def capture_radius(dtype) -> float:
    """Return the distance, in every coordinate, within which an attractor is reached."""
    return max(1e-6, 1e4 * float(np.finfo(dtype).eps))


def cubes(attractor: Attractor, radius: float) -> Float[np.ndarray, "period section section"]:
    """Return capture boxes that are cubes, of a given half edge."""
    period, size = attractor.states.shape
    return np.tile(np.eye(size) / radius, (period, 1, 1))


def targets_of(
    attractors: Sequence[Attractor], size: int, within: float | None = None
) -> tuple[Targets, Int[np.ndarray, " m"]]:
    """Return the capture boxes of all cycles, or cubes of a half edge, and the owner of each.

    Another owner, the last, is -1: that of the target -1, for none.
    """
    states, frames, owner = [], [], []
    for number, one in enumerate(attractors):
        if one.period is None:
            continue
        boxes = one.capture_boxes if within is None else cubes(one, within)
        states.append(one.states)
        frames.append(cubes(one, capture_radius(one.states.dtype)) if boxes is None else boxes)
        owner += [number] * one.period
    if not owner:
        return Targets(np.zeros((0, size)), np.zeros((0, size, size))), np.full(1, -1, np.int32)
    targets = Targets(np.concatenate(states), np.concatenate(frames))
    return targets, np.array([*owner, -1], np.int32)


def match_attractor(
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    within: float | None = None,
    turns: Turns = None,
) -> Int[np.ndarray, " n"]:
    """Return the number of the cycle whose capture box holds each state; -1 for none.

    Of several boxes the nearest counts. With `within` the boxes are cubes of that half edge.
    """
    targets, owner = targets_of(attractors, x.shape[1], within)
    return owner[nearest_target(x, targets, turns)]


def sorted_numbers(attractors: Sequence[Attractor]) -> list[int]:
    """Return their numbers, sorted by period and angle; aperiodic ones, then artefacts, last."""
    key = [(one.artefact, one.period or np.inf, one.states[0, 0]) for one in attractors]
    return sorted(range(len(key)), key=key.__getitem__)


def sample(x: Float[np.ndarray, "n section"], most: int = SAMPLE) -> Float[np.ndarray, "m section"]:
    """Return some of many points, evenly spread over their order."""
    return x[sample_indices(len(x), most)]


def sample_indices(n: int, most: int = SAMPLE) -> Int[np.ndarray, " m"]:
    """Return the indices of a sample of n items, evenly spread over their order."""
    return np.linspace(0, n - 1, min(n, most)).astype(int)


def find_attractors(
    walker: System,
    x: Float[np.ndarray, "n section"],
    integrator: Integrator,
    known: Sequence[Attractor] = (),
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
            x = x[stay_undecided(found, walker, x, integrator)]
    x, solved = add_cycles(walker, x, found, integrator)
    stands_for_all = any(one.period is None and one.cloud is None for one in found)
    if len(x) and not solved and not stands_for_all:
        found += lasting_motions(walker, sample(x, WITNESSES), found, integrator)
    return found


def add_cycles(
    walker: System,
    x: Float[np.ndarray, "n section"],
    found: list[Attractor],
    integrator: Integrator,
) -> tuple[Float[np.ndarray, "m section"], bool]:
    """Add the cycles to which walkers converge.

    Returns the states of walkers that neither failed nor came to a cycle, and whether some of them
    approach a cycle that was solved for.
    """
    x, period, nearest = add_repeated(walker, x, found, integrator)
    slow = np.flatnonzero(nearest < NEARLY)[:ATTEMPTS]
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
    walker: System,
    x: Float[np.ndarray, "n section"],
    found: list[Attractor],
    integrator: Integrator,
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


def stay_undecided(
    found: Sequence[Attractor],
    walker: System,
    x: Float[np.ndarray, "n section"],
    integrator: Integrator,
) -> Bool[np.ndarray, " n"]:
    """Return whether walkers neither fail nor come to one of these cycles in `PATIENCE` rounds."""
    targets, _ = targets_of(found, x.shape[1])
    end = iterate(walker, x, PATIENCE * LONGEST_PERIOD, integrator, targets)
    return (end.outcome == Outcome.STRIDE) & (end.target < 0)


def lasting_motions(
    walker: System,
    x: Float[np.ndarray, "n section"],
    found: Sequence[Attractor],
    integrator: Integrator,
) -> list[Attractor]:
    """Return the motions without a period on which walkers last, apart from those already found.

    On such a motion walkers neither fall nor converge to a cycle for long, and none of them does so
    later either.
    """
    early, late = SURVIVAL
    end = iterate(walker, x, early, integrator)
    x = end.state[end.outcome == Outcome.STRIDE]
    x = x[match_approaching(walker, x, found, integrator) < 0]
    walks, outcome = orbits(walker, x, late, integrator)
    lasts = outcome == Outcome.STRIDE
    lasts[lasts] = match_approaching(walker, walks[lasts, -1], found, integrator) < 0
    known = [one.cloud for one in found if one.cloud is not None]
    new = distinct_motions(walks[lasts], known, MOST_MOTIONS + 1)
    if new and not lasts.all():  # walkers leave the nearest motion, which is then a transient
        left, _ = Clouds([*known, *new]).nearest(walks[~lasts])
        new = [cloud for i, cloud in enumerate(new, len(known)) if i not in left]
    first = [cloud[[cloud[:, 0].argmin()]] for cloud in new]
    if len(new) > MOST_MOTIONS:
        return [Attractor(None, first[0])]
    return [Attractor(None, one, cloud=cloud) for one, cloud in zip(first, new, strict=True)]


def match_approaching(
    walker: System,
    x: Float[np.ndarray, "n section"],
    attractors: Sequence[Attractor],
    integrator: Integrator,
) -> Int[np.ndarray, " n"]:
    """Return the numbers of the cycles that walkers come ever nearer to; -1 for none."""
    number = match_attractor(x, attractors, CLOSE, turns_of(walker))
    for i in np.unique(number[number >= 0]).tolist():
        near = np.flatnonzero(number == i)
        nearer = approaches(walker, x[near], attractors[i].states, integrator)
        number[near[~nearer]] = -1
    return number


def approaches(
    walker: System,
    x: Float[np.ndarray, "n section"],
    cycle: Float[np.ndarray, "period section"],
    integrator: Integrator,
) -> Bool[np.ndarray, " n"]:
    """Return whether walkers that are `CLOSE` to a cycle come ever nearer to it.

    They do if the largest distance from the cycle falls from one stretch of strides to the next, or
    if they arrive. A walker on another motion, which passes by, moves away again.
    """
    largest = largest_distances(walker, x, cycle, integrator)
    nearer = (largest[:, 0] < 2 * CLOSE) & (np.diff(largest, axis=1) < 0).all(axis=1)
    return nearer | (largest[:, -1] < capture_radius(x.dtype))


def attracts(
    walker: System, cycle: Float[np.ndarray, "period section"], integrator: Integrator
) -> bool:
    """Return whether a cycle attracts: it does unless a multiplier is outside the unit circle.

    Multipliers are computed where walkers from all sides do not stay near and come clearly nearer.
    If there are none, as the stride has no derivative there, walkers must stay near.
    """
    radius, axes = capture_radius(cycle.dtype), np.eye(len(cycle[0]))
    beside = cycle[0] + radius * np.concatenate([axes, -axes])
    largest = largest_distances(walker, beside, cycle, integrator).max(axis=0)
    if largest[0] < CLOSE and largest[-1] < radius / (2 * len(axes)):  # False for NaN
        return True
    jacobians = linearise(walker, cycle[None], integrator).jacobian
    if np.isfinite(jacobians).all():
        return bool(np.abs(find_multipliers(multiply_jacobians(jacobians))).max() < 1 + radius)
    return bool(largest[-1] <= radius)


def largest_distances(
    walker: System,
    x: Float[np.ndarray, "n section"],
    cycle: Float[np.ndarray, "period section"],
    integrator: Integrator,
) -> Float[np.ndarray, "n blocks"]:
    """Return the largest distance from a cycle in each stretch of strides; NaN after a failure."""
    largest = np.empty((len(x), BLOCKS), x.dtype)
    size = max(1, MAX_DISTANCES // (BLOCKS * LONGEST_PERIOD * cycle.size))
    for start in range(0, len(x), size):
        part = slice(start, start + size)
        states, _ = orbits(walker, x[part], BLOCKS * LONGEST_PERIOD, integrator)
        distance = distance_from(cycle, states[:, 1:], turns_of(walker))
        largest[part] = distance.reshape(-1, BLOCKS, LONGEST_PERIOD).max(axis=2)
    return largest


def distance_from(
    cycle: Float[np.ndarray, "period section"],
    x: Float[np.ndarray, "*n section"],
    turns: Turns = None,
) -> Float[np.ndarray, "*n"]:
    """Return the largest difference in a coordinate from the nearest state of a cycle."""
    return np.abs(difference(x[..., None, :], cycle, turns)).max(axis=-1).min(axis=-1)


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


def new_cycle(
    states: Float[np.ndarray, "period section"],
    known: Sequence[Attractor],
    turns: Turns = None,
) -> Attractor | None:
    """Make a cycle, from its state of the smallest angle on; None if it is known."""
    states = np.roll(states, -int(states[:, 0].argmin()), axis=0)
    is_known = match_attractor(states[:1], known, turns=turns)[0] >= 0
    return None if is_known else Attractor(len(states), states)
