"""The area, the large basins and the classes of cells of a basin's data set."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.basins.schema import artefacts
from walker_jax.systems.outcomes import Outcome, names_in

LARGE = 0.1
"""Share of the walking cells from which on a basin is large. Of smaller basins, such as those of a
few cells near a bifurcation, only the number is reported."""


class WalkingCells(NamedTuple):
    """Marks of the cells from which a walker never falls, by the attractor it converges to."""

    large: dict[int, Bool[np.ndarray, "*shape"]]
    """The large basins, by the numbers of their attractors."""
    others: Bool[np.ndarray, "*shape"]
    """The cells of all other attractors together."""
    artefacts: Bool[np.ndarray, "*shape"]
    """Cells in artefacts of cell mapping."""
    unmatched: Bool[np.ndarray, "*shape"]
    """Cells that converge to no known attractor."""


def has_known_units(data: xr.Dataset) -> bool:
    """Return whether the section begins as walkers' do, which gives areas known units."""
    return names_in(data, "section")[:2] == ("theta", "thetadot")


def fixed_coordinates(data: xr.Dataset) -> dict[str, float]:
    """Return the coordinates of the section that a slice holds fixed, with their values.

    Fixed coordinates after the axes are coordinates of the data set; those before an axis are in
    its origin.
    """
    section, origin = names_in(data, "section"), data.attrs.get("origin")
    fixed = {name: float(data[name]) for name in section if name in data and not data[name].ndim}
    axes = data["fate"].dims if "fate" in data else data["axis"].values.tolist()
    if origin is not None and {*axes} <= {*section}:
        fixed |= {
            name: float(at) for name, at in zip(section, origin, strict=True) if name not in axes
        } | fixed
    return {name: fixed[name] for name in section if name in fixed}


def total_area(data: xr.Dataset) -> float:
    """Return the area of all basins together."""
    return float(data["area"].sum())


def large_basins(data: xr.Dataset, most: int) -> list[int]:
    """Return the numbers of at most `most` attractors with large basins, the largest first."""
    walks = data["fate"].values == Outcome.STRIDE
    numbers, cells = np.unique(data["attractor"].values[walks], return_counts=True)
    real = np.isin(numbers, np.flatnonzero(~artefacts(data)))
    large = real & (cells >= LARGE * walks.sum())
    order = np.argsort(-cells[large], kind="stable")[:most]
    return numbers[large][order].tolist()


def walking_cells(data: xr.Dataset, large: Sequence[int]) -> WalkingCells:
    """Sort the cells that never fall, with a class for each of the `large` attractors."""
    attractor = data["attractor"].values
    walks = data["fate"].values == Outcome.STRIDE
    made_up = walks & np.isin(attractor, np.flatnonzero(artefacts(data)))
    return WalkingCells(
        large={number: walks & (attractor == number) for number in large},
        others=walks & (attractor >= 0) & ~made_up & ~np.isin(attractor, large),
        artefacts=made_up,
        unmatched=unmatched_cells(data["fate"].values, attractor),
    )


def unmatched_cells(
    fate: Int[np.ndarray, "*shape"], attractor: Int[np.ndarray, "*shape"]
) -> Bool[np.ndarray, "*shape"]:
    """Mark the cells that walk on without coming near a known attractor."""
    return (fate == Outcome.STRIDE) & (attractor < 0)


def failing_cells(
    fate: Int[np.ndarray, "*shape"],
) -> dict[Outcome, Bool[np.ndarray, "*shape"]]:
    """Mark the cells of each failure that there is."""
    return {Outcome(one): fate == one for one in np.unique(fate[fate > Outcome.STRIDE])}


def along_axis(
    states: Float[np.ndarray, "... section"], section: Sequence[str], axis: str
) -> Float[np.ndarray, "..."]:
    """Return states along an axis of a grid, `sum` included; NaN along a foreign axis."""
    if axis in section:
        return states[..., list(section).index(axis)]
    if axis == "sum":
        return along_axis(states, section, "theta") + along_axis(states, section, "thetadot")
    return np.full(states.shape[:-1], np.nan)
