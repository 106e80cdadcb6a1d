"""Integration of equations of motion: its checked settings, and single steps of any method.

A method is a Taylor series, or a Runge-Kutta method of diffrax. The loop around its steps
is in `hybrid.following`.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.arrivals import arrive
from walker_jax.integrators.closures import convert_closure
from walker_jax.integrators.expansion import with_fast_sincos, without_derivatives
from walker_jax.integrators.integrals import beside, motion_of
from walker_jax.integrators.own_sizes import proportional_variables
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.integrators.runge_kutta_steps import (
    controller_of,
    defect_of,
    derivative_error,
    expansion_errors,
    in_units_of,
    interpolate,
    twist_of,
    units_of,
)
from walker_jax.integrators.step_lengths import NO_LIMITS, StepLimits
from walker_jax.integrators.taylor import (
    VectorField,
    evaluate_series,
    function_series,
    is_absent,
    solution_series,
)
from walker_jax.integrators.taylor_steps import (
    SERIES_ORDER,
    Taylor,
    end_at_kink,
    smooth_step,
    usable_series,
)

if TYPE_CHECKING:
    import diffrax

    AnySolver = diffrax.AbstractSolver | Taylor
    Solver = diffrax.AbstractAdaptiveSolver | Taylor
else:  # what other processes have traced needs no diffrax, which takes a quarter second to load
    AnySolver = Solver = Any

TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
"""Default tolerance of a step: 4500 and 8 times the epsilon of the dtype."""
MOST_STEPS = 1_000_000
"""Default of the most steps of a mode, so that it always ends. A return of a Rikitake dynamo may
take thousands of turns, as it leaves a fixed point with imaginary eigenvalues by a power of time:
of 1600 starts 5 % make more than 1000 steps at first, 0.5 % more than 10,000, and 0.1 % more than
100,000 in 500 returns. A mode without end takes a tenth of a second for every eight cells."""
MOST_EXPANDED_AGAIN = 5
"""Most variables of a state whose series is expanded again for the search within a step. For more
variables, and where an expansion takes long, as that of a `PowerBalance` does, it is cheaper to
carry the series from step to step."""


def default_tolerance(dtype, tolerance: Real | None = None) -> Real:
    """Return the given tolerance, or the default of a dtype.

    It must lie between a quarter of the dtype's rounding error and 1. Below that, rounding hides
    the difference between a step and a shorter one. A traced tolerance is not checked.
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


class Integrator(eqx.Module):
    """The settings of integration: the tolerance of a step, and the solver."""

    tolerance: Real
    solver: Solver | None = eqx.field(static=True, default=None)
    """A method of diffrax, or `Taylor`; None for `Taylor` of the order that suits the dtype."""

    def in_dtype(self, dtype) -> "Integrator":
        """Return the same settings, with the tolerance as an array."""
        known = self.tolerance
        if isinstance(known, np.ndarray) and known.dtype == dtype:
            return self
        # Of NumPy where it can be: JAX takes longer to make one number than a kernel to make some
        # strides.
        as_array: Any = jnp.asarray if isinstance(known, Tracer) else np.asarray
        return Integrator(as_array(known, dtype), self.solver)

    def method(
        self,
        field: VectorField,
        state: PyTree,
        *others: Callable[[PyTree], PyTree],
        watched: tuple[Callable[[PyTree], Scalar], ...] = (),
        conditions: tuple[Callable[[PyTree], Scalar], ...] = (),
        limits: StepLimits = NO_LIMITS,
    ) -> "Method":
        """Return the method that integrates y' = f(y) from a state."""
        solver = self.solver or Taylor(SERIES_ORDER[jax.tree.leaves(state)[0].dtype])
        if limits.scales is None:
            limits = limits._replace(proportional=proportional_variables(*motion_of(field, state)))
        # It has no effect to differentiate; the length of an exact step has no derivative by it.
        tolerance = lax.stop_gradient(self.tolerance)
        return Method(field, solver, tolerance, others, watched, conditions, limits)


