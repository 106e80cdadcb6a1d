"""Walks for the page: the frames of some strides, and pushes.

A frame is a full state, angles first and then their rates. Frames are evenly spaced over each
stride, with its start and its end among them. The page interpolates between them, so few suffice.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.execution.tiles import map_cells
from walker_jax.explorer.subjects import Subject
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.kneed import BentState
from walker_jax.walkers.model import State, Walker
from walker_jax.walkers.phase import legs
from walker_jax.walking.iteration import record_walk, strides
from walker_jax.walking.movement import find_end
from walker_jax.walking.trajectories import phase_times, state_after

MAX_STRIDES = 60
"""Most strides in one answer."""
STRIDES_AT_ONCE = 6
"""Strides computed before other requests take their turn; at most `RECORDED`."""
INTEGRATOR = Integrator(1e-12)
FRAME = 0.06
"""Time between frames, about 60 in a stride. A cubic through states and rates interpolates them."""


def leg_of(subject: Subject) -> dict[str, float] | None:
    """Return the sizes for drawing a walker; None for a system that is not drawn.

    They are the length of its legs, from the hip to the centre of the foot's arc, and the radius of
    that arc. Raises `WrongUse` if its clearance and reach are not those of a leg.
    """
    if not subject.offer.has_film:
        return None
    _, length, radius = subject.walker.picture()
    if not (0 < length < math.inf and math.isfinite(radius)):
        raise WrongUse(
            f"{subject.offer.name} cannot be drawn: its clearance and reach are no leg's"
        )
    return {"length": length, "radius": radius}


def follow(subject: Subject, start: Float[np.ndarray, " coordinates"], count: int) -> dict:
    """Follow strides from a start on the section, or from a full state.

    Each of the `strides` has its `start`, `outcome`, `duration` (for a failing stride, of the part
    to be shown) and `frames`, rows of theta, phi, thetadot and phidot. The rows of a `KneedWalker`
    are of a `BentState`; a full state of the legs alone starts with locked knees. `next` is the
    start of the next stride, None after a failure. `leg` has the sizes for drawing the walker.
    """
    made, leg = [], leg_of(subject)
    strides_made, following = make_strides(subject, start, count)
    for walker, start, outcome, duration in strides_made:
        if leg is None or outcome == Outcome.OUTSIDE:
            made.append(end(walker, start, outcome, duration if outcome == Outcome.STRIDE else 0.0))
        elif outcome != Outcome.STRIDE:
            made.append(fall(walker, start, outcome))
        else:
            times = np.linspace(0, duration, 1 + max(8, round(duration / FRAME)))
            states = states_at(walker, start, times)
            made.append(end(walker, start, outcome, duration, states))
    return {"strides": made, "next": following, "leg": leg}


def make_strides(
    subject: Subject, start: Float[np.ndarray, " coordinates"], count: int
) -> tuple[list[tuple[System, np.ndarray, Outcome, float]], list[float] | None]:
    """Return each stride's walker, start, outcome and time, and where the next one starts, if any.

    The first stride may begin in a full state, those after it on the section.
    """
    walker, made = walker_from(subject, start), []
    if len(start) != len(walker.section):
        first = strides(walker, start[None])
        outcome = Outcome(int(first.outcome[0]))
        made.append((walker, start, outcome, float(first.time[0])))
        start, count, walker = np.asarray(first.state[0]), count - 1, subject.walker
        if outcome != Outcome.STRIDE or count == 0:
            return made, start.tolist() if outcome == Outcome.STRIDE else None
    arguments = in_dtype(walker, float), start[None], np.int32(count), INTEGRATOR.in_dtype(float)
    (states,), (last,), (times,) = map_cells(record_walk, arguments, (False, True, False, False))
    last = Outcome(int(last))
    walked = count if last == Outcome.STRIDE else int(np.isfinite(states[:, 0]).sum()) + 1
    outcomes = [Outcome.STRIDE] * (walked - 1) + [last]
    starts = [start, *states]
    of_each = zip(starts, outcomes, map(float, times), strict=False)
    made += [(walker, *one) for one in of_each]
    return made, states[count - 1].tolist() if last == Outcome.STRIDE else None


def walker_from(subject: Subject, start: Float[np.ndarray, " coordinates"]) -> System:
    """Return the walker whose stride begins at a start; its knees are locked if the start's are."""
    walker: Any = subject.walker
    swings = subject.offer.has_film and len(start) == len(State._fields)
    return walker.in_swing() if swings else walker


