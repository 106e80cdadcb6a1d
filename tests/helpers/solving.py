"""Solutions of equations of motion at one time, by diffrax's own loop and the package's steps."""

import diffrax
import equinox as eqx

from walker_jax.integrators.closures import convert_closure
from walker_jax.integrators.integrator import MOST_STEPS
from walker_jax.integrators.power_balance import PowerBalance
from walker_jax.integrators.taylor_steps import Taylor


def solve(method, state, time):
    """Integrate from a state by a Taylor method for a time."""
    apart = lambda f: f if isinstance(f, PowerBalance) else convert_closure(f, state)
    method = eqx.tree_at(lambda method: method.field, method, apart(method.field))
    return diffrax.diffeqsolve(
        diffrax.ODETerm(convert_closure(method.terms.vector_field, 0 * time, state, None)),
        Taylor(method.solver.taylor_order, method.field),
        0 * time,
        time,
        None,
        state,
        saveat=diffrax.SaveAt(t1=True),
        stepsize_controller=method.controller(),
        adjoint=diffrax.ForwardMode(),
        max_steps=MOST_STEPS,
        throw=False,
    )
