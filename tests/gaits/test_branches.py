import jax.numpy as jnp
import numpy as np
import pytest
from maps import done_with
from reference import read_values
from simplest_gaits import REGION, assert_repeats, walker

import walker_jax as wj
from walker_jax.gaits import arclength, branches, continuation, events
from walker_jax.gaits.cycles import Linearisation
from walker_jax.gaits.search import search_gait

VALUES = read_values("values")
FEIGENBAUM = 4.669201609


@pytest.fixture(scope="module")
def long():
    """The long period-one gait over the slope."""
    return wj.continue_gait(walker(), "slope", (0.001, 0.03))


@pytest.fixture(scope="module")
def cascade(long):
    """The branches that stem from it, one doubling after the other."""
    found = [long]
    while found[-1].period < 16:
        start = continuation.start_at_doubling(found[-1].doublings[0])
        found += branches.continue_gaits(walker(), "slope", (0.001, 0.0185), [start])
    return found


@pytest.fixture(scope="module")
def born_in_folds():
    """The gaits of period three and four that no doubling leads to."""
    starts = []
    for period, slope in ((3, 0.013), (4, 0.0105)):
        gait = wj.find_gaits(walker(slope), period, REGION)[0]
        starts.append(continuation.Start(slope, np.asarray(gait.states)))
    return branches.continue_gaits(walker(), "slope", (0.009, 0.02), starts)


def assert_walks(branch, every=1):
    """Every gait of a branch repeats itself when it is walked."""
    for value, states in list(zip(branch.values, branch.states, strict=True))[::every]:
        assert_repeats(value, states)


