"""Integration by diffrax: a solver by Taylor series, and integration up to an event.

`Taylor` is a solver for `diffrax.diffeqsolve`, and `SeriesSteps` the step size controller that
suits it, which never rejects a step. `Method` integrates until a condition holds for the two ends
of a step, by these or by one of diffrax's explicit Runge-Kutta methods.

Nothing here knows what is integrated. Derivatives are taken in forward mode; `kernels.by_kernel`
derives reverse mode from them.
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
from jaxtyping import Array, Bool, Int, PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.roots import (
    Jet,
    Scalar,
    derivative_of,
    differentiable_zero,
    first_zero,
    function_jet,
    polynomial_jet,
)
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.taylor import (
    function_series,
    is_list,
    solution_series,
    switching_series,
    with_fast_sincos,
)
from walker_jax.kernels.primitive import contexts

Real = Scalar | float
VectorField = Callable[[PyTree], PyTree]


SERIES_ORDER = {jnp.dtype("float64"): 12, jnp.dtype("float32"): 8}
"""Order of the series: the fastest, or nearly, at the default tolerance (benchmarks/README.md).

A higher order takes fewer steps of more work each.
"""
TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
"""Default tolerance of a step: 4500 and 8 times the epsilon of the dtype."""
MAX_STEPS = 1000
"""Most steps of one integration, so that each ends."""
MOST_EXPANDED_AGAIN = 6
"""Variables of a state whose series is expanded once more for the last step of an integration. To
carry the series of more of them from step to step takes less than that."""
LONGEST_STEP, POLYNOMIAL_STEP = 2.0, 0.25
"""In |y| / |y'|: a longer step is one that the last terms of a series do not limit, as those of a
harmonic motion are at most a third as long; and its length instead, in which functions of a state
that is a polynomial of time seldom turn more than once."""
TIME_REFINEMENTS = 3
"""Newton's iterations on a time that interpolation gives; each squares its error."""


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
    variables (Jorba and Zou 2005), where |y| is the larger of |c_0| and |c_1|. The last terms of a
    polynomial of time vanish, such as those of ballistic flight or of a clock, and all terms at
    rest. So h is finite wherever the solution is: `POLYNOMIAL_STEP` |y| / |c_1| where it would be
    more than `LONGEST_STEP` |y| / |c_1|, and |c_1| counts as at least the rounding of |y|. It needs
    few digits, and powers are cheap in float32.
    """
    leaves = jax.tree.leaves(series, is_leaf=is_list)
    order, scale = len(leaves[0]) - 1, scale_of(series)
    log_tolerance = jnp.log(jnp.asarray(tolerance, jnp.float32))

    def part(k):
        return (largest_coefficient(series, k) / scale).astype(jnp.float32)

    def log_length(k):
        return (log_tolerance - jnp.log(part(k))) / k

    shortest = jnp.exp(jnp.minimum(log_length(order - 1), log_length(order)))
    unit = 1 / jnp.maximum(part(1), float(jnp.finfo(scale.dtype).eps))
    shortest = jnp.where(shortest > LONGEST_STEP * unit, POLYNOMIAL_STEP * unit, shortest)
    return shortest.astype(leaves[0][0].dtype)


def scale_of(series: PyTree) -> Scalar:
    """The larger of |y| and |y'| at the start of a step; above zero also at rest at y = 0."""
    scale = jnp.maximum(largest_coefficient(series, 0), largest_coefficient(series, 1))
    return jnp.maximum(scale, float(jnp.finfo(scale.dtype).tiny) ** 0.5)


def largest_coefficient(series: PyTree, k: int) -> Scalar:
    """The largest absolute value of all variables' k-th coefficients; constant to derivatives."""
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
    """The series of the solution of y' = f(y) from a state, and the length of its step.

    At that length the last terms of the series reach the tolerance. If f, or one of the others, has
    a kink before, the step ends just behind the kink, by `tolerance` times the length. The length
    is NaN if f jumps by more than the root of the tolerance, relative to |y| or |y'|.
    """
    series = solution_series(vector_field, state, order)
    length = step_length(series, tolerance)
    if not (switches := [s for f in (vector_field, *others) for s in switching_series(f, series)]):
        return series, length
    least = jnp.asarray(tolerance, length.dtype) * length
    length = cut_at_switches(switches, length, least)
    constant, end = lax.stop_gradient((series, length))
    rates = vector_field(evaluate_series(constant, end))
    expected = jax.tree.map(
        lambda c: evaluate_polynomial(derivative_of(c), end), constant, is_leaf=is_list
    )
    defects = jax.tree.map(lambda a, b: jnp.max(jnp.abs(a - b)), rates, expected)
    defect = jnp.max(jnp.stack(jax.tree.leaves(defects)))
    steady = defect <= jnp.sqrt(jnp.asarray(tolerance, length.dtype)) * scale_of(series)
    return series, jnp.where(steady, length, jnp.nan)


