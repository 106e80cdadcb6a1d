"""Areas, least disturbances and gaits change with parameters as their derivatives say."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from all_measures import all_measures
from cells_of_basins import labels_where, let_grow, let_walk
from scipy.stats import multivariate_normal

import walker_jax as wj
from walker_jax.basins import refinement
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.refinement import refine_cells
from walker_jax.basins.runs import Runs, label_of
from walker_jax.design.area_gradients import (
    boundary_pairs,
    integrate_along_boundary,
    walkers_at_band_ends,
)
from walker_jax.design.measures import GAIT_MEASURES
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.disturbances import LeastDisturbance
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.walkers.parameters import with_parameter

SECTION = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))


def difference(walker_of, value, width, grid, levels=5):
    """A central difference of refined areas, and its standard error."""
    low, high = (
        wj.refine(walker_of(value + step), grid, levels, seed=7) for step in (-width / 2, width / 2)
    )
    error = np.hypot(float(low.total_area_error), float(high.total_area_error))
    return (float(high.total_area) - float(low.total_area)) / width, error / width


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "expected"),
    # by differences of areas refined five times, at slopes 4e-4 apart, to 0.0016
    [(0.003, -0.0985), (0.006, -0.0410)],
)
def test_the_area_falls_with_the_slope(slope, expected):
    found = wj.measure(wj.SimplestWalker(slope), "area", ["slope"], grid=SECTION, levels=1)
    assert found.gradient[0] == pytest.approx(expected, rel=0.06)
    assert 0 < found.gradient_error[0] < 0.06 * abs(expected)
    assert found.lost == 0 and found.crossings > 500 and not found.averaged.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "half", "smooth"),
    [(0.003, 2e-4, True), (0.006, 4e-4, True), (0.010, 5e-4, False), (0.013, 5e-4, False)],
)
def test_the_derivative_of_the_area_by_smooth_and_fractal_edges(slope, half, smooth):
    """Within 5 % of a central difference on a finer grid, of which that has the error stated."""
    levels = 3 if smooth else 4
    found = wj.measure(
        wj.SimplestWalker(slope), "area", ["slope"], grid=SECTION, levels=levels, bands=(half,)
    )
    expected, error = difference(wj.SimplestWalker, slope, 2 * half, SECTION, levels=6)
    assert error < 0.025 * abs(expected)
    assert abs(found.gradient[0] - expected) < 0.05 * abs(expected)
    assert found.averaged.tolist() == [not smooth]


@pytest.mark.slow
def test_where_the_edge_is_fractal_it_is_a_bands_average():
    walker, band = wj.SimplestWalker(0.013), 1e-3
    assert not wj.measure(walker, "area", ["slope"], grid=SECTION, levels=1).averaged[0]
    found = wj.measure(walker, "area", ["slope"], grid=SECTION, levels=1, bands=(band,))
    assert found.averaged[0]
    expected = -0.1627  # by areas refined five times, to 0.0004
    assert abs(found.gradient[0] - expected) < 4 * found.gradient_error[0] < 0.25 * abs(expected)


def test_bands_end_where_a_parameter_does():
    low, high = walkers_at_band_ends(wj.SpringWalker(0.004, 0.1), "hip_stiffness", 0.5)
    ends = [float(vars(one)["hip_stiffness"]) for one in (low, high)]
    assert ends == pytest.approx([0.1 - 0.5 / 8, 0.6])  # a quarter would be below 0
    low, high = walkers_at_band_ends(wj.SpringWalker(0.004, 0.1), "slope", 0.001)
    assert [float(vars(one)["slope"]) for one in (low, high)] == pytest.approx([0.003, 0.005])


@pytest.mark.slow
def test_a_band_that_ends_where_the_slope_does():
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 20), sum=(-0.02, 0.01, 20))
    found = wj.measure(
        wj.SimplestWalker(0.013),
        "area",
        ["slope"],
        grid=grid,
        levels=0,
        bands=(2.0,),
        strides=20,
        check=0,
    )
    assert np.isfinite(found.gradient).all()


@pytest.mark.slow
def test_the_chance_of_a_density_to_walk_and_its_derivative():
    """Against random starts of the same distribution, and a central difference."""
    mean, covariance = [0.2, -0.2], np.array([[4e-4, -3e-4], [-3e-4, 2.6e-4]])
    distribution: Any = multivariate_normal
    density = distribution(mean, covariance).pdf
    where = wj.Grid.sheared(theta=(0.1, 0.3, 51), sum=(-0.04, 0.04, 89))  # five deviations about
    chance = lambda slope, levels, names=(): wj.measure(
        wj.SimplestWalker(slope),
        "basin-stability",
        names,
        grid=where,
        levels=levels,
        density=density,
    )
    found = chance(0.006, 1, ("slope",))
    draw = lambda rng, n: rng.multivariate_normal(mean, covariance, n) * [1, 1]
    starts = wj.basin_stability(wj.SimplestWalker(0.006), draw, samples=4000)
    assert starts.low < found.value < starts.high
    low, high = (chance(0.006 + step, 2) for step in (-4e-4, 4e-4))
    difference = (high.value - low.value) / 8e-4
    error = np.hypot(found.gradient_error[0], np.hypot(low.value_error, high.value_error) / 8e-4)
    assert abs(found.gradient[0] - difference) < 3 * error < 0.15 * abs(difference)
    with pytest.raises(ValueError, match="density must return"):
        wj.measure(
            wj.SimplestWalker(0.006),
            "basin-stability",
            (),
            grid=SECTION,
            levels=0,
            density=lambda x: x,
        )


CENTRE = np.array([0.52, 0.47])


def radius(slope):
    return 0.2 + 10 * (slope - 0.004)


@pytest.fixture
def disc(monkeypatch):
    """Walkers walk from within a disc; beyond it the margin is a multiple of the distance."""

    inside = lambda walker, x: np.linalg.norm(x - CENTRE, axis=1) < radius(float(walker.slope))
    let_walk(monkeypatch, inside, np.zeros(2))
    let_grow(monkeypatch, CENTRE)


@pytest.mark.parametrize("shear", [[[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.3, 2.0]]])
def test_the_area_of_a_disc_grows_by_its_circumference(disc, shear):
    """In any coordinates: 2 pi r dr/dp, with dr/dp = 10."""
    axes = {"u": (-1, 1, 30), "v": (-1, 1, 40)}
    grid = wj.Grid(axes, np.array(shear), np.array([0.5, 0.5]))
    for slope in (0.004, 0.01):
        found = wj.measure(wj.SimplestWalker(slope), "area", ["slope"], grid=grid, levels=4)
        r = radius(slope)
        assert abs(found.value - np.pi * r**2) < 4 * found.value_error < 0.01 * found.value
        assert found.gradient[0] == pytest.approx(2 * np.pi * r * 10, rel=1e-3)
        assert 0 < found.gradient_error[0] < 0.01 * found.gradient[0] and not found.averaged.any()
        # lines along each axis, which are those of half the width in the other, meet it twice
        widths = r * np.linalg.norm(np.linalg.inv(shear), axis=1)
        assert abs(found.crossings - 4 * widths @ [15 * 16, 20 * 16]) <= 8 and found.lost == 0


def test_the_area_of_a_disc_over_a_band(disc, monkeypatch):
    """Where the integral is not to be trusted: pi ((r + 10 h)^2 - (r - 10 h)^2) / 2h."""
    grid = wj.Grid.plain(theta=(0, 1, 40), thetadot=(0, 1, 40))
    monkeypatch.setattr("walker_jax.design.area_gradients.MAX_RELATIVE_ERROR", 0.0)
    found = wj.measure(
        wj.SimplestWalker(0.008), "area", ["slope"], grid=grid, bands=(0.002,), levels=4
    )
    assert found.averaged.tolist() == [True]
    expected = 4 * np.pi * radius(0.008) * 10 / 2
    assert found.gradient[0] == pytest.approx(expected, rel=2e-3)
    assert abs(found.gradient[0] - expected) < 4 * found.gradient_error[0]


NONE = np.zeros(0, int)
"""No mistakes of a check."""


@pytest.mark.parametrize(
    ("fate", "strides", "counts"),
    [
        (wj.Outcome.FORWARD, 0, True),
        (wj.Outcome.OUTSIDE, 1, True),
        (wj.Outcome.OUTSIDE, 0, False),  # the border of the starts themselves is fixed
    ],
)
def test_the_error_of_an_integral_is_of_independent_parts(monkeypatch, fate, strides, counts):
    """A straight edge that moves by a rate of each line's own, but one of which none is known.

    That one counts as one that moves as the others do, in the mean square.
    """

    def follow(mapper, x, **_):
        last = 9 * x[:, 1] > 8
        labels = labels_where(x[:, 0] < 0.5, x)
        labels.fate[last & ~labels.converged] = fate
        labels.strides[last & ~labels.converged] = strides
        return labels

    monkeypatch.setattr(Mapper, "walk", follow)
    grid = wj.Grid.plain(theta=(0, 1, 4), thetadot=(0, 1, 9))
    attractor = np.repeat([0, 0, -1, -1], 9).reshape(4, 9).astype(np.int16)
    label = label_of(np.where(attractor < 0, 1, 0), attractor)
    runs = Runs.from_cells(label, np.zeros_like(label))
    walker = wj.SimplestWalker(0.004)
    mapper = Mapper(walker, [], Integrator(1e-10), 10)
    found = refinement.Refined(
        *(
            grid,
            runs,
            np.arange(36),
            np.zeros(36, int),
            mapper,
            0.5,
            0.0,
            [36],
            [18],
            0,
            NONE,
            NONE,
            0,
        )
    )

    def changes(walker, x, *_):
        line = np.floor(9 * x[:, 1])
        moves = np.where(line == 8, np.nan, 5 * line)
        return 0 * line, np.stack([np.full(len(x), -5.0), 0 * line, moves], axis=1)

    monkeypatch.setattr("walker_jax.design.area_gradients.margins_with_derivatives", changes)
    integral = integrate_along_boundary(walker, found, ("slope",))
    # lines 0 to 7 move by their numbers: in four parts, by 0 + 4, 1 + 5, 2 + 6 and 3 + 7
    assert integral.gradient[0] == pytest.approx(28 / 36, rel=1e-12)
    scatter, unknown = np.sqrt(4 * np.var([4, 6, 8, 10], ddof=1)), np.sqrt(140 / 8) * counts
    assert integral.error[0] == pytest.approx(np.hypot(scatter, unknown) / 36)
    assert (integral.crossings, integral.lost) == (9, 1)


def test_the_error_has_a_part_for_what_is_thinner_than_a_cell(disc, monkeypatch):
    """A strip of 5/8 of a cell, whose sides move by one cell: a centre is in 5 of 8 such strips."""
    strip = lambda mapper, x, **_: labels_where(np.abs(x[:, 0] - 0.375) < 5 / 64, x)
    monkeypatch.setattr(Mapper, "walk", strip)
    changes = lambda walker, x, *_: (np.zeros(len(x)), np.tile([3.0, 0.0, 3.0], (len(x), 1)))
    monkeypatch.setattr("walker_jax.design.area_gradients.margins_with_derivatives", changes)
    grid = wj.Grid.plain(theta=(0, 1, 4), thetadot=(0, 1, 8))
    found = wj.measure(wj.SimplestWalker(0.004), "area", ["slope"], grid=grid, levels=0)
    assert found.crossings == 16 and found.gradient[0] == pytest.approx(16 / 32, rel=1e-12)
    # all lines are alike: they do not scatter
    assert found.gradient_error[0] == pytest.approx(16 / 32 * (8 / 5 - 1), rel=1e-12)


SIZE = lambda slope: 0.002 + 3 * (slope - 0.004) + 50 * (slope - 0.004) ** 2
"""Of a least disturbance, that is made up."""


@pytest.mark.parametrize("direction", [[0.6, 0.8], [0.0, -1.0]])
def test_the_least_disturbance_changes_with_boundary_and_gait(monkeypatch, direction):
    """With a margin SIZE(p) - (x - g(p)) . u, times 7, of which the size is known."""
    walker, gait, u = wj.SimplestWalker(0.004), wj.find_gait(wj.SimplestWalker(0.004)), direction
    state = np.asarray(gait.states[0]) + SIZE(0.004) * np.array(u)
    found = LeastDisturbance(SIZE(0.004), np.array(u), state, 0, wj.Outcome.FORWARD, 6)
    monkeypatch.setattr(
        "walker_jax.design.disturbance_gradients.least_disturbance", lambda *_, **__: found
    )
    moved = gait_derivatives(walker, gait, "slope").states[0]

    def changes(walker, x, made, directions, parameters, tolerance):
        assert made.tolist() == [6] * len(x)
        np.testing.assert_allclose(x, np.broadcast_to(state, x.shape), rtol=0, atol=1e-9)
        row = 7 * np.array([*(-np.array(u)), 3 + moved @ u])
        margins = 7 * (SIZE(0.004) - (x - np.asarray(gait.states[0])) @ u)
        return margins, np.stack([np.full(3, np.nan), *[row] * (len(x) - 1)])  # the first unknown

    name = "walker_jax.design.disturbance_gradients.margins_with_derivatives"
    monkeypatch.setattr(name, changes)
    gradient = wj.measure(walker, "least-disturbance", ("slope",), gait)
    assert gradient.value == SIZE(0.004) and not gradient.averaged.any()
    assert gradient.gradient == pytest.approx([3.0], rel=1e-9)


def test_without_a_margin_the_least_changes_by_a_bands_average(monkeypatch):
    """Up to the ends that have the gait stable: at a slope of 0.016 it is not."""

    def least(walker, gait, **_):
        x = np.asarray(gait.states[0])
        return LeastDisturbance(
            SIZE(float(walker.slope)), np.array([1.0, 0.0]), x, 0, wj.Outcome.STRIDE, 6
        )

    monkeypatch.setattr("walker_jax.design.disturbance_gradients.least_disturbance", least)
    nan = lambda walker, x, *_: (np.full(len(x), np.nan), np.full((len(x), 3), np.nan))
    monkeypatch.setattr("walker_jax.design.disturbance_gradients.margins_with_derivatives", nan)
    walker = wj.SimplestWalker(0.012)
    assert np.isnan(wj.measure(walker, "least-disturbance", ["slope"]).gradient).all()
    for width, low, high in ((0.002, 0.010, 0.014), (0.004, 0.008, 0.012)):
        found = wj.measure(walker, "least-disturbance", ["slope"], bands=(width,))
        expected = (SIZE(high) - SIZE(low)) / (high - low)
        assert found.averaged.all() and found.gradient == pytest.approx([expected], rel=1e-9)


@pytest.mark.slow
def test_where_a_margin_jumps_the_gradient_is_a_bands_average():
    """From the nearest point of the first a strike is missed; its margin would give -0.0245."""
    names = ("hip_angle",)
    jumps = wj.PoweredWalker(0.01, 8.0, 1.0, -0.5, 0.05)
    assert np.isnan(wj.measure(jumps, "least-disturbance", names, directions=720).gradient).all()
    found = wj.measure(jumps, "least-disturbance", names, bands=(1e-4,), directions=720)
    assert found.averaged.all() and found.gradient == pytest.approx([0.10858], abs=1e-4)
    # central differences of least disturbances, over 2e-4
    smooth = wj.PoweredWalker(0.03, 3.0, 0.3, -0.2, 0.1)
    for tolerance in (None, 1e-6):
        found = wj.measure(smooth, "least-disturbance", names, directions=720, tolerance=tolerance)
        assert not found.averaged.any() and found.gradient == pytest.approx([-0.163026], abs=2e-5)


@pytest.mark.slow
def test_two_parameters_of_another_walker():
    walker = wj.SpringWalker(0.004, 0.1)
    found = wj.measure(walker, "area", ("slope", "hip_stiffness"), grid=SECTION, levels=3)
    by_slope, error = difference(lambda p: wj.SpringWalker(p, 0.1), 0.004, 4e-4, SECTION)
    assert error < 0.05 * abs(by_slope)
    assert abs(found.gradient[0] - by_slope) < 0.1 * abs(by_slope)
    by_stiffness, error = difference(lambda p: wj.SpringWalker(0.004, p), 0.1, 2e-2, SECTION)
    assert error < 0.05 * abs(by_stiffness)
    assert abs(found.gradient[1] - by_stiffness) < 0.1 * abs(by_stiffness)
    exact = wj.refine(walker, SECTION, 5)
    assert abs(found.value - float(exact.total_area)) < 4 * found.value_error


@pytest.mark.slow
def test_the_least_disturbance_changes_with_the_slope():
    size = lambda slope: wj.least_disturbance(wj.SimplestWalker(slope)).size
    found = wj.measure(wj.SimplestWalker(0.004), "least-disturbance", ["slope"])
    assert found.value == pytest.approx(0.0022561749204, abs=1e-12)
    central = (size(0.004 + 1e-5) - size(0.004 - 1e-5)) / 2e-5
    assert found.gradient[0] == pytest.approx(central, rel=1e-4)
    assert not found.averaged.any()


@pytest.mark.slow
def test_where_another_motion_is_nearest_it_is_an_average():
    """At 0.0125 the basin of a gait of period three comes closest."""
    walker = wj.SimplestWalker(0.0125)
    assert wj.least_disturbance(walker).failure == wj.Outcome.STRIDE
    assert np.isnan(wj.measure(walker, "least-disturbance", ["slope"]).gradient).all()
    found = wj.measure(walker, "least-disturbance", ["slope"], bands=(1e-4,))
    low, high = (wj.least_disturbance(wj.SimplestWalker(slope)).size for slope in (0.0124, 0.0126))
    assert found.averaged.all() and found.gradient[0] == pytest.approx((high - low) / 2e-4)


def test_where_nothing_walks_there_is_no_area_and_no_gradient():
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 20), sum=(-0.02, 0.01, 20))
    found = wj.measure(wj.SimplestWalker(0.1), "area", ["slope"], grid=grid, levels=1)
    assert found.value == 0 and found.gradient.tolist() == [0.0] and found.crossings == 0


def test_where_everything_walks_the_area_is_that_of_the_grid():
    grid = wj.Grid.plain(theta=(0.1533, 0.1535, 5), thetadot=(-0.1562, -0.156, 6))
    found = wj.measure(wj.SimplestWalker(0.004), "area", ["slope"], grid=grid, levels=1)
    assert found.value == pytest.approx(4e-8) and found.gradient.tolist() == [0.0]


@pytest.mark.slow
def test_cells_may_have_the_fates_of_their_centres():
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.02, 0.01, 40))
    fine = wj.Grid.sheared(theta=(0.1, 0.3, 160), sum=(-0.02, 0.01, 160))
    direct = (wj.basin(walker, fine, "direct").attractor >= 0).values
    options = {"strides": 200, "check": 0, "seed": 0, "tolerance": None}
    walks = refine_cells(walker, grid, 2, by_centres=True, **options).attractor >= 0
    assert walks.shape == direct.shape and np.mean(walks == direct) > 0.999
    by_points = refine_cells(walker, grid, 2, **options).attractor >= 0
    assert np.mean(by_points == direct) < 0.999


def test_crossings_are_between_neighbours_that_differ():
    attractor = np.array([[-1, 0, 0], [-1, -1, 0]])
    label = label_of(np.where(attractor < 0, 1, 0), attractor)
    runs = Runs.from_cells(label, np.zeros_like(label))
    grid = wj.Grid.plain(theta=(0, 1, 2), thetadot=(0, 1, 3))
    mapper = Mapper(wj.SimplestWalker(0.004), [], Integrator(1e-10), 10)
    found = refinement.Refined(
        *(grid, runs, np.arange(6), np.zeros(6, int), mapper, 0.5, 0.0, [6], [6], 0, NONE, NONE, 0)
    )
    inside, outside = boundary_pairs(found, 1)
    assert inside.tolist() == [[0.5, 1.5], [1.5, 2.5]]
    assert outside.tolist() == [[0.5, 0.5], [1.5, 1.5]]
    inside, outside = boundary_pairs(found, 0)
    assert inside.tolist() == [[0.5, 1.5]] and outside.tolist() == [[1.5, 1.5]]


WALKERS = {
    "simplest": (wj.SimplestWalker(0.004), 1, ("slope",)),
    "period two": (wj.SimplestWalker(0.016), 2, ("slope",)),
    "spring": (wj.SpringWalker(0.004, 0.5), 1, ("slope", "hip_stiffness")),
    "round": (wj.RoundFootWalker(0.01), 1, ("foot_radius",)),
}


@pytest.mark.parametrize(
    "name",
    [*list(WALKERS)[:2], *(pytest.param(one, marks=pytest.mark.slow) for one in list(WALKERS)[2:])],
)
def test_measures_of_a_gait_change_as_their_derivatives_say(name):
    walker, period, names = WALKERS[name]
    gait = wj.find_gait(walker, period=period)
    found = all_measures(walker, names, gait)
    assert tuple(found) == GAIT_MEASURES
    for k, parameter in enumerate(names):
        step = 1e-5 * float(getattr(walker, parameter))
        ends = []
        for side in (-1, 1):
            value = float(getattr(walker, parameter)) + side * step
            other = with_parameter(walker, parameter, np.asarray(value))
            there = wj.find_gait(other, gait.states, period)
            ends.append(all_measures(other, (), there))
        for one in GAIT_MEASURES:
            central = (ends[1][one].value - ends[0][one].value) / (2 * step)
            assert found[one].gradient[k] == pytest.approx(central, rel=1e-4, abs=1e-9), one


def test_measures_of_a_gait_are_those_of_its_geometry():
    walker = wj.SimplestWalker(0.004)
    gait, found = wj.find_gait(walker), all_measures(walker, ["slope"])
    theta = float(gait.states[0, 0])
    assert found["step-length"].value == pytest.approx(2 * np.sin(theta), rel=1e-13)
    speed = 2 * np.sin(theta) / float(gait.step_times[0])
    assert found["speed"].value == pytest.approx(speed, rel=1e-13)
    assert found["spectral-radius"].value == pytest.approx(abs(gait.multipliers[0]), rel=1e-13)
    # a step of length s lets the weight down by s sin(slope)
    assert found["cost-of-transport"].value == np.sin(0.004)
    assert found["cost-of-transport"].gradient.tolist() == [np.cos(0.004)]


@pytest.mark.slow
def test_the_step_of_a_foot_that_rolls():
    walker = wj.RoundFootWalker(0.01)
    theta = float(wj.find_gait(walker).states[0, 0])
    # the arcs' centres are 2 (l - R) sin(theta) apart, and the foot rolls by 2 R theta
    step = 2 * (1 - 0.2) * np.sin(theta) + 2 * 0.2 * theta
    assert wj.measure(walker, "step-length", ()).value == pytest.approx(step, rel=1e-12)


def test_without_a_gait_its_measures_are_nan():
    found = all_measures(wj.SimplestWalker(0.3), ("slope",))
    assert all(np.isnan(one.value) and np.isnan(one.gradient).all() for one in found.values())


def test_wrong_arguments_are_refused():
    walker = wj.SimplestWalker(0.004)
    with pytest.raises(ValueError, match="parameter must be one of the walker's"):
        wj.measure(walker, "area", ("hip_stiffness",), grid=SECTION)
    with pytest.raises(ValueError, match="parameter must be one of the walker's"):
        wj.measure(walker, "least-disturbance", ("mass",))
    with pytest.raises(ValueError, match="levels must be at least 0"):
        wj.measure(walker, "area", ["slope"], grid=SECTION, levels=-1)
    with pytest.raises(ValueError, match="strides must be at least 1"):
        wj.measure(walker, "area", ["slope"], grid=SECTION, strides=0)
    with pytest.raises(ValueError, match="grid must have 2 axes for area, not 1"):
        wj.measure(walker, "area", ["slope"], grid=wj.Grid.plain(theta=(0, 1, 5)))
    for bands in [(0.0,), (1e-4, 1e-4), (np.inf,)]:
        with pytest.raises(ValueError, match="bands must be a number above 0 for each parameter"):
            wj.measure(walker, "area", ["slope"], grid=SECTION, bands=bands)
    with pytest.raises(ValueError, match="parameter must be one of the walker's"):
        all_measures(walker, ("foot_mass",))


class OwnSpringWalker(wj.SimplestWalker):
    """A spring at the hip, set by a constructor in an order of its own."""

    stiffness: jax.Array

    def __init__(self, slope, stiffness):
        self.stiffness = jnp.asarray(stiffness)
        self.slope = jnp.asarray(slope)


def test_derivatives_are_by_names_of_parameters_in_any_order(monkeypatch):
    """Of a margin that is made up: slope x_0 + stiffness^2 x_1."""
    margin = lambda walker, x, _: walker.slope * x[0] + walker.stiffness**2 * x[1]
    for name, made_up in {
        "scan_strides": lambda step, x, *_: (SimpleNamespace(state=x), None),
        "follow_margins": lambda *given: SimpleNamespace(failed=margin(*given)),
    }.items():
        monkeypatch.setattr(f"walker_jax.stability.margin_changes.{name}", made_up)
    walker, names = OwnSpringWalker(0.009, 1.5), ["slope", "stiffness"]
    assert [*vars(walker)] == names[::-1]
    x, made = np.array([[0.1, -0.3], [0.15, -0.2]]), np.zeros(2, np.int32)
    found = differentiate_margins(walker, x, made, np.eye(2), names, 1e-12)
    expected = [[0.009, 1.5**2, theta, 2 * 1.5 * thetadot] for theta, thetadot in x]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
