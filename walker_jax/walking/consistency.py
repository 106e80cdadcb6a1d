"""Checks of a model: its starts, its section, where its strides end, and its energy."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.hybrid.modes import SECTION, Mode
from walker_jax.kernels import kernel
from walker_jax.systems.angles import takes_turns_off
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.system import System
from walker_jax.walking.starts import on_section
from walker_jax.walking.stride import modes_from
from walker_jax.walking.undecided import not_finite

ENERGY_DRIFT = 1e-6
"""Change of the energy, relative to it or to 1, that exceeds an error of the integration."""


def format_point(values: Float[np.ndarray, " n"]) -> str:
    return f"({', '.join(f'{value:.9g}' for value in values)})"


class StartOfStride(NamedTuple):
    """The start of a stride from a point of the section."""

    feasible: Bool[Array, ""]
    may_launch: Bool[Array, ""]
    first: Any
    """The state in which the stride begins."""
    rates: Any
    """Its rates."""
    back: Float[Array, " section"]
    """The point, lifted and projected."""
    again: Float[Array, " section"]
    """The same of `back`, as an angle may be wrapped once."""
    turned: Bool[Array, " section"]
    """Whether this takes a full turn off each coordinate."""


@kernel
def begin_stride(system: HybridSystem, x: Float[Array, " section"]) -> StartOfStride:
    """Begin a stride from a point, in one compiled program."""
    first = system.launch(x)
    first_mode, *_ = modes_from(system, x).values()
    there_and_back = lambda x: system.project(system.lift(x))
    back = there_and_back(x)
    return StartOfStride(
        feasible=jnp.asarray(system.feasible(x)),
        may_launch=jnp.asarray(system.may_launch(x, first)),
        first=first,
        rates=first_mode.rates(first),
        back=back,
        again=there_and_back(back),
        turned=takes_turns_off(there_and_back, x),
    )


def check_point(system: System, x: Any) -> list[str]:
    """Return complaints about a start."""
    if not on_section(system, x):
        return []
    if not isinstance(system, HybridSystem):
        return [] if bool(system.feasible(x)) else ["the start is not feasible"]
    found = begin_stride(system, x)
    if not found.feasible:
        return ["the start is not feasible"]
    if names := not_finite(found.first):
        return [f"the state that lift returns is not finite: {names}"]
    if names := not_finite(found.rates):
        return [f"the vector field at the start is not finite: the rate of {names}"]
    if not found.may_launch:
        return ["the start is not feasible"]
    return []


def check_projection(system: HybridSystem, x: Any) -> list[str]:
    """Return a complaint if `lift` and `project` change a point, or wrap an unnamed angle."""
    if not on_section(system, x):
        return []
    found = begin_stride(system, x)
    back = np.asarray(found.back)
    rounding = 64 * np.finfo(back.dtype).eps * max(1.0, np.max(np.abs(back)))
    if not np.max(np.abs(found.again - back)) <= rounding:
        return [f"project(lift(x)) is {format_point(back)}"]
    for name, turned in zip(system.section, found.turned.tolist(), strict=True):
        if turned and name not in system.angles:
            return [f"project takes full turns off {name}, which angles does not name"]
    return []


def check_landing(system: HybridSystem, landed: Any) -> list[str]:
    """Return complaints about the state in which the next stride begins."""
    point = system.project(landed)
    again = system.lift(point)
    if jax.tree.structure(again) != jax.tree.structure(landed):
        return ["the last reset leads to a state of another kind than lift"]
    # A state may count time, or turns, from anywhere, but must move on alike.
    first, *_ = system.modes().values()
    rates = first.rates
    known, found = rates(system.begin(again)), rates(system.begin(landed))
    largest = lambda tree: max(float(jnp.max(jnp.abs(leaf))) for leaf in jax.tree.leaves(tree))
    miss = largest(jax.tree.map(jnp.subtract, known, found))
    if miss > 1e-6 * max(1.0, largest(found)):
        return [f"the last reset leads off the section: rates differ by {miss:.3g} there"]
    return []


def added_energy(
    system: HybridSystem, modes: Mapping[str, Mode], way: tuple[str, str], before: float, state: Any
) -> list[str]:
    """Return a doubt about a reset from one mode to another that adds energy.

    None about a system with motors (`motor_work`), nor about resets to the section, where the
    energy of a walker counts from its other foot.
    """
    name, onto = way
    energy = None if onto == SECTION else modes[onto].energy
    if energy is None or type(system).motor_work is not System.motor_work:
        return []
    gain = float(energy(state)) - before
    if not gain > ENERGY_DRIFT * max(1.0, abs(before)):
        return []
    return [
        f"the reset from mode {name!r} to {onto!r} adds {gain:.3g} to an energy of {before:.6g}: "
        "wrong, unless motors do that work (define motor_work) or energies count from two places"
    ]
