"""Recordings of walks: samples of coordinates over consecutive steps, in a system's units.

Gaps are NaN. Heel strikes are given as times, told by a column that changes at each, or found where
a coordinate jumps as the legs exchange roles.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_kind, numbers, short
from walker_jax.systems.html_tables import html_table

UNITS = {
    **{"rad": 1.0, "deg": np.pi / 180, "rad/s": 1.0, "deg/s": np.pi / 180},
    **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""Sizes of units, in rad, seconds and metres."""
LARGEST_ANGLE = np.pi
"""No leg turns so far within a step (rad): larger numbers are degrees, or counts of an encoder."""
ANGLES = "theta", "phi", "knee"
"""Names that walkers have for angles."""
JUMP = 8.0
"""A change between samples is a heel strike if it is so many times as large as any of the changes
just before and after it, and at least a `SHARE` of the column's range."""
SHARE = 0.3


class Recording(NamedTuple):
    """One experiment."""

    time: Float[np.ndarray, " samples"]
    values: dict[str, Float[np.ndarray, " samples"]]
    """Coordinates by the names that the system's state has for them; NaN in gaps."""
    strikes: Float[np.ndarray, " strikes"]
    """Times of heel strikes, those that begin the first step and end the last among them."""
    inputs: dict[str, Float[np.ndarray, " samples"]]
    """Recorded inputs, such as a motor's command, by the names of their columns."""
    stance: int = 0
    """Number of the system, of two that take turns, that makes the first step."""


class Recordings(tuple[Recording, ...]):
    """Experiments; shown as a table of what was read."""

    def table(self) -> list[list[Any]]:
        """Return a row for each column of each experiment: samples, gaps, and its range."""
        rows = []
        for number, one in enumerate(self):
            steps = len(one.strikes) - 1
            for name, values in (one.values | one.inputs).items():
                ends = (f"{end:.4g}" for end in (np.nanmin(values), np.nanmax(values)))
                gaps = int(np.isnan(values).sum())
                rows.append([number, steps, name, len(values), gaps, *ends])
        return rows

    def __repr__(self) -> str:
        rows = [[*map(str, row)] for row in (HEAD, *self.table())]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ("  ".join(map(str.rjust, row, widths)) for row in rows)
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_table(f"{len(self)} recordings", HEAD, self.table())


HEAD = "experiment", "steps", "column", "samples", "gaps", "least", "largest"


def make_recording(
    time: Any,
    values: Mapping[str, Any],
    strikes: Any = None,
    inputs: Mapping[str, Any] | None = None,
    stance: int = 0,
) -> Recording:
    """Return a recording of arrays in the system's units, checked, with its heel strikes."""
    time = check_time(numbers("time", time))
    known = {name: check_column(name, one, len(time)) for name, one in values.items()}
    if not known:
        raise WrongUse("columns must name one coordinate or more, not none", of="columns")
    for name, one in known.items():
        largest = np.nanmax(np.abs(one))
        if name in ANGLES and largest > LARGEST_ANGLE:
            raise WrongUse(
                f"columns must be in rad, but {name} reaches {largest:.4g}: give units, such as "
                f"deg for {name}",
                of="columns units",
            )
    given = {name: check_column(name, one, len(time)) for name, one in (inputs or {}).items()}
    at = find_strikes(time, known) if strikes is None else numbers("strikes", strikes)
    if at.ndim != 1 or not (np.diff(at) > 0).all():
        raise WrongUse(f"strikes must be times that grow, not {short(at)}")
    return Recording(time, known, at, given, stance)


def check_time(time: Float[np.ndarray, "..."]) -> Float[np.ndarray, " samples"]:
    """Raise `WrongUse` unless times are finite and grow."""
    if time.ndim != 1 or len(time) < 2:
        raise WrongUse(f"time must be a row of two samples or more, not of shape {time.shape}")
    if (lost := np.flatnonzero(~np.isfinite(time))).size:
        raise WrongUse(f"time must be finite, but is {time[lost[0]]} in sample {lost[0]}")
    if (back := np.flatnonzero(np.diff(time) <= 0)).size:
        i = back[0] + 1
        raise WrongUse(
            f"time must grow, but goes from {time[i - 1]:.6g} to {time[i]:.6g} at sample {i}: "
            "several experiments in one file need experiment",
            of="time experiment",
        )
    return time


def check_column(name: str, values: Any, count: int) -> Float[np.ndarray, " samples"]:
    """Raise `WrongUse` unless a column has a number for each time, and one that is not NaN."""
    found = numbers(name, values)
    if found.shape != (count,):
        raise WrongUse(
            f"{name} must have one number for each of {count} times, not shape {found.shape}"
        )
    if not np.isfinite(found).any():
        raise WrongUse(f"{name} must have numbers, not NaN alone")
    return np.where(np.isfinite(found), found, np.nan)


def find_strikes(
    time: Float[np.ndarray, " samples"], values: Mapping[str, Float[np.ndarray, " samples"]]
) -> Float[np.ndarray, " strikes"]:
    """Return the times of heel strikes, half-way between the samples where a coordinate jumps.

    The recording begins with the step after the first jump, and ends with the step before the last.
    """
    is_jump = np.zeros(len(time) - 1, bool)
    for one in values.values():
        good = np.flatnonzero(np.isfinite(one))
        change = np.abs(np.diff(one[good]))
        if len(change) < 5:
            continue
        around = np.stack([np.roll(change, shift) for shift in (-2, -1, 1, 2)]).max(axis=0)
        found = (change > JUMP * around) & (change > SHARE * np.ptp(one[good]))
        is_jump[good[:-1][found]] = True
    at = np.flatnonzero(is_jump)
    if len(at) < 2:
        raise WrongUse(
            f"strikes must be given: {len(at)} jumps of {', '.join(values)} were found, not two or "
            "more",
            of="strikes",
        )
    return (time[at] + time[at + 1]) / 2


def strikes_at_changes(
    time: Float[np.ndarray, " samples"], legs: Float[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " strikes"], int]:
    """Return the times at which a column changes, and its value after the first, 0 or 1.

    The samples before the first change and after the last are ends of steps too, if they are the
    recording's own.
    """
    at = np.flatnonzero(np.diff(legs))
    between = (time[at] + time[at + 1]) / 2
    first = legs[at[0] + 1] if len(at) else 0
    return between, int(first) % 2 if np.isfinite(first) else 0


def as_recordings(recordings: Any) -> Recordings:
    """Return one recording, or several, as `Recordings`."""
    several = [recordings] if isinstance(recordings, Recording) else recordings
    check_kind("recordings", several, Sequence)
    for one in several:
        check_kind("recordings", one, Recording)
    if not several:
        raise WrongUse("recordings must be one or more, not none")
    names = {*several[0].values}
    for one in several:
        if {*one.values} != names:
            raise WrongUse(
                f"recordings must have the same columns, not {', '.join(sorted(names))} and "
                f"{', '.join(sorted(one.values))}"
            )
    return Recordings(several)
