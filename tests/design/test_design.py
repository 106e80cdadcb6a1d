"""Walkers that are optimised end where independent searches end, and say so."""

import itertools
import json
from typing import Any

import numpy as np
import powered_reference
import pytest
import xarray as xr
from optima import FEW, GRID, SLOPES, WALKER, measure, values
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import multivariate_normal

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.windows import default_region
from walker_jax.design.evaluation import ENDS_STAGE, evaluate_objective
from walker_jax.design.optimisation import optimise
from walker_jax.design.problem import Problem, describe_problem, parse_objective

SHOWN = 50
"""Cells along each axis in pictures of basins."""


def lowest(function):
    """The slope of its least value, and that, by golden sections."""
    found: Any = minimize_scalar(function, bounds=(0.001, 0.015), method="bounded")
    return found.x, found.fun


@pytest.fixture(scope="module")
def steepest():
    """The most stable gait, with few cells for its basin and in the pictures."""
    few = wj.Grid.sheared(theta=(0, np.pi / 4, 40), sum=(-0.12, 0.06, 80))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("walker_jax.design.optimisation.VIEW_CELLS", SHOWN)
        return optimise(WALKER, SLOPES, "spectral-radius", grid=few, starts=2, scan=7)


def test_an_optimum_within_the_bounds(steepest):
    at, least = lowest(lambda slope: measure("spectral-radius", slope))
    assert bool(steepest.found) and bool(steepest.converged)
    assert float(steepest.optimum[0]) == pytest.approx(at, abs=0.003 * 0.014)
    assert float(steepest.exact_optimum) == pytest.approx(least, abs=1e-4)
    run = values(steepest, "run")[values(steepest, "stage").index(ENDS_STAGE)]
    first = float(steepest.parameters[values(steepest, "run").index(run), 0])
    assert values(steepest, "start") == [first]
    assert float(steepest.exact_start) == pytest.approx(
        measure("spectral-radius", first), rel=1e-12
    )
    assert float(steepest.parameters[0, 0]) == 0.004
    assert values(steepest, "at_bound") == [0] and not steepest.binding.any()
    assert values(steepest, "note") == ["", ""]


def test_the_trace_holds_what_was_measured(steepest):
    climbing = steepest.isel(evaluation=steepest.stage.values >= 0)
    assert set(values(climbing, "run")) == {0, 1}
    assert set(values(climbing, "stage")) == {*range(4)}
    for row in range(0, climbing.sizes["evaluation"], 5):
        one = climbing.isel(evaluation=row)
        found = wj.measure(
            wj.SimplestWalker(float(one.parameters[0])), "spectral-radius", ["slope"]
        )
        assert float(one.value) == float(one.measures[0]) == pytest.approx(found.value, abs=1e-12)
        assert float(one.gradient[0]) == pytest.approx(found.gradient[0], rel=1e-9)
    np.testing.assert_allclose(steepest.scan_parameters[0], np.linspace(0.001, 0.015, 7))
    expected = [measure("spectral-radius", slope) for slope in np.linspace(0.001, 0.015, 7)]
    np.testing.assert_allclose(steepest.scan_value[0], expected, rtol=1e-12)
    assert steepest.scan_allowed.all()
    about = steepest.attrs
    assert about["walker"] == "SimplestWalker" and about["sign"] == -1
    assert json.loads(about["bounds"]) == {"slope": [0.001, 0.015]}


