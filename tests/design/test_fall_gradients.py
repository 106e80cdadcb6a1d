"""The action of the most probable fall changes as its derivative says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from networks import NetworkWalker

import walker_jax as wj


@pytest.fixture
def strict():
    """JAX's options to find faults, which this long computation passes too."""
    with jax.debug_nans(True), jax.numpy_rank_promotion("raise"):
        yield


SPRING = wj.SpringWalker, {"slope": 0.004, "hip_stiffness": 0.5}


@pytest.mark.usefixtures("strict")
@pytest.mark.parametrize(
    ("kind", "values", "strides"),
    [
        (wj.SimplestWalker, {"slope": 0.004}, 1),
        *(pytest.param(*SPRING, strides, marks=pytest.mark.slow) for strides in (1, 3)),
    ],
)
def test_the_action_changes_with_slope_and_spring(kind, values, strides):
    """By differences of actions that are searched for anew."""
    how = {"strides": strides, "directions": 8 * strides**2}
    action = lambda **changed: wj.most_probable_fall(kind(**values | changed), **how).action
    found = wj.measure(kind(**values), "fall-action", [*values], **how)
    assert found.value == pytest.approx(action(), rel=1e-12)
    for name, gradient in zip(values, found.gradient, strict=True):
        step = 1e-3 * values[name]
        low, high = (action(**{name: values[name] + side}) for side in (-step, step))
        assert gradient == pytest.approx((high - low) / (2 * step), rel=1e-4)
    assert np.shape(wj.measure(kind(**values), "fall-action", (), **how).gradient) == (0,)


@pytest.mark.slow
@pytest.mark.parametrize("strides", [1, 2])
def test_the_action_changes_with_all_weights_of_a_network(strides):
    """By a difference along a direction in which all change; the gait changes too.

    On a steeper slope, of 0.009, the boundary is fractal, and each search finds another edge.
    """
    how = {"strides": strides, "directions": 8 * strides**2}
    walker = NetworkWalker(0.004)
    weights, unravel = ravel_pytree(walker.policy)
    towards = np.random.default_rng(0).normal(size=weights.size)
    action = lambda step: (
        wj.most_probable_fall(
            NetworkWalker(0.004, policy=unravel(weights + step * jnp.asarray(towards))), **how
        ).action
    )
    found = wj.measure(walker, "fall-action", lambda one: one.policy, **how)
    assert found.gradient.shape == weights.shape
    by = (8 * (action(1e-3) - action(-1e-3)) - action(2e-3) + action(-2e-3)) / 12e-3
    assert by / found.value == pytest.approx(found.gradient @ towards / found.value, rel=1e-4)
    assert abs(by) > 0.01 * found.value
