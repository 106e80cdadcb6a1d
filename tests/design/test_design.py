"""Walkers that are optimised end where independent searches end, and say so."""

import itertools
import json
from typing import Any

import numpy as np
import powered_reference
import pytest
import xarray as xr
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import multivariate_normal

import walker_jax as wj
from walker_jax import storage
from walker_jax.design import climbs, problem
from walker_jax.design.evaluation import ENDS_STAGE, Evaluation, evaluate_objective
from walker_jax.design.limits import Slack
from walker_jax.design.measures import Measure
from walker_jax.design.optimisation import optimise
from walker_jax.design.problem import (
    Problem,
    describe_problem,
    latin_hypercube,
    parse_objective,
    starting_places,
)
from walker_jax.design.trace import Trace
from walker_jax.stability.slices import default_region

WALKER = wj.SimplestWalker(0.004)
SLOPES = {"slope": (0.001, 0.015)}
"""On all of them the gait with the largest basin is the long one of period one."""
GRID = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 60))
FEW = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.02, 0.01, 12))
"""Walkers reach the gait from a few of its cells, and the search for it is quick."""
SHOWN = 100
"""Cells along each axis in pictures of basins."""


def measure(name, slope):
    return wj.gait_measures(wj.SimplestWalker(slope), ())[name].value


def lowest(function):
    """The slope of its least value, and that, by golden sections."""
    found: Any = minimize_scalar(function, bounds=(0.001, 0.015), method="bounded")
    return found.x, found.fun


def values(data, name):
    return data[name].values.tolist()


@pytest.fixture
def no_basins(monkeypatch):
    """Those at both ends take most of the time, and have a test of their own."""
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})


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
        found = wj.gait_measures(wj.SimplestWalker(float(one.parameters[0])))["spectral-radius"]
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
    fast = lambda slope: wj.gait_measures(wj.SpringWalker(slope, 0.5), ())["speed"].value - speed
    assert values(found, "at_bound") == [0, 1] and bool(found.binding[1])
    assert float(found.optimum[0]) == pytest.approx(brentq(fast, 0.001, 0.01), rel=1e-6)
    assert float(found.optimum[1]) == 0.5 and bool(found.converged)


@pytest.mark.slow
def test_the_area_is_largest_on_the_gentlest_slope(no_basins, monkeypatch):
    """In one stage, of long steps."""
    for module in ("climbs", "optimisation"):
        monkeypatch.setattr(f"walker_jax.design.{module}.STEP_LENGTHS", (0.4,))
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
    assert np.all(climbing.gradient < 0) and np.all(climbing.strides > 0)


@pytest.mark.slow
def test_a_start_where_nothing_walks_is_led_to_where_something_does():
    bounds = {"slope": (0.001, 0.05)}
    walker = wj.SimplestWalker(0.03)
    found = optimise(walker, bounds, grid=GRID, starts=1, levels=1)
    first = found.isel(evaluation=0)
    assert float(first.value) == 0 and first.gradient.values.tolist() == [0.0]
    assert bool(found.found) and float(found.exact_start) == 0 < float(found.exact_optimum)
    assert np.isfinite(found.gradient.values[found.stage.values >= 0]).all()


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
        lambda *all: made.append(all) or evaluate_objective(*all),
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


def test_random_places_are_one_in_each_layer_along_every_axis():
    places = latin_hypercube(7, 3, seed=2)
    np.testing.assert_array_equal(np.sort(np.floor(7 * places), axis=0).T, [range(7)] * 3)
    assert len(np.unique(places)) == 21 and len(latin_hypercube(0, 3, seed=2)) == 0
    assert not np.array_equal(places, latin_hypercube(7, 3, seed=3))


