"""The least disturbance is the nearest point that fails."""

from contextlib import contextmanager

import diffrax
import jax
import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.mapper import Mapper
from walker_jax.execution.tiles import map_cells
from walker_jax.fractals.dimensions import Uncertainty
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability import gait_robustness
from walker_jax.stability.dimension import boundary_dimension
from walker_jax.stability.disturbances import LeastDisturbance, least_disturbance
from walker_jax.stability.gait_mapper import mapper_of_gait
from walker_jax.stability.gait_robustness import join_rows
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.stability.sampling import (
    BasinStability,
    basin_stability,
    draw_from_ball,
    wilson_interval,
)
from walker_jax.stability.steps_down import LeastStepDown, labels_after_step, least_step_down
from walker_jax.systems.outcomes import OUTCOMES
from walker_jax.walking.stride import follow_stride

WALKER = wj.SimplestWalker(0.004)


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(WALKER)


@pytest.fixture(scope="module")
def least(gait):
    return least_disturbance(WALKER, gait, directions=360)


def test_a_push_that_changes_the_speed_alone(gait, least):
    found = least_disturbance(WALKER, gait, along=[0, 1])
    assert abs(found.direction[0]) < 1e-12 and abs(found.direction[1]) == pytest.approx(1)
    assert found.size > least.size
    state = np.asarray(gait.states[0])
    np.testing.assert_allclose(found.state, state + found.size * found.direction, atol=1e-15)
    # the walker walks on from just short of it, and fails as said from just beyond
    inside = wj.walk(WALKER, state + 0.9999 * found.size * found.direction, 300)
    assert inside.outcomes[-1] == Outcome.STRIDE
    beyond = state + (1 + 1e-8) * found.size * found.direction
    outside = np.asarray(wj.walk(WALKER, beyond, 300).outcomes)
    assert outside[-1] == found.failure != Outcome.STRIDE
    assert (outside == Outcome.STRIDE).sum() == pytest.approx(found.strides, abs=3)
    # in other units the same point
    scaled = least_disturbance(WALKER, gait, along=[0, 1], scale=np.abs(state))
    np.testing.assert_allclose(scaled.state, found.state, rtol=0, atol=1e-10)
    assert scaled.size == pytest.approx(found.size / abs(state[1]))


@pytest.mark.slow
def test_a_thin_finger_of_falls_is_met_at_another_slope():
    """Within 99.99 % of it every start is proved to walk for ever (docs/proofs.md, Theorem 2)."""
    found = least_disturbance(wj.SimplestWalker(slope=0.009))
    assert found.size == pytest.approx(0.00225558, abs=1e-8)


@pytest.mark.slow
def test_the_least_disturbance_by_another_solver(gait):
    expected = least_disturbance(WALKER, gait, along=[0, 1])
    found = least_disturbance(WALKER, gait, along=[0, 1], solver=diffrax.Dopri8())
    assert found.failure == expected.failure
    np.testing.assert_allclose(found.state, expected.state, rtol=0, atol=1e-9)


def test_the_boundary_is_normal_to_the_least_disturbance(gait, least):
    """By the derivatives of the margin of the failure, that the search for it ends with."""
    point = np.asarray(gait.states[0]) + (1 + 1e-8) * least.size * least.direction
    count = np.array([least.strides], np.int32)
    (normal,) = differentiate_margins(WALKER, point[None], count, np.eye(2), (), 1e-12)
    normal /= -np.linalg.norm(normal)  # margins fall where the walker comes to fail
    np.testing.assert_allclose(normal, least.direction, rtol=0, atol=1e-5)
    assert least.failure == Outcome.FORWARD and least.phase == 0


