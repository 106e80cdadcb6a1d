"""Attractors without a period, told apart; unstable cycles, which are no attractors."""

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins.matching import match_clouds
from walker_jax.basins.motions import (
    clouds_of,
    distinct_motions,
    is_same_motion,
    nearest_motion,
    two_nearest,
)
from walker_jax.walkers.parameters import with_parameter

CUBIC = wj.Map(
    lambda x, a: jnp.stack([a * x[0] - x[0] ** 3, 0.3 * x[1]]),
    ("x", "y"),
    parameters={"a": 2.5},
    feasible=lambda x, a: 4 - x[0] ** 2,
)
"""Odd, so what is on one side of x = 0 is on the other too. The side is kept for ever as long as
the largest value, at x = sqrt(a / 3), is below sqrt(a): for a < 2.598. At 2.5 both are chaotic, at
1.5 there are the fixed points sqrt(a - 1) = +-0.7071, and 0 has the multiplier a."""
GRID = wj.Grid.plain(x=(-1.6, 1.6, 16), y=(-1, 1, 2))


@pytest.fixture(scope="module")
def direct():
    return wj.basin(CUBIC, GRID, "direct")


def kept_side(x, a, strides=3000):
    """The side of 0 on which the map stays, by iteration in NumPy."""
    for _ in range(1000):
        x = a * x - x**3
    side = np.sign(x)
    for _ in range(strides):
        x = a * x - x**3
        assert (np.sign(x) == side).all()
    return side


@pytest.mark.parametrize("method", ["direct", "cell-map"])
def test_two_chaotic_attractors_in_disjoint_cells_are_two(method, direct):
    data = direct if method == "direct" else wj.basin(CUBIC, GRID, method)
    assert data.period.values.tolist() == [0, 0]
    first = data.states.values[:, 0, 0]
    assert first[0] < 0 < first[1]
    if method == "direct":
        side = kept_side(GRID.centres(np.arange(GRID.size))[:, 0], 2.5)
        np.testing.assert_array_equal(data.attractor.values.ravel(), np.where(side < 0, 0, 1))
    np.testing.assert_allclose(data.area, 3.2, rtol=1e-14)  # half of the grid each, by symmetry


def test_they_are_two_in_pieces_refined_and_after_a_jump(tmp_path, direct):
    stored = wj.basin(CUBIC, GRID, "direct", out=tmp_path / "two.zarr")
    np.testing.assert_array_equal(stored.attractor, direct.attractor)
    refined = wj.refine(CUBIC, GRID, 1, check=50)
    assert refined.period.values.tolist() == [0, 0]
    np.testing.assert_allclose(refined.area, 3.2, rtol=0.05)
    jump = wj.tipping_probability(CUBIC, "a", 2.4, GRID, samples=20)
    assert jump.before == jump.after == ("attractor 0", "attractor 1")
    np.testing.assert_array_equal(np.diag(jump.on_attractor), 1)  # both sides are kept


def test_they_keep_their_numbers_over_a_parameter():
    """From two fixed points through two chaotic attractors to one, beyond the merging at 2.598."""
    values = [1.5, 2.4, 2.5, 2.65]
    data = wj.continue_basins(CUBIC, "a", values, GRID, samples=30)
    found = np.isfinite(data.fraction.values)
    assert found.sum(axis=1).tolist() == [2, 2, 2, 1]
    assert data.period.values.tolist() == [1, 1, 0, 0]
    np.testing.assert_array_equal(found[1], found[2])
    np.testing.assert_allclose(data.fraction.values[1:].sum(axis=1, where=found[1:]), 1)
    for name in np.flatnonzero(found[1]):
        side = np.sign(data.states.values[1:3, name, :, 0])
        assert (side == side[0, 0]).all()


