"""The nearest point that fails, among made-up regions of failure."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.stability.descents import nearest_failure
from walker_jax.stability.rays import (
    FINE,
    bisect,
    bisect_nearest,
    scan,
    spacing,
    spread_directions,
)


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


def test_a_finger_thinner_than_the_first_rays_are_apart():
    """A wedge with its tip at 0.5, between two of them, before a circle of radius 0.9."""
    angle = 2 * np.pi * 100.5 / 720
    along = np.array([np.cos(angle), np.sin(angle)])

    def fails(y):
        on, off = y @ along, np.abs(y @ [-along[1], along[0]])
        return (np.linalg.norm(y, axis=1) > 0.9) | ((on > 0.5) & (off < 0.01 * (on - 0.5)))

    found = nearest_failure(fails, np.eye(2), lambda y: np.full_like(y, np.nan))
    assert fails(found[None]) and not fails(0.999999 * found[None])
    assert 0.5 < np.linalg.norm(found) < 0.53  # the tip, where it is as wide as rays are apart


@pytest.mark.parametrize(("size", "count"), [(2, 720), (3, 180), (3, 720)])
def test_directions_are_as_far_apart_as_is_said(size, count):
    rays = spread_directions(size, count)
    cosines = rays @ rays.T - 2 * np.eye(len(rays))
    nearest = np.arccos(cosines.max(axis=1))
    np.testing.assert_allclose(nearest, spacing(size, count), rtol=0.15)


def test_a_descent_begins_where_a_rough_test_is_a_little_off():
    """The ray along an axis alone meets the ball that fails; it is tried at 0.25, just before."""
    centre = 0.351 * np.eye(5)[0]

    def gap(y):
        return np.linalg.norm(y - centre, axis=1) - 0.1

    found = nearest_failure(
        lambda y: gap(y) < 0,
        np.eye(5),
        lambda y: (centre - y) / np.linalg.norm(centre - y, axis=1, keepdims=True),
        count=16,
        roughly_fails=lambda y: gap(y / 0.995) < 0,
    )
    np.testing.assert_allclose(found, 0.251 * np.eye(5)[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("missed", [False, True])
def test_what_fails_by_a_rough_test_alone_is_no_failure(missed):
    """Not even if that finds nothing else."""
    centre, phantom = np.eye(5)[0], -0.2 * np.eye(5)[0]
    gap = lambda y: np.linalg.norm(y - centre, axis=1) - 0.7
    found = nearest_failure(
        lambda y: gap(y) < 0,
        np.eye(5),
        lambda y: centre - y,
        count=16,
        roughly_fails=lambda y: (
            ((gap(y) < 0) & (not missed)) | (np.linalg.norm(y - phantom, axis=1) < 0.05)
        ),
    )
    np.testing.assert_allclose(found, 0.3 * np.eye(5)[0], rtol=0, atol=1e-9)


def test_normals_are_found_though_none_is_known_at_the_boundary():
    """As rounding decides there how a walk ends."""
    normal = np.full(5, 1 / np.sqrt(5))
    gap = lambda y: y @ normal - 0.3
    gradient = lambda y: np.where(gap(y)[:, None] > 1e-11, normal, np.nan)
    found = nearest_failure(lambda y: gap(y) > 0, np.eye(5), gradient, count=64)
    np.testing.assert_allclose(found, 0.3 * normal, rtol=0, atol=1e-6)


def test_in_one_direction_only():
    fails = lambda y: (y[:, 1] > 0.2) | (y[:, 1] < -0.05)
    found = nearest_failure(fails, np.array([[0.0, 1.0]]), np.zeros_like)
    np.testing.assert_allclose(found, [0, -0.05], rtol=0, atol=1e-12)
    with pytest.raises(wj.ComputationFailed, match="returns to its gait from all disturbances"):
        nearest_failure(fails, np.array([[1.0, 0.0]]), np.zeros_like)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_thin_shell_is_met_on_the_last_search_along_the_ray(axis):
    """Nothing else does that: of 128 and 64 distances, none is in it; of the last 512, one is."""
    shell = 257 / 512

    def fails(y):
        size = np.linalg.norm(y, axis=1)
        return (size > 1) | (np.abs(size - shell) < 1e-4)

    found = nearest_failure(fails, np.eye(2)[[axis]], np.zeros_like)
    assert np.linalg.norm(found) == pytest.approx(shell - 1e-4, abs=1e-9)


def test_dust_of_failures_is_met_by_chance_and_never_lost():
    """Some points fail that are farther than a half, as if at random."""

    def fails(y):
        dust = np.sin(1e7 * y[:, 0]) * np.cos(3e7 * y[:, 1]) > 0.98
        return (np.linalg.norm(y, axis=1) > 0.5) & dust

    found = nearest_failure(fails, np.eye(2), lambda y: np.full_like(y, np.nan))
    assert fails(found[None])[0] and 0.5 < np.linalg.norm(found) < 0.51


def test_few_rays_are_halved_several_times_in_a_call():
    """Of three boundaries the first is found, in fewer calls than there are halvings."""
    ray, calls = np.array([[0.6, 0.8]]), []
    boundary = np.array([0.31, 0.52, 0.83])

    def fails(x):
        calls.append(len(x))
        return np.searchsorted(boundary, np.linalg.norm(x, axis=1)) % 2 == 1

    found = bisect(fails, ray, np.array([1.0]), 1.0, FINE)
    assert boundary[0] < found[0] < boundary[0] + 2e-10 and fails(found[:, None] * ray)
    assert len(calls) - 1 < FINE / 3 and max(calls) == 15
    assert not fails((found - 2.0**-FINE)[:, None] * ray)
    assert bisect(fails, ray, np.array([np.inf]), 1.0, FINE) == np.inf


@pytest.mark.parametrize("count", [2, 40])
def test_the_nearest_of_rays_is_found_as_if_all_were_followed(count):
    """Bit by bit, however many of them are halved in a call, and how often in each."""
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(count, 9, 2))
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    radius = lambda x: 1 + 1e-4 * np.sin(7 * np.arctan2(x[:, 1], x[:, 0]))
    followed = []

    def fails(x):
        followed.append(len(x))
        return np.linalg.norm(x, axis=1) > radius(x)

    flat = rays.reshape(-1, 2)
    high = np.ceil(radius(flat) * 1e3) / 1e3
    high[::7] = np.inf
    every = bisect(fails, flat, high, 1e-3, FINE).reshape(count, 9)
    all_of_them = sum(followed)
    alone = [bisect(fails, flat[i : i + 1], high[i : i + 1], 1e-3, FINE) for i in range(len(flat))]
    np.testing.assert_array_equal(np.concatenate(alone), every.ravel())
    followed.clear()
    high = high.reshape(count, 9)
    least = np.where(np.arange(count) % 2, np.inf, every.min(axis=1) + 1e-5)
    nearest = bisect_nearest(fails, rays, high, 1e-3, least)
    share = sum(followed) / all_of_them if count == 40 else len(followed) / FINE
    assert share < 0.5
    np.testing.assert_array_equal(nearest.min(axis=1), every.min(axis=1))
    np.testing.assert_array_equal(nearest.argmin(axis=1), every.argmin(axis=1))
    exact = np.where(np.isfinite(high.ravel()), radius(flat), np.inf)
    np.testing.assert_allclose(nearest.min(axis=1), exact.reshape(count, 9).min(axis=1), rtol=1e-12)


@pytest.mark.parametrize(("scale", "share"), [(0.04, 0.5), (1.0, 0.8), (30.0, 0.96)])
def test_a_scan_outwards_finds_the_nearest_of_all(scale, share):
    """Bit by bit, from fewer points; farther failures are left out."""
    rays, followed = spread_directions(2, 720), []

    def fails(y):
        followed.append(len(y))
        return (gaps(y / scale) < 0).any(axis=1)

    every = scan(fails, rays, 128)
    all_of_them = sum(followed)
    followed.clear()
    near = scan(fails, rays, 128, 8)
    assert sum(followed) < share * all_of_them
    found = np.isfinite(near)
    np.testing.assert_array_equal(near[found], every[found])
    assert 0 < found.sum() < np.isfinite(every).sum() and near[found].min() == every.min()
    assert every[~found].min() > every.min()
