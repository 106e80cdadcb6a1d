"""The cells of a basin against walks made stride by stride, and basins that are any set."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.basins import refinement
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper


def check_cells(
    system: wj.System, gait: np.ndarray, grid: wj.Grid, strides: int = 60
) -> xr.Dataset:
    """The basin of a gait of period one, by direct iteration; its cells end as walks do."""
    data = wj.basin(system, grid, "direct")
    fate = data.fate.values.ravel()
    np.testing.assert_allclose(data.states.values[0], gait, rtol=0, atol=1e-9)
    xs = grid.centres(np.arange(grid.size))
    ends = np.zeros(grid.size, int)
    for _ in range(strides):
        found = wj.strides(system, np.where(ends[:, None] == 0, xs, gait))
        ends = np.where(ends == 0, found.outcome, ends)
        xs = found.state
    np.testing.assert_array_equal(ends, fate)
    walked = fate == 0
    assert walked.sum() > 20
    np.testing.assert_allclose(xs[walked], np.tile(gait, (walked.sum(), 1)), atol=1e-8)
    return data


def labels_where(walks: np.ndarray, x: np.ndarray) -> Label:
    """Those of starts x, from some of which walkers walk; the others fall in the first stride."""
    number = np.where(walks, 0, -1).astype(np.int32)
    fate = np.where(walks, wj.Outcome.STRIDE, wj.Outcome.FORWARD).astype(np.int8)
    return Label(fate, number, np.ones(len(x), np.int32), x)


def let_walk(
    monkeypatch: pytest.MonkeyPatch, inside: Callable, gait: np.ndarray
) -> list[np.ndarray]:
    """Let walkers walk from a set alone, `inside(walker, x)`; gives all points asked for."""
    asked, cycle = [], Attractor(gait[None])

    def labels_of(mapper, x, *, progress=None):
        asked.append(x)
        return labels_where(inside(mapper.walker, x), x)

    mapper = lambda walker, grid, *limits, boxes: Mapper(walker, [cycle], *limits)
    monkeypatch.setattr(Mapper, "walk", labels_of)
    monkeypatch.setattr(refinement, "mapper_of_scouts", mapper)
    return asked


def let_grow(monkeypatch: pytest.MonkeyPatch, centre: np.ndarray) -> None:
    """Margins grow by 7 with the distance from a centre, and by 70 with every parameter."""

    def changes(walker, x, made, directions, parameters, tolerance):
        away = x - centre
        along = -(away @ directions.T) / np.linalg.norm(away, axis=1, keepdims=True)
        by = 7 * np.concatenate([along, np.full((len(x), len(parameters)), 10.0)], axis=1)
        return np.zeros(len(x)), by

    monkeypatch.setattr("walker_jax.design.area_gradients.margins_with_derivatives", changes)