def test_a_branch_is_made_of_gaits(long):
    assert long.period == 1 and long.ends == ("the end of the range", "the end of the range")
    assert (np.diff(long.values) > 0).all() and long.folds == []
    np.testing.assert_allclose(long.values[[0, -1]], [0.001, 0.03], rtol=0, atol=1e-15)
    assert_walks(long)
    for i in (0, len(long.values) // 2, -1):
        gait = wj.find_gait(walker(long.values[i]))
        np.testing.assert_allclose(long.states[i], gait.states, rtol=0, atol=1e-12)
        np.testing.assert_allclose(long.multipliers[i], gait.multipliers, rtol=0, atol=1e-10)
        np.testing.assert_allclose(long.step_times[i], gait.step_times, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(long.stable, long.values < long.doublings[0].value)


def test_the_cascade_of_doublings(cascade):
    """The three of the reference, two more, and how their distances shrink."""
    doublings = [branch.doublings[0] for branch in cascade]
    slopes = np.array([one.value for one in doublings])
    known = [one["slope"] for one in VALUES["period_doublings"]]
    np.testing.assert_allclose(slopes[:3], known, rtol=0, atol=1e-12)
    assert doublings[0].states[0, 0] == pytest.approx(
        VALUES["period_doublings"][0]["theta"], abs=1e-12
    )
    distances = np.diff(slopes)
    ratios = distances[:-1] / distances[1:]
    np.testing.assert_allclose(ratios, FEIGENBAUM, rtol=0.15)
    assert abs(ratios[-1] - FEIGENBAUM) < 0.02
    for one, branch in zip(doublings, cascade, strict=True):
        assert one.kind == "doubling" and one.states.shape == (branch.period, 2)
        assert one.residual < 1e-12
        assert np.abs(one.multipliers + 1).min() < 1e-9
        walked = wj.walk(walker(one.value), one.states[0], branch.period).states
        np.testing.assert_allclose(walked[-1], one.states[0], rtol=0, atol=1e-10)


def test_doubled_gaits_are_stable_until_they_double(cascade):
    for branch in cascade[1:]:
        assert branch.ends[0] == "a period doubling"
        assert_walks(branch, every=3)
        inside = (branch.values > branch.values[0] + 1e-7) & (
            branch.values < branch.doublings[0].value - 1e-7
        )
        assert inside.sum() > 2 and branch.stable[inside].all()
        assert not branch.stable[branch.values > branch.doublings[0].value + 1e-7].any()


def test_a_doubled_branch_followed_back_ends_at_its_doubling(long):
    (gait,) = wj.find_gaits(walker(0.016), 2, REGION)
    branch = wj.continue_gait(walker(0.016), "slope", (0.001, 0.017), gait)
    assert branch.ends == ("the gait of period 1 that it doubles", "the end of the range")
    assert branch.folds == []
    assert branch.values[0] == pytest.approx(long.doublings[0].value, abs=1e-5)


@pytest.mark.slow
def test_gaits_of_period_three_and_four_are_born_in_folds(born_in_folds):
    for branch, slope in zip(born_in_folds, (0.0122808216261, 0.0100897842119), strict=True):
        (fold,) = branch.folds
        assert fold.kind == "fold" and fold.value == pytest.approx(slope, abs=1e-12)
        assert fold.residual < 1e-12 and np.abs(fold.multipliers - 1).min() < 1e-7
        assert branch.values.min() >= fold.value
        assert branch.ends == ("the end of the range", "the end of the range")
        assert_walks(branch, every=5)
        below = wj.find_gaits(walker(slope - 1e-6), branch.period, REGION)
        above = wj.find_gaits(walker(slope + 1e-6), branch.period, REGION)
        assert len(below) == 0 and len(above) == 2
        assert [bool(gait.stable) for gait in above].count(True) == 1


@pytest.mark.slow
def test_a_gait_born_in_a_fold_attracts_walkers(born_in_folds):
    """Walked from beside it, well between its fold and its doubling."""
    for branch in born_in_folds:
        slope = (branch.folds[0].value + branch.doublings[0].value) / 2
        gait = next(g for g in wj.find_gaits(walker(slope), branch.period, REGION) if g.stable)
        beside = gait.states[0] + np.array([1e-5, 0])
        states = np.asarray(wj.walk(walker(slope), beside, 100 * branch.period).states)
        np.testing.assert_allclose(states[:: branch.period][-1], gait.states[0], atol=1e-10)


def test_a_branch_may_start_at_an_end_of_the_interval():
    for interval in ((0.009, 0.02), (0.001, 0.009)):
        branch = wj.continue_gait(walker(), "slope", interval)
        assert branch.ends == ("the end of the range", "the end of the range")
        np.testing.assert_allclose(branch.values[[0, -1]], interval, rtol=0, atol=1e-15)


def test_no_gait_no_branch():
    (branch,) = branches.continue_gaits(
        walker(), "slope", (0.001, 0.02), [continuation.Start(0.01, np.array([[0.2, -0.5]]))]
    )
    assert len(branch.values) == 0 and branch.ends == ("no gait", "no gait")
    assert branch.folds == branch.doublings == []


# Of maps with branches known in closed form


RADIUS = 0.3


def island(x, p):
    """A map whose gaits are a circle over the parameter."""
    return x + 0.5 * (RADIUS**2 - x**2 - p**2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_branch_that_closes_is_gone_round_once(sign):
    start = continuation.Start(0.0, np.array([[RADIUS]]))
    path = done_with(island, continuation.follow_branch(start, sign, (-1.0, 1.0)))
    assert path.end == "the branch closes"
    values = np.array([point.value for point in path.points])
    states = np.array([point.cycle[0, 0] for point in path.points])
    np.testing.assert_allclose(values**2 + states**2, RADIUS**2, rtol=0, atol=1e-10)
    angles = np.unwrap(np.arctan2(states, values))
    assert (sign * np.diff(angles) < 0).all()
    assert abs(angles[-1] - angles[0]) == pytest.approx(2 * np.pi, abs=0.3)
    assert [event.kind for event in path.events] == ["fold", "fold"]
    for fold, value in zip(path.events, (sign * RADIUS, -sign * RADIUS), strict=True):
        assert fold.value == pytest.approx(value, abs=1e-12)
        assert abs(fold.states[0, 0]) < 1e-6 and abs(fold.multipliers[0] - 1) < 1e-6


@pytest.mark.parametrize("of_tangent", [1.0, -1.0])
@pytest.mark.parametrize("lean", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_branch_is_followed_the_way_that_is_wanted(sign, lean, of_tangent, monkeypatch):
    """Whether its states grow with the parameter, or fall, and whatever the sign of a tangent."""
    tangent = arclength.tangent
    monkeypatch.setattr(
        "walker_jax.gaits.continuation.tangent", lambda *given: of_tangent * tangent(*given)
    )
    line = lambda x, p: x + 0.5 * (lean * p - x)
    path = done_with(
        line,
        continuation.follow_branch(continuation.Start(0.0, np.zeros((1, 1))), sign, (-1.0, 2.0)),
    )
    values = np.array([point.value for point in path.points])
    assert path.end == "the end of the range" and (sign * np.diff(values) > 0).all()
    assert values[0] == 0 and values[-1] == (2.0 if sign > 0 else -1.0)
    states = [point.cycle[0, 0] for point in path.points]
    np.testing.assert_allclose(states, lean * values, rtol=0, atol=1e-13)


def test_crossings_are_where_a_line_of_points_has_the_value():
    """Once on the way up, and once on the way down."""
    values, x = np.array([0.0, 1.0, 0.5]), np.array([[[2.0, 0.0]], [[4.0, 1.0]], [[0.0, 3.0]]])
    one = np.ones((3, 1))
    branch = branches.Branch("p", values, x, one, one, [], [], ("", ""))
    at = lambda value: np.reshape(branches.interpolate_cycles(branch, value), (-1, 2)).tolist()
    assert at(0.25) == [[2.5, 0.25]]
    assert at(0.75) == [[3.5, 0.75], [2.0, 2.0]]
    assert at(-0.1) == at(1.1) == []
    assert [4.0, 1.0] in at(1.0) and [0.0, 3.0] in at(0.5) and at(0.0) == [[2.0, 0.0]]


def test_a_branch_that_passes_by_its_start_does_not_close():
    none = Linearisation(*5 * [np.zeros(0)])
    point = lambda value, x: arclength.Point(value, np.array([[x]]), none)
    one, other = point(0.0, 0.1), point(0.04, 0.1)
    step = lambda end: arclength.scaled_step(one, end, 1.0)
    passes = lambda value, x: continuation.passes_start(step(other), step(point(value, x)))
    assert all(passes(value, x) for value in (1e-6, 0.02, 0.0399) for x in (0.1, 0.1 + 1e-4))
    assert not any(passes(value, 0.1) for value in (-1e-3, 0.041))
    assert not any(passes(0.02, x) for x in (0.09, 0.11, -0.5))


def test_a_bifurcation_found_beyond_a_step_is_none_of_the_step():
    """The multiplier of x = 0 is -1 - 0.3 sin(p): doublings at all multiples of pi."""
    width = 3.0
    waves = lambda x, p: -x * (1 + 0.3 * jnp.sin(p))

    def look(first, last):
        ends = [arclength.correct_point(p, np.zeros((1, 1)), None, width) for p in (first, last)]
        one, other = (done_with(waves, task) for task in ends)
        along = np.array([0.0, 1.0])
        return done_with(waves, events.find_bifurcations(one, other, along, along, width))

    (doubling,) = look(2.9, 3.6)
    assert doubling.kind == "doubling" and doubling.value == pytest.approx(np.pi, abs=1e-12)
    assert doubling.multipliers[0] == pytest.approx(-1, abs=1e-12)
    assert look(2.0, 3.0) == []
    # from 4.5 Newton's iteration goes to the one at 0: the step is too long to tell
    assert look(1.6, 4.5) is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: wj.continue_gait(walker(), "mass", (0.1, 0.2)), "parameter .*slope.*'mass'"),
        (lambda: wj.continue_gait(walker(), "slope", (0.2, 0.1)), "interval .*0.2, 0.1"),
        (lambda: wj.continue_gait(walker(), "slope", (0.1, 0.2)), "interval .*0.009"),
        (lambda: wj.continue_gait(walker(), "slope", (-0.1, 0.2)), "slope .*-0.1"),
        (lambda: wj.continue_gait(walker(), "slope", (0.001, np.inf)), "interval .*inf"),
        (
            lambda: wj.continue_gait(
                walker(), "slope", (0.001, 1.0), search_gait(walker(), np.array([3.0, 3.0]))
            ),
            "gait must be one",
        ),
    ],
)
def test_wrong_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
