"""Integrals and largest values of functions along a stride, such as work, effort and peak forces.

The modes of a system name the functions (`Mode.integrals`, `Mode.largest`). An integral is one more
variable of the motion, which neither the equations nor the guards read. A largest value is minus
the least value of a condition (`hybrid.misses`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.hybrid.graphs import check_states
from walker_jax.hybrid.modes import SECTION, Condition, Function, Guard, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrals import WithIntegrals
from walker_jax.integrators.integrator import AnySolver, Integrator, zero_at
from walker_jax.integrators.roots import Real
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name, modes_of
from walker_jax.systems.outcomes import Outcome, nan_unless
from walker_jax.systems.system import System
from walker_jax.walking.failure_margins import add_conditions, nothing_violated
from walker_jax.walking.starts import during_stride, prepare
from walker_jax.walking.stride import end_course, follow_graph, modes_from, start_course


def integrals(
    system: System,
    x: Float[ArrayLike, " coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> dict[str, Float[Array, ""]]:
    """Compute the integrals and largest values along the stride from x that a system's modes name.

    ```python
    class Measured(wj.systems.SpringMassRunner):
        def modes(self):
            height = {"height": lambda state: state.y}
            return {of: mode._replace(integrals=height) for of, mode in super().modes().items()}

    wj.integrals(Measured(), [0.79])["height"]
    ```

    An integral is over all modes that name the function, in the unit of the function times the unit
    of time. Values are NaN where the stride fails. First derivatives are exact; largest values have
    none where the instant of the largest value jumps. Arguments and errors are those of `stride`.

    **Returns** a dictionary by name. Raises `WrongUse` for a system whose modes name no function.
    """
    system, x, integrator = prepare(system, x, tolerance, solver)
    if not isinstance(system, HybridSystem) or not named_functions(system):
        raise WrongUse(
            f"system must name functions in Mode.integrals or Mode.largest, as no mode of "
            f"{system.label()} does"
        )
    return follow_integrals(system, x, integrator)


def named_functions(system: System) -> list[str]:
    """Return the names of the functions that the modes of a system name, integrals first."""
    if not isinstance(system, HybridSystem):
        return []
    modes = modes_of(system).values()
    summed = [name for mode in modes for name in mode.integrals]
    return [*dict.fromkeys([*summed, *(name for mode in modes for name in mode.largest)])]


@kernel
def follow_integrals(
    system: HybridSystem, x: Float[Array, " coordinates"], integrator: Integrator
) -> dict[str, Float[Array, ""]]:
    system = during_stride(system, x)
    modes = modes_from(system, x, to_the_end=True)
    summed = [*dict.fromkeys(name for mode in modes.values() for name in mode.integrals)]
    peaks = [*dict.fromkeys(name for mode in modes.values() for name in mode.largest)]
    if both := sorted({*summed} & {*peaks}):
        raise WrongUse(
            f"integrals of {system.label()} must have other names than its largest values, unlike "
            f"{both[0]!r}"
        )
    course = start_course(system, modes, x)
    check_states(modes, course.entries[next(iter(modes))].state)
    longer = {of: with_largest(mode) for of, mode in modes.items()}
    if summed:
        first, *_ = modes
        entry = course.entries[first]
        begun = entry.state, dict.fromkeys(summed, zero_at(entry.state))
        course = course._replace(entries={first: entry._replace(state=begun)})
        longer = {of: with_integrals(mode, summed) for of, mode in longer.items()}
    numbers = failures_by_name(system)
    add = lambda known, part: with_fast_sincos(lambda: add_conditions(known, part, numbers))()
    known = nothing_violated(longer, course.time)
    fold = add if peaks else lambda known, _: known
    course, known = follow_graph(
        system, longer, course, integrator, fold, known, measured=bool(peaks)
    )
    section = course.entries[SECTION]
    state, sums = section.state if summed else (section.state, {})
    least = {name: -known.value[name] for name in peaks}
    made = end_course(
        system,
        modes,
        course._replace(
            entries={SECTION: section._replace(state=state)},
            violated={name: flag for name, flag in course.violated.items() if name not in peaks},
        ),
    )
    return {
        name: nan_unless(made.outcome == Outcome.STRIDE, value)
        for name, value in (sums | least).items()
    }


def with_largest(mode: Mode) -> Mode:
    """Return a mode with a condition for each function whose largest value it names."""

    def as_condition(name: str, function: Function) -> Condition:
        return Condition(lambda state: -function(state), name)

    peaks = (as_condition(*one) for one in mode.largest.items())
    return mode._replace(conditions=(*mode.conditions, *peaks))


def with_integrals(mode: Mode, names: list[str]) -> Mode:
    """Return a mode whose states are pairs, of the state and of the integrals by name."""
    of_state = lambda function: lambda both: function(both[0])
    every = lambda functions: tuple(map(of_state, functions))
    conditions = lambda given: tuple(one._replace(value=of_state(one.value)) for one in given)

    def guard(one: Guard) -> Guard:
        return one._replace(
            value=of_state(one.value),
            admits=every(one.admits),
            reset=lambda both: (one.reset(both[0]), both[1]),
            must_hold=conditions(one.must_hold),
            surface=one.surface and of_state(one.surface),
        )

    return mode._replace(
        field=WithIntegrals(
            mode.rates, {name: mode.integrals.get(name, zero_at) for name in names}
        ),
        guards=tuple(map(guard, mode.guards)),
        conditions=conditions(mode.conditions),
        rates_at=None,
    )