def test_measurements_of_something_else_are_refused(no_basins):
    known = optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", starts=1)
    with pytest.raises(ValueError, match="known must be of the same objective"):
        optimise(WALKER, {"slope": (0.008, 0.009)}, "step-length", known=known)
    with pytest.raises(ValueError, match="known must be of the same bounds"):
        optimise(WALKER, SLOPES, "speed", known=known)
    with_option = known.assign_attrs(walker_check_scuffing=1)
    with pytest.raises(ValueError, match="the same walker_check_scuffing, None, not 1"):
        optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", known=with_option)


def test_a_problem_is_described_by_its_density_and_by_the_plane_of_its_grid():
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


def test_parameters_that_the_walker_refuses_together_are_not_tried():
    walker = wj.RoundFootWalker(0.01, leg_length=0.6, foot_radius=0.3)
    bounds = {"foot_radius": (0.1, 0.5), "leg_length": (0.4, 1.0)}
    trace = Trace(problem_of(walker, bounds), None, None, False, 1)
    assert trace.limits.nearest_allowed(np.array([1.0, 0.0])) is None
    assert "foot_radius must be less than leg_length" in climbs.explain_failure(
        trace, np.array([1.0, 0.0])
    )
    np.testing.assert_array_equal(trace.limits.nearest_allowed(np.array([0.5, 0.5])), [0.5, 0.5])


def test_a_stage_that_cannot_begin_keeps_what_was_found(no_basins, monkeypatch):

    def failing(problem, stage, values, gait_of):
        row = evaluate_objective(problem, stage, values, gait_of)
        return row._replace(gradient=row.gradient * np.nan) if stage >= 1 else row

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", failing)
    found = optimise(WALKER, {"slope": (0.008, 0.009)}, "speed", grid=FEW, starts=1)
    assert bool(found.found) and not found.converged
    assert float(found.exact_optimum) == pytest.approx(measure("speed", 0.009), rel=1e-9)


def problem_of(walker, bounds, **limits):
    low, high = np.array(list(bounds.values())).T
    return problem.Problem(
        walker, tuple(bounds), low, high, {"speed": 1.0}, 1.0, limits, None, 0, 200, 0, None
    )


def test_places_between_the_bounds():
    problem = problem_of(WALKER, {"slope": (0.1 + 0.2, 0.7)})
    assert problem.values(np.array([0.0])) == [0.1 + 0.2] and problem.values(np.array([1.0])) == 0.7
    assert problem.place_of(np.array([0.5])) == pytest.approx([0.5])
    problem = problem_of(wj.SpringWalker(0.004, 0.25), {**SLOPES, "hip_stiffness": (0.0, 1.0)})
    places = starting_places(problem, 4)
    np.testing.assert_allclose(places[0], [0.003 / 0.014, 0.25])
    assert len({tuple(place) for place in places}) == 4
    thirds = np.sort(np.floor(3 * np.array(places[1:])), axis=0)  # one in each, along each
    np.testing.assert_array_equal(thirds, [[0, 0], [1, 1], [2, 2]])
    outside = problem_of(wj.SpringWalker(0.05, 0.25), {**SLOPES, "hip_stiffness": (0.0, 1.0)})
    assert len(starting_places(outside, 3)) == 3
    assert all(np.all((place > 0) & (place < 1)) for place in starting_places(outside, 3))


