"""Boundaries between attractors count as boundaries between fates do."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.legend import Legend

import walker_jax as wj
from walker_jax import figures
from walker_jax.basins.runs import attractors_of, fates_of, label_of
from walker_jax.cli.boundary_command import boundary_in_words
from walker_jax.stability.boundaries import edge_arrays, label_regions, summarise_boundary
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import OUTCOMES


def turn(x, a, b, j):
    """The map of Grebogi, McDonald, Ott and Yorke (1983, Physics Letters A 99, 415)."""
    t = x[0] + a * jnp.sin(2 * x[0]) - b * jnp.sin(4 * x[0]) - x[1] * jnp.sin(x[0])
    return jnp.stack([jnp.mod(t, 2 * jnp.pi), -j * jnp.cos(x[0])])


TURN = wj.Map(turn, ("theta", "x"), parameters={"a": 1.32, "b": 0.9, "j": 0.3})
GRID = wj.Grid.plain(theta=(0, 2 * np.pi, 120), x=(-0.5, 0.5, 120))


@pytest.fixture(scope="module")
def data():
    """Of the fractal boundary, whose edge states are many, only a short path is followed."""
    with pytest.MonkeyPatch.context() as patch:
        short = partial(wj.edge_state, rounds=10)
        patch.setattr("walker_jax.stability.boundaries.edge_state", short)
        return wj.boundary(TURN, GRID, side=6)


def test_a_label_tells_a_fate_or_an_attractor():
    """Of all failures, a system's own ones too, and of a few attractors."""
    fate = np.concatenate([np.arange(1, OUTCOMES), np.zeros(3, int)])
    attractor = np.concatenate([np.full(OUTCOMES - 1, -1), np.arange(3)])
    labels = label_of(fate, attractor)
    assert len({*labels.tolist()}) == len(labels)
    np.testing.assert_array_equal(fates_of(labels), fate)
    np.testing.assert_array_equal(attractors_of(labels), attractor)


def test_two_attractors_without_a_failure_have_a_boundary(data):
    """An entropy of 0.60 to 0.61 on the boundary is published for boxes of 6, on a finer grid."""
    assert (data.fate.values == 0).all() and data.sizes["number"] == 2
    assert 0.59 < float(data.boundary_entropy) < 0.61
    assert bool(data.boundary_fractal) and 0.5 < float(data.boundary_excess) < 0.9
    own = wj.fractals.basin_entropy(data.attractor.values, 6)
    assert (own.value, own.boundary) == (float(data.basin_entropy), float(data.boundary_entropy))
    assert data.region_attractor.values.tolist() == [0, 1] and not data.region.values.any()
    assert data.edge_attractors.values.tolist() == [[0, 1]]
    check_dataset(data, "boundary")


def test_the_answer_and_the_picture_name_attractors(data):
    answer = summarise_boundary(data)
    assert answer["regions"] == ["attractor 0", "attractor 1"]
    assert answer["edges"][0]["regions"] == answer["regions"]
    text = "\n".join(boundary_in_words(TURN, answer))
    assert "attractor 0 / attractor 1" in text and "or more: fractal" in text
    assert "No boundary" not in text and "(between" not in text
    axes = figures.boundary(data)
    legends = [one for one in axes.get_children() if isinstance(one, Legend)]
    words = [text.get_text() for legend in legends for text in legend.get_texts()]
    assert any(one.startswith("attractor 0 / attractor 1") for one in words)


@pytest.mark.filterwarnings("ignore::walker_jax.checks.NoKernelWarning")  # of complex numbers
def test_three_attractors_and_a_failure_are_four_regions():
    """z -> the Newton step for z^3 = 1, which is not feasible near the origin."""

    def step(x):
        z = jax.lax.complex(x[0], x[1])
        z = z - (z**3 - 1) / (3 * z**2)
        return jnp.stack([z.real, z.imag])

    system = wj.Map(step, ("x", "y"), feasible=lambda x: x[0] ** 2 + x[1] ** 2 - 0.01)
    grid = wj.Grid.plain(x=(-1.5, 1.5, 32), y=(-1.4, 1.5, 32))
    data = wj.basin(system, grid, "direct")
    label = label_regions(system, grid, data)
    walks = data.attractor.values >= 0
    np.testing.assert_array_equal(walks, data.fate.values == 0)  # those that fail come to none
    roots = np.exp(2j * np.pi * np.arange(3) / 3)
    states = data.states.values[:, 0] @ [1, 1j]
    np.testing.assert_allclose(np.sort_complex(states), np.sort_complex(roots), atol=1e-9)
    assert len(np.unique(label[walks])) == 3 and (label[~walks] < label[walks].min()).all()
    beginning = np.hypot(*grid.centres(np.arange(grid.size)).T) < 0.1
    assert (label.ravel()[beginning] == -1).all()  # no feasible start