def test_basins_at_both_ends_are_shown(steepest):
    assert steepest.fate_start.dims == ("theta", "sum") == steepest.fate_optimum.dims
    view = wj.Grid.sheared(
        **{
            name: (*((axis := steepest[name].values)[[0, -1]] + np.diff(axis)[0] * shift), SHOWN)
            for name in ("theta", "sum")
            for shift in [np.array([-0.5, 0.5])]
        }
    )
    direct = wj.basin(wj.SimplestWalker(float(steepest.optimum[0])), view, "direct")
    walks = (direct.attractor >= 0).values
    shown = steepest.fate_optimum.values
    assert 0.01 < walks.mean() and np.mean((shown == -1) != walks) < 1e-4
    assert np.mean(shown[~walks] == direct.fate.values[~walks]) > 0.999
    # the picture holds all that walks on the whole section, at both ends, and little more
    whole = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.2, 0.1, 200))
    both = np.zeros(whole.shape, bool)
    for slope in (steepest.start[0], steepest.optimum[0]):
        both |= wj.basin(wj.SimplestWalker(float(slope)), whole, "direct").attractor.values >= 0
    for name, cells in zip(("theta", "sum"), np.nonzero(both), strict=True):
        inside, centres = whole.axes[name][cells], steepest[name].values
        half = np.diff(centres)[0] / 2
        left, right = centres[0] - half, centres[-1] + half
        size = np.ptp(inside)
        assert inside.min() - 0.1 * size < left < inside.min() < inside.max() < right
        assert right < inside.max() + 0.1 * size


def test_at_a_bound_and_where_a_limit_holds(no_basins):
    found = optimise(WALKER, SLOPES, "speed", grid=FEW, starts=1)
    assert values(found, "optimum") == [0.015] and values(found, "at_bound") == [1]
    assert bool(found.converged) and not found.binding.any()
    found = optimise(
        WALKER,
        SLOPES,
        "speed",
        grid=FEW,
        starts=1,
        scan=5,
        at_most={"spectral-radius": 0.9},
        at_least={"step-length": 0.25},  # at the lowest slope steps are shorter
    )
    edge = brentq(lambda slope: measure("spectral-radius", slope) - 0.9, 0.01, 0.015)
    assert float(found.optimum[0]) == pytest.approx(edge, rel=1e-7)
    assert values(found, "at_bound") == [0] and bool(found.converged)
    assert dict(zip(values(found, "measure"), values(found, "binding"), strict=True)) == {
        "speed": False,
        "spectral-radius": True,
        "step-length": False,
    }
    slopes = np.linspace(0.001, 0.015, 5)
    stable = [measure("spectral-radius", slope) <= 0.9 for slope in slopes]
    long = [measure("step-length", slope) >= 0.25 for slope in slopes]
    assert stable == [True, True, True, True, False] and long == [False, True, True, True, True]
    assert found.scan_allowed.values[0].tolist() == [False, True, True, True, False]


@pytest.mark.slow
def test_a_weighted_sum(no_basins):
    """Speed against steepness: where ten times speed falls behind ninety times the slope."""
    weights = {"speed": 10.0, "cost-of-transport": -90.0}
    found = optimise(WALKER, SLOPES, weights, grid=FEW, starts=1)
    total = lambda slope: 10 * measure("speed", slope) - 90 * np.sin(slope)
    at, least = lowest(lambda slope: -total(slope))
    assert 0.0011 < at < 0.0149
    assert float(found.optimum[0]) == pytest.approx(at, abs=0.003 * 0.014)
    assert float(found.exact_optimum) == pytest.approx(-least, abs=1e-4)
    assert found.attrs["sign"] == 1 and values(found, "measure") == list(weights)


@pytest.mark.slow
def test_two_parameters_along_a_limit():
    """The least slope at a speed: the stiffest spring, and the slope that then gives the speed."""
    bounds = {"slope": (0.001, 0.01), "hip_stiffness": (0.0, 0.5)}
    walker = wj.SpringWalker(0.006, 0.1)
    speed = 0.09
    found = optimise(walker, bounds, "cost-of-transport", at_least={"speed": speed}, starts=1)
    fast = lambda slope: wj.measure(wj.SpringWalker(slope, 0.5), "speed", ()).value - speed
    assert values(found, "at_bound") == [0, 1] and bool(found.binding[1])
    assert float(found.optimum[0]) == pytest.approx(brentq(fast, 0.001, 0.01), rel=1e-6)
    assert float(found.optimum[1]) == 0.5 and bool(found.converged)


