"""`label`, a pure function of one start: against the mapper, its closed forms, and under JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins import methods
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.integrators.integrator import integrator_of
from walker_jax.walkers.parameters import with_parameter

CUBIC = wj.Map(
    lambda x, a: jnp.stack([a * x[0] - x[0] ** 3, 0.3 * x[1]]),
    ("x", "y"),
    parameters={"a": 2.5},
    feasible=lambda x, a: 4 - x[0] ** 2,
)
"""Two chaotic attractors at a = 2.5, on both sides of x = 0, which is kept; two fixed points,
sqrt(a - 1) = +-0.7071, at 1.5."""
LINE = wj.Grid.plain(x=(-1.6, 1.6, 41), y=(-1, 1, 3))
DOUBLING = wj.SimplestWalker(0.0151)
"""Just above its period doubling, where walkers come near so slowly that no box captures them."""
WINDOW = wj.Grid.sheared(theta=(0.1, 0.35, 7), sum=(-0.04, 0.01, 8))


def centres(grid: wj.Grid) -> np.ndarray:
    return grid.centres(np.arange(grid.size))


@pytest.mark.parametrize(
    ("system", "grid", "periods", "strides"),
    [
        (CUBIC, LINE, [None, None], 200),
        (with_parameter(CUBIC, "a", 1.5), LINE, [1, 1], 5),  # most converge later
        (DOUBLING, WINDOW, [2], 200),
    ],
)
def test_one_start_and_many_have_the_same_labels(system, grid, periods, strides):
    x = centres(grid)
    attractors = wj.find_attractors(system, x, strides=strides)
    assert [one.period for one in attractors] == periods
    many = Mapper(system, attractors, integrator_of(x.dtype, None), strides)(x)
    label = jax.jit(jax.vmap(lambda y: wj.label(system, attractors, y, strides=strides)))
    for one, other in zip(label(x), many, strict=True):
        np.testing.assert_array_equal(one, other)
    assert set(range(-1, len(periods))) == set(many.attractor.tolist())


def test_labels_of_a_map_are_those_of_its_sides():
    """At a = 1.5: x > 0 goes to sqrt(0.5), x < 0 to its negative, x = 0 stays on a saddle."""
    system, x = with_parameter(CUBIC, "a", 1.5), centres(LINE)
    attractors = wj.find_attractors(system, x)
    np.testing.assert_allclose([one.states[0, 0] for one in attractors], [-(0.5**0.5), 0.5**0.5])
    found = jax.jit(jax.vmap(lambda y: wj.label(system, attractors, y)))(x)
    end = x[:, 0]
    for _ in range(200):
        end = 1.5 * end - end**3
    np.testing.assert_array_equal(
        found.attractor, np.array([0, -1, 1])[1 + np.sign(end).astype(int)]
    )
    assert 0 < (np.sign(end) != np.sign(x[:, 0])).sum() < 30  # some change sides
    assert (found.fate == wj.Outcome.STRIDE).all()
    start = x[-1]
    walked = np.asarray(wj.walk(system, start, int(found.strides[-1])).states)
    away = np.abs(walked - attractors[1].states).max(axis=1)
    assert (away[:-1] >= 1e-6).all() and away[-1] < 1e-6


def test_another_walker_needs_no_new_program():
    """Walkers and attractors are operands; derivatives of what depends on a label are finite."""
    traced = []

    @jax.jit
    def label(walker, attractors, x):
        traced.append(x)
        return wj.label(walker, attractors, x)

    start, near = jnp.array([0.2, -0.2]), [(0.2, -0.2), (0.15, -0.15)]
    for slope in (0.004, 0.005):
        walker = wj.SimplestWalker(slope)
        attractors = wj.find_attractors(walker, near)
        found = label(walker, attractors, start)
        gait = np.asarray(wj.find_gait(walker).states)
        np.testing.assert_allclose(found.state, gait[0], atol=1e-6)
        assert (int(found.fate), int(found.attractor)) == (0, 0) and found.strides > 5
    assert len(traced) == 1

    def reward(slope):
        found = wj.label(wj.SimplestWalker(slope), attractors, start)
        return jnp.where(found.fate == 0, slope**2, 0.0)

    assert jax.grad(reward)(0.005) == pytest.approx(0.01, rel=1e-14)


def test_a_walker_that_falls_is_labelled_by_its_fall():
    walker = wj.SimplestWalker(0.004)
    found = wj.label(walker, [], (0.3, -0.1))
    walked = wj.walk(walker, (0.3, -0.1), 30)
    first = int((np.asarray(walked.outcomes) != 0).argmax())
    assert found.fate == walked.outcomes[first] != 0 and found.strides == first
    assert found.attractor == -1 and np.isnan(found.state).all() and found.fallen


def test_labels_of_ones_own_take_the_place_of_attractors(tmp_path, monkeypatch):
    """Which third of a circle a turn by a third of it ends in: that of the start, as 3 divides."""
    turn = wj.Map(lambda x: jnp.stack([(x[0] + 1 / 3) % 1, 0.5 * x[1]]), ("x", "y"))
    grid = wj.Grid.plain(x=(0, 1, 30), y=(-1, 1, 2))
    third = lambda x: jnp.where(x[0] < 0.9, (3 * x[0]).astype(jnp.int32), -1)
    data = wj.basin(turn, grid, "direct", strides=30, label=third)
    wanted = np.where(grid.centres(np.arange(60))[:, 0] < 0.9, np.arange(60) // 20, -1)
    np.testing.assert_array_equal(data.attractor.values.ravel(), wanted)
    assert data.attrs["label"] == "<lambda>" and data.cells.values.tolist() == [20, 20, 14]
    assert data.period.values.tolist() == [0, 0, 0] and (data.strides == 30).all()
    for method, label, message in (
        ("cell-map", third, "method must be direct, not 'cell-map', for a label of your own"),
        ("direct", 3, "label must be a function, or Clusters of one, not 3"),
        ("direct", wj.Clusters(third, smallest=1), "label smallest must be at least 2, not 1"),
        ("direct", lambda x: x[0], "label must return a whole number"),
    ):
        with pytest.raises(ValueError, match=message):
            wj.basin(turn, grid, method, strides=3, label=label)
    # A store, in pieces of three rows, is the same, and of this label alone.
    monkeypatch.setattr(methods, "PIECE", 6)
    stored = wj.basin(turn, grid, "direct", strides=30, label=third, out=tmp_path / "a")
    for name in data:
        np.testing.assert_array_equal(stored[name], data[name])
    other = lambda x: jnp.where(x[0] < 0.8, (3 * x[0]).astype(jnp.int32), -1)
    with pytest.raises(ValueError, match="holds another result"):
        wj.basin(turn, grid, "direct", strides=30, label=other, out=tmp_path / "a")


def test_find_attractors_and_label_refuse_what_is_no_start():
    walker = wj.SimplestWalker(0.004)
    with pytest.raises(ValueError, match="starts must be points of the section"):
        wj.find_attractors(walker, (0.2, -0.2))
    with pytest.raises(ValueError, match="start must be on the section"):
        wj.label(walker, [], (0.2, 0.4, -0.2, 0.1))


def test_label_refuses_attractors_that_do_not_attract():
    """An unstable gait, and the gait of another walker; traced attractors are the caller's own."""
    walker, start = wj.SimplestWalker(0.0152), (0.3, -0.3)
    unstable = Attractor(np.asarray(wj.find_gait(walker).states))
    (other,) = wj.find_attractors(wj.SimplestWalker(0.004), [(0.2, -0.2)])
    for one in (unstable, other):
        label = lambda x, one=one: wj.label(walker, [one], x)
        for run in (label, jax.jit(label)):
            with pytest.raises(ValueError, match="attractors must attract walkers of this system"):
                run(jnp.array(start))
    traced = jax.jit(lambda cycle, x: wj.label(walker, [cycle], x))(unstable, unstable.states[0])
    assert (traced.fate, traced.attractor, traced.strides) == (0, 0, 0)
