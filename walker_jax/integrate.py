"""Integration by Taylor series: a diffrax solver, integration up to a condition, and landing.

`Taylor` is the solver, for `diffrax.diffeqsolve`. `integrate_until` drives the same steps in a
loop of its own.

Nothing here knows what is integrated. Forward-mode derivatives run through everything; step
lengths are constants to them.
"""

from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, PyTree

from walker_jax.checks import WrongUse, check_number
from walker_jax.series import evaluate
from walker_jax.taylor import (
    fast_sines,
    function_series,
    is_list,
    solution_series,
    switching_series,
)

Scalar = Float[Array, ""]
Real = Scalar | float
VectorField = Callable[[PyTree], PyTree]

# Order of the series. Higher orders take fewer steps of more work each; these are the fastest, or
# nearly, at the default tolerances (benchmarks/README.md).
ORDER = {jnp.dtype("float64"): 12, jnp.dtype("float32"): 8}
TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
MAX_STEPS = 1000


def default_tolerance(dtype, tolerance: Real | None = None) -> Real:
    """The tolerance that a dtype holds, or the one given, where the dtype can hold it."""
    dtype = jnp.dtype(dtype)
    if dtype not in TOLERANCE:
        raise WrongUse(f"dtype must be float32 or float64, not {dtype}")
    if tolerance is None:
        return TOLERANCE[dtype]
    if isinstance(tolerance, Tracer):
        return tolerance
    check_number("tolerance", tolerance)
    if not jnp.finfo(dtype).eps / 4 <= tolerance < 1:
        raise WrongUse(
            f"tolerance must lie between {jnp.finfo(dtype).eps / 4:.2g}, which is what {dtype} "
            f"holds, and 1, not be {tolerance:g}"
        )
    return tolerance


def step_length(series: PyTree, tolerance: Real) -> Scalar:
    """Length of a step in which the last terms of the series stay below the tolerance.

    h = min over k = n-1, n of (tolerance |y| / |c_k|)^(1/k), in the largest norm over all
    variables (Jorba and Zou 2005), where |y| is the larger of |c_0| and |c_1|. It is not finite
    for the series of a rest position. The length needs few digits, and powers are cheap in
    float32.
    """
    leaves = jax.tree.leaves(series, is_leaf=is_list)
    order, scale = len(leaves[0]) - 1, scale_of(series)
    log_tolerance = jnp.log(jnp.asarray(tolerance, jnp.float32))

    def log_length(k):
        return (log_tolerance - jnp.log((largest(series, k) / scale).astype(jnp.float32))) / k

    shortest = jnp.exp(jnp.minimum(log_length(order - 1), log_length(order)))
    return shortest.astype(leaves[0][0].dtype)


def scale_of(series: PyTree) -> Scalar:
    """The larger of |y| and |y'| at the start of a step."""
    return jnp.maximum(largest(series, 0), largest(series, 1))


def largest(series: PyTree, k: int) -> Scalar:
    """The largest of all variables' k-th coefficients, in size. A constant to derivatives."""
    leaves = jax.tree.leaves(series, is_leaf=is_list)
    size = jnp.zeros((), leaves[0][0].dtype)
    for leaf in leaves:
        size = jnp.maximum(size, jnp.max(jnp.abs(leaf[k])))
    return lax.stop_gradient(size)


def taylor_step(
    vector_field: VectorField,
    state: PyTree,
    order: int,
    tolerance: Real,
    *others: Callable[[PyTree], PyTree],
) -> tuple[PyTree[list], Scalar]:
    """The series of y' = f(y) from a state, and how long a step it may be used for.

    That is the length at which its last terms reach the tolerance; or where f, or one of the
    others, has a kink, that up to the kink and just beyond it, by `tolerance` of the length. It is
    NaN where f jumps by more than the root of the tolerance, relative to |y| or |y'|.
    """
    series = solution_series(vector_field, state, order)
    length = step_length(series, tolerance)
    if not (switches := [s for f in (vector_field, *others) for s in switching_series(f, series)]):
        return series, length
    least = jnp.asarray(tolerance, length.dtype) * length
    length = up_to_switches(switches, length, least)
    fixed, end = lax.stop_gradient((series, length))
    rates = vector_field(polynomial(fixed, end))
    expected = jax.tree.map(lambda c: evaluate(derivative_of(c), end), fixed, is_leaf=is_list)
    defects = jax.tree.map(lambda a, b: jnp.max(jnp.abs(a - b)), rates, expected)
    defect = jnp.max(jnp.stack(jax.tree.leaves(defects)))
    steady = defect <= jnp.sqrt(jnp.asarray(tolerance, length.dtype)) * scale_of(series)
    return series, jnp.where(steady, length, jnp.nan)


