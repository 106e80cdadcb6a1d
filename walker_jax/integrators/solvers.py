"""Integration by diffrax: a solver by Taylor series, integration up to a condition, and landing.

`Taylor` is a solver for `diffrax.diffeqsolve`, and `SeriesSteps` the step size controller that
suits it, which needs no steps to be rejected. `Method` follows a solution until a condition holds
for the two ends of a step, by these or by an explicit Runge-Kutta method of diffrax's.

Nothing here knows what is integrated. Derivatives are forward mode; `kernels.by_kernel`
makes those of reverse mode of them.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.roots import (
    Look,
    derivative_of,
    first_zero,
    of_function,
    of_polynomial,
    when_zero,
)
from walker_jax.integrators.series import evaluate
from walker_jax.integrators.taylor import (
    fast_sines,
    function_series,
    is_list,
    solution_series,
    switching_series,
)
from walker_jax.kernels.primitive import contexts

Scalar = Float[Array, ""]
Real = Scalar | float
VectorField = Callable[[PyTree], PyTree]


# Order of the series. Higher orders take fewer steps of more work each; these are the fastest, or
# nearly, at the default tolerances (benchmarks/README.md).
ORDER = {jnp.dtype("float64"): 12, jnp.dtype("float32"): 8}
TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
MAX_STEPS = 1000
SHARPENINGS = 3
"""Of a time that an interpolation gives: its error is squared by each."""


def default_tolerance(dtype, tolerance: Real | None = None) -> Real:
    """The tolerance given, or the default of a dtype.

    It must lie between a quarter of the dtype's rounding error, below which no step can be told
    from a shorter one, and 1. One that JAX traces is not checked.
    """
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


def order_of(state: PyTree) -> int:
    """Order of the series in a step from a state."""
    return ORDER[jax.tree.leaves(state)[0].dtype]


AnySolver = diffrax.AbstractSolver
Solver = diffrax.AbstractAdaptiveSolver
solver_in_use = jax.make_user_context(None)
contexts.append(solver_in_use)


def solved_by(solver: AnySolver | None) -> AbstractContextManager:
    """Let strides be followed by a solver meanwhile; None leaves it as it is. Refuses most."""
    if solver is None:
        return nullcontext()
    explicit = isinstance(solver, (diffrax.AbstractERK, Taylor))
    if not (explicit and isinstance(solver, diffrax.AbstractAdaptiveSolver)):
        raise WrongUse(
            "solver must be an explicit Runge-Kutta method of diffrax that estimates its error, "
            f"such as diffrax.Dopri8(), or a Taylor, not {short(solver)}"
        )
    return solver_in_use(solver)


def solver_for(state: PyTree) -> Solver:
    """The solver in use: unless one is given, a series of the order that suits the dtype."""
    return solver_in_use.value or Taylor(order_of(state))


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
    field: VectorField | None = None
    """f, where it depends on the state alone. Then it may be a `VirtualPower`."""

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

    def expand(self, terms, t0, y0, args) -> tuple[PyTree[list], list[list[Scalar]]]:
        """The series of the solution from a state, and that of its switching functions."""
        if self.field is not None:
            series = solution_series(self.field, y0, self.taylor_order)
            return series, switching_series(self.field, series)

        def autonomous(state):
            time, y = state
            return jnp.ones_like(time), terms.vf(time, y, args)

        both = solution_series(autonomous, (jnp.asarray(t0), y0), self.taylor_order)
        return both[1], switching_series(autonomous, both)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump
        series, switches = self.expand(terms, t0, y0, args)
        length = jnp.asarray(t1 - t0)
        power = length**self.taylor_order
        error = jax.tree.map(lambda c: c[-1] * power, series, is_leaf=is_list)
        if switches:
            # A step over a kink has an error that no controller takes; one just behind it has not.
            eps = float(jnp.finfo(length.dtype).eps)
            least = 1e3 * eps * jnp.maximum(step_length(series, eps), jnp.abs(t1))
            over = length > up_to_switches(switches, length, least)
            error = jax.tree.map(lambda e: jnp.where(over, scale_of(series), e), error)
        return (
            polynomial(series, length),
            error,
            dict(series=series),
            None,
            diffrax.RESULTS.successful,
        )


class SeriesSteps(diffrax.AbstractStepSizeController):
    """Steps as long as the series of the solution allows: none is rejected.

    They are those of `taylor_step`, which has the arguments' meaning.
    """

    field: VectorField
    order: int = eqx.field(static=True)
    tolerance: Real
    others: tuple[Callable[[PyTree], PyTree], ...] = ()

    def wrap(self, direction):
        return self

    def longest(self, state: PyTree) -> Scalar:
        return taylor_step(self.field, state, self.order, self.tolerance, *self.others)[1]

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        return t0 + self.longest(y0), None

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        following = t1 + self.longest(y1_candidate)
        return jnp.array(True), t1, following, False, None, diffrax.RESULTS.successful


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
    sides: tuple[Bool[Array, ""], Bool[Array, ""]]
    """The sides of the event on which it begins and ends."""
    series: PyTree[list] | None = None
    """The solution's from where it begins, if that is how it was solved."""


