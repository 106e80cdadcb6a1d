"""The area, the large basins and the classes of cells of a basin's data set."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.basins.schema import artefacts
from walker_jax.systems.outcomes import Outcome

LARGE = 0.1
"""Share of the cells that converge to attractors, above which a basin is large. Of smaller ones,
such as those of a few cells near a bifurcation, no more than their number is worth telling."""


class CellClass(NamedTuple):
    """Cells of a grid with something in common."""

    cells: Bool[np.ndarray, "*shape"]
    """Whether each cell is among them."""

    @property
    def count(self) -> int:
        """How many there are."""
        return int(np.count_nonzero(self.cells))


class WalkingCells(NamedTuple):
    """The cells from which a walker never falls, by what it converges to."""

    large: dict[int, CellClass]
    """The basins of some attractors, by their numbers."""
    others: CellClass
    """Those of all other attractors together."""
    artefacts: CellClass
    """Cells in cycles that cell mapping makes up."""
    unmatched: CellClass
    """Cells that converge to no known attractor."""


def has_known_units(data: xr.Dataset) -> bool:
    """Whether the section begins as walkers' do, so that areas and volumes have known units."""
    return [*data.attrs["section"][:2]] == ["theta", "thetadot"]


def fixed_coordinates(data: xr.Dataset) -> dict[str, float]:
    """The coordinates of the section that a slice holds at one value, and these values.

    Those behind the axes are coordinates of the data set; those before one are in its origin.
    """
    section, origin = [*data.attrs["section"]], data.attrs.get("origin")
    fixed = {name: float(data[name]) for name in section if name in data and not data[name].ndim}
    axes = data["fate"].dims if "fate" in data else data["axis"].values.tolist()
    if origin is not None and {*axes} <= {*section}:
        fixed |= {
            name: float(at) for name, at in zip(section, origin, strict=True) if name not in axes
        } | fixed
    return {name: fixed[name] for name in section if name in fixed}


def total_area(data: xr.Dataset) -> float:
    """The area of all basins together."""
    return float(data["area"].sum())


def large_basins(data: xr.Dataset, most: int) -> list[int]:
    """Numbers of the attractors whose basins are large, `most` of them, the largest first."""
    walks = data["fate"].values == Outcome.STRIDE
    numbers, cells = np.unique(data["attractor"].values[walks], return_counts=True)
    real = np.isin(numbers, np.flatnonzero(~artefacts(data)))
    large = real & (cells >= LARGE * walks.sum())
    order = np.argsort(-cells[large], kind="stable")[:most]
    return numbers[large][order].tolist()


def walking_cells(data: xr.Dataset, large: Sequence[int]) -> WalkingCells:
    """The cells that never fall, those of the `large` attractors each in a class of its own."""
    attractor = data["attractor"].values
    walks = data["fate"].values == Outcome.STRIDE
    made_up = walks & np.isin(attractor, np.flatnonzero(artefacts(data)))
    return WalkingCells(
        large={number: CellClass(walks & (attractor == number)) for number in large},
        others=CellClass(walks & (attractor >= 0) & ~made_up & ~np.isin(attractor, large)),
        artefacts=CellClass(made_up),
        unmatched=CellClass(unmatched_cells(data["fate"].values, attractor)),
    )


def unmatched_cells(
    fate: Int[np.ndarray, "*shape"], attractor: Int[np.ndarray, "*shape"]
) -> Bool[np.ndarray, "*shape"]:
    """The cells that walk on without coming near a known attractor."""
    return (fate == Outcome.STRIDE) & (attractor < 0)


def failing_cells(fate: Int[np.ndarray, "*shape"]) -> dict[Outcome, CellClass]:
    """The cells of each failure."""
    return {outcome: CellClass(fate == outcome) for outcome in Outcome if outcome != Outcome.STRIDE}


def along_axis(
    states: Float[np.ndarray, "... section"], section: Sequence[str], axis: str
) -> Float[np.ndarray, "..."]:
    """States along an axis of a grid, `sum` among these; NaN along what is not of the section."""
    if axis == "sum":
        return along_axis(states, section, "theta") + along_axis(states, section, "thetadot")
    if axis not in section:
        return np.full(states.shape[:-1], np.nan)
    return states[..., list(section).index(axis)]
