import jax.numpy as jnp
import numpy as np
import pytest
from maps import done_with
from reference import read_values
from simplest_gaits import REGION, walker

import walker_jax as wj
from walker_jax.gaits import branch_search, crises, long_runs
from walker_jax.gaits.arclength import correct_point
from walker_jax.gaits.branches import Branch
from walker_jax.gaits.continuation import Start
from walker_jax.walking.iteration import WalkEnd

VALUES = read_values("values")
DOUBLINGS = np.array([one["slope"] for one in VALUES["period_doublings"]])


def test_what_walkers_come_to():
    slopes = np.array([0.01, 0.016, 0.0178, 0.0186, 0.0195])
    gaits = np.array([wj.find_gait(walker(slope)).states[0] for slope in slopes])
    starts = np.stack([gaits + np.array([1e-3, 0]), np.full_like(gaits, [0.2, -0.3])], axis=1)
    data = wj.attractors(walker(), "slope", slopes, starts, strides=1000)
    assert data.fate.values[:, 0].tolist() == [0, 0, 0, 0, wj.Outcome.FORWARD]
    assert (data.fate.values[:, 1] == wj.Outcome.FORWARD).all()
    assert data.period.values[:, 0].tolist() == [1, 2, 4, 0, 0]
    assert data.strides.values[:4, 0].tolist() == [1000 + long_runs.RECORDED_STATES] * 4
    assert np.isnan(data.orbit.values[:, 1]).all()
    np.testing.assert_allclose(
        data.orbit.values[0, 0, -1], wj.find_gait(walker(0.01)).states[0], atol=1e-9
    )
    chaos = data.orbit.values[3, 0]
    np.testing.assert_allclose(chaos[1:], wj.strides(walker(0.0186), chaos[:-1]).state, atol=1e-12)


@pytest.mark.slow
def test_what_attracts_beside_the_long_gait_is_seen():
    """Between fold and doubling of the gait of period four, at 0.010090 and 0.010132."""
    gait = next(gait for gait in wj.find_gaits(walker(0.01012), 4, REGION) if gait.stable)
    branch = wj.continue_gait(walker(0.01012), "slope", (0.01, 0.0102), gait)
    long = wj.continue_gait(walker(0.01012), "slope", (0.01, 0.0102))
    values = np.array([0.01008, 0.0101, 0.01012])
    starts = long_runs.starts_near_gaits(walker(), "slope", [long, branch], values, 1e-12)
    data = wj.attractors(walker(), "slope", values, starts, strides=600)
    found = [
        set(row[fate == 0].tolist())
        for row, fate in zip(data.period.values, data.fate.values, strict=True)
    ]
    assert found == [{1}, {1, 4}, {1, 4}]


@pytest.mark.slow
def test_a_cascade_that_began_below_the_interval_is_known():
    data = wj.bifurcation_diagram(
        walker(), "slope", (0.0165, 0.0182), period_max=4, strides=100, scan=2
    )
    chosen = data.cascade.values
    np.testing.assert_allclose(data.event_value.values[chosen], DOUBLINGS[1:], rtol=0, atol=1e-12)
    assert set(data.period.values[data.on_cascade.values].tolist()) == {1, 2, 4}


@pytest.mark.slow
def test_walking_is_lost_between_two_slopes():
    long = wj.continue_gait(walker(), "slope", (0.001, 0.03))
    lost = wj.loss_of_walking(walker(), "slope", (0.0185, 0.0195), [long], strides=2000)
    assert 0.01903 < lost.below < lost.above < 0.01907
    assert lost.above - lost.below <= 1e-5 and lost.strides == 2000
    everywhere = wj.loss_of_walking(walker(), "slope", (0.005, 0.006), [long], strides=200)
    assert everywhere.below == 0.006 and np.isnan(everywhere.above)
    nowhere = wj.loss_of_walking(walker(), "slope", (0.0200, 0.0201), [long], strides=2000)
    assert np.isnan(nowhere.below) and nowhere.above == 0.02


def test_walking_is_lost_above_the_last_value_that_walks(monkeypatch):
    """Of walkers that fall over a range of slopes below it, too."""

    def walk(walkers, starts, strides, *_):
        slope, n = walkers.slope, len(starts)
        walks = (slope < 0.3) | ((slope > 0.5) & (slope < 0.7))
        outcome = np.where(walks, wj.Outcome.STRIDE, wj.Outcome.FORWARD)
        return WalkEnd(starts, outcome, np.full(n, strides), np.full(n, -1))

    start = lambda walker, parameter, branches, values, _: np.zeros((len(values), 1, 2))
    monkeypatch.setattr(crises, "starts_near_gaits", start)
    monkeypatch.setattr(crises, "iterate_to_cycles", walk)
    lost = wj.loss_of_walking(walker(), "slope", (0.1, 1.0), [], resolution=1e-3)
    assert lost.below < 0.7 <= lost.above <= lost.below + 1e-3


def branch_of(period, sizes, values=None, states=None):
    """One along which the largest multiplier has these sizes."""
    sizes = np.array(sizes)
    values = np.linspace(0, 1, len(sizes)) if values is None else values
    states = np.zeros((len(sizes), period, 2)) if states is None else states
    multipliers = np.stack([-sizes, 0.1 * sizes], axis=1).astype(complex)
    return Branch("slope", values, states, multipliers, states[..., 0], [], [], ("", ""))


