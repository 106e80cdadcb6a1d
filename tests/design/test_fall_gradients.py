"""The action of the most probable fall changes as its derivative says; by the slope alone, see
test_probable_falls."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from networks import NetworkWalker

import walker_jax as wj
from walker_jax.integrators.integrator import integrator_of
from walker_jax.kernels import transposes
from walker_jax.stability.disturbed_falls import pull_walks
from walker_jax.systems.trees import in_dtype
from walker_jax.walkers.choices import numbers_chosen
from walker_jax.walking.disturbed import follow_disturbed_walk


@pytest.fixture
def strict():
    """JAX's options to find faults, which this long computation passes too."""
    with jax.debug_nans(True), jax.numpy_rank_promotion("raise"):
        yield


SPRING = wj.SpringWalker, {"slope": 0.004, "hip_stiffness": 0.5}


@pytest.mark.slow
@pytest.mark.usefixtures("strict")
@pytest.mark.parametrize(
    ("kind", "values", "strides"),
    [(wj.SimplestWalker, {"slope": 0.004}, 1), (*SPRING, 1), (*SPRING, 3)],
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


@pytest.mark.slow
@pytest.mark.parametrize("strides", [1, 2])
def test_the_action_changes_with_all_weights_of_a_network(strides):
    """By a difference along a direction in which all change; the gait changes too.

    On a steeper slope, of 0.009, the boundary is fractal, and each search finds another edge.
    """
    how = {"strides": strides, "directions": 8 * strides**2}
    walker = NetworkWalker(0.004)
    weights, unravel = ravel_pytree(walker.policy)
    towards = np.random.default_rng(0).normal(size=weights.size)
    action = lambda step: (
        wj.most_probable_fall(
            NetworkWalker(0.004, policy=unravel(weights + step * jnp.asarray(towards))), **how
        ).action
    )
    found = wj.measure(walker, "fall-action", lambda one: one.policy, **how)
    assert found.gradient.shape == weights.shape
    names = numbers_chosen(walker, lambda one: one.policy)
    some = wj.measure(walker, "fall-action", names[3:5], **how)
    np.testing.assert_allclose(some.gradient, found.gradient[3:5], rtol=1e-8)
    by = (8 * (action(1e-3) - action(-1e-3)) - action(2e-3) + action(-2e-3)) / 12e-3
    assert by / found.value == pytest.approx(found.gradient @ towards / found.value, rel=1e-4)
    assert abs(by) > 0.01 * found.value


@pytest.mark.slow
def test_margins_of_disturbed_walks_by_their_adjoint(monkeypatch):
    """They are those of forward mode, whether the walk falls early, later or not at all."""
    walker = in_dtype(wj.SimplestWalker(0.009), np.float64, jnp.asarray)
    integrator = integrator_of(np.dtype(float), None).in_dtype(np.dtype(float))
    start = jnp.stack(walker.lift(jnp.asarray(wj.find_gait(walker).states[0])))
    rows = np.zeros((12, 5, 3))
    rows[:, 0, 0] = np.linspace(1e-4, 5e-3, 12)
    given = walker, start, jnp.asarray(rows), jnp.ones((12, 2)), integrator
    walks = [follow_disturbed_walk(walker, start, jnp.asarray(one), integrator) for one in rows]
    assert {int(walk.strides) for walk in walks} == {1, 2, 3, 5}
    found = []
    for fewest in (1, 10**9):  # the adjoint, and forward mode
        monkeypatch.setattr(transposes, "FEWEST_FOR_ADJOINT", fewest)
        jax.clear_caches()
        found.append(jax.tree.leaves(pull_walks(*given, leaves=("slope",))))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)
