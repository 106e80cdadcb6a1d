"""Refinement finds what following every cell finds, with fewer strides."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome, figures
from walker_jax.basins import refinement
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.labels import Label
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.refinement import finer, refine
from walker_jax.design.area_gradients import integrate_over_basin
from walker_jax.grids import edge
from walker_jax.integrators.integrator import Integrator

WALKER = wj.SimplestWalker(0.004)
GRID = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 60))
CHECK = 50_000


@pytest.fixture(scope="module")
def refined():
    return refine(WALKER, GRID, 3, check=CHECK)


@pytest.fixture(scope="module")
def uniform():
    return wj.basin(WALKER, finer(GRID, 3), "direct")


def test_cells_that_inherited_have_fates_of_the_uniform_grid(refined, uniform):
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
    assert int(refine(WALKER, GRID, 3, check=0).strides_made) < uniformly / 4
    assert int(refined.mistaken) < 30


@pytest.mark.slow
def test_areas_of_a_hundred_seeds_are_right_within_their_errors():
    """On the 800 x 800 cells of a sweep, against 6400 x 6400 and 12,800 x 12,800."""
    exact, check = 0.00167448, 100_000  # +- 2e-7, as in benchmarks/refinement_seeds.py
    grid = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))
    found = [refine(WALKER, grid, 2, seed=seed, check=check) for seed in range(100)]
    away = np.array([float(one.total_area) for one in found]) - exact
    deviations = away / [float(one.total_area_error) for one in found]
    assert abs(deviations.mean()) < 0.3  # three standard errors of the mean
    assert 0.75 < np.sqrt(np.mean(deviations**2)) < 1.2
    assert np.mean(np.abs(deviations) < 1) > 0.55 and np.mean(np.abs(deviations) < 2) > 0.9


def test_the_same_seed_gives_the_same():
    first, again, other = (refine(WALKER, GRID, 1, check=4000, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(again.fate, first.fate)
    assert float(again.total_area) == float(first.total_area) != float(other.total_area)


def test_a_tail_that_is_met_anywhere_is_followed():
    """Of a strip thinner than a coarse cell, seen at one end only, all is found."""
    coarse = wj.Grid.sheared(theta=(0.3, 0.7, 40), sum=(-0.05, 0.03, 10))
    found = refine(WALKER, coarse, 4, check=20_000)
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
    uniform = wj.basin(walker, finer(grid, 2), "direct")
    walks = [(data.attractor >= 0).values for data in (found, uniform)]
    assert 100 < walks[1].sum() < 1500
    assert np.mean(walks[0] == walks[1]) > 0.97  # but for tails thinner than a coarse cell
    inner = ~np.logical_or(*(edge(one.astype(int)) for one in walks))
    assert (walks[0] != walks[1])[inner].sum() <= 5
    assert (found.fate.values == uniform.fate.values).mean() > 0.95
    followed, boundary = found.followed.values, found.boundary.values
    assert np.all(followed[1:] >= 4 * boundary[:-1])  # all parts of each cell on the boundary
    area, error = float(found.total_area), float(found.total_area_error)
    assert abs(area - float(uniform.area.sum())) < 4 * error < 0.2 * area


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


SQUARE = wj.Grid.plain(theta=(0, 1, 10), thetadot=(0, 1, 10))
"""Coarse cells of side 0.1, those of level 2 of side 0.025."""


def refined_by(number_of, monkeypatch, levels=2, check=4000, seed=0):
    """Refine where the attractor's number is a function of the point; all points, by call."""
    asked = []

    def labels_of(mapper, x, *, progress=None):
        asked.append(x)
        number = number_of(x).astype(np.int32)
        fate = np.where(number >= 0, Outcome.STRIDE, Outcome.FORWARD).astype(np.int8)
        return Label(fate, number, np.ones(len(x), np.int32), x)

    mapper = Mapper(WALKER, [Attractor(np.zeros((1, 2)))] * 2, Integrator(1e-12), 10)
    monkeypatch.setattr(Mapper, "walk", labels_of)
    monkeypatch.setattr(refinement, "mapper_of_scouts", lambda *_, boxes: mapper)
    options = {"strides": 10, "check": check, "seed": seed, "tolerance": None}
    return refinement.refine_cells(WALKER, SQUARE, levels, **options), asked


def cells_of(x):
    """Cells of level 2, as numbers in the flattened grid of 40 x 40."""
    row, column = np.floor(40 * x).astype(int).T
    return 40 * row + column