def cut_at_switches(switches: list[list[Scalar]], length: Scalar, behind: Scalar) -> Scalar:
    """Cuts a step just behind the first zero of functions given by their series.

    The length keeps the derivatives of that zero, since second derivatives depend on where a step
    ends at a kink.
    """
    for switch in switches:
        zero = first_zero(lax.stop_gradient(switch), lax.stop_gradient(length), behind)
        length = jnp.where(
            zero + behind < length, differentiable_zero(switch, zero) + behind, length
        )
    return length


def series_order(state: PyTree) -> int:
    """Order of the series in a step from a state."""
    return SERIES_ORDER[jax.tree.leaves(state)[0].dtype]


AnySolver = diffrax.AbstractSolver
Solver = diffrax.AbstractAdaptiveSolver
solver_in_use = jax.make_user_context(None)
contexts.append(solver_in_use)


def using_solver(solver: AnySolver | None) -> AbstractContextManager:
    """Makes `Method` use a solver inside a `with` block; None changes nothing.

    Raises `WrongUse` for a solver that is neither a `Taylor` nor an explicit Runge-Kutta method.
    """
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
    """The solver in use; by default `Taylor`, of the order that suits the dtype."""
    return solver_in_use.value or Taylor(series_order(state))


def evaluate_series(series: PyTree, t) -> PyTree:
    return jax.tree.map(lambda c: evaluate_polynomial(c, t), series, is_leaf=is_list)


class TaylorInterpolation(diffrax.AbstractLocalInterpolation):
    """A step's own polynomial."""

    t0: Scalar
    t1: Scalar
    series: PyTree

    def evaluate(self, t0, t1=None, left=True):
        del left
        if t1 is not None:
            return jax.tree.map(lambda a, b: a - b, self.evaluate(t1), self.evaluate(t0))
        return evaluate_series(self.series, t0 - self.t0)


class Taylor(diffrax.AbstractAdaptiveSolver):
    """Explicit Taylor method for `diffrax.diffeqsolve`, of any order.

    The error estimate is the last term of the series, so adaptive steps keep that term below the
    tolerance. Dense output is the series itself, of the full order. Equations may depend on time.
    """

    taylor_order: int = eqx.field(static=True, default=SERIES_ORDER[jnp.dtype("float64")])
    field: VectorField | None = None
    """f, if it depends on the state alone; then it may be a `PowerBalance`."""

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
            # A step over a kink gets an error that every controller rejects; a step to just behind
            # it does not.
            eps = float(jnp.finfo(length.dtype).eps)
            least = 1e3 * eps * jnp.maximum(step_length(series, eps), jnp.abs(t1))
            over = length > cut_at_switches(switches, length, least)
            error = jax.tree.map(lambda e: jnp.where(over, scale_of(series), e), error)
        return (
            evaluate_series(series, length),
            error,
            dict(series=series),
            None,
            diffrax.RESULTS.successful,
        )


class SeriesSteps(diffrax.AbstractStepSizeController):
    """Steps as long as the series of the solution allows, so that none is rejected.

    The steps and the arguments are those of `taylor_step`.
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
    """State at its start."""
    end: PyTree
    """State at its end."""
    time: Scalar
    """Time at its start."""
    length: Scalar
    """Its duration."""
    sides: tuple[Bool[Array, "*events"], Bool[Array, "*events"]]
    """The side of the event, or of each of several, at its start and at its end."""
    series: PyTree[list] | None = None
    """The series of the solution from its start, if a series solved it."""


class Until(diffrax.AbstractStepSizeController):
    """The steps of another controller, until a condition holds for the two ends of a step.

    `stop(start, end, side)` returns whether the condition holds, and the side of the event on which
    the end lies; `side` is that of the start, which the step before has returned. So two successive
    steps always agree on the side of the state between them, and no event falls between the two by
    rounding. A `diffrax.Event` sees the end of a step alone.
    """

    controller: diffrax.AbstractStepSizeController
    stop: Callable[..., tuple[Bool[Array, ""], Bool[Array, "*events"]]]
    side: Bool[Array, "*events"]

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

    A loop should start its values from this if they depend on the state in later turns. For a value
    that has no derivative at first, JAX differentiates the whole loop once more.
    """
    return 0 * jnp.sum(jax.tree.leaves(state)[0])


def stop_gradients(tree: PyTree) -> PyTree:
    """A tree with all arrays constant to derivatives."""
    return jax.tree.map(lambda x: lax.stop_gradient(x) if eqx.is_array(x) else x, tree)