@pytest.mark.slow
def test_the_area_is_largest_on_the_gentlest_slope(no_basins, monkeypatch):
    """In one stage, of long steps."""
    for module in ("climbs", "optimisation"):
        monkeypatch.setattr(f"walker_jax.design.{module}.STEP_SIZES", (0.4,))
    bounds, walker = {"slope": (0.003, 0.009)}, wj.SimplestWalker(0.007)
    found = optimise(walker, bounds, grid=GRID, starts=1, scan=3, levels=3)
    assert values(found, "optimum") == [0.003] and values(found, "at_bound") == [-1]
    assert bool(found.converged)
    areas = {slope: wj.refine(wj.SimplestWalker(slope), GRID, 3) for slope in (0.003, 0.007)}
    for end, slope in (("optimum", 0.003), ("start", 0.007)):
        error = 4 * float(found[f"exact_{end}_error"]) + 4 * float(areas[slope].total_area_error)
        assert abs(float(found[f"exact_{end}"]) - float(areas[slope].total_area)) < error
    assert np.all(np.diff(found.scan_value[0]) < 0)
    climbing = found.isel(evaluation=found.stage.values >= 0)
    assert climbing.sizes["evaluation"] < 6
    known = climbing.gradient.values[np.isfinite(climbing.gradient_error.values)]
    assert len(known) >= 2 and np.all(known < 0) and np.all(climbing.strides > 0)


@pytest.mark.slow
def test_from_where_nothing_walks_it_leads_to_a_walk():
    bounds = {"slope": (0.001, 0.05)}
    walker = wj.SimplestWalker(0.03)
    found = optimise(walker, bounds, grid=GRID, starts=1, levels=1)
    first = found.isel(evaluation=0)
    assert float(first.value) == 0 and first.gradient.values.tolist() == [0.0]
    assert bool(found.found) and float(found.exact_start) == 0 < float(found.exact_optimum)
    measured = (found.stage.values >= 0) & np.isfinite(found.gradient_error.values[:, 0])
    assert measured.sum() >= 2 and np.isfinite(found.gradient.values[measured]).all()


@pytest.mark.parametrize(
    ("slopes", "reason"),
    [
        pytest.param(
            *((0.05, 0.06), "the gait of period 1 has a multiplier of modulus"),
            marks=pytest.mark.slow,
        ),
        ((0.4, 0.5), "no gait is found"),
    ],
)
def test_where_nothing_leads_anywhere_that_is_said(slopes, reason):
    walker = wj.SimplestWalker(sum(slopes) / 2)
    found = optimise(walker, {"slope": slopes}, grid=FEW, starts=1, levels=1)
    assert not found.found and "optimum" not in found
    assert all(reason in note and "slope 0." in note for note in values(found, "note"))


def test_a_limit_out_of_reach_is_named():
    found = optimise(WALKER, SLOPES, "spectral-radius", at_least={"speed": 0.2}, starts=1)
    assert not found.found
    reason = "slope 0.004: speed is 0.07932, and the search found no place with at least 0.2"
    assert values(found, "note") == [reason]


def test_an_interrupted_run_goes_on(no_basins, tmp_path, monkeypatch):
    kept = []

    def keep(trace):
        kept.append(trace)
        if len(kept) == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimise(WALKER, SLOPES, "speed", grid=FEW, starts=2, keep=keep)
    assert [one.sizes["evaluation"] for one in kept] == [*range(1, 8)]
    whole = optimise(WALKER, SLOPES, "speed", grid=FEW, starts=2)

    made = []
    monkeypatch.setattr(
        "walker_jax.design.trace.evaluate_objective",
        lambda *all, **how: made.append(all) or evaluate_objective(*all, **how),
    )
    storage.save(kept[-1], tmp_path / "trace.zarr", {})
    known = storage.load(tmp_path / "trace.zarr")
    assert known is not None
    kept.clear()
    again = optimise(WALKER, SLOPES, "speed", grid=FEW, starts=2, known=known, keep=kept.append)
    xr.testing.assert_identical(again, whole)
    # the last two stages measure alike
    distinct, before = (
        {
            (min(stage, 2), at)
            for stage, at in zip(data.stage.values, data.parameters.values[:, 0], strict=True)
        }
        for data in (whole, known)
    )
    assert len(made) == len(distinct - before) < len(distinct)
    # what is kept on the way holds all that is known, lest a second interruption lose it
    assert len(kept) == len(distinct - before)
    assert kept[0].sizes["evaluation"] == len(before) + 1
    made.clear()
    xr.testing.assert_identical(
        optimise(WALKER, SLOPES, "speed", grid=FEW, starts=2, known=whole), whole
    )
    assert not made


