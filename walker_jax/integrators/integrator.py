"""The tolerance and the solver of an integration, checked."""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.method import Method, Solver
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.integrators.taylor import VectorField
from walker_jax.integrators.taylor_solver import Taylor
from walker_jax.integrators.taylor_steps import series_order

AnySolver = diffrax.AbstractSolver

TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
"""Default tolerance of a step: 4500 and 8 times the epsilon of the dtype."""


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
        return Integrator(jnp.asarray(self.tolerance, dtype), self.solver)

    def method(
        self,
        field: VectorField,
        state: PyTree,
        *others: Callable[[PyTree], PyTree],
        watched: tuple[Callable[[PyTree], Scalar], ...] = (),
    ) -> Method:
        """Return the method that integrates y' = f(y) from a state."""
        solver = self.solver or Taylor(series_order(state))
        return Method(field, solver, self.tolerance, others, watched)


def integrator_of(
    dtype, tolerance: Real | None = None, solver: AnySolver | None = None
) -> Integrator:
    """Return the integrator of a checked tolerance and solver, or of the defaults of a dtype.

    Raises `WrongUse` for a solver that is neither a `Taylor` nor an explicit Runge-Kutta method.
    """
    tolerance = default_tolerance(dtype, tolerance)
    tolerance = tolerance if isinstance(tolerance, Tracer) else float(tolerance)
    if solver is None:
        return Integrator(tolerance)
    explicit = isinstance(solver, (diffrax.AbstractERK, Taylor))
    if not (explicit and isinstance(solver, diffrax.AbstractAdaptiveSolver)):
        raise WrongUse(
            "solver must be an explicit Runge-Kutta method of diffrax that estimates its error, "
            f"such as diffrax.Dopri8(), or a Taylor, not {short(solver)}"
        )
    return Integrator(tolerance, solver)