def test_steps_keep_to_bounds_and_limits(monkeypatch):
    problem = problem_of(WALKER, SLOPES, speed=(0.06, np.inf))
    trace = Trace(problem, None, None, False, 1)
    edge = brentq(lambda slope: measure("speed", slope) - 0.06, 0.001, 0.004)
    back = trace.limits.nearest_allowed(np.array([0.0]))
    assert back is not None
    assert problem.values(back)[0] == pytest.approx(edge, rel=1e-8)
    np.testing.assert_array_equal(trace.limits.nearest_allowed(np.array([0.5])), [0.5])
    np.testing.assert_allclose(
        trace.limits.feasible_direction(back, np.array([-1.0])), [0.0], atol=1e-12
    )
    assert trace.limits.feasible_direction(back, np.array([1.0])).tolist() == [1.0]
    bounds = {**SLOPES, "hip_stiffness": (0.0, 1.0)}
    both = Trace(problem_of(wj.SpringWalker(0.004), bounds), None, None, False, 1)
    slant = Slack("speed", 0.0, np.array([1.0, 2.0]))
    monkeypatch.setattr(both.limits, "slacks", lambda *_: [slant])
    # against a limit, and then against a bound as well: no way is left
    np.testing.assert_allclose(
        both.limits.feasible_direction(np.array([0.5, 0.5]), np.array([-1.0, 0.0])), [-0.8, 0.4]
    )
    np.testing.assert_allclose(
        both.limits.feasible_direction(np.array([0.5, 1.0]), np.array([-1.0, 0.0])),
        [0.0, 0.0],
        atol=1e-12,
    )
    monkeypatch.undo()
    free = Trace(problem_of(WALKER, SLOPES), None, None, False, 1)
    assert free.limits.feasible_direction(np.array([0.0]), np.array([-1.0])).tolist() == [0.0]
    assert free.limits.feasible_direction(np.array([0.0]), np.array([1.0])).tolist() == [1.0]


@pytest.mark.slow
def test_measures_are_those_of_the_gait_with_the_largest_basin():
    """A search for the most stable gait ends in another one."""
    walker, values = wj.SpringWalker(0.004, 11.24), np.array([11.24])
    grid = wj.Grid.sheared(theta=(0.02, 0.2, 12), sum=(-0.2, 0, 16))
    springs = problem_of(walker, {"hip_stiffness": (11.0, 11.5)})._replace(grid=grid)
    trace = Trace(springs, None, None, False, 1)
    owner = wj.find_gait(walker, [0.0908, -0.2074])
    expected = wj.gait_measures(walker, ("hip_stiffness",), owner)["speed"]
    row = trace.measure(0, 0, springs.place_of(values))
    assert float(row.value) == pytest.approx(expected.value, rel=1e-12)
    assert row.gradient == pytest.approx(expected.gradient, rel=1e-8)


def test_the_gait_has_the_largest_basin_or_is_the_most_stable_one_where_nothing_walks():
    doubled = problem_of(WALKER, SLOPES)._replace(grid=FEW)
    trace = Trace(doubled, None, None, False, 1)
    assert [len(trace.gait(np.array([slope])).states) for slope in (0.0165, 0.03)] == [2, 1]
    assert "an unstable gait" in trace.note(np.array([0.0165]))
    assert trace.note(np.array([0.03])) == trace.note(np.array([0.009])) == ""
    of_area = doubled._replace(weights={"area": 1.0})
    assert Trace(of_area, None, None, False, 1).note(np.array([0.0165])) == ""


def test_within_their_errors_values_are_not_believed():
    def row(place, value, gradient, error=0.1):
        numbers = (np.array([place]), value, error, np.array([gradient]), np.zeros(1))
        return Evaluation(0, 0, *numbers, np.zeros(1), 0)

    problem = problem_of(WALKER, SLOPES)
    here = row(0.010, 1.0, 1.0)
    assert climbs.is_better(problem, here, row(0.012, 1.5, -1.0))
    assert not climbs.is_better(problem, here, row(0.012, 0.5, 1.0))
    assert climbs.is_better(problem, here, row(0.012, 0.9, 1.0))
    assert not climbs.is_better(problem, here, row(0.012, 1.1, -1.0))  # beyond the top
    assert not climbs.is_better(problem, here, row(0.008, 1.1, 1.0))
    small = problem._replace(sign=-1.0)
    assert climbs.is_better(small, here, row(0.012, 0.5, 1.0))
    assert climbs.is_better(small, here, row(0.008, 1.1, 1.0))
    exact = row(0.010, 1.0, 1.0, 0.0)
    assert climbs.is_better(problem, exact, row(0.012, 1.0 + 1e-12, -1.0, 0.0))


