"""Refinement finds what following every cell finds, with fewer strides."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome, figures
from walker_jax.refinement import cut, edge, finer, refine

WALKER = wj.SimplestWalker(0.004)
GRID = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 60))
CHECK = 50_000


@pytest.fixture(scope="module")
def refined():
    return refine(WALKER, GRID, 3, check=CHECK)


@pytest.fixture(scope="module")
def uniform():
    return wj.basin(WALKER, finer(GRID, 3), "direct")


def test_cells_that_inherited_have_the_fates_of_the_uniform_grid(refined, uniform):
    assert refined.fate.shape == uniform.fate.shape == (800, 480)
    np.testing.assert_allclose(refined.theta, uniform.theta)
    inner = ~edge(np.where(uniform.attractor >= 0, 99, uniform.fate))
    inner &= ~edge(np.where(refined.attractor >= 0, 99, refined.fate))
    assert 0.8 < inner.mean()
    same = refined.fate.values == uniform.fate.values
    assert (~same & inner).sum() <= 20  # of tails that are thinner than a cell
    assert same.mean() > 0.95
    np.testing.assert_allclose(refined.states, uniform.states, rtol=0, atol=1e-9)


def test_the_area_is_that_of_a_finer_grid_within_its_error(refined):
    exact = 0.00120739  # by 4000 x 4000 cells, followed directly
    area, error = float(refined.total_area), float(refined.total_area_error)
    assert abs(area - exact) < 3 * error
    assert error < 0.002 * exact
    assert abs(float(refined.area.sum()) - area) < 5 * error


def test_strides_are_spent_on_the_boundary(refined, uniform):
    followed, boundary = refined.followed.values, refined.boundary.values
    assert followed[0] == GRID.size and len(followed) == len(boundary) == 4
    # a line has twice as many cells on a grid twice as fine, a fractal somewhat more
    ratio = boundary[1:] / boundary[:-1]
    assert np.all((1.8 < ratio) & (ratio < 2.8))
    assert np.all(followed[1:] < 5 * boundary[:-1])
    uniformly = uniform.strides.values.sum() + (uniform.fate.values != Outcome.STRIDE).sum()
    assert int(refined.strides_made) - 4 * int(refined.checked) < uniformly / 4
    assert int(refined.mistaken) < 30


@pytest.mark.slow
def test_errors_are_as_large_as_is_said():
    """Twelve draws, against the area of a fine grid, in units of the error that each states."""
    found = [refine(WALKER, GRID, 1, seed=seed, check=10_000) for seed in range(12)]
    areas = np.array([float(one.total_area) for one in found])
    errors = np.array([float(one.total_area_error) for one in found])
    deviations = (areas - 0.00120739) / errors
    assert np.mean(np.abs(deviations) < 2) >= 0.8
    assert 0.4 < deviations.std() < 1.5
    assert len(set(areas)) > 5


def test_the_same_seed_gives_the_same(refined):
    again = refine(WALKER, GRID, 3, check=CHECK)
    np.testing.assert_array_equal(again.fate, refined.fate)
    assert float(again.total_area) == float(refined.total_area)


def test_a_tail_that_is_met_anywhere_is_followed():
    """Of a strip thinner than a coarse cell, seen at one end only, all is found."""
    coarse = wj.Grid.sheared(theta=(0.3, 0.7, 40), sum=(-0.05, 0.03, 10))
    found = refine(WALKER, coarse, 4)
    uniform = wj.basin(WALKER, finer(coarse, 4), "direct")
    walks = [(data.attractor >= 0).values for data in (found, uniform)]
    assert walks[1].sum() > 50
    deep = walks[1] & ~edge(walks[1].astype(int))
    assert np.mean(walks[0][deep]) > 0.99
    area, error = float(found.total_area), float(found.total_area_error)
    assert abs(area - float(uniform.area.sum())) < 4 * error


def test_no_levels_give_the_coarse_grid_by_random_points():
    found = refine(WALKER, GRID, 0, check=0)
    assert found.fate.shape == GRID.shape and int(found.checked) == 0
    assert found.followed.values.tolist() == [GRID.size]
    assert float(found.total_area) == pytest.approx(float(found.area.sum()))


@pytest.mark.slow
def test_a_slice_of_three_dimensions_is_refined():
    walker = wj.RoundFootWalker(0.01)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 12), sum=(-0.12, 0, 10), phidot=-0.045)
    found = refine(walker, grid, 2, check=500)
    assert found.fate.shape == (48, 40) and float(found.phidot) == -0.045
    assert 0 < (found.fate == 0).sum() < found.fate.size


def test_the_result_is_drawn_like_a_basin(refined):
    axes = figures.basin(refined)
    assert len(axes.get_images()) == 1


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="levels must be at least 0, not -1"):
        refine(WALKER, GRID, -1)
    with pytest.raises(ValueError, match="levels must be at most 30, not 1000"):
        refine(WALKER, GRID, 1000)
    with pytest.raises(ValueError, match="seed must be at least 0, not -1"):
        refine(WALKER, GRID, 1, seed=-1)
    with pytest.raises(ValueError, match="check must be at least 0"):
        refine(WALKER, GRID, 1, check=-5)
    with pytest.raises(ValueError, match="strides must be at least 1"):
        refine(WALKER, GRID, 1, strides=0)
    with pytest.raises(ValueError, match=r"grid of .* needs .* GiB"):
        refine(WALKER, wj.Grid.sheared(theta=(0, 1, 1000), sum=(0, 1, 1000)), 5)
    with pytest.raises(ValueError, match="3 dimensions"):
        refine(wj.RoundFootWalker(0.01), GRID, 1)


def test_edges_are_cells_beside_others():
    label = np.zeros((5, 6), int)
    label[2, 3] = 1
    expected = np.zeros((5, 6), bool)
    expected[1:4, 2:5] = True
    np.testing.assert_array_equal(edge(label), expected)
    np.testing.assert_array_equal(edge(np.ones((3, 4, 2), int)), np.zeros((3, 4, 2), bool))
    np.testing.assert_array_equal(cut(np.array([[1, 2]])), [[1, 1, 2, 2]] * 2)
