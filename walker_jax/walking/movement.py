"""Walks as motions: angles and places at many times, over strides joined one to the next.

For pictures and films. Places are along the slope and normal to it, from where the stance foot of
the first stride is when its leg is upright.
"""

from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_number, check_whole, refuses_tracers
from walker_jax.walkers.model import State, Walker, check_planar
from walker_jax.walkers.outcomes import Outcome
from walker_jax.walkers.parameters import attributes_of
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walking.frames import frames_of_stride
from walker_jax.walking.iteration import walk
from walker_jax.walking.movement_in_space import motion_in_space
from walker_jax.walking.starts import full_state
from walker_jax.walking.trajectories import legs

FALL_TIME = 40.0
"""Time in which a walker that fails is on the ground, for legs of length 1."""


@refuses_tracers()
def motion(
    walker: Walker,
    x: Float[ArrayLike, " section"],
    strides: int,
    *,
    step: float = 0.05,
    ground: Float[ArrayLike, " strides"] | None = None,
    tolerance: float | None = None,
) -> xr.Dataset:
    """A walk of some strides from x, and the fall in which it ends, at times about `step` apart.

    Frames are evenly spaced within each stride, with its start and its end among them: so there are
    two at every heel strike, before and after the legs exchange roles. A fall is shown to the
    ground; one that runs to where its foot leaves the ground; one that stops on both feet to there.

    **Arguments:**

    - `walker`, `tolerance`: as in `stride`.
    - `x`: a feasible start, on the section.
    - `strides`: how many, at most.
    - `step`: of time.
    - `ground`: heights of footholds, each above the one before, as in `walk`.

    **Returns** a data set, over `frame`: `time`; `stride`, its number, from 0; `theta`, `phi`,
    `thetadot` and `phidot`, and what else a state of the stride's first phase has, such as `knee`;
    and, over `axis` too, the places of the `hip`, of the ends of the legs, `stance` and `swing`,
    which are centres of the feet's arcs where the feet are round, and of a `swing_knee`. Over
    `start`: `states`, those on the section, the one after the last stride too. Over `made`:
    `outcome` of each stride, a failure at most the last, and its `duration`, NaN if it failed.
    On rough ground also, over `foothold` and `axis`, `footholds`: places on the ground where feet
    stand, one after the other; where a stride fails the next one is a step's length ahead.
    Attributes `leg_length`, to the end of the leg, and `foot_radius` are the sizes in which to draw
    these. `ValueError` for a start that is not feasible, and as for `walk`.

    Of a walker in space there are all four angles, and places have three coordinates, along the
    slope, to the left and normal to it: of the discs' centres, `stance` and `swing`, of the ends of
    the axle, `stance_hip` and `swing_hip`; `axle` is the direction of that.
    """
    check_number("step", step)
    if not 0 < step < np.inf:
        raise WrongUse(f"step must be above 0, not {step}")
    check_whole("strides", strides)
    if not isinstance(walker, SpatialWalker) or ground is not None:
        check_planar(walker)
    made = walk(walker, x, strides, ground=ground, tolerance=tolerance)
    outcomes, durations = np.asarray(made.outcomes), np.asarray(made.times)
    if outcomes[0] == Outcome.OUTSIDE:
        raise WrongUse(f"x must be a feasible start, not {np.asarray(x).tolist()}")
    failed = outcomes != Outcome.STRIDE
    count = int(failed.argmax()) + 1 if failed.any() else len(outcomes)
    outcomes, durations = outcomes[:count], durations[:count]
    starts = np.asarray(made.states)[: count + (not failed.any())]
    if isinstance(walker, SpatialWalker):
        return motion_in_space(walker, starts, outcomes, durations, step, tolerance)

    length, radius = leg_shape(walker)
    longest = FALL_TIME * float(np.sqrt(length + radius))
    steps_up = np.zeros(count) if ground is None else np.asarray(ground, float)[:count]
    spread, parts, places, feet = [], [], [], []
    foot, begins = np.zeros(2), 0.0
    for k in range(count):
        height = None if ground is None else float(steps_up[k])
        made = Outcome(int(outcomes[k])), float(durations[k])
        how = {"longest": longest, "height": height, "tolerance": tolerance}
        times, states = frames_of_stride(walker, starts[k], made, step, **how)
        spread.append(begins + times)
        parts.append(states)
        places.append(leg_positions(walker, states, foot, length, radius))
        last = jax.tree.map(lambda values: jnp.asarray(values[-1]), legs(states))
        feet.append(foot)
        ahead = float(walker.reach(last))
        if failed[k] and ground is not None:
            start = legs(full_state(walker, jnp.asarray(starts[k])))
            ahead = abs(float(walker.reach(legs(walker.exchange_legs(start)))))
        foot, begins = foot + np.array([ahead, steps_up[k]]), spread[-1][-1]

    sizes = [len(states.theta) for states in parts]
    joined = {name: np.concatenate([getattr(s, name) for s in parts]) for name in parts[0]._fields}
    joints = ("stance", "hip", "swing", "swing_knee")[: len(places[0])]
    rough = {}
    if ground is not None:
        rough["footholds"] = ("foothold", "axis"), np.array([*feet, foot])
        starts = np.array([walker.project(State(*row)) for row in starts])
    return xr.Dataset(
        {
            **rough,
            "time": ("frame", np.concatenate(spread)),
            "stride": ("frame", np.repeat(np.arange(count), sizes)),
            **{name: ("frame", values) for name, values in joined.items()},
            **{
                name: (("frame", "axis"), np.concatenate([one[i] for one in places]))
                for i, name in enumerate(joints)
            },
            "states": (("start", "coordinate"), starts),
            "outcome": ("made", outcomes),
            "duration": ("made", durations),
        },
        attrs={
            "walker": type(walker).__name__,
            **attributes_of(walker),
            "section": list(walker.section),
            "leg_length": length,
            "foot_radius": radius,
            "version": f"walker-jax {version('walker-jax')}",
        },
    )


def leg_shape(walker: Walker) -> tuple[float, float]:
    """From the hip to the centre of the foot's arc, and its radius, 0 for point feet.

    Told by how far the swing foot goes as legs turn by half a turn from being parallel, the stance
    leg from upright: that is twice the length down, and half the arc's circumference along.
    """
    half, zero = jnp.asarray(np.pi), jnp.asarray(0.0)
    turned = State(half, half, zero, zero)
    length, radius = -walker.clearance(turned) / 2, -walker.reach(turned) / np.pi
    return float(length), max(0.0, round(float(radius), 12))


def leg_positions(
    walker: Walker, states: Any, foot: Float[np.ndarray, "2"], length: float, radius: float
) -> tuple[Float[np.ndarray, "frames 2"], ...]:
    """Stance foot, hip and swing foot; of round feet, the arcs' centres. And a swing knee."""
    along = lambda angle: np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    theta, phi = np.asarray(states.theta), np.asarray(states.phi)
    stance = foot + np.stack([-radius * theta, np.full(len(theta), radius)], axis=1)
    hip = stance + length * along(theta)
    bent = jax.vmap(walker.bent_leg)(jax.tree.map(jnp.asarray, states))
    if bent is None:
        return stance, hip, hip - length * along(theta - phi)
    knee, end = np.moveaxis(np.asarray(bent), 1, 0)
    return stance, hip, hip + end, hip + knee