class Until(diffrax.AbstractStepSizeController):
    """Another controller's steps, until a condition holds for the two ends of one.

    `stop(start, end, side)` is whether it does, and the side of an event on which the end is; the
    side of the start is that of the step before its end. So a step that an event has missed by
    rounding and the next one cannot disagree on where they meet, and miss it both. An
    `diffrax.Event` sees the end alone.
    """

    controller: diffrax.AbstractStepSizeController
    stop: Callable[..., tuple[Bool[Array, ""], Bool[Array, ""]]]
    side: Bool[Array, ""]

    def wrap(self, direction):
        return Until(self.controller.wrap(direction), self.stop, self.side)

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        end, state = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        start, none = jnp.asarray(t0), jnp.zeros_like(t0)
        return end, (state, Step(y0, y0, start, none, (self.side, self.side)))

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        state, last = controller_state
        adapted = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, state
        )
        kept, following, end, made_jump, state, result = adapted
        stops, side = self.stop(y0, y1_candidate, last.sides[1])
        start, length = jnp.asarray(t0), jnp.asarray(t1 - t0)
        step = Step(y0, y1_candidate, start, length, (last.sides[1], side))
        last = jax.tree.map(lambda new, old: jnp.where(kept, new, old), step, last)
        stopped = diffrax.RESULTS.where(
            kept & stops, diffrax.RESULTS.event_occurred, diffrax.RESULTS.successful
        )
        result = diffrax.RESULTS.where(result == diffrax.RESULTS.successful, stopped, result)
        return kept, following, end, made_jump, (state, last), result


def zero_at(state: PyTree) -> Scalar:
    """Zero, as a function of a state.

    What a loop starts from, where it will come to depend on the state: JAX differentiates a loop
    anew for each value of which it finds only then that it has derivatives.
    """
    return 0 * jnp.sum(jax.tree.leaves(state)[0])


def fixed(tree: PyTree) -> PyTree:
    """The same, with all arrays as constants to derivatives."""
    return jax.tree.map(lambda x: lax.stop_gradient(x) if eqx.is_array(x) else x, tree)


