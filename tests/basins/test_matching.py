"""Attractors of neighbouring walkers have the same number where they are near."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import figures
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.labels import Label
from walker_jax.basins.matching import match_cycles, number_alike
from walker_jax.fingerprints import code_fingerprint
from walker_jax.gaits.cycles import cycle_distance
from walker_jax.stability import basin_fractions
from walker_jax.stability.basin_fractions import Found, assemble, summarise_fractions
from walker_jax.storage.schema import check_dataset

REGION = wj.Grid.sheared(theta=(0.1, 0.3, 10), sum=(-0.03, 0.01, 10))


def test_a_cycle_is_the_same_from_whichever_state_it_begins():
    cycle = np.array([[0.1, -0.2], [0.2, -0.1], [0.3, -0.3]])
    assert cycle_distance(cycle, np.roll(cycle, 2, axis=0)) == 0
    assert cycle_distance(cycle, np.roll(cycle, 1, axis=0) + 0.01) == pytest.approx(0.01)
    assert cycle_distance(cycle, cycle[:2]) == np.inf


def test_each_known_cycle_is_matched_once_and_by_the_nearest():
    at = lambda x: np.array([[x, 0.0]])
    assert match_cycles([at(0.02), at(0.05)], [at(0.06), at(0.0)], 0.1) == [1, 0]
    assert match_cycles([at(0.02), at(0.03)], [at(0.0)], 0.1) == [0, -1]
    assert match_cycles([at(0.2)], [at(0.0)], 0.1) == [-1]


def test_crossing_and_doubling_attractors_keep_their_numbers():
    """A made-up family: one rises and the other falls.

    They are never in the same order twice, and the one ends where a cycle of two is born.
    """
    periods = np.full((6, 3), -1)
    states = np.full((6, 3, 2, 2), np.nan)
    for i in range(6):
        low, high = np.array([0.05 * i, 0.0]), np.array([0.25 - 0.04 * i, 0.3])
        order = [low, high] if low[0] < high[0] else [high, low]
        periods[i, :2] = 1
        states[i, :2, 0] = order
        if i >= 4:
            which = int(order[1] is high)
            periods[i, which] = 2
            states[i, which] = high - 0.02, high + 0.02
    numbers = number_alike(periods, states)
    assert (numbers[:, 2] == -1).all()
    rising = [numbers[i, np.argmin(np.abs(states[i, :2, 0, 1]))] for i in range(6)]
    falling = [numbers[i, np.argmax(np.abs(states[i, :2, 0, 1]))] for i in range(6)]
    assert rising == [0] * 6 and falling == [1] * 4 + [2] * 2


def test_a_cycle_is_matched_with_that_of_the_nearest_walker():
    """A gait that moves by 0.25 along a row of walkers has the same number in the next row."""
    periods, states = np.ones((2, 6, 1), int), np.zeros((2, 6, 1, 1, 2))
    states[..., 0, 0, 0] = 0.05 * np.arange(6)
    np.testing.assert_array_equal(number_alike(periods, states), 0)


def test_motions_without_a_period_have_one_number():
    periods = np.array([[[1], [0]], [[-1], [0]]])
    states = np.zeros((2, 2, 1, 1, 2))
    np.testing.assert_array_equal(number_alike(periods, states)[..., 0], [[0, 1], [-1, 1]])


@pytest.fixture(scope="module")
def followed():
    slopes = [0.0122, 0.0125, 0.0145, 0.0155, 0.0195]
    return wj.continue_basins(wj.SimplestWalker(0.004), "slope", slopes, REGION, samples=1000)


@pytest.mark.slow
def test_fractions_are_those_of_refined_areas():
    """Of the paper's window, through two period doublings; 3.5 standard errors of the starts."""
    slopes, window = [0.004, 0.012, 0.016, 0.018], 0.4 * 0.05
    region = wj.Grid.sheared(theta=(0.0, 0.4, 200), sum=(-0.04, 0.01, 250))
    found = wj.continue_basins(wj.SimplestWalker(0.004), "slope", slopes, region, samples=200_000)
    for i, slope in enumerate(slopes):
        share = float(found["fraction"][i].sum())
        error = float((found["fraction_high"] - found["fraction_low"])[i].sum()) / (2 * 1.96)
        area = float(wj.refine(wj.SimplestWalker(slope), region, levels=4)["area"].sum())
        assert abs(share - area / window) < 3.5 * error


def test_attractors_begin_and_end_at_bifurcations(followed):
    check_dataset(followed, "basin fractions")
    period, first, last = (followed[name].values for name in ("period", "first", "last"))
    long, three, two = (int(np.flatnonzero(period == k)[0]) for k in (1, 3, 2))
    assert (first[long], last[long]) == (0.0122, 0.0145)
    assert (first[three], last[three]) == (0.0125, 0.0125)
    assert (first[two], last[two]) == (0.0155, 0.0155)
    events = {
        (int(name), bool(fold)): float(value)
        for name, fold, value in zip(
            followed["event_attractor"],
            followed["event_fold"],
            followed["event_value"],
            strict=True,
        )
    }
    doubling = events[long, False]
    assert last[long] < doubling < first[two]
    assert doubling == pytest.approx(0.0150884379, abs=1e-9)
    assert events[three, True] < 0.0125 < events[three, False]


