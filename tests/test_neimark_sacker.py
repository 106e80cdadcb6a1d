"""Neimark-Sacker points along branches: of maps in the place of strides, known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
from maps import done_with

from walker_jax.gaits import continuation


def delayed_logistic(x, p):
    """x' = p x (1 - y), y' = x: its fixed point, x = y = 1 - 1/p, has exp(+-i pi / 3) at p = 2."""
    return jnp.stack([p * x[0] * (1 - x[1]), x[0]])


def with_a_third(x, p):
    """The same beside a coordinate that it drives, and that is at rest with a multiplier of 0.3."""
    return jnp.append(delayed_logistic(x[:2], p), 0.3 * x[2] + x[0] * x[1])


def in_two_scales(x, p):
    """The same in coordinates whose scale changes from stride to stride: cycles of period two."""
    side = x[2]
    next_side = -(3 * side - side**3) / 2
    return jnp.append(
        (1 + 0.2 * next_side) * delayed_logistic(x[:2] / (1 + 0.2 * side), p), next_side
    )


def saddle(x, p):
    """Multipliers p and 0.8 of the fixed point 0: their product passes 1, and both are real."""
    return jnp.stack([p * x[0] + x[0] ** 3, 0.8 * x[1]])


def path_of(stride, states, value, bounds=(1.6, 2.4)):
    start = continuation.Start(value, np.asarray(states, float))
    return done_with(stride, continuation.follow_branch(start, 1.0, bounds))


@pytest.mark.parametrize(
    ("stride", "states", "angle"),
    [
        (delayed_logistic, [[3 / 8] * 2], np.pi / 3),
        (with_a_third, [[3 / 8, 3 / 8, 9 / 64 / 0.7]], np.pi / 3),
        (in_two_scales, [[0.45, 0.45, 1.0], [0.3, 0.3, -1.0]], 2 * np.pi / 3),
    ],
)
def test_a_pair_that_leaves_the_unit_circle_is_located(stride, states, angle):
    path = path_of(stride, states, 1.6)
    assert path.end == "the end of the range" and path.folds == path.doublings == []
    (found,) = path.neimark_sackers
    assert found.kind == "neimark-sacker"
    assert abs(found.value - 2) < 1e-12 and found.residual < 1e-12
    upper = found.multipliers[0]
    assert abs(upper - np.exp(1j * angle)) < 1e-11
    scales = [1.0] if len(states) == 1 else [1.2, 0.8]
    for state, scale in zip(found.states, scales, strict=True):
        np.testing.assert_allclose(state[:2], 0.5 * scale, rtol=0, atol=1e-12)
    before, after = (
        [one for one in path.points if (one.value > 2) == beyond] for beyond in (False, True)
    )
    assert before and after


def test_real_multipliers_whose_product_passes_one_are_no_such_point():
    path = path_of(saddle, [[0.0, 0.0]], 1.1, (1.1, 1.6))
    assert path.end == "the end of the range" and path.neimark_sackers == ()
