"""Volumes of basins in many dimensions, against balls, ellipsoids and products in closed form."""

import math

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins.attractor import all_motions
from walker_jax.stability.basin_volumes import grow, slide


def log_ball(d: int) -> float:
    """The logarithm of the unit ball's volume, pi^(d/2) / (d/2)!."""
    return d / 2 * math.log(math.pi) - math.lgamma(d / 2 + 1)


@pytest.mark.parametrize("d", [2, 6, pytest.param(20, marks=pytest.mark.slow)])
def test_volumes_of_ellipsoids_and_cubes_within_their_errors(d):
    """The longest axis is twice the shortest. The centre is off the middle, on none of the axes."""
    axes, centre = np.linspace(0.4, 0.2, d), np.full(d, 0.5) + 0.05 * np.sin(np.arange(d))
    ellipsoid = lambda y: np.sum(((y - 0.5) / axes) ** 2, axis=1) < 1
    cube = lambda y: np.all((y > 0.3) & (y < 0.9), axis=1)
    wanted = log_ball(d) + np.log(axes).sum(), d * np.log(0.6)
    for inside, value in zip((ellipsoid, cube), wanted, strict=True):
        radii, logs, error = grow(inside, centre, np.random.default_rng(0), 128, 32)
        assert abs(logs[-1] - value) < 3 * error < 1.2
        assert (np.diff(logs) >= 0).all() and len(radii) == len(logs)


def test_a_move_along_a_line_ends_anywhere_on_it():
    """From one point, along one line of the unit cube cut off by a ball: uniform between them."""
    n = 4000
    x, lines = np.tile([0.5, 0.25], (n, 1)), np.tile([0.0, 1.0], (n, 1))
    below = lambda y: y[:, 1] < 0.5
    ends = slide(below, x, lines, np.array([0.5, 0.5]), 0.4, np.random.default_rng(0))
    np.testing.assert_array_equal(ends[:, 0], 0.5)
    places = np.sort((ends[:, 1] - 0.1) / 0.4)  # from 0.5 - 0.4 to 0.5
    assert 0 <= places[0] and places[-1] <= 1
    assert np.abs(places - (np.arange(n) + 0.5) / n).max() < 1.63 / np.sqrt(n)  # Kolmogorov, 1 %


def test_the_basin_of_a_map_in_four_dimensions():
    """Each coordinate goes to 1 from (0, sqrt(3)), to -1 from (-sqrt(3), 0): volume 3^(4/2)."""
    names = tuple("abcd")
    system = wj.Map(lambda x: 1.5 * x - 0.5 * x**3, names)
    attractors = wj.find_attractors(system, np.full((1, 4), 0.8))
    (one,) = attractors
    np.testing.assert_allclose(one.states, 1, atol=1e-9)
    region = wj.Grid.plain(**dict.fromkeys(names, (-(3**0.5), 3**0.5, 1)))
    found = wj.basin_volume(system, one, region, samples=64, moves=4, strides=40, progress=False)
    assert abs(found.value - 9) < 3 * found.error < 7
    assert found.share == pytest.approx(found.value / (2 * 3**0.5) ** 4, rel=1e-12)
    far, saddle = one._replace(states=one.states + 9), one._replace(states=0 * one.states)
    for wrong in (all_motions(one.states), far, saddle):
        with pytest.raises(ValueError, match="attractor must be a stable cycle"):
            wj.basin_volume(system, wrong, region)


def test_a_set_that_fills_no_ball_is_told():
    with pytest.raises(wj.ComputationFailed, match="no ball around the attractor"):
        grow(lambda y: y[:, 0] > 2, np.full(2, 0.5), np.random.default_rng(0), 8, 1)