def test_measurements_of_something_else_are_refused(no_basins):
    known = optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", starts=1)
    with pytest.raises(ValueError, match="known must be of the same objective"):
        optimise(WALKER, {"slope": (0.008, 0.009)}, "step-length", known=known)
    with pytest.raises(ValueError, match="known must be of the same bounds"):
        optimise(WALKER, SLOPES, "speed", known=known)
    with_option = known.assign_attrs(walker_check_scuffing=1)
    with pytest.raises(ValueError, match="the same walker_check_scuffing, None, not 1"):
        optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", known=with_option)


def test_a_problem_is_described_by_density_and_plane():
    plane = wj.Grid.sheared(theta=(0, 0.4, 8), sum=(-0.04, 0.01, 5))
    weighted = Problem(
        *(WALKER, ("slope",), np.array([0.004]), np.array([0.02]), {"basin-stability": 1.0}, 1.0),
        *({}, plane, 0, 200, 0, None, lambda x: np.ones(len(x))),
    )
    other = weighted._replace(density=lambda x: np.full(len(x), 7.0))
    assert describe_problem(weighted) == describe_problem(weighted._replace(seed=0))
    assert describe_problem(weighted)["density"] != describe_problem(other)["density"]
    through = [
        wj.Grid.through({"theta": 0.2, "thetadot": -0.26, "phidot": at}, theta=(-0.1, 0.1, 4))
        for at in (-0.05, -0.4)
    ]
    box = {"theta": (0, 0.4, 8), "sum": (-0.04, 0.01, 5)}
    turned = [wj.Grid(box, np.array([[1, 0], [slant, 1]])) for slant in (0, -1, 2)]
    regions = [
        json.loads(describe_problem(weighted._replace(grid=grid, density=None))["region"])
        for grid in (*through, *turned, plane)
    ]
    assert all(one != two for one, two in itertools.combinations(regions[:5], 2))
    assert regions[4]["shear"] == [[1, 0], [2, 1]] and regions[4]["origin"] == [0, 0]
    assert regions[3] == regions[5] == {name: list(axis) for name, axis in box.items()}


def test_limits_hold_at_a_loose_tolerance(no_basins):
    limits = {"spectral-radius": 0.9}
    found = optimise(WALKER, SLOPES, "speed", starts=1, grid=FEW, at_most=limits, tolerance=1e-6)
    assert float(found.optimum[0]) == pytest.approx(0.01465582, rel=1e-4)


def test_a_stage_that_cannot_begin_keeps_what_was_found(no_basins, monkeypatch):

    def failing(problem, stage, *all, **how):
        row = evaluate_objective(problem, stage, *all, **how)
        return row._replace(gradient=row.gradient * np.nan) if stage >= 1 else row

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", failing)
    found = optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", grid=FEW, starts=1)
    assert bool(found.found) and not found.converged
    assert float(found.exact_optimum) == pytest.approx(measure("speed", 0.009), rel=1e-9)


