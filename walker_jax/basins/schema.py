"""The data set of a basin: its arrays, their dimensions, types and attributes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from walker_jax.basins.attractor import Attractor, in_order
from walker_jax.grids import Grid, cell_slices
from walker_jax.storage.schema import with_dims
from walker_jax.systems.outcomes import names_in, names_of_outcomes
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_source

NOT_COMPUTED = -1
"""Fate of a cell whose piece has not been computed."""
ARRAYS = "fate", "attractor", "strides"
"""Names of the arrays over a grid."""


def attributes_of_arrays(failures: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the attributes of these arrays, for a system with failures of its own."""
    names = names_of_outcomes(failures)
    return {
        "fate": {"flag_values": list(map(int, names)), "flag_meanings": " ".join(names.values())},
        "attractor": {"description": "-1 for none"},
        "strides": {"description": "before the attractor or the failure"},
    }


class CellCycles(NamedTuple):
    """The cycles of cells of each attractor, or artefact, of cell mapping."""

    cycles: Int[np.ndarray, " number"]
    """Number of cycles of cells that belong to it, or make up this artefact."""
    falling: Int[np.ndarray, " number"]
    """Number of centres of those cells from which a walker falls."""
    artefact: Bool[np.ndarray, " number"]
    """Whether it is a cycle of cells alone: walkers from most of its centres do not converge to one
    attractor. Its states are those centres."""


class Basins(NamedTuple):
    """The label of each cell of a grid, in the order of their indices, and the attractors."""

    fate: Int[np.ndarray, " n"]
    attractor: Int[np.ndarray, " n"]
    strides: Int[np.ndarray, " n"]
    attractors: list[Attractor]
    cell_cycles: CellCycles | None = None

    def sorted(self) -> "Basins":
        """Return the basins with attractors numbered in order."""
        attractors, number = in_order(self.attractors)
        return self._replace(attractor=number[self.attractor], attractors=attractors)


def artefacts(data: xr.Dataset) -> Bool[np.ndarray, " number"]:
    """Mark the attractors that are artefacts of cells; none if the data set does not say."""
    return data["artefact"].values if "artefact" in data else np.zeros(data.sizes["number"], bool)


def to_dataset(walker: System, grid: Grid, basins: Basins, settings: dict) -> xr.Dataset:
    """Make the data set that `basin` returns; settings of the method are among its attributes."""
    return add_basins(describe(walker, grid, settings), grid, basins, walker.failures)


def add_basins(data: xr.Dataset, grid: Grid, basins: Basins, failures: Sequence[str]) -> xr.Dataset:
    """Add the labels of a grid's cells, and the attractors, to a data set of its axes."""
    reached = basins.attractor[basins.attractor >= 0]
    cells = np.bincount(reached, minlength=len(basins.attractors))
    about = attributes_of_arrays(failures)
    arrays = {
        name: (grid.names, np.asarray(values).reshape(grid.shape), about[name])
        for name, values in zip(ARRAYS, basins, strict=False)
    }
    data = data.assign(arrays)
    at_border = count_at_border(grid, basins.attractor)
    return add_attractors(data, grid, basins.attractors, cells, at_border, basins.cell_cycles)


def describe(walker: System, grid: Grid, settings: dict) -> xr.Dataset:
    """Make a data set of a grid's axes; attributes name the walker and the computation."""
    about = describe_source(walker) | settings
    if np.any(np.asarray(grid.origin)[: grid.coordinates - len(grid.fixed)]):
        about["origin"] = grid.origin.tolist()  # the coordinates of the box are offsets from it
    return xr.Dataset(coords=grid.axes | grid.fixed_values, attrs=about)


def count_at_border(grid: Grid, attractor: Int[np.ndarray, " n"], first: int = 0) -> int:
    """Count the cells of basins at the border of the grid, among n cells from the first on."""
    count = 0
    for part in cell_slices(len(attractor)):
        cells = first + part.start + np.flatnonzero(attractor[part] >= 0)
        places = zip(np.unravel_index(cells, grid.shape), grid.shape, strict=True)
        count += np.any([(place == 0) | (place == end - 1) for place, end in places], axis=0).sum()
    return int(count)


def add_attractors(
    data: xr.Dataset,
    grid: Grid,
    attractors: list[Attractor],
    cells: Int[np.ndarray, " number"],
    at_border: int,
    cell_cycles: CellCycles | None = None,
) -> xr.Dataset:
    """Add the attractors to a data set, with the cells of each basin and those at the border."""
    area = cells * grid.cell_area
    found = {
        "period": np.array([one.period or 0 for one in attractors], np.int32),
        "states": padded([one.states for one in attractors], grid.coordinates),
        "cells": cells,
        "area": area,
        "at_border": at_border,
        **({} if cell_cycles is None else cell_cycles._asdict()),
    }
    data = data.assign(with_dims("basin", found)).assign_coords(number=np.arange(len(attractors)))
    return data.assign_attrs(area=area.tolist())


def padded(rows: Sequence[Any], size: int) -> Float[np.ndarray, "n most size"]:
    """Join arrays of several lengths into one, with NaN after the shorter ones."""
    values = np.full((len(rows), max(map(len, rows), default=0), size), np.nan)
    for one, row in zip(values, rows, strict=True):
        one[: len(row)] = row
    return values


def request_of(about: xr.Dataset, grid: Grid) -> dict:
    """Return all that a basin depends on, by which a stored one is recognised."""
    return {
        **{str(name): value for name, value in about.attrs.items()},
        **{name: names_in(about, name) for name in ("section", "failures") if name in about.attrs},
        "axes": grid.box,
        "shear": grid.shear.tolist(),
        "origin": grid.origin.tolist(),
        "dtype": str(jnp.result_type(float)),
    }


def arrays_to_compute(walker: System, grid: Grid) -> dict[str, xr.Variable]:
    """Return the arrays over a grid before anything is computed."""
    about = attributes_of_arrays(walker.failures)
    return {
        "fate": constant_array(grid, NOT_COMPUTED, np.int8, about["fate"]),
        "attractor": constant_array(grid, -1, np.int32, about["attractor"]),
        "strides": constant_array(grid, 0, np.int32, about["strides"]),
    }


def constant_array(
    grid: Grid, value: Any, dtype: Any, attributes: dict | None = None, *coordinate: str
) -> xr.Variable:
    """Make an array of one value, without memory, over a grid and perhaps coordinates."""
    shape = (*grid.shape, *(grid.coordinates for _ in coordinate))
    values = np.broadcast_to(np.array(value, dtype), shape)
    return xr.Variable((*grid.names, *coordinate), values, attributes)