def integrator_of(
    dtype, tolerance: Real | None = None, solver: AnySolver | None = None
) -> Integrator:
    """Return the integrator of a checked tolerance and solver, or of the defaults of a dtype.

    Raises `WrongUse` for a solver that is neither a `Taylor` nor a Runge-Kutta method whose stages
    are explicit or solved one by one (ESDIRK).
    """
    tolerance = default_tolerance(dtype, tolerance)
    tolerance = tolerance if isinstance(tolerance, Tracer) else float(tolerance)
    if solver is None:
        return Integrator(tolerance)
    import diffrax

    runge_kutta = isinstance(solver, (diffrax.AbstractERK, diffrax.AbstractESDIRK))
    estimates_errors = isinstance(solver, diffrax.AbstractAdaptiveSolver)
    if not isinstance(solver, Taylor) and not (runge_kutta and estimates_errors):
        raise WrongUse(
            "solver must be a Runge-Kutta method of diffrax that estimates its error, such as "
            "diffrax.Dopri8() or, for stiff equations, diffrax.Kvaerno5(), or a Taylor, "
            f"not {short(solver)}"
        )
    return Integrator(tolerance, solver)


def zero_at(state: PyTree) -> Scalar:
    """Return zero, as a function of a state.

    The values of a loop should start from this zero if they depend on the state in later turns. If
    a value has no derivative at first, JAX differentiates the whole loop once more.
    """
    return 0 * jnp.sum(jax.tree.leaves(state)[0])


def stop_gradients(tree: PyTree) -> PyTree:
    """Return a tree in which all arrays are constant to derivatives."""
    return jax.tree.map(lambda x: lax.stop_gradient(x) if eqx.is_array(x) else x, tree)


class Memory(NamedTuple):
    """The memory of a method between one step and the next."""

    control: PyTree
    """The length of the next step, and what the controller and the solver keep; of a Taylor method,
    nothing, or in reverse mode the length of the last step, if it met no kink."""
    series: PyTree
    """The polynomial of the step, where expanding it again costs more than carrying it; else
    None."""


