"""Strides made one after another, the loop under every walk."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from walker_jax.kernels.primitive import vary_together
from walker_jax.systems.outcomes import Outcome, Stride


class Walked(NamedTuple):
    """A walk so far: arrays of JAX or of NumPy, over many walks too."""

    state: Any
    """Start of the next stride, NaN after a failure; or any tree that strides carry on."""
    outcome: Int[Any, "*walks"]
    """`Outcome` of the last stride; `STRIDE` if none was made."""
    strides: Int[Any, "*walks"]
    """Number of completed strides."""


def scan_strides(
    step: Callable[[Any, Int[Array, ""]], Stride],
    start: Any,
    most: int | Int[Array, ""],
    stop: Callable[[Walked], Bool[Array, ""]] | None = None,
    record: Callable[[Stride], Any] | None = None,
) -> tuple[Walked, Any]:
    """Make strides one after another, until one fails, `stop(walk)` is true, or there are `most`.

    **Arguments:**

    - `step`: makes a stride from a state; it is also given the stride's number, from 0 on. The
      result holds the outcome and the next state.
    - `start`: the first state.
    - `most`: an int, or traced.
    - `stop`: asked before each stride.
    - `record`: function of a stride, whose values are kept. All `most` strides are then made, an
      int: the walk keeps the outcome of its first failure, and counts no later stride. Without
      it there are no derivatives in reverse mode.

    **Returns** the walk and, along a first axis, the values of `record`.
    """

    def going(walk: Walked) -> Bool[Array, ""]:
        more = (walk.outcome == Outcome.STRIDE) & (walk.strides < most)
        return more if stop is None else more & ~stop(walk)

    def advance(walk: Walked) -> Walked:
        made = step(walk.state, walk.strides)
        return Walked(made.state, made.outcome, walk.strides + 1)

    none = jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.zeros((), jnp.int32)
    begun = vary_together(Walked(start, *none))
    if record is None:
        end = lax.while_loop(going, advance, begun)
        failed = (end.outcome != Outcome.STRIDE).astype(jnp.int32)
        return end._replace(strides=end.strides - failed), None

    def advance_and_record(walk: Walked, number: Int[Array, ""]) -> tuple[Walked, Any]:
        made = step(walk.state, number)
        fate = jnp.where(walk.outcome == Outcome.STRIDE, made.outcome, walk.outcome)
        count = walk.strides + (fate == Outcome.STRIDE).astype(jnp.int32)
        return Walked(made.state, fate, count), record(made._replace(outcome=fate))

    return lax.scan(advance_and_record, begun, jnp.arange(most, dtype=jnp.int32))
