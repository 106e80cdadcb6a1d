"""Grids, and the simple cell map against a sequential transcription and known basins."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from walker_jax.cellmaps import CellMap, cell_image, resolve
from walker_jax.grids import MAX_SIZE, Grid

SINKS = 3
LEAVE = 2

GRIDS = [
    Grid.plain(x=(-1, 1, 1)),
    Grid.plain(x=(-1.5, 1.5, 301)),
    Grid.plain(theta=(0, 0.4, 20), thetadot=(-0.4, 0.0, 33)),
    Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250)),
    Grid.plain(a=(0, 1, 2), b=(-3, 7.5, 7), c=(1e3, 2e3, 5)),
    Grid.sheared(theta=(0.1, 0.4, 7), sum=(-0.3, 0.1, 11), rest=(-1e-6, 1e-6, 3)),
    Grid({"p": (0, 1, 6), "q": (-2, 1, 4)}, np.array([[2.0, 0.5], [-1.0, 3.0]])),
]
THE_SEVERAL = pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: "-".join(grid.names))

MOST = max(grid.size for grid in GRIDS)


def of_many(function):
    """A function of a grid and each of some numbers, compiled once for any number of them."""
    compiled = jax.jit(jax.vmap(function, in_axes=(None, 0)))

    def look(grid, each):
        each = np.asarray(each)
        padded = np.zeros((MOST, *each.shape[1:]), each.dtype)
        padded[: len(each)] = each
        return np.asarray(compiled(grid, padded))[: len(each)]

    return look


cell_of = jax.jit(Grid.cell)
cells_of, centres_of = of_many(Grid.cell), of_many(Grid.centre)


# Grids


@THE_SEVERAL
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_every_cell_holds_its_centre(grid, dtype):
    grid = jax.tree.map(lambda x: x.astype(dtype) if x.dtype == np.float64 else x, grid)
    index = np.arange(grid.size)
    centres = centres_of(grid, index)
    assert centres.shape == (grid.size, len(grid.names)) and centres.dtype == dtype
    cells = cells_of(grid, centres)
    assert cells.dtype == np.int32
    np.testing.assert_array_equal(cells, index)


@THE_SEVERAL
def test_cells_are_in_c_order_along_the_box_axes(grid):
    box = np.stack(np.meshgrid(*grid.axes.values(), indexing="ij"), axis=-1)
    assert box.shape == (*grid.shape, len(grid.names)) and tuple(grid.axes) == grid.names
    centres = centres_of(grid, np.arange(grid.size))
    expected = (box @ grid.shear.T).reshape(grid.size, -1)
    np.testing.assert_allclose(centres, expected, rtol=1e-13, atol=1e-15)


@THE_SEVERAL
def test_a_point_is_within_half_a_cell_or_off_the_grid(grid):
    width, random = grid.upper - grid.lower, np.random.default_rng(0)
    points = random.uniform(grid.lower - 0.2 * width, grid.upper + 0.2 * width, (1000, len(width)))
    cells = cells_of(grid, points @ grid.shear.T)
    on_it = np.all((grid.lower <= points) & (points <= grid.upper), axis=1)
    np.testing.assert_array_equal(cells >= 0, on_it)
    places = np.unravel_index(cells[on_it], grid.shape)
    pairs = zip(grid.axes.values(), places, strict=True)
    centres = np.stack([axis[i] for axis, i in pairs], axis=1)
    assert np.all(abs(points[on_it] - centres) <= 0.5 * grid.spacing * (1 + 1e-9))


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
def test_on_the_host_cells_are_the_same(dtype):
    axes = {"theta": (0.0, 0.4, 13), "thetadot": (-0.5, 0.1, 7)}
    grids = [Grid.plain(**axes), Grid(axes, np.array([[1, 0.3], [-1, 2]]), np.array([0.1, -0.2]))]
    with jax.enable_x64(dtype == np.float64):
        for grid in grids:
            index = np.arange(grid.size)
            centres = grid.centres(index)
            assert centres.dtype == dtype
            np.testing.assert_array_equal(centres, jax.vmap(grid.centre)(index.astype(np.int32)))
            edges = grid.points_at(np.array([[0, 0], [1, 0.5], [0.5, 1], [1e-3, 0.999]]))
            beyond = [[np.nan, 0.1], [np.inf, 0.1]]
            points = np.concatenate([centres, 2 * centres, edges, beyond]).astype(dtype)
            cells = jax.vmap(grid.cell)(jnp.asarray(points))
            np.testing.assert_array_equal(grid.contains(points), cells >= 0)
            pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 2)
            assert grid.contains(pairs).shape == pairs.shape[:2]
            places = np.stack([grid.place(x) for x in centres])
            expected = np.stack(np.unravel_index(index, grid.shape), axis=1)
            np.testing.assert_allclose(places, expected, atol=1e-3 if dtype == np.float32 else 1e-9)


def test_cells_are_half_open_and_the_last_one_is_closed():
    grid = Grid.plain(x=(0, 1, 4), y=(-1, 1, 2))

    def cell(x, y):
        return int(cell_of(grid, jnp.array([x, y])))

    assert [cell(x, 0.5) for x in (0.0, 0.25, 0.5, 0.75)] == [1, 3, 5, 7]
    assert [cell(0.1, y) for y in (-1.0, 0.0)] == [0, 1]
    assert cell(np.nextafter(0.25, 0), -1.0) == 0
    assert cell(np.nextafter(1.0, 0), np.nextafter(1.0, 0)) == 7
    assert [cell(*on) for on in ((1.0, -1.0), (0.0, 1.0), (1.0, 1.0), (0.5, 1.0))] == [6, 1, 7, 5]
    above, below = np.nextafter(1.0, 2), np.nextafter(-1.0, -2)
    outside = [(above, 0.0), (0.5, above), (-1e-300, 0.0), (0.5, below)]
    assert {cell(x, float(y)) for x, y in outside} == {-1}


@pytest.mark.parametrize(
    "grid", [one for one in GRIDS if (one.shear == np.eye(len(one.names))).all()]
)
def test_corners_of_the_box_are_in_the_corner_cells(grid):
    """Both borders belong to the grid, along every axis, up to the rounding of a shear."""
    ends = np.array(list(np.ndindex((2,) * len(grid.names))))
    corners = np.where(ends == 1, grid.upper, grid.lower)
    expected = np.ravel_multi_index((ends * (grid.counts - 1)).T, grid.shape)
    np.testing.assert_array_equal(cells_of(grid, corners), expected)
    assert grid.contains(corners).all()


@settings(max_examples=100, deadline=None)
@given(low=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3), count=st.integers(1, 10**6))
def test_the_last_point_below_the_upper_end_is_in_the_last_cell(low, width, count):
    grid = Grid.plain(x=(low, low + width, count))
    last = jnp.asarray(np.nextafter(grid.upper, -np.inf))
    assert cell_of(grid, last) == count - 1


@THE_SEVERAL
def test_no_cell_holds_a_point_that_is_not_finite(grid):
    (inside,), points = centres_of(grid, [0]), []
    for value in (np.nan, np.inf, -np.inf):
        for where in (*np.eye(len(inside), dtype=bool), True):
            points.append(np.where(where, value, inside))
    assert (cells_of(grid, points) == -1).all() and (cells_of(grid, [inside]) == 0).all()


def test_the_sum_axis_is_theta_plus_thetadot():
    grid = Grid.sheared(theta=(0, 0.4, 2), sum=(-0.04, 0.01, 5), phi=(2, 4, 1))
    assert grid.names == ("theta", "sum", "phi") and grid.shape == (2, 5, 1) and grid.size == 10
    np.testing.assert_allclose(grid.axes["sum"], [-0.035, -0.025, -0.015, -0.005, 0.005])
    np.testing.assert_allclose(centres_of(grid, [9]), [[0.3, 0.005 - 0.3, 3.0]])
    assert np.array_equal(grid.unshear, [[1, 0, 0], [1, 1, 0], [0, 0, 1]])
    assert not np.signbit(grid.unshear).any()


def test_cell_area_is_in_state_coordinates():
    assert Grid.plain(x=(0, 3, 4)).cell_area == pytest.approx(0.75)
    assert Grid.plain(x=(0, 1, 10), y=(0, 2, 4), z=(0, 1, 2)).cell_area == pytest.approx(0.025)
    schwab_and_wisse = Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    assert schwab_and_wisse.cell_area == pytest.approx(0.002 * 0.0002)
    stretched = Grid({"p": (0, 1, 2), "q": (0, 1, 2)}, np.array([[2.0, 0.5], [-1.0, -3.0]]))
    assert stretched.cell_area == pytest.approx(0.25 * 5.5)
    # of slices along no axis of the state: by Pythagoras, and of a rhomb of half a square's height
    line = Grid({"p": (0, 1, 2)}, np.array([[2.0], [1.0]]))
    assert line.cell_area == pytest.approx(np.sqrt(5) / 2)
    rhomb = Grid({"p": (0, 2, 1), "q": (0, 2, 1)}, np.array([[1.0, 0.5], [0.0, 0.5], [0.0, 0.0]]))
    assert rhomb.cell_area == pytest.approx(2.0)
    leaning = Grid({"p": (0, 1, 1), "q": (0, 1, 1)}, np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    assert leaning.cell_area == pytest.approx(np.sqrt(3))


def test_another_window_is_not_compiled_again():
    compiled = 0

    @jax.jit
    def centre_and_back(grid, index):
        nonlocal compiled
        compiled += 1
        return grid.cell(grid.centre(index)), grid

    for count in (3, 40):
        back, grid = centre_and_back(Grid.plain(x=(-count, 1, count), y=(0, 1, 5)), 7)
        assert back == 7
        assert grid.shape == (count, 5)
    assert compiled == 1


@pytest.mark.parametrize(
    "axis",
    [
        (0.4, 0, 200),
        (0.4, 0.4, 200),
        (0, np.nan, 200),
        (-np.inf, 0, 200),
        (-1e308, 1e308, 200),
        (0, 0.4, 0),
        (0, 0.4, -3),
        (0, 0.4, 2.0),
        (0, 0.4, "2"),
        (0, "far", 2),
        (0, None, 2),
        (0, 0.4),
        (0, 0.4, 2, 2),
        0.4,
        "axis",
        (0, 10**400, 2),
    ],
    ids=repr,
)
@pytest.mark.parametrize("make", [Grid.plain, Grid.sheared])
def test_a_wrong_axis_is_refused_by_name(make, axis):
    with pytest.raises(ValueError) as error:
        make(theta=axis, sum=(0, 1, 2))
    message = str(error.value)
    given = repr(axis) if len(repr(axis)) <= 60 else f"{repr(axis)[:57]}..."
    assert message.startswith(f"theta={given}: ") and "\n" not in message


def test_wrong_grids_are_refused():
    with pytest.raises(ValueError, match="at least one axis"):
        Grid.plain()
    with pytest.raises(ValueError, match=r"axes must have at most .* cells, not 2147483648"):
        Grid.plain(x=(0, 1, 2**16), y=(0, 1, 2**15))
    assert Grid.plain(x=(0, 1, MAX_SIZE)).size == MAX_SIZE
    with pytest.raises(ValueError, match="axes must have at most"):
        Grid.plain(x=(0, 1, MAX_SIZE + 1))
    axes = {"p": (0, 1, 2), "q": (0, 1, 2)}
    for shear in (np.eye(3), np.ones(2), np.ones((2, 2)), np.full((2, 2), np.nan)):
        with pytest.raises(ValueError, match="shear must") as error:
            Grid(axes, shear)
        assert "\n" not in str(error.value)


# The simple cell map


def follow_sequences(image, sinks) -> CellMap:
    """Schwab and Wisse (2001), section 4.3: one sequence of cells after the other.

    A sequence ends in a cell that is known, from an earlier sequence, or in one of its own, which
    closes a new cycle. Sinks are known from the start.
    """
    n = len(image)
    end = {n + s: ("sink", s) for s in range(sinks)}
    steps = {n + s: -1 for s in range(sinks)}
    cycles = []
    for first in range(n):
        sequence, cell = [], first
        while cell not in end and cell not in sequence:
            sequence.append(cell)
            cell = image[cell]
        if cell not in end:
            cycle = sequence[sequence.index(cell) :]
            end.update((member, ("cycle", len(cycles))) for member in cycle)
            steps.update((member, 0) for member in cycle)
            cycles.append(cycle)
        for cell in reversed(sequence):
            if cell not in end:
                end[cell] = end[image[cell]]
                steps[cell] = steps[image[cell]] + 1

    turned = [c[c.index(min(c)) :] + c[: c.index(min(c))] for c in cycles]
    order = sorted(range(len(cycles)), key=lambda c: (len(turned[c]), turned[c][0]))
    number = {c: i for i, c in enumerate(order)}
    ends = [number[i] if kind == "cycle" else -1 - i for kind, i in (end[c] for c in range(n))]
    counts = [steps[cell] for cell in range(n)]
    cycles = tuple(np.array(turned[c]) for c in order)
    return CellMap(np.array(ends, np.int32), np.array(counts, np.int32), cycles)


def assert_same(result, expected):
    for name in ("end", "attractor", "sink", "steps"):
        values = getattr(result, name)
        assert values.dtype == np.int32
        np.testing.assert_array_equal(values, getattr(expected, name), err_msg=name)
    assert [c.tolist() for c in result.attractors] == [c.tolist() for c in expected.attractors]


def assert_is_sequential(image, sinks=SINKS):
    image = np.asarray(image)
    assert_same(resolve(image, sinks), follow_sequences(image.tolist(), sinks))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([1, 5, 24]).flatmap(lambda n: st.tuples(*n * [st.integers(0, n + 2)])))
def test_resolve_follows_any_sequence(image):
    assert_is_sequential(image)


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.sampled_from([17, 64, 200]),
    reach=st.sampled_from([1, 3, 1000]),
    cyclic=st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]),
    sunk=st.sampled_from([0.0, 0.01, 0.5, 1.0]),
)
def test_resolve_follows_sequences(seed, n, reach, cyclic, sunk):
    """Some cells are permuted, some sunk; the others go to one within reach, all in any order."""
    rng = np.random.default_rng(seed)
    image = np.clip(np.arange(n) + rng.integers(-reach, reach + 1, n), 0, n - 1)
    image = np.where(rng.random(n) < sunk, n + rng.integers(0, SINKS, n), image)
    cycle = np.flatnonzero(rng.random(n) < cyclic)
    image[cycle] = rng.permutation(cycle)
    name = np.concatenate([rng.permutation(n), np.arange(n, n + SINKS)])
    renamed = np.empty(n, int)
    renamed[name[:n]] = name[image]
    assert_is_sequential(renamed)


@pytest.mark.parametrize("dtype", [np.int64, np.int32, np.uint8])
def test_a_single_cell(dtype):
    for image in range(1 + SINKS):
        assert_is_sequential(np.array([image], dtype))
    assert_is_sequential(np.array([0], dtype), sinks=0)


def test_identity():
    n = 1000
    result = resolve(np.arange(n), 0)
    np.testing.assert_array_equal(result.attractor, np.arange(n))
    assert [c.tolist() for c in result.attractors] == [[i] for i in range(n)]
    assert not result.steps.any() and np.all(result.sink == -1)


def test_all_in_sinks():
    n = 1000
    result = resolve(n + np.arange(n) % SINKS, SINKS)
    np.testing.assert_array_equal(result.sink, np.arange(n) % SINKS)
    assert result.attractors == () and not result.steps.any() and np.all(result.attractor == -1)


@pytest.mark.parametrize("length", [2, 3, 4, 5, 63, 64, 65, 66, 1023, 1024, 1025, 1026, 1100])
def test_one_long_chain(length):
    """Whatever power of two the longest transient is next to."""
    n = 1100
    order, others = np.split(np.random.default_rng(length).permutation(n), [length])
    image = np.empty(n, np.int32)
    image[others] = n
    image[order[:-1]] = order[1:]

    image[order[-1]] = n + 1
    sunk = resolve(image, SINKS)
    np.testing.assert_array_equal(np.asarray(sunk.steps)[order], length - 1 - np.arange(length))
    assert sunk.attractors == () and np.all(np.asarray(sunk.sink)[order] == 1)

    image[order[-1]] = order[-1]
    fixed = resolve(image, SINKS)
    np.testing.assert_array_equal(np.asarray(fixed.steps)[order], length - 1 - np.arange(length))
    assert [c.tolist() for c in fixed.attractors] == [[order[-1]]]


def test_one_giant_cycle():
    n = 100_000
    order = np.roll(np.random.default_rng(0).permutation(n), 7)
    image = np.empty(n, np.int64)
    image[order] = np.roll(order, -1)
    result = resolve(image, SINKS)
    (cycle,) = result.attractors
    np.testing.assert_array_equal(cycle, np.roll(order, -np.argmin(order)))
    assert not result.steps.any() and not result.attractor.any()


def test_attractors_are_numbered_by_period_then_smallest_index():
    image = [4, 0, 3, 2, 1, 5, 7, 6, 8, 6]
    result = resolve(np.array(image), 1)
    cycles = [[5], [8], [2, 3], [6, 7], [0, 4, 1]]
    assert [c.tolist() for c in result.attractors] == cycles
    assert result.attractor.tolist() == [4, 4, 2, 2, 4, 0, 3, 3, 1, 3]
    assert result.steps.tolist() == [0] * 9 + [1]


def simple_cell_map(function, grid) -> CellMap:
    def image(index):
        return cell_image(grid, function(grid.centre(index)), 0, leave=LEAVE)

    return resolve(jax.jit(jax.vmap(image))(jnp.arange(grid.size)), SINKS)


def test_cubing_draws_the_unit_interval_to_zero():
    grid = Grid.plain(x=(-1.5, 1.5, 301))
    result = simple_cell_map(lambda x: x**3, grid)
    inside = abs(grid.axes["x"]) < 1
    assert [c.tolist() for c in result.attractors] == [[150]]
    np.testing.assert_array_equal(result.attractor, np.where(inside, 0, -1))
    np.testing.assert_array_equal(result.sink, np.where(inside, -1, LEAVE))
    far = abs(grid.axes["x"]) > 1.5 ** (1 / 3)
    np.testing.assert_array_equal((result.steps == 0) & ~inside, far)


def test_rotation_by_a_quarter_has_period_four():
    grid = Grid.plain(x=(0, 1, 64))
    result = simple_cell_map(lambda x: (x + 0.25) % 1, grid)
    expected = [[i, i + 16, i + 32, i + 48] for i in range(16)]
    assert [c.tolist() for c in result.attractors] == expected
    np.testing.assert_array_equal(result.attractor, np.arange(64) % 16)


def test_logistic_map_at_its_superstable_two_cycle():
    """At r = 1 + sqrt 5 all points come to {1/2, r/4}, but for the fixed points' preimages."""
    r = 1 + np.sqrt(5)
    grid = Grid.plain(x=(0, 1, 999))
    result = simple_cell_map(lambda x: r * x * (1 - x), grid)
    two = [cycle for cycle in result.attractors if cycle.size == 2]
    assert len(two) == 1
    np.testing.assert_allclose(grid.axes["x"][two[0]], [1 / 2, r / 4], atol=2 / 999)
    number = [cycle.size for cycle in result.attractors].index(2)
    assert np.mean(np.asarray(result.attractor) == number) > 0.95
    assert np.all(result.sink == -1)


