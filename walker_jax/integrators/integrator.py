"""The tolerance and the solver of an integration, checked."""

from contextlib import AbstractContextManager, nullcontext

import diffrax
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import PyTree

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.integrators.method import Solver
from walker_jax.integrators.roots import Real
from walker_jax.integrators.taylor_solver import Taylor
from walker_jax.integrators.taylor_steps import series_order
from walker_jax.kernels.primitive import contexts

TOLERANCE = {jnp.dtype("float64"): 1e-12, jnp.dtype("float32"): 1e-6}
"""Default tolerance of a step: 4500 and 8 times the epsilon of the dtype."""


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


AnySolver = diffrax.AbstractSolver
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
