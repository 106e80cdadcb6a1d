"""Measured modes, whose misses reverse mode transposes step by step.

When a guard or a condition turns, and how long a step is, is constant to derivatives. So it is
written on the tape, or found again; what is transposed is the values at these times.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.hybrid.crossings import Crossing
from walker_jax.hybrid.misses import StepRecord, add_misses
from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import Method
from walker_jax.integrators.taylor import evaluate_series
from walker_jax.kernels.reverse import with_transposed_turns


def carried_of(now: Any) -> PyTree:
    """Return what a measured step begins with: state, time, misses, sides of guards, violations."""
    last = now.last
    return last.end, last.time + last.length, now.misses, last.ends_below, now.violated


def decided_of(found: Any, seen: StepRecord) -> PyTree:
    """Return what is constant to derivatives of a measured step, after it has been searched."""
    return seen.length, seen.until, found.last.ends_below, found.violated


def transpose_measured_steps(
    mode: Mode,
    method: Method,
    find: Callable,
    follow: Callable,
    along: Callable[[PyTree], list],
    begun: Any,
) -> Any:
    """Return a measured mode up to its first event, such that reverse mode transposes its steps.

    **Arguments:**

    - `find`: from a state and a `Writer` to the mode followed to its event, whether it has ended,
      and tapes with what each step begins with and what was decided there.
    - `follow`: from a mode up to some instant to that after one more step, and its `StepRecord`.
    - `along`: from the series of a step to the polynomials of the guards.
    - `begun`: the mode at its start.
    """

    def found(carry, writer):
        now, ended, tapes = find(carry[0], writer)
        end = now.arrival, now.time, now.misses, now.last.ends_below, now.violated
        return end, jnp.where(ended, now.count, 0), now, tapes

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