class Method(eqx.Module):
    """Equations y' = f(y), with the diffrax solver and the tolerance that solve them."""

    field: VectorField
    solver: Solver
    tolerance: Real
    others: tuple[Callable[[PyTree], PyTree], ...] = ()
    """Functions of the state; the Taylor solver ends steps at their kinks, as at those of f."""

    @property
    def terms(self):
        field = self.field if isinstance(self.solver, Taylor) else with_fast_sincos(self.field)
        return diffrax.ODETerm(lambda t, y, args: field(y))

    def controller(self) -> diffrax.AbstractStepSizeController:
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            return SeriesSteps(self.field, order, self.tolerance, self.others)
        return diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance)

    def solve(self, state: PyTree, t0, t1, controller, **saved) -> diffrax.Solution:
        """Integrates from `state` at t0 to t1, or until the controller stops."""
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
        stop: Callable[..., tuple[Bool[Array, ""], Bool[Array, "*events"]]],
        *,
        side: Bool[Array, "*events"] | bool = False,
        time: Real = 0.0,
    ) -> tuple[Step, Int[Array, ""]]:
        """The first step for whose two ends `stop` holds (`Until`), and the number of steps.

        There are at least one and at most `MAX_STEPS` steps, in which `stop` need not hold. The end
        is not finite if the field jumps.
        """
        time, side = time + zero_at(state), jnp.asarray(side)
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            return self.follow_taylor(state, with_fast_sincos(stop), side, time, order)
        controller = Until(self.controller(), with_fast_sincos(stop), side)
        end = jnp.full_like(time, jnp.inf)
        solution = self.solve(state, time, end, controller, controller_state=True)
        assert solution.controller_state is not None
        _, last = solution.controller_state
        return last, solution.stats["num_steps"]

    def follow_taylor(
        self, state: PyTree, stop: Callable, side: Bool[Array, "*events"], time: Scalar, order: int
    ) -> tuple[Step, Int[Array, ""]]:
        """`follow` for the Taylor solver, by a loop that expands one series in each step.

        A step size controller of diffrax has to return the length of the next step when one ends,
        which needs the next series; to carry that to the next turn takes longer.
        """

        carried = len(jax.tree.leaves(state)) > MOST_EXPANDED_AGAIN

        def advance(carry):
            last, count, _ = carry
            series, length = taylor_step(self.field, last.end, order, self.tolerance, *self.others)
            end, (_, side) = evaluate_series(series, length), last.sides
            stops, beyond = stop(last.end, end, side)
            going = jnp.isfinite(length) & (count + 1 < MAX_STEPS) & ~stops
            step = Step(last.end, end, last.time + last.length, length, (side, beyond))
            return step._replace(series=series if carried else None), count + 1, going

        first = Step(state, state, time, zero_at(state), (side, side))
        if carried:
            constant = jax.tree.map(lambda x: [x, *[0 * x] * order], state)
            first = first._replace(series=constant)
        carry = first, jnp.asarray(0), jnp.asarray(True)
        last, count, _ = lax.while_loop(lambda carry: carry[-1], advance, carry)
        if carried:
            return last, count
        return last._replace(series=solution_series(self.field, last.start, order)), count

    def runge_kutta_step(
        self, state: PyTree, length: Scalar
    ) -> tuple[PyTree, Callable[[Scalar], PyTree]]:
        """One Runge-Kutta step of a given length: its end, and the solver's interpolation."""
        zero, solver = jnp.zeros_like(length), self.solver
        if isinstance(solver, diffrax.AbstractRungeKutta):  # "lax" has derivatives in forward mode
            solver = eqx.tree_at(lambda s: s.scan_kind, solver, "lax", is_leaf=lambda x: x is None)
        first = solver.init(self.terms, zero, length, state, None)
        end, _, dense, _, _ = solver.step(self.terms, zero, length, state, None, first, False)
        return end, solver.interpolation_cls(t0=zero, t1=length, **dense).evaluate

    def state_at(self, step: Step, time: Scalar) -> PyTree:
        """The state at a time after the start of a step, by its series or by one shorter step."""
        if step.series is not None:
            return evaluate_series(step.series, time)
        return self.runge_kutta_step(step.start, time)[0]

    def jet(self, function: Callable[[PyTree], Scalar], step: Step) -> Jet:
        """A function of the state, as a function of time in a step; constant to derivatives."""
        method, step = stop_gradients((self, step))
        if step.series is not None:
            return polynomial_jet(function_series(function, step.series))
        _, inside = method.runge_kutta_step(step.start, step.length)
        return function_jet(lambda t: function(inside(t)))

    def refine_time(self, event: Callable[[PyTree], Scalar], step: Step, time: Scalar) -> Scalar:
        """Refines the time of an event in a step by Newton's iteration; constant to derivatives.

        The interpolation of a Runge-Kutta method is less accurate than its steps. So each iteration
        takes a step to the latest time. A series needs no refinement.
        """
        if isinstance(self.solver, Taylor):
            return time
        method, step, time = stop_gradients((self, step, time))
        for _ in range(TIME_REFINEMENTS):
            state = method.state_at(step, time)
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

    def refine_event(
        self, event: Callable[[PyTree], Scalar], state: PyTree
    ) -> tuple[PyTree, Scalar]:
        """The state at which `event` is zero, and the time to it, with their derivatives.

        `state` is that state to rounding, at a time that is constant to derivatives, so the values
        returned are `state` and 0. Two of Newton's iterations, dt = -event / (d event / dt), on a
        series of third order make their derivatives exact to third order.
        """
        values = self.series(event, state, 3)
        values[0] -= lax.stop_gradient(values[0])
        slopes = derivative_of(values)
        time = -values[0] / values[1]
        time = time - evaluate_polynomial(values, time) / evaluate_polynomial(slopes, time)
        return evaluate_series(self.series(lambda state: state, state, 3), time), time