def test_fractions_are_those_of_direct_iteration(followed):
    walker = wj.SimplestWalker(0.0125)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 200), sum=(-0.03, 0.01, 200))
    cells = wj.basin(walker, grid, "direct", strides=500)
    expected = cells["cells"].values[np.argsort(cells["period"].values)] / grid.size
    here = followed.sel(value=0.0125)
    present = np.flatnonzero(np.isfinite(here["fraction"]))
    order = present[np.argsort(here["period"].values[present])]
    for share, name in zip(expected, order, strict=True):
        low, high = here["fraction_low"][name], here["fraction_high"][name]
        assert low - 0.002 < share < high + 0.002
    whole = followed["fraction"].fillna(0).sum("attractor") + followed["failed"].sum("outcome")
    np.testing.assert_allclose(whole, 1, atol=1e-12)


def test_what_is_not_there_has_no_state_and_no_fraction(followed):
    assert not np.isfinite(followed["fraction"].sel(value=0.0195)).any()
    present = np.isfinite(followed["fraction"])
    assert (np.isfinite(followed["states"][..., 0, 0]) == present).all()
    answer = summarise_fractions(followed)
    assert [one["period"] for one in answer["attractors"]] == [1, 3, 2]


def test_the_picture_stacks_what_there_is(followed):
    above, below = figures.basin_fractions(followed).axes
    assert len(below.patches) == followed.sizes["attractor"]
    assert above.get_xlim() == below.get_xlim() == (0.0122, 0.0195)
    top = max(np.max(np.asarray(patch.get_path().vertices)[:, 1]) for patch in below.patches)
    assert top == pytest.approx(float(followed["fraction"].sum("attractor").max()))
    drawn: Any = below.collections
    bars = np.concatenate([np.stack(one.get_segments()) for one in drawn])
    wide = (followed["fraction_high"] - followed["fraction_low"]).values.T
    np.testing.assert_allclose(np.ptp(bars[:, :, 1], axis=1), wide[wide > 0], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "words"),
    [([0.004], "two or more"), ([0.005, 0.004], "ascending"), ([0.004, -1.0], "ascending")],
)
def test_values_that_are_not_in_order_are_refused(values, words):
    with pytest.raises(ValueError, match=words):
        wj.continue_basins(wj.SimplestWalker(0.004), "slope", values, REGION)


def test_a_sweep_keeps_states_of_attractors_and_their_numbers():
    slopes = [0.0122, 0.0125]
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.03, 0.01, 40))
    swept = wj.sweep(wj.SimplestWalker(0.004), {"slope": slopes}, grid, levels=0, check=0)
    check_dataset(swept, "sweep")
    for slope in slopes:
        here = swept.sel(slope=slope)
        gait = wj.find_gait(wj.SimplestWalker(slope))
        i = int(np.flatnonzero(here["attractor_period"] == 1)[0])
        np.testing.assert_allclose(here["attractor_states"][i, 0], gait.states[0], atol=1e-9)
        assert int(here["attractor_number"][i]) == 0
    count = (swept["attractor_period"] >= 0).sum("own")
    np.testing.assert_array_equal(count, swept["attractors"])
    np.testing.assert_array_equal((swept["attractor_number"] >= 0).sum("own"), count)


def test_two_gaits_of_a_turning_branch_have_the_sum_of_shares():
    gaits = [Attractor(np.array([[theta, -0.2]])) for theta in (0.2, 0.3)]
    labels = Label(
        np.zeros(100, np.int8),
        np.repeat([0, 1], [70, 30]),
        np.ones(100, np.int32),
        np.zeros((100, 2)),
    )
    data = assemble(np.array([0.004]), [Found([0, 0], gaits, labels)], [None], 100)
    assert data["fraction"].item() == 1 and data["failed"].sum() == 0
    assert data["states"].values[0, 0, 0].tolist() == [0.2, -0.2]


def test_a_walker_of_ones_own_leaves_a_fingerprint_of_its_code(monkeypatch):
    class Mine(wj.SimplestWalker):
        """The simplest walker by another name."""

    class Nothing:
        branches = ()

        def __init__(self, *_):
            pass

        def attractors_at(self, *_):
            pass

    monkeypatch.setattr(basin_fractions, "Family", Nothing)
    monkeypatch.setattr(basin_fractions, "assemble", lambda *_: xr.Dataset())
    about = [
        wj.continue_basins(kind(0.004), "slope", [0.004, 0.005], REGION, samples=10).attrs
        for kind in (wj.SimplestWalker, Mine)
    ]
    assert "code" not in about[0] and about[1]["code"] == code_fingerprint(Mine)
    assert not any("walker_slope" in one for one in about)
