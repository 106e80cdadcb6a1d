"""A mode that is followed step by step, by the search that decides a stride, for `explanation`."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from walker_jax.hybrid.following import (
    NO_GUARD,
    Unfinished,
    begin_following,
    follow_measured,
    integrate_mode,
)
from walker_jax.hybrid.graphs import suit_state
from walker_jax.hybrid.misses import turns_in_step
from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import Integrator, Method
from walker_jax.integrators.roots import Scalar
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.walking.guards import method_of, number_due
from walker_jax.walking.stride import modes_from
from walker_jax.walking.undecided import steps_ran_out, why_it_stops

MOST_STUCK = 100
"""A mode is given up after so many steps without length, which are those that a solver rejects."""
MOST_RECORDED = 10_000
"""Most steps of a mode that are recorded one by one; then only its end is found. To record a step
takes a thousand times as long as to make it."""
ROUNDING = 1e-9
"""Part of a step within which two guards rise at once."""


class Rise(NamedTuple):
    """A guard that rose through zero."""

    mode: str
    guard: int
    leads_to: str
    """The name of a mode, the section, or a failure."""
    time: float
    """Time since the start of the mode."""
    admitted: bool
    """Whether it counted; the first admitted rise ends the mode."""


class ModeStart(eqx.Module):
    """The start of a mode, and all that its compiled programs depend on."""

    system: HybridSystem
    x: Any
    """The point where the stride starts."""
    state: Any
    integrator: Integrator
    name: str = eqx.field(static=True)
    switched: bool = eqx.field(static=True)
    """Whether another mode led to it."""

    def begin(self) -> tuple[Mode, Method, Unfinished]:
        """Return the mode, measured, with its method, and its first instant."""
        mode = modes_from(self.system, self.x)[self.name]._replace(early_exit=None)
        mode = suit_state(self.name, mode, self.state)
        method = method_of(mode, self.state, jax.tree.map(jnp.asarray, self.integrator))
        mode, begun = begin_following(mode, self.state, jnp.asarray(True), method, measured=True)
        return mode, method, begun


@kernel
def begin_mode(start: ModeStart) -> tuple[Unfinished, list[Scalar], Int[Array, ""]]:
    """Return the first instant of a mode, the values of its guards, and the one that is due."""
    mode, method, begun = start.begin()
    numbers = failures_by_name(start.system)
    due = number_due(mode, numbers, method, start.state, start.switched)
    return begun, [guard.value(start.state) for guard in mode.guards], due


@kernel
def make_step(start: ModeStart, now: Unfinished) -> tuple[Unfinished, list[Scalar], list[Scalar]]:
    """Make a step; return the values of guards at its end, and when rises were refused."""
    mode, method, _ = start.begin()
    now, seen = follow_measured(mode, method, now)
    whole = seen._replace(until=seen.length)  # a rise may be refused just at the end
    pairs = zip(mode.guards, seen.crossings, strict=True)
    turns = [turns_in_step(*pair, whole) for pair in pairs]
    refused = [jnp.where(one.refused, one.time, jnp.inf) for one in turns]
    return now, [guard.value(now.arrival) for guard in mode.guards], refused


@kernel
def finish_mode(start: ModeStart, now: Unfinished) -> Unfinished:
    """Make all steps that are left."""
    mode, method, _ = start.begin()
    return integrate_mode(mode, method, now, measured=False)[0]


class Followed(NamedTuple):
    """A mode that was followed step by step."""

    end: Unfinished
    rises: list[Rise]
    greatest: list[float]
    """The greatest value of each guard at the ends of steps."""
    way: list[tuple[float, Any]]
    """The time and the state at the start and at the end of each step."""
    reason: str
    """Why nothing ended it."""


def follow_steps(start: ModeStart, mode: Mode, begun: Followed) -> Followed:
    """Follow a mode to its end, or to where the integration gives up."""
    name, names = start.name, [guard.leads_to for guard in mode.guards]
    now, rises, greatest, way, _ = begun
    stuck = 0
    while int(now.guard) == NO_GUARD and int(now.count) < min(mode.most_steps, MOST_RECORDED):
        before, (now, values, refused) = now, make_step(start, now)
        time, length = float(now.last.time), float(now.last.length)
        stuck = 0 if length > 0 else stuck + 1
        if not np.isfinite(length) or stuck > MOST_STUCK:
            reason = why_it_stops(*start.begin()[:2], before.last.end, time)
            return Followed(before, rises, greatest, way, reason)
        found = [Rise(name, i, names[i], time + float(t), False) for i, t in enumerate(refused)]
        end = float(now.time) + ROUNDING * length
        rises += sorted((one for one in found if one.time <= end), key=lambda one: one.time)
        greatest = [max(known, float(value)) for known, value in zip(greatest, values, strict=True)]
        way.append((time + length, now.last.end))
    if int(now.guard) == NO_GUARD and int(now.count) < mode.most_steps:
        now = finish_mode(start, now)
        time = float(now.last.time)
        if not np.isfinite(time + float(now.last.length)):
            reason = why_it_stops(*start.begin()[:2], now.last.start, time)
            before = now._replace(arrival=now.last.start, time=now.last.time, count=now.count - 1)
            return Followed(before, rises, greatest, way, reason)
    guard = int(now.guard)
    if guard == NO_GUARD:
        return Followed(
            now, rises, greatest, way, steps_ran_out(mode, float(now.time), now.arrival)
        )
    rises.append(Rise(name, guard, names[guard], float(now.time), True))
    return Followed(now, rises, greatest, way, "")