def made_up(problem, stage, values, value, area=0.0):
    """A row of the trace."""
    none = np.zeros(len(values))
    return Evaluation(
        -1, stage, values, value, 0.0, none, none, np.full(len(problem.measures), area), 0
    )


@pytest.mark.parametrize(("walking_below", "steps"), [(0.012, 4), (0.0, 8)])
def test_from_where_nothing_walks_steps_lead_to_where_the_gait_is_more_stable(
    monkeypatch, walking_below, steps
):
    """By a tenth of the bounds along the parameter that matters most, and others in proportion."""
    bounds = {"slope": (0.001, 0.021), "hip_stiffness": (0.0, 2.0)}
    problem = problem_of(wj.SpringWalker(0.019, 0.4), bounds)._replace(weights={"area": 1.0})
    radius = Measure(1.5, np.array([2 / 0.02, -1 / 2]))
    monkeypatch.setattr(
        "walker_jax.design.climbs.gait_measures", lambda *_, **__: {"spectral-radius": radius}
    )
    monkeypatch.setattr(Trace, "gait", lambda *_: None)
    asked = []

    def evaluate_objective(problem, stage, values, gait_of):
        asked.append(values)
        return made_up(problem, stage, values, 1.0, area=float(values[0] < walking_below))

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    begin = np.array([0.019, 0.4])
    trace = Trace(problem, None, None, False, 1)
    found = climbs.rescue(trace, 0, made_up(problem, 0, begin, 0.0))
    way = np.arange(1, 9)[:, None] * [-0.002, 0.1]
    np.testing.assert_allclose(asked, (begin + way)[:steps], rtol=1e-9)
    assert (found is not None) == (steps == 4)
    flat = {"spectral-radius": Measure(1.5, np.zeros(2))}
    monkeypatch.setattr("walker_jax.design.climbs.gait_measures", lambda *_, **__: flat)
    assert climbs.rescue(trace, 0, made_up(problem, 0, begin, 0.0)) is None


@pytest.mark.parametrize(("objective", "best"), [("speed", 1), ("spectral-radius", 2)])
def test_the_best_of_the_first_climbs_goes_on(no_basins, monkeypatch, objective, best):
    """The climbs are made up; one of them leads nowhere, and the third stage cannot begin."""
    heights, asked = [0.5, 0.75, 0.25, None], []

    def climb(trace, run, stage, place):
        asked.append((run, stage))
        if stage == 2 or heights[run] is None:
            return climbs.Climb(None, None, False, "nothing there")
        high = heights[run] + stage / 100
        start = made_up(trace.problem, stage, trace.problem.values(place), high)
        return climbs.Climb(start, start._replace(value=high + 0.005), True)

    evaluate_objective = lambda problem, stage, values, _: made_up(problem, stage, values, 0.125)
    monkeypatch.setattr("walker_jax.design.optimisation.climb", climb)
    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    found = optimise(WALKER, SLOPES, objective, starts=4)
    assert sorted(asked[:4]) == [(run, 0) for run in range(4)]  # side by side, in any order
    assert asked[4:] == [(best, stage) for stage in (1, 2, 3)]
    assert values(found, "note") == ["", "", "", "nothing there"]
    assert float(found.objective_start) == heights[best]
    assert float(found.objective_optimum) == heights[best] + 0.03 + 0.005
    assert float(found.exact_start) == float(found.exact_optimum) == 0.125 and found.converged


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
def test_a_spring_between_the_legs_makes_the_basin_many_times_as_large():
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
def test_basin_stability_is_optimised_and_confirmed_by_other_starts(no_basins, monkeypatch):
    """Under a density about one place, the best slope is one whose basin is there."""
    for module in ("climbs", "optimisation"):
        monkeypatch.setattr(f"walker_jax.design.{module}.STEP_LENGTHS", (0.2, 0.05))
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
