"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3)."""

from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from walker_jax.checks import WrongUse, check_kind, check_number, short
from walker_jax.integrators.integrator import AnySolver, Integrator, integrator_of
from walker_jax.integrators.method import zero_at
from walker_jax.integrators.roots import Real
from walker_jax.integrators.taylor import with_fast_sincos
from walker_jax.kernels import by_kernel
from walker_jax.walkers.masses import MultibodyMotion
from walker_jax.walkers.model import Phase, Scalar, State, Walker, check_planar, check_single
from walker_jax.walking.falls import check_falls, fall_of
from walker_jax.walking.modes import equations, in_tension, phase_mode, starts_under, swing_mode
from walker_jax.walking.outcomes import Outcome, Stride, nan_unless
from walker_jax.walking.phases import (
    Arrival,
    follow_on,
    follow_phases,
    follow_to_heel_strike,
    follow_to_swing,
    is_over,
    legs,
)


def stride(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    *,
    step: Real | None = None,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Stride:
    """One stride, S(x), equation (20).

    Works under JAX's transformations, in the dtype of x, float32 or float64: `jax.jit`, `jax.vmap`,
    `jax.lax.scan`; `jax.jacfwd`, `jax.grad` and `jax.jacrev`, and derivatives of these. On a CPU
    all of them call machine code (`kernels`), so a jitted `jax.vmap` is as fast as `strides`.

    **Arguments:**

    - `walker`: any walker; derivatives with respect to its parameters are right too.
    - `x`: the start, on the walker's section just after heel strike; or a full state
      (theta, phi, thetadot, phidot), for a launch or after a push. That is feasible where it is
      finite and the stance leg stands, |theta| < pi/2.
    - `step`: height of the next foothold above the present one, normal to the slope, in the unit of
      length; by default 0. The swing foot comes down there ahead of the other, with a straight
      knee; if it does not rise as high, the walker falls. Scuffing is judged by the present level.
      The result's state is then a full one, just after heel strike and off the section, as one foot
      is lower. `stride` takes it from there, on a slope through the foot that stands now.
    - `tolerance`: of one integration step: of its last Taylor terms, relative to the state or its
      rate (`integrators.taylor_steps.step_length`), or of the error that another solver estimates.
      By default 1e-12 in float64 and 1e-6 in float32. The error of a stride is larger by as much as
      the stride amplifies errors, up to 1e5 times near falling backward.
    - `solver`: one of diffrax's explicit Runge-Kutta methods, such as `diffrax.Dopri8()`, in place
      of the Taylor series. It does not know where a vector field has kinks.

    **Returns** a `Stride`. A failure is an `Outcome`. `ValueError` for a wrong shape or dtype, and
    for a tolerance that the dtype cannot hold.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if step is None:
        return follow_stride(walker, x, integrator)
    check_planar(walker)
    return follow_step(walker, x, height_of_step(step, x.dtype), integrator)


def height_of_step(step: Any, dtype) -> Float[Array, ""]:
    """A step's height, checked."""
    if not isinstance(step, Tracer):
        check_number("step", step)
        if not abs(step) <= np.finfo(float).max:
            raise WrongUse(f"step must be one finite number, not {short(step)}")
    return jnp.asarray(step, dtype)


def prepare(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    tolerance: Real | None,
    solver: AnySolver | None = None,
) -> tuple[Walker, Float[Array, " coordinates"], Integrator]:
    """Walker, start and integrator, checked, in the dtype of the start."""
    check_kind("walker", walker, Walker)
    check_single(walker)
    x = as_floating(x)
    sizes = len(walker.section), *(len(kind._fields) for kind in state_kinds(walker))
    if x.ndim != 1 or x.shape[0] not in sizes:
        full = " or ".join(f"({size},)" for size in sizes[1:])
        raise WrongUse(
            f"x must have shape ({sizes[0]},), on the section {walker.section}, or {full}, "
            f"a full state, not {x.shape}"
        )
    integrator = integrator_of(x.dtype, tolerance, solver).in_dtype(x.dtype)
    walker = jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), walker)
    return walker, x, integrator


@by_kernel
def follow_stride(
    walker: Walker,
    x: Float[Array, " coordinates"],
    integrator: Integrator,
) -> Stride:
    walker = during_stride(walker, x)
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    launched = not on_section(walker, x)
    arrival = follow_to_heel_strike(walker, start, verdict, integrator, launched=launched)
    return with_fast_sincos(end_stride)(walker, arrival)


def on_section(walker: Walker, x: Float[Array, " coordinates"]) -> bool:
    """Whether a start is a point of the section, and no full state."""
    return x.shape == (len(walker.section),)


def during_stride(walker: Walker, x: Float[Array, " coordinates"]) -> Walker:
    """The walker as it is during the stride from x; of a full state, the section's coordinates."""
    if type(walker).during_stride is Walker.during_stride:
        return walker
    return walker.during_stride(
        x if on_section(walker, x) else walker.project(full_state(walker, x))
    )


