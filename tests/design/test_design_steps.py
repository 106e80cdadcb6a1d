"""The steps that an optimisation takes: places, limits, measures and climbs."""

from contextlib import closing
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from optima import FEW, SLOPES, WALKER, measure, values
from scipy.optimize import brentq

import walker_jax as wj
from walker_jax.design import climbs, evaluation, problem
from walker_jax.design.area_gradients import AreaSettings
from walker_jax.design.evaluation import ENDS_STAGE, HURRIED_ENDS_STAGE, Evaluation
from walker_jax.design.limits import Slack
from walker_jax.design.measures import Measure
from walker_jax.design.optimisation import optimise
from walker_jax.design.problem import latin_hypercube, starting_places
from walker_jax.design.trace import KEPT_AREAS, Trace


def test_random_places_are_one_in_each_layer_along_every_axis():
    places = latin_hypercube(7, 3, seed=2)
    np.testing.assert_array_equal(np.sort(np.floor(7 * places), axis=0).T, [range(7)] * 3)
    assert len(np.unique(places)) == 21 and len(latin_hypercube(0, 3, seed=2)) == 0
    assert not np.array_equal(places, latin_hypercube(7, 3, seed=3))


def test_parameters_that_a_walker_refuses_are_not_tried():
    walker = wj.RoundFootWalker(0.01, leg_length=0.6, foot_radius=0.3)
    bounds = {"foot_radius": (0.1, 0.5), "leg_length": (0.4, 1.0)}
    trace = Trace(problem_of(walker, bounds), None, None, False, 1)
    assert trace.limits.nearest_allowed(np.array([1.0, 0.0])) is None
    assert "foot_radius must be less than leg_length" in climbs.explain_failure(
        trace, np.array([1.0, 0.0])
    )
    np.testing.assert_array_equal(trace.limits.nearest_allowed(np.array([0.5, 0.5])), [0.5, 0.5])


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
    expected = wj.measure(walker, "speed", ("hip_stiffness",), owner)
    row = trace.measure(0, 0, springs.place_of(values))
    assert float(row.value) == pytest.approx(expected.value, rel=1e-12)
    assert row.gradient == pytest.approx(expected.gradient, rel=1e-8)


def test_the_gait_has_the_largest_basin_or_is_the_most_stable():
    doubled = problem_of(WALKER, SLOPES)._replace(grid=FEW)
    trace = Trace(doubled, None, None, False, 1)
    assert [len(trace.gait(np.array([slope])).states) for slope in (0.0165, 0.03)] == [2, 1]
    assert "an unstable gait" in trace.note(np.array([0.0165]))
    assert trace.note(np.array([0.03])) == trace.note(np.array([0.009])) == ""
    of_area = doubled._replace(weights={"area": 1.0})
    assert Trace(of_area, None, None, False, 1).note(np.array([0.0165])) == ""


def test_a_gain_is_sure_beyond_the_errors_of_both_ends():
    """Two standard errors of the difference: with 0.3 and 0.4, that is 1."""
    nothing = np.zeros(1)
    row = lambda value, error: Evaluation(0, 0, nothing, value, error, nothing, nothing, nothing, 0)
    for sign in (1.0, -1.0):
        one = problem_of(WALKER, SLOPES)._replace(sign=sign)
        for errors in ((0.3, 0.4), (0.4, 0.3)):
            gain = lambda by, errors=errors, one=one: climbs.sure_gain(
                one, row(2.0, errors[0]), row(2.0 + by, errors[1])
            )
            assert gain(0.99) == gain(-0.99) == 0
            assert [gain(1.01), gain(-1.01)] == pytest.approx([1.01 * sign, -1.01 * sign])


def test_errors_of_an_area_are_positive_whatever_its_weight(monkeypatch):
    area = Measure(2.0, np.array([3.0]), 0.1, np.array([0.2]), np.array([False]), 5, 0, strides=7)
    monkeypatch.setattr(evaluation, "differentiate_area", lambda *_: area)
    of_area = problem_of(WALKER, SLOPES)._replace(grid=FEW, weights={"area": -2.0})
    measured: Any = lambda *_: None
    row = evaluation.evaluate_objective(of_area, 0, np.array([0.004]), measured, measured)
    assert (row.value, row.gradient.tolist()) == (-4.0, [-6.0])
    assert (row.value_error, row.gradient_error.tolist()) == (0.2, [0.4])


def test_areas_at_the_ends_have_the_tolerance_of_the_request():
    """During the optimisation a looser one, unless it is given."""
    of_area = problem_of(WALKER, SLOPES)._replace(grid=FEW, weights={"area": 1.0})
    settings = lambda tolerance, stage: (
        evaluation.area_settings(of_area._replace(tolerance=tolerance), FEW, stage).tolerance
    )
    assert settings(None, ENDS_STAGE) is None
    assert settings(None, 0) == evaluation.AREA_TOLERANCE
    assert settings(1e-9, ENDS_STAGE) == settings(1e-9, 0) == 1e-9


