"""Modes of a stride on ground higher or lower than the standing foot."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse, check_number, short
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Scalar, Walker
from walker_jax.walkers.phase import is_of_package


def raise_ground(mode: Mode, step: Scalar) -> Mode:
    """Return a phase whose swing foot must not come down on ground that is higher by `step`."""
    above = lambda guard: lambda state: step + guard.value(state)
    raised = [
        guard._replace(value=above(guard)) if guard.leads_to == Outcome.BENT_KNEE.name else guard
        for guard in mode.guards
    ]
    return mode._replace(guards=tuple(raised))


def onto_step(
    walker: Walker, swing: Mode, step: Scalar, to_step: Bool[Array, ""] | None = None
) -> Mode:
    """Return the swing up to the foot's contact, ahead of the other, on ground higher by `step`.

    If not `to_step`, it is the swing as it is. Both cases share one loop, which keeps the lanes of
    a kernel together. On a step the foot is ahead once it has passed the other leg; a walker's own
    rule holds too. The guard of the contact has neither reset nor what must hold after it.
    """
    *others, strike = swing.guards
    above = lambda state: step - walker.clearance(state)
    passed = lambda state: -state.phi
    own = not is_of_package(type(walker), "is_ahead")
    admits = (passed, walker.is_ahead) if own else (passed,)
    if to_step is None:
        onto = Guard(above, SECTION, admits)
        return swing._replace(guards=(*others, onto), foregone=None)
    choose = lambda one, other: lambda state: jnp.where(to_step, one(state), other(state))
    admits = tuple(choose(one, walker.is_ahead) for one in admits)
    onto = Guard(choose(above, strike.value), SECTION, admits)
    foregone = swing.foregone
    if foregone is not None:  # a foot does not come up again to a higher step either
        holds, sinks = foregone.holds, ~to_step | (step > 0)
        foregone = foregone._replace(holds=lambda state: sinks & holds(state))
    return swing._replace(guards=(*others, onto), foregone=foregone)


def height_of_step(step: Any, dtype) -> Float[Array, ""]:
    """Return a step's height, checked."""
    if not isinstance(step, Tracer):
        check_number("step", step)
        if not abs(step) <= np.finfo(float).max:
            raise WrongUse(f"step must be one finite number, not {short(step)}")
    return jnp.asarray(step, dtype)