def up_to_switches(switches: list[list[Scalar]], length: Scalar, behind: Scalar) -> Scalar:
    """A step's length, cut just past the first zero of functions given by their series.

    How that zero depends on everything is part of the result: where a step ends at a kink matters
    to second derivatives.
    """
    for switch in switches:
        zero = first_zero(lax.stop_gradient(switch), lax.stop_gradient(length), behind)
        length = jnp.where(zero + behind < length, when_zero(switch, zero) + behind, length)
    return length


def first_zero(series: list[Scalar], length: Scalar, resolution: Scalar) -> Scalar:
    """The first zero of a polynomial in 0 <= t <= length; that, or more, where there is none.

    The polynomial is expanded anew, about points that approach the zero from the left by as much as
    is certain to hold none, until that is less than the resolution. It converges as Newton's
    iteration does, but passes no zero. One that is zero at 0 has that zero, unless it vanishes.
    """

    def certain(series: list[Scalar], most: Scalar) -> Scalar:
        """A length, up to `most`, in which a polynomial that is positive at first has no zero.

        p(t) >= p_0 + p_1 t - b t^2, with b such that b most^2 is the sum of the later terms' sizes
        at t = most.
        """
        value, rate = series[:2]
        later = evaluate([jnp.abs(c) for c in series[2:]], most)
        all_of_it = value + (rate - later * most) * most >= 0
        root = jnp.sqrt(rate**2 + 4 * later * value)
        rising = (rate + root) / (2 * jnp.where(later > 0, later, 1))
        falling = 2 * value / jnp.where(root > rate, root - rate, 1)
        bound = jnp.where(rate > 0, rising, falling)
        at_zero = (value <= 0) & ((value != 0) | (rate != 0) | (later != 0))
        return jnp.where(at_zero, 0, jnp.where(all_of_it, most, bound))

    def unfinished(carry):
        time, step, *_ = carry
        return (time < length) & (step > resolution)

    def advance(carry):
        time, step, *series = carry
        for i in range(len(series) - 1):  # p(step + t), by Horner's rule order after order
            for k in range(len(series) - 2, i - 1, -1):
                series[k] = series[k] + step * series[k + 1]
        time = time + step
        return time, certain(series, length - time), *series

    sign = jnp.where(series[0] < 0, -1, 1).astype(length.dtype)
    series = [sign * c for c in series]
    first = jnp.zeros_like(length), certain(series, length), *series
    return lax.while_loop(unfinished, advance, first)[0]


def order_of(state: PyTree) -> int:
    """Order of the series in a step from a state."""
    return ORDER[jax.tree.leaves(state)[0].dtype]


def step(vector_field: VectorField, state: PyTree, length: Scalar, order: int) -> PyTree:
    """The solution of y' = f(y) a time `length` after `state`, by one Taylor step."""
    series = solution_series(vector_field, state, order)
    return polynomial(series, length)


def polynomial(series: PyTree, t) -> PyTree:
    return jax.tree.map(lambda c: evaluate(c, t), series, is_leaf=is_list)


class TaylorInterpolation(diffrax.AbstractLocalInterpolation):
    """A step's own polynomial."""

    t0: Scalar
    t1: Scalar
    series: PyTree

    def evaluate(self, t0, t1=None, left=True):
        del left
        if t1 is not None:
            return jax.tree.map(lambda a, b: a - b, self.evaluate(t1), self.evaluate(t0))
        return polynomial(self.series, t0 - self.t0)