def test_areas_at_the_ends_are_those_of_a_climb_if_hurried():
    of_area = problem_of(WALKER, SLOPES)._replace(grid=FEW, weights={"area": 1.0}, levels=3)
    settings = lambda stage: evaluation.area_settings(of_area, FEW, stage)
    levels = [settings(one).levels for one in (ENDS_STAGE, HURRIED_ENDS_STAGE, 0, 2)]
    assert levels == [3, 2, 0, 2]
    assert settings(HURRIED_ENDS_STAGE).check == settings(0).check < settings(ENDS_STAGE).check


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
def test_where_nothing_walks_steps_lead_to_more_stable_gaits(monkeypatch, walking_below, steps):
    """By a tenth of the bounds along the parameter that matters most, and others in proportion."""
    bounds = {"slope": (0.001, 0.021), "hip_stiffness": (0.0, 2.0)}
    problem = problem_of(wj.SpringWalker(0.019, 0.4), bounds)._replace(weights={"area": 1.0})
    radius = Measure(1.5, np.array([2 / 0.02, -1 / 2]))
    monkeypatch.setattr(
        "walker_jax.design.climbs.differentiate_measures",
        lambda *_, **__: {"spectral-radius": radius},
    )
    monkeypatch.setattr(Trace, "gait", lambda *_: None)
    asked = []

    def evaluate_objective(problem, stage, values, *_, **__):
        asked.append(values)
        return made_up(problem, stage, values, 1.0, area=float(values[0] < walking_below))

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    begin = np.array([0.019, 0.4])
    trace = Trace(problem, None, None, False, 1)
    found = climbs.climb_to_walking(trace, 0, made_up(problem, 0, begin, 0.0))
    way = np.arange(1, 9)[:, None] * [-0.002, 0.1]
    np.testing.assert_allclose(asked, (begin + way)[:steps], rtol=1e-9)
    assert (found is not None) == (steps == 4)
    flat = {"spectral-radius": Measure(1.5, np.zeros(2))}
    monkeypatch.setattr("walker_jax.design.climbs.differentiate_measures", lambda *_, **__: flat)
    assert climbs.climb_to_walking(trace, 0, made_up(problem, 0, begin, 0.0)) is None


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

    evaluate_objective = lambda problem, stage, values, *_, **__: made_up(
        problem, stage, values, 0.125
    )
    monkeypatch.setattr("walker_jax.design.optimisation.climb", climb)
    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    found = optimise(WALKER, SLOPES, objective, starts=4)
    assert sorted(asked[:4]) == [(run, 0) for run in range(4)]  # side by side, in any order
    assert asked[4:] == [(best, stage) for stage in (1, 2, 3)]
    assert values(found, "note") == ["", "", "", "nothing there"]
    assert float(found.objective_start) == heights[best]
    assert float(found.objective_optimum) == heights[best] + 0.03 + 0.005
    assert float(found.exact_start) == float(found.exact_optimum) == 0.125 and found.converged


def test_a_hidden_gain_is_sought_where_the_gradient_promises_it():
    def row(place, value, gradient, error=0.1):
        numbers = (np.array([place]), value, error, np.array([gradient]), np.zeros(1))
        return Evaluation(0, 0, *numbers, np.zeros(1), 0)

    problem, none = problem_of(WALKER, SLOPES), np.nan
    here = row(0.010, 1.0, 100.0)  # promises 0.2 at a distance of 0.002
    assert climbs.may_be_better(problem, here, row(0.012, 1.5, none))
    assert climbs.may_be_better(problem, here, row(0.012, 0.9, none))
    assert not climbs.may_be_better(problem, here, row(0.012, 0.5, none))
    assert not climbs.may_be_better(problem, here, row(0.008, 1.1, none))  # downhill
    assert not climbs.may_be_better(problem, here, row(0.011, 1.0, none))  # promises too little
    steep = row(0.010, 1.0, 1000.0)
    assert not climbs.may_be_better(problem, steep, row(0.012, 1.1, none))  # half of 2 would show
    assert not climbs.may_be_better(problem, here, row(0.012, none, none))


