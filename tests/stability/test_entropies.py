"""Basin entropy and the Wada property, of labels whose boundary is known."""

import numpy as np
import pytest
from test_boundaries import snowflake

import walker_jax as wj
from walker_jax.fractals.wada import boundary_of

SEVENTH = 7


def cantor(generations):
    """Which of three gaps each of 7^generations cells is in: 0, 1 and 2 in turn.

    Of seven parts of a cell the second, fourth and sixth are gaps; the others repeat the whole. The
    centres of the cells that are left fall into the middle gap.
    """
    labels = np.array([1])
    for _ in range(generations):
        rest = len(labels)
        gaps = [np.full(rest, gap) for gap in range(3)]
        labels = np.concatenate([labels, gaps[0], labels, gaps[1], labels, gaps[2], labels])
    return labels


def newton(n, side=4.0):
    """Which root of z^3 = 1 Newton's method goes to, on an n x n grid."""
    t = ((np.arange(n) + 0.5) / n - 0.5) * side
    z = t[:, None] + 1j * t
    for _ in range(60):
        z = z - (z**3 - 1) / (3 * z**2)
    roots = np.exp(2j * np.pi * np.arange(3) / 3)
    return np.abs(z[..., None] - roots).argmin(axis=-1)


def test_the_entropy_of_a_cantor_set_is_log_3_in_its_boxes():
    """Of 7^k boxes 4^k hold the whole again, with a third of each label but for what is not told.

    That is by arithmetic: gaps of all generations up to m make (1 - (4/7)^m) / 3 of each label.
    """
    inner, outer = 4, 2
    labels, side = cantor(inner + outer), SEVENTH**inner
    left = (4 / 7) ** inner
    p = np.array([(1 - left) / 3, (1 - left) / 3 + left, (1 - left) / 3])
    each = -np.sum(p * np.log(p))
    # of boxes at their own places, not at all places: those are what the arithmetic is of
    boxes = labels.reshape(-1, side)
    found = [wj.fractals.basin_entropy(box, side) for box in boxes]
    assert {one.boxes for one in found} == {1}
    mixed = np.array([one.value for one in found])
    np.testing.assert_allclose(mixed[mixed > 0], each, rtol=1e-12)
    assert (mixed > 0).sum() == 4**outer
    assert np.log(2) < each < np.log(3)


@pytest.mark.parametrize("side", [2, 5, 20])
def test_the_entropy_of_a_straight_boundary(side):
    """At all places of a box the shares are 1, 2 ... of side: their mean tends to a half."""
    labels = np.zeros((80, 60), int)
    labels[33:] = 7
    p = np.arange(1, side) / side
    expected = np.mean(-p * np.log(p) - (1 - p) * np.log(1 - p))
    found = wj.fractals.basin_entropy(labels, side)
    assert found.boundary == pytest.approx(expected, rel=1e-12)
    places = (80 - side + 1) * (60 - side + 1)
    assert (found.boxes, found.mixed) == (places, (side - 1) * (60 - side + 1))
    assert found.value == pytest.approx(expected * found.mixed / places, rel=1e-12)
    assert not found.fractal and abs(found.boundary - 0.5) < 0.5 * 1.6 / side
    assert wj.fractals.basin_entropy(np.ones((9, 9), int), 3)[:1] == (0,)
    assert found.crowded == 0


def test_the_entropy_is_that_of_a_loop_over_labelled_boxes():
    labels = np.random.default_rng(0).integers(0, 4, (17, 13))
    labels[3, 4] = -1
    values, crowded = [], 0
    for i in range(17 - 3):
        for j in range(13 - 3):
            box = labels[i : i + 4, j : j + 4]
            if (box >= 0).all():
                p = np.unique(box, return_counts=True)[1] / 16
                values.append(-(p * np.log(p)).sum())
                crowded += len(p) > 2
    found = wj.fractals.basin_entropy(labels, 4)
    assert found.boxes == len(values) and found.value == pytest.approx(np.mean(values))
    assert found.crowded == crowded > 0
    assert wj.fractals.basin_entropy(np.where(labels < 0, np.nan, labels), 4) == found


def test_smooth_stripes_wider_than_a_cell_are_not_fractal():
    """Boxes of five cells hold three of them, and exceed log 2; boxes of two and three do not."""
    for width in (2, 3, 4):
        for labels in (2, 3):
            found = wj.fractals.basin_entropy(
                np.arange(400)[:, None] // width % labels * np.ones(400, int)
            )
            assert not found.fractal and found.excess < 0
        assert (found.boundary - 2 * found.boundary_error > np.log(2)) == (width < 4)
        assert (found.crowded > 0) == (width < 4)


