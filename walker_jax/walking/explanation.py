"""Explanations of a stride, mode by mode and guard by guard, with checks of the model.

The rises of guards are found anew here, as the real roots of the polynomials of all steps. This is
a second opinion on the search that decides a stride.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.following import along, is_due
from walker_jax.hybrid.modes import Condition, Mode
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real
from walker_jax.kernels import kernel
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome, name_of_outcome
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walking.consistency import (
    check_landing,
    check_point,
    check_projection,
    format_point,
)
from walker_jax.walking.starts import during_stride, full_state, prepare
from walker_jax.walking.stride import begin_next, fall_of, method_of, modes_from, stride
from walker_jax.walking.undecided import (
    doubts,
    not_finite,
    steps_ran_out,
    why_it_stops,
)

MOST_RISES = 20
"""Most rises of a mode that are reported: the last ones."""
ENERGY_DRIFT = 1e-6
"""Change of the energy, relative to it or to 1, that exceeds an error of the integration."""
PARTS = 0.25, 0.5, 0.75, 1.0
"""Fractions of a step at which conditions are checked."""

MOST_STUCK = 100
"""A mode is given up after so many steps without length, which are those that a solver rejects."""


class Rise(NamedTuple):
    """A guard that rose through zero."""

    mode: int
    guard: int
    leads_to: str
    """The `Outcome`; `STRIDE` for a guard with which the stride goes on."""
    time: float
    """Time since the start of the mode."""
    admitted: bool
    """Whether it counted; the first admitted rise ends the mode."""


class ModeRecord(NamedTuple):
    """A mode that was followed."""

    time: float
    """Duration; infinite if nothing ended it."""
    steps: int
    ended_by: str
    """The outcome of the guard that ended it; empty for none."""
    rises: list[Rise]
    least: dict[str, float]
    """About the least value of each condition, at `PARTS` of steps, by its outcome when
    negative."""
    at_end: dict[str, float]
    """The value of each condition of its end, by its outcome when not positive."""
    greatest: dict[str, float]
    """The greatest value of each guard at the ends of steps, by its number and outcome."""
    energy: tuple[float, float]
    """Energy at its start and at its end; NaN where the mode does not define it."""
    reason: str = ""
    """Why nothing ended it."""
    doubts: tuple[str, ...] = ()
    """Why its numbers may be wrong, and remedies."""


class Explanation(NamedTuple):
    """A stride as it happened; printed, it is a report."""

    outcome: Outcome
    name: str
    """The name of the outcome, which may be one of the system's own."""
    system: str
    start: Float[np.ndarray, " coordinates"]
    modes: list[ModeRecord]
    complaints: list[str]
    """Inconsistencies of the model, and why a stride is `UNDECIDED`; none for a sound one."""
    state: Float[np.ndarray, " section"]
    jacobian: Float[np.ndarray, "section coordinates"]
    """Derivative of the next point by the start; NaN where there is none."""

    def __str__(self) -> str:
        lines = [f"{self.system} from {format_point(self.start)}: {self.name}"]
        for i, mode in enumerate(self.modes):
            end = f"ended by {mode.ended_by}" if mode.ended_by else "ended by nothing"
            lines.append(f"mode {i}: {mode.time:.6g} in {mode.steps} steps, {end}")
            for rise in mode.rises:
                counted = "" if rise.admitted else ", not admitted"
                lines.append(
                    f"  guard {rise.guard} ({rise.leads_to}) rose at {rise.time:.9g}{counted}"
                )
            risen = {f"{rise.guard} ({rise.leads_to})" for rise in mode.rises}
            for name, value in mode.greatest.items():
                if name not in risen:
                    lines.append(f"  guard {name} did not rise: {value:.6g} at most")
            asked = [(name, value, value >= 0) for name, value in mode.least.items()]
            asked += [(name, value, value > 0) for name, value in mode.at_end.items()]
            for name, value, holds in asked:
                broken = "" if holds else ", violated"
                lines.append(f"  condition {name}: {value:.6g} at least{broken}")
            start, end = mode.energy
            if np.isfinite(start):
                lines.append(f"  energy {start:.9g} at the start, {end - start:+.3g} along the way")
        if self.outcome == Outcome.STRIDE:
            lines.append(f"leads to {format_point(self.state)}")
            rows, columns = self.jacobian.shape
            if rows == columns and np.isfinite(self.jacobian).all():
                largest = np.abs(np.linalg.eigvals(self.jacobian)).max()
                lines[-1] += f", greatest multiplier {largest:.6g}"
        lines += [f"? {one}" for mode in self.modes for one in mode.doubts]
        lines += [f"! {one}" for one in self.complaints]
        return "\n".join(lines)


