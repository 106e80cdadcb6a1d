"""Margins of strides in space are zero where outcomes change, and have the right derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.stability.margin_changes import differentiate_margins
from walker_jax.walking.failure_margins import Margins, failure_margin

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


def failing(found: Margins) -> np.ndarray:
    return np.array(jax.vmap(failure_margin)(jax.tree.map(jnp.asarray, found)))


@pytest.mark.parametrize("allow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_signs_are_the_outcomes(allow):
    """And a stride is the one that `strides` makes."""
    walker, xs = wj.SpatialWalker(allow_scuffing=allow), starts()
    found, expected = wj.margins_of_many(walker, xs), wj.strides(walker, xs)
    outcome = np.asarray(expected.outcome)
    np.testing.assert_array_equal(found.stride.outcome, outcome)
    np.testing.assert_allclose(found.stride.state, expected.state, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.stride.time, expected.time, rtol=0, atol=1e-11)
    assert set(outcome.tolist()) >= set(DECIDES) - ({Outcome.SCUFFED} if allow else set())
    for code, way in DECIDES.items():
        values = getattr(found, way)
        assert np.all(values[outcome == code] < 0)
        made = values[outcome == Outcome.STRIDE]
        assert np.all((made > 0) | np.isnan(made))
        if way != "scuffing":
            assert not np.isnan(made).any()
        assert np.isnan(values[outcome == Outcome.OUTSIDE]).all()


@pytest.mark.slow
def test_margins_are_zero_where_outcomes_change():
    """At boundaries found by bisection with plain strides.

    Where a disc grazes the slope ahead, a stride jumps from one heel strike to another. If that
    other stride fails later on, no margin tells.
    """
    xs = starts(1, near=0, far=8000)
    outcome = np.asarray(wj.strides(WALKER, xs).outcome)
    rng = np.random.default_rng(2)
    good = np.flatnonzero(outcome == Outcome.STRIDE)
    bad = [rng.choice(np.flatnonzero(outcome == code), 60) for code in DECIDES]
    bad = np.concatenate(bad)
    a, b = xs[rng.choice(good, len(bad))], xs[bad]
    for _ in range(50):
        middle = (a + b) / 2
        strides = (wj.strides(WALKER, middle).outcome == Outcome.STRIDE)[:, None]
        a, b = np.where(strides, middle, a), np.where(strides, b, middle)
    found, beyond = wj.margins_of_many(WALKER, a), wj.margins_of_many(WALKER, b)
    ends, sizes = np.asarray(beyond.stride.outcome), np.abs(failing(beyond))
    for code in DECIDES:
        at = ends == code
        if code in (Outcome.RUNNING, Outcome.STOPPED):
            assert np.mean(sizes[at] < 1e-8) > 0.3
            continue
        assert at.sum() >= 3 and np.max(sizes[at]) < 1e-8
    least = np.nanmin(np.abs([getattr(found, name) for name in DECIDES.values()]), axis=0)
    assert np.max(least[ends == Outcome.SCUFFED]) < 1e-8
    assert np.mean(least[ends != Outcome.OUTSIDE] < 1e-8) > 0.6


@pytest.mark.slow
def test_derivatives_of_failing_margins_agree_with_extrapolated_differences():
    """By all seven coordinates and three parameters, of each kind of failure."""
    names = ["slope", "hip_width", "inertia_zz"]
    xs = starts(3, near=3000)
    fates = np.asarray(wj.strides(WALKER, xs).outcome)
    xs = np.concatenate([xs[fates == code][:12] for code in DECIDES])
    none = np.zeros(len(xs), np.int32)
    found = differentiate_margins(WALKER, xs, none, np.eye(7), names, 1e-14)

    def at(h):
        columns = [
            failing(wj.margins_of_many(WALKER, xs + h * axis, tolerance=1e-14))
            for axis in np.eye(7)
        ]
        for name in names:
            other = wj.SpatialWalker(**{name: float(getattr(WALKER, name)) + h})
            columns.append(failing(wj.margins_of_many(other, xs, tolerance=1e-14)))
        return np.stack(columns, axis=1)

    steps = 2e-4 * 0.5 ** np.arange(3)
    first, second, third = ((at(h) - at(-h)) / (2 * h) for h in steps)
    once, again = (4 * second - first) / 3, (4 * third - second) / 3
    expected, change = (16 * again - once) / 15, np.abs(again - once)
    settled = change < 1e-6
    assert settled.mean() > 0.7
    np.testing.assert_allclose(found[settled], expected[settled], rtol=1e-6, atol=1e-7)
