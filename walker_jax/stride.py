"""The stride function: from one heel strike to the next (Schwab and Wisse 2001, section 3.3).

A stride is followed by its contact coordinate h. Whatever ends it shows at the ends of an
integration step: h has risen through zero with the swing leg ahead, or may have in between, the
stance leg has stopped, or is down. Then the step is looked at more closely, through its own
polynomial; where nothing has happened after all, the stride goes on.
"""

import enum
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from walker_jax.checks import (
    WrongUse,
    array,
    check_kind,
    check_number,
    check_whole,
    refuses_tracers,
    short,
)
from walker_jax.integrate import (
    MAX_STEPS,
    AnySolver,
    Method,
    Real,
    default_tolerance,
    solved_by,
    solver_for,
    zero_at,
)
from walker_jax.kernels import by_kernel
from walker_jax.roots import first_rise, least, negative
from walker_jax.taylor import fast_sines
from walker_jax.tiles import map_cells
from walker_jax.walkers import (
    MultibodyWalker,
    Scalar,
    SingleSupport,
    State,
    Walker,
    parameters,
)


class Outcome(enum.IntEnum):
    """How a stride ends."""

    STRIDE = 0
    """Heel strike: the next stride begins."""
    FORWARD = 1
    """The stance leg reaches theta = -pi/2 without a heel strike."""
    BACKWARD = 2
    """The stance leg stops before a heel strike, or the heel strike turns the next one back."""
    RUNNING = 3
    """The contact force is tensile at the start, or during a stride that reaches heel strike."""
    STOPPED = 4
    """At heel strike the trailing foot does not lift: both feet stay down."""
    OUTSIDE = 5
    """The start is not feasible."""
    UNDECIDED = 6
    """The integration gave no answer."""
    LEFT_GRID = 7
    """Cell mapping only: the stride ended outside the grid."""


class Stride(NamedTuple):
    """What a stride leads to."""

    state: Float[Array, "*cells section"]
    """Start of the next stride, on the section; NaN unless the outcome is `STRIDE`."""
    outcome: Int[Array, "*cells"]
    """`Outcome` as int8."""
    time: Float[Array, "*cells"]
    """Duration; NaN unless the outcome is `STRIDE`."""


class Walk(NamedTuple):
    """What a number of strides leads to. Nothing follows a failure: later states are NaN."""

    states: Float[Array, "strides+1 section"]
    """Start of each stride, and of the one after the last."""
    outcomes: Int[Array, " strides"]
    """`Outcome` of each stride; that of the failure from there on."""
    times: Float[Array, " strides"]
    """Duration of each stride."""


