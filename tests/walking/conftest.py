"""Fixtures of more than one file."""

import jax
import numpy as np
import pytest
from independent_strides import GAIT, following

import walker_jax as wj
from walker_jax import SimplestWalker


@pytest.fixture(scope="module")
def walking():
    """A walk of 8 strides, of slope and x."""
    return jax.jit(lambda slope, x: wj.walk(SimplestWalker(slope), x, 8))


@pytest.fixture(scope="module")
def swing():
    """Times, and angles and rates, of the gait at slope 0.009."""
    times = np.linspace(0, GAIT["step_time"], 24)
    path = wj.trajectory(SimplestWalker(GAIT["slope"]), np.array(GAIT["state"]), times)
    return times, np.stack(path, axis=1)


@pytest.fixture(scope="module")
def tangents():
    """`following` at each of any number of points, and its derivative along a direction each."""
    batch = 128
    run = jax.jit(jax.vmap(lambda z, v: jax.jvp(following, (z,), (v,))))

    def along(points, directions):
        values, slopes = [], []
        for i in range(0, len(points), batch):
            part, direction = points[i : i + batch], directions[i : i + batch]
            missing = ((0, batch - len(part)), (0, 0))
            value, slope = run(np.pad(part, missing, "edge"), np.pad(direction, missing, "edge"))
            values.append(value[: len(part)])
            slopes.append(slope[: len(part)])
        return np.concatenate(values), np.concatenate(slopes)

    return along
