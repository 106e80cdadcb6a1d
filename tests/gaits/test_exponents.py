"""Lyapunov exponents: of maps in closed form, and of the walker against reference values."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import read_values

import walker_jax as wj
from walker_jax.gaits.exponents import kaplan_yorke

REFERENCE = read_values("systems")


def test_exponents_of_henon():
    one = REFERENCE["henon_lyapunov"]
    found = wj.lyapunov(wj.systems.HenonMap(), np.array([0.1, 0.1]), 20_000)
    combined = np.hypot(found.errors, one["stderr"])
    exact = np.array([one["l1"], np.log(0.3) - one["l1"]])
    assert (np.abs(found.exponents - exact) < 4 * combined).all() and (found.errors < 1e-3).all()
    assert found.exponents.sum() == pytest.approx(np.log(0.3), abs=1e-10)
    assert found.log_determinant == pytest.approx(np.log(0.3), abs=1e-10)
    assert found.dimension == pytest.approx(1 + exact[0] / -exact[1], abs=1e-3)
    assert 0 < found.dimension_error < 1e-3 and found.outcome == wj.Outcome.STRIDE
    inside = wj.strides(wj.systems.HenonMap(), found.states)
    assert (inside.outcome == wj.Outcome.STRIDE).all()


def test_exponents_of_the_simplest_walker():
    one = REFERENCE["lyapunov"]["values"]["0.0185"]
    walker = wj.SimplestWalker(0.0185)
    found = wj.lyapunov(walker, wj.find_gait(walker).states[0], 1000)
    combined = np.hypot(found.errors, one["stderr"])
    assert (np.abs(found.exponents - one["exponents"]) < 4 * combined).all()
    assert (found.errors < 0.004).all()
    assert found.exponents.sum() == pytest.approx(found.log_determinant, abs=1e-8)
    assert found.log_determinant == pytest.approx(one["sum"], abs=1e-3)


def test_those_of_a_stable_gait_are_its_multipliers():
    """Of many systems at once: of two real ones, p and 0.3, and of a pair of modulus p."""
    values, points = np.array([0.2, 0.5, 0.9]), np.zeros((3, 2))
    real = wj.Map(
        lambda x, p: jnp.stack([p * x[0] + x[1], 0.3 * x[1] + x[0] ** 2]),
        ("x", "y"),
        parameters={"p": 0.5},
    )
    pair = wj.Map(
        lambda x, p: p * jnp.stack([0.6 * x[0] - 0.8 * x[1], 0.8 * x[0] + 0.6 * x[1]]),
        ("x", "y"),
        parameters={"p": 0.5},
    )
    for system, exact in ((real, [np.full(3, 0.3), values]), (pair, [values, values])):
        many = jax.tree.map(lambda _: values, system)
        found = wj.lyapunov(many, points, 300, walks=3)
        exact = -np.sort(-np.log(np.stack(exact, axis=1)), axis=1)
        np.testing.assert_allclose(found.exponents, exact, rtol=0, atol=1e-13)
        assert (found.dimension == 0).all() and (found.errors < 1.001 / 300).all()
        assert found.exponents.shape == (3, 2) and found.states.shape == (3, 3, 2)


def test_one_turn_of_a_cycle_gives_what_walks_give():
    """Of a gait of period 2, and of one of period 4 from two of its states."""
    slopes = np.array([0.0165, 0.0179])
    gaits = [
        wj.find_gait(wj.SimplestWalker(slope), period=period)
        for slope, period in zip(slopes, (2, 4), strict=True)
    ]
    walkers = jax.vmap(wj.SimplestWalker)(jnp.append(slopes, slopes[1]))
    x = np.stack([gaits[0].states[0], gaits[1].states[0], gaits[1].states[3]])
    found = wj.lyapunov(walkers, x, 400, walks=3, settling=201)
    walked = wj.lyapunov(walkers, x + 1e-7, 400, walks=3, settling=201)
    exact = [np.log(np.abs(gait.multipliers)) / len(gait.states) for gait in gaits]
    np.testing.assert_allclose(found.exponents[:2], exact, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.exponents[2], exact[1], rtol=0, atol=1e-9)
    assert (np.abs(walked.exponents - found.exponents) < 3 * walked.errors).all()
    assert (np.abs(walked.exponents - found.exponents) > 1e-9).any()
    np.testing.assert_allclose(found.states, walked.states, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.log_determinant, found.exponents.sum(axis=1), atol=1e-12)


def test_of_an_unstable_gait_walks_tell():
    """Walks from near a gait that is unstable leave it for the attractor, a gait of period 2."""
    walker = wj.SimplestWalker(0.0165)
    found = wj.lyapunov(walker, wj.find_gait(walker).states[0], 400, walks=2, settling=800)
    exact = np.log(np.abs(wj.find_gait(walker, period=2).multipliers)) / 2
    assert (np.abs(found.exponents - exact) < 3 * found.errors).all()


@pytest.mark.parametrize(
    "size, zeros",
    [
        (1, 1),
        (2, 1),
        pytest.param(2, 2, marks=pytest.mark.slow),
        pytest.param(3, 2, marks=pytest.mark.slow),
    ],
)
def test_a_multiplier_of_zero_has_no_finite_logarithm(size, zeros):
    """One turn of the cycle gives a single one, and walks give several."""
    diagonal = np.where(np.arange(size) < size - zeros, 0.5, 0.0)
    system = wj.Map(lambda x: diagonal * x, tuple("xyz"[:size]))
    found = wj.lyapunov(system, np.zeros(size), 10, walks=2, settling=3)
    with np.errstate(divide="ignore"):
        np.testing.assert_allclose(found.exponents, np.log(diagonal), rtol=1e-14)
    np.testing.assert_allclose(found.errors, 0.1)
    assert found.dimension == 0 and found.log_determinant == -np.inf


def test_multipliers_that_rounding_hides_are_left_to_walks():
    """Of three, of which the second is a millionth of the matrix: one turn would lose digits."""
    shear = np.tril(np.ones((3, 3)))
    for second, walked in ((2.0**-4, False), (2.0**-20, True)):
        matrix = shear @ (np.diag([0.75, second, 2.0**-24]) + np.triu(np.ones((3, 3)), 1))
        matrix = matrix @ np.linalg.inv(shear)
        system = wj.Map(lambda x, matrix=matrix: matrix @ x, ("x", "y", "z"))
        found = wj.lyapunov(system, np.zeros(3), 200, walks=2)
        np.testing.assert_allclose(found.exponents[:2], np.log([0.75, second]), rtol=0.1)
        assert found.states.any() == walked


def test_errors_of_exponents_contain_those_of_derivatives():
    """A matrix with the eigenvalues 1/2 and e^-rate, by one turn of its fixed point and by walks.

    Rounding hides the second from e^-35 on. It is then found too large, but within its error.
    """
    turn = np.array([[0.6, -0.8], [0.8, 0.6]]) @ np.array([[1.0, 0.3], [0.0, 1.0]])
    rates = np.array([2.0, 20.0, 24.0, 45.0, 60.0])
    back = np.linalg.inv(turn)
    rule = lambda x, rate: (turn * jnp.stack([0.5, jnp.exp(-rate)])) @ back @ x
    many = jax.tree.map(lambda _: rates, wj.Map(rule, ("x", "y"), parameters={"rate": 1.0}))
    for x in np.zeros((5, 2)), np.full((5, 2), 1e-3):
        found = wj.lyapunov(many, x, 200, walks=2, settling=0)
        off = np.abs(found.exponents - np.stack([np.full(5, np.log(0.5)), -rates], axis=1))
        assert (off <= found.errors).all() and (found.errors[:, 0] < 0.01).all()
        assert (found.errors[:2, 1] < 0.01).all() and (found.errors[3:, 1] > 1).all()
        assert (off[3:, 1] > 1).all() and (found.dimension == 0).all()


def test_a_cycle_without_derivatives_is_left_to_walks():
    """Of |x|^(1/2) there is none at zero; walks from near it tend to one."""
    system = wj.Map(lambda x: jnp.sqrt(jnp.abs(x)), ("x",))
    found = wj.lyapunov(system, np.zeros(1), 100, walks=2)
    np.testing.assert_allclose(found.exponents, np.log(0.5), atol=1e-3)
    np.testing.assert_allclose(found.states, 1, rtol=1e-12)


def test_walks_that_fail_have_none():
    walker = wj.SimplestWalker(0.0195)
    found = wj.lyapunov(walker, wj.find_gait(walker).states[0], 2000, walks=4)
    assert found.outcome == wj.Outcome.FORWARD and np.isnan(found.exponents).all()
    assert np.isnan(found.dimension) and np.isnan(found.log_determinant)


def test_a_start_that_is_not_finite_has_none():
    """Alone it is refused; of many systems it leaves the others as they are."""
    start = np.array([0.1, 0.1])
    many = jax.vmap(lambda a: wj.systems.HenonMap(a, 0.3))(jnp.array([1.4, 1.2]))
    found = wj.lyapunov(many, np.stack([start, [np.nan, 0.1]]), 100, walks=4)
    alone = wj.lyapunov(wj.systems.HenonMap(), start, 100, walks=4)
    assert found.outcome.tolist() == [wj.Outcome.STRIDE, wj.Outcome.OUTSIDE]
    np.testing.assert_allclose(found.exponents[0], alone.exponents, rtol=0, atol=1e-9)
    assert np.isnan(found.exponents[1]).all()


def test_the_dimension_of_kaplan_and_yorke():
    exponents = np.array([[-1, -2, -3], [0.5, -1, -2], [1, -0.5, -1], [1, 0, -0.5], [1, 0, np.nan]])
    found = kaplan_yorke(exponents)
    np.testing.assert_allclose(found[:4], [0, 1.5, 2.5, 3], rtol=0, atol=1e-15)
    assert np.isnan(kaplan_yorke(np.full((1, 2), np.nan))).all()


def test_the_counted_dimension_is_about_the_same():
    found = wj.lyapunov(wj.systems.HenonMap(), np.array([0.1, 0.1]), 500, walks=300)
    points = [found.states]
    for _ in range(700):
        points.append(np.asarray(wj.strides(wj.systems.HenonMap(), points[-1]).state))
    counted = wj.fractals.information_dimension(np.concatenate(points))
    assert abs(counted.value - found.dimension) < 0.04
    assert counted.low < found.dimension < counted.high and len(counted.sizes) > 5


@pytest.mark.parametrize("dimension", [1, 2])
def test_the_dimension_of_what_is_spread_evenly(dimension):
    points = np.random.default_rng(0).random((200_000, dimension))
    found = wj.fractals.information_dimension(points)
    assert found.value == pytest.approx(dimension, abs=0.01)
    line = np.column_stack([points[:, 0], 2 * points[:, 0], np.zeros(len(points))])
    assert wj.fractals.information_dimension(line).value == pytest.approx(1, abs=0.01)
    assert np.isnan(wj.fractals.information_dimension(points[:100]).value)


def test_what_is_refused():
    system = wj.systems.HenonMap()
    with pytest.raises(ValueError, match="x must be states on the section"):
        wj.lyapunov(system, np.array([0.1]))
    with pytest.raises(ValueError, match="walks must be at least 2, not 1"):
        wj.lyapunov(system, np.array([0.1, 0.1]), walks=1)
    with pytest.raises(ValueError, match=r"x must be finite, not \[nan, 0\.1\]"):
        wj.lyapunov(system, np.array([np.nan, 0.1]))
    with pytest.raises(ValueError, match="points must be finite, of shape"):
        wj.fractals.information_dimension(np.full((3, 2), np.nan))


class Decaying(wj.HybridSystem):
    """A place that decays for a time of 1, at the rate 1."""

    section = ("place",)

    def lift(self, x):
        return {"place": x[0], "time": 0 * x[0]}

    def project(self, state):
        return state["place"][None]

    def modes(self):
        field = lambda y: {"place": -y["place"], "time": jnp.ones_like(y["time"])}
        return {"decay": wj.Mode(field, (wj.Guard(lambda y: y["time"] - 1, wj.SECTION),))}


def test_the_solver_of_exponents_may_be_another():
    """Its error shows: that of the Taylor series is rounding."""
    short: Any = {"strides": 5, "walks": 2, "settling": 0}
    other: Any = {"solver": diffrax.Bosh3(), "tolerance": 1e-5}
    (found,) = wj.lyapunov(Decaying(), [0.5], **short, **other).exponents
    assert 1e-10 < abs(found + 1) < 1e-4


@pytest.mark.slow
def test_exponents_by_another_solver():
    walker = wj.SimplestWalker(0.004)
    gait = wj.find_gait(walker)
    found = wj.lyapunov(walker, gait.states[0], solver=diffrax.Dopri8())
    expected = np.log(np.abs(gait.multipliers))
    np.testing.assert_allclose(found.exponents, expected, rtol=0, atol=1e-6)
