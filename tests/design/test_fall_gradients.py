"""The action of the most probable fall changes as its derivative says."""

import numpy as np
import pytest

import walker_jax as wj

SPRING = {"slope": 0.004, "hip_stiffness": 0.5}


@pytest.mark.parametrize(
    ("kind", "values", "strides"),
    [
        (wj.SimplestWalker, {"slope": 0.004}, 1),
        pytest.param(wj.SpringWalker, SPRING, 1, marks=pytest.mark.slow),
        pytest.param(wj.SpringWalker, SPRING, 3, marks=pytest.mark.slow),
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