CUBIC = wj.Map(lambda x: jnp.stack([1.5 * x[0] - x[0] ** 3, 0.3 * x[1]]), ("x", "y"))
"""The stable manifold of its saddle is x = 0, between two fixed points."""


def test_a_start_on_the_boundary_itself_is_in_no_region():
    """A column of starts on the stable manifold of a saddle is no third region."""
    grid = wj.Grid.plain(x=(-1.4, 1.4, 41), y=(-1, 1, 12))
    label = label_regions(CUBIC, grid, wj.basin(CUBIC, grid, "direct"))
    assert (label[20] == -1).all() and (np.delete(label, 20, axis=0) >= 0).all()


def test_the_manifold_of_a_saddle_is_kept_with_its_edge(monkeypatch):
    begin = partial(wj.stable_manifold, points=20)
    monkeypatch.setattr("walker_jax.stability.boundaries.stable_manifold", begin)
    state = wj.edge_state(CUBIC, [-0.05, 0.1], [0.06, 0.1])
    other = state._replace(kind="", saddle=None)
    found = edge_arrays(CUBIC, [(0, 1), (0, 1)], [state, other], None, False)
    assert found["edge_kind"].tolist() == ["saddle", ""]
    assert found["edge_period"].tolist() == [1, 0]
    np.testing.assert_allclose(found["edge_saddle"][0, 0], 0, atol=1e-9)
    np.testing.assert_allclose(found["edge_multipliers"][0, :, 0], [1.5, 0.3], atol=1e-9)
    curves = found["stable_manifold"]
    assert curves.shape == (2, 2, 20, 2) and np.isnan(curves[1]).all()
    np.testing.assert_allclose(curves[0, ..., 0], 0, atol=1e-9)
    assert np.ptp(curves[0, ..., 1]) > 0.01


@pytest.mark.slow
def test_the_boundary_of_two_points_is_a_straight_manifold(monkeypatch):
    begin = partial(wj.stable_manifold, points=20)
    monkeypatch.setattr("walker_jax.stability.boundaries.stable_manifold", begin)
    even = wj.boundary(CUBIC, wj.Grid.plain(x=(-1.4, 1.4, 24), y=(-1, 1, 8)))
    assert not even.boundary_fractal and even.edge_kind.values.tolist() == ["saddle"]
    np.testing.assert_allclose(even.edge_saddle.values[0, 0], 0, atol=1e-9)
    np.testing.assert_allclose(even.edge_multipliers.values[0, :, 0], [1.5, 0.3], atol=1e-9)
    assert even.stable_manifold.shape == (1, 2, 20, 2)
    np.testing.assert_allclose(even.stable_manifold.values[..., 0], 0, atol=1e-9)


def test_checks_of_refined_cells_find_tails_of_attractors():
    """A strip of one basin in another, between the centres of all coarse cells."""

    def to_side(x):
        inside = (x[0] < 0.5) | (jnp.abs(x[1] - 0.5) < 0.02)
        return jnp.stack([jnp.where(inside, 0.25, 0.75), jnp.where(inside, 0.5, 0.25)])

    system, grid = wj.Map(to_side, ("x", "y")), wj.Grid.plain(x=(0, 1, 4), y=(0, 1, 4))
    found = wj.refine(system, grid, 3, check=2000)
    assert found.period.values.tolist() == [1, 1]
    assert float(found.area[0]) == pytest.approx(0.52, abs=0.01)
    without = wj.refine(system, grid, 3, check=0)
    assert float(without.area[0]) < 0.51