def state_kinds(walker: Walker) -> list[type]:
    """Kinds of full states that a stride may start from: its own, and that of its first phase."""
    if not (phases := walker.phases()):
        return [walker.state]
    number: Any = jax.ShapeDtypeStruct((), jnp.asarray(0.0).dtype)
    return [State, type(jax.eval_shape(phases[0].begin, State(number, number, number, number)))]


def full_state(walker: Walker, x: Float[Array, " coordinates"]) -> Any:
    """The full state of a start, which may be one already; of the first phase, if there are any."""
    if on_section(walker, x):
        start = walker.lift(x)
    else:
        start = next(kind for kind in state_kinds(walker) if len(kind._fields) == len(x))(*x)
    if isinstance(start, walker.state):
        check_vector_field(walker, start)
        check_falls(walker, start)
        return walker.phases()[0].begin(start) if walker.phases() else start
    return start


def check_vector_field(walker: Walker, start: Any) -> None:
    """Refuse a walker of a user's own whose vector field is none."""
    if type(walker).vector_field is MultibodyMotion.vector_field:
        return
    rates = jax.eval_shape(walker.vector_field, start)
    if not isinstance(rates, walker.state) or any(np.shape(rate) for rate in rates):
        found = " ".join(eqx.tree_pformat(rates, struct_as_array=True).split())
        raise WrongUse(
            f"vector_field of {type(walker).__name__} must return a State of four scalars, "
            f"not {found}"
        )


def begin_stride(walker: Walker, x: Float[Array, " coordinates"]) -> tuple[Any, Int[Array, ""]]:
    """The full state at the start, and the outcome where that settles it.

    Where there are phases, these look at the contact force themselves.
    """
    start, phases = full_state(walker, x), walker.phases()
    if on_section(walker, x):
        feasible = walker.feasible(x)
    else:
        feasible = jnp.all(jnp.isfinite(x)) & (jnp.abs(start.theta) < np.pi / 2)
        if phases:
            feasible &= phases[0].event(start) <= 0
    verdict = fall_of(walker, start)
    if not phases:
        verdict = jnp.where(in_tension(walker, start), Outcome.RUNNING, verdict)
    return start, jnp.where(feasible, verdict, Outcome.OUTSIDE).astype(jnp.int8)


def end_stride(walker: Walker, arrival: Arrival) -> Stride:
    """The stride whose swing has arrived, on the section."""
    following, outcome = resolve_impact(walker, arrival)
    return make_stride(walker.project(following), outcome, arrival.time)


def make_stride(
    state: Float[Array, " coordinates"], outcome: Int[Array, ""], time: Scalar
) -> Stride:
    """A stride; its results, and their derivatives, are NaN unless it is one."""
    success = outcome == Outcome.STRIDE
    return Stride(nan_unless(success, state), outcome, nan_unless(success, time))


def resolve_impact(walker: Walker, arrival: Arrival) -> tuple[Any, Int[Array, ""]]:
    """The state after a heel strike, legs exchanged, and the outcome of the stride."""
    (_, lift), after = walker.impact(arrival.state)
    following = walker.exchange_legs(after)
    fallen = fall_of(walker, following)
    struck = jnp.where(fallen == Outcome.UNDECIDED, Outcome.STRIDE, fallen)
    struck = jnp.where(lift > 0, struck, Outcome.STOPPED)
    struck = jnp.where(jnp.isfinite(lift), struck, Outcome.UNDECIDED)
    for outcome, violated in reversed(arrival.violated.items()):
        struck = jnp.where(violated, outcome, struck)
    outcome = jnp.where(arrival.verdict == Outcome.STRIDE, struck, arrival.verdict)
    return following, outcome.astype(jnp.int8)


def step_down(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    drop: Real,
    *,
    tolerance: Real | None = None,
) -> Stride:
    """One stride whose heel strike is on ground that is lower by `drop`, not negative.

    `stride(walker, x, step=-drop)`.
    """
    if not isinstance(drop, Tracer):
        check_number("drop", drop)
        if not 0 <= drop < np.inf:
            raise WrongUse(f"drop must be one number, finite and not negative, not {short(drop)}")
    step = -drop if isinstance(drop, Tracer) else -float(drop)
    return stride(walker, x, step=step, tolerance=tolerance)


@by_kernel
def follow_step(
    walker: Walker,
    x: Float[Array, " coordinates"],
    step: Float[Array, ""],
    integrator: Integrator,
) -> Stride:
    """One stride to ground that is higher by `step`; the result's state is a full one."""
    walker = during_stride(walker, x)
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    launched = not on_section(walker, x)
    # A foot that goes below the ground has passed its level first, ahead of the other: the legs may
    # pass each other below the level, and that is no heel strike.
    begun = follow_to_swing(walker, start, verdict, integrator, step)
    passed = step > 0
    if walker.phases():  # a foot in front may be below the level as a knee strikes
        ahead = (begun.state.phi < 0) & (walker.is_ahead(begun.state) > 0)
        passed |= (step < 0) & ahead & with_fast_sincos(starts_under)(walker, begun.state)
    to_level = swing_mode(walker, begun.state, step, to_step=passed, launched=launched)
    level = follow_on(to_level, begun, integrator)
    lower = (level.verdict == Outcome.STRIDE) & (step < 0) & ~passed
    verdict = jnp.where(lower, Outcome.UNDECIDED, level.verdict).astype(jnp.int8)
    last = follow_on(
        swing_mode(walker, level.state, step), level._replace(verdict=verdict), integrator
    )
    # On even ground nothing is left to swing, but the derivative with respect to the step is.
    method = integrator.method(equations(walker), last.state)
    contact = lambda state: step - walker.clearance(state)
    arrival, delay = method.refine_event(contact, last.state)
    last = last._replace(state=arrival, time=last.time + delay)
    following, outcome = with_fast_sincos(resolve_impact)(walker, last)
    return make_stride(jnp.stack(following), outcome, last.time)


