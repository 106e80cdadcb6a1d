"""Modes whose steps reverse mode transposes as the turns of a loop.

The length of a step is constant to derivatives, up to where it meets a kink of the equations, which
depends on its start; and so is when a guard or a condition turns. These are written on the tape, or
found again; what is transposed is the values at these times.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from walker_jax.hybrid.crossings import Crossing
from walker_jax.hybrid.misses import StepRecord, add_misses
from walker_jax.hybrid.modes import Mode, has_ended
from walker_jax.integrators.integrator import Method, zero_at
from walker_jax.integrators.taylor import evaluate_series, solution_series
from walker_jax.integrators.taylor_steps import end_at_kink, smooth_step
from walker_jax.kernels.reverse import with_transposed_turns


def find_in_reverse(
    mode: Mode, find: Callable, start: Any, method: Method
) -> tuple[Any, Callable[[Any], Any]]:
    """Find the first event so that reverse mode transposes the steps before it.

    Returns the mode as it begins its last step, and a function from there to the event.
    """
    solver: Any = method.solver

    def found(carry, writer):
        last, tapes = find(carry[0], writer=writer)
        steps = jnp.where(has_ended(mode, last.guard), jnp.maximum(last.count - 1, 0), 0)
        return (last.last.start, last.last.time), steps, last, tapes

    def decide(carry):
        about = solver.order, method.tolerance, method.watched, method.limits
        return smooth_step(method.field, carry[0], *about)[1]

    def turn(carry, length):
        (state, time), tolerance = carry, lax.stop_gradient(method.tolerance)
        series = solution_series(method.field, state, solver.order)
        series, length = end_at_kink(method.field, series, length, tolerance, *method.others)
        return evaluate_series(series, length), time + length

    (state, time), last = with_transposed_turns(found, decide, turn, (start, zero_at(start)))
    until = last.time - last.last.time
    go_on = lambda state: method.state_at(state, method.expand(state), until)
    return last._replace(arrival=state, time=time + until), go_on


def carried_of(now: Any) -> PyTree:
    """Return what a measured step begins with: state, time, misses, sides of guards, violations."""
    last = now.last
    return last.end, last.time + last.length, now.misses, last.ends_below, now.violated


def decided_of(found: Any, seen: StepRecord) -> PyTree:
    """Return what is constant to derivatives of a measured step, after it has been searched."""
    return seen.length, seen.until, found.last.ends_below, found.violated


def find_measured_in_reverse(
    mode: Mode,
    method: Method,
    find: Callable,
    follow: Callable,
    along: Callable[[PyTree], list],
    begun: Any,
) -> Any:
    """Find the first event, and the misses before it, so that reverse mode transposes all steps.

    **Arguments:**

    - `find`: from a state and a `Writer` to the mode followed to its event, and tapes with what
      each step begins with and what was decided there.
    - `follow`: from a mode up to some instant to that after one more step, and its `StepRecord`.
    - `along`: from the series of a step to the polynomials of the guards.
    - `begun`: the mode at its start.
    """

    def found(carry, writer):
        now, tapes = find(carry[0], writer=writer)
        end = now.arrival, now.time, now.misses, now.last.ends_below, now.violated
        return end, jnp.where(has_ended(mode, now.guard), now.count, 0), now, tapes

    def decide(carry):
        state, time, misses, below, violated = carry
        last = begun.last._replace(end=state, time=time, ends_below=below)
        return decided_of(*follow(begun._replace(last=last, misses=misses, violated=violated)))

    def turn(carry, decided):
        (state, time, misses, below, violated), (length, until, ends, after) = carry, decided
        series = method.expand(state)
        arrival = evaluate_series(series, until)
        sides = zip(along(series), below, ends, strict=True)
        crossings = [Crossing(*one, *both) for one, *both in sides]
        seen = StepRecord(state, series, length, arrival, until, crossings, violated)
        return arrival, time + until, add_misses(mode, misses, seen), ends, after

    end, now = with_transposed_turns(found, decide, turn, carried_of(begun))
    return now._replace(arrival=end[0], time=end[1], misses=end[2])