def fall(walker: Any, start: Float[np.ndarray, " coordinates"], outcome: Outcome) -> dict:
    """Describe the stride in which a walker fails, until it is on the ground, runs or stops."""
    last = min(find_end(walker, start, outcome), walker.picture().longest())
    times = np.linspace(0, max(last, FRAME), 1 + max(8, round(last / FRAME)))
    states = states_at(walker, start, times)
    finite = np.isfinite(states.theta)
    count = max(2, len(times) if finite.all() else int(finite.argmin()))
    states = jax.tree.map(lambda values: values[:count], states)
    return end(walker, start, outcome, float(times[count - 1]), states)


def end(
    walker: Any,
    start: Float[np.ndarray, " coordinates"],
    outcome: Outcome,
    duration: float,
    states: Any = None,
) -> dict:
    """Describe a stride for the page; without states it has no frames.

    If a leg has a knee, `bent` has the places of the knee and of the leg's end relative to the hip,
    and `locks` is the time of knee strike.
    """
    rows = np.zeros((0, 4))
    if states is not None:
        rows = np.stack(states if isinstance(states, BentState) else legs(states), axis=1)
    found = {
        "start": start.tolist(),
        "outcome": int(outcome),
        "duration": duration,
        "frames": np.round(rows, 7).tolist(),
    }
    if len(rows) and walker.phases():
        bent = jax.vmap(walker.bent_leg)(jax.tree.map(jnp.asarray, states))
        if bent is not None:
            found["bent"] = np.round(np.asarray(bent).reshape(-1, 4), 6).tolist()
        locks = float(phase_times(walker, start)[-2])
        found["locks"] = locks if np.isfinite(locks) else None
    return found


def states_at(
    walker: Any, start: Float[np.ndarray, " coordinates"], times: Float[np.ndarray, " n"]
) -> Any:
    """Return the states at times after a start; one program serves any number of times."""
    walker = in_dtype(walker, float)
    arguments = (walker, start, times, INTEGRATOR.in_dtype(float))
    return map_cells(state_after, arguments, (False, False, True, False))


def push(
    subject: Subject, start: Float[np.ndarray, " coordinates"], impulse: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " state"]:
    """Compute the full state after a push at the hip: an impulse along the slope and normal to it.

    The unit is that of mass (or the mass at the hip) times speed.
    """
    walker, leg = in_dtype(walker_from(subject, start), float), leg_of(subject)
    sizes = np.array([*leg.values()]) if leg else None
    if leg is None or jax.eval_shape(after_push, walker, start, impulse, sizes) is None:
        raise WrongUse(
            f"{subject.offer.name} cannot be pushed: it does not say where its masses are"
        )
    arguments = (walker, start[None], impulse[None], sizes)
    return map_cells(after_push, arguments, (False, True, True, False))[0]


def after_push(
    walker: Walker,
    start: Float[Array, " coordinates"],
    impulse: Float[Array, " 2"],
    leg: Float[Array, " 2"],
) -> Float[Array, " state"] | None:
    """Return the state after an impulse at the hip, if it is known which masses move with it.

    The hip of a leg of length l on a foot of radius r is at (-r theta - l sin theta, l cos theta).
    """
    state = walker.launch(start)
    length, radius = leg
    arm = -(radius + length * jnp.cos(state.theta)), -length * jnp.sin(state.theta)
    after = walker.struck(state, impulse, arm)
    return None if after is None else jnp.stack(after)
