"""Reasons why a mode of a stride has no end, and doubts about the numbers of one that has."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.integrator import Method
from walker_jax.integrators.own_sizes import proportional_variables
from walker_jax.integrators.roots import first_zero
from walker_jax.integrators.step_lengths import has_sharp_features, step_size
from walker_jax.integrators.taylor import evaluate_series, located_switches
from walker_jax.integrators.taylor_steps import Taylor
from walker_jax.kernels.jaxprs import line_of

FAINT, A_WHILE = 1e-12, 0.1
"""A variable is faint where it is smaller than this, relative to the largest one, for that part of
the time of a mode: the error of a step is relative to the largest variable."""
BOTH_SIDES = 1e-6
"""Distance from a jump at which both sides are evaluated, as part of a step."""


def names_of(state: Any) -> list[str]:
    """Return the names of all scalars of a state, such as phidot, or [2] in an array."""
    names = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(state):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        places = np.ndindex(np.shape(leaf))
        names += [name + "".join(f"[{i}]" for i in place) for place in places]
    return [name or "the only variable" for name in names]


def numbers_of(state: Any) -> Float[np.ndarray, " n"]:
    """Return all scalars of a state."""
    return np.concatenate([np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(state)])


def not_finite(state: Any) -> str:
    """Return the names of the scalars that are not finite; empty if all are."""
    numbers = numbers_of(state)
    return ", ".join(
        name for name, y in zip(names_of(state), numbers, strict=True) if ~np.isfinite(y)
    )


def describe_state(state: Any) -> str:
    return f"({', '.join(f'{value:.6g}' for value in numbers_of(state))})"


def why_it_stops(mode: Mode, method: Method, state: Any, time: float) -> str:
    """Return why no step of the integration begins in a state, a time after a mode's start."""
    where = f"at {time:.9g}, from {describe_state(state)}"
    if names := not_finite(state):
        return f"the state is not finite {where}: {names}"
    if names := not_finite(mode.rates(state)):
        return f"the vector field is not finite {where}: the rate of {names}"
    if not isinstance(method.solver, Taylor):
        return f"the solver rejects all steps {where}"
    series = method.expand(state)
    if found := find_jump(mode, method, series):
        return describe_jump(mode, series, *found, time)
    last = jax.tree.map(lambda c: c[-1], series, is_leaf=lambda x: isinstance(x, list))
    if names := not_finite(last):
        return f"the series of {names} is not finite {where}"
    return f"the vector field jumps, or is not finite nearby, {where}"


def find_jump(mode: Mode, method: Method, series: Any) -> tuple[float, float, str] | None:
    """Find the first jump or kink in a step: its time, the step's length, and a name for it."""
    length = step_size(series, method.tolerance)
    guards = [(f"guard {i}", one) for i, guard in enumerate(mode.functions()) for one in guard]
    found: list[tuple[float, str]] = []
    for label, function in [("the vector field", method.field), *guards]:
        for equation, switch in located_switches(function, series):
            zero = float(first_zero(switch, length, length * method.tolerance)[0])
            if zero < float(length):
                line = line_of(equation)
                name = f"{label}, in {equation.primitive.name}" + (f", {line}" if line else "")
                found.append((zero, name))
    if not found:
        return None
    zero, name = min(found)
    return zero, float(length), name


def describe_jump(
    mode: Mode, series: Any, zero: float, length: float, name: str, begun: float
) -> str:
    """Return by how much the rates of the state jump, where, and by which function."""
    at = lambda time: numbers_of(mode.rates(evaluate_series(series, jnp.asarray(time))))
    jump = at(zero + BOTH_SIDES * length) - at(zero - BOTH_SIDES * length)
    there = evaluate_series(series, jnp.asarray(zero))
    i = int(np.nanargmax(np.abs(jump))) if np.isfinite(jump).any() else 0
    return (
        f"{name}: the rate of {names_of(there)[i]} jumps by {jump[i]:.3g} at {begun + zero:.9g}, "
        f"in {describe_state(there)}; end the mode there by a guard"
    )


def steps_ran_out(mode: Mode, time: float, state: Any) -> str:
    """Return that a mode has used all its steps."""
    return (
        f"none has risen when its {mode.most_steps} steps run out (most_steps) at {time:.6g}, "
        f"in {describe_state(state)}"
    )


def doubts(name: str, mode: Mode, way: Sequence[tuple[float, Any]]) -> list[str]:
    """Return doubts about a mode that was followed, and their remedies.

    `way` has the time and the state at the start and at the end of each step.
    """
    found, start = [], way[0][1]
    times = np.array([time for time, _ in way])
    if mode.scales is None:
        states = np.array([numbers_of(state) for _, state in way])
        own = proportional_variables(mode.field, start)
        for i, least, other in faint_variables(times, states):
            if own is not None and numbers_of(own)[i]:
                continue
            found.append(
                f"in mode {name!r} {names_of(start)[i]} falls to {least:.3g}, beside variables of "
                f"{other:.3g}: its digits are noise, unless Mode has scales for the variables"
            )
    if mode.longest_step is None and has_sharp_features(mode.field, start):
        found.append(
            f"the longest step of mode {name!r} takes {np.diff(times, prepend=0).max():.3g}: "
            "features of its exponential functions that are shorter may be missed, unless Mode has "
            "a longest_step"
        )
    return found


def faint_variables(
    times: Float[np.ndarray, " n"], states: Float[np.ndarray, "n variables"]
) -> list[tuple[int, float, float]]:
    """Find variables that fall below the noise of the largest one: their least value, and that."""
    sizes = np.abs(states)
    largest = sizes.max(axis=1)
    found = []
    for i, size in enumerate(sizes.T):
        faint = (size > 0) & (size < FAINT * largest)
        duration = np.diff(times)[faint[1:] & faint[:-1]].sum()
        if duration > A_WHILE * times[-1] and (size >= FAINT * largest).any():
            at = int(np.where(faint, size, np.inf).argmin())
            found.append((i, float(size[at]), float(largest[at])))
    return found
