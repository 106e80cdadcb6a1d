"""The cells of a basin against walks that are made stride by stride."""

import numpy as np
import xarray as xr

import walker_jax as wj


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
