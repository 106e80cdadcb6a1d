"""The swing: from a heel strike to the next, or to a fall, and the contact force on the way.

A stride is followed by its contact coordinate h. Whatever ends it shows at the ends of an
integration step: h has risen through zero with the swing leg ahead, or may have in between, the
stance leg has stopped, or is down. Then the step is looked at more closely, through its own
polynomial; where nothing has happened after all, the stride goes on.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from walker_jax.integrators.roots import (
    Instant,
    Jet,
    first_upcrossing,
    interior_minimum,
    negate,
)
from walker_jax.integrators.solvers import MAX_STEPS, Method, Real, solver_for, zero_at
from walker_jax.integrators.taylor import with_fast_sincos
from walker_jax.walkers.masses import MultibodyMotion, SingleSupport
from walker_jax.walkers.model import Phase, Scalar, Walker, is_planar
from walker_jax.walkers.rolling_stance import RollingStance
from walker_jax.walkers.spatial import SpatialWalker
from walker_jax.walking.falls import (
    fall_of,
    has_fallen,
    has_own_falls,
    has_own_is_ahead,
    is_ahead_over_steps,
    watched_falls,
)
from walker_jax.walking.outcomes import Outcome

Condition = Callable[[Any, Any], Scalar]
"""What must not be negative up to heel strike, of a walker or a phase, and its state."""
Broken = dict[int, Bool[Array, ""]]
"""Whether each condition was broken, by the outcome that this has: the lower number first."""


def normal_force(walker: Walker | Phase, state: Any) -> Scalar:
    """Q_v."""
    return walker.contact_force(state)[1]


def conditions_of(walker: Walker | Phase) -> dict[int, Condition]:
    """Its conditions, the contact force among them, by the outcome where one is broken."""
    other = lambda name: lambda walker, state: walker.conditions()[name](state)
    others = {int(Outcome[name]): other(name) for name in walker.conditions()}
    return {int(Outcome.RUNNING): normal_force} | others


def equations(walker: Walker | Phase) -> Callable[[Any], Any]:
    """The equations of motion: the vector field, or virtual power for walkers with masses."""
    moves_by = type(walker).vector_field
    if isinstance(walker, MultibodyMotion) and moves_by is MultibodyMotion.vector_field:
        return SingleSupport(walker)
    if isinstance(walker, SpatialWalker) and moves_by is SpatialWalker.vector_field:
        return RollingStance(walker)
    return walker.vector_field


def swing(
    walker: Walker,
    start: Any,
    verdict: Int[Array, ""],
    tolerance: Real,
    step: Scalar | None = None,
    *,
    to_step: Bool[Array, ""] | bool = True,
    launched: bool = False,
) -> tuple[Any, Scalar, Int[Array, ""], Broken]:
    """Swing the leg until heel strike (`STRIDE`) or a fall; nothing to do unless `UNDECIDED`.

    With a `step`, and `to_step`, until the swing foot comes down, ahead of the other, to ground
    that is higher by so much. A kernel's lanes are in one loop, whichever of the two they need.
    Returns the state just before the impact, its time, the verdict, and which conditions were
    broken before that, its two ends excluded; first, whether the ground would have had to pull at
    the stance foot. A walker that was `launched`, and did not start on the section, is followed to
    the end of its fall.
    """

    def contact(state: Any) -> Scalar:
        if step is None:
            return walker.contact(state)
        above = step - walker.clearance(state)
        return above if to_step is True else jnp.where(to_step, above, walker.contact(state))

    def is_ahead(state: Any) -> Bool[Array, ""]:
        """Whether the swing foot is ahead, so that coming down is heel strike."""
        if step is None:
            return walker.is_ahead(state)
        return jnp.where(to_step, is_ahead_over_steps(walker, state), walker.is_ahead(state))

    def may_end(before: Any, after: Any, below: Bool[Array, ""], ends_below: Bool[Array, ""]):
        """Whether a stride may end in a step, from the two ends of the step alone."""
        first, last = walker.vector_field(before), walker.vector_field(after)
        begins, ends = (  # dh/dt along the motion
            jax.jvp(contact, (state,), (field,))[1]
            for state, field in ((before, first), (after, last))
        )
        rises = ~ends_below & (below | ((begins < 0) & (ends > 0)))
        if may_dip:
            dips = below & ends_below & (begins > 0) & (ends < 0)
            if step is not None:
                # To higher ground, a foot from behind comes down and up again behind: as the legs
                # pass each other, both feet are at one level.
                dips &= is_ahead(before) | jnp.where(to_step, step < 0, True)
            rises |= dips
        # One's own rule may hold within a step alone.
        may = rises if has_own_is_ahead(walker) else rises & (is_ahead(before) | is_ahead(after))
        if may_stop_within(walker):
            may |= (first.thetadot > 0) & (last.thetadot < 0)
        return may | ends_in_fall(after, ends_below)

    def ends_in_fall(state: Any, below: Bool[Array, ""]):
        fallen = has_fallen(walker, state)
        if launched or (step is not None and to_step is True):
            return fallen
        past = ~below & walker.past_contact(state)
        return fallen | (past if step is None else past & ~jnp.asarray(to_step))

    def undecided(carry):
        *_, time, verdict, count, _, _ = carry
        return (verdict == Outcome.UNDECIDED) & (count < MAX_STEPS) & jnp.isfinite(time)

    def follow(carry):
        now, _, time, verdict, count, broken, below = carry

        def stop(before: Any, after: Any, below: Bool[Array, ""]):
            ends_below = contact(after) < 0
            ends = may_end(before, after, below, ends_below)
            for outcome, condition in watched.items():
                ends |= may_break(condition, walker, before, after) & ~broken[outcome]
            return ends, ends_below

        last, steps = method.follow(now, stop, side=below, time=time)
        jet, until = method.jet(contact, last), last.length
        below, ends_below = last.sides
        if may_dip:
            exists, highest = interior_minimum(negate(jet), until)
            until = jnp.where(exists, highest, until)
            ends_below = jnp.where(exists, jet(until)[0] < 0, ends_below)
        rises, time = first_upcrossing(jet, until, (below, ends_below))
        time = jnp.where(rises, method.refine_time(contact, last, time), last.length)
        after = lambda time: method.state_at(last, time)
        arrival, delay = method.refine_event(contact, after(time))
        ahead = is_ahead(arrival) & ~has_fallen(walker, arrival)
        passes = rises & ~ahead  # a foot that comes down behind does not end the stride
        until = jnp.where(passes, last.length, time)
        end = jax.tree.map(lambda a, b: jnp.where(passes, a, b), last.end, arrival)
        for outcome, condition in watched.items():
            more = breaks(condition, walker, last.start, end, after, until)
            ends = passes | ~rises
            more |= ends & with_fast_sincos(partial(is_broken, condition))(walker, end)
            broken = broken | {outcome: broken[outcome] | more}
        fallen = fall_of(walker, last.end)
        fallen = jnp.where(fallen == Outcome.UNDECIDED, Outcome.FORWARD, fallen)
        fallen = jnp.where(
            with_fast_sincos(ends_in_fall)(last.end, last.sides[1]), fallen, Outcome.UNDECIDED
        )
        verdict = jnp.where(rises & ahead, Outcome.STRIDE, fallen)
        if may_stop_within(walker):
            stops = stop_within(method.jet(speed_of, last), time)
            verdict = jnp.where(stops.exists, Outcome.BACKWARD, verdict)
        verdict = verdict.astype(jnp.int8)
        time = jnp.where(verdict == Outcome.STRIDE, time + delay, last.length)
        time = last.time + time
        below = last.sides[1]
        return last.end, arrival, time, verdict, count + steps, broken, below

    # A foot may come down and up again within a step.
    may_dip = step is not None or not walker.foot_stays_down
    watched = conditions_of(walker)
    broken = {outcome: jnp.asarray(False) for outcome in watched}
    if walker.force_least_at_ends:
        del watched[Outcome.RUNNING]
    method = Method(
        equations(walker), solver_for(start), tolerance, (contact, *watched_falls(walker))
    )
    zero = zero_at(start)
    below = jnp.asarray(with_fast_sincos(contact)(start) < 0)
    carry = (start, start, zero, verdict, jnp.asarray(0), broken, below)
    _, arrival, time, verdict, _, broken, _ = lax.while_loop(undecided, follow, carry)
    return arrival, time, verdict, broken


def may_stop_within(walker: Walker) -> bool:
    """Whether the stance leg may stop, and go on, within a step.

    An inverted pendulum does not: where it stops before the top, it goes back.
    """
    usual = is_planar(walker) and not has_own_falls(walker)
    return usual and not walker.inverted_pendulum


def speed_of(state: Any) -> Scalar:
    """The rate of the stance leg."""
    return state.thetadot


def stop_within(speed: Jet, until: Scalar) -> Instant:
    """Where the stance leg is slowest before a time of a step, if it stands or goes back then."""
    slowest = interior_minimum(negate(speed), until)
    return Instant(slowest.exists & (speed(slowest.time)[0] >= 0), slowest.time)


def in_tension(walker: Walker | Phase, state: Any) -> Bool[Array, ""]:
    """Whether the ground would have to pull at the stance foot, Q_v < 0."""
    return is_broken(normal_force, walker, state)


def is_broken(condition: Condition, walker: Walker | Phase, state: Any) -> Bool[Array, ""]:
    walker, state = lax.stop_gradient((walker, state))
    return condition(walker, state) < 0


def broken_at(walker: Walker | Phase, state: Any) -> Broken:
    """Which conditions are broken in a state."""
    each = lambda condition: with_fast_sincos(partial(is_broken, condition))(walker, state)
    return {outcome: each(condition) for outcome, condition in conditions_of(walker).items()}


def with_rate(condition: Condition, walker: Walker | Phase, state: Any) -> tuple[Scalar, Scalar]:
    """The value of a condition, such as Q_v, and its rate along the motion."""
    at = lambda state: condition(walker, state)
    return jax.jvp(at, (state,), (walker.vector_field(state),))


def may_break(
    condition: Condition, walker: Walker | Phase, before: Any, after: Any
) -> Bool[Array, ""]:
    """Whether a condition may be broken by the end of a step, from the two ends alone."""
    walker, before, after = lax.stop_gradient((walker, before, after))
    least = with_rate(condition, walker, before)[1] < 0
    least &= with_rate(condition, walker, after)[1] > 0
    return is_broken(condition, walker, after) | least


def breaks(
    condition: Condition,
    walker: Walker | Phase,
    before: Any,
    after: Any,
    between: Callable[[Scalar], Any],
    time: Scalar,
) -> Bool[Array, ""]:
    """Whether a condition is broken in between two states of a motion, `time` apart."""
    _, least = minimum_of(
        condition, walker, before, after, between, time, resolution=1e-6, above=0.0
    )
    return least < 0


def minimum_of(
    condition: Condition,
    walker: Walker | Phase,
    before: Any,
    after: Any,
    between: Callable[[Scalar], Any],
    time: Scalar,
    *,
    resolution: float,
    above: float = -np.inf,
) -> tuple[Scalar, Scalar]:
    """When a condition's value is least between two states of a motion, `time` apart, and that.

    That is at a root of its rate, bracketed by secants (Illinois), to a part of `time`, or until
    the value is not `above` some number. It is infinite where there is no least one in between.
    The value is right to the square of what the time is right to. Constants to derivatives.
    """
    walker, before, after = lax.stop_gradient((walker, before, after))
    jet = with_fast_sincos(partial(with_rate, condition, walker))
    below, beyond, time = jet(before)[1], jet(after)[1], lax.stop_gradient(time)
    zero = jnp.zeros_like(time)
    resolution = max(resolution, 8 * float(jnp.finfo(time.dtype).eps))  # or it would never end

    def unfinished(carry):
        low, high, *_, least = carry
        return (high - low > resolution * time) & (least > above)

    def narrow(carry):
        low, high, below, beyond, best, least = carry
        t = low + (high - low) * jnp.clip(below / (below - beyond), 0.01, 0.99)
        force, rate = jet(lax.stop_gradient(between(t)))
        falling = rate < 0
        # An end that stays counts half as much the next time.
        return (
            jnp.where(falling, t, low),
            jnp.where(falling, high, t),
            jnp.where(falling, rate, below / 2),
            jnp.where(falling, beyond / 2, rate),
            jnp.where(force < least, t, best),
            jnp.minimum(least, force),
        )

    active = (below < 0) & (beyond > 0)
    high = jnp.where(active, time, zero)
    carry = (zero, high, below, beyond, zero, jnp.full_like(time, jnp.inf))
    *_, best, least = lax.while_loop(unfinished, narrow, carry)
    return best, least


def is_below(walker: Walker, state: Any) -> Bool[Array, ""]:
    """Whether h < 0."""
    return walker.contact(state) < 0
