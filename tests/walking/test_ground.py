"""A step up or down is the same modes with their ground moved."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.execution.tiles import map_cells
from walker_jax.hybrid.graphs import check_graph
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.hybrid_system import failures_by_name, has_ground
from walker_jax.walkers.ground import LOWER
from walker_jax.walking.disturbed import Disturbance, follow_disturbed, follow_disturbed_margins
from walker_jax.walking.stride import follow_stride

INTEGRATOR = Integrator(np.float64(1e-12))
WALKER = wj.SimplestWalker(0.004)
X = jnp.array([0.2, -0.2])


@pytest.mark.parametrize("walker", [WALKER, wj.KneedWalker(0.05)])
def test_the_modes_on_a_step_are_a_graph(walker):
    """Those of level ground, and one more for a foot on its way to lower ground."""
    modes = walker.modes_on(jnp.asarray(0.01))
    assert [*modes] == [*walker.modes(), LOWER]
    check_graph(walker.label(), modes, {*failures_by_name(walker)})
    assert [one.leads_to for one in modes["swing"].guards[-2:]] == [LOWER, "section"]
    assert has_ground(walker) and not has_ground(wj.systems.SpringMassRunner())
    assert not has_ground(wj.SpatialWalker()) and not has_ground(wj.systems.HenonMap())


def test_a_stride_is_smooth_as_a_step_up_turns_into_one_down():
    """Its derivative by the step at 0, where no swing is left below the level, is the limit."""

    def ends(step):
        made = follow_stride(WALKER, X, INTEGRATOR, step)
        return jnp.append(made.state, made.time)

    zero, width = jnp.asarray(0.0), 1e-5
    sides = [(ends(jnp.asarray(s * width)) - ends(zero)) / (s * width) for s in (-1, 1)]
    slope = jax.jit(jax.jacfwd(ends))(zero)
    np.testing.assert_allclose(slope, (sides[0] + sides[1]) / 2, rtol=2e-7, atol=1e-8)
    np.testing.assert_allclose(sides[0], sides[1], rtol=2e-3)


def test_the_foot_is_on_the_ground_of_the_step():
    """Of the feet at a heel strike, the new one is higher by the step: l cos by the geometry."""
    steps = np.array([0.02, 1e-9, 0.0, -1e-9, -0.02, -0.1])
    made = map_cells(
        follow_stride,
        (jax.tree.map(np.asarray, WALKER), np.tile(X, (6, 1)), INTEGRATOR, steps),
        (False, True, False, True),
    )
    assert (made.outcome == wj.Outcome.STRIDE).all()
    theta, phi = made.state[:, 0], made.state[:, 1]
    height = np.cos(theta - phi) - np.cos(theta)  # of the new stance foot above the other
    np.testing.assert_allclose(height, steps, rtol=0, atol=1e-13)


def test_margins_on_a_step_of_nothing_are_those_of_a_stride():
    """The strides are launched in full states, as `margins` takes them too, and many fail."""
    walker = jax.tree.map(np.asarray, WALKER)
    rng = np.random.default_rng(1)
    xs = rng.uniform([0.1, -0.3], [0.3, -0.05], (300, 2))
    full = np.stack([np.asarray(jnp.stack(WALKER.lift(x))) for x in jnp.asarray(xs)])
    zeros: Any = np.zeros((3, len(xs)))
    none = Disturbance(*zeros)
    arguments = walker, full, none, INTEGRATOR
    found = map_cells(follow_disturbed_margins, arguments, (False, True, True, False))
    level = wj.margins(WALKER, full)
    assert {0, 1, 2} <= set(level.stride.outcome.tolist())
    np.testing.assert_allclose(found.failed, level.failed, rtol=0, atol=1e-13)
    for name, values in found.by_name.items():
        np.testing.assert_allclose(values, level.by_name[name], rtol=0, atol=1e-13)


@pytest.mark.slow
def test_margins_on_ground_a_little_lower_are_those_on_level():
    """On round feet many fall with the swing foot below the level all the time."""
    walker = jax.tree.map(np.asarray, wj.RoundFootWalker(0.01))
    rng = np.random.default_rng(1)
    xs = rng.uniform([0.05, -0.4, -0.1], [0.25, -0.15, 0.0], (300, 3))
    full = np.stack([np.asarray(jnp.stack(walker.lift(x))) for x in jnp.asarray(xs)])
    lower: Any = np.full(300, -1e-9), np.zeros(300), np.zeros(300)
    arguments = walker, full, Disturbance(*lower), INTEGRATOR
    found = map_cells(follow_disturbed_margins, arguments, (False, True, True, False))
    level = wj.margins(walker, full)
    np.testing.assert_array_equal(found.stride.outcome, level.stride.outcome)
    assert np.bincount(level.stride.outcome)[1:3].min() > 30
    np.testing.assert_allclose(found.failed, level.failed, rtol=0, atol=1e-7)


def test_a_measured_stride_ends_as_the_stride_does():
    """From starts whose legs begin beside each other, where the margins' stride was another one."""
    starts = np.array(
        [
            [-6.68216929e-03, -1.33643386e-02, -4.51612894e-02, -4.03296834e-06],
            [-1.36285923e-02, -2.72571845e-02, -1.64717999e-01, -6.11851688e-05],
        ]
    )
    numbers: Any = (
        np.array([-6.944730189498899e-07, -0.6395406207542276]),
        np.array([0.003237958986053437, -0.00016367596032493295]),
        np.array([-0.00656633378059425, 0.0003955722506308007]),
    )
    disturbances = Disturbance(*numbers)
    walker = jax.tree.map(np.asarray, WALKER)
    arguments = walker, starts, disturbances, INTEGRATOR
    made = map_cells(follow_disturbed, arguments, (False, True, True, False))
    found = map_cells(follow_disturbed_margins, arguments, (False, True, True, False))
    np.testing.assert_array_equal(found.stride.outcome, made.outcome)
    np.testing.assert_allclose(found.stride.state, made.state, rtol=0, atol=1e-12)


def test_walks_on_rough_ground_are_strides_onto_steps():
    ground = np.array([0.004, -0.003, 0.0, -0.002])
    made = wj.walk(WALKER, X, 4, ground=ground)
    state = jnp.stack(WALKER.lift(X))
    for number, height in enumerate(ground):
        state = wj.stride(WALKER, state, step=height).state
        np.testing.assert_allclose(made.states[number + 1], state, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "system", [wj.systems.HenonMap(), wj.systems.SpringMassRunner(), wj.SpatialWalker()]
)
def test_systems_without_ground_are_told(system):
    name = type(system).__name__
    x = np.zeros(len(system.section)) + 0.9
    with pytest.raises(ValueError, match=f"walker must be planar, not a {name}"):
        wj.stride(system, x, step=0.1)
    with pytest.raises(ValueError, match=f"walker must be planar, not a {name}"):
        wj.walk(system, x, 2, ground=[0.0, 0.1])
