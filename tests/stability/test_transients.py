"""Long transients: known rates, exponents and dimensions of saddles, and laws of crises."""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.escapes import crisis_exponents, exponents_along


def tent(x, steepness):
    return jnp.where(x < 0.5, steepness * x, steepness * (1 - x))


def open_tent(steepness):
    within = lambda x, steepness: (x[0] > 0) & (x[0] < 1)
    return wj.Map(tent, ("x",), parameters={"steepness": steepness}, feasible=within)


@pytest.mark.parametrize("steepness", [2.2, 3.0])
def test_an_open_tent_map(steepness):
    """Of the interval 2/s stays at each step; the saddle is a Cantor set of ratio 1/s."""
    starts = np.random.default_rng(0).uniform(size=(300_000, 1))
    found = wj.transients(open_tent(steepness), starts, settle=5, strides=500)
    rate = np.log(steepness / 2)
    assert found.low < rate < found.high and found.high - found.low < 0.03 * rate
    assert found.exponents == pytest.approx([np.log(steepness)], rel=1e-12)
    assert found.dimension == pytest.approx(np.log(2) / np.log(steepness), abs=0.01)
    assert found.ended.all() and (found.lives[found.ended] >= 0).all()


def test_escapes_end_in_failures():
    system = open_tent(2.2)
    starts = np.random.default_rng(2).uniform(size=(3000, 1))
    found = wj.transients(system, starts, settle=5, strides=500)
    assert found.escapes.shape == (100, 5, 1) and found.section == ("x",)
    first, last = found.escapes[:, :-1, 0], found.escapes[:, 1:, 0]
    np.testing.assert_allclose(tent(first, 2.2), last, rtol=0, atol=1e-12)
    assert (last[:, -1] > 1).all() and (first < 1).all()  # from there no step begins


def henon_like(x, a):
    return jnp.stack([a - x[0] ** 2 + 0.3 * x[1], x[0]])


def test_a_saddle_of_henon_and_its_boxes():
    """Beyond its crisis at a = 1.4269; the area contracts by 0.3 in each step."""
    within = lambda x, a: jnp.max(jnp.abs(x)) < 3
    system = wj.Map(henon_like, ("x", "y"), parameters={"a": 1.6}, feasible=within)
    starts = np.random.default_rng(1).uniform(-2, 2, size=(200_000, 2))
    found = wj.transients(system, starts, settle=10, strides=2000)
    assert found.exponents.sum() == pytest.approx(np.log(0.3), rel=1e-12)
    survivors = [np.count_nonzero(found.lives >= n) for n in (20, 40)]
    decay = np.log(survivors[0] / survivors[1]) / 20
    assert decay == pytest.approx(found.rate, rel=0.05)
    assert found.low < found.rate < found.high
    counts = []
    for size in (0.05, 0.1, 0.2):
        boxes = np.floor(found.saddle / size).astype(int)
        counts.append(len(np.unique(boxes, axis=0)))
    slope = -np.diff(np.log(counts)) / np.log(2)
    assert slope.mean() == pytest.approx(found.dimension, abs=0.2)


def test_the_saddle_beyond_the_loss_of_walking():
    walker = wj.SimplestWalker(0.0194)
    on_saddle = wj.find_gaits(walker, 2)[0].states
    starts = np.concatenate(
        [one + 1e-4 * np.random.default_rng(0).normal(size=(400, 2)) for one in on_saddle]
    )
    found = wj.transients(walker, starts)
    assert 15 < found.mean_life < 22 and found.ended.all()
    assert found.exponents[0] > found.rate > 0 > found.exponents[1]
    assert 0 < found.dimension < 2


def test_frames_are_aligned_before_exponents_count():
    """Along x' = A x the exponents are the logarithms of A's eigenvalues, once a frame is along the
    first: their ratio of 6 to the power of 40 leaves no error."""
    a, axes = np.diag([1.8, 0.3]), np.array([[1.0, 0.7], [0.4, 1.0]])
    matrix = jnp.asarray(axes @ a @ np.linalg.inv(axes))
    system = wj.Map(lambda x: matrix @ x, ("x", "y"))
    paths = [np.zeros((200, 2)), np.ones((250, 2))]
    found = exponents_along(system, paths, integrator_of(np.float64))
    np.testing.assert_allclose(found, np.log([1.8, 0.3]), rtol=1e-12)


@pytest.mark.parametrize("law", ["no crisis", "at the first value"])
def test_lives_that_follow_no_law_have_no_crisis(law):
    """A crisis far below all values, or at the first one, would fit them best."""
    values = np.linspace(1.0, 2.0, 12)
    lives = np.exp(-3 * values) if law == "no crisis" else np.append(1e30, (values[1:] - 1) ** -1)
    with pytest.raises(ComputationFailed, match="no crisis fits these lives best"):
        wj.crisis_law(values, lives, 0.01 * lives)


def test_crisis_laws_are_found_again(monkeypatch):
    monkeypatch.setattr("walker_jax.stability.escapes.RESAMPLES", 100)
    rng = np.random.default_rng(3)
    values = 1.0 + np.geomspace(1e-3, 1e-1, 12)
    lives = 5 * (values - 0.9995) ** -0.7
    errors = 0.01 * lives
    found = wj.crisis_law(values, lives * (1 + 0.01 * rng.normal(size=12)), errors, confidence=0.99)
    assert found.low < 0.7 < found.high and found.high - found.low < 0.15
    assert found.crisis == pytest.approx(0.9995, abs=2e-4) and found.misfit < 3
    known = wj.crisis_law(values, lives, errors, crisis=0.9995)
    assert known.exponent == pytest.approx(0.7, rel=1e-12) and known.misfit < 1e-20
    bent = wj.crisis_law(values, lives * np.where(values > 1.02, 0.3, 1), errors, crisis=0.9995)
    assert bent.misfit > 100


def test_predicted_exponents():
    """The tent map's limit is 1/2, without contraction in one direction; both agree there."""
    one_dimension, even = crisis_exponents([-3.0, 1e-300]), crisis_exponents([4.0, 0.0625])
    assert one_dimension == pytest.approx({"heteroclinic": 0.5, "homoclinic": 0.5}, abs=2e-3)
    assert even == pytest.approx({"heteroclinic": 1.0, "homoclinic": 1.0})
    values = np.array([1.0, 2.0, 3.0, 4.0])
    law = partial(wj.crisis_law, values, 1 / values, values / 100, crisis=0.0)
    assert law(multipliers=[4.0, 0.0625]).predicted == even and law().predicted == {}


def test_wrong_use_of_transients():
    system = open_tent(3.0)
    with pytest.raises(WrongUse, match=r"starts must have shape \(n, 1\), not \(2, 3\)"):
        wj.transients(system, np.zeros((2, 3)))
    with pytest.raises(ComputationFailed, match="no walk lasts for 60 strides"):
        wj.transients(system, np.full((3, 1), 0.5))
    with pytest.raises(WrongUse, match="values must be 4 or more, ascending, not"):
        wj.crisis_law([1.0, 2.0], [1.0, 1.0], [1.0, 1.0])
    values = [1.0, 2.0, 3.0, 4.0]
    with pytest.raises(WrongUse, match="errors must be 4 positive numbers, not"):
        wj.crisis_law(values, values, [0.0, 1.0, 1.0, 1.0])
    with pytest.raises(WrongUse, match="crisis must be below 1, not"):
        wj.crisis_law(values, values, values, crisis=2.0)
    with pytest.raises(WrongUse, match="multipliers must be two of a saddle"):
        wj.crisis_law(values, values, values, multipliers=[0.5, 0.2])
