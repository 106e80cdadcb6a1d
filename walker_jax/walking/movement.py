"""Walks as motions: angles and places at many times, over consecutive strides.

They serve pictures and films of systems that have a `picture`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import WrongUse, check_kind, check_number, refuses_tracers
from walker_jax.hybrid.modes import Condition, Guard, Mode
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import failures_by_name
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_source
from walker_jax.walking.iteration import walk
from walker_jax.walking.starts import during_stride, prepare
from walker_jax.walking.stride import follow_graph, modes_from, start_course
from walker_jax.walking.trajectories import trajectory


@refuses_tracers()
def motion(
    walker: System,
    x: Float[ArrayLike, " section"] | Sequence[Any],
    strides: int,
    *,
    step: float = 0.05,
    ground: Float[ArrayLike, " strides"] | Sequence[Any] | None = None,
    tolerance: float | None = None,
) -> xr.Dataset:
    """Compute the motion of a walk from x, and of its fall, at times about `step` apart.

    ```python
    walker = wj.SimplestWalker(0.009)
    walk = wj.motion(walker, wj.find_gait(walker).states[0], 3)
    figures.step(walk).savefig("step.png")  # from walker_jax import figures
    ```

    Frames are evenly spaced within each stride, with its start and its end among them. So there are
    two at every heel strike, before and after the legs exchange roles. A fall is shown to the
    ground; a run until the foot leaves the ground; a stop until both feet stand.

    **Arguments:**

    - `walker`, `tolerance`: as in `stride`; the walker, or other system, has a `picture`.
    - `x`: a feasible start, on the section.
    - `strides`: most strides.
    - `step`: time between frames, approximately, in the unit of time.
    - `ground`: heights of footholds, each above the one before, as in `walk`.

    **Returns** a data set. Over `frame` it has

    - `time`, and `stride`, its number, from 0;
    - `theta`, `phi`, `thetadot` and `phidot`, and all else that a state of the stride's first phase
      has, such as `knee` and its rate;
    - over `axis` too, the places of the `hip`, of a `swing_knee`, and of the ends of the legs,
      `stance` and `swing`: on round feet, the centres of the arcs.

    Over `start` it has `states`, those on the section, the one after the last stride included. Over
    `made` it has the `outcome` of each stride, a failure only for the last one, and its `duration`,
    NaN if it failed. On rough ground it has, over `foothold` and `axis`, `footholds`: successive
    places of feet on the ground; after a failed stride, the next one is a step's length ahead.
    Attributes `leg_length`, to the end of the leg, and `foot_radius` are sizes for drawing.

    For a walker in space there are all four angles, and places have three coordinates, along the
    slope, to the left and normal to it: `stance` and `swing` of the discs' centres, `stance_hip`
    and `swing_hip` of the ends of the axle; `axle` is its direction.

    Raises `ValueError` for a start that is not feasible, and as `walk` does.
    """
    check_number("step", step)
    if not 0 < step < np.inf:
        raise WrongUse(f"step must be above 0, not {step}")
    check_kind("walker", walker, System)
    if (picture := walker.picture()) is None:
        raise WrongUse(f"walker must be a system with a picture, unlike {walker.label()}")
    made = walk(walker, x, strides, ground=ground, tolerance=tolerance)
    outcomes, durations = np.asarray(made.outcomes), np.asarray(made.times)
    if outcomes[0] == Outcome.OUTSIDE:
        raise WrongUse(f"x must be a feasible start, not {np.asarray(x).tolist()}")
    failed = outcomes != Outcome.STRIDE
    count = int(failed.argmax()) + 1 if failed.any() else len(outcomes)
    outcomes, durations = outcomes[:count], durations[:count]
    starts = np.asarray(made.states)[: count + (not failed.any())]
    steps_up = [None] * count if ground is None else np.asarray(ground, float).tolist()
    columns: defaultdict[str, list] = defaultdict(list)
    foot, begins, feet = np.zeros(picture.axes), 0.0, []
    for k, height in zip(range(count), steps_up, strict=False):
        feet.append(foot)
        made = Outcome(int(outcomes[k])), float(durations[k])
        how = {"longest": picture.longest(), "height": height, "tolerance": tolerance}
        times, states = frames_of_stride(walker, starts[k], made, step, **how)
        shown, places, foot = picture.move(states, foot, k, height, bool(failed[k]))
        parts = {"time": begins + times, "stride": np.full(len(times), k)} | shown | places
        for name, values in parts.items():
            columns[name].append(np.asarray(values))
        begins += times[-1]
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    variables = {name: (("frame", "axis")[: x.ndim], x) for name, x in joined.items()}
    if ground is not None:
        planar: Any = walker
        variables["footholds"] = ("foothold", "axis"), np.array([*feet, foot])
        starts = np.array([planar.project(planar.state(*row)) for row in starts])
    variables["states"] = ("start", "coordinate"), starts
    variables |= {"outcome": ("made", outcomes), "duration": ("made", durations)}
    return xr.Dataset(variables, attrs=describe_source(walker) | picture.sizes())


def frames_of_stride(
    walker: Any,
    x: Float[np.ndarray, " coordinates"],
    stride: tuple[Outcome, float],
    step: float,
    *,
    longest: float,
    height: float | None = None,
    tolerance: float | None = None,
) -> tuple[Float[np.ndarray, " frames"], Any]:
    """Return times about `step` apart from the start of a stride to its end, and the states then.

    `stride` is its outcome and duration. A failing stride is shown to its end, or to the violation
    of a condition, and for `longest` at most. `height` is the step up to the next foothold, on
    rough ground.
    """
    outcome, end = stride
    if outcome != Outcome.STRIDE:
        end = min(find_end(walker, x, outcome, height, tolerance), longest)
    times = np.linspace(0, end, 1 + max(int(end > 0), round(end / step)))
    return times, jax.tree.map(np.asarray, trajectory(walker, x, times, tolerance=tolerance))


def find_end(
    walker: System,
    x: Float[np.ndarray, " coordinates"],
    outcome: Outcome,
    height: float | None = None,
    tolerance: float | None = None,
) -> float:
    """Compute when the picture of a stride with a failing outcome ends; infinite if never."""
    walker, start, integrator = prepare(walker, x, tolerance)
    step = None if height is None else jnp.asarray(height, start.dtype)
    return float(end_of_picture(walker, start, jnp.asarray(outcome), step, integrator))


@kernel
def end_of_picture(
    walker: Any,
    x: Float[Array, " coordinates"],
    outcome: Int[Array, ""],
    step: Float[Array, ""] | None,
    integrator: Integrator,
) -> Float[Array, ""]:
    """Return when the swing foot comes down, the walker is on the ground, or the condition of its
    outcome is violated."""
    walker = during_stride(walker, x)
    numbers = failures_by_name(walker)
    modes = modes_from(walker, x, step, to_the_end=True)
    fails = lambda name: outcome == numbers[name]
    shown = {name: mode_shown(one, fails) for name, one in modes.items()}
    course, _ = follow_graph(walker, shown, start_course(walker, shown, x), integrator)
    return jnp.where(course.verdict == Outcome.UNDECIDED, jnp.inf, course.time)


def mode_shown(mode: Mode, fails: Callable[[str], Bool[Array, ""]]) -> Mode:
    """Return a mode that goes on until a leg that stops is down, or a condition that fails is
    violated."""
    down = lambda state: state.theta - np.pi / 2
    guards = [
        one._replace(value=down, persists=False) if one.leads_to == Outcome.BACKWARD.name else one
        for one in mode.guards
    ]

    def violation(one: Condition) -> Guard:
        value = lambda state: jnp.where(fails(one.leads_to), -one.value(state), -1.0)
        return Guard(value, one.leads_to, at_once=not one.zero_at_start)

    violations = map(violation, mode.conditions)
    guards = (*guards, *violations)
    return mode._replace(guards=guards, conditions=(), as_smooth=False)