def test_walkers_come_to_their_gait_from_the_whole_of_its_box(gait):
    """Also from between the starts that the box was found by, and from twice as far off."""
    mapper = Mapper(WALKER, [Attractor(np.asarray(gait.states))], Integrator(1e-12), 300)
    (cycle,) = with_capture_boxes(mapper).attractors
    assert cycle.capture_boxes is not None
    rng = np.random.default_rng(5)
    u = rng.uniform(-2, 2, (5000, 2))
    starts = cycle.states[0] + u @ np.linalg.inv(cycle.capture_boxes[0]).T
    assert np.abs(starts - cycle.states[0]).max() > 1e-3
    assert mapper(starts).converged.all()
    x = starts
    for _ in range(60):
        x = wj.strides(WALKER, x).state
    np.testing.assert_allclose(x, np.broadcast_to(cycle.states, x.shape), rtol=0, atol=1e-9)


def test_disturbances_below_the_least_are_survived(gait, least):
    below = basin_stability(WALKER, 0.999 * least.size, gait, samples=4000)
    assert below.value == 1 and below.high == 1 and 0.999 < below.low < 1
    assert below.fates[Outcome.STRIDE] == 4000 and below.elsewhere == 0
    above = basin_stability(WALKER, 1.2 * least.size, gait, samples=4000)
    assert 0.9 < above.value < 1 and above.low < above.value < above.high
    assert above.fates[1:].sum() == round(4000 * (1 - float(above.value)))


def test_basin_stability_in_a_region_is_the_share_of_the_basin():
    region = wj.Grid.sheared(theta=(0.1, 0.3, 2), sum=(-0.02, 0.01, 3))
    found = basin_stability(WALKER, region, samples=40_000)
    exact = wj.refine(
        WALKER, wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.02, 0.01, 40)), 3, check=5000
    )
    share = float(exact.total_area) / (0.2 * 0.03)
    assert found.low < share < found.high and found.high - found.low < 0.01


