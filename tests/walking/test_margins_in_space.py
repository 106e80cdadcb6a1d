"""Margins of strides in space are zero where outcomes change, and have the right derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.walkers.spatial import LEAST_STEP
from walker_jax.walking.failure_margins import Margins
from walker_jax.walking.iteration import iterate

WALKER = wj.SpatialWalker()
GAIT = np.array(
    [0.09866765, 0.16016583, 0.29424124, -0.13220966, -0.01990962, -0.47124237, -0.39255917]
)
WIDE = np.array([1, 0.3, 0.3, 1, 2, 1, 1])
"""Around the gait: walkers that stride, and that fail in each way."""
DECIDES = {
    Outcome.BACKWARD: "backward",
    Outcome.FORWARD: "forward",
    Outcome.RUNNING: "running",
    Outcome.STOPPED: "stopping",
    Outcome.SCUFFED: "scuffing",
    Outcome.SIDEWAYS: "sideways",
}


def starts(seed=0, near=1500, far=3000):
    rng = np.random.default_rng(seed)
    close = 0.1 * rng.uniform(-1, 1, (near, 7))
    return GAIT + np.concatenate([close, WIDE * rng.uniform(-1, 1, (far, 7))])


def assert_signs(found: Margins, ways: set) -> None:
    """Which margins are negative, positive and unknown after each outcome; there are these."""
    outcome = found.stride.outcome
    assert set(outcome.tolist()) >= ways
    for code, way in DECIDES.items():
        values = getattr(found, way)
        assert np.all(values[outcome == code] < 0)
        made = values[outcome == Outcome.STRIDE]
        assert np.all((made > 0) | np.isnan(made))
        if way != "scuffing":
            assert not np.isnan(made).any()
        assert np.isnan(values[outcome == Outcome.OUTSIDE]).all()


@pytest.fixture(scope="module")
def some():
    """Margins of a few thousand starts."""
    return wj.margins(WALKER, starts(1, near=300, far=3000))


def test_signs_of_margins_are_the_outcomes(some):
    assert_signs(some, set(DECIDES))
    back = wj.margins(WALKER, GAIT[None])
    np.testing.assert_allclose(back.stride.state[0], GAIT, rtol=0, atol=1e-7)
    assert np.isnan(back.failed).all()


def test_forward_margins_are_by_how_much_heel_strikes_were_some(some):
    """By how far the legs pass each other, and by how high the disc was, whichever is less."""
    made = np.flatnonzero(some.stride.outcome == Outcome.STRIDE)
    passed = some.stride.state[made, 2] - LEAST_STEP  # exchanged, the angle between the legs
    assert (some.forward[made] < passed + 1e-12).all()
    by_angle = np.abs(some.forward[made] - passed) < 1e-12
    xs = starts(1, near=300, far=3000)[made]
    lift, heights = jax.jit(lambda x: WALKER.lift(x)), jax.jit(jax.vmap(WALKER.clearance))
    field, kind = jax.jit(lambda state: jnp.stack(WALKER.vector_field(state))), WALKER.state
    rates = lambda _, y: np.asarray(field(kind(*y)))
    for i in (*np.flatnonzero(by_angle)[:2], *np.flatnonzero(~by_angle)[:4]):
        start = lift(xs[i])
        times = np.linspace(0, some.stride.time[made[i]], 2000)
        way: Any = {"rtol": 1e-10, "atol": 1e-11, "method": "DOP853", "t_eval": times}
        states = solve_ivp(rates, times[[0, -1]], np.array(start), **way).y
        highest = float(np.max(heights(kind(*states))))
        expected = min(highest, passed[i])
        assert some.forward[made[i]] == pytest.approx(expected, abs=1e-7)
    assert by_angle.sum() > 1 and (~by_angle).sum() > 3


@pytest.mark.slow
@pytest.mark.parametrize("allow", [False, True])
def test_signs_are_the_outcomes_of_strides(allow):
    """And a stride is the one that `strides` makes."""
    walker, xs = wj.SpatialWalker(allow_scuffing=allow), starts()
    found, expected = wj.margins(walker, xs), wj.strides(walker, xs)
    np.testing.assert_array_equal(found.stride.outcome, expected.outcome)
    np.testing.assert_allclose(found.stride.state, expected.state, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.stride.time, expected.time, rtol=0, atol=1e-11)
    assert_signs(found, set(DECIDES) - ({Outcome.SCUFFED} if allow else set()))


def outcomes_of_margins(xs):
    return wj.margins(WALKER, xs).stride.outcome


@pytest.mark.parametrize(
    ("outcome_of", "far", "pairs"),
    [
        pytest.param(outcomes_of_margins, 3000, 40, id="of margins", marks=pytest.mark.slow),
        pytest.param(
            lambda xs: wj.strides(WALKER, xs).outcome,
            8000,
            60,
            id="of plain strides",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_margins_are_zero_where_outcomes_change(outcome_of, far, pairs):
    """At boundaries found by bisection.

    Where a disc grazes the slope ahead, a stride jumps from one heel strike to another. If that
    other stride fails later on, no margin tells.
    """
    xs = starts(1, near=0, far=far)
    outcome = np.asarray(outcome_of(xs))
    rng = np.random.default_rng(2)
    good = np.flatnonzero(outcome == Outcome.STRIDE)
    bad = [rng.choice(np.flatnonzero(outcome == code), pairs) for code in DECIDES]
    bad = np.concatenate(bad)
    a, b = xs[rng.choice(good, len(bad))], xs[bad]
    for _ in range(50):
        middle = (a + b) / 2
        strides = (outcome_of(middle) == Outcome.STRIDE)[:, None]
        a, b = np.where(strides, middle, a), np.where(strides, b, middle)
    found, beyond = wj.margins(WALKER, a), wj.margins(WALKER, b)
    ends, sizes = np.asarray(beyond.stride.outcome), np.abs(beyond.failed)
    for code in DECIDES:
        at = ends == code
        if code in (Outcome.RUNNING, Outcome.STOPPED):
            assert np.mean(sizes[at] < 1e-8) > 0.3
            continue
        assert at.sum() >= 3 and np.mean(sizes[at] < 1e-8) > 0.75 and np.isfinite(sizes[at]).all()
    least = np.nanmin(np.abs([getattr(found, name) for name in DECIDES.values()]), axis=0)
    assert np.max(least[ends == Outcome.SCUFFED]) < 1e-8
    assert np.mean(least[ends != Outcome.OUTSIDE] < 1e-8) > 0.6


@pytest.mark.slow
def test_derivatives_of_failing_margins_are_differences():
    """By all seven coordinates and three parameters, of each kind of failure."""
    names = ["slope", "hip_width", "inertia_zz"]
    xs = starts(3, near=3000)
    fates = np.asarray(wj.strides(WALKER, xs).outcome)
    xs = np.concatenate([xs[fates == code][:12] for code in DECIDES])
    none = np.zeros(len(xs), np.int32)
    found = differentiate_margins(WALKER, xs, none, np.eye(7), names, 1e-14)

    def at(h):
        columns = [wj.margins(WALKER, xs + h * axis, tolerance=1e-14).failed for axis in np.eye(7)]
        for name in names:
            other = wj.SpatialWalker(**{name: float(getattr(WALKER, name)) + h})
            columns.append(wj.margins(other, xs, tolerance=1e-14).failed)
        return np.stack(columns, axis=1)

    steps = 2e-4 * 0.5 ** np.arange(3)
    first, second, third = ((at(h) - at(-h)) / (2 * h) for h in steps)
    once, again = (4 * second - first) / 3, (4 * third - second) / 3
    expected, change = (16 * again - once) / 15, np.abs(again - once)
    settled = change < 1e-6
    assert settled.mean() > 0.7
    np.testing.assert_allclose(found[settled], expected[settled], rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_in_seven_dimensions_the_least_is_on_the_boundary():
    """A minimum of the distance: the boundary's normal there, by differences of fates, is its
    direction; and along one coordinate it is no nearer than in all."""
    gait = wj.find_gait(WALKER, GAIT)
    found = wj.least_disturbance(WALKER, gait, directions=2000)
    assert found.failure == Outcome.SCUFFED and found.size == pytest.approx(0.007190584, abs=1e-8)
    x = np.asarray(gait.states[0])

    def lost(points):
        end = np.array(points)
        for _ in range(80):
            end = np.asarray(wj.strides(WALKER, end).state)
        return np.isnan(end).any(axis=1)

    shares = np.array([1 - 1e-7, 1 + 1e-7])
    assert lost(x + shares[:, None] * (found.state - x)).tolist() == [False, True]
    # the boundary a little beside, along seven directions across, is as a sphere to first order
    across = np.linalg.svd(found.direction[None])[2][1:]
    beside = found.state + 2e-5 * np.concatenate([across, -across])
    below, above = np.full(len(beside), -1e-6), np.full(len(beside), 1e-6)
    for _ in range(12):
        middle = (below + above) / 2
        failed = lost(beside + middle[:, None] * found.direction)
        below, above = np.where(failed, below, middle), np.where(failed, middle, above)
    tilt = (above[:6] - above[6:]) / 4e-5
    assert np.abs(tilt).max() < 1e-3
    sideways = wj.least_disturbance(WALKER, gait, along=np.eye(7)[4], directions=16)
    assert sideways.size == pytest.approx(0.008628980, abs=1e-8) and sideways.size > found.size


@pytest.mark.slow
def test_its_gradient_is_that_of_bisections():
    """For a push from the side, of walkers a little wider and with a little larger discs."""
    gait = wj.find_gait(WALKER, GAIT)
    names = ["hip_width", "disc_radius"]
    found = wj.measure(WALKER, "least-disturbance", names, gait, along=np.eye(7)[4], directions=16)

    def size(name, h):
        walker = wj.SpatialWalker(**{name: float(getattr(WALKER, name)) + h})
        x = np.asarray(wj.find_gait(walker, GAIT).states[0])
        low, high = found.value - 2e-4, found.value + 2e-4
        for _ in range(6):  # 65 points each: to 1e-14
            sizes = np.linspace(low, high, 65)
            failed = (
                iterate(walker, x + sizes[:, None] * np.eye(7)[4], 60, Integrator(1e-12)).outcome
                != 0
            )
            low, high = sizes[failed.argmax() - 1], sizes[failed.argmax()]
        return high

    steps = (2e-4, 1e-4, 5e-5)
    for name, slope in zip(names, found.gradient, strict=True):
        first, second, third = ((size(name, h) - size(name, -h)) / (2 * h) for h in steps)
        once, again = (4 * second - first) / 3, (4 * third - second) / 3
        assert slope == pytest.approx((16 * again - once) / 15, rel=1e-5)


@pytest.mark.slow
def test_basin_stability_without_the_way_back_is_the_same_share():
    gait = wj.find_gait(WALKER, GAIT)
    draw = lambda rng, n: np.asarray(gait.states[0]) + 0.01 * rng.uniform(-1, 1, (n, 7))
    plain = wj.basin_stability(WALKER, draw, gait, samples=500)
    quick = wj.basin_stability(WALKER, draw, gait, samples=500, within=None)
    assert plain.value == quick.value and 0.2 < quick.value < 0.95
    assert np.isnan(quick.median) and np.isfinite(plain.median)
    np.testing.assert_array_equal(plain.fates, quick.fates)


@pytest.mark.slow
def test_the_gradient_of_a_slice_is_that_of_areas():
    """Of the slice over yaw and rate of lean, by the hip's width."""
    width = float(WALKER.hip_width)
    point = dict(zip(WALKER.section, GAIT.tolist(), strict=True))
    around = lambda name, half: (point[name] - half, point[name] + half, 16)
    grid = wj.Grid.through(point, yaw=around("yaw", 0.25), leandot=around("leandot", 0.05))
    found = wj.measure(WALKER, "area", ["hip_width"], grid=grid, levels=3, strides=100, check=1000)
    areas = [
        float(wj.refine(wj.SpatialWalker(hip_width=w), grid, 4, strides=100, check=1000).total_area)
        for w in (width - 0.004, width + 0.004)
    ]
    assert found.lost == 0 and found.crossings > 100 and not found.averaged.any()
    assert found.gradient[0] == pytest.approx((areas[1] - areas[0]) / 0.008, rel=0.08)
    assert found.value == pytest.approx(np.mean(areas), rel=0.02)


@pytest.mark.slow
def test_the_boundary_leads_to_where_a_disc_grazes():
    """From a push to the side that scuffs after some strides: the last of them just touches."""
    push = 0.02 * np.eye(7)[4]
    found = wj.edge_state(WALKER, GAIT, GAIT + push, rounds=30)
    assert found.kind == "scuffing" and found.margin < 1e-12
    assert set(found.fates) == {Outcome.STRIDE, Outcome.SCUFFED}
    ends = np.asarray(wj.strides(WALKER, found.path[:-1]).state)
    np.testing.assert_allclose(ends, found.path[1:], atol=1e-9)