def trajectory(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    times: Float[ArrayLike, " times"],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Any:
    """Angles and rates at `times` after the start x of a stride, 0 or later, in any order.

    The motion is that of the equations alone: it does not end at heel strike, whose time `stride`
    gives. Phases end with their events, at `phase_times`; a walker that falls before goes on.
    Returns a `State` of arrays, or a state of the stride's first phase, such as `BentState`; NaN
    where that takes more than `MAX_STEPS` of integration. `ValueError` as for `stride`, and for
    times that are not finite or negative.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    if not isinstance(x, Tracer) and not jnp.isfinite(x).all():
        raise WrongUse(f"x must be finite, not {x}")
    times = as_floating(times, "times").astype(x.dtype)
    if times.ndim != 1:
        raise WrongUse(f"times must be a row of numbers, not of shape {times.shape}")
    if not isinstance(times, Tracer):
        values = np.asarray(times)
        if values.size == 0 or not (np.isfinite(values) & (values >= 0)).all():
            raise WrongUse(f"times must be one or more, finite and not negative, unlike {times}")
    return jax.vmap(state_after, (None, None, 0, None))(walker, x, times, integrator)


@by_kernel
def state_after(
    walker: Walker,
    x: Float[Array, " coordinates"],
    time: Scalar,
    integrator: Integrator,
) -> Any:
    """The state a time after the start of a stride; of the first phase, if there are any."""
    walker = during_stride(walker, x)
    start = full_state(walker, x)
    if not (phases := walker.phases()):
        return state_of_motion(walker, start, time, integrator)
    result, begins = state_of_motion(phases[0], start, time, integrator), jnp.zeros_like(time)
    for phase, following in zip(phases, (*phases[1:], walker), strict=True):
        mode = phase_mode(phase, start)
        alone = mode._replace(guards=mode.guards[-1:], conditions=())  # nothing else ends it
        over = is_over(phase, start, integrator)
        verdict = jnp.where(over, Outcome.STRIDE, Outcome.UNDECIDED).astype(jnp.int8)
        arrival = follow_on(alone, Arrival(start, begins, verdict, {}), integrator)
        begins = jnp.where(arrival.verdict == Outcome.STRIDE, arrival.time, jnp.inf)
        start = with_fast_sincos(lambda phase, s: phase.end(s))(phase, arrival.state)
        left = time - begins
        later = state_of_motion(following, start, jnp.maximum(left, 0), integrator)
        if type(later) is not type(result):
            later = phases[0].begin(legs(later))
        result = jax.tree.map(partial(jnp.where, left >= 0), later, result)
    return result


def state_of_motion(
    walker: Walker | Phase, start: Any, time: Scalar, integrator: Integrator
) -> Any:
    """The state a time after another, by the equations of one phase."""
    method = integrator.method(equations(walker), start)
    solution = method.solve(start, jnp.zeros_like(time), time)
    arrived = solution.result == diffrax.RESULTS.successful
    return jax.tree.map(lambda values: nan_unless(arrived, values[-1]), solution.ys)


def phase_times(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Float[Array, " phases"]:
    """When each phase of a stride ends, since its start; the last is the time of `stride`.

    Of a kneed walker: the times of knee strike, 0 where the knee locks at once, and of heel strike.
    NaN for phases that do not end with their event. Arguments and errors are those of `stride`.
    """
    return follow_phase_times(*prepare(walker, x, tolerance, solver))


@by_kernel
def follow_phase_times(
    walker: Walker, x: Float[Array, " coordinates"], integrator: Integrator
) -> Float[Array, " phases"]:
    ends = follow_stride(walker, x, integrator).time
    walker = during_stride(walker, x)
    start, verdict = with_fast_sincos(begin_stride)(walker, x)
    phases = follow_phases(walker, Arrival(start, zero_at(start), verdict, {}), integrator)
    ended = [one.verdict == Outcome.UNDECIDED for one in phases]
    times = [nan_unless(good, one.time) for one, good in zip(phases, ended, strict=True)]
    return jnp.stack([*times, ends])


def as_floating(x: Any, name: str = "x") -> Float[Array, "..."]:
    """x as an array, its dtype kept where it is a floating one."""
    try:
        values = jnp.asarray(x)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(f"{name} must be real numbers, not {short(x)}") from None
    if jnp.iscomplexobj(values):
        raise WrongUse(f"{name} must be real, not of type {values.dtype}")
    return values if jnp.issubdtype(values.dtype, jnp.floating) else values.astype(float)