def test_the_cascade_stems_from_the_most_stable_gait():
    """Most stable where that is, however unstable elsewhere; and from it alone."""
    short, long = branch_of(1, [1.5, 1.4, 1.6]), branch_of(1, [0.6, 0.9, 5.0])
    doubles = [branch_of(2, [0.3, 2.0]) for _ in range(3)]
    branches = [short, doubles[0], long, doubles[1], doubles[2], branch_of(4, [0.2, 3.0])]
    assert sorted(branch_search.find_descendants(branches, [-1, 0, -1, 2, -1, 3])) == [2, 3, 5]
    assert branch_search.find_descendants([doubles[0]], [-1]) == []


def test_gaits_are_known_from_any_of_their_states(monkeypatch):
    """Of the Hénon map, whose cycle of two is known in closed form."""

    def henon(x, a):
        return jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]])

    def cycle(a):
        root = np.sqrt(4 * a - 3 * 0.7**2)
        x = np.array([0.7 - root, 0.7 + root]) / (2 * a)
        return np.stack([x, 0.3 * x[::-1]], axis=1)

    def solve_at(walker, parameter, guesses, tolerance):
        points = [done_with(henon, correct_point(a, x, None, 1.0)) for a, x in guesses]
        return [point and point.cycle for point in points]

    monkeypatch.setattr("walker_jax.gaits.branch_search.solve_at", solve_at)
    values = np.array([0.6, 0.8])
    two = branch_of(2, [0.5, 0.5], values, np.stack([cycle(a) for a in values]))
    look = lambda starts: branch_search.select_new_starts(walker(), "slope", [two], starts, 1e-12)
    x = (np.sqrt(0.7**2 + 4 * 0.7) - 0.7) / (2 * 0.7)
    fixed = np.array([[x, 0.3 * x]] * 2)
    starts = [Start(0.7, x) for x in (cycle(0.7), cycle(0.7)[::-1], fixed, fixed[:1])]
    assert look(starts) == starts[2:]
    assert look([Start(0.9, cycle(0.9))]) != []  # where there is no branch


@pytest.mark.slow
def test_the_whole_diagram():
    data = wj.bifurcation_diagram(
        walker(), "slope", (0.0148, 0.0181), period_max=4, strides=300, scan=10
    )
    events = {
        (int(period), bool(fold)): (float(value), bool(chain))
        for period, fold, value, chain in zip(
            data.event_period.values,
            data.event_fold.values,
            data.event_value.values,
            data.cascade.values,
            strict=True,
        )
    }
    for period, slope in ((1, DOUBLINGS[0]), (2, DOUBLINGS[1])):
        value, chain = events[period, False]
        assert chain and value == pytest.approx(slope, abs=1e-12)
    assert set(data.period.values.tolist()) == {1, 2, 3, 4}
    for i in range(0, data.sizes["gait"], 7):
        one = data.isel(gait=i)
        states = one.states.values[: int(one.period)]
        assert np.isnan(one.states.values[int(one.period) :]).all()
        walked = wj.walk(walker(float(one.value)), states[0], len(states)).states
        np.testing.assert_allclose(walked[:-1], states, rtol=0, atol=1e-10)
        np.testing.assert_allclose(walked[-1], states[0], rtol=0, atol=1e-10)
    periods = data.attractor_period.values.max(axis=1)
    slopes = data.sample_value.values
    settled = np.abs(slopes[:, None] - DOUBLINGS).min(axis=1) > 1e-4
    expected = 2 ** (slopes[:, None] > DOUBLINGS).sum(axis=1)
    np.testing.assert_array_equal(periods[settled], expected[settled])
    assert data.lost.values[0] == 0.0181 and np.isnan(data.lost.values[1])
    assert data.attrs["parameter"] == "slope" and "walker_slope" not in data.attrs


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: wj.bifurcation_diagram(walker(), "slope", (0.1, 0.1)), "interval .*0.1"),
        (lambda: wj.loss_of_walking(walker(), "mass", (0.1, 0.2), []), "parameter .*'mass'"),
        (lambda: wj.loss_of_walking(walker(), "slope", (0.2, 0.1), []), "interval .*0.2"),
        (lambda: wj.loss_of_walking(walker(), "slope", (0.1, 0.2), [], strides=0), "strides .*0"),
        (
            lambda: wj.loss_of_walking(walker(), "slope", (0.1, 0.2), [], resolution=-1.0),
            "resolution .*-1",
        ),
        (
            lambda: wj.bifurcation_diagram(walker(), "slope", (0.1, 0.2), period_max=0),
            "period_max .*0",
        ),
        (
            lambda: wj.attractors(walker(), "slope", np.ones(2), np.ones((3, 1, 2))),
            r"starts .*\(2, starts, 2\).*\(3, 1, 2\)",
        ),
    ],
)
def test_wrong_requests_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_an_interval_from_a_bound_on_is_not_widened():
    widen = branch_search.widen_downwards
    assert widen(walker(), "slope", 0.004, 0.02) == (0.002, 0.02)
    spring = wj.SpringWalker(0.0165, 0.0)
    assert widen(spring, "hip_stiffness", 0.0, 0.02) == (0.0, 0.02)
    powered = wj.PoweredWalker(0.0, push_off=0.05)
    assert widen(powered, "slope", -0.01, 0.01) == pytest.approx((-0.03, 0.01))
    assert widen(powered, "slope", -1.5, 0.5) == (-1.5, 0.5)


@pytest.mark.slow
def test_a_diagram_may_begin_where_a_parameter_is_zero():
    """A gait of period two at the lowest value, of which the doubling is not in the interval."""
    data = wj.bifurcation_diagram(
        wj.SpringWalker(0.0165, 0.0), "hip_stiffness", (0.0, 0.02), period_max=2, scan=4, strides=50
    )
    assert {1, 2} <= set(data.period.values.tolist())