class Method(eqx.Module):
    """How equations y' = f(y) are solved: a solver of diffrax's, and its tolerance."""

    field: VectorField
    solver: Solver
    tolerance: Real
    others: tuple[Callable[[PyTree], PyTree], ...] = ()
    """Functions of the state at whose kinks steps of the Taylor solver end, as at the field's."""

    @property
    def terms(self):
        field = self.field if isinstance(self.solver, Taylor) else fast_sines(self.field)
        return diffrax.ODETerm(lambda t, y, args: field(y))

    def controller(self) -> diffrax.AbstractStepSizeController:
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            return SeriesSteps(self.field, order, self.tolerance, self.others)
        return diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance)

    def solve(self, state: PyTree, t0, t1, controller, **saved) -> diffrax.Solution:
        """From `state` at t0 to t1, or until the controller ends it."""
        solver = self.solver
        if isinstance(solver, Taylor):
            solver = Taylor(solver.taylor_order, self.field)
        return diffrax.diffeqsolve(
            self.terms,
            solver,
            t0,
            t1,
            None,
            state,
            saveat=diffrax.SaveAt(t1=True, **saved),
            stepsize_controller=controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_STEPS,
            throw=False,
        )

    def follow(
        self,
        state: PyTree,
        stop: Callable[..., tuple[Bool[Array, ""], Bool[Array, ""]]],
        *,
        side: Bool[Array, ""] | bool = False,
        time: Real = 0.0,
    ) -> tuple[Step, Int[Array, ""]]:
        """The first step for whose two ends `stop` holds (`Until`), and how many there were.

        At least one is taken, `MAX_STEPS` at most. The state stops being finite where the field
        jumps, or `stop` holds for none.
        """
        time, side = time + zero_at(state), jnp.asarray(side)
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            return self.follow_series(state, fast_sines(stop), side, time, order)
        controller = Until(self.controller(), fast_sines(stop), side)
        end = jnp.full_like(time, jnp.inf)
        solution = self.solve(state, time, end, controller, controller_state=True)
        assert solution.controller_state is not None
        _, last = solution.controller_state
        return last, solution.stats["num_steps"]

    def follow_series(
        self, state: PyTree, stop: Callable, side: Bool[Array, ""], time: Scalar, order: int
    ) -> tuple[Step, Int[Array, ""]]:
        """The same with the steps of a series, by a loop that expands it once in each.

        A step size controller of diffrax's has to know the next step when one ends, and so the next
        series: then each is carried on to the next turn, which takes longer.
        """

        def advance(carry):
            last, count, _ = carry
            series, length = taylor_step(self.field, last.end, order, self.tolerance, *self.others)
            end, (_, side) = polynomial(series, length), last.sides
            stops, beyond = stop(last.end, end, side)
            going = jnp.isfinite(length) & (count + 1 < MAX_STEPS) & ~stops
            step = Step(last.end, end, last.time + last.length, length, (side, beyond))
            return step, count + 1, going

        first = Step(state, state, time, zero_at(state), (side, side))
        carry = first, jnp.asarray(0), jnp.asarray(True)
        last, count, _ = lax.while_loop(lambda carry: carry[-1], advance, carry)
        return last._replace(series=solution_series(self.field, last.start, order)), count

    def begin(self, state: PyTree, length: Scalar) -> tuple[PyTree, Callable[[Scalar], PyTree]]:
        """A Runge-Kutta step of some length: its end, and the solver's interpolation."""
        zero, solver = jnp.zeros_like(length), self.solver
        if isinstance(solver, diffrax.AbstractRungeKutta):  # one that has derivatives forward
            solver = eqx.tree_at(lambda s: s.scan_kind, solver, "lax", is_leaf=lambda x: x is None)
        first = solver.init(self.terms, zero, length, state, None)
        end, _, dense, _, _ = solver.step(self.terms, zero, length, state, None, first, False)
        return end, solver.interpolation_cls(t0=zero, t1=length, **dense).evaluate

    def within(self, step: Step, time: Scalar) -> PyTree:
        """The state a time after a step began, by one step."""
        if step.series is not None:
            return polynomial(step.series, time)
        return self.begin(step.start, time)[0]

    def look(self, function: Callable[[PyTree], Scalar], step: Step) -> Look:
        """A function of the state along a step. A constant to derivatives."""
        method, step = fixed((self, step))
        if step.series is not None:
            return of_polynomial(function_series(function, step.series))
        _, inside = method.begin(step.start, step.length)
        return of_function(lambda t: function(inside(t)))

    def sharpened(self, event: Callable[[PyTree], Scalar], step: Step, time: Scalar) -> Scalar:
        """When an event is zero in a step, given that by interpolation. A constant to derivatives.

        An interpolation is less exact than the steps that it is made of, but for a series: Newton's
        iteration goes on, with a step of its own to each time.
        """
        if isinstance(self.solver, Taylor):
            return time
        method, step, time = fixed((self, step, time))
        for _ in range(SHARPENINGS):
            state = method.within(step, time)
            value, rate = jax.jvp(event, (state,), (method.field(state),))
            time = time - value / rate
        return time

    def series(self, function: Callable, state: PyTree, order: int) -> PyTree[list]:
        """Taylor coefficients of function(y(t)) along the solution y from a state."""
        if isinstance(self.solver, Taylor):
            return function_series(function, solution_series(self.field, state, order))
        values = []
        for k in range(order + 1):
            value = jax.tree.map(lambda x, k=k: x / math.factorial(k), function(state))
            values.append(value)
            along = lambda state, last=function: jax.jvp(last, (state,), (self.field(state),))[1]
            function = along
        return jax.tree.map(lambda *coefficients: list(coefficients), *values)

    def land(self, event: Callable[[PyTree], Scalar], state: PyTree) -> tuple[PyTree, Scalar]:
        """The state at which `event` is zero, and the time to it from `state`: that state, and 0.

        `state` is there to rounding, found for a time that was constant to derivatives. What this
        adds is how state and time depend on everything, to third order: two of Newton's
        iterations, dt = -event / (d event / dt), on a series of as many terms.
        """
        values = self.series(event, state, 3)
        values[0] -= lax.stop_gradient(values[0])
        slopes = derivative_of(values)
        time = -values[0] / values[1]
        time = time - evaluate(values, time) / evaluate(slopes, time)
        return polynomial(self.series(lambda state: state, state, 3), time), time
