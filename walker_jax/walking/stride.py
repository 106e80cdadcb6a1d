"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3).

A stride follows the modes of a walker, one after the other: its phases and, last, the swing, which
ends at heel strike or in a fall. A mode begins in the state to which the mode before was reset. It
is over at once if the walker has fallen by then, or if the event of the phase is due.

Conditions, such as a contact force that would have to pull (`RUNNING`), count in strides that reach
heel strike. A stride that starts in tension is over at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import WrongUse, check_number, check_whole, short
from walker_jax.hybrid.following import NO_GUARD, End, Violated, follow_mode, is_due
from walker_jax.hybrid.modes import Mode, ends_at_once
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import AnySolver, Integrator, Method, zero_at
from walker_jax.integrators.roots import Real
from walker_jax.integrators.step_lengths import StepLimits, has_sharp_features
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, check_outcomes
from walker_jax.systems.outcomes import Outcome, Stride, make_stride
from walker_jax.systems.system import System, apply_map
from walker_jax.walkers.model import Scalar, Walker, check_planar
from walker_jax.walking.raised_ground import height_of_step, onto_step, raise_ground
from walker_jax.walking.starts import (
    during_stride,
    full_state,
    is_feasible,
    on_section,
    prepare,
)

ROUNDING = 100
"""Largest height of a step that counts as level, over the spacing of floating-point numbers at
1."""


class Part(NamedTuple):
    """A mode of a stride that was followed."""

    mode: Mode
    start: Any
    verdict: Int[Array, ""]
    """Verdict as it began; the mode was followed if that is `UNDECIDED`."""
    end: End
    """The end of the mode, with its misses."""


class Arrival(NamedTuple):
    """The point that a stride has reached so far."""

    state: Any
    """The state in which the next mode begins; after the swing, the state before heel strike."""
    time: Scalar
    """Time since the start of the stride; infinite if the integration gave no answer in a phase."""
    verdict: Int[Array, ""]
    """`UNDECIDED` before the swing, `STRIDE` after it, unless the walker falls."""
    violated: Violated
    """Conditions that were violated, the contact force Q_v >= 0 among them."""
    parts: tuple[Part, ...] = ()
    """Its modes so far, for a stride that is measured."""