class Taylor(diffrax.AbstractAdaptiveSolver):
    """Explicit Taylor method for `diffrax.diffeqsolve`, of any order.

    The error estimate is the last term of the series, so adaptive steps keep that term below the
    tolerance. Dense output is the series itself, of the full order. Equations that depend on time
    are taken as they are.
    """

    taylor_order: int = eqx.field(static=True, default=14)

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar = TaylorInterpolation

    def order(self, terms):
        return self.taylor_order

    def error_order(self, terms):
        return self.taylor_order

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump

        def autonomous(state):
            time, y = state
            return jnp.ones_like(time), terms.vf(time, y, args)

        start = (jnp.asarray(t0), y0)
        both = solution_series(autonomous, start, self.taylor_order)
        length, series = jnp.asarray(t1 - t0), both[1]
        power = length**self.taylor_order
        error = jax.tree.map(lambda c: c[-1] * power, series, is_leaf=is_list)
        if switches := switching_series(autonomous, both):
            # A step over a kink has an error that no controller takes; one just behind it has not.
            eps = float(jnp.finfo(length.dtype).eps)
            least = 1e3 * eps * jnp.maximum(step_length(both, eps), jnp.abs(t1))
            over = length > up_to_switches(switches, length, least)
            error = jax.tree.map(lambda e: jnp.where(over, scale_of(both), e), error)
        return (
            polynomial(series, length),
            error,
            dict(series=series),
            None,
            diffrax.RESULTS.successful,
        )


class Step(NamedTuple):
    """One step of a solution."""

    start: PyTree
    """State where it begins."""
    end: PyTree
    """State where it ends."""
    time: Scalar
    """Time at which it begins."""
    length: Scalar
    """Its duration."""
    count: Int[Array, ""]
    """Number of steps taken, this one included."""
    sides: tuple[Bool[Array, ""], Bool[Array, ""]]
    """The sides of the event on which it begins and ends."""


def integrate_until(
    vector_field: VectorField,
    state: PyTree,
    stop: Callable[..., tuple[Bool[Array, ""], Bool[Array, ""]]],
    *,
    tolerance: Real,
    side: Bool[Array, ""] | bool = False,
    others: Sequence[Callable[[PyTree], PyTree]] = (),
    time: Real = 0.0,
    count: Int[Array, ""] | int = 0,
    max_steps: int = MAX_STEPS,
    active: Bool[Array, ""] | bool = True,
) -> Step:
    """Follow y' = f(y) from `state` until `stop` holds for a step's two ends.

    `stop(start, end, side)` is whether it does, and the side of an event on which the end is; the
    side of the start is that of the step before its end. So a step that an event has missed by
    rounding and the next one cannot disagree on where they meet, and miss it both.

    At least one step is taken, unless `active` is false. Steps are as long as `tolerance` allows,
    and end where the field, or one of `others`, has a kink. Returns the last step; `count` reaches
    `max_steps`, or the state stops being finite, where `stop` never holds.
    """
    order = order_of(state)
    stop = fast_sines(stop)

    def advance(carry):
        last, _ = carry
        series, length = taylor_step(vector_field, last.end, order, tolerance, *others)
        end, (_, side) = polynomial(series, length), last.sides
        stops, beyond = stop(last.end, end, side)
        going = jnp.isfinite(length) & (last.count + 1 < max_steps) & ~stops
        time = last.time + last.length
        return Step(last.end, end, time, length, last.count + 1, (side, beyond)), going

    time = jnp.asarray(time, jax.tree.leaves(state)[0].dtype)
    count, side, active = map(jnp.asarray, (count, side, active))
    first = Step(state, state, time, jnp.zeros_like(time), count, (side, side))
    last, _ = lax.while_loop(lambda carry: carry[-1], advance, (first, active))
    return last


