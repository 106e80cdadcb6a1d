"""Fixtures of more than one file."""

import jax
import numpy as np
import pytest
from kneed_walkers import START, WALKER, knee_strike

import walker_jax as wj


@pytest.fixture(scope="module")
def path():
    """A stride of the walker: times, states, when its phases end."""
    knee, heel = knee_strike(WALKER, START), float(wj.stride(WALKER, START).time)
    times = np.concatenate([np.linspace(0, knee * (1 - 1e-12), 12), np.linspace(knee, heel, 12)])
    return times, jax.tree.map(np.asarray, wj.trajectory(WALKER, START, times)), knee, heel