@pytest.mark.parametrize(
    ("top", "reached", "tried"), [(0.012, 4, 4), (0.021, 8, 5), (0.0049, 0.5, 3)]
)
def test_a_step_is_doubled_as_long_as_it_improves(monkeypatch, top, reached, tried):
    """Values alone are measured on the way, and the gradient where it ends."""
    problem = problem_of(WALKER, {"slope": (0.0, 0.1)})._replace(weights={"area": 1.0})
    with_gradient, alone = [], []

    def at(values, gradient):
        height = float(1 - abs(values[0] - top))
        found = made_up(problem, 0, values, height, area=1.0)
        return found._replace(gradient=gradient, gradient_error=0 * gradient)

    def evaluate_objective(problem, stage, values, *_, value_only):
        (alone if value_only else with_gradient).append(values[0])
        return at(values, np.array([np.nan]) if value_only else np.sign(top - values))

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    trace = Trace(problem, None, None, False, 1)
    best = trace.measure(0, 0, problem.place_of(np.array([0.004])))
    higher = climbs.step_up(trace, 0, 0, best, np.array([0.02]))
    expected = 0.004 + 0.002 * reached
    assert higher is not None and higher.parameters == pytest.approx([expected], rel=1e-9)
    assert with_gradient == pytest.approx([0.004, expected], rel=1e-9)
    assert len(alone) > 2 and np.isclose(alone, expected, rtol=1e-9).any()
    # the trace holds each place once, with the gradient where there is one, and none that was
    # measured beside it in vain
    assert len(trace.rows) == 1 + tried <= 1 + len(alone)
    assert sum(row.has_gradient for row in trace.rows) == 2


def test_the_area_of_a_promising_step_is_measured_once(monkeypatch):
    """Its gradient follows from the same cells; those of later places take their room."""
    measured = []

    def measure(how, walker):
        measured.append(float(walker.slope))
        return measure_area(how, walker)

    measure_area = AreaSettings.measure
    monkeypatch.setattr(AreaSettings, "measure", measure)
    few = wj.Grid.sheared(theta=(0.1, 0.3, 20), sum=(-0.03, 0.01, 12))
    problem = problem_of(WALKER, SLOPES)._replace(weights={"area": 1.0}, grid=few)
    trace = Trace(problem, None, None, False, 1)
    place = problem.place_of(np.array([0.005]))
    alone = trace.measure(0, 0, place, value_only=True)
    assert measured == [0.005] and not alone.has_gradient
    whole = trace.measure(0, 0, place)
    assert measured.count(0.005) == 1 and whole.has_gradient
    assert whole.value == alone.value and len(trace.rows) == 1
    trace.measure(0, 1, place)  # by other levels
    assert measured.count(0.005) == 2
    for slope in np.linspace(0.006, 0.009, KEPT_AREAS):
        trace.measure(0, 0, problem.place_of(np.array([slope])), value_only=True)
    assert len(trace.areas) == KEPT_AREAS
    trace.measure(0, ENDS_STAGE, place)  # keeps no area, as no gradient can follow
    assert measured.count(0.005) == 3 and len(trace.areas) == KEPT_AREAS
    for slope in np.linspace(0.006, 0.009, KEPT_AREAS):
        trace.measure(0, 0, problem.place_of(np.array([slope])))
    assert not trace.areas


def test_a_measurement_is_kept_once_it_is_taken(monkeypatch):
    problem = problem_of(WALKER, SLOPES)
    begun, kept = [], []
    both = Barrier(2)

    def evaluate_objective(problem, stage, values, *_, **__):
        begun.append(values)
        if len(begun) <= 2:
            both.wait(60)
        return made_up(problem, stage, values, 1.0)

    monkeypatch.setattr("walker_jax.execution.threads.cores", lambda: 2)
    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate_objective)
    trace = Trace(problem, None, lambda data: kept.append(data.sizes["evaluation"]), False, 1)
    places = np.array([[0.2], [0.4]])
    with closing(trace.measure_each(0, 0, places)) as rows:
        next(rows)
    assert len(trace.measured) == 2 and kept == [1] and len(trace.rows) == 1
    trace.measure(0, 0, places[1])
    trace.measure(0, 0, places[1])
    assert len(begun) == 2 and kept == [1, 2]


@pytest.mark.slow
def test_out_of_time_ends_a_measurement_and_hurries_the_last(monkeypatch):
    """The time is over as the third measurement begins, which stops before its first kernel."""
    began, ended = [], []

    def evaluate(problem, stage, *given, **options):
        began.append(stage)
        row = evaluation.evaluate_objective(problem, stage, *given, **options)
        ended.append(stage)
        return row

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate)
    clock = lambda: 61.0 if len(began) > 2 else 0.0
    monkeypatch.setattr("walker_jax.design.budget.perf_counter", clock)
    walker = wj.SpringWalker(0.004, 1.0)
    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.1, 0.05, 40))
    options = {"grid": grid, "starts": 1, "levels": 2, "progress": False, "seconds": 60}
    found = optimise(walker, {"hip_stiffness": (0.0, 30.0)}, "area", **options)
    assert began[:3] == [0, 0, 0] and ended[:2] == [0, 0] and {*ended[2:]} == {-3}
    assert bool(found.out_of_time) and not bool(found.converged)
    assert {*found.stage.values.tolist()} == {0, -3} and found.fate_optimum.size <= 100**2
    best = walker.__class__(0.004, float(found.optimum[0]))
    area = wj.refine(best, grid, 1, check=50_000, progress=False).area.sum()
    error = float(found.exact_optimum_error)
    assert 0 < error < 0.1 * float(found.exact_optimum)
    assert abs(float(found.exact_optimum) - float(area)) < 4 * error
