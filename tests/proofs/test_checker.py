"""Proofs replayed by a checker that shares no code with them."""

import numpy as np
import pytest
from interval_checker import follow, replay

import walker_jax as wj


@pytest.fixture(scope="module")
def data():
    grid = wj.Grid.sheared(theta=(0.0, 0.4, 20), sum=(-0.04, 0.01, 25))
    return wj.prove_basin(wj.SimplestWalker(0.004), grid, levels=4)


@pytest.mark.slow
def test_the_checker_agrees_on_a_thousand_cells(data):
    answers = replay(data, "0.004", 1000, seed=3)
    assert answers["walks"] + answers["falls"] >= 990 and answers["walks"] > 100


def test_the_checker_tells_walks_from_falls():
    """About the gait at slope 0.004 in a small ellipse, and of a start that is far too fast."""
    trap = np.array([0.15338956487624, -0.15608014667568]), np.eye(2), 1e-3
    assert follow("0.004", trap[0] + 1e-4, *trap) == "walks"
    assert follow("0.004", np.array([0.15, -0.3]), *trap) == "falls"
    assert follow("0.004", np.array([0.1, 0.001]), *trap) == "falls"  # no start of a stride
