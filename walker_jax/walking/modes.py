"""The modes of a stride: its phases and, last, the swing.

This file puts the hooks of a walker in the form of a hybrid system, once for all functions that
follow a stride. The swing ends at heel strike, where the contact coordinate rises through zero
with the swing leg ahead, or in a fall. A phase ends with its event, in a fall, or where the swing
foot comes down in front, if it must not.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from walker_jax.hybrid.modes import Condition, Foregone, Function, Guard, Mode
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.method import Method
from walker_jax.integrators.taylor import VectorField
from walker_jax.walkers.masses import MultibodyMotion, SingleSupport
from walker_jax.walkers.model import Phase, Scalar, Walker, is_planar
from walker_jax.walkers.rolling_stance import RollingStance
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walking.falls import has_own_falls, makes_step, overrides
from walker_jax.walking.outcomes import Outcome


def equations(walker: Walker | Phase) -> VectorField:
    """The equations of motion: the vector field, or virtual power for walkers with masses."""
    moves_by = type(walker).vector_field
    if isinstance(walker, MultibodyMotion) and moves_by is MultibodyMotion.vector_field:
        return SingleSupport(walker)
    if isinstance(walker, SpatialWalker) and moves_by is SpatialWalker.vector_field:
        return RollingStance(walker)
    return walker.vector_field


def method_of(mode: Mode, start: Any, integrator: Integrator) -> Method:
    """The method by which a mode is integrated: its steps end at kinks of guards too."""
    kinked = [function for guard in mode.functions() for function in guard]
    return integrator.method(mode.field, start, *kinked)


def conditions_of(walker: Walker | Phase) -> dict[int, Function]:
    """Its conditions, the contact force Q_v among them, by the outcome where one is violated."""
    others = {int(Outcome[name]): one for name, one in walker.conditions().items()}
    return {int(Outcome.RUNNING): lambda state: walker.contact_force(state)[1]} | others


def in_tension(walker: Walker | Phase, state: Any) -> Bool[Array, ""]:
    """Whether the ground would have to pull at the stance foot, Q_v < 0."""
    return lax.stop_gradient(walker.contact_force(state)[1]) < 0


def fall_guards(walker: Walker, state: Any, *, persist: bool = False) -> tuple[Guard, ...]:
    """The falls of a walker; whether it is known that they persist within a step."""
    value = lambda name: lambda state: walker.falls(state)[name]
    guards = []
    for name in jax.eval_shape(walker.falls, state):
        guard = Guard(value(name), Outcome[name], persists=persist)
        if name == "BACKWARD" and is_planar(walker):
            guard = guard._replace(measure=lambda speed: speed**2 / 2)  # smooth at a dead point
        guards.append(guard)
    return tuple(guards)


def swing_mode(
    walker: Walker,
    state: Any,
    step: Scalar | None = None,
    *,
    to_step: Bool[Array, ""] | bool = True,
    launched: bool = False,
) -> Mode:
    """The swing, to heel strike or a fall.

    With a `step`, and `to_step`, to where the swing foot comes down, ahead of the other, on ground
    that is higher by so much. Both cases share one loop, which keeps the lanes of a kernel
    together. A walker that was `launched`, and did not start on the section, is followed to the end
    of its fall.
    """
    ahead = walker.is_ahead
    strike = Guard(walker.contact, Outcome.STRIDE, (ahead,), persists=walker.foot_stays_down)
    foregone = Foregone(
        lambda state: (walker.contact(state) > 0) & walker.past_contact(state), Outcome.FORWARD
    )
    if step is not None:
        above = lambda state: step - walker.clearance(state)
        choose = lambda one, other: lambda state: jnp.where(to_step, one(state), other(state))
        value = above if to_step is True else choose(above, walker.contact)
        admits = ahead_on_steps(walker)
        if to_step is not True:
            admits = tuple(choose(one, ahead) for one in admits)
        strike = Guard(value, Outcome.STRIDE, admits)
        given_up = foregone.holds
        foregone = Foregone(lambda state: ~jnp.asarray(to_step) & given_up(state), Outcome.FORWARD)
    spared = not launched and (step is None or to_step is not True)
    scuffs = isinstance(walker, SpatialWalker) and not overrides(walker, "conditions")
    touches = scuffs and not launched, scuffs
    conditions = tuple(
        Condition(one, of, walker.force_least_at_ends)
        if of == Outcome.RUNNING
        else Condition(one, of, zero_at_ends=touches)
        for of, one in conditions_of(walker).items()
    )
    # An inverted pendulum that stops goes back, and its leg goes one way until then.
    persist = walker.inverted_pendulum and not has_own_falls(walker)
    guards = (*fall_guards(walker, state, persist=persist), strike)
    field = equations(walker)
    return Mode(field, walker.vector_field, guards, conditions, foregone if spared else None)


def ahead_on_steps(walker: Walker) -> tuple[Function, ...]:
    """Functions that are positive where the swing foot is ahead, of feet at different heights.

    The swing leg has passed the other; a rule of a walker's own holds too.
    """
    passed = lambda state: -state.phi
    return (passed, walker.is_ahead) if overrides(walker, "is_ahead") else (passed,)


def phase_mode(phase: Phase, state: Any, step: Scalar | None = None) -> Mode:
    """A phase, to its event (`STRIDE`), a fall, or a foot that comes down on a bent knee.

    Where it may not, the foot comes down on ground that is higher by `step`.
    """
    event = Guard(phase.event, Outcome.STRIDE)
    conditions = tuple(Condition(one, of) for of, one in conditions_of(phase).items())
    guards = (*fall_guards(phase.walker, state), *landing_guards(phase, state, step), event)
    return Mode(equations(phase), phase.vector_field, guards, conditions)


def landing_guards(phase: Phase, state: Any, step: Scalar | None) -> tuple[Guard, ...]:
    """The end of a phase in which the swing foot must not come down in front, if it must not."""
    if phase.clearance(state) is None:
        return ()

    def below(state: Any) -> Scalar:
        above = phase.clearance(state)
        assert above is not None
        return -above if step is None else step - above

    return (Guard(below, Outcome.BENT_KNEE, (phase.walker.is_ahead,), (phase.reach,)),)


def starts_under(
    phase: Phase | Walker, state: Any, ground: Scalar | float = 0.0
) -> Bool[Array, ""]:
    """Whether the swing foot is below the ground, of some height."""
    above = phase.clearance(state)
    return jnp.asarray(False) if above is None else above < ground


def in_front(phase: Phase, state: Any) -> Bool[Array, ""]:
    """Whether a foot that comes down would take a step: in front, before the walker has fallen."""
    return makes_step(phase.walker, state) & (phase.reach(state) > 0)
