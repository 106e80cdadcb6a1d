"""Places of legs and axle of a walker in space at many times, for films.

Places are along the slope, to the left and normal to it, relative to the walker's first place.
Every other stride is that of a walker in a mirror (`SpatialWalker`), which is undone here.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.kernels import kernel
from walker_jax.walkers.rolling_stance import SpatialState
from walker_jax.walkers.spatial import SpatialWalker, on_ground

SHOWN_IN_SPACE = 6.0
"""Time for which a failing walker is followed, for legs of length 1: most are down before."""
PLACES = "stance", "swing", "stance_hip", "swing_hip", "axle"
ANGLES = SpatialState._fields[2:6]


def move_in_space(
    walker: SpatialWalker, states: SpatialState, foot: Float[np.ndarray, " 3"], number: int
) -> tuple[dict[str, Float[np.ndarray, " n"]], dict[str, Float[np.ndarray, "n 3"]], Any]:
    """Return angles and places in a stride of some number, and the place of the next foot."""
    found, sole = map(np.asarray, jax.vmap(places_of, (None, 0))(walker, states))
    mirror = np.array([1, (-1) ** number, 1])
    places = {name: foot + mirror * found[:, i] for i, name in enumerate(PLACES)}
    places["axle"] = mirror * found[:, PLACES.index("axle")]
    angles = {name: np.asarray(getattr(states, name)) for name in ANGLES}
    return angles, places, foot + mirror * sole[-1]


@kernel
def places_of(
    walker: SpatialWalker, state: SpatialState
) -> tuple[Float[jax.Array, "places 3"], Float[jax.Array, " 3"]]:
    """Return both discs' centres, the axle's ends and direction; and the swing disc's sole."""
    q, shank = on_ground(jnp.stack(state[:6])), walker.leg_length - walker.disc_radius
    discs = [walker.disc(q, swing) for swing in (False, True)]
    ends = [
        disc + shank * walker.rotation(q, swing)[:, 2]
        for disc, swing in zip(discs, (False, True), strict=True)
    ]
    return jnp.stack([*discs, *ends, walker.axle(q)[:, 1]]), walker.sole(q, True)