def stride(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    *,
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
    - `tolerance`: of one step's last Taylor terms, relative to the state or its rate; of the error
      that another solver estimates.
    - `solver`: one of diffrax's explicit Runge-Kutta methods, such as `diffrax.Dopri8()`, in place
      of the Taylor series. It does not know where a vector field has kinks.

    **Returns** a `Stride`. A failure is an `Outcome`. `ValueError` for a wrong shape or dtype, and
    for a tolerance that the dtype cannot hold.
    """
    with solved_by(solver):
        return follow_stride(*prepared(walker, x, tolerance))


def prepared(
    walker: Walker, x: Float[ArrayLike, " coordinates"], tolerance: Real | None
) -> tuple[Walker, Float[Array, " coordinates"], Float[Array, ""]]:
    """Walker, start and tolerance, checked, in the dtype of the start."""
    check_kind("walker", walker, Walker)
    for name, value in vars(walker).items():
        if np.shape(value):
            raise WrongUse(f"{name} must be one number, not of shape {np.shape(value)}")
    x = as_floating(x)
    sizes = len(walker.section), len(State._fields)
    if x.ndim != 1 or x.shape[0] not in sizes:
        raise WrongUse(
            f"x must have shape ({sizes[0]},), on the section {walker.section}, or ({sizes[1]},), "
            f"a full state, not {x.shape}"
        )
    tolerance = default_tolerance(x.dtype, tolerance)
    walker = jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), walker)
    return walker, x, jnp.asarray(tolerance, x.dtype)


@by_kernel
def follow_stride(
    walker: Walker,
    x: Float[Array, " coordinates"],
    tolerance: Float[Array, ""],
) -> Stride:
    start, verdict = fast_sines(begin)(walker, x)
    launched = not on_section(walker, x)
    arrival, time, verdict, pulled = swing(walker, start, verdict, tolerance, launched=launched)
    return fast_sines(end)(walker, arrival, time, verdict, pulled)


def on_section(walker: Walker, x: Float[Array, " coordinates"]) -> bool:
    """Whether a start is a point of the section, and no full state."""
    return x.shape == (len(walker.section),)


def full_state(walker: Walker, x: Float[Array, " coordinates"]) -> State:
    """The full state of a start, which may be one already."""
    start = walker.lift(x) if on_section(walker, x) else State(*x)
    check_field(walker, start)
    return start


def check_field(walker: Walker, start: State) -> None:
    """Refuse a walker of a user's own whose vector field is none."""
    if type(walker).vector_field is MultibodyWalker.vector_field:
        return
    rates = jax.eval_shape(walker.vector_field, start)
    if not isinstance(rates, State) or any(np.shape(rate) for rate in rates):
        found = " ".join(eqx.tree_pformat(rates, struct_as_array=True).split())
        raise WrongUse(
            f"vector_field of {type(walker).__name__} must return a State of four scalars, "
            f"not {found}"
        )


def begin(walker: Walker, x: Float[Array, " coordinates"]) -> tuple[State, Int[Array, ""]]:
    """The full state at the start, and the outcome where that settles it."""
    start = full_state(walker, x)
    if on_section(walker, x):
        feasible = walker.feasible(x)
    else:
        feasible = jnp.all(jnp.isfinite(x)) & (jnp.abs(start.theta) < np.pi / 2)
    verdict = jnp.where(start.thetadot >= 0, Outcome.BACKWARD, Outcome.UNDECIDED)
    verdict = jnp.where(in_tension(walker, start), Outcome.RUNNING, verdict)
    return start, jnp.where(feasible, verdict, Outcome.OUTSIDE).astype(jnp.int8)


def end(
    walker: Walker,
    arrival: State,
    time: Scalar,
    verdict: Int[Array, ""],
    pulled: Bool[Array, ""],
) -> Stride:
    """What a stride leads to whose swing ended with `verdict`, on the section."""
    following, outcome = after_impact(walker, arrival, verdict, pulled)
    return completed(walker.project(following), outcome, time)


def completed(state: Float[Array, " coordinates"], outcome: Int[Array, ""], time: Scalar) -> Stride:
    """A stride; its results are NaN unless it is one."""
    success = outcome == Outcome.STRIDE
    return Stride(jnp.where(success, state, jnp.nan), outcome, jnp.where(success, time, jnp.nan))


def after_impact(
    walker: Walker, arrival: State, verdict: Int[Array, ""], pulled: Bool[Array, ""]
) -> tuple[State, Int[Array, ""]]:
    """The state after a heel strike, legs exchanged, and the outcome of the stride."""
    (_, lift), after = walker.impact(arrival)
    following = walker.exchange_legs(after)
    struck = jnp.where(following.thetadot < 0, Outcome.STRIDE, Outcome.BACKWARD)
    struck = jnp.where(lift > 0, struck, Outcome.STOPPED)
    struck = jnp.where(jnp.isfinite(lift), struck, Outcome.UNDECIDED)
    struck = jnp.where(pulled | in_tension(walker, arrival), Outcome.RUNNING, struck)
    return following, jnp.where(verdict == Outcome.STRIDE, struck, verdict).astype(jnp.int8)


def step_down(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    drop: Real,
    *,
    tolerance: Real | None = None,
) -> Stride:
    """One stride whose heel strike is on ground that is lower by `drop`.

    The swing foot comes down to the slope, as in `stride`, and goes on until it is `drop` below,
    measured at right angles to the slope, in the unit of length, not negative. Arguments and errors
    are those of `stride` otherwise. The result's state is a full one, (theta, phi, thetadot,
    phidot), just after heel strike, off the section: the foot that stood is higher. `stride` takes
    it from there, on a slope through the foot that stands now.
    """
    walker, x, tolerance = prepared(walker, x, tolerance)
    if not isinstance(drop, Tracer):
        check_number("drop", drop)
        if not 0 <= drop < np.inf:
            raise WrongUse(f"drop must be one number, finite and not negative, not {short(drop)}")
    height = jnp.asarray(drop, x.dtype)
    return follow_step_down(walker, x, height, tolerance)


@by_kernel
def follow_step_down(
    walker: Walker,
    x: Float[Array, " coordinates"],
    drop: Float[Array, ""],
    tolerance: Float[Array, ""],
) -> Stride:
    start, verdict = fast_sines(begin)(walker, x)
    launched = not on_section(walker, x)
    level, time, verdict, pulled = swing(walker, start, verdict, tolerance, launched=launched)
    pulled |= fast_sines(in_tension)(walker, level)
    going = (verdict == Outcome.STRIDE) & (drop > 0)
    verdict = jnp.where(going, Outcome.UNDECIDED, verdict).astype(jnp.int8)
    arrival, longer, verdict, more = swing(walker, level, verdict, tolerance, drop)
    following, outcome = fast_sines(after_impact)(walker, arrival, verdict, pulled | more)
    return completed(jnp.stack(following), outcome, time + longer)


def in_tension(walker: Walker, state: State) -> Bool[Array, ""]:
    """Whether the ground would have to pull at the stance foot, Q_v < 0."""
    return walker.contact_force(state)[1] < 0


def equations(walker: Walker) -> Callable[[State], State]:
    """What is integrated: the vector field, or what it follows from where that is faster."""
    general = type(walker).vector_field is MultibodyWalker.vector_field
    if general and isinstance(walker, MultibodyWalker):
        return SingleSupport(walker)
    return walker.vector_field


def swing(
    walker: Walker,
    start: State,
    verdict: Int[Array, ""],
    tolerance: Real,
    drop: Scalar | None = None,
    *,
    launched: bool = False,
) -> tuple[State, Scalar, Int[Array, ""], Bool[Array, ""]]:
    """Swing the leg until heel strike (`STRIDE`) or a fall; nothing to do unless `UNDECIDED`.

    Or until the swing foot is lower than at the start by `drop`. Returns the state just before the
    impact, its time, the verdict, and whether the ground would have had to pull at the stance foot
    before that; its two ends are not looked at. What has been `launched`, and did not start on the
    section, is followed to the end of its fall.
    """

    def contact(state: State) -> Scalar:
        if drop is None:
            return walker.contact(state)
        return walker.clearance(start) - walker.clearance(state) - drop

    def rate(state: State) -> Scalar:
        """dh/dt along the motion."""
        return jax.jvp(contact, (state,), (walker.vector_field(state),))[1]

    def may_end(before: State, after: State, below: Bool[Array, ""], ends_below: Bool[Array, ""]):
        """Whether a stride may end in a step: all that is wanted of it are its two ends."""
        turns = (rate(before) < 0) & (rate(after) > 0)
        rises = ~ends_below & (below | turns)
        if drop is not None:  # a foot may come down and up again: the legs pass each other
            rises |= (rate(before) > 0) & (rate(after) < 0)
        return (rises & (after.theta < 0)) | has_fallen(after, ends_below)

    def may_pull(before: State, after: State):
        """Whether the ground may have had to pull by the end of a step."""
        return in_tension(walker, after) | dips(walker, before, after)

    def has_fallen(state: State, below: Bool[Array, ""]):
        fallen = (state.thetadot >= 0) | (state.theta <= -np.pi / 2)
        if launched or drop is not None:
            return fallen
        return fallen | (~below & walker.past_contact(state))

    def undecided(carry):
        *_, time, verdict, count, _, _ = carry
        return (verdict == Outcome.UNDECIDED) & (count < MAX_STEPS) & jnp.isfinite(time)

    def follow(carry):
        now, _, time, verdict, count, pulled, below = carry

        def stop(before: State, after: State, below: Bool[Array, ""]):
            ends_below = contact(after) < 0
            ends = may_end(before, after, below, ends_below)
            if not walker.force_least_at_ends:
                ends |= may_pull(before, after) & ~pulled
            return ends, ends_below

        last, steps = method.follow(now, stop, side=below, time=time)
        look, until = method.look(contact, last), last.length
        below, ends_below = last.sides
        if drop is not None:
            highest = least(negative(look), until)
            until = jnp.where(highest.exists, highest.time, until)
            ends_below = jnp.where(highest.exists, look(until)[0] < 0, ends_below)
        rises, time = first_rise(look, until, (below, ends_below))
        time = jnp.where(rises, method.sharpened(contact, last, time), last.length)
        after = lambda time: method.within(last, time)
        arrival = after(time)
        if not walker.force_least_at_ends:
            pulled |= pulls(walker, last.start, arrival, after, time)
            pulled |= ~rises & fast_sines(in_tension)(walker, arrival)
        arrival, delay = method.land(contact, arrival)
        ahead = (arrival.theta < 0) & (arrival.theta > -np.pi / 2) & (arrival.thetadot < 0)
        ahead &= arrival.phi < 0
        fallen = jnp.where(last.end.thetadot >= 0, Outcome.BACKWARD, Outcome.FORWARD)
        fallen = jnp.where(
            fast_sines(has_fallen)(last.end, last.sides[1]), fallen, Outcome.UNDECIDED
        )
        verdict = jnp.where(rises & ahead, Outcome.STRIDE, fallen).astype(jnp.int8)
        time = jnp.where(verdict == Outcome.STRIDE, time + delay, last.length)
        time = last.time + time
        below = last.sides[1]
        return last.end, arrival, time, verdict, count + steps, pulled, below

    method = Method(equations(walker), solver_for(start), tolerance, (contact,))
    zero, never = zero_at(start), jnp.asarray(False)
    below = jnp.asarray(fast_sines(contact)(start) < 0)
    carry = (start, start, zero, verdict, jnp.asarray(0), never, below)
    _, arrival, time, verdict, _, pulled, _ = lax.while_loop(undecided, follow, carry)
    return arrival, time, verdict, pulled


def normal_force(walker: Walker, state: State) -> tuple[Scalar, Scalar]:
    """Q_v, and dQ_v/dt along the motion."""
    force = lambda state: walker.contact_force(state)[1]
    return jax.jvp(force, (state,), (walker.vector_field(state),))


def dips(walker: Walker, before: State, after: State) -> Bool[Array, ""]:
    """Whether Q_v is least in between two states of a motion."""
    return (normal_force(walker, before)[1] < 0) & (normal_force(walker, after)[1] > 0)


def pulls(
    walker: Walker,
    before: State,
    after: State,
    between: Callable[[Scalar], State],
    time: Scalar,
) -> Bool[Array, ""]:
    """Whether Q_v is negative in between two states of a motion, `time` apart."""
    _, least = least_force(walker, before, after, between, time, resolution=1e-6, above=0.0)
    return least < 0


def least_force(
    walker: Walker,
    before: State,
    after: State,
    between: Callable[[Scalar], State],
    time: Scalar,
    *,
    resolution: float,
    above: float = -np.inf,
) -> tuple[Scalar, Scalar]:
    """When Q_v is least in between two states of a motion, `time` apart, and its value.

    That is at a root of its rate, bracketed by secants (Illinois), to a part of `time`, or until
    the value is not `above` some number. It is infinite where Q_v has no least value in between.
    The value is right to the square of what the time is right to. Constants to derivatives.
    """
    walker, before, after = lax.stop_gradient((walker, before, after))
    look = fast_sines(partial(normal_force, walker))
    below, beyond, time = look(before)[1], look(after)[1], lax.stop_gradient(time)
    zero = jnp.zeros_like(time)

    def unfinished(carry):
        low, high, *_, least = carry
        return (high - low > resolution * time) & (least > above)

    def narrow(carry):
        low, high, below, beyond, best, least = carry
        t = low + (high - low) * jnp.clip(below / (below - beyond), 0.01, 0.99)
        force, rate = look(lax.stop_gradient(between(t)))
        falling = rate < 0
        # An end that stays counts half as much the next time.
        return (
            jnp.where(falling, t, low),
            jnp.where(falling, high, t),
            jnp.where(falling, rate, below / 2),
            jnp.where(falling, beyond / 2, rate),
            jnp.where(force < least, t, best),
            jnp.minimum(least, force),
        )

    active = (below < 0) & (beyond > 0)
    high = jnp.where(active, time, zero)
    carry = (zero, high, below, beyond, zero, jnp.full_like(time, jnp.inf))
    *_, best, least = lax.while_loop(unfinished, narrow, carry)
    return best, least


@refuses_tracers("within them use jax.vmap(lambda x: wj.stride(walker, x))(xs)")
def strides(
    walker: Walker,
    xs: Float[ArrayLike, "n coordinates"],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
    progress: str | None = None,
) -> Stride:
    """`stride` for each of n starts, on all devices and cores; NumPy arrays.

    The walker's parameters are numbers, or arrays of n, as `jax.vmap(RoundFootWalker)(slopes)`
    makes them: then every start has a walker of its own.
    It is fastest where neighbours in `xs` are close on the section.
    `progress` is what to call the work in a progress bar, shown on a terminal only.
    """
    with solved_by(solver):
        return for_each_start(follow_stride, walker, xs, tolerance, progress)


def for_each_start(
    function: Callable,
    walker: Walker,
    xs: Float[ArrayLike, "n coordinates"],
    tolerance: Real | None = None,
    progress: str | None = None,
) -> Any:
    """function(walker, x, tolerance) for n starts, and one walker or n; NumPy arrays."""
    check_kind("walker", walker, Walker)
    xs = array("xs", xs)
    if xs.dtype.kind not in "fiub":
        raise WrongUse(f"xs must be real numbers, not of type {xs.dtype}")
    if xs.ndim != 2:
        raise WrongUse(f"xs must have shape (n, coordinates), not {xs.shape}")
    sizes = len(walker.section), len(State._fields)
    if xs.shape[1] not in sizes:
        raise WrongUse(
            f"xs must have shape (n, {sizes[0]}), on the section {walker.section}, or "
            f"(n, {sizes[1]}), full states, not {xs.shape}"
        )
    dtype = xs.dtype if np.issubdtype(xs.dtype, np.floating) else float
    xs = xs.astype(jax.dtypes.canonicalize_dtype(dtype), copy=False)
    # Of one dtype, whatever numbers they were given as: another would be compiled anew.
    to_dtype = lambda leaf: np.asarray(leaf, xs.dtype)
    walker, finest = jax.tree.map(to_dtype, (walker, default_tolerance(xs.dtype, tolerance)))
    many = any(np.ndim(leaf) for leaf in jax.tree.leaves(walker))
    if many:
        check_parameters(walker, len(xs))
        walker = stacked(walker, len(xs), xs.dtype)
    return map_cells(function, (walker, xs, finest), (many, True, False), progress=progress)


def stacked(walker: Walker, n: int, dtype) -> Walker:
    """A walker, or n of them, with every parameter as an array of n."""
    return jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf, dtype), (n,)), walker)


