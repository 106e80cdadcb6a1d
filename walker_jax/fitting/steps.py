"""Recordings as arrays of steps, which one batched call follows.

Steps are the rows; samples are padded to the most that a step has, without weight. Consecutive
steps make a run, in which each heel strike ends one step and begins the next.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from walker_jax.checks import WrongUse
from walker_jax.fitting.recordings import Recording

SAMPLES_MULTIPLE = 16
"""Samples of a step are padded to a multiple of this, so that few shapes are compiled."""
FEWEST_SAMPLES = 3
"""A step with fewer samples is left out, and its run ends before it."""


class Steps(NamedTuple):
    """Samples of all steps, in the system's units."""

    times: Float[Any, "steps samples"]
    """Times of samples, on the clock of their recording; that of the heel strike where padded."""
    values: Float[Any, "steps samples columns"]
    """Zero where there is no sample."""
    known: Bool[Any, "steps samples columns"]
    begins: Float[Any, " steps"]
    """Recorded time of the heel strike that begins each step."""
    ends: Float[Any, " steps"]
    run: Int[Any, " steps"]
    """Number of the run of consecutive steps."""
    is_first: Bool[Any, " steps"]
    """Whether a step is the first of its run."""
    recording: Int[Any, " steps"]
    stance: Int[Any, " steps"]
    """Number of the system: which leg stands."""

    @property
    def count(self) -> int:
        """Number of recorded numbers, heel strikes included."""
        return int(self.known.sum()) + len(self.run) + int(self.is_first.sum())


def cut_steps(
    recordings: Sequence[Recording], columns: Sequence[str], skip: float, margin: float
) -> tuple[Steps, list[slice]]:
    """Return the steps of recordings, and the samples of each, all experiments end to end.

    Samples up to `skip` after a heel strike are left out, and those within `margin` of one, as they
    may belong to the other step; inputs keep them, and those without any number.
    """
    rows, places, run, offset = [], [], -1, 0
    for number, one in enumerate(recordings):
        values = np.stack([one.values[name] for name in columns], axis=-1)
        goes_on = False
        for i, (begin, end) in enumerate(zip(one.strikes, one.strikes[1:], strict=False)):
            first, last = np.searchsorted(one.time, (begin + max(skip, margin), end - margin))
            within = slice(int(first), int(last))
            seen = np.isfinite(values[within]).any(axis=1)
            if seen.sum() < FEWEST_SAMPLES:
                goes_on = False
                continue
            is_first, goes_on = not goes_on, True
            run += is_first
            facts = begin, end, np.int32(run), is_first, np.int32(number)
            stance = np.int32((one.stance + i) % 2)
            rows.append((one.time[within][seen], values[within][seen], *facts, stance))
            places.append(slice(offset + within.start, offset + within.stop))
        offset += len(one.time)
    if len(rows) < 2:
        raise WrongUse(
            "recordings must have two steps or more, from heel strike to heel strike, not "
            f"{len(rows)}"
        )
    most = max(len(row[0]) for row in rows)
    most = -(-most // SAMPLES_MULTIPLE) * SAMPLES_MULTIPLE
    return Steps(*map(np.stack, zip(*(pad(row, most) for row in rows), strict=True))), places


def pad(row: tuple, most: int) -> tuple:
    """Return a step with as many samples as all have."""
    times, values, begin, *facts = row
    more = most - len(times)
    times = np.append(times, np.full(more, begin))
    values = np.concatenate([values, np.full((more, values.shape[1]), np.nan)])
    known = np.isfinite(values)
    return times, np.where(known, values, 0.0), known, begin, *facts


def tables_of_inputs(
    recordings: Sequence[Recording],
    steps: Steps,
    places: Sequence[slice],
    wanted: Mapping[str, tuple[str, float, int]],
) -> dict[str, Float[np.ndarray, "steps numbers"]]:
    """Return recorded inputs as a table over time for each step.

    For each parameter `wanted` names a recorded input, the time between two numbers of its table,
    and how many there are. The table is that of linear interpolation that is nearest to the samples
    of the step, by least squares; after them it stays as it ends.
    """
    tables = {}
    clock = np.concatenate([one.time for one in recordings])
    for parameter, (name, spacing, count) in wanted.items():
        recorded = np.concatenate([one.inputs[name] for one in recordings])
        rows = []
        for place, begin in zip(places, steps.begins, strict=True):
            at, values = (clock[place] - begin) / spacing, recorded[place]
            good = np.isfinite(values)
            used = min(count, int(np.ceil(at[good][-1])) + 1)
            hats = np.maximum(0, 1 - np.abs(at[good][:, None] - np.arange(used)))
            table = np.linalg.lstsq(hats, values[good], rcond=None)[0]
            rows.append(np.append(table, np.full(count - used, table[-1])))
        tables[parameter] = np.stack(rows)
    return tables
