"""The least disturbance is the nearest point that fails."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.robustness import least_disturbance, nearest_failure


@pytest.mark.parametrize("size", [2, 3])
def test_the_nearest_point_of_a_half_plane(size):
    normal = np.arange(1.0, size + 1)
    normal /= np.linalg.norm(normal)
    for distance in (0.003, 0.3, 7.0):
        found = nearest_failure(
            lambda y, d=distance: y @ normal > d, np.eye(size), lambda y: 0 * y + normal
        )
        np.testing.assert_allclose(found, distance * normal, rtol=0, atol=1e-6 * distance)
        assert np.linalg.norm(found) == pytest.approx(distance, rel=1e-11)


CENTRES = np.array([[-1.0, 0.2], [0.3, 0.8], [0.6, -0.3]])
RADII = np.array([0.3, 0.3, 0.12])


def gaps(y):
    return np.linalg.norm(y[:, None] - CENTRES, axis=2) - RADII


def towards(y):
    """The direction to the disc that is nearest."""
    away = CENTRES[gaps(y).argmin(axis=1)] - y
    return away / np.linalg.norm(away, axis=1, keepdims=True)


@pytest.mark.parametrize("gradient", [towards, lambda y: np.full_like(y, np.nan)])
def test_the_nearest_of_several_discs(gradient):
    """One that is far off and large, one nearer, and a small one nearer still."""
    found = nearest_failure(lambda y: (gaps(y) < 0).any(axis=1), np.eye(2), gradient)
    nearest = np.linalg.norm(CENTRES, axis=1) - RADII
    assert np.linalg.norm(found) == pytest.approx(nearest.min(), rel=1e-8)
    accuracy = 1e-6 if gradient is towards else 1e-4
    np.testing.assert_allclose(
        found / np.linalg.norm(found), CENTRES[2] / np.linalg.norm(CENTRES[2]), atol=accuracy
    )


def test_in_one_direction_only():
    fails = lambda y: (y[:, 1] > 0.2) | (y[:, 1] < -0.05)
    found = nearest_failure(fails, np.array([[0.0, 1.0]]), np.zeros_like)
    np.testing.assert_allclose(found, [0, -0.05], rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="returns from everywhere"):
        nearest_failure(fails, np.array([[1.0, 0.0]]), np.zeros_like)


def test_a_push_that_changes_the_speed_alone():
    walker = wj.SimplestWalker(0.004)
    gait = wj.find_gait(walker)
    found = least_disturbance(walker, gait, along=[0, 1])
    assert abs(found.direction[0]) < 1e-12 and abs(found.direction[1]) == pytest.approx(1)
    state = np.asarray(gait.states[0])
    np.testing.assert_allclose(found.state, state + found.size * found.direction, atol=1e-15)
    # the walker walks on from just short of it, and fails as said from there
    inside = wj.walk(walker, state + 0.9999 * found.size * found.direction, 300)
    assert inside.outcomes[-1] == Outcome.STRIDE
    outside = np.asarray(
        wj.walk(walker, state + (1 + 1e-8) * found.size * found.direction, 300).outcomes
    )
    assert outside[-1] == found.failure != Outcome.STRIDE
    assert (outside == Outcome.STRIDE).sum() == pytest.approx(found.strides, abs=3)
    # in other units the same point
    scaled = least_disturbance(walker, gait, along=[0, 1], scale=np.abs(state))
    np.testing.assert_allclose(scaled.state, found.state, rtol=0, atol=1e-9)
    assert scaled.size == pytest.approx(found.size / abs(state[1]))


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.004, 0.009, 0.012])
def test_no_point_of_a_fine_polar_grid_is_nearer(slope):
    from walker_jax.basin import near
    from walker_jax.robustness import end_of_walk
    from walker_jax.tiles import over_cells

    walker = wj.SimplestWalker(slope)
    gait = wj.find_gait(walker)
    found = least_disturbance(walker, gait)
    states = np.asarray(gait.states)
    parameters = type(walker)(np.asarray(walker.slope))
    shared = parameters, np.float64(1e-12), states, near(states.dtype), np.int32(500)
    angles = 2 * np.pi * np.arange(20_000) / 20_000
    radii = np.linspace(0.8, 1.002, 102) * found.size
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    nearest = np.inf
    for radius in radii:
        if not over_cells(end_of_walk, shared, states[0] + radius * rays).back.all():
            nearest = radius
            break
    assert nearest == pytest.approx(found.size, rel=3e-3)


def test_wrong_arguments_are_refused():
    walker = wj.SimplestWalker(0.004)
    gait = wj.find_gait(walker)
    for scale in ([1.0], [1.0, 0.0], [1.0, np.nan]):
        with pytest.raises(ValueError, match="scale must be 2 positive numbers"):
            least_disturbance(walker, gait, scale=scale)
    for along in ([1.0], [[1.0, 0.0], [2.0, 0.0]], [np.nan, 1.0], [0.0, 0.0]):
        with pytest.raises(ValueError, match="along must be independent vectors"):
            least_disturbance(walker, gait, along=along)
    with pytest.raises(ValueError, match="strides must be at least 1"):
        least_disturbance(walker, gait, strides=0)
    unstable = wj.find_gait(wj.SimplestWalker(0.018))
    with pytest.raises(ValueError, match="gait must be a stable one"):
        least_disturbance(wj.SimplestWalker(0.018), unstable)
