"""Explanations of a stride, mode by mode and guard by guard, with checks of the model.

Each mode is measured step by step, by the search that decides a stride.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import refuses_tracers
from walker_jax.hybrid.following import NO_GUARD
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.integrator import AnySolver, Integrator
from walker_jax.integrators.roots import Real
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name
from walker_jax.systems.outcomes import Outcome, name_of_outcome
from walker_jax.systems.system import System
from walker_jax.walking.consistency import (
    ENERGY_DRIFT,
    added_energy,
    check_landing,
    check_point,
    check_projection,
    format_point,
)
from walker_jax.walking.guards import Numbers
from walker_jax.walking.starts import during_stride, prepare
from walker_jax.walking.steps_of_modes import Followed, ModeStart, Rise, begin_mode, follow_steps
from walker_jax.walking.stride import modes_from, stride
from walker_jax.walking.undecided import doubts, not_finite

MOST_RISES = 20
"""Most rises of a mode that are reported: the last ones."""
MOST_MODES = 100
"""Most modes of a stride that are recorded."""


class ModeRecord(NamedTuple):
    """A mode that was followed."""

    name: str
    time: float
    """Duration; infinite if nothing ended it."""
    steps: int
    led_to: str
    """The name to which the guard that ended it leads; empty if nothing ended it."""
    due: int | None
    """The number of the guard that ended it as it began; None if none did."""
    rises: list[Rise]
    least: dict[str, float]
    """The least value of the conditions, by their outcome when negative."""
    held: dict[str, float]
    """Values that must be positive where its guard has risen, by their failures."""
    greatest: dict[str, float]
    """The greatest value of each guard at the ends of the first `MOST_RECORDED` steps, by its
    number and outcome."""
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
    """Inconsistencies of the model, and why a stride is `UNDECIDED`, in the order in which the
    stride comes to them; none for a sound one."""
    state: Float[np.ndarray, " section"]
    jacobian: Float[np.ndarray, "section coordinates"]
    """Derivative of the next point by the start; NaN where there is none."""
    remarks: tuple[str, ...]
    """The system's own `remarks`."""

    def __str__(self) -> str:
        lines = [f"{self.system} from {format_point(self.start)}: {self.name}"]
        for mode in self.modes:
            end = f"leads to {mode.led_to}" if mode.led_to else "ended by nothing"
            lines.append(f"mode {mode.name}: {mode.time:.6g} in {mode.steps} steps, {end}")
            for rise in mode.rises:
                counted = "" if rise.admitted else ", not admitted"
                lines.append(
                    f"  guard {rise.guard} ({rise.leads_to}) rose at {rise.time:.9g}{counted}"
                )
            risen = {f"{rise.guard} ({rise.leads_to})" for rise in mode.rises}
            for number, (name, value) in enumerate(mode.greatest.items()):
                if number == mode.due:
                    lines.append(f"  guard {name} was due as the mode began: {value:.6g}")
                elif name not in risen:
                    since = " from below zero" if value > 0 else ""
                    lines.append(f"  guard {name} did not rise{since}: {value:.6g} at most")
            asked = [(name, value, value >= 0) for name, value in mode.least.items()]
            asked += [(name, value, value > 0) for name, value in mode.held.items()]
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
        lines += self.remarks
        lines += [f"? {one}" for mode in self.modes for one in mode.doubts]
        order = ["first: ", *["then: "] * len(self.complaints)] if self.complaints[1:] else [""]
        lines += [f"! {n}{one}" for n, one in zip(order, self.complaints, strict=False)]
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
    admitted, and how near the others came. It reports the least values of conditions, and the
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
        complaints += check_records(records, driven_by_gravity=walker.driven_by_gravity())
        if outcome == Outcome.STRIDE and landed is not None:
            complaints += check_landing(walker, landed)
        if len(records) == MOST_MODES:
            complaints.append(f"the stride chatters: it has passed {MOST_MODES} modes")
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
    about = walker.label(), np.asarray(x), records, complaints, state, jacobian
    return Explanation(outcome, name, *about, walker.remarks())


