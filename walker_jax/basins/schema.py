"""The data set of a basin: its arrays, their dimensions, types and attributes."""

from importlib.metadata import version
from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from walker_jax.basins.attractor import Attractor, Basins
from walker_jax.grids import Grid
from walker_jax.walkers.model import Walker
from walker_jax.walking.outcomes import Outcome

NOT_YET = -1
"""The fate of a cell whose piece has not been computed."""


def artefacts(data: xr.Dataset) -> Bool[np.ndarray, " number"]:
    """Which attractors of a data set are artefacts of cells; none where it does not tell."""
    return data["artefact"].values if "artefact" in data else np.zeros(data.sizes["number"], bool)


def labelled(walker: Walker, grid: Grid, found: Basins, how: dict) -> xr.Dataset:
    """The data set that `basin` returns; `how` it was made is among its attributes."""
    cells = np.bincount(found.attractor[found.attractor >= 0], minlength=len(found.attractors))
    over_grid = {
        name: (grid.names, np.asarray(values).reshape(grid.shape), ABOUT[name])
        for name, values in zip(ABOUT, found, strict=False)
    }
    data = described(walker, grid, how).assign(over_grid)
    return with_attractors(data, grid, found.attractors, cells)


ABOUT: dict[str, dict[str, Any]] = {
    "fate": {
        "flag_values": list(range(len(Outcome))),
        "flag_meanings": " ".join(Outcome.__members__),
    },
    "attractor": {"description": "-1 for none"},
    "strides": {"description": "before the attractor or the failure"},
}
"""Attributes of what there is over a grid."""


def described(walker: Walker, grid: Grid, how: dict) -> xr.Dataset:
    """The axes of a grid, and what is computed over it."""
    about = {
        "walker": type(walker).__name__,
        **{f"walker_{name}": float(value) for name, value in vars(walker).items()},
        **how,
        "section": list(walker.section),
        "version": f"walker-jax {version('walker-jax')}",
    }
    return xr.Dataset(coords=grid.axes | grid.held, attrs=about)


def with_attractors(
    data: xr.Dataset, grid: Grid, attractors: list[Attractor], cells: Int[np.ndarray, " number"]
) -> xr.Dataset:
    """With the attractors, and how many cells come to each."""
    longest = max((len(one.states) for one in attractors), default=0)
    states = np.full((len(attractors), longest, grid.coordinates), np.nan)
    for one, row in zip(attractors, states, strict=True):
        row[: len(one.states)] = one.states
    area = cells * grid.cell_area
    found = {
        "period": ("number", np.array([one.period or 0 for one in attractors], np.int32)),
        "states": (("number", "phase", "coordinate"), states),
        "cells": ("number", cells),
        "area": ("number", area),
    }
    if data.attrs["method"] == "cell-map":
        found |= {
            "artefact": ("number", np.array([one.artefact for one in attractors], bool)),
            "cycles": ("number", np.array([one.cycles for one in attractors], np.int32)),
            "falling": ("number", np.array([one.falling for one in attractors], np.int32)),
        }
    data = data.assign(found).assign_coords(number=np.arange(len(attractors)))
    return data.assign_attrs(area=area.tolist())


def request_of(about: xr.Dataset, grid: Grid) -> dict:
    """All that a basin depends on, by which it is known again."""
    return {
        **{str(name): value for name, value in about.attrs.items()},
        "axes": grid.box,
        "shear": grid.shear.tolist(),
        "origin": grid.origin.tolist(),
        "dtype": str(jnp.asarray(0.0).dtype),
    }


def not_yet(grid: Grid) -> dict[str, xr.Variable]:
    """What there is over a grid before anything is computed."""
    return {
        "fate": over_grid(grid, NOT_YET, np.int8, ABOUT["fate"]),
        "attractor": over_grid(grid, -1, np.int32, ABOUT["attractor"]),
        "strides": over_grid(grid, 0, np.int32, ABOUT["strides"]),
    }


def over_grid(grid: Grid, value: Any, dtype: Any, about: dict, *more: str) -> xr.Variable:
    """An array over a grid, and over the state too, with one value everywhere and no memory."""
    shape = (*grid.shape, *(grid.coordinates for _ in more))
    return xr.Variable((*grid.names, *more), np.broadcast_to(np.array(value, dtype), shape), about)