class Method(eqx.Module):
    """Equations y' = f(y), with the diffrax solver and the tolerance of their solution."""

    field: VectorField
    solver: Solver
    tolerance: Real
    others: tuple[Callable[[PyTree], PyTree], ...] = ()
    """Functions of the state; the Taylor solver ends steps at their kinks, as at those of f, and
    their polynomials limit the steps of Runge-Kutta methods."""
    watched: tuple[Callable[[PyTree], Scalar], ...] = ()
    """Functions of the state whose series limit the steps as the solution's series does."""
    conditions: tuple[Callable[[PyTree], Scalar], ...] = ()
    """Functions of the state of which Runge-Kutta steps have one extremum at most."""
    limits: StepLimits = NO_LIMITS

    @property
    def terms(self):
        import diffrax

        field = with_fast_sincos(self.field)
        return diffrax.ODETerm(lambda t, y, args: field(y))

    @property
    def is_series(self) -> bool:
        """Return whether the polynomial of a step is the series of the solution."""
        return isinstance(self.solver, Taylor)

    @property
    def forward_solver(self) -> Any:
        """Return a Runge-Kutta method with a loop over stages that supports forward mode."""
        solver = eqx.tree_at(lambda s: s.scan_kind, self.solver, "lax", is_leaf=is_absent)
        finder: Any = getattr(solver, "root_finder", None)
        if finder is None or isinstance(finder.rtol, float):
            return solver
        import optimistix

        # Implicit stages are solved to the tolerance; diffrax sets it in `diffeqsolve` only.
        where = lambda s: (s.root_finder.rtol, s.root_finder.atol, s.root_finder.norm)
        return eqx.tree_at(where, solver, (self.tolerance, self.tolerance, optimistix.max_norm))

    def in_reverse(self) -> "Method":
        """Return the method whose steps reverse mode transposes."""
        return eqx.tree_at(lambda one: one.limits.in_reverse, self, True)

    def begin(self, state: PyTree) -> Memory:
        """Return the memory for the first step, of the same types as those after steps."""
        solver, control, series = self.solver, (), None
        carries = len(jax.tree.leaves(state)) > MOST_EXPANDED_AGAIN
        if isinstance(solver, Taylor):
            order = solver.order
            carries |= isinstance(self.field, PowerBalance)
            control = zero_at(state) if self.limits.in_reverse else ()
        else:
            carries, order = True, SERIES_ORDER[jax.tree.leaves(state)[0].dtype]
            zero, terms = zero_at(state), self.terms
            controller = controller_of(self.tolerance, self.limits.longest)
            first = self.forward_solver.init(terms, zero, zero + 1, state, None)
            about = state, None, None, solver.func, solver.error_order(terms)
            length, kept = controller.init(terms, zero, jnp.full_like(zero, jnp.inf), *about)
            control = length, kept, first
        if carries:
            series = jax.tree.map(lambda x: [x, *[0 * x] * order], state)
        return Memory(control, series)

    def step(self, state: PyTree, memory: Memory) -> tuple[PyTree[list], PyTree, Scalar, Memory]:
        """Make one step of the method from a state.

        Returns the polynomial of the step, from its start (the series of the solution, or the
        interpolation of a Runge-Kutta method); its end; its length, zero if the method rejects the
        step; and the memory for the next step.
        """
        if isinstance(self.solver, Taylor):
            about = self.tolerance, self.watched, self.limits
            series, smooth = smooth_step(self.field, state, self.solver.order, *about)
            series, length = end_at_kink(self.field, series, smooth, self.tolerance, *self.others)
            kept = None if memory.series is None else series
            control = smooth if self.limits.in_reverse else ()
            return series, evaluate_series(series, length), length, Memory(control, kept)
        length, kept, first = memory.control
        zero, terms = jnp.zeros_like(length), self.terms
        controller = controller_of(self.tolerance, self.limits.longest)
        end, error, dense, last, _ = self.forward_solver.step(
            terms, zero, length, state, None, first, False
        )
        series = interpolate(self.solver, length, dense, SERIES_ORDER[length.dtype])
        order: Any = self.solver.error_order(terms)
        both, errors = self.with_errors_within(state, end, error, series, length)
        good, begins, ends, _, kept, _ = controller.adapt_step_size(
            zero, length, *both, None, errors, order, kept
        )
        keep = lambda new, old: jax.tree.map(partial(jnp.where, good), new, old)
        control = ends - begins, kept, keep(last, first)
        return series, keep(end, state), jnp.where(good, length, 0), Memory(control, series)

    def with_errors_within(
        self, state, end, error, series, length
    ) -> tuple[tuple[PyTree, PyTree], PyTree]:
        """Return both ends of a step, and its errors, for the controller.

        Errors of the interpolation and of derivatives are among them; no number means infinite.
        """
        of_derivatives = derivative_error((error, state, end))
        method, state, end, error, series = stop_gradients((self, state, end, error, series))
        scaled = partial(in_units_of, beside(method.field, units_of(method.limits), state, 0.0))
        defect = defect_of(method.field, series, length)
        error = jax.tree.map(lambda a, b: jnp.maximum(jnp.abs(a), b), error, defect)
        others = expansion_errors(method.others, series, length)
        others += [method.tolerance * twist_of(one, series, length) for one in method.conditions]
        others = lax.stop_gradient([*others, of_derivatives])
        none = [jnp.zeros_like(one) for one in others]
        finite = lambda x: jnp.where(jnp.isfinite(x), x, jnp.inf)
        both = (scaled(state), none), (scaled(end), none)
        return both, jax.tree.map(finite, (scaled(error), others))

    def series_of(self, state: PyTree, memory: Memory) -> PyTree[list]:
        """Return the polynomial of the step from a state, given the memory that the step left."""
        return self.expand(state) if memory.series is None else memory.series

    def expand(self, state: PyTree) -> PyTree[list]:
        """Return the series of the solution from a state, for a Taylor method."""
        assert isinstance(self.solver, Taylor)
        series = solution_series(self.field, state, self.solver.order)
        return usable_series(self.field, series)

    def state_at(self, state: PyTree, series: PyTree[list], time: Scalar) -> PyTree:
        """Return the state at a time after the start of a step, by its series or a shorter step."""
        if isinstance(self.solver, Taylor):
            return evaluate_series(series, time)
        zero, solver = jnp.zeros_like(time), self.forward_solver
        first = solver.init(self.terms, zero, time, state, None)
        return solver.step(self.terms, zero, time, state, None, first, False)[0]

    def refine_time(
        self,
        event: Callable[[PyTree], Scalar],
        state: PyTree,
        series: PyTree[list],
        time: Scalar,
        length: Scalar,
    ) -> Scalar:
        """Refine the time from the start of a step to an event; constant to derivatives.

        The interpolation of a Runge-Kutta method is less accurate than its steps. So each Newton
        iteration takes a step to the latest time, as long as corrections at least halve. The time
        is NaN if the event is not zero then, within the tolerance. A series needs no refinement.
        """
        if isinstance(self.solver, Taylor):
            return time
        method, state, time, length = stop_gradients((self, state, time, length))
        along = lambda state: jax.jvp(event, (state,), (method.field(state),))
        value_and_rate = without_derivatives(along, state)

        def unfinished(carry):
            turn, _, change, most, _ = carry
            return (turn == 0) | ((change != 0) & (jnp.abs(change) <= most))

        def iterate(carry):
            turn, time, change, most, _ = carry
            time = time + change
            value, rate = value_and_rate(method.state_at(state, series, time))
            zero = jnp.abs(value) <= method.tolerance * (1 + jnp.abs(rate) * length)
            most = jnp.where(turn == 0, most, jnp.abs(change) / 2)
            return turn + 1, time, -value / rate, most, zero

        begun = jnp.asarray(0), time, jnp.zeros_like(time), length / 2, jnp.asarray(False)
        _, time, *_, zero = lax.while_loop(unfinished, iterate, lax.stop_gradient(begun))
        return jnp.where(zero, time, jnp.nan)

    def series(self, function: Callable, state: PyTree, order: int) -> PyTree[list]:
        """Return the Taylor coefficients of function(y(t)) along the solution y from a state.

        They are constant to derivatives by the state, and by parameters that the equations hold.
        The function is evaluated in the same way for all methods: only so it is zero for all of
        them, or for none, in a state where it is zero to rounding.
        """
        method, state = stop_gradients((self, state))
        if isinstance(method.solver, Taylor):
            known = solution_series(method.field, state, order)
            return function_series(function, usable_series(method.field, known))
        known, along = [state], lambda state: state
        for k in range(1, order + 1):
            along = lambda state, last=along: jax.jvp(last, (state,), (method.field(state),))[1]
            known.append(jax.tree.map(lambda x, k=k: x / math.factorial(k), along(state)))
        return function_series(function, jax.tree.map(lambda *one: [*one], *known))

    def refine_event(
        self, event: Callable[[PyTree], Scalar], state: PyTree
    ) -> tuple[PyTree, Scalar]:
        """Return the state at which `event` is zero, and the time to it, with all derivatives.

        `state` is already that state to rounding, at a time that is constant to derivatives, so the
        returned values are `state` and 0.
        """

        def rates(state):  # of the structure and the types of the state, as tangents must be
            leaves, structure = jax.tree.flatten(state)
            pairs = zip(jax.tree.leaves(self.field(state)), leaves, strict=True)
            return jax.tree.unflatten(structure, [jnp.asarray(r, x.dtype) for r, x in pairs])

        convert = lambda function: convert_closure(with_fast_sincos(function), state)
        field, event = convert(rates), convert(event)
        return arrive(event, field, state)