ROW, COLUMN = np.indices((400, 400))
SMOOTH = {
    "circle": np.hypot(ROW - 200, COLUMN - 190) < 150,
    "small circle": np.hypot(ROW - 200, COLUMN - 190) < 5,
    "rings": np.hypot(ROW - 200, COLUMN - 200) // 10 % 2,
    "dots": np.hypot(ROW % 20 - 10, COLUMN % 20 - 10) < 5,
    "diagonal": ROW + COLUMN < 399,
    "slope of 2": 2 * ROW + COLUMN < 500,
    "slope of 3/7": 3 * ROW + 7 * COLUMN < 2000,
    "wave": ROW - 150 - 10 * np.sin(COLUMN / 10) > 0,
    "corner": (ROW > 200) & (COLUMN > 200),
    "squares": (ROW // 5 + COLUMN // 5) % 2,
    "sectors": np.arctan2(ROW - 200.3, COLUMN - 200.7) * 8 / np.pi // 1 % 2,
    "finger": np.abs(ROW - 200) < (400 - COLUMN) / 40,
    "nothing": 0 * ROW,
}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_boundaries_of_two_basins_are_not_fractal(name):
    for side in (2, 5, 20):
        assert not wj.fractals.basin_entropy(SMOOTH[name].astype(int), side).fractal


def grebogi(n):
    """Return which of two fixed points each start goes to (Grebogi and others 1983).

    The dimension of the boundary is 1.8, its entropy in boxes of 6 is 0.60 to 0.61.
    """
    share = (np.arange(n) + 0.5) / n
    t, x = np.meshgrid(2 * np.pi * share, share - 0.5, indexing="ij")
    for _ in range(80):
        t, x = 1.32 * np.sin(2 * t) - 0.9 * np.sin(4 * t) - x * np.sin(t) + t, -0.3 * np.cos(t)
    return (np.cos(t) > 0).astype(int)


def test_a_fractal_boundary_of_two_basins_is_fractal():
    labels = grebogi(400)
    assert 0.60 < wj.fractals.basin_entropy(labels, 6).boundary < 0.61 < np.log(2)
    for side in (2, 5, 20):
        found = wj.fractals.basin_entropy(labels, side)
        assert found.fractal and 0 < found.excess_error < 0.02
        assert 0.6 < found.excess < 0.8  # planes in boxes of few cells grow a little faster
    line = wj.fractals.basin_entropy(labels[:, 7], 5)  # across: a set of points of dimension 0.8
    assert line.fractal and line.excess > 0.4
    assert wj.fractals.basin_entropy(snowflake(grid_points(400))).fractal  # log 4 / log 3 = 1.26


def grid_points(n):
    share = (np.arange(n) + 0.5) / n - 0.5
    return 1.4 * np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1)


def test_too_little_of_a_boundary_is_no_evidence():
    labels = np.zeros((64, 64), int)
    labels[3:5, 3:5] = np.eye(2)
    found = wj.fractals.basin_entropy(labels)
    assert np.isnan(found.excess) and np.isnan(found.excess_error) and not found.fractal
    assert not wj.fractals.basin_entropy(np.eye(2, dtype=int), 2).fractal


def test_cells_of_no_label_make_no_boundary():
    """Boxes that hold one are left out, on all sizes, so that a line beside them stays a line."""
    labels = (ROW > 200).astype(int)
    labels[np.hypot(ROW - 200, COLUMN - 200) < 80] = -1
    labels[:, 300:][(ROW + COLUMN)[:, 300:] % 40 == 0] = -1
    assert not wj.fractals.basin_entropy(labels).fractal


def test_a_plane_in_space_is_not_fractal_and_noise_is():
    i, j, k = np.indices((40, 40, 40))
    for plane in (i, i + j, i + 2 * j + 3 * k):
        assert not wj.fractals.basin_entropy((plane > plane.mean()).astype(int)).fractal
    noise = np.random.default_rng(0).integers(0, 2, i.shape)
    assert wj.fractals.basin_entropy(noise).excess == pytest.approx(1, abs=0.1)


def test_the_entropy_of_newtons_method_goes_with_its_dimension():
    """Sb goes like the box's side to the power 2 - D (Daza and others 2016), with D = 1.4445 by
    inverse iteration, as in test_boundaries."""
    coarse, fine = (wj.fractals.basin_entropy(newton(n)) for n in (400, 800))
    assert coarse.fractal and fine.fractal
    assert np.log(2) < fine.boundary < np.log(3)
    assert coarse.boundary == pytest.approx(fine.boundary, abs=0.02)
    assert 2 - np.log2(coarse.value / fine.value) == pytest.approx(1.4445, abs=0.02)


def test_newton_s_basins_are_wada():
    """All three have the Julia set for their boundary: it is one, in cells, on every grid."""
    found = wj.fractals.merge_regions(newton(400))
    assert found.wada and (found.share == 0).all()
    assert found.distances.shape == (4, 3, 3) and found.spacings.tolist() == [1, 2, 4, 8]
    # the same few cells on every grid: half the distance on one twice as fine
    farthest = found.distances.max(axis=(1, 2))
    assert (farthest <= 5 * found.spacings).all() and farthest[0] < 0.5 * farthest[-1]
    assert (found.mean_distances <= found.distances).all()


