"""Pictures of walkers: the places of their legs, in the plane and in space.

Places are along the slope and normal to it, relative to the stance foot of the first stride when
its leg is upright. In space they are along the slope, to the left and normal to it, relative to the
first place. There, every other stride is that of a walker in a mirror (`SpatialWalker`), which is
undone here.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.kernels import kernel
from walker_jax.walkers.phase import State, legs

FALL_TIME = 40.0
"""Time after which a failing walker is on the ground, for legs of length 1."""
SHOWN_IN_SPACE = 6.0
"""Time for which a failing walker is followed, for legs of length 1: most are down before."""
PLACES = "stance", "swing", "stance_hip", "swing_hip", "axle"
ANGLES = "yaw", "lean", "theta", "phi"
Moved = tuple[dict[str, Any], dict[str, Any], Float[np.ndarray, " axes"]]
"""Angles, places, and the place of the next foot."""


class LegPicture(NamedTuple):
    """A walker in the plane: two legs from a hip, on feet that are arcs or points."""

    walker: Any
    leg_length: float
    """From the hip to the centre of the foot's arc."""
    foot_radius: float
    """0 for a point."""

    axes = 2

    def longest(self) -> float:
        """Return the time for which a fall is shown."""
        return FALL_TIME * float(np.sqrt(self.leg_length + self.foot_radius))

    def sizes(self) -> dict[str, float]:
        """Return sizes for drawing."""
        return {"leg_length": self.leg_length, "foot_radius": self.foot_radius}

    def move(
        self,
        states: Any,
        foot: Float[np.ndarray, "2"],
        number: int = 0,
        height: float | None = None,
        failed: bool = False,
    ) -> Moved:
        """Return angles and places in a stride from a place of the foot, and the next foothold.

        `height` is the step up to the next foothold, on rough ground, which is one step ahead of a
        walker that has `failed`.
        """
        ahead = self.step_ahead(states, height, failed)
        return states._asdict(), self.places(states, foot), foot + ahead

    def places(
        self, states: Any, foot: Float[np.ndarray, "2"]
    ) -> dict[str, Float[np.ndarray, "frames 2"]]:
        """Return stance foot, hip and swing foot, or the arcs' centres; and a swing knee."""
        _, length, radius = self
        along = lambda angle: np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        theta, phi = np.asarray(states.theta), np.asarray(states.phi)
        stance = foot + np.stack([-radius * theta, np.full(len(theta), radius)], axis=1)
        hip = stance + length * along(theta)
        bent = jax.vmap(self.walker.bent_leg)(jax.tree.map(jnp.asarray, states))
        if bent is None:
            return {"stance": stance, "hip": hip, "swing": hip - length * along(theta - phi)}
        knee, end = np.moveaxis(np.asarray(bent), 1, 0)
        return {"stance": stance, "hip": hip, "swing": hip + end, "swing_knee": hip + knee}

    def step_ahead(self, states: Any, height: float | None, failed: bool) -> Float[np.ndarray, "2"]:
        """Return the way from the stance foot to the next foothold; one step, after a failure."""
        shown = lambda i: jax.tree.map(lambda values: jnp.asarray(values[i]), legs(states))
        ahead = float(self.walker.reach(shown(-1)))
        if failed and height is not None:
            ahead = abs(float(self.walker.reach(self.walker.exchange_legs(shown(0)))))
        return np.array([ahead, height or 0.0])


def picture_of_legs(walker: Any) -> LegPicture:
    """Return the picture of a walker in the plane, with the sizes of its legs.

    They follow from the way of the swing foot as legs turn by half a turn from being parallel, the
    stance leg from upright. That way is twice the length down, and half the arc's circumference
    along.
    """
    half, zero = jnp.asarray(np.pi), jnp.asarray(0.0)
    turned = State(half, half, zero, zero)
    length, radius = -walker.clearance(turned) / 2, -walker.reach(turned) / np.pi
    return LegPicture(walker, float(length), max(0.0, round(float(radius), 12)))


class DiscPicture(NamedTuple):
    """A `SpatialWalker`: two discs, and the legs from them to an axle."""

    walker: Any

    axes = 3

    def longest(self) -> float:
        """Return the time for which a fall is shown."""
        return SHOWN_IN_SPACE * float(np.sqrt(self.walker.leg_length))

    def sizes(self) -> dict[str, float]:
        """Return none: the walker's parameters are the sizes for drawing."""
        return {}

    def move(self, states: Any, foot: Float[np.ndarray, "3"], number: int = 0, *_: Any) -> Moved:
        """Return angles and places in a stride of some number, and the place of the next foot."""
        found, sole = map(np.asarray, jax.vmap(places_of_discs, (None, 0))(self.walker, states))
        mirror = np.array([1, (-1) ** number, 1])
        places = {name: foot + mirror * found[:, i] for i, name in enumerate(PLACES)}
        places["axle"] = mirror * found[:, PLACES.index("axle")]
        angles = {name: np.asarray(getattr(states, name)) for name in ANGLES}
        return angles, places, foot + mirror * sole[-1]


@kernel
def places_of_discs(walker: Any, state: Any) -> tuple[Float[Array, "places 3"], Float[Array, " 3"]]:
    """Return both discs' centres, the axle's ends and direction; and the swing disc's sole."""
    x, y, *angles = state[:6]
    q, shank = jnp.stack([x, y, jnp.zeros_like(x), *angles]), walker.leg_length - walker.disc_radius
    discs = [walker.disc(q, swing) for swing in (False, True)]
    ends = [
        disc + shank * walker.rotation(q, swing)[:, 2]
        for disc, swing in zip(discs, (False, True), strict=True)
    ]
    return jnp.stack([*discs, *ends, walker.axle(q)[:, 1]]), walker.sole(q, True)
