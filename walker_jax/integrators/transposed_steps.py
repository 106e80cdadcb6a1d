"""Steps of a Taylor method as turns of a loop that reverse mode transposes.

The length of a step is constant to derivatives, unless it ends at a kink of the equations: then the
step is made again, with the derivatives of its length.
"""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Int, PyTree

from walker_jax.integrators.integrator import Memory, Method, zero_at
from walker_jax.integrators.roots import Scalar
from walker_jax.integrators.taylor import evaluate_series, series_of_switches
from walker_jax.kernels.reverse import with_transposed_turns


def transpose_steps(
    method: Method,
    find: Callable[[PyTree], tuple[PyTree, Scalar, Int[Array, ""], Any]],
    start: PyTree,
) -> tuple[PyTree, Scalar, Any]:
    """Return the state after some steps from `start`, and the time, as reverse mode needs them.

    `find` makes the steps. It returns the state, the time, the number of steps and other results,
    which have no derivatives in reverse mode.
    """
    smooth = not has_switches(method, start)

    def found(carry):
        state, time, steps, others = find(carry[0])
        return (state, time), steps, others

    def decide(carry):
        return step(carry[0])[1] if smooth else ()

    def turn(carry, decided):
        (state, time), length = carry, decided
        if smooth:
            return evaluate_series(method.expand(state), length), time + length
        end, length = step(state)
        return end, time + length

    def step(state):
        _, end, length, _ = method.step(state, Memory((), None))
        return end, length

    (state, time), others = with_transposed_turns(found, decide, turn, (start, zero_at(start)))
    return state, time, others


def has_switches(method: Method, state: PyTree) -> bool:
    """Return whether steps may end at kinks."""

    def switches(state):
        series = method.expand(state)
        return [series_of_switches(f, series) for f in (method.field, *method.others)]

    return bool(jax.tree.leaves(jax.eval_shape(switches, state)))