def test_a_plane_contraction_in_sheared_coordinates():
    """The distance to a point halves with every step, so its logarithm counts the steps."""
    grid = Grid.sheared(theta=(0, 0.4, 101), sum=(-0.05, 0.05, 51))
    goal = grid.centre(grid.size // 2)
    result = simple_cell_map(lambda x: goal + 0.49 * (x - goal), grid)
    assert [c.tolist() for c in result.attractors] == [[grid.size // 2]]
    assert not result.attractor.any()
    assert np.max(result.steps) == 6  # 50 spacings to fewer than a half: 50 -> 25 -> ... -> 1 -> 0


def test_cell_image_is_a_cell_or_the_sink_of_what_went_wrong():
    grid = Grid.plain(x=(0, 1, 4))

    @jax.jit
    def image(x, outcome):
        return cell_image(grid, jnp.array([x]), outcome, leave=7)

    inside, outside, nowhere = 0.6, 1.01, np.nan
    assert image(inside, 0) == 2
    assert image(outside, 0) == image(nowhere, 0) == 4 + 7
    for failure in (1, 6, 7):
        assert {int(image(x, failure)) for x in (inside, outside, nowhere)} == {4 + failure}
    assert image(inside, np.int64(0)).dtype == image(inside, np.int8(3)).dtype == np.int32


@pytest.mark.parametrize(
    ("image", "sinks", "message"),
    [
        ([0, -1, 2], 0, r"image\[1\]=-1: must be 0 \.\.\. 2"),
        ([0, 1, 5], 2, r"image\[2\]=5: must be 0 \.\.\. 4"),
        ([0.0, 1.0], 2, r"image of shape \(2,\) and type float64"),
        ([True, False], 2, r"image of shape \(2,\) and type bool"),
        ([[0, 1]], 2, r"image of shape \(1, 2\)"),
        (np.zeros(0, int), 2, r"image of shape \(0,\)"),
        ([0], -1, "sinks=-1"),
        ([0], 1000, "sinks=1000"),
    ],
)
def test_wrong_images_are_refused(image, sinks, message):
    with pytest.raises(ValueError, match=message):
        resolve(np.asarray(image), sinks)


def test_one_sink_more_makes_the_same_image_right():
    assert resolve(np.array([0, 1, 5]), 3).sink.tolist() == [-1, -1, 2]


def test_a_slice_has_its_last_coordinates_fixed():
    plain = Grid.plain(theta=(0, 1, 4), thetadot=(-1, 1, 2), phidot=0.25)
    sheared = Grid.sheared(theta=(0, 1, 4), sum=(-1, 1, 2), phidot=-0.5)
    assert plain.shape == sheared.shape == (4, 2) and plain.coordinates == 3
    assert plain.fixed_values == {"phidot": 0.25} and sheared.fixed_values == {"phidot": -0.5}
    np.testing.assert_array_equal(plain.centre(3), [0.375, 0.5, 0.25])
    np.testing.assert_array_equal(sheared.centre(3), [0.375, 0.5 - 0.375, -0.5])
    assert plain.cell_area == sheared.cell_area == pytest.approx(0.25)
    assert Grid.plain(theta=(0, 1, 4)).fixed_values == {}


def test_a_slice_is_the_layer_of_cells_around_it():
    axes = {"theta": (0.0, 1.0, 5), "sum": (-1.0, 1.0, 3)}
    whole = Grid.sheared(**axes, phidot=(-1.0, 1.0, 5))
    layer = Grid.sheared(**axes, phidot=0.4)
    centres = centres_of(whole, np.arange(whole.size)).reshape(5, 3, 5, 3)
    found = centres_of(layer, np.arange(layer.size)).reshape(5, 3, 3)
    np.testing.assert_allclose(found, centres[:, :, 3], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Grid.plain(theta=0.2, thetadot=(-1, 0, 3)), "theta=0.2"),
        (lambda: Grid.plain(theta=0.2), "at least one axis"),
        (lambda: Grid.plain(theta=(0, 1, 3), phidot=np.nan), "origin"),
        (lambda: Grid.plain(theta=(0, 1, 3), phidot=0.1).cell(jnp.zeros(2)), "slice"),
        (lambda: Grid({"x": (0, 1, 3)}, np.zeros((2, 1))), "shear"),
        (lambda: Grid({"x": (0, 1, 3)}, np.eye(1), np.zeros(2)), "origin"),
    ],
)
def test_slices_that_are_none(make, named):
    with pytest.raises(ValueError, match=named) as error:
        make()
    assert "\n" not in str(error.value)


def test_truth_values_are_no_coordinates_and_a_grid_has_an_axis():
    with pytest.raises(ValueError, match=r"phidot=True: an axis is"):
        Grid.plain(theta=(0, 1, 3), thetadot=(0, 1, 3), phidot=True)
    with pytest.raises(ValueError, match=r"axes=.*at least one axis"):
        Grid.plain(theta=1.0, thetadot=2.0)
