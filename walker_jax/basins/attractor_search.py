"""The search for attractors: cycles of strides, and sets that never repeat."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from walker_jax.basins.attractor import CLOSE, Attractor, capture_radius, match_attractor
from walker_jax.gaits.cycles import gait_at
from walker_jax.gaits.search import cycle_guesses, iterate_newton
from walker_jax.walkers.model import Walker
from walker_jax.walking.iteration import orbits
from walker_jax.walking.outcomes import Outcome

SAMPLE = 2**14
"""Starts that are followed in search of attractors."""
LONGEST_PERIOD = 64
"""Strides in the longest cycle that is recognised as one."""
PATIENCE = 8
"""Times `LONGEST_PERIOD`: strides in which a walker is to converge to a cycle."""
ATTEMPTS = 8
"""Walkers that have not, for which a cycle is solved for."""
NEARLY = 1e-4
"""Distance to which a walker has come back by then if it approaches a cycle, however slowly: at a
period doubling it approaches like the inverse square root of the strides, and after n of them
comes back to n^-3/2. On a motion without a period it comes back to a 64th of that, some 1e-3."""


def sample(x: Float[np.ndarray, "n section"]) -> Float[np.ndarray, "m section"]:
    """Some of many points, evenly spread over their order."""
    return x[sample_indices(len(x))]


def sample_indices(n: int) -> Int[np.ndarray, " m"]:
    """Indices of a sample of n things, evenly spread over their order."""
    return np.linspace(0, n - 1, min(n, SAMPLE)).astype(int)


def find_attractors(
    walker: Walker,
    x: Float[np.ndarray, "n section"],
    tolerance: float,
    known: Sequence[Attractor] = (),
) -> list[Attractor]:
    """The known attractors, and those to which walkers converge that start at x.

    Walkers are followed until each has failed, or repeats itself to rounding. For those that do
    neither in some hundred strides, as close to a period doubling, a stable cycle is solved for.
    Where there is none they are on an attractor without a period; one is added for them all.
    """
    found, exact = list(known), 1e3 * np.finfo(x.dtype).eps
    period, nearest = np.ones(len(x), int), np.zeros(len(x))
    for _ in range(PATIENCE):
        states, outcome = orbits(walker, x, LONGEST_PERIOD, tolerance)
        back = states[outcome == Outcome.STRIDE, ::-1]  # (walkers, strides back, coordinates)
        misses = np.abs(back[:, 1:] - back[:, :1]).max(axis=2)
        repeated = (misses < exact).any(axis=1)
        for path, miss in zip(back[repeated], misses[repeated], strict=True):
            # a slow approach that alternates comes close to itself after two strides before one
            count = first_period(miss, capture_radius(x.dtype))
            add_cycle(found, path[:count][::-1])
        x = back[:, 0]
        left = ~repeated & (match_attractor(x, found) < 0)
        x, period, nearest = x[left], misses[left].argmin(axis=1) + 1, misses[left].min(axis=1)
        if len(x) == 0:
            return found
    slow = np.flatnonzero(nearest < NEARLY)[:ATTEMPTS]
    solved = [
        cycle
        for start, count in zip(x[slow], period[slow], strict=True)
        if (cycle := stable_cycle(walker, start, int(count), tolerance)) is not None
    ]
    for cycle in solved:
        add_cycle(found, cycle)
    if not solved and all(one.period for one in found):
        found.append(Attractor(None, x[:1]))
    return found


def stable_cycle(
    walker: Walker, start: Float[np.ndarray, " section"], period: int, tolerance: float
) -> Float[np.ndarray, "period section"] | None:
    """The states of a stable cycle that a walker is `CLOSE` to, by Newton's iteration from it."""
    _, cycles = cycle_guesses(walker, start[None], period, tolerance)
    if len(cycles) == 0:
        return None
    gait = gait_at(iterate_newton(walker, cycles, tolerance), 0)
    states = np.asarray(gait.states)
    exact = gait.residual < 1e3 * np.finfo(start.dtype).eps
    stable = exact and np.abs(gait.multipliers[0]) < 1  # neither if NaN
    if not stable or not np.abs(states[0] - start).max() < CLOSE:
        return None
    misses = np.abs(np.roll(states, -1, axis=0) - states[0]).max(axis=1)
    return states[: first_period(misses, capture_radius(start.dtype))]


def first_period(misses: Float[np.ndarray, " strides"], within: float) -> int:
    """After how many strides a walk first comes back within a distance, given all distances."""
    return int(np.flatnonzero(misses < within)[0]) + 1


def add_cycle(found: list[Attractor], states: Float[np.ndarray, "period section"]) -> None:
    """Add a cycle, from its state of the smallest angle on, unless it is known."""
    states = np.roll(states, -int(states[:, 0].argmin()), axis=0)
    if match_attractor(states[:1], found)[0] < 0:
        found.append(Attractor(len(states), states))
