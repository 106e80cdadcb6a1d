"""Walks in space as motions: places of legs and axle at many times, over strides joined in a row.

For films. Places are along the slope, to the left and normal to it, from where the walker stands
first. Every other stride is that of a walker in a mirror (`SpatialWalker`), which is undone here.
"""

from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from walker_jax.kernels import by_kernel
from walker_jax.walkers.outcomes import Outcome
from walker_jax.walkers.parameters import attributes_of
from walker_jax.walkers.rolling_stance import SpatialState
from walker_jax.walkers.spatial import SpatialWalker, on_ground
from walker_jax.walking.frames import frames_of_stride

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
    columns: dict[str, list] = {name: [] for name in ("time", "stride", *ANGLES, *PLACES)}
    foot, mirror, begins = np.zeros(3), np.array([1.0, 1.0, 1.0]), 0.0
    longest = FALL_TIME * float(np.sqrt(walker.leg_length))
    for k, made in enumerate(zip(outcomes.tolist(), durations.tolist(), strict=True)):
        stride = Outcome(made[0]), made[1]
        times, states = frames_of_stride(
            walker, starts[k], stride, step, longest=longest, tolerance=tolerance
        )
        places, sole = map(np.asarray, jax.vmap(places_of, (None, 0))(walker, states))
        columns["time"].append(begins + times)
        columns["stride"].append(np.full(len(times), k))
        for name in ANGLES:
            columns[name].append(np.asarray(getattr(states, name)))
        for i, name in enumerate(PLACES):
            at = np.zeros(3) if name == "axle" else foot
            columns[name].append(at + mirror * places[:, i])
        foot, begins = foot + mirror * sole[-1], begins + times[-1]
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