def test_strides_to_come_back_are_those_that_are_counted(gait):
    """One by one, of the starts that the seed gives."""
    region = wj.Grid.sheared(theta=(0.1, 0.3, 2), sum=(-0.02, 0.01, 3))
    found = basin_stability(WALKER, region, gait, samples=2001, seed=5, within=1e-5)
    x = region.points_at(np.random.default_rng(5).uniform(size=(2001, 2)))
    fate, arrived = np.full(len(x), -1), np.full(len(x), np.inf)
    for k in range(80):
        close = np.abs(x - gait.states[0]).max(axis=1) < 1e-5
        arrived[close] = np.minimum(arrived[close], k)
        outcome, x = np.asarray((one := wj.strides(WALKER, x)).outcome), np.asarray(one.state)
        fate = np.where((fate <= 0) & (outcome != Outcome.OUTSIDE), outcome, fate)
    back = np.sort(arrived[np.isfinite(arrived)])
    assert 300 < len(back) < 1900 and found.value == len(back) / 2001
    assert found.median == back[-(-50 * len(back) // 100) - 1]
    assert found.slowest == back[-(-95 * len(back) // 100) - 1] > found.median
    np.testing.assert_array_equal(found.fates, np.bincount(fate, minlength=OUTCOMES))


def test_basin_stability_of_several_walkers(gait):
    slopes = np.array([0.004, 0.009, 0.018])
    found = basin_stability(jax.vmap(wj.SimplestWalker)(slopes), 0.01, samples=2000)
    assert found.value.shape == (3,) and found.fates.shape == (3, OUTCOMES)
    single = basin_stability(WALKER, 0.01, gait, samples=2000)
    assert found.value[0] == single.value and found.median[0] == single.median
    assert np.isnan(found.value[2]) and np.isnan(found.median[2])  # no stable gait
    other = basin_stability(WALKER, 0.01, gait, samples=2000, seed=1)
    assert other.value != single.value and abs(other.value - single.value) < 0.05


def test_strides_to_come_back_are_those_of_the_multipliers(gait):
    """Ten times closer to the gait takes log 10 / log(1 / |multiplier|) strides."""
    far, close = (
        basin_stability(WALKER, 1e-3, gait, samples=1000, within=within).median
        for within in (1e-5, 1e-9)
    )
    rate = np.log(1 / np.abs(gait.multipliers[0]))
    assert (close - far) == pytest.approx(4 * np.log(10) / rate, abs=2)
    never = basin_stability(WALKER, 1e-3, gait, samples=1000, within=1e-9, strides=25)
    assert np.isinf(never.slowest) and never.value == 1


@pytest.mark.slow
def test_a_gait_of_period_two_is_disturbed_where_it_is_weakest():
    walker = wj.SimplestWalker(0.0165)
    gait = wj.find_gait(walker, np.array([[0.2367, -0.2323], [0.2510, -0.2423]]), 2)
    assert gait.stable
    found = least_disturbance(walker, gait)
    states = np.asarray(gait.states)
    np.testing.assert_allclose(
        found.state, states[found.phase] + found.size * found.direction, rtol=0, atol=1e-15
    )
    rolled = gait._replace(states=np.roll(states, -found.phase, axis=0))
    assert basin_stability(walker, 0.999 * found.size, rolled, samples=4000).value == 1
    assert basin_stability(walker, 2 * found.size, rolled, samples=4000).value < 1


def test_points_of_a_ball_and_wilsons_interval():
    for rank in (1, 2, 3):
        x = draw_from_ball(np.random.default_rng(0), 20_000, rank)
        radius = np.linalg.norm(x, axis=1)
        assert radius.max() <= 1
        assert np.mean(radius < 0.5) == pytest.approx(0.5**rank, abs=0.01)
    # Newcombe (1998, Statistics in Medicine 17:857), Table I
    for successes, n, ends in ((81, 263, (0.2553, 0.3662)), (15, 148, (0.0624, 0.1605))):
        np.testing.assert_allclose(wilson_interval(successes, n, 0.95), ends, atol=5e-5)
    np.testing.assert_allclose(wilson_interval(0, 20, 0.95), (0, 0.1611), atol=5e-5)


def test_a_smooth_boundary_has_dimension_one_a_fractal_more(monkeypatch):
    shown = []

    @contextmanager
    def bar(label, progress, total):
        yield lambda done: shown.append((progress, done, total))

    monkeypatch.setattr("walker_jax.stability.dimension.bar", bar)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 60), sum=(-0.02, 0.01, 60))
    options = {"pairs": 4000, "distances": np.geomspace(1e-5, 3e-3, 6), "strides": 150}
    smooth = boundary_dimension(WALKER, grid, **options, progress=True)
    assert shown == [(True, i + 1, 7) for i in range(7)]  # the cells, and each distance
    assert smooth.low < 1.06 and smooth.value < 1.1
    fractal = boundary_dimension(wj.SimplestWalker(0.012), grid, **options)
    assert fractal.low > 1.3
    nowhere = boundary_dimension(WALKER, wj.Grid.sheared(theta=(0.01, 0.02, 4), sum=(0.1, 0.2, 4)))
    assert np.isnan(nowhere.value) and nowhere.distances.size == 0


def test_a_step_down_that_is_survived_and_one_that_is_not(gait):
    found = least_step_down(WALKER, gait)
    state = np.asarray(gait.states[0])
    for share, ends in ((0.999, Outcome.STRIDE), (1 + 1e-7, found.failure)):
        down = wj.stride(WALKER, state, step=-share * found.size)
        after = wj.stride(WALKER, down.state)
        assert after.outcome == Outcome.STRIDE
        assert wj.walk(WALKER, after.state, 200).outcomes[-1] == ends
    np.testing.assert_allclose(wj.stride(WALKER, state, step=-found.size).state, found.state)
    rough = mapper_of_gait(WALKER, None, 500, 1e-4).attractors[0].states  # the gait at a tolerance
    assert (rough == wj.find_gait(WALKER, tolerance=1e-4).states).all()
    assert 1e-12 < np.abs(rough - gait.states).max() < 1e-4
    mapper = mapper_of_gait(WALKER, gait, 500, None)
    heights = np.linspace(0, found.size, 5001)[:-1]
    starts = np.broadcast_to(state, (len(heights), 2))
    assert labels_after_step(mapper, starts, heights).converged.all()
    # how a walk from higher ones ends, and how many strides it has, as it is made one by one
    heights = np.array([1 + 1e-8, 1.0001, 1.1, 1.5, 200]) * found.size
    ends = labels_after_step(mapper, starts[: len(heights)], heights)
    for k, height in enumerate(heights):
        down = wj.stride(WALKER, state, step=-height)
        walk = [down, wj.stride(WALKER, down.state)]
        while len(walk) < 400 and walk[-1].outcome == Outcome.STRIDE:
            walk.append(wj.stride(WALKER, walk[-1].state))
        outcomes = [int(one.outcome) for one in walk]
        failed = next(outcome for outcome in outcomes if outcome != Outcome.STRIDE)
        assert ends.strides[k] == outcomes.index(failed) and ends.fate[k] == failed
        assert not ends.converged[k]
    assert found.strides == ends.strides[0] > 10 and {0, 1, 2} < set(ends.strides.tolist())


STEEP = wj.SimplestWalker(0.0125)
"""A gait of period three attracts there too, and its basin is nearer than any fall."""
BOXES: dict = {}


@pytest.fixture
def boxed(monkeypatch):
    """The capture boxes of each gait are found once."""

    def once(walker, gait, strides, tolerance, solver):
        key = float(walker.slope), strides
        if key not in BOXES:
            BOXES[key] = mapper_of_gait(walker, gait, strides, tolerance)
        return BOXES[key]

    monkeypatch.setattr("walker_jax.stability.disturbances.mapper_of_gait", once)


@pytest.fixture(scope="module")
def steep():
    return wj.find_gait(STEEP)


def ends_of(x, gait):
    """Which walkers come back, and which fall, stride by stride."""
    for _ in range(150):
        x = wj.strides(STEEP, x).state
    fallen = np.isnan(x).any(axis=1)
    return ~fallen & (np.abs(x - np.asarray(gait.states[0])).max(axis=1) < 1e-4), fallen


def test_the_nearest_fall_is_beyond_a_nearer_motion(steep, boxed, monkeypatch):
    """Along one direction, against walks from points 2e-6 apart."""
    options = {"along": [[0.68, 0.73]], "strides": 150}
    first, fall = (least_disturbance(STEEP, steep, **options, fall=f) for f in (False, True))
    assert first.failure == Outcome.STRIDE and fall.failure == Outcome.FORWARD
    assert first.strides == 150 and fall.strides < 100
    np.testing.assert_allclose(fall.state, steep.states[0] + fall.size * fall.direction, rtol=1e-12)
    distances = np.arange(2e-6, 1.01 * fall.size, 2e-6)
    starts = np.asarray(steep.states[0]) + np.concatenate(
        [sign * distances[:, None] * fall.direction for sign in (-1, 1)]
    )
    back, fallen = (one.reshape(2, -1) for one in ends_of(starts, steep))
    lost, falls = (distances[one.any(axis=0).argmax()] for one in (~back, fallen))
    assert first.size == pytest.approx(lost, abs=2.1e-6)
    assert fall.size == pytest.approx(falls, abs=2.1e-6) and falls > 1.2 * lost
    # and the same where no walk may end at the other gait
    monkeypatch.setattr(
        "walker_jax.stability.disturbances.with_other_gaits", lambda mapper, starts: mapper
    )
    slow = least_disturbance(STEEP, steep, **options, fall=True)
    assert fall.size == slow.size and fall[3:] == slow[3:]


@pytest.mark.slow
def test_the_least_step_down_that_ends_in_a_fall_is_higher(steep, boxed):
    """Against steps down of heights that are 0.1 % apart."""
    first, fall = (least_step_down(STEEP, steep, strides=150, fall=f) for f in (False, True))
    assert first.failure == Outcome.STRIDE and fall.failure == Outcome.FORWARD
    heights = np.arange(0.001, 1.01, 0.001) * fall.size
    state = np.broadcast_to(steep.states[0], (len(heights), 2))
    down = map_cells(
        follow_stride,
        (STEEP, state, Integrator(np.float64(1e-12)), -heights),
        (False, True, False, True),
    )
    back, fallen = ends_of(wj.strides(STEEP, down.state).state, steep)
    assert first.size == pytest.approx(heights[(~back).argmax()], abs=1.1e-3 * fall.size)
    assert fall.size == pytest.approx(heights[fallen.argmax()], abs=1.1e-3 * fall.size)
    assert first.size < 0.7 * fall.size


def test_the_two_are_one_where_the_nearest_lost_start_falls(gait, boxed):
    options = {"along": [0, 1], "strides": 150}
    first, fall = (least_disturbance(WALKER, gait, **options, fall=f) for f in (False, True))
    assert first.failure == Outcome.FORWARD and first.size == fall.size
    assert first[3:] == fall[3:]
    first, fall = (least_step_down(WALKER, gait, strides=150, fall=f) for f in (False, True))
    assert first.size == fall.size and first[2:] == fall[2:]


@pytest.mark.parametrize("failure", [Outcome.STRIDE, Outcome.BACKWARD])
def test_a_fall_is_searched_for_only_where_the_nearest_is_none(monkeypatch, gait, failure):
    asked = []

    def disturbed(walker, gait, *, fall=False, **options):
        asked.append(("disturbance", fall))
        size, how = (0.02, Outcome.FORWARD) if fall else (0.01, failure)
        return LeastDisturbance(size, np.array([0.0, 1.0]), np.array([0.1, -size]), 0, how, 7)

    def stepped(walker, gait, *, fall=False, **options):
        asked.append(("step", fall))
        size, how = (0.2, Outcome.FORWARD) if fall else (0.1, failure)
        return LeastStepDown(size, np.zeros(4), 0, how, 7)

    survived = BasinStability(*map(np.asarray, (0.5, 0.4, 0.6, np.zeros(8, int), 0, 5.0, 9.0)))
    dimension = Uncertainty(1.0, 1.0, 1.0, 1.0, np.zeros(0), np.zeros(0))
    monkeypatch.setattr("walker_jax.stability.gait_robustness.least_disturbance_if_any", disturbed)
    monkeypatch.setattr("walker_jax.stability.gait_robustness.least_step_down", stepped)
    monkeypatch.setattr(
        "walker_jax.stability.gait_robustness.basin_stability", lambda *_, **__: survived
    )
    monkeypatch.setattr(
        "walker_jax.stability.gait_robustness.boundary_dimension", lambda *_, **__: dimension
    )
    grid = wj.Grid.sheared(theta=(0.05, 0.4, 20), sum=(-0.04, 0.01, 20))
    found = gait_robustness.robustness(WALKER, grid, levels=0, check=0, strides=100)
    twice = failure == Outcome.STRIDE
    for name in ("disturbance", "step"):  # these two are measured side by side
        assert [fall for one, fall in asked if one == name] == [False, True][: 1 + twice]
    assert float(found.least_disturbance) == 0.01 and float(found.step_down) == 0.1
    assert int(found.failure) == int(found.step_down_failure) == failure
    assert float(found.least_fall) == (0.02 if twice else 0.01)
    assert float(found.step_down_fall) == (0.2 if twice else 0.1)
    assert int(found.fall_failure) == (Outcome.FORWARD if twice else failure)
    assert found.fall_state.values.tolist() == [0.1, -0.02 if twice else -0.01]


def test_the_numbers_are_the_largest_basins_at_its_weakest(monkeypatch):
    """Of a motion that does not repeat itself there are none. All of this is made up."""
    cycle = np.array([[0.1, -0.1], [0.2, -0.25], [0.3, -0.35]])
    states = np.full((3, 3, 2), np.nan)
    states[0, 0], states[1], states[2, 0] = [0.15, -0.15], cycle, [0.16, -0.14]
    basins = xr.Dataset(
        {
            "cells": ("number", [7, 40, 90]),
            "period": ("number", [1, 3, 0]),
            "states": (("number", "phase", "coordinate"), states),
        }
    )
    multipliers, times = np.array([0.3 + 0.4j, 0.3 - 0.4j]), np.array([3.0, 4.0, 6.5])
    yes, asked = np.array(True), {}
    gait = Gait(cycle, multipliers, times, yes, np.array(0.0), yes)

    def found_gait(walker, guess=cycle, period=3, **_):
        np.testing.assert_array_equal(guess, cycle)
        assert period == 3
        return gait

    def survived(walker, disturbances, gait, *, scale, **_):
        asked.update(states=gait.states, scale=scale, disturbances=disturbances)
        return BasinStability(*map(np.asarray, (0.5, 0.4, 0.7, np.zeros(8, int), 0, 5.0, 9.0)))

    failing = {"failure": Outcome.FORWARD, "strides": 7, "phase": 1}
    at = {"size": 0.01, "direction": np.array([0.6, 0.8]), "state": np.array([0.21, -0.24])}
    answers = {
        "refine": basins,
        "least_disturbance_if_any": LeastDisturbance(**at, **failing),
        "least_step_down": LeastStepDown(size=0.05, state=np.zeros(4), **failing),
        "boundary_dimension": Uncertainty(1.25, 1.0, 1.5, 0.75, np.zeros(0), np.zeros(0)),
    }
    for name, answer in answers.items():
        monkeypatch.setattr(
            f"walker_jax.stability.gait_robustness.{name}", lambda *_, answer=answer, **__: answer
        )
    for module in ("stability.gait_robustness", "basins.attracting_gaits"):
        monkeypatch.setattr(f"walker_jax.{module}.search_gait", found_gait)
    monkeypatch.setattr("walker_jax.stability.gait_robustness.basin_stability", survived)
    grid = wj.Grid.sheared(theta=(0.05, 0.4, 20), sum=(-0.04, 0.01, 20))
    found = gait_robustness.robustness(WALKER, grid, disturbances=0.25)
    np.testing.assert_array_equal(asked["states"], cycle[[1, 2, 0]])
    assert asked["scale"].tolist() == [0.2, 0.25] and asked["disturbances"] == 0.25
    expected = {
        **{"gait_period": 3, "gait_state": [0.2, -0.25], "multiplier": 0.5, "step_time": 4.5},
        **{"least_disturbance": 0.01, "direction": [0.6, 0.8], "failing_state": [0.21, -0.24]},
        **{"failure": 1, "failing_strides": 7, "step_down": 0.05},
        **{"stability": 0.5, "stability_low": 0.4, "stability_high": 0.7},
        **{"median_strides": 5, "slowest_strides": 9},
        **{"dimension": 1.25, "dimension_low": 1.0, "dimension_high": 1.5},
    }
    for name, value in expected.items():
        assert found[name].values.tolist() == pytest.approx(value), name
    assert found.attrs["disturbances"] == 0.25


def test_of_the_states_of_a_gait_the_weakest_counts(gait, monkeypatch):
    """The searches from each are made up, and so is the second state."""
    mapper = mapper_of_gait(WALKER, gait, 500, None)
    (own,) = mapper.attractors
    assert own.capture_boxes is not None
    states = np.array([own.states[0], [0.16, -0.165]])
    boxes = np.tile(own.capture_boxes, (2, 1, 1))
    mapper = mapper._replace(attractors=[Attractor(states, boxes)])
    for module in ("disturbances", "steps_down"):
        monkeypatch.setattr(f"walker_jax.stability.{module}.mapper_of_gait", lambda *_: mapper)
    steps = iter([[0.03, 0.0], [0.0, -0.02]])
    monkeypatch.setattr(
        "walker_jax.stability.disturbances.nearest_failure", lambda *_: np.array(next(steps))
    )
    found = least_disturbance(WALKER, gait, scale=[1.0, 0.5])
    assert (found.size, found.phase, found.direction.tolist()) == (0.02, 1, [0.0, -1.0])
    np.testing.assert_allclose(found.state, [0.16, -0.175], rtol=1e-12)
    heights = iter([0.03, 0.02])
    bisect = lambda *_: np.array([next(heights)])
    monkeypatch.setattr("walker_jax.stability.steps_down.bisect", bisect)
    down = least_step_down(WALKER, gait)
    assert (down.size, down.phase) == (0.02, 1)
    np.testing.assert_allclose(down.state, wj.stride(WALKER, states[1], step=-0.02).state)


@pytest.mark.slow
def test_the_nearest_fall_beyond_another_basin_is_a_polar_grids(steep):
    first, fall = (least_disturbance(STEEP, steep, fall=f) for f in (False, True))
    assert first.failure == Outcome.STRIDE and fall.failure == Outcome.FORWARD
    assert first.size == pytest.approx(0.001333, abs=1e-6)
    mapper = mapper_of_gait(STEEP, steep, 500, None)
    angles = 2 * np.pi * np.arange(5000) / 5000
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nearest = np.inf
    for radius in np.linspace(0.97, 1.005, 36) * fall.size:
        labels = mapper(np.asarray(steep.states[0]) + radius * rays)
        if (labels.fate != Outcome.STRIDE).any():
            nearest = radius
            break
    assert nearest == pytest.approx(fall.size, rel=2e-3)


def test_rows_of_a_table_may_lack_what_others_have():
    full = xr.Dataset(
        {"total_area": 0.5, "checked": 7, "direction": ("coordinate", np.array([0.6, 0.8]))},
        {"phidot": -0.05},
        {"area": [0.5], "walker_slope": 0.1, "walker_mass": 2.0, "seed": 0},
    )
    lacking = xr.Dataset({"total_area": np.nan, "direction": ("coordinate", np.full(2, np.nan))})
    other = full.assign_coords(phidot=-0.06)
    table = join_rows([full, lacking, other], np.array([0.1, 0.2, 0.3]), "slope")
    assert table.phidot.values.tolist()[::2] == [-0.05, -0.06] and np.isnan(table.phidot[1])
    assert np.isnan(table.checked[1]) and table.checked[2] == 7
    assert table.direction.dims == ("slope", "coordinate") and table.direction[2, 1] == 0.8
    attributes = lambda *rows: join_rows([*rows], 0.1 * np.arange(len(rows)), "slope").attrs
    assert attributes(lacking, full) == attributes(full) == {"walker_mass": 2.0, "seed": 0}
    other.attrs |= {"section": ["theta"], "seed": 1}
    same = other.assign_attrs(section=["theta"], seed=2)
    assert attributes(other, lacking, same) == {"walker_mass": 2.0, "section": ["theta"]}


@pytest.mark.slow
def test_a_table_over_slopes():
    grid = wj.Grid.sheared(theta=(0.05, 0.4, 50), sum=(-0.04, 0.01, 50))
    table = wj.robustness(WALKER, grid, values=[0.004, 0.0195], levels=1)
    assert dict(table.sizes) == {"slope": 2, "coordinate": 2}
    assert float(table.least_disturbance[0]) == pytest.approx(0.00225617, abs=1e-7)
    assert float(table.step_down[0]) == pytest.approx(0.00133962, abs=1e-7)
    assert int(table.gait_period[1]) == 0 and np.isnan(table.least_disturbance[1])
    assert float(table.total_area[1]) == 0 and "walker_slope" not in table.attrs
    other = wj.robustness(
        wj.SpringWalker(0.004), grid, values=[0.0, 0.1], parameter="hip_stiffness", levels=0
    )
    assert float(other.least_disturbance[0]) == pytest.approx(0.00225617, abs=1e-7)
    assert table.attrs["walker"] == "SimplestWalker"


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.004, 0.009, 0.012])
def test_no_point_of_a_fine_polar_grid_is_nearer(slope):
    walker = wj.SimplestWalker(slope)
    gait = wj.find_gait(walker)
    found = least_disturbance(walker, gait)
    mapper = mapper_of_gait(walker, gait, 500, None)
    angles = 2 * np.pi * np.arange(20_000) / 20_000
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nearest = np.inf
    for radius in np.linspace(0.8, 1.002, 203) * found.size:
        if not mapper(np.asarray(gait.states[0]) + radius * rays).converged.all():
            nearest = radius
            break
    assert nearest == pytest.approx(found.size, rel=1e-3)


