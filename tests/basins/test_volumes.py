"""Basins in three dimensions: their cells, volumes, errors, slices and pictures."""

import dataclasses
import json

import numpy as np
import pytest
from cells_of_basins import let_grow, let_walk

import walker_jax as wj
from walker_jax import Outcome, figures
from walker_jax.basins import refinement
from walker_jax.basins.basin_summary import summarise_basin, tally
from walker_jax.basins.runs import Runs, neighbours
from walker_jax.basins.windows import WHOLE_SECTION, grid_along, whole_section
from walker_jax.checks import TooLarge
from walker_jax.design.area_gradients import MeasuredArea
from walker_jax.design.measures import Measure
from walker_jax.grids import edge

WALKER = wj.RoundFootWalker(0.01)
CENTRE, HALF_AXES = np.array([0.52, 0.47, 0.51]), np.array([0.31, 0.23, 0.17])
BY_CENTRES = {"strides": 10, "check": 0, "seed": 0, "tolerance": None, "by_centres": True}


def cube(count):
    return wj.Grid.plain(**{name: (0, 1, count) for name in WALKER.section})


def ellipsoid(x):
    return (((x - CENTRE) / HALF_AXES) ** 2).sum(axis=1) < 1


def torus(x):
    along, across, up = (x - CENTRE).T
    return (np.hypot(along, across) - 0.27) ** 2 + up**2 < 0.09**2


def comb(x):
    """Fingers much thinner than a cell: the boundary fills a slab."""
    return x[:, 2] < 0.35 + 0.2 * np.modf(1e4 * x[:, 0])[0]


VOLUMES = {
    ellipsoid: 4 / 3 * np.pi * HALF_AXES.prod(),
    torus: 2 * np.pi**2 * 0.27 * 0.09**2,
    comb: 0.45,
}


@pytest.fixture
def walks_in(monkeypatch):
    """Let walkers walk from a set alone; gives all points that were asked for."""
    return lambda inside: let_walk(monkeypatch, lambda _, x: inside(x), CENTRE)


