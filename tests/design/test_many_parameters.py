"""Objectives by whole leaves: on discs whose area, multiplier and gait are known in closed form."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discs import COUNT, MIX, area, disc, parts
from networks import NetworkWalker, pushed

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.gaits.derivatives import GaitPull, gait_derivatives
from walker_jax.stability import margin_changes
from walker_jax.stability.margin_changes import margins_with_derivatives
from walker_jax.walkers.choices import numbers_chosen, values_of
from walker_jax.walkers.parameters import with_values

WEIGHTS = np.random.default_rng(1).uniform(-0.5, 0.5, COUNT)
DISC = disc(WEIGHTS)
GRID = wj.Grid.plain(x=(-1.5, 1.5, 40), y=(-1.5, 1.5, 44))
NAMES = tuple(f"w[{i}]" for i in range(COUNT))


def test_numbers_are_chosen_by_names_and_functions():
    walker = NetworkWalker(0.009)
    first = [f"policy.layers[0].weight[{i}, {j}]" for i in range(4) for j in range(2)]
    assert numbers_chosen(walker, lambda one: one.policy.layers[0].weight) == tuple(first)
    assert numbers_chosen(walker, "policy.layers[0].weight") == tuple(first)
    assert numbers_chosen(walker, ["slope", first[3]]) == ("slope", first[3])
    every = numbers_chosen(walker, "policy")
    assert every[:8] == tuple(first) and len(every) == 17
    several = lambda one: (one.slope, one.policy.layers[1])
    assert numbers_chosen(walker, several) == ("slope", *every[12:])
    assert numbers_chosen(DISC, lambda one: one.w) == numbers_chosen(DISC, "w") == NAMES
    machine = pushed()  # whose `order` is of integers
    assert numbers_chosen(machine, ["force", "pulls"])[0] == "force.gain".replace(
        ".gain", '["gain"]'
    )
    with pytest.raises(WrongUse, match="parameter must be one of the walker's"):
        numbers_chosen(machine, "order")
    with pytest.raises(WrongUse, match="parameter must be one of the walker's, slope"):
        numbers_chosen(walker, "polic")
    for where in (lambda one: one.gains, lambda one: 3.5):
        with pytest.raises(
            WrongUse, match="parameters must return leaves of the walker, not raise"
        ):
            numbers_chosen(walker, where)
    with pytest.raises(WrongUse, match="parameters must return one leaf of the walker or more"):
        numbers_chosen(walker, lambda one: ())


def test_numbers_are_put_back_where_they_were_taken():
    walker = NetworkWalker(0.009)
    names = numbers_chosen(walker, lambda one: (one.policy, one.slope))
    changed = with_values(walker, dict(zip(names, np.arange(18.0), strict=True)))
    assert values_of(changed, names).tolist() == np.arange(18.0).tolist()
    assert changed.policy.layers[0].weight.tolist() == np.arange(8.0).reshape(4, 2).tolist()
    traced = jax.jit(lambda x: with_values(walker, dict(zip(names, x, strict=True))))(
        np.arange(18.0)
    )
    for one, other in zip(*map(jax.tree.leaves, (changed, traced)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_area_by_all_weights():
    found = wj.measure(DISC, "area", lambda one: one.w, grid=GRID, levels=2, check=20_000)
    assert abs(found.value - area(WEIGHTS)) < 4 * found.value_error < 0.02 * found.value
    np.testing.assert_allclose(found.gradient, jax.grad(area)(WEIGHTS), rtol=0.01, atol=2e-3)
    assert not found.fractal.any() and found.lost == 0


def test_margins_in_reverse_equal_those_forward(monkeypatch):
    """And a central difference, over walks of different numbers of strides."""
    c, k, radius = parts(WEIGHTS)
    angles = np.linspace(0, 6, 7)
    out = np.linspace(1.001, 2.4, 7)[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
    x = np.asarray(c + radius * np.sqrt(1 - k) * out)
    made = np.array([stride_count(DISC, one) for one in x], np.int32)
    assert made[0] > 5 and made[-2] >= 1
    known, back = margins_with_derivatives(DISC, x, made, np.eye(2), NAMES, 1e-12)
    monkeypatch.setattr(margin_changes, "MANY", 1000)
    margins, forward = margins_with_derivatives(DISC, x, made, np.eye(2), NAMES, 1e-12)
    np.testing.assert_allclose(margins, known, rtol=1e-12)
    assert len(np.unique(margins)) == len(x)
    np.testing.assert_allclose(back, forward, rtol=1e-11, atol=1e-16 * abs(forward).max())
    step = 1e-6 * MIX[3]
    ends = [
        margin_changes.margins_after(disc(WEIGHTS + one), x, made, 1e-12) for one in (-step, step)
    ]
    np.testing.assert_allclose(back[:, 2:] @ step, (ends[1] - ends[0]) / 2, rtol=1e-7)


def stride_count(walker, x):
    made = wj.walk(walker, x, 60)
    return int((made.outcomes != wj.Outcome.STRIDE).argmax())


def test_the_least_disturbance_moves_with_the_boundary_alone():
    """The gait moves with it, by weights of c: that cancels."""
    radius = lambda w: parts(w)[2] * jnp.sqrt(1 - parts(w)[1])
    found = wj.measure(DISC, "least-disturbance", "w", directions=360)
    assert found.value == pytest.approx(float(radius(WEIGHTS)), rel=1e-8)
    np.testing.assert_allclose(found.gradient, jax.grad(radius)(WEIGHTS), rtol=1e-5, atol=1e-8)


def test_a_gait_and_its_measures_by_all_weights():
    gait = wj.find_gait(DISC, parts(WEIGHTS)[0])
    by_multipliers = np.array([1.0 + 2j, 0.5])
    given = np.array([[0.3, -0.7]]), np.array([2.0]), by_multipliers
    pulled = GaitPull(DISC, gait, NAMES).pull(*given)
    changes = [gait_derivatives(DISC, gait, name) for name in NAMES]
    expected = [
        np.sum(given[0] * one.states) + np.real(by_multipliers @ one.multipliers) for one in changes
    ]
    np.testing.assert_allclose(pulled, expected, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(np.array([one.states[0] for one in changes]), MIX[:2].T, rtol=1e-10)
    radius = wj.measure(DISC, "spectral-radius", "w", gait)
    assert radius.value == pytest.approx(float(parts(WEIGHTS)[1]), rel=1e-12)
    np.testing.assert_allclose(radius.gradient, MIX[2], rtol=1e-10, atol=1e-15)


def test_areas_grow_by_minibatches(monkeypatch):
    """The area found is that of the weights found; known measurements are not made again."""
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    how: Any = {"grid": GRID, "levels": 2, "batch": 200, "rate": 0.1, "steps": 6}
    how |= {"parameters": "w", "progress": False}
    found = wj.optimise(DISC, None, "area", **how)
    before, after = (np.asarray(found[name]) for name in ("start", "optimum"))
    np.testing.assert_array_equal(before, WEIGHTS)
    assert np.abs(after - before).max() == pytest.approx(0.6, rel=0.05)  # six steps of Adam
    for name, w in (("exact_start", before), ("exact_optimum", after)):
        assert float(found[name]) == pytest.approx(
            float(area(w)), abs=4 * float(found[f"{name}_error"])
        )
    assert area(after) > 1.3 * area(before)
    assert int((found.stage == 0).sum()) == 7
    kept = []
    again = wj.optimise(DISC, None, "area", known=found, keep=kept.append, **how)
    np.testing.assert_array_equal(again["optimum"], after)
    assert not kept


def score(machine, gait):
    """A paraboloid over the gait's place and the weights, with one maximum."""
    return -jnp.sum((gait.states[0] - 0.3) ** 2) - 0.01 * jnp.sum((machine.w - WEIGHTS) ** 2)


def best_weights():
    """Where the gradient of `score` is zero."""
    mix = MIX[:2]
    c = np.asarray(parts(WEIGHTS)[0])
    change = np.linalg.solve(mix.T @ mix + 0.01 * np.eye(COUNT), mix.T @ (0.3 - c))
    return WEIGHTS + change


def test_a_function_of_the_gait_is_maximised_by_many_weights():
    how: Any = {"steps": 40, "rate": 0.05, "progress": False}
    found = wj.optimise(DISC, None, score, parameters=lambda one: one.w, **how)
    gait = wj.find_gait(disc(best_weights()), [0.2, 0.2])
    best = float(score(disc(best_weights()), gait))
    start = float(found["objective_start"])
    assert float(found["objective_optimum"]) == pytest.approx(best, abs=0.01 * (best - start))
    assert found.attrs["functions"]
    with pytest.raises(WrongUse, match="known must be of the same functions"):
        other = lambda machine, gait: score(machine, gait) + 1
        other.__name__ = "score"
        wj.optimise(DISC, None, other, parameters="w", known=found, progress=False)