@pytest.mark.slow
def test_a_gait_on_a_section_of_three_dimensions():
    walker = wj.RoundFootWalker(0.01)
    gait = wj.find_gait(walker)
    found = least_disturbance(walker, gait, along=[[1, 0, 0], [0, 1, 0]])
    assert abs(found.direction[2]) < 1e-12 and found.failure != Outcome.STRIDE
    assert basin_stability(walker, 0.99 * found.size, gait, along=np.eye(3)[:2]).value == 1
    assert basin_stability(walker, 3 * found.size, gait, along=np.eye(3)[:2]).value < 1
    down = least_step_down(walker, gait)
    assert 0 < down.size < 0.1


def test_wrong_arguments_are_refused():
    walker = wj.SimplestWalker(0.004)
    gait = wj.find_gait(walker)
    for scale in ([1.0], [1.0, 0.0], [1.0, np.nan]):
        with pytest.raises(ValueError, match="scale must be 2 positive numbers"):
            least_disturbance(walker, gait, scale=scale)
    for along in ([1.0], [[1.0, 0.0], [2.0, 0.0]], [np.nan, 1.0], [0.0, 0.0]):
        with pytest.raises(ValueError, match="along must be independent vectors"):
            least_disturbance(walker, gait, along=along)
    with pytest.raises(ValueError, match="strides must be at least 1"):
        least_disturbance(walker, gait, strides=0)
    unstable = wj.find_gait(wj.SimplestWalker(0.018))
    with pytest.raises(ValueError, match="gait must be stable, not with a multiplier of size"):
        least_disturbance(wj.SimplestWalker(0.018), unstable)
    other = wj.find_gait(wj.SimplestWalker(0.005))
    for search in (least_disturbance, least_step_down):
        with pytest.raises(ValueError, match="gait must be one of this walker, whose strides miss"):
            search(walker, other)
    with pytest.raises(ValueError, match="gait must be one of this walker, on theta, thetadot, ph"):
        least_disturbance(wj.RoundFootWalker(0.01), gait)
    with pytest.raises(
        ValueError, match=r"disturbances must be a positive number, a grid, or a function .*, not -"
    ):
        basin_stability(walker, -1.0, gait)
    for scale in ("ab", [[1.0], [1.0, 2.0]]):
        with pytest.raises(ValueError, match="scale must be 2 positive numbers"):
            least_disturbance(walker, gait, scale=scale)
    grid = wj.Grid.sheared(theta=(0, 0.4, 4), sum=(-0.04, 0.01, 4))
    with pytest.raises(ValueError, match="strides must be at least 1, not 0"):
        boundary_dimension(walker, grid, strides=0)
    with pytest.raises(ValueError, match=r"distances=\[0\.  0\.1 0\.2\]: must be positive"):
        boundary_dimension(walker, grid, distances=[0.0, 0.1, 0.2])
    with pytest.raises(ValueError, match="scale and along must be left out"):
        basin_stability(walker, wj.Grid.plain(theta=(0, 1, 2), thetadot=(-1, 0, 2)), along=[0, 1])
    with pytest.raises(ValueError, match="samples must be at least 1"):
        basin_stability(walker, 0.1, gait, samples=0)
    with pytest.raises(ValueError, match="within must be positive"):
        basin_stability(walker, 0.1, gait, within=np.nan)
    with pytest.raises(ValueError, match="confidence must be between 0 and 1"):
        basin_stability(walker, 0.1, gait, confidence=1.0)
    with pytest.raises(ValueError, match="gait must be left out"):
        basin_stability(jax.vmap(wj.SimplestWalker)(np.array([0.004, 0.005])), 0.1, gait)
    for values in ([], np.array(0.004)):
        with pytest.raises(ValueError, match="values must be one row"):
            wj.robustness(walker, values=values)
    with pytest.raises(ValueError, match="parameter must be one of"):
        wj.robustness(walker, values=np.array([0.1]), parameter="mass")