def test_a_torus_beside_chaos_is_another_attractor():
    """A circle that turns by the golden ratio attracts at its radius, beside Henon's attractor."""
    angle = np.pi * (np.sqrt(5) - 1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([3.0, 0.0])

    def rule(x):
        radius = jnp.linalg.norm(x - middle)
        circle = middle + turn @ (x - middle) * (0.5 + 0.5 / radius)
        chaos = jnp.stack([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])
        return jnp.where(x[0] > 1.6, circle, chaos)

    system = wj.Map(rule, ("x", "y"), feasible=lambda x: 10 - jnp.abs(x[0]))
    grid = wj.Grid.plain(x=(-1, 4.2, 26), y=(-0.5, 0.5, 10))
    data = wj.basin(system, grid, "direct")
    assert data.period.values.tolist() == [0, 0]
    right = data.x.values > 1.6
    assert set(np.unique(data.attractor.values[right])) == {1}
    assert set(np.unique(data.attractor.values[~right])) == {-1, 0}  # some leave Henon's basin
    assert abs(data.states.values[1, 0, 0] - 2) < 1e-3  # the smallest x of the circle


def test_motions_of_a_conservative_system_are_one():
    """The standard map: each start has a circle of its own, and none attracts."""

    def rule(x):
        p = jnp.mod(x[1] + 0.5 * jnp.sin(x[0]), 2 * jnp.pi)
        return jnp.stack([jnp.mod(x[0] + p, 2 * jnp.pi), p])

    grid = wj.Grid.plain(q=(0, 2 * np.pi, 5), p=(0, 2 * np.pi, 5))
    data = wj.basin(wj.Map(rule, ("q", "p")), grid, "direct")
    assert (data.period.values == 0).sum() == 1 and data.cells.values[-1] > 20


def orbit(x, n=2001):
    """States of x -> 2.5 x - x^3 and a constant."""
    states = np.empty((n, 2))
    for state in states:
        x = 2.5 * x - x**3
        state[:] = x, 7.0
    return states


def test_walks_share_a_motion_wherever_they_are_on_it():
    walks = np.stack([orbit(x) for x in (0.3, 0.31, -0.3, 0.7, -1.1)])
    assert is_same_motion(walks[0], walks[1]) and not is_same_motion(walks[0], walks[2])
    found = distinct_motions(walks, [], 9)
    assert [one[0, 0] > 0 for one in found] == [True, False]
    assert [len(distinct_motions(walks, found[:count], 9)) for count in (1, 2)] == [1, 0]
    states = np.stack([walks[3, 1000:1005], walks[4, :5] + [0, 1]])
    nearest, near = nearest_motion(clouds_of(found), states)
    assert nearest.tolist() == [0, 1] and near.tolist() == [True, False]
    assert match_clouds([walks[4], walks[3]], found) == [1, 0]
    assert sorted(match_clouds([walks[4], walks[2]], found)) == [0, 1]  # each is taken once
    assert match_clouds([found[0]], []) == [-1]


def test_a_cycle_too_long_to_be_recognised_is_one_motion():
    """Its points lie on each other but for the last digits, whichever comes first."""
    cycle = np.random.default_rng(0).uniform(size=(128, 2))
    long = np.tile(cycle, (16, 1))
    assert is_same_motion(long + 1e-12 * np.arange(len(long))[:, None], np.roll(long, 5, axis=0))
    assert not is_same_motion(long, long + 0.5)


@pytest.mark.parametrize("cells", [20, 21])
@pytest.mark.parametrize(("a", "method"), [(1.5, "direct"), (1.5, "cell-map"), (2.5, "direct")])
def test_a_start_on_a_saddle_is_no_attractor(method, cells, a):
    """Of an odd number of cells, a column begins on the stable manifold of 0, exactly."""
    grid = wj.Grid.plain(x=(-1.4, 1.4, cells), y=(-1, 1, 3))
    data = wj.basin(with_parameter(CUBIC, "a", a), grid, method)
    real = ~data.artefact.values if method == "cell-map" else np.full(data.sizes["number"], True)
    period = 1 if a == 1.5 else 0
    assert data.period.values[real].tolist() == [period, period]
    assert data["cells"].values[real].tolist() == [cells // 2 * 3] * 2
    if a == 1.5:
        np.testing.assert_allclose(data.states.values[real, 0, 0], [-(0.5**0.5), 0.5**0.5])
    if method == "direct":
        np.testing.assert_array_equal((data.attractor.values == -1).sum(), cells % 2 * 3)


def test_rounding_ends_on_unstable_cycles_that_do_not_attract():
    """0.5 goes to 1 and 0 exactly in the logistic map; doubling shifts all digits out."""
    logistic = wj.Map(lambda x: 4 * x * (1 - x), ("x",))
    data = wj.basin(logistic, wj.Grid.plain(x=(0, 1, 101)), "direct")
    assert data.period.values.tolist() == [0] and data.cells.values.tolist() == [100]
    assert data.attractor.values[50] == -1
    doubling = wj.Map(lambda x: jnp.mod(2 * x, 1.0), ("x",))
    assert wj.basin(doubling, wj.Grid.plain(x=(0, 1, 10)), "direct").sizes["number"] == 0


def test_attractors_on_either_border_of_a_grid_count():
    """Fixed points -2, 0 and 2 with a quarter, a half and a quarter of the cells."""

    def rule(x):
        return jnp.stack(
            [jnp.where(x[0] < -1, -2.0, jnp.where(x[0] > 1, 2.0, 0.0)), 2.0 + 0 * x[1]]
        )

    three = wj.Map(rule, ("x", "y"))
    grid = wj.Grid.plain(x=(-2, 2, 20), y=(-2, 2, 20))
    for method in ("cell-map", "direct"):
        data = wj.basin(three, grid, method)
        np.testing.assert_array_equal(data.states.values[:, 0], [[-2, 2], [0, 2], [2, 2]])
        np.testing.assert_allclose(data.area.values / 16, [0.25, 0.5, 0.25], rtol=1e-15)


def test_nearest_points_on_the_host_are_those_in_a_program():
    """With a point that is twice there, one that is a state, and a state that is not finite."""
    rng = np.random.default_rng(5)
    clouds, x = rng.normal(size=(40, 3, 2)), rng.normal(size=(20, 2))
    clouds[7, 1] = clouds[8, 1]
    x[0], x[1, 0] = clouds[3, 2], np.nan
    expected = two_nearest(jnp.asarray(clouds), jnp.asarray(x))
    for one, other in zip(two_nearest(clouds, x), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    assert np.isnan(expected[0][1]).all() and expected[0][0, 2] == 0 < expected[1][0, 2]