def stride(
    walker: System,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    step: Real | None = None,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Stride:
    """Make one stride, S(x), equation (20); for any `System`, the step to its next point.

    ```python
    walker = wj.SimplestWalker(0.004)
    end = wj.stride(walker, (0.2, -0.2))
    end.outcome, end.state, end.time
    ```

    Works under JAX's transformations, in the dtype of x, float32 or float64: `jax.jit`, `jax.vmap`,
    `jax.lax.scan`; `jax.jacfwd`, `jax.grad` and `jax.jacrev`, and derivatives of these. On a CPU
    all of them call machine code (`kernels`), so a jitted `jax.vmap` is as fast as `strides`.

    **Arguments:**

    - `walker`: any walker or other system; derivatives with respect to its parameters are right
      too.
    - `x`: the start, on the walker's section just after heel strike; or a full state
      (theta, phi, thetadot, phidot), for a launch or after a push. A full state is feasible if it
      is finite and the stance leg stands, |theta| < pi/2.
    - `step`: height of the next foothold above the present one, normal to the slope, in the unit of
      length; by default 0. The swing foot comes down there ahead of the other, with a straight
      knee; if it does not rise that high, the walker falls. Scuffing is judged by the present
      level. The result's state is then a full state, just after heel strike and off the section, as
      one foot is lower. `stride` takes it from there, on a slope through the standing foot.
    - `tolerance`: of one integration step: of its last Taylor terms, relative to the state or its
      rate (`integrators.taylor_steps.step_size`), or of the error that another solver estimates.
      By default 1e-12 in float64 and 1e-6 in float32. A stride amplifies this error, up to 1e5
      times near falling backward.
    - `solver`: one of diffrax's Runge-Kutta methods, such as `diffrax.Dopri8()`, in place
      of the Taylor series. It does not know where a vector field has kinks.

    **Returns** a `Stride`. A failure is an `Outcome`. Raises `ValueError` for a wrong shape or
    dtype, and for a tolerance that the dtype cannot hold.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if step is None:
        return follow_stride(walker, x, integrator)
    return follow_step(check_planar(walker), x, height_of_step(step, x.dtype), integrator)


@kernel
def follow_stride(
    walker: System, x: Float[Array, " coordinates"], integrator: Integrator
) -> Stride:
    if not isinstance(walker, HybridSystem):
        return apply_map(walker, x)
    walker = during_stride(walker, x)
    modes = modes_from(walker, x)
    arrival = follow_modes(modes, begin_stride(walker, x), integrator)
    _, end = with_fast_sincos(lambda walker, last: end_stride(walker, modes, last))(walker, arrival)
    return end


def modes_from(
    walker: HybridSystem, x: Float[Array, " coordinates"], *, to_the_end: bool = False
) -> list[Mode]:
    """Return the modes of the stride from x.

    A launched walker, which did not start on the section, is followed to the end of a fall.
    """
    *phases, swing = walker.modes()
    check_outcomes(walker, *phases, swing)
    for mode in (*phases, swing):
        check_whole("most_steps", mode.most_steps)
    launched = not on_section(walker, x)
    if launched or to_the_end:
        swing = swing._replace(foregone=None)
    if launched:
        anywhere = lambda one: one._replace(zero_at_ends=(False, one.zero_at_ends[1]))
        swing = swing._replace(conditions=tuple(map(anywhere, swing.conditions)))
    return [*phases, swing]


def begin_stride(walker: HybridSystem, x: Float[Array, " coordinates"]) -> Arrival:
    """Return the full state at the start."""

    def begin(walker, x):
        start = full_state(walker, x)
        return start, jnp.asarray(is_feasible(walker, x, start))

    start, feasible = with_fast_sincos(begin)(walker, x)
    verdict = jnp.where(feasible, Outcome.UNDECIDED, Outcome.OUTSIDE).astype(jnp.int8)
    return Arrival(start, zero_at(start), verdict, {})


def follow_modes(
    modes: list[Mode], begun: Arrival, integrator: Integrator, measured: bool = False
) -> Arrival:
    """Follow modes from a state of the first one to heel strike, the end of the last.

    If `measured`, the parts of the stride have their misses.
    """
    *phases, swing = modes
    last = follow_phases(phases, begun, integrator, measured)[-1]
    return follow_swing(swing, last, integrator, measured, bool(phases))


def follow_phases(
    phases: list[Mode], begun: Arrival, integrator: Integrator, measured: bool = False
) -> list[Arrival]:
    """Return the start of a stride, and the end of each phase, reset for the next one."""
    ends = [begun]
    for mode in phases:
        last = ends[-1]
        due = is_due(mode, method_of(mode, last.state, integrator), last.state)
        now = begin_mode(mode, last, due, len(ends) > 1)
        over = (now.verdict == Outcome.UNDECIDED) & due
        now = now._replace(verdict=jnp.where(over, Outcome.STRIDE, now.verdict).astype(jnp.int8))
        now = follow_on(mode, now, integrator, measured)
        judged = with_fast_sincos(partial(judge_end, mode))(now.state, now.verdict)
        verdict = jnp.where(now.verdict == Outcome.STRIDE, judged, now.verdict)
        ended = verdict == Outcome.STRIDE
        time = jnp.where(verdict == Outcome.UNDECIDED, jnp.inf, now.time)
        verdict = jnp.where(ended, Outcome.UNDECIDED, verdict).astype(jnp.int8)
        state = with_fast_sincos(mode.reset)(now.state)
        ends.append(now._replace(state=state, time=time, verdict=verdict))
    return ends


def follow_swing(
    mode: Mode, last: Arrival, integrator: Integrator, measured=False, switched: bool = False
) -> Arrival:
    """Follow the last mode, from the end of the phases."""
    begun = begin_mode(mode, last, jnp.asarray(False), switched)
    return follow_on(mode, begun, integrator, measured)


def begin_mode(mode: Mode, last: Arrival, over: Bool[Array, ""], switched: bool) -> Arrival:
    """Judge how a mode begins: the walker may have fallen, or, unless the mode is `over`, be in
    tension at the start of the stride."""
    going = last.verdict == Outcome.UNDECIDED
    fallen = with_fast_sincos(partial(fall_of, mode, switched=switched))(last.state)
    verdict = jnp.where(going, fallen, last.verdict)
    for one in mode.conditions:
        if one.outcome == Outcome.RUNNING:
            pulled = going & ~over & (last.time == 0) & one.is_negative(last.state)
            verdict = jnp.where(pulled, Outcome.RUNNING, verdict)
    return last._replace(verdict=verdict.astype(jnp.int8))


def fall_of(mode: Mode, state: Any, switched: bool = False) -> Int[Array, ""]:
    """Return how a walker has fallen as a mode begins; `UNDECIDED` if it has not."""
    outcome = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    for guard in reversed(mode.guards):
        if guard.at_once:
            fallen = ends_at_once(mode, guard, state, switched)
            outcome = jnp.where(fallen, guard.leads_to, outcome).astype(jnp.int8)
    return outcome


def follow_on(mode: Mode, last: Arrival, integrator: Integrator, measured: bool = False) -> Arrival:
    """Follow a mode from the end of the one before; its guard gives the verdict."""
    going = (last.verdict == Outcome.UNDECIDED) & jnp.isfinite(last.time)
    method = method_of(mode, last.state, integrator)
    found = follow_mode(mode, last.state, going, method, measured=measured)
    verdict = jnp.where(found.guard == NO_GUARD, Outcome.UNDECIDED, last.verdict)
    for i, guard in enumerate(mode.guards):
        verdict = jnp.where(found.guard == i, guard.leads_to, verdict)
    if mode.foregone is not None:
        verdict = jnp.where(found.guard == len(mode.guards), mode.foregone.leads_to, verdict)
    never = jnp.asarray(False)
    keys = sorted({*last.violated, *found.violated})
    either = lambda key: last.violated.get(key, never) | found.violated.get(key, never)
    violated = {key: either(key) for key in keys}
    parts = last.parts
    if found.misses is not None:
        parts = *parts, Part(mode, last.state, last.verdict, found)
    return Arrival(found.state, last.time + found.time, verdict.astype(jnp.int8), violated, parts)


def judge_end(mode: Mode, state: Any, verdict: Int[Array, ""]) -> Int[Array, ""]:
    """Judge the state in which a mode has ended: the motion may have to end there."""
    for one in reversed(mode.at_end):
        value = one.value(state)
        fails = jnp.where(jnp.isnan(value), Outcome.UNDECIDED, one.outcome)
        verdict = jnp.where(value > 0, verdict, fails)
    return verdict


def method_of(mode: Mode, start: Any, integrator: Integrator) -> Method:
    """Return the method that integrates a mode; its steps also end at kinks of guards."""
    functions = tuple(function for guard in mode.functions() for function in guard)
    sharp = tuple(one.value for one in mode.conditions if has_sharp_features(one.value, start))
    watched = sharp if mode.as_smooth else (*functions, *sharp)
    conditions = tuple(one.value for one in mode.conditions if not one.least_at_ends)
    limits = StepLimits(mode.scales, mode.longest_step)
    return integrator.method(
        mode.field, start, *functions, watched=watched, conditions=conditions, limits=limits
    )


def end_stride(walker: HybridSystem, modes: list[Mode], last: Arrival) -> tuple[Any, Stride]:
    """Return the state after a heel strike, legs exchanged, and the stride, on the section."""
    lift, following = begin_next(walker, modes[-1], last.state)
    fallen = fall_of(judging_mode(walker, modes), following)
    struck = jnp.where(fallen == Outcome.UNDECIDED, Outcome.STRIDE, fallen)
    struck = jnp.where(lift > 0, struck, Outcome.STOPPED)
    point = walker.project(following)
    finite = jnp.isfinite(lift) & jnp.all(jnp.isfinite(point))
    struck = jnp.where(finite, struck, Outcome.UNDECIDED)
    struck = judge_end(modes[-1], last.state, struck)
    for outcome, violated in reversed(last.violated.items()):
        struck = jnp.where(violated, outcome, struck)
    outcome = jnp.where(last.verdict == Outcome.STRIDE, struck, last.verdict).astype(jnp.int8)
    return following, make_stride(point, outcome, last.time)


def judging_mode(walker: HybridSystem, modes: list[Mode]) -> Mode:
    """Return the mode whose guards decide whether the next stride begins with a fall.

    Its state is the one that the last mode leads to: for a walker that of the swing, before its
    first phase begins.
    """
    return modes[-1] if isinstance(walker, Walker) else modes[0]


def begin_next(walker: HybridSystem, last: Mode, state: Any) -> tuple[Scalar, Any]:
    """Return the speed at which the trailing foot lifts, and the next stride's start.

    The start follows from the state in which the last mode has ended. The speed is 1 for systems
    without feet.
    """
    if not isinstance(walker, Walker):
        return zero_at(state) + 1, last.reset(state)
    (_, lift), after = walker.impact(state)
    return lift, walker.exchange_legs(after)


def step_down(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    drop: Real,
    *,
    tolerance: Real | None = None,
) -> Stride:
    """Make one stride whose heel strike is on ground lower by `drop`, which is not negative.

    It is `stride(walker, x, step=-drop)`; `drop` is in the unit of length.

    ```python
    walker = wj.SimplestWalker(0.004)
    end = wj.step_down(walker, wj.find_gait(walker).states[0], 0.001)
    end.state  # a full state: the feet stand at different heights
    ```
    """
    if not isinstance(drop, Tracer):
        check_number("drop", drop)
        if not 0 <= drop < np.inf:
            raise WrongUse(f"drop must be one number, finite and not negative, not {short(drop)}")
    step = -drop if isinstance(drop, Tracer) else -float(drop)
    return stride(walker, x, step=step, tolerance=tolerance)


@kernel
def follow_step(
    walker: Walker, x: Float[Array, " coordinates"], step: Float[Array, ""], integrator: Integrator
) -> Stride:
    """Make one stride to ground higher by `step`; the result's state is a full state."""
    walker = during_stride(walker, x)
    swing, last = follow_to_contact(walker, x, step, integrator)

    def end(walker, last):
        following, stride = end_stride(walker, [swing], last)
        return jnp.stack(following), stride.outcome

    state, outcome = with_fast_sincos(end)(walker, last)
    return make_stride(state, outcome, last.time)


def follow_to_contact(
    walker: Walker,
    x: Float[Array, " coordinates"],
    step: Scalar,
    integrator: Integrator,
    measured: bool = False,
) -> tuple[Mode, Arrival]:
    """Return the swing of a stride to ground higher by `step`, and the state at its heel strike."""
    *phases, swing = modes_from(walker, x, to_the_end=measured)
    raised = [raise_ground(mode, step) for mode in phases]
    last = follow_phases(raised, begin_stride(walker, x), integrator, measured)[-1]
    last = follow_to_step(walker, swing, last, step, integrator, measured)
    # On even ground no swing is left, but its derivative with respect to the step is.
    contact = lambda state: step - walker.clearance(state)
    arrival, delay = method_of(swing, last.state, integrator).refine_event(contact, last.state)
    return swing, last._replace(state=arrival, time=last.time + delay)


def follow_to_step(
    walker: Walker,
    swing: Mode,
    last: Arrival,
    step: Scalar,
    integrator: Integrator,
    measured: bool = False,
) -> Arrival:
    """Follow the swing on even ground, and on to ground that is higher by `step`.

    A foot that goes below the ground has passed its level first, ahead of the other: the legs may
    pass each other below the level, and that is no heel strike.
    """
    # A step within rounding counts as level: its foot may be there already, or have been there as
    # the legs passed each other.
    rounding = ROUNDING * jnp.finfo(step.dtype).eps
    passed = step > rounding
    if walker.phases():  # a foot in front may be below the level as a knee strikes
        ahead = (last.state.phi < 0) & (walker.is_ahead(last.state) > 0)
        under = with_fast_sincos(walker.clearance)(last.state) < 0
        passed |= (step < 0) & ahead & under
    level = follow_swing(onto_step(walker, swing, step, passed), last, integrator, measured)
    lower = (level.verdict == Outcome.STRIDE) & (step < -rounding) & ~passed
    verdict = jnp.where(lower, Outcome.UNDECIDED, level.verdict).astype(jnp.int8)
    onto = onto_step(walker, swing, step)
    return follow_on(onto, level._replace(verdict=verdict), integrator, measured)
