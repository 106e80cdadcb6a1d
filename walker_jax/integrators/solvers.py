"""Integration by diffrax: a solver by Taylor series, and single steps of any method.

`Taylor` is a solver for `diffrax.diffeqsolve`, and `SeriesSteps` the step size controller that
suits it, which never rejects a step. `Method` makes single steps, by these or by one of diffrax's
explicit Runge-Kutta methods; `hybrid.following` has the loop around them.

Nothing here knows what is integrated. Derivatives are taken in forward mode; `kernels.by_kernel`
derives reverse mode from them.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.roots import (
    Scalar,
    derivative_of,
    differentiable_zero,
    first_zero,
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
"""Variables of a state whose series is expanded once more for a step that is searched. To carry the
series of more of them from step to step takes less than that."""
LONGEST_STEP, POLYNOMIAL_STEP = 2.0, 0.25
"""In |y| / |y'|: a longer step is one that the last terms of a series do not limit, as those of a
harmonic motion are at most a third as long; and its length instead, in which functions of a state
that is a polynomial of time seldom turn more than once."""
INTERPOLATION_ORDER = 8
"""Order to which the interpolation of a Runge-Kutta method counts: none of diffrax's has more."""
NODES = (1 - np.cos(np.pi * np.arange(INTERPOLATION_ORDER + 1) / INTERPOLATION_ORDER)) / 2
"""Parts of a step at which such an interpolation is read, to have it as a polynomial."""
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


def zero_at(state: PyTree) -> Scalar:
    """Zero, as a function of a state.

    A loop should start its values from this if they depend on the state in later turns. For a value
    that has no derivative at first, JAX differentiates the whole loop once more.
    """
    return 0 * jnp.sum(jax.tree.leaves(state)[0])


def stop_gradients(tree: PyTree) -> PyTree:
    """A tree with all arrays constant to derivatives."""
    return jax.tree.map(lambda x: lax.stop_gradient(x) if eqx.is_array(x) else x, tree)


def fit_polynomial(length: Scalar, values: Float[Array, " nodes"]) -> list[Scalar]:
    """The polynomial in 0 <= t <= length with these values at `NODES`, which are parts of it."""
    changes, unit, found = values - values[0], jnp.ones_like(length), [values[0]]
    for row in np.linalg.inv(np.vander(NODES, increasing=True))[1:]:
        unit = unit * length
        whole = sum(float(part) * change for part, change in zip(row, changes, strict=True))
        found.append(whole / unit)
    return found


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

    @property
    def by_stages(self) -> Solver:
        """The solver with a loop over stages that has derivatives in forward mode."""
        if not isinstance(self.solver, diffrax.AbstractRungeKutta):
            return self.solver
        absent = lambda x: x is None
        return eqx.tree_at(lambda s: s.scan_kind, self.solver, "lax", is_leaf=absent)

    def controller(self) -> diffrax.AbstractStepSizeController:
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            return SeriesSteps(self.field, order, self.tolerance, self.others)
        return diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance)

    def solve(self, state: PyTree, t0, t1) -> diffrax.Solution:
        """Integrates from `state` at t0 to t1."""
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
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=self.controller(),
            adjoint=diffrax.ForwardMode(),
            max_steps=MAX_STEPS,
            throw=False,
        )

    def carries_series(self, state: PyTree) -> bool:
        """Whether a loop should pass the polynomial of a step on, not compute it again."""
        series = isinstance(self.solver, Taylor)
        return not series or len(jax.tree.leaves(state)) > MOST_EXPANDED_AGAIN

    def first_memory(self, state: PyTree) -> PyTree:
        """The method's own, for the first step."""
        if isinstance(self.solver, Taylor):
            return ()
        zero, terms, controller = zero_at(state), self.terms, self.controller()
        order = self.solver.error_order(terms)
        first = self.by_stages.init(terms, zero, zero + 1, state, None)
        length, kept = controller.init(
            terms, zero, jnp.full_like(zero, jnp.inf), state, None, None, self.solver.func, order
        )
        return length, kept, first

    def step(self, state: PyTree, memory: PyTree) -> tuple[PyTree[list], PyTree, Scalar, PyTree]:
        """One step of the method from a state.

        Returns its polynomial, from its start: the series of the solution, or the interpolation of
        a Runge-Kutta method; its end; its length, zero where the method rejects the step; and what
        the next step takes from this one.
        """
        if isinstance(self.solver, Taylor):
            order = self.solver.taylor_order
            series, length = taylor_step(self.field, state, order, self.tolerance, *self.others)
            return series, evaluate_series(series, length), length, ()
        length, kept, first = memory
        zero, terms, controller = jnp.zeros_like(length), self.terms, self.controller()
        end, error, dense, last, _ = self.by_stages.step(
            terms, zero, length, state, None, first, False
        )
        order: Any = self.solver.error_order(terms)
        good, begins, ends, _, kept, _ = controller.adapt_step_size(
            zero, length, state, end, None, error, order, kept
        )
        inside = self.solver.interpolation_cls(t0=zero, t1=length, **dense).evaluate
        series = jax.tree.map(partial(fit_polynomial, length), jax.vmap(inside)(length * NODES))
        keep = lambda new, old: jax.tree.map(partial(jnp.where, good), new, old)
        memory = ends - begins, kept, keep(last, first)
        return series, keep(end, state), jnp.where(good, length, 0), memory

    def series_of(self, state: PyTree) -> PyTree[list]:
        """The series of the solution from a state, of a Taylor method."""
        assert isinstance(self.solver, Taylor)
        return solution_series(self.field, state, self.solver.taylor_order)

    def no_series(self, state: PyTree) -> PyTree[list]:
        """A polynomial with as many coefficients as those of steps."""
        solver = self.solver
        order = solver.taylor_order if isinstance(solver, Taylor) else INTERPOLATION_ORDER
        return jax.tree.map(lambda x: [x, *[0 * x] * order], state)

    def state_at(self, state: PyTree, series: PyTree[list], time: Scalar) -> PyTree:
        """The state a time after the start of a step, by its series or by a shorter step."""
        if isinstance(self.solver, Taylor):
            return evaluate_series(series, time)
        zero, solver = jnp.zeros_like(time), self.by_stages
        first = solver.init(self.terms, zero, time, state, None)
        return solver.step(self.terms, zero, time, state, None, first, False)[0]

    def refine_time(
        self, event: Callable[[PyTree], Scalar], state: PyTree, series: PyTree[list], time: Scalar
    ) -> Scalar:
        """Refines the time from the start of a step to an event; constant to derivatives.

        The interpolation of a Runge-Kutta method is less accurate than its steps. So each of
        Newton's iterations takes a step to the latest time. A series needs no refinement.
        """
        if isinstance(self.solver, Taylor):
            return time
        method, state, time = stop_gradients((self, state, time))
        for _ in range(TIME_REFINEMENTS):
            there = method.state_at(state, series, time)
            value, rate = jax.jvp(event, (there,), (method.field(there),))
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
