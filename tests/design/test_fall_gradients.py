"""The action of the most probable fall changes as its derivative says."""

import numpy as np
import pytest

import walker_jax as wj


@pytest.mark.parametrize("strides", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_action_changes_with_slope_and_spring(strides):
    """By differences of actions that are searched for anew."""
    how = {"strides": strides, "directions": 8 * strides**2}
    values = {"slope": 0.004, "hip_stiffness": 0.5}
    action = lambda **changed: (
        wj.most_probable_fall(wj.SpringWalker(**values | changed), **how).action
    )
    found = wj.measure(wj.SpringWalker(**values), "fall-action", [*values], **how)
    assert found.value == pytest.approx(action(), rel=1e-12)
    for name, gradient in zip(values, found.gradient, strict=True):
        step = 1e-3 * values[name]
        low, high = (action(**{name: values[name] + side}) for side in (-step, step))
        assert gradient == pytest.approx((high - low) / (2 * step), rel=1e-4)
    assert np.shape(wj.measure(wj.SpringWalker(**values), "fall-action", (), **how).gradient) == (
        0,
    )