@pytest.mark.parametrize("shape", [(7,), (3, 5), (4, 3, 5)])
def test_runs_are_what_arrays_over_the_grid_are(shape):
    rng = np.random.default_rng(len(shape))
    label, level = rng.integers(0, 2, shape), np.zeros(shape, int)
    runs = Runs.from_cells(label, level)
    for depth in (1, 2):
        runs = runs.subdivide()
        for axis in range(len(shape)):
            label, level = (np.repeat(values, 2, axis) for values in (label, level))
        cells = np.unique(rng.integers(0, label.size, label.size // 5))
        new = rng.integers(0, 3, len(cells))
        runs = runs.with_cells(cells, new, depth)
        label.ravel()[cells], level.ravel()[cells] = new, depth
        assert runs.shape == label.shape and runs.size == label.size
        np.testing.assert_array_equal(runs.spread(runs.label), label)
        np.testing.assert_array_equal(runs.spread(runs.level), level)
        np.testing.assert_array_equal(runs.levels_of(cells), depth)
        assert runs.count_levels(3).tolist() == np.bincount(level.ravel(), minlength=3).tolist()
        own = np.flatnonzero(level == 0)
        number = rng.integers(0, len(own), 50)
        np.testing.assert_array_equal(runs.cells_of_level(0, number), own[number])
        outer = np.ones(label.shape, bool)
        outer[(slice(1, -1),) * len(shape)] = False
        assert runs.count_at_border(runs.label == 1) == (outer & (label == 1)).sum()
        # no two runs of a row that follow one on another are alike
        alike = (np.diff(runs.label) == 0) & (np.diff(runs.level) == 0)
        assert not (alike & (runs.first[1:] % label.shape[-1] > 0)).any()


def test_neighbours_are_those_that_an_edge_has():
    label = np.random.default_rng(0).integers(0, 2, (4, 5, 6))
    cells = np.arange(label.size)
    beside = list(neighbours(cells, label.shape))
    assert len(beside) == 26
    unlike = np.any([label.ravel()[one] != label.ravel() for one in beside], axis=0)
    np.testing.assert_array_equal(unlike.reshape(label.shape), edge(label))


@pytest.mark.parametrize("inside", [ellipsoid, torus])
def test_cells_are_the_whole_grids_at_the_cost_of_its_boundary(walks_in, inside):
    asked = walks_in(inside)
    found = refinement.refine_cells(WALKER, cube(12), 3, **BY_CENTRES)
    fine = refinement.finer(cube(12), 3)
    expected = inside(fine.centres(np.arange(fine.size))).reshape(fine.shape)
    np.testing.assert_array_equal(found.attractor >= 0, expected)
    assert found.boundary[-1] == edge(expected.astype(int)).sum()
    assert sum(map(len, asked)) == sum(found.followed) < fine.size / 6
    # four times as many cells a level, as of a surface, and not eight times
    followed, boundary = np.array(found.followed[1:]), np.array(found.boundary)
    assert np.all(followed[1:] < 4.8 * followed[:-1]) and np.all(boundary[1:] < 5 * boundary[:-1])
    assert len(found.runs.first) < 2 * 96**2 + 2 * found.boundary[-1]


def test_cells_of_a_slice_are_those_of_an_ellipse(walks_in):
    asked, height = walks_in(ellipsoid), 0.6
    grid = wj.Grid.plain(theta=(0, 1, 20), thetadot=(0, 1, 25), phidot=height)
    found = refinement.refine_cells(WALKER, grid, 3, **BY_CENTRES)
    places = np.meshgrid((np.arange(160) + 0.5) / 160, (np.arange(200) + 0.5) / 200, indexing="ij")
    theta, thetadot, phidot = (
        ((x - middle) / half) ** 2
        for x, middle, half in zip([*places, height], CENTRE, HALF_AXES, strict=True)
    )
    expected = theta + thetadot < 1 - phidot
    np.testing.assert_array_equal(found.attractor >= 0, expected)
    assert found.boundary[-1] == edge(expected.astype(int)).sum()
    assert np.all(np.array(found.followed[1:]) >= 4 * np.array(found.boundary[:-1]))
    assert sum(map(len, asked)) == sum(found.followed) < expected.size / 4


@pytest.mark.parametrize("inside", VOLUMES)
def test_volumes_are_right_within_errors_as_large_as_said(walks_in, inside):
    walks_in(inside)
    options = {"strides": 10, "check": 5000, "tolerance": None}
    found = [
        refinement.refine_cells(WALKER, cube(10), 1, seed=seed, **options) for seed in range(16)
    ]
    error = np.array([one.area_error for one in found])
    deviation = (np.array([one.area for one in found]) - VOLUMES[inside]) / error
    assert abs(deviation.mean()) < 3 / np.sqrt(16)
    assert 0.6 < np.sqrt(np.mean(deviation**2)) < 1.5
    assert np.all(error < 0.04 * VOLUMES[inside])


def test_a_volume_of_too_much_memory_is_refused_at_once(walks_in, monkeypatch):
    asked = walks_in(ellipsoid)
    monkeypatch.setattr("walker_jax.checks.memory_of_machine", lambda: 1e6)
    with pytest.raises(TooLarge, match=r"levels=3: level 2 follows \d+ cells, which need .* GiB"):
        wj.refine(WALKER, cube(12), 3, check=1000)
    assert len(asked) == 2


@pytest.fixture
def refined(walks_in):
    walks_in(ellipsoid)
    axes = {"theta": (0, 1, 12), "sum": (0.4, 1.6, 14), "phidot": (0, 1, 11)}
    return wj.refine(WALKER, wj.Grid.sheared(**axes), 2, check=20_000)


def test_slices_are_those_of_the_whole_grid(refined):
    volume, error = float(refined.total_area), float(refined.total_area_error)
    assert abs(volume - VOLUMES[ellipsoid]) < 4 * error < 0.03 * volume
    lengths = np.diff(refined.first_cell.values, append=48 * 56 * 44)
    fate = np.repeat(refined.run_fate.values, lengths).reshape(48, 56, 44)
    for k, (name, width) in enumerate({"theta": 1, "sum": np.sqrt(2), "phidot": 1}.items()):
        place = 20
        plane = wj.slice_basin(refined, name, float(refined[name][place]))
        np.testing.assert_array_equal(plane.fate, np.take(fate, place, axis=k))
        assert float(plane[name]) == float(refined[name][place])
        others = [one for one in ("theta", "sum", "phidot") if one != name]
        spacing = np.prod([float(refined[one][1] - refined[one][0]) for one in others])
        cells = (plane.fate == 0).sum()
        assert float(plane.area[0]) == pytest.approx(float(cells * spacing * width))
        assert plane.attrs["area"] == plane.area.values.tolist()
    assert len(figures.basin(wj.slice_basin(refined, "phidot", 0.5)).get_images()) == 1
    assert int(refined.at_border) == 0


def test_what_a_volume_has_of_each_fate(refined):
    counts = tally(refined)
    assert counts.fates.sum() == 48 * 56 * 44 and counts.unmatched == 0
    assert counts.fates[Outcome.STRIDE] == refined.cells.sum()
    answer = summarise_basin(refined, counts)
    assert answer["volume"] == float(refined.total_area) and answer["cells"] == 48 * 56 * 44
    assert answer["volume_error"] == float(refined.total_area_error) and "area" not in answer


@pytest.mark.parametrize(
    "at, message",
    [
        (("thetadot", 0.1), "axis must be one of theta, sum, phidot, not 'thetadot'"),
        (("theta", 1.0), "value must be on theta, from 0 to 1, not 1"),
        (("phidot", float("nan")), "value must be on phidot, from 0 to 1, not nan"),
    ],
)
def test_a_slice_is_at_one_value_of_one_axis(refined, at, message):
    with pytest.raises(ValueError, match=message):
        wj.slice_basin(refined, *at)


def test_the_picture_has_three_slices_and_the_surface(refined):
    figure = figures.volume(refined)
    *slices, surface = figure.axes
    assert [len(ax.get_images()) for ax in slices] == [1, 1, 1]
    assert surface.name == "3d"
    for ax in slices:
        ((left, right), (low, high)) = ax.get_xlim(), ax.get_ylim()
        assert right - left < 1 and high - low < 1.2  # of the basin, not of the grid
        (dot,) = ax.get_lines()
        ((x, y),) = np.asarray(dot.get_xydata()).tolist()
        assert left < x < right and low < y < high
    (squares,) = surface.collections  # one for each outermost cell of an ellipsoid
    lit = np.asarray(squares.get_facecolor())[:, :3].sum(axis=1)
    assert lit.max() > 1.5 * lit.min()
    assert 50 < len(np.asarray(squares.get_offsets())) < refined.axis.size * 24**2


def test_a_volume_without_a_basin_is_drawn_too(walks_in):
    walks_in(lambda x: np.zeros(len(x), bool))
    data = wj.refine(WALKER, cube(6), 1, check=100)
    assert float(data.total_area) == 0 < float(data.total_area_error)
    assert "no basin" in figures.volume(data).axes[3].get_title("left").lower()


@pytest.mark.parametrize(
    "shear",
    [pytest.param(np.eye(3), marks=pytest.mark.slow), [[1, 0, 0], [-1, 1, 0], [0, 0.3, 2.0]]],
)
def test_the_volume_of_a_ball_grows_by_its_surface(monkeypatch, walks_in, shear):
    """In any coordinates: 4 pi r^2 dr/dp, with dr/dp = 10."""

    let_grow(monkeypatch, CENTRE)
    walks_in(lambda x: np.linalg.norm(x - CENTRE, axis=1) < 0.23)
    axes = {name: (-1.01, 1.02, 25) for name in "uvw"}
    found = wj.measure(
        WALKER,
        "volume",
        ["slope"],
        grid=wj.Grid(axes, np.array(shear), CENTRE),
        levels=2,
        check=500_000,
    )
    assert abs(found.value - 4 / 3 * np.pi * 0.23**3) < 4 * found.value_error < 0.03 * found.value
    assert found.gradient[0] == pytest.approx(4 * np.pi * 0.23**2 * 10, rel=4e-3)
    assert 0 < found.gradient_error[0] < 0.02 * found.gradient[0]
    assert found.lost == 0 and not found.averaged.any()


def test_a_blade_thinner_than_a_cell_grows_within_its_error(monkeypatch, walks_in):
    """Half a ball between planes that are p u apart, at u from their edge.

    dV/dp = 2/3 R^3 / (1 + p^2 / 4).
    """
    radius, sharpness = 0.4, 0.2
    across = np.array([0.36, 0.48, 0.8])
    towards = np.array([-0.8, 0.6, 0.0])

    def margins(x):
        """Those of the blade's sides, and of its rim."""
        u, s = (x - CENTRE) @ towards, (x - CENTRE) @ across
        return sharpness * u / 2 - np.abs(s), radius - np.linalg.norm(x - CENTRE, axis=1)

    def changes(walker, x, made, directions, parameters, tolerance):
        u, s, away = (x - CENTRE) @ towards, (x - CENTRE) @ across, x - CENTRE
        sides = sharpness / 2 * towards - np.sign(s)[:, None] * across
        rim = -away / np.linalg.norm(away, axis=1, keepdims=True)
        side = np.less(*margins(x))[:, None]
        rates = np.where(side, u[:, None] / 2, 0)
        along = np.where(side, sides, rim) @ directions.T
        return np.zeros(len(x)), np.concatenate([along, rates], axis=1)

    monkeypatch.setattr("walker_jax.design.area_gradients.margins_with_derivatives", changes)
    walks_in(lambda x: np.minimum(*margins(x)) > 0)
    exact = 2 / 3 * radius**3 / (1 + sharpness**2 / 4)
    shifts = np.random.default_rng(1).uniform(0, 1 / 16, (8, 3))
    for levels, share in ((0, 0.15), (2, 0.015)):
        found = []
        for shift in shifts:
            axes = {
                name: (low, 1 + low, 16)
                for name, low in zip(WALKER.section, shift.tolist(), strict=True)
            }
            grid = wj.Grid.plain(**axes)
            found.append(
                wj.measure(WALKER, "volume", ["slope"], grid=grid, levels=levels, check=1000)
            )
        away = np.array([one.gradient[0] for one in found]) - exact
        error = np.array([one.gradient_error[0] for one in found])
        assert np.all(np.abs(away) < 4 * error) and error.mean() < share * exact
        assert abs(away.mean()) < share * exact / 2
        assert np.sqrt(np.mean((away / error) ** 2)) < 1.5


def test_the_whole_section_is_in_units_of_the_leg():
    short = wj.RoundFootWalker(0.01, leg_length=0.25, com_from_hip=0.1, foot_radius=0.05)
    own, axes = whole_section(WALKER), whole_section(short)
    assert own is not None and axes is not None
    assert own["phidot"][:2] == pytest.approx(WHOLE_SECTION["phidot"][:2])
    assert axes["phidot"] == (pytest.approx(-5), pytest.approx(2), WHOLE_SECTION["phidot"][2])
    # the same rates, twice as high, at either end of theta
    low, high = (rate - 1.4 for rate in WHOLE_SECTION["sum"][:2])
    assert axes["sum"][0] == pytest.approx(1.4 + 2 * low) and axes["sum"][1] >= 1.4 + 2 * high


def use_made_up_sizes(monkeypatch, gradient):
    """`gradient` takes the place of measured basins: (walker, grid, parameters)."""
    measure = lambda how, walker: MeasuredArea._make((walker, how.grid, None, None))
    monkeypatch.setattr("walker_jax.design.evaluation.AreaSettings.measure", measure)
    monkeypatch.setattr(
        "walker_jax.design.evaluation.differentiate_area",
        lambda area, parameters, *_: gradient(*area[:2], parameters),
    )


def test_the_volume_is_optimised(monkeypatch):
    """Of a size that is made up, with its maximum at a foot radius of 0.3."""

    def gradient(walker, grid, parameters):
        assert len(grid.names) == 3 and grid.shape == (84, 72, 84)
        radius = float(walker.foot_radius)
        slope = np.array([-2 * (radius - 0.3)] * len(parameters))
        none = np.zeros(len(parameters))
        return Measure(1 - (radius - 0.3) ** 2, slope, 1e-9, none, none > 0, 1, 0, 1)

    use_made_up_sizes(monkeypatch, gradient)
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    found = wj.optimise(WALKER, {"foot_radius": (0.05, 0.7)}, "volume", starts=1)
    assert float(found.optimum[0]) == pytest.approx(0.3, abs=2e-3)
    assert float(found.exact_optimum) == pytest.approx(1) and found.attrs["levels"] == 2
    assert json.loads(found.attrs["objective"]) == {"volume": 1.0}
    assert json.loads(found.attrs["region"])["theta"] == [0.0, 1.4, 84]
    assert "volume of the basin" in figures.optimum(found).axes[0].get_ylabel()


def test_an_optimum_beside_a_bound_by_rounding_is_at_it(monkeypatch):
    """The first step, a tenth of the bounds, ends there; beyond, rounding makes the size less."""

    def gradient(walker, grid, parameters):
        radius, none = float(walker.foot_radius), np.zeros(len(parameters))
        size = radius - 1e-9 * (radius == 0.7)
        return Measure(size, none + 1, 0.0, none, none > 0, 1, 0, 1)

    use_made_up_sizes(monkeypatch, gradient)
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    walker = wj.RoundFootWalker(0.01, foot_radius=0.635)
    found = wj.optimise(walker, {"foot_radius": (0.05, 0.7)}, "volume", starts=1)
    assert 0 < 0.7 - float(found.optimum[0]) < 1e-10 and found.at_bound.values.tolist() == [1]


def test_areas_and_volumes_take_the_grids_that_they_are_of():
    flat = wj.Grid.sheared(theta=(0, 1, 5), sum=(0, 1, 5), phidot=0.0)
    bounds = {"foot_radius": (0.1, 0.3)}
    with pytest.raises(ValueError, match="objective volume must have a grid of 3 axes, not 2"):
        wj.optimise(WALKER, bounds, "volume", grid=flat)
    with pytest.raises(ValueError, match="objective area must have a grid of 2 axes, not 3"):
        wj.optimise(WALKER, bounds, "area", grid=cube(4))
    with pytest.raises(ValueError, match="objective must be area for a SimplestWalker"):
        wj.optimise(wj.SimplestWalker(0.01), {"slope": (0.001, 0.01)}, "volume")
    with pytest.raises(ValueError, match="not several"):
        wj.optimise(WALKER, bounds, {"area": 1.0, "volume": 1.0})


def test_the_command_says_volume_with_its_unit(walks_in, run, tmp_path):
    walks_in(ellipsoid)
    axes = "--theta 0 1 12 --sum 0.4 1.6 12 --phidot 0 1 12 --levels 1".split()
    command = ["basin", "--walker", "round-foot", "--slope", "0.01", *axes]
    code, printed, err = run(*command)
    assert (code, err) == (0, "")
    assert "direct, refined" in printed and "rad^3 g/l in all" in printed
    assert (tmp_path / "basin.png").exists()
    answer = json.loads(run(*command, "--json")[1])  # reads what was saved
    assert abs(answer["volume"] - VOLUMES[ellipsoid]) < 4 * answer["volume_error"]
    assert answer["at_border"] == 0 and f"volume {answer['volume']:.7g} +-" in printed


def test_levels_are_followed_directly_and_here(run):
    for option in ("--workers=2", "--method=cell-map"):
        walker = ("--walker", "round-foot", "--slope", "0.01")
        code, _, err = run("basin", *walker, "--levels", "1", option)
        assert code == 2 and "--levels" in err


def box_of(data):
    """A box that holds all basins of a data set over three axes, with some cells about them."""
    walks, axes = np.argwhere(data.attractor.values >= 0), {}
    for k, name in enumerate(data.attractor.dims):
        values = data[name].values
        first, last = walks[:, k].min() - 4, walks[:, k].max() + 4
        axes[name] = float(values[max(first, 0)]), float(values[min(last, len(values) - 1)]), 10
    return wj.Grid.sheared(**axes)


@pytest.mark.slow
def test_the_volume_of_a_walker_on_round_feet():
    """Against every cell of a uniform grid, and random starts; and its change with the radius."""
    axes = whole_section(WALKER)
    assert axes is not None
    grid = grid_along(axes)
    found = wj.refine(WALKER, grid, 1)
    volume, error = float(found.total_area), float(found.total_area_error)
    uniform = wj.basin(WALKER, refinement.finer(grid, 1), "direct")
    assert abs(float(uniform.area.sum()) - volume) < 4 * error < 0.02 * volume
    box = box_of(uniform)
    whole, chance = (
        box.size * box.cell_area,
        wj.basin_stability(WALKER, box, samples=2_000_000, strides=200),
    )
    assert whole * chance.low - 2 * error < volume < whole * chance.high + 2 * error
    assert whole * (chance.high - chance.low) < 0.03 * volume
    near = [wj.refine(wj.RoundFootWalker(0.01, foot_radius=r), grid, 2) for r in (0.19, 0.21)]
    low, high = (float(one.total_area) for one in near)
    spread = np.linalg.norm([float(one.total_area_error) for one in near]) / 0.02
    for levels in (0, 1):
        rate = wj.measure(WALKER, "volume", ("foot_radius",), grid=grid, levels=levels)
        away = abs(rate.gradient[0] - (high - low) / 0.02)
        assert away < 3 * np.hypot(spread, rate.gradient_error[0]) < 0.25 * rate.gradient[0]


KNEED = wj.KneedWalker(0.07, foot_radius=0.1)
BOX = wj.Grid.sheared(theta=(0, 1.4, 42), sum=(-1.0, 0.4, 42), phidot=(-2.5, 1.5, 42))
"""It holds the basin of that walker."""


@pytest.mark.slow
def test_slices_of_a_kneed_volume_are_those_refined_alone():
    """Each within the errors of both, and so is the sum of the latter, the volume."""
    found = wj.refine(KNEED, BOX, 2)
    assert found.period.values.tolist() == [1] and int(found.at_border) == 0
    low, high, count = -2.5, 1.5, 40
    width, cell = (high - low) / count, float(BOX.cell_area) / 16 / ((high - low) / 42)
    areas, errors, apart = np.zeros(count), np.zeros(count), []
    for k, phidot in enumerate(np.linspace(low, high, count, endpoint=False) + width / 2):
        flat = wj.Grid.sheared(theta=(0, 1.4, 42), sum=(-1.0, 0.4, 42), phidot=float(phidot))
        alone = wj.refine(KNEED, flat, 2, check=20_000)
        areas[k], errors[k] = float(alone.total_area), float(alone.total_area_error)
        cut = wj.slice_basin(found, "phidot", float(phidot))
        mixed = edge((cut.attractor.values >= 0).astype(int)).sum()  # a quarter each, at most
        apart.append(abs(float(cut.area.sum()) - areas[k]) / np.hypot(errors[k], cell * mixed**0.5))
    assert (areas > 0).sum() > 10 and max(apart) < 4
    error = width * np.linalg.norm(errors[areas > 0])
    volume, own = float(found.total_area), float(found.total_area_error)
    assert abs(width * areas.sum() - volume) < 4 * np.hypot(error, own) < 0.03 * volume
    every = [wj.slice_basin(found, "theta", float(theta)) for theta in found.theta.values]
    step = float(found.theta[1] - found.theta[0])
    total = step * sum(float(one.area.sum()) for one in every)
    assert total == pytest.approx(float(found.area.sum()))


@pytest.mark.slow
def test_the_volume_of_a_kneed_walker_changes_by_its_gradient():
    steps = {"slope": 0.008, "foot_radius": 0.04}
    rate = wj.measure(KNEED, "volume", tuple(steps), grid=BOX, levels=1)
    for k, (name, step) in enumerate(steps.items()):
        value = float(getattr(KNEED, name))
        near = [dataclasses.replace(KNEED, **{name: value + by}) for by in (-step, step)]
        low, high = (wj.refine(one, BOX, 2) for one in near)
        change = float(high.total_area - low.total_area) / (2 * step)
        spread = np.hypot(float(low.total_area_error), float(high.total_area_error)) / (2 * step)
        away = abs(rate.gradient[k] - change)
        assert away < 3 * np.hypot(spread, rate.gradient_error[k]) < 0.6 * abs(change)