def test_objectives_have_their_senses():
    assert parse_objective("area") == ({"area": 1.0}, 1.0)
    assert parse_objective("spectral-radius") == ({"spectral-radius": 1.0}, -1.0)
    assert parse_objective({"speed": 2, "spectral-radius": -1}) == (
        {"speed": 2.0, "spectral-radius": -1.0},
        1.0,
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"bounds": {}}, "bounds must name at least one parameter"),
        ({"bounds": {"mass": (0.1, 1.0)}}, "parameter must be one of the walker's, slope, not 'm"),
        ({"bounds": {"slope": (0.1, 0.1)}}, "bounds of slope must be finite, the lower first"),
        ({"bounds": {"slope": (0.1, np.inf)}}, "bounds of slope must be finite"),
        ({"bounds": {"slope": (0.0, 0.1)}}, "slope must be above 0 and below 1.5708, not 0"),
        ({"bounds": {"slope": 0.1}}, "bounds of slope must be two numbers, not 0.1"),
        ({"objective": "beauty"}, "objective must be one of area, .*, not 'beauty'"),
        ({"objective": {}}, "objective must name at least one measure"),
        ({"objective": {"area": 0.0}}, "objective must give area a weight other than 0, not 0.0"),
        (
            {"at_least": {"area": 0.1}},
            "at_least and at_most must be of one of step-length, .*'area'",
        ),
        (
            {"at_most": {"speed": np.nan}},
            "at_least and at_most of speed must be finite numbers, not nan",
        ),
        (
            {"at_most": {"speed": 0.1}, "at_least": {"speed": 0.2}},
            "at_least speed must be below at_most, not 0.2 and 0.1",
        ),
        ({"starts": 0}, "starts must be at least 1, not 0"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
        ({"objective": {"speed": "x"}}, "objective must give speed a weight other than 0, not x"),
        (
            {"at_least": {"speed": "x"}},
            "at_least and at_most of speed must be finite numbers, not 'x'",
        ),
        ({"strides": 0}, "strides must be at least 1, not 0"),
        ({"levels": -1}, "levels must be at least 0, not -1"),
        ({"scan": -1}, "scan must be at least 0, not -1"),
        ({"grid": wj.Grid.plain(theta=(0, 1, 5))}, "grid must have the 2 dimensions"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(given, message, monkeypatch):
    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", None)
    with pytest.raises(ValueError, match=message):
        optimise(WALKER, **{"bounds": SLOPES} | given)


@pytest.mark.slow
def test_the_area_over_the_whole_range_of_slopes():
    """At the lower bound, as the area falls with the slope; or where the least speed holds it."""
    found = optimise(WALKER, SLOPES, scan=20)
    assert values(found, "optimum") == [0.001] and values(found, "at_bound") == [-1]
    assert np.all(np.diff(found.scan_value[0]) <= 0) and float(found.exact_optimum) > 0.00208
    found = optimise(WALKER, SLOPES, at_least={"speed": 0.06}, scan=20)
    edge = brentq(lambda slope: measure("speed", slope) - 0.06, 0.001, 0.004)
    assert float(found.optimum[0]) == pytest.approx(edge, rel=1e-7)
    assert values(found, "binding") == [False, True] and values(found, "at_bound") == [0]
    allowed = found.scan_allowed.values[0]
    best = found.scan_value.values[0][allowed].max()
    assert float(found.objective_optimum) > best


@pytest.mark.slow
def test_the_least_disturbance_is_largest_within_the_bounds():
    found = optimise(WALKER, SLOPES, "least-disturbance", scan=39)
    assert values(found, "at_bound") == [0] and bool(found.converged)
    assert float(found.optimum[0]) == pytest.approx(0.0077, abs=3e-4)
    assert float(found.exact_optimum) == pytest.approx(0.002355, abs=2e-6)
    assert float(found.exact_optimum) > np.nanmax(found.scan_value.values)


@pytest.mark.slow
def test_a_spring_makes_the_basin_many_times_as_large():
    walker = wj.SpringWalker(0.004, 0.0)
    found = optimise(walker, {"hip_stiffness": (0.0, 2.0)}, starts=1, levels=3)
    assert values(found, "optimum") == [2.0] and values(found, "at_bound") == [1]
    region = default_region(walker)
    assert region is not None
    simplest = wj.refine(WALKER, region, 3)
    assert float(found.exact_start) == pytest.approx(float(simplest.total_area), rel=0.01)
    assert float(found.exact_optimum) > 20 * float(found.exact_start)
    for end, stiffness in (("start", 0.0), ("optimum", 2.0)):  # by walks from random starts
        other = wj.SpringWalker(0.004, stiffness)
        starts = wj.basin_stability(other, region, samples=400_000, strides=200, seed=9)
        area, error = (float(found[f"exact_{end}{one}"]) for one in ("", "_error"))
        low, high = (
            float(share) * region.size * region.cell_area for share in (starts.low, starts.high)
        )
        assert low - 2 * error < area < high + 2 * error


@pytest.mark.slow
def test_an_optimised_hip_spring_has_the_norm_that_scipy_says(no_basins):
    """Stiffness and slack angle, for the gait sensitivity norm; before and after."""
    bounds = {"hip_stiffness": (0.0, 4.0), "hip_angle": (-0.3, 0.1)}
    found = optimise(wj.PoweredWalker(0.009, 1.0), bounds, "sensitivity-norm", starts=1)
    norms = []
    for end in ("start", "optimum"):
        stiffness, angle = values(found, end)
        gait = wj.find_gait(wj.PoweredWalker(0.009, stiffness, hip_angle=angle))
        own = 0.009, stiffness, 0.0, angle, 0.0
        norms.append(powered_reference.sensitivity_norm(own, gait.states[0]))
        assert float(found[f"exact_{end}"]) == pytest.approx(norms[-1], rel=1e-7)
    assert norms[1] < 0.7 * norms[0]


@pytest.mark.slow
def test_the_fastest_walk_on_level_ground_at_a_cost(no_basins):
    """The push-off that costs as much as is allowed: energy for weight and distance."""
    walker, most = wj.PoweredWalker(0.0, push_off=0.05), 0.004
    bounds, limits = {"push_off": (0.02, 0.1)}, {"cost-of-transport": most}
    found = optimise(walker, bounds, "speed", at_most=limits, starts=2)

    def excess(push_off):
        gait = wj.find_gait(wj.PoweredWalker(0.0, push_off=push_off))
        return push_off**2 / 2 / (2 * np.sin(gait.states[0, 0])) - most

    assert float(found.optimum[0]) == pytest.approx(brentq(excess, 0.03, 0.09), rel=1e-6)
    assert bool(found.binding[1]) and set(values(found, "run")) == {0, 1}


@pytest.mark.slow
def test_an_optimal_basin_stability_is_that_of_other_starts(no_basins, monkeypatch):
    """Under a density about one place, the best slope is one whose basin is there."""
    for module in ("climbs", "optimisation"):
        monkeypatch.setattr(f"walker_jax.design.{module}.STEP_SIZES", (0.2, 0.05))
    mean, covariance = [0.2, -0.2], np.array([[4e-4, -3e-4], [-3e-4, 2.6e-4]])
    distribution: Any = multivariate_normal
    found = optimise(
        *(WALKER, {"slope": (0.003, 0.014)}, "basin-stability"),
        density=distribution(mean, covariance).pdf,
        grid=wj.Grid.sheared(theta=(0, 0.4, 60), sum=(-0.06, 0.04, 60)),
        starts=1,
        levels=2,
    )
    draw = lambda rng, n: rng.multivariate_normal(mean, covariance, n)
    chance = lambda slope: wj.basin_stability(wj.SimplestWalker(slope), draw, samples=4000, seed=9)
    for end in ("start", "optimum"):
        other, error = chance(values(found, end)[0]), 3 * float(found[f"exact_{end}_error"])
        assert other.low - error < float(found[f"exact_{end}"]) < other.high + error
    best = values(found, "optimum")[0]
    assert values(found, "at_bound") == [0]
    assert all(chance(best).low > chance(slope).high for slope in (0.7 * best, 1.4 * best))