def first_rise(
    series: list[Scalar],
    length: Scalar,
    sides: tuple[Bool[Array, ""], Bool[Array, ""]] | None = None,
) -> tuple[Bool[Array, ""], Scalar]:
    """Where a polynomial p(t) rises through zero in a step 0 <= t <= length, if it does.

    The step is short enough for p to have one minimum in it at most. p rises through zero if it
    is not negative at the end, but is at the start or at that minimum. `sides` says whether it is
    negative at start and end, where that has been decided; rounding may have p differ.

    Returns whether it does, and the time (`length` if not). A constant to derivatives.
    """
    series, length = lax.stop_gradient((series, length))

    def derivatives(t):
        value, slope, curvature = series[-1], jnp.zeros_like(t), jnp.zeros_like(t)
        for coefficient in series[-2::-1]:
            curvature = curvature * t + slope
            slope = slope * t + value
            value = value * t + coefficient
        return value, slope, 2 * curvature

    zero = jnp.zeros_like(length)
    end, end_slope, _ = derivatives(length)
    below, ends_below = (series[0] < 0, end < 0) if sides is None else sides
    turns = ~below & (series[1] < 0) & (end_slope > 0)
    turn = rising_root(lambda t: derivatives(t)[1:], zero, jnp.where(turns, length, zero))
    rises = (below | (turns & (derivatives(turn)[0] < 0))) & ~ends_below
    root = rising_root(lambda t: derivatives(t)[:2], jnp.where(rises, turn, length), length)
    return rises, root


class Instant(NamedTuple):
    """When something happens within a step, if it does."""

    exists: Bool[Array, ""]
    time: Scalar


def least(series: list[Scalar], length: Scalar) -> Instant:
    """Where a polynomial that falls at first in a step, and rises at its end, is least.

    A constant to derivatives: to first order the least value does not depend on it.
    """
    series, length = lax.stop_gradient((series, length))
    slope = derivative_of(series)
    curvature = derivative_of(slope)
    exists = (slope[0] < 0) & (evaluate(slope, length) > 0)
    look = lambda t: (evaluate(slope, t), evaluate(curvature, t))
    zero = jnp.zeros_like(length)
    return Instant(exists, rising_root(look, zero, jnp.where(exists, length, zero)))


def derivative_of(series: list[Scalar]) -> list[Scalar]:
    """The coefficients of a polynomial's derivative."""
    return [k * c for k, c in enumerate(series)][1:]


def when_zero(series: list[Scalar], time: Scalar) -> Scalar:
    """The time at which a polynomial is zero, with its derivatives: a step of Newton's."""
    time = lax.stop_gradient(time)
    value, slope = evaluate(series, time), evaluate(derivative_of(series), time)
    slope = lax.stop_gradient(jnp.where(slope == 0, 1.0, slope))
    return time - (value - lax.stop_gradient(value)) / slope


def rising_root(
    function: Callable[[Scalar], tuple[Scalar, Scalar]], low: Scalar, high: Scalar
) -> Scalar:
    """Root of a function that is negative at `low` and not at `high`; either where they are equal.

    Newton's iteration from `high` on (value, slope), kept inside the bracket by halving; every
    turn shrinks the bracket, so it ends.
    """
    resolution = 2 * float(jnp.finfo(high.dtype).eps) * jnp.abs(high)

    def unfinished(carry):
        *_, t, previous = carry
        return jnp.abs(t - previous) > resolution

    def iterate(carry):
        low, high, t, _ = carry
        value, slope = function(t)
        low, high = jnp.where(value < 0, t, low), jnp.where(value < 0, high, t)
        newton = t - value / slope
        inside = ((newton > low) & (newton < high)) | (newton == t)
        return low, high, jnp.where(inside, newton, (low + high) / 2), t

    return lax.while_loop(unfinished, iterate, (low, high, high, low))[2]


def land(
    vector_field: VectorField, event: Callable[[PyTree], Scalar], state: PyTree
) -> tuple[PyTree, Scalar]:
    """The state at which `event` is zero, and the time to it from `state`: the same state, and 0.

    `state` is there to rounding, found for a time that was constant to derivatives. What this
    adds is how state and time depend on everything, to third order: two of Newton's iterations,
    dt = -event / (d event / dt), on a series of as many terms.
    """
    series = solution_series(vector_field, state, 3)
    values = function_series(event, series)
    values[0] -= lax.stop_gradient(values[0])
    slopes = [k * value for k, value in enumerate(values)][1:]
    time = -values[0] / values[1]
    time = time - evaluate(values, time) / evaluate(slopes, time)
    return polynomial(series, time), time