def check_parameters(walker: Walker, n: int) -> None:
    """Refuse parameters that are neither one number nor n, or that a constructor refuses."""
    for name, values in vars(walker).items():
        if np.shape(values) not in ((), (n,)):
            raise WrongUse(f"{name} must be one number or {n}, not of shape {np.shape(values)}")
    for one in parameters(walker):
        values = getattr(walker, one.name)
        for value in (np.min(values), np.max(values)) if np.size(values) else ():
            one.checked(value)


def walk(
    walker: Walker,
    x: Float[ArrayLike, " section"],
    n: int,
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Walk:
    """n strides, one after the other, from x on the section. As `stride` otherwise."""
    check_whole("n", n)
    walker, x, tolerance = prepared(walker, x, tolerance)
    if x.shape != (len(walker.section),):
        raise WrongUse(f"x must be on the section {walker.section}, not of shape {x.shape}")
    with solved_by(solver):
        return follow_walk(walker, x, n, tolerance)


@partial(jax.jit, static_argnums=2)
def follow_walk(
    walker: Walker, x: Float[Array, " section"], n: int, tolerance: Float[Array, ""]
) -> Walk:
    def follow(carry, _):
        x, fate = carry
        result = follow_stride(walker, x, tolerance)
        fate = jnp.where(fate == Outcome.STRIDE, result.outcome, fate)
        return (result.state, fate), (result.state, fate, result.time)

    first = (x, jnp.asarray(Outcome.STRIDE, jnp.int8))
    _, (states, outcomes, times) = lax.scan(follow, first, length=n)
    return Walk(jnp.concatenate([x[None], states]), outcomes, times)


def trajectory(
    walker: Walker,
    x: Float[ArrayLike, " coordinates"],
    times: Float[ArrayLike, " times"],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> State:
    """Angles and rates at `times` after the start x of a stride, 0 or later, increasing.

    The motion is that of the equations alone: it does not end at heel strike, whose time `stride`
    gives. Returns a `State` of arrays; NaN where that takes more than `MAX_STEPS` of integration.
    `ValueError` as for `stride`, and for times that decrease or are negative.
    """
    walker, x, tolerance = prepared(walker, x, tolerance)
    if not isinstance(x, Tracer) and not jnp.isfinite(x).all():
        raise WrongUse(f"x must be finite, not {x}")
    times = as_floating(times, "times").astype(x.dtype)
    if times.ndim != 1:
        raise WrongUse(f"times must be a row of numbers, not of shape {times.shape}")
    if not isinstance(times, Tracer):
        listed = np.asarray(times)
        steps = np.diff(listed, prepend=0.0)
        if listed.size == 0 or not (np.isfinite(steps) & (steps >= 0)).all():
            raise WrongUse(f"times must be finite, not negative and not decrease, unlike {times}")
    with solved_by(solver):
        return jax.vmap(state_after, (None, None, 0, None))(walker, x, times, tolerance)


@by_kernel
def state_after(
    walker: Walker,
    x: Float[Array, " coordinates"],
    time: Scalar,
    tolerance: Scalar,
) -> State:
    """The state a time after the start of a stride."""
    start = full_state(walker, x)
    method = Method(equations(walker), solver_for(start), tolerance)
    solution = method.solve(start, jnp.zeros_like(time), time, method.controller())
    arrived = solution.result == diffrax.RESULTS.successful
    return jax.tree.map(lambda values: jnp.where(arrived, values[-1], jnp.nan), solution.ys)


def as_floating(x: Any, name: str = "x") -> Float[Array, "..."]:
    """x as an array, its dtype kept where it is a floating one."""
    try:
        values = jnp.asarray(x)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(f"{name} must be real numbers, not {short(x)}") from None
    if jnp.iscomplexobj(values):
        raise WrongUse(f"{name} must be real, not of type {values.dtype}")
    return values if jnp.issubdtype(values.dtype, jnp.floating) else values.astype(float)
