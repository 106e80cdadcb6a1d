"""Summary of a basin's data set: cells by their fate, and its attractors."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from walker_jax.basins.cell_classes import unmatched_cells
from walker_jax.basins.schema import artefacts
from walker_jax.basins.volumes import runs_of
from walker_jax.systems.outcomes import OUTCOMES, Outcome, failures_of, names_of_outcomes

CELLS_AT_ONCE = 2**22
"""Cells that are counted together, some 40 MB: a large data set exceeds the memory."""


class Tally(NamedTuple):
    """Counts of the cells of a data set."""

    fates: Int[np.ndarray, " outcomes"]
    """Cells of each `Outcome`."""
    unmatched: int
    """Cells that walk on without coming near a known attractor."""
    strides: int
    """Strides made from all cells, including the failing strides."""


def tally(data: xr.Dataset) -> Tally:
    """Count the cells of a basin's data set by their fate."""
    if "run_fate" in data:
        fate, lengths = data["run_fate"].values, runs_of(data).lengths
        fates = np.bincount(fate, lengths, minlength=OUTCOMES).astype(int)
        lost = unmatched_cells(fate, data["run_attractor"].values)
        return Tally(fates, int(lengths[lost].sum()), int(data["strides_made"]))
    fates, unmatched, made = np.zeros(OUTCOMES, int), 0, 0
    row = data["fate"].dims[0]
    rows = max(1, CELLS_AT_ONCE * data.sizes[row] // data["fate"].size)
    for first in range(0, data.sizes[row], rows):
        part = data[["fate", "attractor", "strides"]].isel({row: slice(first, first + rows)})
        fate, attractor, strides = (part[name].values.ravel() for name in part)
        fates += np.bincount(fate, minlength=len(fates))
        unmatched += int(unmatched_cells(fate, attractor).sum())
        made += int(strides.sum(dtype=np.int64) + (fate != Outcome.STRIDE).sum())
    return Tally(fates, unmatched, made)


def summarise_basin(data: xr.Dataset, counts: Tally) -> dict:
    """Return the cells, area, attractors and fates of a basin's data set, as JSON can hold them.

    A refined basin has the error of its area too. Over three dimensions the keys are `volume` and
    `volume_error`.
    """
    names = names_of_outcomes(failures_of(data))
    size = {"area": float(data["area"].sum())}
    if "total_area" in data:
        name = "volume" if "run_fate" in data else "area"
        size = {name: float(data["total_area"]), f"{name}_error": float(data["total_area_error"])}
    return {
        "cells": int(counts.fates.sum()),
        **size,
        "at_border": int(data["at_border"]),
        "attractors": summarise_attractors(data),
        "fates": {name: int(counts.fates[one]) for one, name in names.items()},
    }


def summarise_attractors(data: xr.Dataset) -> list[dict]:
    """Return the attractors of a basin's data set; the period is None for aperiodic ones."""
    mapped = [name for name in ("cycles", "falling") if name in data]
    return [
        {
            "period": int(data["period"][i]) or None,
            "states": data["states"].values[i][: max(1, int(data["period"][i]))],
            "cells": int(data["cells"][i]),
            "area": float(data["area"][i]),
            "artefact": bool(artefact),
            **{name: int(data[name][i]) for name in mapped},
        }
        for i, artefact in enumerate(artefacts(data))
    ]
