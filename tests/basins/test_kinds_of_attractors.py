"""Attractors of every kind side by side, and labels of a user's own, against other solvers."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.integrate import solve_ivp

import walker_jax as wj

LOGISTIC = 3.9
GOLDEN = 2 * np.pi * (5**0.5 - 1) / 2
"""The turn of a map of the plane in each stride; no stride brings it back."""


def two_logistic_maps(x):
    """The logistic map on each of (0, 1) and (1, 2)."""
    side = jnp.floor(x[0])
    u = x[0] - side
    return jnp.stack([side + LOGISTIC * u * (1 - u), 0.5 * x[1]])


def around_the_origin(x):
    """Turns; the squared radius s follows s' = s - s (s - 1/4) (s - 1) / 4, and 1/4 repels."""
    s = x[0] ** 2 + x[1] ** 2
    grows = jnp.sqrt(1 - (s - 0.25) * (s - 1) / 4)
    c, d = np.cos(GOLDEN), np.sin(GOLDEN)
    return grows * jnp.stack([c * x[0] - d * x[1], d * x[0] + c * x[1]])


def lorenz84(v, xp=jnp):
    """The flow of Lorenz (1984) at F = 6.886, G = 1.347, a = 0.255, b = 4."""
    x, y, z = v
    return xp.stack(
        [
            -(y**2) - z**2 - 0.255 * x + 0.255 * 6.886,
            x * y - y - 4 * x * z + 1.347,
            4 * x * y + x * z - z,
        ]
    )


def after_one(v):
    """The state after a unit of time, by a hundred steps of Runge and Kutta."""

    def step(_, v):
        a = lorenz84(v)
        b = lorenz84(v + 0.005 * a)
        c = lorenz84(v + 0.005 * b)
        return v + 0.01 / 6 * (a + 2 * b + 2 * c + lorenz84(v + 0.01 * c))

    return lax.fori_loop(0, 100, step, v)


LORENZ = wj.Map(after_one, ("x", "y", "z"))
STARTS = wj.Grid.plain(x=(-1, 3, 6), y=(-2, 3, 6), z=(-2, 2.5, 6))


@pytest.fixture(scope="module")
def features():
    """Spread and least value of x from 300 to 400 units of time, by SciPy, for all starts."""
    x = STARTS.centres(np.arange(STARTS.size)).T
    flow = lambda _, v: lorenz84(v.reshape(3, -1), np).ravel()
    times, by = np.arange(300, 400, 0.1), {"method": "DOP853", "rtol": 1e-8, "atol": 1e-8}
    end = solve_ivp(flow, (0, 400), x.ravel(), t_eval=times, **by).y.reshape(3, x.shape[1], -1)
    return end[0].std(axis=1), end[0].min(axis=1)


@pytest.fixture(scope="module")
def wanted(features):
    """The fixed point, the chaotic attractor and the cycle, whose x falls to -0.677 and -0.471."""
    spread, least = features
    return np.where(spread < 1e-6, 0, np.where(least < -0.6, 1, 2))


def test_a_fixed_point_a_cycle_and_chaos_of_lorenz_84(wanted):
    """After each unit of time the cycle is a closed curve without a period, beside the others."""
    data = wj.basin(LORENZ, STARTS, "direct", strides=300, progress=False)
    assert data.period.values.tolist() == [1, 0, 0]
    found = data.attractor.values.ravel()
    # Solvers part on the chaotic ways to an attractor that a few starts take.
    assert (found != wanted).mean() < 0.02
    shares = data.cells.values / STARTS.size
    np.testing.assert_allclose(shares, np.bincount(wanted) / STARTS.size, atol=0.01)
    still = np.abs(lorenz84(data.states.values[0, 0], np)).max()
    assert still < 1e-10 and shares.min() > 0.1
    largest = [wj.lyapunov(LORENZ, one[0], 500, walks=8).exponents[0] for one in data.states.values]
    assert largest[0] < -0.01 and largest[1] > 0.03 and abs(largest[2]) < 0.01


def test_two_logistic_maps_side_by_side_are_two_attractors():
    """Each lasts on r^2 (4 - r) / 16 to r / 4, from the image of its largest value on."""
    system = wj.Map(two_logistic_maps, ("x", "y"))
    grid = wj.Grid.plain(x=(0, 2, 40), y=(-1, 1, 2))
    data = wj.basin(system, grid, "direct", progress=False)
    x = grid.centres(np.arange(grid.size))
    np.testing.assert_array_equal(data.attractor.values.ravel(), x[:, 0].astype(int))
    assert data.period.values.tolist() == [0, 0] and data.cells.values.tolist() == [40, 40]
    for side, one in enumerate(wj.find_attractors(system, x)):
        ends = side + np.array([LOGISTIC**2 * (4 - LOGISTIC) / 16, LOGISTIC / 4])
        found = one.points[:, 0].min(), one.points[:, 0].max()
        np.testing.assert_allclose(found, ends, atol=1e-3)


def test_a_closed_curve_beside_a_fixed_point():
    """The fixed point attracts from within the radius 1/2, the curve from beyond."""
    system = wj.Map(around_the_origin, ("x", "y"))
    grid = wj.Grid.plain(x=(-1, 1, 40), y=(-1, 1, 40))
    data = wj.basin(system, grid, "direct", progress=False)
    assert data.period.values.tolist() == [1, 0]
    np.testing.assert_allclose(data.states.values[0, 0], 0, atol=1e-6)
    assert np.hypot(*data.states.values[1, 0]) == pytest.approx(1, abs=1e-9)
    r = np.hypot(*grid.centres(np.arange(grid.size)).T)
    np.testing.assert_array_equal(data.attractor.values.ravel(), r > 0.5)
    np.testing.assert_allclose(data.area, [np.pi / 4, 4 - np.pi / 4], rtol=0.01)


def spread_and_least(states):
    return jnp.stack([jnp.std(states[:, 0]), jnp.min(states[:, 0])])


def test_clusters_of_features_are_the_attractors(wanted, tmp_path):
    """As `BasinMapFeaturizing` of Attractors.jl groups the same features of this flow."""
    pytest.importorskip("sklearn")
    by = {"strides": 300, "progress": False, "label": wj.Clusters(spread_and_least)}
    data = wj.basin(LORENZ, STARTS, "direct", **by)
    found, names = data.attractor.values.ravel(), np.arange(data.sizes["number"])
    belong = [np.bincount(wanted[found == i], minlength=3).argmax() for i in names]
    assert sorted(belong) == [0, 1, 2]
    assert (np.append(belong, -1)[found] != wanted).mean() < 0.03
    assert data.attrs["label"] == "Clusters 100 10"
    stored = wj.basin(LORENZ, STARTS, "direct", out=tmp_path / "a", **by)
    np.testing.assert_array_equal(stored.attractor, data.attractor)


def test_walks_to_one_point_are_one_cluster():
    """Rounding alone tells them apart; too few walks are none."""
    pytest.importorskip("sklearn")
    system = wj.Map(lambda x: 0.9 * x + 0.1, ("x",))
    label = wj.Clusters(lambda states: jnp.mean(states, axis=0), strides=5)
    for cells, number in ((40, 0), (9, -1)):
        grid = wj.Grid.plain(x=(-1, 3, cells))
        data = wj.basin(system, grid, "direct", strides=300, label=label, progress=False)
        np.testing.assert_array_equal(data.attractor, number)
    with pytest.raises(ValueError, match="label must have features in one row"):
        wj.basin(system, grid, "direct", label=wj.Clusters(jnp.mean), progress=False)
