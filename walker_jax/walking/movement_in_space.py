"""Walks in space as motions: places of legs and axle at many times, over strides joined in a row.

For films. Places are along the slope, to the left and normal to it, from where the walker stands
first. Every other stride is that of a walker in a mirror (`SpatialWalker`), which is undone here.
"""

from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.kernels import by_kernel
from walker_jax.walkers.model import least_scuff
from walker_jax.walkers.parameters import attributes_of
from walker_jax.walkers.rolling_stance import SpatialState
from walker_jax.walkers.spatial import SpatialWalker, on_ground
from walker_jax.walking.falls import fall_of
from walker_jax.walking.modes import in_tension
from walker_jax.walking.outcomes import Outcome
from walker_jax.walking.stepping import trajectory

FALL_TIME = 6.0
"""Time for which a walker that fails is followed, for legs of length 1: most are down before."""
PLACES = "stance", "swing", "stance_hip", "swing_hip", "axle"


def motion_in_space(
    walker: SpatialWalker,
    starts: Float[np.ndarray, "starts section"],
    outcomes: Int[np.ndarray, " made"],
    durations: Float[np.ndarray, " made"],
    step: float,
    tolerance: float | None,
) -> xr.Dataset:
    """`motion` of a walker in space, of a walk whose strides and their starts are known."""
    failed, count = outcomes != Outcome.STRIDE, len(outcomes)
    columns: dict[str, list] = {name: [] for name in ("time", "stride", *ANGLES, *PLACES)}
    foot, mirror, begins = np.zeros(3), np.array([1.0, 1.0, 1.0]), 0.0
    for k in range(count):
        end = FALL_TIME * float(np.sqrt(walker.leg_length)) if failed[k] else durations[k]
        times = np.linspace(0, end, 1 + max(1, round(end / step)))
        states = trajectory(walker, starts[k], times, tolerance=tolerance)
        if failed[k]:
            over = is_over(walker, states, Outcome(int(outcomes[k])))
            shown = max(2, int(over.argmax()) + 1) if over.any() else len(times)
            times, states = times[:shown], jax.tree.map(lambda one, n=shown: one[:n], states)
        places, sole = map(np.asarray, jax.vmap(places_of, (None, 0))(walker, states))
        columns["time"].append(begins + times)
        columns["stride"].append(np.full(len(times), k))
        for name in ANGLES:
            columns[name].append(np.asarray(getattr(states, name)))
        for i, name in enumerate(PLACES):
            at = np.zeros(3) if name == "axle" else foot
            columns[name].append(at + mirror * places[:, i])
        foot, begins = foot + mirror * sole[-1], begins + end
        mirror = mirror * [1, -1, 1]
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    variables = {name: (("frame", "axis")[: x.ndim], x) for name, x in joined.items()}
    variables["states"] = ("start", "coordinate"), starts
    variables |= {"outcome": ("made", outcomes), "duration": ("made", durations)}
    about = {"walker": type(walker).__name__, **attributes_of(walker)}
    about |= {"section": list(walker.section), "version": f"walker-jax {version('walker-jax')}"}
    return xr.Dataset(variables, attrs=about)


ANGLES = SpatialState._fields[2:6]


@by_kernel
def places_of(
    walker: SpatialWalker, state: SpatialState
) -> tuple[Float[jax.Array, "places 3"], Float[jax.Array, " 3"]]:
    """Centres of both discs, both ends of the axle and its direction; and the swing disc's sole."""
    q, shank = on_ground(jnp.stack(state[:6])), walker.leg_length - walker.disc_radius
    discs = [walker.disc(q, swing) for swing in (False, True)]
    ends = [
        disc + shank * walker.rotation(q, swing)[:, 2]
        for disc, swing in zip(discs, (False, True), strict=True)
    ]
    return jnp.stack([*discs, *ends, walker.axle(q)[:, 1]]), walker.sole(q, True)


def is_over(
    walker: SpatialWalker, states: SpatialState, outcome: Outcome
) -> Bool[np.ndarray, " frames"]:
    """Whether a stride that fails is over: fallen, at heel strike, scuffing, or in the air."""

    def look(walker, state):
        fallen = fall_of(walker, state) != Outcome.UNDECIDED
        return (
            fallen,
            walker.clearance(state),
            walker.is_ahead(state) > 0,
            in_tension(walker, state),
        )

    fallen, height, ahead, pulled = map(
        np.asarray, jax.vmap(by_kernel(look), (None, 0))(walker, states)
    )
    over = fallen | (ahead & (height < 0))
    if outcome == Outcome.SCUFFED:
        over |= height < -float(least_scuff(walker.leg_length))
    return over | pulled if outcome == Outcome.RUNNING else over
