"""Policies for each objective, as walkers like any other, on rough ground too."""

import copy
import heapq
import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Disturbance, Outcome
from walker_jax.control.actions import Actions
from walker_jax.control.least_effort import effort_of, find_least_effort
from walker_jax.control.longest_walks import (
    NODES,
    Spread,
    choose_nodes,
    corners,
    find_longest,
    improve,
    transitions,
)
from walker_jax.control.policies import integrator_for
from walker_jax.controlled_maps import Points
from walker_jax.stability.rough_ground import NormalSteps, read_ground

WALKER = wj.PoweredWalker(0.004)
GRID = wj.Grid.sheared(theta=(0.05, 0.45, 80), sum=(-0.06, 0.01, 50))
PUSHES = {"push_off": (0.0, 0.1, 11)}
GROUND = 5e-4


@pytest.fixture(scope="module")
def data():
    return wj.viable(WALKER, GRID, PUSHES, bounds=False)


@pytest.fixture(scope="module")
def steady(data):
    """The policy of the longest walks."""
    return wj.Policy(WALKER, data, "steps-to-fall", ground=GROUND)


def push_of(walker: Any, x):
    """The push-off that a policy chooses."""
    return walker.during_stride(x).push_off


# Least effort


def test_ways_of_least_effort_are_those_of_a_plain_search():
    """By Dijkstra's search from the target back; some strides take no effort at all."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        n, m = 80, 4
        image = rng.integers(0, n, (n, m)).astype(np.int32)
        image[rng.random((n, m)) < 0.4] = n + 1
        effort = np.array([0.0, 0.1, 0.5, 1.0])
        target = np.arange(n) < 4
        action, total = find_least_effort(Points(image), target, effort)
        expected = np.where(target, 0.0, np.inf)
        queue: list[Any] = [(0.0, cell) for cell in range(4)]
        while queue:
            least, cell = heapq.heappop(queue)
            for start, number in zip(*np.nonzero(image == cell), strict=True):
                if least + effort[number] < expected[start]:
                    expected[start] = least + effort[number]
                    heapq.heappush(queue, (expected[start], start))
        np.testing.assert_allclose(total, expected, atol=1e-12)
        assert np.array_equal(action >= 0, np.isfinite(expected) & ~target)
        for start in np.flatnonzero(action >= 0):
            cell, spent, made = start, 0.0, 0
            while not target[cell]:
                spent, made = spent + effort[action[cell]], made + 1
                cell = image[cell, action[cell]]
                assert made <= n
            assert spent == pytest.approx(total[start])


def test_effort_is_counted_from_the_walkers_own_values():
    walker = wj.PoweredWalker(0.004, hip_stiffness=2.0, push_off=0.02)
    actions = Actions(
        ("push_off", "hip_angle"), np.array([[0.0, -0.4], [0.1, 0.0], [0.02, 0.0]]), 2
    )
    np.testing.assert_allclose(effort_of(walker, actions), [0.04 + 1, 0.64, 0.0], atol=1e-15)


@pytest.mark.slow
def test_the_policy_of_least_effort_spends_less(data):
    policies: list[Any] = [wj.Policy(WALKER, data), wj.Policy(WALKER, data, "least-effort")]
    captured = np.flatnonzero(data["capture"].values.ravel() > 0)
    starts = GRID.centres(captured)
    spent, reached = np.zeros((2, len(starts))), np.zeros((2, len(starts)), bool)
    for one, walker in enumerate(policies):
        x = starts
        for _ in range(12):
            push = jax.vmap(lambda x, walker=walker: push_of(walker, x))(x)
            x = wj.strides(walker, x).state
            spent[one] += np.where(np.isfinite(x[:, 0]), push, 0) ** 2
        reached[one] = np.isfinite(x[:, 0])
    both = reached.all(axis=0)
    assert both.mean() > 0.6 and reached[1].sum() > 0.95 * reached[0].sum()
    assert spent[1, both].mean() < 0.8 * spent[0, both].mean()


# The longest walks


@pytest.mark.parametrize("size", [1, 3])
def test_a_few_disturbances_stand_for_all(size):
    """Their moments, and how likely the large ones are."""
    by = jnp.array([1e-3, 2e-3, 5e-3])[:size]
    ground = lambda key: Disturbance(*(by * jax.random.normal(key, (size,), float)))
    nodes = choose_nodes(read_ground(ground))
    values = nodes.values[:, :size] / by
    assert len(values) == NODES * size**2 and nodes.weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(nodes.weights @ values, 0, atol=0.02)
    np.testing.assert_allclose(nodes.weights @ values**2, 1, atol=0.02)
    assert np.abs(values).max() > 3.5 and nodes.weights.min() < 1e-3
    assert (nodes.values[:, size:] == 0).all()
    alone = choose_nodes(lambda key: 0.002)
    np.testing.assert_allclose(alone.values, [[0.002, 0, 0]], atol=1e-15)
    assert alone.weights.tolist() == [1.0]


def test_corners_share_a_place_and_leave_out_those_off_the_grid():
    at, share = corners(np.array([[1.5, 0.75], [2.0, 1.5], [0.25, 0.5], [np.nan, 1.0]]), (3, 2))
    total = {}
    for row, (cells, parts) in enumerate(zip(at, share, strict=True)):
        for cell, part in zip(cells, parts, strict=True):
            total[row, cell] = total.get((row, cell), 0) + part
    kept = {key: value for key, value in total.items() if value}
    assert kept == {(0, 2): 0.75, (0, 3): 0.25, (1, 3): 0.5, (1, 5): 0.5, (2, 0): 0.75}


def test_the_best_actions_are_those_of_a_plain_value_iteration():
    """On a made-up map of one dimension, whose disturbances lead to one of three places."""
    rng = np.random.default_rng(2)
    n, m, weights = 12, 3, np.array([0.5, 0.3, 0.2])
    place = rng.uniform(-1, n + 1, (n, m, 3, 1))
    place[rng.random((n, m, 3)) < 0.1] = np.nan
    spread = Spread(np.arange(n), place, weights, (n,))
    value, action = np.zeros(n), np.zeros(n, np.int32)
    for _ in range(30):
        action = improve(spread, value, action)
        chain = transitions(spread, action).toarray()
        value = np.linalg.solve(np.eye(n) - chain, chain.sum(axis=1))
    plain = np.zeros(n)
    middle = np.arange(n) + 0.5
    for _ in range(4000):
        lasting = lambda u, plain=plain: np.interp(
            u, [-0.5, *middle, n + 0.5], [0, *(1 + plain), 0], left=0, right=0
        )
        ends = np.where(np.isnan(place[..., 0]), -9.0, place[..., 0])
        plain = (lasting(ends) @ weights).max(axis=1)
    np.testing.assert_allclose(value, plain, rtol=1e-8)
    assert len({*action}) > 1 and value.max() > 3


@pytest.mark.slow
def test_walks_last_a_hundred_times_as_long_as_passive_ones(steady):
    """With other random numbers than those that made the policy, from the passive gait."""
    key, gait = jax.random.key(11), wj.find_gait(WALKER)
    passive = wj.steps_to_fall(WALKER, GROUND, 1000, key, gait=gait)
    lasting = wj.steps_to_fall(steady, GROUND, 100, key, gait=gait, limit=640)
    assert passive.high < 8
    assert lasting.low > 100 * passive.high


@pytest.mark.slow
def test_the_value_is_about_how_long_walks_last(data):
    """Where walks are as short that the horizon is beyond them; cells blur it, by a third here."""
    actions = Actions(("push_off",), data["push_off"].values[:, None], 0)
    kernel = data["viable"].values.ravel()
    uneven = 2e-3
    nodes = choose_nodes(NormalSteps(uneven))
    found = find_longest(WALKER, GRID, actions, kernel, nodes, integrator_for(data))
    action, value = found
    assert np.array_equal(action >= 0, kernel) and (value[~kernel] == 0).all()
    start = GRID.centre(int(value.argmax()))
    there = wj.find_gait(WALKER)._replace(states=start[None])
    steered = wj.Policy(WALKER, data, "steps-to-fall", ground=uneven)
    walks = wj.steps_to_fall(steered, uneven, 1000, jax.random.key(5), gait=there)
    assert value.max() / 1.5 < walks.mean < 1.5 * value.max()


@pytest.mark.slow
def test_a_policy_of_a_walker_is_a_walker(steady):
    assert isinstance(steady, type(WALKER)) and steady.label() == "SteeredPoweredWalker"
    heights = np.array([3e-4, -5e-4, 2e-4])
    state: Any = jnp.array([0.31, -0.32])
    made = wj.walk(steady, state, 3, ground=heights)
    for number, height in enumerate(heights):
        push = push_of(steady, state if state.shape == (2,) else state[::2])
        assert 0 < push < 0.1
        result = wj.stride(wj.PoweredWalker(0.004, push_off=push), state, step=height)
        np.testing.assert_allclose(made.states[number + 1], result.state, rtol=0, atol=1e-11)
        state = result.state
    assert (made.outcomes == Outcome.STRIDE).all()


def test_a_policy_keeps_the_feedback_of_its_walker(data):
    own = wj.Feedback(WALKER, [0.2, -0.2], {"push_off": [0.1, 0.2]}, {"push_off": (0.0, 0.3)})
    x = jnp.asarray(GRID.centre(int(np.flatnonzero(data["capture"].values.ravel() > 0)[7])))
    push, both = (push_of(wj.Policy(one, data), x) for one in (WALKER, own))
    away = x - jnp.array([0.2, -0.2])
    expected = jnp.clip(push + 0.1 * away[0] + 0.2 * away[1], 0, 0.3)
    np.testing.assert_allclose(both, expected, rtol=0, atol=1e-15)


def test_a_policy_is_made_anew_of_its_parts(data):
    steered = wj.Policy(WALKER, data)
    sent = pickle.loads(pickle.dumps(steered))
    assert type(sent) is type(steered)
    x = np.array([0.25, -0.27])
    np.testing.assert_array_equal(wj.stride(sent, x).state, wj.stride(steered, x).state)


def test_policies_of_maps_are_copied_and_axes_in_any_order(data):
    x = np.array([0.25, -0.27])
    turned = wj.Policy(WALKER, data.transpose("sum", "theta", ...))
    np.testing.assert_array_equal(
        wj.stride(turned, x).state, wj.stride(wj.Policy(WALKER, data), x).state
    )
    henon, grid = wj.systems.HenonMap(), wj.Grid.plain(x=(-2, 2, 20), y=(-2, 2, 20))
    steered = wj.Policy(henon, wj.viable(henon, grid, {"a": [1.3, 1.4]}, bounds=False))
    again = copy.deepcopy(steered)
    found, expected = (wj.stride(one, jnp.asarray(x)).state for one in (again, steered))
    np.testing.assert_array_equal(found, expected)
    with pytest.raises(ValueError, match="without a policy, not a Steered"):
        wj.Policy(steered, data)


@pytest.mark.slow
def test_a_policy_of_a_runner_begins_where_its_action_can():
    """A flatter leg lands from lower apexes: the basin is the kernel, on the cells' own terms."""
    runner, grid = wj.systems.SpringMassRunner(), wj.Grid.plain(apex=(0.7, 2.2, 300))
    data = wj.viable(runner, grid, {"angle": (0.8, 1.5, 71)}, bounds=False)
    steered = wj.Policy(runner, data)
    kernel = data["viable"].values
    low = np.flatnonzero(kernel)[:40]
    starts = jnp.asarray(grid.centres(low))
    assert not jax.vmap(runner.feasible)(starts).any()
    assert jax.vmap(steered.feasible)(starts).all()
    followed = wj.basin(steered, grid, "direct")["attractor"].values >= 0
    assert (followed & kernel).sum() > 0.98 * kernel.sum()