@refuses_tracers()
def explain(
    walker: System,
    x: Float[ArrayLike, " section"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Explanation:
    """Explain why the stride from x ends as it does, and check that a model fits together.

    For each mode it reports each guard that rose through zero, with its time and whether it was
    admitted, and how near the others came. It reports about the least values of conditions, and the
    change of the energy where that is known (`Mode.energy`, an `energy` of a walker). Complaints
    are: a start that is not feasible; a point of the section that `lift` and `project` change; a
    field that is not finite; a mode that no guard ends, as none rose or was admitted, and why:
    steps that ran out, a jump, with its line of code, or a number that is not finite; energy that
    changes although gravity alone drives a walker; an impact that leads off the section, or to a
    point from which no stride begins; derivatives that are not finite. Lines with ? say what may be
    wrong although the stride has an end.

    ```python
    found = wj.explain(wj.SimplestWalker(0.004), (0.2, -0.2))
    print(found)  # the report
    found.complaints  # []
    ```

    **Arguments:** any system and a point of its section, as in `stride`.
    """
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    made = stride(walker, x, tolerance=tolerance, solver=solver)
    outcome = Outcome(int(made.outcome))
    jacobian = np.full((len(walker.section), len(x)), np.nan)
    if outcome == Outcome.STRIDE:
        next_point = lambda x: stride(walker, x, tolerance=tolerance, solver=solver).state
        jacobian = np.asarray(jax.jacfwd(next_point)(x))
    complaints = check_point(walker, x)
    records: list[ModeRecord] = []
    if isinstance(walker, HybridSystem) and not complaints:
        complaints += check_projection(walker, x)
        records, landed = record_modes(during_stride(walker, x), x, integrator)
        complaints += check_records(records)
        if isinstance(walker, Walker) and walker.driven_by_gravity():
            complaints += check_energy(records)
        if outcome == Outcome.STRIDE and landed is not None:
            complaints += check_landing(walker, landed)
        if landed is not None and (names := not_finite(landed)):
            complaints.append(f"the state after the last reset is not finite: {names}")
    if outcome == Outcome.UNDECIDED and not complaints:
        complaints.append("the next point is not finite")
    if outcome == Outcome.STRIDE:
        if not np.isfinite(jacobian).all():
            complaints.append(f"derivatives of the next point are not finite: {jacobian.tolist()}")
        if not bool(walker.feasible(made.state)):
            complaints.append(
                f"no stride begins at the next point, {format_point(np.asarray(made.state))}"
            )
    state = np.asarray(made.state)
    name = name_of_outcome(outcome, walker.failures)
    return Explanation(
        outcome, name, walker.label(), np.asarray(x), records, complaints, state, jacobian
    )


def check_records(records: list[ModeRecord]) -> list[str]:
    """Return complaints about guards."""
    found = []
    for i, mode in enumerate(records):
        if not mode.ended_by:
            found.append(f"mode {i} is not ended by any of its guards: {mode.reason}")
        refused = {rise.guard for rise in mode.rises if not rise.admitted}
        admitted = {rise.guard for rise in mode.rises if rise.admitted}
        for guard in sorted(refused - admitted):
            found.append(f"guard {guard} of mode {i} rose, but was never admitted")
    return found if records and not records[-1].ended_by else []


def check_energy(records: list[ModeRecord]) -> list[str]:
    """Return complaints about a walker whose energy should stay constant in each mode."""
    found = []
    for i, mode in enumerate(records):
        start, end = mode.energy
        if abs(end - start) > ENERGY_DRIFT * max(1.0, abs(start)):
            found.append(
                f"in mode {i} the energy changes by {end - start:.3g}, but gravity alone drives "
                "the walker: vector_field and energy do not belong together"
            )
    return found


def record_modes(
    system: HybridSystem, x: Any, integrator: Integrator
) -> tuple[list[ModeRecord], Any]:
    """Record each mode up to its end, and the state of the next stride's start, or None."""
    state, records = full_state(system, x), []
    modes = modes_from(system, x)
    for number, mode in enumerate(modes):
        last = number == len(modes) - 1
        record, state, leads_on = record_mode(
            mode, number, state, integrator, system.failures, not last
        )
        records.append(record)
        if not leads_on:
            return records, None
        if not last:
            state = mode.reset(state)
    return records, begin_next(system, modes[-1], state)[1]


def record_mode(
    mode: Mode,
    number: int,
    state: Any,
    integrator: Integrator,
    failures: tuple[str, ...],
    may_be_due: bool,
) -> tuple[ModeRecord, Any, bool]:
    """Follow a mode from a state: its record, its last state, and whether the stride goes on.

    A mode that `may_be_due` is over at once where its last guard is not below zero.
    """
    names = [name_of_outcome(guard.leads_to, failures) for guard in mode.guards]
    energy_of = mode.energy or (lambda state: np.nan)
    energy = float(energy_of(state))
    conditions = {name: one.value for name, one in named(mode.conditions, failures).items()}
    least = {name: float(value(state)) for name, value in conditions.items()}
    values = [float(guard.value(state)) for guard in mode.guards]
    greatest = {f"{i} ({name})": values[i] for i, name in enumerate(names)}

    def over_at_once(name, at_end):
        return ModeRecord(0.0, 0, f"{name} at once", [], least, at_end, greatest, (energy, energy))

    fallen = int(fall_of(mode, state, number > 0))
    if fallen != Outcome.UNDECIDED:
        return over_at_once(name_of_outcome(fallen, failures), {}), state, False
    method = method_of(mode, state, jax.tree.map(jnp.asarray, integrator))
    if may_be_due and is_due(mode, method, state):
        at_end = values_at_end(mode, state, failures)
        return over_at_once(names[-1], at_end), state, all(one > 0 for one in at_end.values())

    step, end_at = steps_of(mode, method, [*conditions.values()])
    rises: list[Rise] = []
    time, count, memory, ending = 0.0, 0, method.begin(state), None
    reason, stuck, way = "", 0, [(0.0, state)]
    below = [value <= 0 for value in values]
    while ending is None and count < mode.most_steps:
        series, end, length, memory, polynomials, (there, values, seen) = step(state, memory)
        count += 1
        stuck = 0 if length > 0 else stuck + 1
        if not np.isfinite(length) or stuck > MOST_STUCK:
            reason = why_it_stops(mode, method, state, time)
            break
        found = [
            Rise(number, i, names[i], time + when, admitted)
            for i, (value, admits) in enumerate(polynomials)
            for when, admitted in rises_in(value, admits, float(length), below[i])
        ]
        counted = (rise for rise in found if rise.admitted)
        ending = min(counted, key=lambda rise: rise.time, default=None)
        if ending is not None:
            until = jnp.asarray(ending.time - time, length.dtype)
            there, values, seen = end_at(state, series, until)
            found = [rise for rise in found if rise.time <= ending.time]
        rises += found
        below = [bool(value < 0) for value in values]
        for name, along_step in zip(conditions, seen, strict=True):
            least[name] = min(least[name], *map(float, along_step))
        for name, value in zip(greatest, values, strict=True):
            greatest[name] = max(greatest[name], float(value))
        state, time = end, time + float(length)
        way.append((time, state))
    if ending is None and not reason:
        reason = steps_ran_out(mode, time, state)
    rises = rises[-MOST_RISES:]
    there = state if ending is None else there
    change = energy, float(energy_of(there))
    leads_on = ending is not None and ending.leads_to == Outcome.STRIDE.name
    at_end = values_at_end(mode, there, failures) if leads_on else {}
    ended = (np.inf, count, "") if ending is None else (ending.time, count, ending.leads_to)
    doubted = tuple(doubts(number, mode, way))
    record = ModeRecord(*ended, rises, least, at_end, greatest, change, reason, doubted)
    return record, there, leads_on and all(value > 0 for value in at_end.values())


def steps_of(mode: Mode, method: Any, conditions: list[Callable]) -> tuple[Callable, Callable]:
    """Make two functions: a recorded step of a mode, and its part up to a time."""

    def look(state, series, time):
        """Return a step's end at a time, the guards there, and the conditions on the way."""
        ways = [method.state_at(state, series, part * time) for part in PARTS]
        values = [guard.value(ways[-1]) for guard in mode.guards]
        return ways[-1], values, [[value(y) for y in ways] for value in conditions]

    @kernel
    def step(state, memory):
        series, end, length, memory = method.step(state, memory)
        polynomials = along(mode, series, whole=True)
        return series, end, length, memory, polynomials, look(state, series, length)

    return step, kernel(look)


def rises_in(value: Any, admits: Any, length: float, below: bool) -> list[tuple[float, bool]]:
    """Return when a guard rises in a step, and whether each rise is admitted."""
    holds = lambda one, when: np.polyval(np.array(one)[::-1], when) > 0
    if not length > 0 or not np.isfinite(value).all():
        return []
    times = rises_of(np.array(value), length, below)
    return [(when, all(bool(holds(one, when)) for one in admits)) for when in times]


def named(conditions: tuple[Condition, ...], failures: tuple[str, ...], where: str = "") -> dict:
    """Return conditions by the names of their outcomes; a repeated name has a number."""
    found: dict[str, Condition] = {}
    for i, one in enumerate(conditions):
        name = name_of_outcome(one.outcome, failures) + where
        found[f"{name} ({i})" if name in found else name] = one
    return found


def values_at_end(mode: Mode, state: Any, failures: tuple[str, ...]) -> dict[str, float]:
    """Return the values of the conditions of a state in which a mode has ended."""
    asked = named(mode.at_end, failures, " at the end")
    return {name: float(one.value(state)) for name, one in asked.items()}


def rises_of(coefficients: Float[np.ndarray, " n"], length: float, below: bool) -> list[float]:
    """Return the times at which a polynomial rises through zero in a step, from all real roots."""
    scaled = coefficients * length ** np.arange(len(coefficients))
    roots = np.roots(np.trim_zeros(scaled[::-1], "f"))
    real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    real = real[(real > 1e-12) & (real <= 1)]
    found, side = [], -1.0 if below else 1.0
    after = [*(real[1:] + real[:-1]) / 2, 1.0][: len(real)]
    for root, later in zip(real, after, strict=True):
        now = np.sign(np.polyval(scaled[::-1], later)) or side
        if root == real[-1] and root > 1 - 1e-12:
            now = 1.0 if side < 0 else side
        if side < 0 < now:
            found.append(float(root) * length)
        side = now
    return found
