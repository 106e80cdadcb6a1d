"""Areas and least disturbances change with parameters as their derivatives say."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basin import centres, settle
from walker_jax.design import (
    area_gradient,
    cells_that_walk,
    crossings_along,
    disturbance_gradient,
)

SECTION = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))


def difference(walker_of, value, width, grid, levels=5):
    """A central difference of refined areas, and its standard error."""
    low, high = (
        wj.refine(walker_of(value + step), grid, levels) for step in (-width / 2, width / 2)
    )
    error = np.hypot(float(low.total_area_error), float(high.total_area_error))
    return (float(high.total_area) - float(low.total_area)) / width, error / width


@pytest.mark.parametrize(
    ("slope", "expected"),
    # by differences of areas refined five times, at slopes 4e-4 apart, to 0.0016
    [pytest.param(0.003, -0.0985, marks=pytest.mark.slow), (0.006, -0.0410)],
)
def test_the_area_falls_with_the_slope(slope, expected):
    found = area_gradient(wj.SimplestWalker(slope), SECTION, levels=1)
    assert found.gradient[0] == pytest.approx(expected, abs=0.0016 + 0.05 * abs(expected))
    assert abs(found.gradient[0] - expected) < 0.0016 + 3 * found.error[0]
    assert found.lost == 0 and found.crossings > 500


@pytest.mark.slow
def test_two_parameters_of_another_walker():
    walker = wj.SpringWalker(0.004, 0.1)
    found = area_gradient(walker, SECTION, ("slope", "hip_stiffness"), levels=3)
    by_slope, error = difference(lambda p: wj.SpringWalker(p, 0.1), 0.004, 4e-4, SECTION)
    assert abs(found.gradient[0] - by_slope) < 3 * error + 0.1 * abs(by_slope)
    by_stiffness, error = difference(lambda p: wj.SpringWalker(0.004, p), 0.1, 2e-2, SECTION)
    assert abs(found.gradient[1] - by_stiffness) < 3 * error + 0.1 * abs(by_stiffness)
    refined = wj.refine(walker, SECTION, 5)
    assert found.area == pytest.approx(float(refined.total_area), rel=0.02)


@pytest.mark.slow
def test_the_least_disturbance_changes_with_the_slope():
    size = lambda slope: wj.least_disturbance(wj.SimplestWalker(slope)).size
    found = disturbance_gradient(wj.SimplestWalker(0.004))
    assert found.size == pytest.approx(0.0022561749204, abs=1e-12)
    central = (size(0.004 + 1e-5) - size(0.004 - 1e-5)) / 2e-5
    assert found.gradient[0] == pytest.approx(central, rel=1e-4)


def test_where_nothing_walks_there_is_no_area_and_no_gradient():
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 20), sum=(-0.02, 0.01, 20))
    found = area_gradient(wj.SimplestWalker(0.1), grid, levels=1)
    assert found.area == 0 and found.gradient.tolist() == [0.0] and found.crossings == 0


def test_where_everything_walks_the_area_is_that_of_the_grid():
    grid = wj.Grid.plain(theta=(0.1533, 0.1535, 5), thetadot=(-0.1562, -0.156, 6))
    found = area_gradient(wj.SimplestWalker(0.004), grid, levels=1)
    assert found.area == pytest.approx(4e-8) and found.gradient.tolist() == [0.0]


def test_cells_are_cut_where_they_are_on_the_boundary():
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.02, 0.01, 40))
    fine = wj.Grid.sheared(theta=(0.1, 0.3, 160), sum=(-0.02, 0.01, 160))
    direct = (wj.basin(walker, fine, "direct").attractor >= 0).values
    starts = centres(grid, np.arange(grid.size, dtype=np.int32))
    walks = cells_that_walk(walker, grid, settle(walker, starts, 1e-12, []), 2, 200, 1e-12)
    assert walks.shape == direct.shape and np.mean(walks == direct) > 0.999


def test_crossings_are_between_neighbours_that_differ():
    walks = np.array([[0, 1, 1], [0, 0, 1]], bool)
    inside, outside, rises = crossings_along(walks, 1)
    assert inside.tolist() == [[0.5, 1.5], [1.5, 2.5]]
    assert outside.tolist() == [[0.5, 0.5], [1.5, 1.5]] and rises.tolist() == [True, True]
    inside, outside, rises = crossings_along(walks, 0)
    assert inside.tolist() == [[0.5, 1.5]] and outside.tolist() == [[1.5, 1.5]]
    assert rises.tolist() == [False]


def test_wrong_arguments_are_refused():
    walker = wj.SimplestWalker(0.004)
    with pytest.raises(ValueError, match="parameter must be one of the walker's"):
        area_gradient(walker, SECTION, ("hip_stiffness",))
    with pytest.raises(ValueError, match="parameter must be one of the walker's"):
        disturbance_gradient(walker, ("mass",))
    with pytest.raises(ValueError, match="levels must not be negative"):
        area_gradient(walker, SECTION, levels=-1)
    with pytest.raises(ValueError, match="strides must be at least 1"):
        area_gradient(walker, SECTION, strides=0)
    with pytest.raises(ValueError, match="grid must have the 2 dimensions"):
        area_gradient(walker, wj.Grid.plain(theta=(0, 1, 5)))
