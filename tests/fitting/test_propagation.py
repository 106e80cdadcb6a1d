"""Errors of parameters go on to functions of the system."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from jax import lax
from made_up_recordings import Ball

import walker_jax as wj
from walker_jax.fitting.bounds import Bounds
from walker_jax.fitting.results import Fit

COVARIANCE = np.array([[0.04, 0.006], [0.006, 0.0025]])


def fit_of(system, names, covariance, low=-np.inf):
    """A fit with these errors."""
    values = {name: float(getattr(system, name)) for name in names}
    count = len(names)
    return Fit(
        parameters=values,
        errors=dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        system=system,
        directions=(),
        draws=np.zeros((0, count)),
        converged=True,
        data=xr.Dataset(),
        bounds=Bounds(np.full(count, low), np.full(count, np.inf)),
    )


FIT = fit_of(Ball(9.0, 0.0, 0.8), ["gravity", "restitution"], COVARIANCE)


def height(ball):
    """Height of the bounce after one of speed 1: e^2 / 2 g."""
    return {"height": ball.restitution**2 / (2 * ball.gravity)}


def expected_error():
    g, e = 9.0, 0.8
    slopes = np.array([-(e**2) / (2 * g**2), e / g])
    return np.sqrt(slopes @ COVARIANCE @ slopes)


def test_the_delta_method_is_exact_where_jax_traces():
    found = wj.propagate(height, FIT)
    assert found.value["height"] == pytest.approx(0.64 / 18, rel=1e-14)
    assert found.error["height"] == pytest.approx(expected_error(), rel=1e-12)
    assert found.draws["height"].shape == (0,)


def test_functions_that_jax_cannot_trace_have_differences():
    untraced = lambda ball: float(height(ball)["height"])
    found = wj.propagate(untraced, FIT, draws=5, seed=3)
    assert float(found.error) == pytest.approx(expected_error(), rel=2e-3)
    traced = wj.propagate(height, FIT, draws=5, seed=3)
    np.testing.assert_allclose(found.draws, traced.draws["height"], rtol=1e-12)


def test_draws_have_the_covariance_of_the_fit():
    found = wj.propagate(lambda ball: jnp.stack([ball.gravity, ball.restitution]), FIT, draws=4000)
    spread = np.cov(found.draws.T)
    # a variance of n normal draws is off by sqrt(2 / n) of itself
    np.testing.assert_allclose(spread, COVARIANCE, atol=5 * np.sqrt(2 / 4000) * 0.04)
    np.testing.assert_allclose(np.diag(spread), np.diag(COVARIANCE), rtol=5 * np.sqrt(2 / 4000))
    low, high = found.interval()
    np.testing.assert_allclose(high - low, 2 * 1.96 * np.sqrt(np.diag(COVARIANCE)), rtol=0.08)


def test_draws_stay_within_bounds():
    near = fit_of(Ball(0.1, 0.0, 0.8), ["gravity"], np.array([[0.01]]), low=0.0)
    drawn = near.sample(1000)
    assert drawn.min() >= 0 and abs(np.median(drawn) - 0.1) < 0.02


def test_a_parameter_without_information_stays():
    covariance = np.array([[0.04, np.nan], [np.nan, np.inf]])
    unknown = fit_of(Ball(9.0, 0.0, 0.8), ["gravity", "restitution"], covariance)
    found = wj.propagate(height, unknown, draws=3)
    assert found.error["height"] == pytest.approx(0.2 * 0.64 / (2 * 81), rel=1e-12)
    np.testing.assert_array_equal(unknown.sample(3)[:, 1], 0.8)


def test_complex_results_are_pairs():
    found = wj.propagate(lambda ball: lax.complex(ball.gravity, 2 * ball.gravity), FIT)
    np.testing.assert_allclose(found.value, [9, 18])
    np.testing.assert_allclose(found.error, [0.2, 0.4], rtol=1e-12)


def test_gaits_have_errors():
    """Those of the implicit function theorem, to the curvature over one standard deviation."""
    walker = wj.SimplestWalker(0.009)
    fit = fit_of(walker, ["slope"], np.array([[1e-10]]))
    found = wj.propagate(lambda walker: wj.find_gait(walker).states[0], fit)
    rates = wj.measure(walker, "states", "slope").gradient
    expected = 1e-5 * np.abs(np.asarray(rates)).ravel()
    np.testing.assert_allclose(found.error, expected, rtol=1e-5)