def check_records(records: list[ModeRecord], *, driven_by_gravity: bool) -> list[str]:
    """Return complaints about the modes, in their order: about energy that should stay constant,
    and about the guards if none ends the last mode."""
    unending, found = bool(records) and not records[-1].led_to, []
    for mode in records:
        start, end = mode.energy
        if driven_by_gravity and abs(end - start) > ENERGY_DRIFT * max(1.0, abs(start)):
            found.append(
                f"in mode {mode.name!r} the energy changes by {end - start:.3g}, but gravity alone "
                "drives the walker: vector_field and energy do not belong together"
            )
        if unending:
            admitted = {rise.guard for rise in mode.rises if rise.admitted}
            for guard in sorted({rise.guard for rise in mode.rises} - admitted):
                found.append(f"guard {guard} of mode {mode.name!r} rose, but was never admitted")
        if not mode.led_to:
            found.append(f"mode {mode.name!r} is not ended by any of its guards: {mode.reason}")
    return found


def record_modes(
    system: HybridSystem, x: Any, integrator: Integrator
) -> tuple[list[ModeRecord], Any]:
    """Record each mode up to its end, and the state of the next stride's start, or None."""
    modes, state, records = modes_from(system, x), system.launch(x), []
    numbers, (name, *_) = failures_by_name(system), modes
    while len(records) < MOST_MODES:
        start = ModeStart(system, x, state, integrator, name, bool(records))
        record, state, guard = record_mode(start, modes[name], numbers)
        records.append(record)
        if guard is None or not all(value > 0 for value in record.held.values()):
            return records, None
        state = guard.reset(state)
        way = name, guard.leads_to
        added = added_energy(system, modes, way, record.energy[1], state)
        records[-1] = record._replace(doubts=(*record.doubts, *added))
        if guard.leads_to == SECTION:
            return records, state
        name = guard.leads_to
    return records, None


def record_mode(
    start: ModeStart, mode: Mode, numbers: Numbers
) -> tuple[ModeRecord, Any, Guard | None]:
    """Follow a mode from a state: its record, its last state, and the guard that leads on.

    There is none if the mode ends in a failure, or by no guard.
    """
    name, state = start.name, start.state
    begun, values, due = begin_mode(start)
    number = due = int(due)
    made = Followed(begun, [], [*map(float, values)], [(0.0, state)], "")
    if due == NO_GUARD:
        made = follow_steps(start, mode, made)
        number = int(made.end.guard)
    guard = None if number == NO_GUARD else mode.guards[number]
    led_to = guard.leads_to if guard else ""
    guard = None if led_to in numbers else guard
    there, count = made.end.arrival, int(made.end.count)
    held = values_held(guard, there) if guard else {}
    energy = mode.energy or (lambda state: np.nan)
    of_guards = zip(mode.guards, made.greatest, strict=True)
    record = ModeRecord(
        name=name,
        time=float(made.end.time) if led_to else np.inf,
        steps=count,
        led_to=led_to if due == NO_GUARD else f"{led_to} at once",
        due=None if due == NO_GUARD else due,
        rises=made.rises[-MOST_RISES:],
        least=least_values(mode, (state, there), made.end.misses),
        held=held,
        greatest={f"{i} ({one.leads_to})": high for i, (one, high) in enumerate(of_guards)},
        energy=(float(energy(state)), float(energy(there))),
        reason=made.reason,
        doubts=tuple(doubts(name, mode, made.way)) if count else (),
    )
    return record, there, guard


def least_values(mode: Mode, ends: tuple[Any, Any], misses: Any) -> dict[str, float]:
    """Return the least value of conditions between two ends of a mode, by failure."""
    least: dict[str, float] = {}
    for one in mode.conditions:
        name = one.leads_to
        values = [float(one.value(state)) for state in ends]
        least[name] = min(*values, float(misses.least[name]), least.get(name, np.inf))
    return least


def values_held(guard: Guard, state: Any) -> dict[str, float]:
    """Return the values of what must hold in a state in which a guard has risen."""
    found: dict[str, float] = {}
    for i, one in enumerate(guard.must_hold):
        name = f"{one.leads_to} at the end"
        found[f"{name} ({i})" if name in found else name] = float(one.value(state))
    return found