def test_an_island_that_no_centre_shows_is_found_whole(monkeypatch):
    """Of 3 x 3 of the finest cells, between the centres of coarse ones."""
    island = lambda x: np.where(((x > [0.475, 0.675]) & (x < [0.55, 0.75])).all(axis=1), 0, -1)
    found, asked = refined_by(island, monkeypatch)
    walks = np.zeros((40, 40), bool)
    walks[19:22, 27:30] = True
    np.testing.assert_array_equal(found.attractor >= 0, walks)
    assert found.mistaken == 0 and found.area == pytest.approx(9 / 1600, rel=1e-12)
    # 8 cells of the island and the 16 around it have neighbours of another fate; these 25 have
    # been followed, and the starts of the second check are in the 1575 others; no two points of
    # one cell differ, and one more than that is counted
    assert 3999 <= found.checked == len(asked[-2]) <= 4000 == len(asked[-1])  # rounded down
    variance = (25 / 8000 + (1575 / found.checked) ** 2) / 1600**2
    assert found.area_error == pytest.approx(np.sqrt(variance), rel=1e-12)
    assert found.followed == [100, 0, 0] and found.boundary == [0, 0, 0]  # before the check


def test_mistakes_count_by_the_cells_that_inherited(monkeypatch):
    """On one side of a line walkers walk, but from dust, which is denser near the line."""

    def number_of(x):
        within = np.mod(40 * x, 1)
        width = np.where(x[:, :1] < 0.4, 0.1, 0.25) * (x[:, :1] < 0.45)
        dust = ((within > 0.02) & (within < 0.02 + width)).all(axis=1)  # not at centres
        return np.where((x[:, 0] < 0.5) & ~dust, 0, -1)

    found, asked = refined_by(number_of, monkeypatch)
    # of 40 columns of cells 4 are followed on the finest level, beside them 4 inherited from
    # level 1, and 32 from level 0
    assert found.followed == [100, 80, 160] and found.boundary == [20, 40, 80]
    level = np.zeros((40, 40), int)
    level[16:24], level[18:22] = 1, 2
    points = asked[3:]  # after one call for each level
    first, last, redrawn = points[0], *points[-2:]
    level.ravel()[np.unique(np.concatenate([cells_of(x) for x in points[1:-2]]))] = 2
    mistaken = [number_of(x) != np.where(cells_of(x) < 800, 0, -1) for x in (first, last)]
    inherited = np.repeat([0, 1], [16, 4])  # levels of the 20 columns that walk, before the check
    wrong_at_first = np.bincount(inherited[cells_of(first)[mistaken[0]] // 40], minlength=2)
    assert all(wrong_at_first > 5)
    # of the second check, more starts where there are more cells, and more mistakes
    sizes = np.bincount(level.ravel(), minlength=3)[:2]
    shares = sizes ** (2 / 3) * (wrong_at_first + 1) ** (1 / 3)
    drawn = np.bincount(level.ravel()[cells_of(last)], minlength=2)
    np.testing.assert_array_equal(drawn, np.floor(4000 * shares / shares.sum()))
    wrong = np.bincount(level.ravel()[cells_of(last)[mistaken[1]]], minlength=2)
    assert all(wrong > 5) and found.mistaken == wrong.sum() and found.checked == drawn.sum()
    cell, walks = 1 / 1600, found.attractor >= 0
    area = (walks.sum() - (wrong * sizes / drawn).sum()) * cell  # all fall where their cell walks
    assert found.area == pytest.approx(area, rel=1e-12)
    # and of the starts in cells that were followed, half of those that differ from their cell
    followed = level.ravel() == 2
    assert len(redrawn) == 4000 and followed[cells_of(redrawn)].all()
    differ = np.count_nonzero((number_of(redrawn) >= 0) != walks.ravel()[cells_of(redrawn)])
    assert differ > 5
    variance = followed.sum() * (differ + 1) / 8000 + ((wrong + 1) * (sizes / drawn) ** 2).sum()
    variance *= cell**2
    assert found.area_error == pytest.approx(np.sqrt(variance), rel=1e-12)
    exact = 0.5 - (80 * 0.25**2 + 640 * 0.1**2) * cell
    assert abs(found.area - exact) < 3 * found.area_error < 0.02
    # and by the density of starts in each cell, where there is one
    size = integrate_over_basin(found, lambda x: np.full(len(x), 3.0))
    assert size.area == pytest.approx(3 * found.area, rel=1e-12)
    assert size.area_error == pytest.approx(3 * found.area_error, rel=1e-12)
    size = integrate_over_basin(found, lambda x: 1 - x[:, 0])
    column = np.arange(18)
    width = np.where(column < 16, 0.1, 0.25)
    dust = ((1 - (column + 0.02 + width / 2) / 40) * width**2).sum() / 40
    assert abs(size.area - (0.375 - dust)) < 3 * size.area_error < 0.02


@pytest.mark.parametrize(
    ("side", "check"), [(0.25, 400), pytest.param(0, 4000, marks=pytest.mark.slow)]
)
def test_areas_of_many_seeds_scatter_as_is_said(side, check, monkeypatch):
    """Of what is beside a slanting line, with or without dust, of which checks find a part."""

    def number_of(x):
        dust = (np.mod(40 * x - 1 / 8, 1) < side).all(axis=1)  # a sixteenth, but no centre
        return np.where((x[:, 0] + x[:, 1] / 8 < 0.4) & ~dust, 0, -1)

    fine = finer(SQUARE, 5)  # 8 x 8 of its centres are in each cell of level 2
    exact = np.mean(number_of(fine.centres(np.arange(fine.size))) >= 0)
    found = [refined_by(number_of, monkeypatch, check=check, seed=seed)[0] for seed in range(64)]
    assert sum(one.mistaken for one in found) >= 800 * side
    away = np.array([one.area for one in found]) - exact
    error = np.sqrt(np.mean([one.area_error**2 for one in found]))
    assert abs(away.mean()) < 3 / 8 * error  # three standard errors of a mean of 64
    assert 0.75 < np.sqrt(np.mean(away**2)) / error < 1.2


def test_the_error_of_boundary_cells_is_of_shares_that_walk(monkeypatch):
    """Of a line along the middle of cells, f (1 - f) is 1/4 in these, and 0 in those beside."""
    line = lambda x: np.where(x[:, 0] < 0.5125, 0, -1)
    found, _ = refined_by(line, monkeypatch, check=20_000)
    mixed = edge((found.attractor >= 0).astype(int))
    assert found.mistaken == 0 and mixed[20].sum() > 30
    # and little for a mistake of the check on each level that was not found
    variance = (found.area_error * 1600) ** 2
    assert variance == pytest.approx(mixed[20].sum() / 4, rel=0.05)


def test_between_attractors_is_a_boundary_but_no_edge(monkeypatch):
    above = lambda x: (x[:, 1] > 0.5).astype(int)
    found, _ = refined_by(above, monkeypatch, check=100)
    assert found.followed == [100, 80, 160] and found.boundary == [20, 40, 80]
    np.testing.assert_array_equal(found.attractor, np.tile(np.repeat([0, 1], 20), (40, 1)))
    assert found.area == pytest.approx(1, rel=1e-12) and found.mistaken == 0
    # starts of the check go by the sizes to the power of 2/3
    sizes = np.array([1280, 160])
    counts = np.floor(100 * sizes ** (2 / 3) / (sizes ** (2 / 3)).sum())
    # no two points of the 160 cells followed last differ in whether they walk
    variance = (160 / 200 + ((sizes / counts) ** 2).sum()) / 1600**2
    assert found.area_error == pytest.approx(np.sqrt(variance), rel=1e-12)
    few, _ = refined_by(above, monkeypatch, check=1)
    assert few.checked == 2  # one at least for each level


@pytest.mark.parametrize("levels", [0, 2])
def test_without_a_check_the_error_is_the_edges_or_unknown(levels, monkeypatch):
    left = lambda x: np.where(x[:, 0] < 0.5, 0, -1)
    found, _ = refined_by(left, monkeypatch, levels=levels, check=0)
    assert found.area == pytest.approx(0.5, rel=1e-12) and found.checked == 0
    expected = np.nan if levels else np.sqrt(20 / 12) * 0.01  # two columns of cells
    assert found.area_error == pytest.approx(expected, rel=1e-12, nan_ok=True)


def test_edges_are_cells_beside_others():
    label = np.zeros((5, 6), int)
    label[2, 3] = 1
    expected = np.zeros((5, 6), bool)
    expected[1:4, 2:5] = True
    np.testing.assert_array_equal(edge(label), expected)
    np.testing.assert_array_equal(edge(np.ones((3, 4, 2), int)), np.zeros((3, 4, 2), bool))
