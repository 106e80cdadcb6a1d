"""Bounds of the viability kernel on ever finer cells, against closed forms and uniform grids."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_viability import LEAST, PushedWheel, saturate

import walker_jax as wj

SKEW = np.array([[1.0, 0.4], [0.3, 1.0]])
LIMITS = np.array([0.5, 0.4])


def unstable(y, push, pull):
    """Two coordinates that double and treble, and are pushed; seen along oblique axes."""
    along = jnp.asarray(np.linalg.inv(SKEW)) @ y
    return jnp.asarray(SKEW) @ (along * jnp.array([2.0, 3.0]) + jnp.stack([push, pull]))


PUSHED = wj.Map(unstable, ("x", "y"), parameters={"push": 0.0, "pull": 0.0})
ACTIONS = {"push": (-0.5, 0.5, 5), "pull": (-0.8, 0.8, 9)}
"""So |x| <= 0.5 and |y| <= 0.4 along their own axes can be kept, and no more."""


def oblique_grid(count: int) -> wj.Grid:
    return wj.Grid.plain(x=(-1, 1, count), y=(-1, 1, count))


def test_bounds_close_in_on_the_kernel_of_a_closed_form():
    """Images of cells are parallelograms here, which their boxes hold without an error."""
    data = wj.viable(PUSHED, oblique_grid(24), ACTIONS, levels=3)
    grid = oblique_grid(192)
    area = np.linalg.det(SKEW) * np.prod(2 * LIMITS)
    least, most = data["level_inner_area"].values, data["level_outer_area"].values
    assert (np.diff(least) >= 0).all() and (np.diff(most) <= 0).all()
    assert 0 < least[-1] < area < most[-1] and least[-1] < data.attrs["area"] < most[-1]
    assert (least[-1], most[-1]) == (data.attrs["inner_area"], data.attrs["outer_area"])
    gaps = most - least
    assert gaps[3] < 0.62 * gaps[2] < 0.62**2 * gaps[1]
    centres = grid.centres(np.arange(grid.size))
    half = grid.spacing / 2
    corners = centres[:, None] + half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    held = np.all(np.abs(corners @ np.linalg.inv(SKEW).T) <= LIMITS + 1e-12, axis=-1)
    assert held[data["inner"].values.ravel()].all()
    assert not held[~data["outer"].values.ravel()].any()


@pytest.mark.slow
def test_refined_bounds_are_those_of_a_fine_grid_for_less():
    fine = wj.viable(PUSHED, oblique_grid(96), ACTIONS)
    refined = wj.viable(PUSHED, oblique_grid(24), ACTIONS, levels=2)
    assert np.array_equal(refined["inner"], fine["inner"])
    assert np.array_equal(refined["outer"], fine["outer"])
    assert refined["mapped"].values.sum() < 0.5 * fine["mapped"].values.sum() == 0.5 * 96**2
    coarse = wj.viable(PUSHED, oblique_grid(24), ACTIONS)
    parts = lambda name: coarse[name].values.repeat(4, 0).repeat(4, 1)
    assert not (parts("inner") & ~refined["inner"].values).any()
    assert not (refined["outer"].values & ~parts("outer")).any()
    assert refined.attrs["inner_area"] > coarse.attrs["inner_area"]
    assert refined.attrs["outer_area"] < coarse.attrs["outer_area"]


def test_the_wheel_needs_cells_beside_its_least_rate_alone():
    grid = wj.Grid.plain(rate=(0.0, 1.5, 1500))
    data = wj.viable(PushedWheel(), grid, {"push": (0.0, 0.2, 8)}, levels=10)
    mapped = data["mapped"].values
    assert data["viable"].size == 1500 * 2**10 and mapped[0] == 1500 and (mapped[1:] < 20).all()
    for name in ("area", "inner_area", "outer_area"):
        assert data.attrs[name] == pytest.approx(1.5 - LEAST, abs=4e-6)
    assert data.attrs["inner_area"] < 1.5 - LEAST < data.attrs["outer_area"]


def test_cells_of_several_sizes_lead_where_their_centres_do():
    """A target of cells is that of their parts, and steps are counted among cells of all sizes."""
    grid, actions = wj.Grid.plain(rate=(0.0, 1.5, 300)), {"push": (0.0, 0.2, 8)}
    rate = grid.axes["rate"]
    target = (rate >= 0.5) & (rate < 0.6)
    data = wj.viable(PushedWheel(), grid, actions, target=target, levels=3)
    assert np.array_equal(data["capture"] == 0, target.repeat(8))
    low, high = 0.5, 0.6
    for steps in range(1, 4):
        low = max(LEAST, (low - np.sin(0.6) * 0.2) / np.cos(0.6))
        high = min(1.5, high / np.cos(0.6))
        captured = (data["capture"].values >= 0) & (data["capture"].values <= steps)
        assert captured.sum() * 1.5 / 2400 == pytest.approx(high - low, abs=1.5 / 300 * 3)
    assert np.array_equal(data["capture"] >= 0, data["viable"])
    assert np.array_equal(data["action"] >= 0, data["viable"] & (data["capture"] > 0))


@pytest.mark.parametrize("gain", [-1.0, 1.0, 0.3])
@pytest.mark.parametrize("axes", [("x",), ("x", "y"), ("x", "y", "z")])
def test_parts_at_the_edges_of_the_grid_stay_within_the_bounds(gain, axes):
    system = wj.Map(saturate, axes, parameters={"gain": gain})
    grid = wj.Grid.plain(**dict.fromkeys(axes, (0, 1, 5)))
    data = wj.viable(system, grid, {"gain": [gain]}, levels=2)
    inner, kernel, outer = (data[name].values for name in ("inner", "viable", "outer"))
    assert not (inner & ~kernel).any() and not (kernel & ~outer).any()
    assert kernel.all()  # what saturates at either border stays


@pytest.mark.slow
def test_bounds_lie_within_each_other_and_a_policy_takes_them():
    walker, actions = wj.PoweredWalker(0.004), {"push_off": (0.0, 0.08, 9)}
    coarse = wj.Grid.sheared(theta=(0.05, 0.45, 40), sum=(-0.05, 0.01, 48))
    fine = wj.Grid.sheared(theta=(0.05, 0.45, 80), sum=(-0.05, 0.01, 96))
    refined, uniform = (
        wj.viable(walker, coarse, actions, levels=1),
        wj.viable(walker, fine, actions),
    )
    inner, kernel, outer = (refined[name].values for name in ("inner", "viable", "outer"))
    assert not (inner & ~kernel).any() and not (kernel & ~outer).any()
    assert not (uniform["inner"].values & ~inner).any()
    assert outer.sum() - inner.sum() <= (uniform["outer"] ^ uniform["inner"]).sum()
    assert refined["mapped"].values.sum() < 0.6 * fine.size
    assert (refined["viable"] != uniform["viable"]).mean() < 0.01
    steered = wj.Policy(walker, refined)
    followed = wj.basin(steered, fine, "direct")["attractor"].values >= 0
    assert (followed & inner).sum() > 0.85 * inner.sum() > 0


def test_a_level_that_needs_too_much_memory_is_refused(monkeypatch):
    monkeypatch.setattr("walker_jax.checks.memory_of_machine", lambda: 2e6)
    with pytest.raises(ValueError, match="lower levels"):
        wj.viable(PUSHED, oblique_grid(24), ACTIONS, levels=2)