def test_a_wada_boundary_may_have_few_points_beyond_the_radius():
    """Whatever the radius: the trend of the distances tells, and the share is given."""
    for radius in (3, 2):
        found = wj.fractals.merge_regions(newton(400), radius)
        assert found.wada and 0 < found.share[0] < 0.005
    # a disc of one basin inside another has a boundary of its own, as small as that share
    labels = newton(400)
    i, j = np.indices(labels.shape)
    labels[np.hypot(i - 360, j - 200) < 4] = 1
    found = wj.fractals.merge_regions(labels)
    assert not found.wada and 0 < found.share[0] < 0.01


def test_a_cantor_set_is_wada_but_not_with_a_region_aside():
    labels = cantor(5)
    assert wj.fractals.merge_regions(labels, 21, halvings=1).wada
    found = wj.fractals.merge_regions(labels, 21, halvings=0)
    assert (found.share == 0).all() and not found.wada  # with nothing to compare it to
    beside = np.concatenate([labels, np.full(4000, 3)])
    found = wj.fractals.merge_regions(beside, 21, halvings=0)
    assert not found.wada
    # the boundary of the fourth is one point; all others' reach to the other end
    assert found.distances[0, :3, 3].min() > 10_000 and found.distances[0, 3, :3].max() < 7**4


def test_three_stripes_are_not_wada_whatever_the_resolution():
    """Two boundaries, 40 apart: that of the middle is both, those of the others are one each."""
    labels = np.repeat([0, 1, 2], 40)[:, None] * np.ones(60, int)
    found = wj.fractals.merge_regions(labels, 3, halvings=2)
    assert not found.wada and (found.share > 0).all()
    assert found.distances[0, 0, 2] == found.distances[0, 2, 0] == found.distances[0, 1, 0] == 40
    assert found.distances[0, 0, 1] == 0
    np.testing.assert_array_equal(found.beyond[0], [[0, 0, 1], [0.5, 0, 0.5], [1, 0, 0]])
    # of a cell each, they are like Wada's on the grid
    assert wj.fractals.merge_regions(
        np.arange(60)[:, None] % 3 * np.ones(60, int), 1, halvings=1
    ).wada
    assert not wj.fractals.merge_regions(np.arange(60)[:, None] // 2 % 3 * np.ones(60, int)).wada


@pytest.mark.parametrize("width", [1, 1.5, 2, 3, 5])
def test_two_curves_within_the_radius_are_not_wada(width):
    """Every point of a boundary is near each other one, but no nearer on finer grids."""
    x, y = np.indices((400, 400))
    beyond = x - 150 - 40 * np.sin(y / 60)
    found = wj.fractals.merge_regions(np.digitize(beyond, [0, width]))
    assert (found.share[0] == 0) and not found.wada


def test_regions_without_a_boundary_are_not_wada():
    labels = np.full((48, 48), -1)
    labels[2:10], labels[20:28], labels[36:44] = 0, 1, 2
    found = wj.fractals.merge_regions(labels, halvings=2)
    assert not found.wada and np.isnan(found.share).all() and np.isnan(found.distances).all()
    # a region that only the finest grid sees is left out of the others
    labels = np.zeros((64, 64), int)
    labels[:, 32:] = 1
    labels[31, 31] = 2
    found = wj.fractals.merge_regions(labels)
    assert found.share[0] > 0.5 and not found.wada
    np.testing.assert_array_equal(found.share[1:], 0)
    assert np.isnan(found.distances[1:, 2]).all() and np.isnan(found.distances[1:, :, 2]).all()


def test_a_boundary_is_between_regions_not_at_points_of_none():
    inside, outside = np.zeros((6, 6), bool), np.zeros((6, 6), bool)
    inside[:2], outside[3:] = True, True  # a row of none is between
    assert boundary_of(inside, outside)[2].all() and boundary_of(inside, outside).sum() == 6
    labels = np.where(inside, 0, np.where(outside, 1, -1))
    labels[3:, 3:] = 2
    assert wj.fractals.merge_regions(labels, 1, halvings=0).labels.tolist() == [0, 1, 2]


def test_what_has_no_such_measure_is_refused():
    with pytest.raises(ValueError, match="side must be at most 2, that of the labels, not 5"):
        wj.fractals.basin_entropy(np.zeros((2, 2), int))
    with pytest.raises(ValueError, match="3 regions or more, not of 2"):
        wj.fractals.merge_regions(np.eye(64, dtype=int))
    with pytest.raises(ValueError, match="halvings=9"):
        wj.fractals.merge_regions(np.arange(4096).reshape(64, 64) % 3, halvings=9)
