"""Steps of a Taylor method as turns of a loop that reverse mode transposes.

The length of a step is constant to derivatives, and so it is written on the tape, up to where the
step meets a kink of the equations: that depends on its start.
"""

from collections.abc import Callable
from typing import Any

from jax import lax
from jaxtyping import Array, Int, PyTree

from walker_jax.integrators.integrator import Method, zero_at
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import evaluate_series, solution_series
from walker_jax.integrators.taylor_steps import Taylor, end_at_kink, smooth_step
from walker_jax.kernels.reverse import with_transposed_turns


def transpose_steps(
    method: Method,
    find: Callable[[PyTree, Any], tuple[PyTree, Scalar, Int[Array, ""], Any, list | None]],
    start: PyTree,
) -> tuple[PyTree, Scalar, Any]:
    """Return the state after some steps from `start`, and the time, as reverse mode needs them.

    `find` makes the steps. It returns the state, the time, the number of steps and other results,
    which have no derivatives in reverse mode; and the tapes of a `Writer`, if it is given one, with
    states and times at the starts of steps.
    """
    field = method.field

    def found(carry, writer):
        state, time, steps, others, tapes = find(carry[0], writer)
        return (state, time), steps, others, tapes

    def expand(state):
        assert isinstance(method.solver, Taylor)
        return solution_series(field, state, method.solver.order)

    def decide(carry):
        assert isinstance(method.solver, Taylor)
        about = method.solver.order, method.tolerance, method.watched, method.limits
        return smooth_step(field, carry[0], *about)[1]

    def turn(carry, length):
        state, time = carry
        tolerance = lax.stop_gradient(method.tolerance)
        series, length = end_at_kink(field, expand(state), length, tolerance, *method.others)
        return evaluate_series(series, length), time + length

    (state, time), others = with_transposed_turns(found, decide, turn, (start, zero_at(start)))
    return state, time, others
