"""Steps to a fall: how long a walker walks on rough ground, or under other random disturbances.

Every stride is disturbed at random, so every walker falls in the end. The measure is the number of
strides until then (Byl and Tedrake 2009, Int. J. Robot. Res. 28:1040-1064).
"""

from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import betaincinv

from walker_jax.checks import (
    WrongUse,
    is_number,
    short,
)
from walker_jax.execution.tiles import map_cells
from walker_jax.gaits.cycles import Gait, check_found
from walker_jax.gaits.selection import require_gait
from walker_jax.identity import FunctionByCode
from walker_jax.integrators.integrator import integrator_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import check_single
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.model import Walker
from walker_jax.walking.disturbed import Disturbance, follow_disturbed_walk
from walker_jax.walking.scan import Walked

RandomDisturbance = Callable[[Any], Any]
"""A JAX function of a random key: the height of one step, or a `Disturbance`."""
STRIDES_PER_CALL = 32
"""Strides that walks make before fallen ones are left out. Three numbers for each fit into the 128
entries of an array that a kernel can hold."""
FEWEST_FALLS = 30
"""Number of walks from which on their mean number of strides is about normally distributed: the
usual rule."""


class StepsToFall(NamedTuple):
    """Numbers of strides that walkers make until they fall."""

    mean: float
    """The mean; its maximum likelihood estimate if some walks did not fall (`ended`): all strides
    over the number of falls. Infinite without a fall."""
    low: float
    high: float
    """Ends of its confidence interval."""
    strides: Int[np.ndarray, " n"]
    """Completed strides of each walk."""
    ended: Bool[np.ndarray, " n"]
    """Whether each walk ended in a failure. The others stopped at the limit, or where the
    integration gave no answer."""
    outcomes: Int[np.ndarray, " n"]
    """`Outcome` of the failure, `STRIDE`, or `UNDECIDED`."""


def walk_disturbed(
    walker: Walker,
    states: Float[np.ndarray, "n full"],
    ground: RandomDisturbance,
    keys: Array,
    limit: int,
    tolerance: float | None,
) -> Walked:
    """Follow disturbed walks from n full states, each with a random key, until they fail."""
    walker = in_dtype(walker, states.dtype)
    integrator = integrator_of(states.dtype, tolerance).in_dtype(states.dtype)
    n = len(states)
    end = Walked(states.copy(), np.zeros(n, np.int8), np.zeros(n, np.int32))
    active, done = np.arange(n), 0
    while len(active) and done < limit:
        count = min(STRIDES_PER_CALL, limit - done)
        own = keys[pad_to_power_of_two(active)]
        drawn = np.asarray(draw(FunctionByCode(ground), own, done, count))[: len(active)]
        part = map_cells(
            follow_disturbed_walk,
            (walker, end.state[active], drawn.astype(states.dtype), integrator),
            (False, True, True, False),
        )
        end.state[active], end.outcome[active] = part.state, part.outcome
        end.strides[active] += part.strides
        active, done = active[part.outcome == Outcome.STRIDE], done + count
    return end


def pad_to_power_of_two(indices: Int[np.ndarray, " m"]) -> Int[np.ndarray, " n"]:
    """Repeat the last index up to a power of two, so that few programs are compiled."""
    size = 1 << (len(indices) - 1).bit_length()
    return np.concatenate([indices, np.repeat(indices[-1:], size - len(indices))])


@partial(jax.jit, static_argnums=(0, 3))
def draw(
    ground: RandomDisturbance, keys: Array, first: int | Int[Array, ""], count: int
) -> Float[Array, "n strides 3"]:
    """Draw the disturbances of `count` strides of n walks, from stride `first` on."""

    def one(key, number):
        drawn = ground(jax.random.fold_in(key, number))
        disturbance = drawn if isinstance(drawn, Disturbance) else Disturbance(step=drawn)
        return jnp.stack([jnp.asarray(value, float) for value in disturbance])

    numbers = first + jnp.arange(count)
    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(keys, numbers)


def read_ground(ground: float | RandomDisturbance) -> RandomDisturbance:
    """Return the random function that an argument stands for, checked."""
    if is_number(ground):
        deviation = float(ground)
        if not 0 <= deviation < np.inf:
            raise WrongUse(f"ground must be finite and not negative, not {short(ground)}")
        return NormalSteps(deviation)
    if not callable(ground):
        raise WrongUse(f"ground must be a number or a function of a key, not {short(ground)}")
    if not isinstance(ground, Hashable):
        raise WrongUse(f"ground must be hashable, as functions are, not {short(ground)}")
    returned: list[Any] = []

    def draw_one(key: Array) -> Any:
        returned.append(ground(key))
        return returned[0]

    refusal = "ground must return a height or a Disturbance"
    try:
        drawn = jax.eval_shape(draw_one, jax.random.key(0))
    except TypeError as error:
        reason = f", not {short(returned[0])}" if returned else f": {str(error).splitlines()[0]}"
        raise WrongUse(refusal + reason) from None
    shapes = {np.shape(value) for value in jax.tree.leaves(drawn)}
    if not isinstance(drawn, Disturbance | jax.ShapeDtypeStruct) or shapes - {()}:
        raise WrongUse(f"{refusal}, not {short(drawn)}")
    return ground


class NormalSteps(NamedTuple):
    """Normally distributed heights of steps."""

    deviation: float

    def __call__(self, key):
        return self.deviation * jax.random.normal(key, dtype=float)


def read_key(key: Any) -> Array:
    """Return a random key, given one of new or old style, or none."""
    if key is None:
        return jax.random.key(0)
    if isinstance(key, jax.Array):
        with suppress(TypeError, ValueError):
            is_new = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
            own = key if is_new else jax.random.wrap_key_data(key)
            if not own.shape:
                return own
    raise WrongUse(f"key must be one random key, such as jax.random.key(0), not {short(key)}")


def start_of_walks(walker: Walker, gait: Gait | None, tolerance: Any) -> Float[np.ndarray, " full"]:
    """Return the full state of a gait just after heel strike."""
    check_single(walker)
    gait = require_gait(walker, ["gait"], tolerance=tolerance) if gait is None else gait
    check_found(gait)
    if gait.states.shape[1] != len(walker.section):
        raise WrongUse(f"gait must be on the section {walker.section}, not of another walker")
    return np.stack(walker.lift(jnp.asarray(gait.states[0])))


def mean_life(
    strides: Int[np.ndarray, " n"], ended: Bool[np.ndarray, " n"], confidence: float
) -> tuple[float, float, float]:
    """Estimate the mean number of strides until a fall, and its confidence interval.

    The stride in which a walker falls does not count, as in a `Walk`.
    """
    total, falls, n = float(strides.sum()), int(ended.sum()), len(strides)
    below, above = (1 - confidence) / 2, (1 + confidence) / 2
    if falls == n and n >= FEWEST_FALLS:
        mean = total / n
        spread = NormalDist().inv_cdf(above) * float(strides.std(ddof=1)) / np.sqrt(n)
        return mean, max(0.0, mean - spread), mean + spread
    # With a chance p to fall in each of `total + falls` strides, a walk makes (1 - p) / p on
    # average.
    least = float(betaincinv(falls, total + 1, below)) if falls else 0.0
    most = float(betaincinv(falls + 1, total, above)) if total else 1.0
    low, high = ((1 - p) / p if p > 0 else np.inf for p in (most, least))
    return total / falls if falls else np.inf, low, high
