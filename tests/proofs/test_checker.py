"""Proofs replayed by a checker that shares no code with them."""

import numpy as np
import pytest
from interval_checker import follow

import walker_jax as wj


@pytest.fixture(scope="module")
def data():
    grid = wj.Grid.sheared(theta=(0.1, 0.2, 10), sum=(-0.01, 0.004, 14))
    return wj.prove_basin(wj.SimplestWalker(0.004), grid, levels=2)


def replay(data, count: int, seed: int) -> int:
    """Checks one start in each of some proved cells; returns for how many the checker decides."""
    rng = np.random.default_rng(seed)
    trap = data["trap_centre"].values, data["trap_factor"].values, float(data["trap_size"])
    width = (data["upper"] - data["lower"]).values / data["count"].values
    decided = 0
    for cell in rng.choice(np.flatnonzero(data["proved"] != 0), count, replace=False):
        place = data["place"].values[cell] + rng.uniform(size=2)
        w = data["lower"].values + place * width / 2.0 ** int(data["level"][cell])
        answer = follow("0.004", data["shear"].values @ w, *trap)
        if answer is not None:
            decided += 1
            assert answer == ("walks" if data["proved"][cell] == 1 else "falls")
    return decided


@pytest.mark.slow
def test_the_checker_agrees_on_many_cells(data):
    assert replay(data, 40, seed=2) >= 20


def test_the_checker_tells_walks_from_falls():
    """About the gait at slope 0.004 in a small ellipse, and of a start that is far too fast."""
    trap = np.array([0.15338956487624, -0.15608014667568]), np.eye(2), 1e-3
    assert follow("0.004", trap[0] + 1e-4, *trap) == "walks"
    assert follow("0.004", np.array([0.15, -0.3]), *trap) == "falls"
