"""Modes of a stride on ground that is higher or lower than the standing foot."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from walker_jax.hybrid.modes import Guard, Mode
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.phase import is_of_package

ROUNDING = 100
"""Largest height of a step that counts as level, over the spacing of floating-point numbers at
1."""
NEVER = -1e6
"""Value of what never admits a guard, so far below zero that it is no miss."""
LOWER = "below the level"
"""The mode of a swing foot that has passed the level of the other foot, to lower ground."""


def raise_ground(walker: Any, modes: Mapping[str, Mode], step: Scalar) -> dict[str, Mode]:
    """Return the modes of a planar walker's stride to ground that is higher by `step`.

    A foot that goes below the ground has passed its level first, ahead of the other: the legs may
    pass each other below the level, and that is no heel strike. So the swing leads to heel strike
    on level or higher ground, or to a further swing that leads to heel strike on lower ground. On a
    step the foot is ahead once it has passed the other leg; a walker's own rule holds too.
    """
    *phases, last = modes
    swing = modes[last]
    *falls, strike = swing.guards
    # A step within rounding counts as level: its foot may be there already, or have been there as
    # the legs passed each other.
    rounding = ROUNDING * jnp.finfo(jnp.result_type(step)).eps
    up, down = step > rounding, step < -rounding
    above = lambda state: step - walker.clearance(state)
    passed = lambda state: -state.phi
    own = not is_of_package(type(walker), "is_ahead")
    ahead = (passed, walker.is_ahead) if own else (passed,)
    choose = lambda one, other: lambda state: jnp.where(up, one(state), other(state))
    unless_down = lambda one: lambda state: jnp.where(down, NEVER, one(state))
    if_down = lambda one: lambda state: jnp.where(down, one(state), NEVER)

    # As a knee locks the foot may be below the level already; it must have passed the leg then.
    passes_by = (if_down(passed), walker.is_ahead) if phases else (if_down(walker.is_ahead),)
    passes = Guard(strike.value, LOWER, passes_by)
    admits = tuple(unless_down(choose(one, walker.is_ahead)) for one in ahead)
    value = choose(above, strike.value)
    onto = strike._replace(value=value, admits=admits, persists=False, surface=above)
    lower = strike._replace(value=above, admits=ahead, persists=False)
    raised = {name: keep_above(modes[name], step) for name in phases}
    raised[last] = swing._replace(guards=(*falls, passes, onto))
    return raised | {LOWER: swing._replace(guards=(*falls, lower), early_exit=None)}


def keep_above(mode: Mode, step: Scalar) -> Mode:
    """Return a phase whose swing foot must not come down on ground that is higher by `step`."""
    above = lambda guard: lambda state: step + guard.value(state)
    raised = [
        guard._replace(value=above(guard)) if guard.leads_to == Outcome.BENT_KNEE.name else guard
        for guard in mode.guards
    ]
    return mode._replace(guards=tuple(raised))
