"""The most probable fall: the least sequence of disturbances that topples a walker.

On slightly rough ground a walker falls rarely, and then nearly always in the same way: by the least
improbable sequence of disturbances. For independent normal disturbances w of standard deviation
sigma, that is the sequence of least action, by the theory of large deviations of Freidlin and
Wentzell (2012, Random Perturbations of Dynamical Systems):

    action = min |w|^2 / 2,  log(mean strides to a fall) ~ action / sigma^2

The set of sequences that topple the walker has a boundary, and the least sequence is its point
nearest to no disturbance at all (`nearest_points`). Such a sequence ends in each stride with the
same chance, the chance to be beyond this boundary. This gives the prefactor too.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_precision,
    is_number,
    refuses_tracers,
    short,
)
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.disturbances import BEYOND
from walker_jax.stability.disturbed_falls import DisturbedWalks
from walker_jax.stability.gait_mapper import mapper_of_gait
from walker_jax.stability.nearest_points import NearestPoint, nearest_minima, solve_nearest
from walker_jax.stability.rays import spread_directions
from walker_jax.stability.rough_ground import STRIDES_PER_CALL
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walking.disturbed import Disturbance, follow_disturbed
from walker_jax.walking.scan import scan_strides

SEARCHED = 3
"""Most disturbed strides for which random directions are searched. Longer sequences follow from
shorter ones, with one more stride at the beginning or at the end."""
DESCENTS = 8
"""Number of descents from the nearest failures found: most of them end at the same few minima."""
KNOWN = 1e-9
"""Relative distance beyond a boundary at which a walk falls despite rounding errors."""
NEEDED_BY = f"most_probable_fall, which steps {KNOWN:g} beyond a boundary,"
FOLLOWED = 200
"""Strides after the disturbances in which a walker may return, or fall."""


class ProbableFall(NamedTuple):
    """The least disturbances that topple a walker."""

    action: float
    """Half the sum of their squares, each in units of its standard deviation."""
    disturbances: Float[np.ndarray, "strides 3"]
    """Step (unit of length), slope (rad) and push (of thetadot) in each stride."""
    states: Float[np.ndarray, "made full"]
    """The full state just after each heel strike, from the gait to the last before the fall."""
    outcome: Outcome
    """How the walker falls from just beyond the boundary."""
    strides: int
    """Strides before the failing one; after the disturbances the ground is even."""
    actions: Float[np.ndarray, " strides"]
    """The least action of at most 1, 2 ... disturbed strides."""
    flatness: float
    """Curvature of the boundary of the sequences that topple the walker: det(I - r W), 1 if
    flat."""
    residual: float
    """Angle between the sequence and the normal of that boundary, 0 at the least sequence."""

    def mean_strides(self, scale: float = 1.0) -> float:
        """Return the mean strides to a fall, with deviations `scale` times as large.

            sqrt(flatness) / Phi(-sqrt(2 action) / scale)

        The formula is right to first order as the scale goes to zero. It counts the walker as lost
        wherever it is beyond the boundary. If one `outcome` was asked for, it counts that fall
        alone, as if there were no other. It is NaN where the search has not converged to a minimum,
        and infinite beyond 1e308, where `log_mean_strides` is finite.
        """
        with np.errstate(over="ignore"):
            return float(np.exp(self.log_mean_strides(scale)))

    def log_mean_strides(self, scale: float = 1.0) -> float:
        """Return the natural logarithm of `mean_strides`, however rare a fall is."""
        from scipy.special import log_ndtr

        if not (is_number(scale) and 0 < scale < np.inf):
            raise WrongUse(f"scale must be a number above 0, not {short(scale)}")
        if not self.flatness > 0:
            return np.nan
        log_chance = float(log_ndtr(-np.sqrt(2 * self.action) / scale))
        return float(np.log(self.flatness) / 2 - log_chance)


@refuses_tracers()
def most_probable_fall(
    walker: Walker,
    ground: float | Disturbance = 1.0,
    gait: Gait | None = None,
    *,
    strides: int = 12,
    outcome: Outcome | None = None,
    directions: int = 180,
    tolerance: float | None = None,
) -> ProbableFall:
    """Find the most probable sequence of disturbances that topples a walker, from its gait on.

    Consider all sequences of `strides` disturbances after which the walker falls, at once or later
    on even ground. The result is the one with the least sum of squares. For one to three strides,
    random directions are searched, and descents along the boundary lead to the least sequences.
    Each longer sequence starts from the previous one, with one more stride. Newton's iteration ends
    each search. A narrow finger of failures may be missed.

    ```python
    fall = wj.most_probable_fall(wj.SimplestWalker(0.004), 1e-4, strides=2, directions=60)
    fall.disturbances[:, 0]  # heights of the steps
    fall.log_mean_strides()  # natural logarithm of the mean number of strides to a fall
    ```

    **Arguments:**

    - `walker`: a planar walker.
    - `ground`: the standard deviation of the heights of steps; or a `Disturbance` of the standard
      deviations of steps, slope and pushes. The default of 1 gives actions in squares of the unit
      of length; strides to a fall are then those of `mean_strides(deviation)`.
    - `gait`: a stable gait of period one; that of `find_gait` by default.
    - `strides`: number of disturbed strides, at most 32.
    - `outcome`: the fall that counts, for example `Outcome.BACKWARD`; by default any.
    - `directions`: number of directions that are searched for each number of disturbances up to
      three.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for a gait that is not stable and for arguments out of range;
    `ComputationFailed` where nothing topples the walker.
    """
    check_planar(walker)
    check_precision(jnp.result_type(float), NEEDED_BY)
    deviations = read_deviations(ground)
    if strides > STRIDES_PER_CALL:
        raise WrongUse(f"strides must be at most {STRIDES_PER_CALL}, not {strides}")
    if outcome is not None:
        check_kind("outcome", outcome, Outcome)
        if outcome in (Outcome.STRIDE, Outcome.UNDECIDED):
            raise WrongUse(f"outcome must be a failure, not {outcome.name}")
    mapper = mapper_of_gait(walker, gait, FOLLOWED, tolerance)
    states = mapper.attractors[0].states
    check_precision(states.dtype, NEEDED_BY)
    if len(states) != 1:
        raise WrongUse(f"gait must be of period one, not {len(states)}", of="gait")
    start, unit = np.stack(walker.lift(jnp.asarray(states[0]))), float(deviations.max())
    walks = DisturbedWalks(mapper, start, deviations / unit, strides, outcome)
    found = [search(walks, None, 1, directions)]
    for count in range(2, strides + 1):
        found.append(search(walks, found[-1], count, directions))
    return describe(walks, found, unit)


def read_deviations(ground: float | Disturbance) -> Float[np.ndarray, " 3"]:
    """Return the standard deviations of steps, slope and pushes, checked."""
    given = ground if isinstance(ground, Disturbance) else Disturbance(step=ground)
    known = all(is_number(one) and 0 <= one < np.inf for one in given)
    if not (known and any(given)):
        raise WrongUse(
            f"ground must be a standard deviation above 0, or three, not {short(ground)}"
        )
    return np.array([float(one) for one in given])


def search(
    walks: DisturbedWalks, shorter: NearestPoint | None, count: int, directions: int
) -> NearestPoint:
    """Find the nearest sequence of `count` disturbed strides, given that of one stride less."""
    kinds = int(np.count_nonzero(walks.deviations))
    size = count * kinds
    rays = []
    if shorter is not None:
        none = np.zeros(kinds)
        rays += [np.append(none, shorter.ray), np.append(shorter.ray, none)]
    if count <= SEARCHED:
        rays += [*np.eye(size), *-np.eye(size), *spread_directions(size, directions)]
    # The two extended sequences fail where the shorter one does, or just beyond.
    known = (0, np.inf) if shorter is None else (2, shorter.length * (1 + KNOWN))
    rays, lengths = nearest_minima(walks.fails, walks.gradient, np.stack(rays), DESCENTS, known)
    return solve_nearest(walks.fails, walks.gradient, rays[0], lengths[0])


def describe(walks: DisturbedWalks, found: list[NearestPoint], unit: float) -> ProbableFall:
    """Describe the least sequence, and its walk to the fall; `unit` is the largest deviation."""
    best = min(found, key=lambda one: one.length)
    w = best.length * best.ray
    tried = BEYOND[:, None] * w
    ends = walks.follow(tried)
    first = int(walks.falls(ends).argmax())
    (walker, integrator), made = walks.arrays(), int(ends.strides[first])
    rows = walks.rows(tried[first : first + 1])[0]
    rows = np.concatenate([rows, np.zeros((made, 3))]).astype(walks.start.dtype)
    states = states_between(walker, walks.start, rows, integrator, made)
    return ProbableFall(
        (best.length / unit) ** 2 / 2,
        walks.rows(w[None])[0],
        np.concatenate([walks.start[None], states]),
        Outcome(int(ends.outcome[first])),
        made,
        np.minimum.accumulate([(one.length / unit) ** 2 / 2 for one in found]),
        best.flatness,
        best.residual,
    )


@partial(jax.jit, static_argnames="made")
def states_between(
    walker: Walker,
    start: Float[Array, " full"],
    rows: Float[Array, "strides 3"],
    integrator: Integrator,
    made: int,
) -> Float[Array, "made full"]:
    """Return the states after each of the strides made, given the disturbances in each."""
    step = lambda x, i: follow_disturbed(walker, x, Disturbance(*rows[i]), integrator)
    return scan_strides(step, start, made, record=lambda stride: stride.state)[1]
