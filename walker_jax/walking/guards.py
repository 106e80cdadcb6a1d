"""Guards as a mode begins, and where one has risen: failures, and the mode or section beyond."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from walker_jax.hybrid.beginnings import Due, is_due
from walker_jax.hybrid.following import NO_GUARD
from walker_jax.hybrid.modes import SECTION, Guard, Mode, ends_at_once
from walker_jax.integrators.integrals import WithIntegrals
from walker_jax.integrators.integrator import Integrator, Method
from walker_jax.integrators.step_lengths import StepLimits, has_sharp_features
from walker_jax.systems.outcomes import Outcome

Verdict = Int[Array, ""]
"""The number of an `Outcome`."""
Numbers = Mapping[str, int]
"""The number of each failure, by its name."""


def guard_due(
    mode: Mode, numbers: Numbers, method: Method, state: Any, switched: bool | Bool[Array, ""]
) -> tuple[Int[Array, ""] | None, Bool[Array, ""]]:
    """Return the number of the first guard that ends a mode as it begins, but by no failure.

    A guard that leads to a mode is due if it does not begin below zero; one that leads to the
    section only if it acts `at_once`. The number is `NO_GUARD` if none is due, and None if none can
    be. Also returns whether it `rises` just then (`Due`).
    """
    found, rises = None, jnp.asarray(False)
    for i, guard in reversed([*enumerate(mode.guards)]):
        if guard.leads_to in numbers or (guard.leads_to == SECTION and not guard.at_once):
            continue
        due = is_due(mode, guard, method, state)
        if guard.leads_to == SECTION:
            due = Due(ends_at_once(mode, guard, state, switched), due.rises)
        found = jnp.where(due.ends, i, NO_GUARD if found is None else found).astype(jnp.int32)
        rises = jnp.where(due.ends, due.rises, rises)
    return found, rises


def number_due(
    mode: Mode, numbers: Numbers, method: Method, state: Any, switched: bool
) -> Int[Array, ""]:
    """Return the number of the guard that ends a mode as it begins; `NO_GUARD` if none does.

    Failures come first (`fall_of`, `guard_due`).
    """
    due, _ = guard_due(mode, numbers, method, state, switched)
    found = jnp.asarray(NO_GUARD if due is None else due, jnp.int32)
    for i, one in reversed([*enumerate(mode.guards)]):
        if one.at_once and one.leads_to in numbers:
            found = jnp.where(ends_at_once(mode, one, state, switched), i, found)
    return found


def leads_on(guard: Guard, numbers: Numbers) -> bool:
    """Return whether a guard leads to a mode."""
    return guard.leads_to != SECTION and guard.leads_to not in numbers


def fall_of(
    mode: Mode, numbers: Numbers, state: Any, switched: bool | Bool[Array, ""] = False
) -> Verdict:
    """Return the first failure with which a mode begins; `UNDECIDED` if there is none."""
    outcome = jnp.asarray(Outcome.UNDECIDED, jnp.int8)
    for guard in reversed(mode.guards):
        if guard.at_once and guard.leads_to in numbers:
            fallen = ends_at_once(mode, guard, state, switched)
            outcome = jnp.where(fallen, numbers[guard.leads_to], outcome).astype(jnp.int8)
    return outcome


def take_guard(guard: Guard, numbers: Numbers, state: Any) -> tuple[Verdict, Any]:
    """Return whether all holds where a guard has risen, and the state after its reset.

    That is `STRIDE`, or the failure of the first thing that does not hold.
    """
    verdict = jnp.asarray(Outcome.STRIDE, jnp.int8)
    for one in reversed(guard.must_hold):
        value = one.value(state)
        fails = jnp.where(jnp.isfinite(value), numbers[one.leads_to], Outcome.UNDECIDED)
        verdict = jnp.where(value > 0, verdict, fails).astype(jnp.int8)
    return verdict, guard.reset(state)


def method_of(mode: Mode, start: Any, integrator: Integrator) -> Method:
    """Return the method that integrates a mode; its steps also end at kinks of guards."""
    functions = tuple(function for guard in mode.functions() for function in guard)
    sharp = tuple(one.value for one in mode.conditions if has_sharp_features(one.value, start))
    watched = sharp if mode.as_smooth else (*functions, *sharp)
    if isinstance(mode.field, WithIntegrals):
        watched = *watched, *mode.field.functions().values()
    conditions = tuple(one.value for one in mode.conditions if not one.least_at_ends)
    limits = StepLimits(mode.scales, mode.longest_step)
    return integrator.method(
        mode.field, start, *functions, watched=watched, conditions=conditions, limits=limits
    )
