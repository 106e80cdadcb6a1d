"""The most probable fall: nearest points of boundaries, margins of disturbed strides, the law."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import walker_jax as wj
from walker_jax import Disturbance, Outcome, figures
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import WrongUse
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability import probable_falls
from walker_jax.stability.disturbed_falls import DisturbedWalks
from walker_jax.stability.gait_mapper import mapper_of_gait
from walker_jax.stability.nearest_points import NearestPoint, nearest_minima, solve_nearest
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.stability.rays import spread_directions
from walker_jax.walking.disturbed import follow_disturbed, follow_disturbed_margins

WALKER = wj.SimplestWalker(0.004)
"""On a steeper slope the boundary is fractal, and each search finds another edge."""
SPRING = wj.SpringWalker(0.01, 0.2)
ONE = np.array([1.0, 0.0, 0.0])


def nearest(fails, gradient, size):
    rays = np.concatenate([np.eye(size), -np.eye(size), spread_directions(size, 60)])
    rays, lengths = nearest_minima(fails, gradient, rays, 24)
    return solve_nearest(fails, gradient, rays[0], lengths[0])


@pytest.mark.parametrize("decay", [0.0, 0.6, -0.8])
def test_exit_of_an_autoregressive_process(decay):
    """x' = a x + w leaves x < d within n steps, with sum w^2 = d^2 / sum a^2k in the last one."""
    n, d = 5, 0.3
    powers = np.tril(decay ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)), dtype=float))
    fails = lambda w: (w @ powers.T > d).any(axis=1)
    gradient = lambda w: powers[np.argmax(w @ powers.T > d, axis=1)]
    found = nearest(fails, gradient, n)
    assert found.length**2 == pytest.approx(d**2 / np.sum(decay ** (2.0 * np.arange(n))), rel=1e-11)
    way = powers[-1] / np.linalg.norm(powers[-1])
    if decay:  # without memory all steps are alike
        np.testing.assert_allclose(found.ray, way, atol=1e-10)
    assert found.flatness == pytest.approx(1, abs=1e-6)
    assert found.residual < 1e-10


def test_flatness_is_that_of_curved_boundaries():
    bends = np.array([0.7, -0.4])
    height = lambda w: w[:, 0] - 1 - w[:, 1:] ** 2 @ bends / 2
    gradient = lambda w: np.concatenate([np.ones((len(w), 1)), -bends * w[:, 1:]], axis=1)
    found = nearest(lambda w: height(w) > 0, gradient, 3)
    assert found.length == pytest.approx(1, rel=1e-11)
    assert found.flatness == pytest.approx(np.prod(1 + bends), rel=1e-6)


def made_up_walks(*deviations: float) -> DisturbedWalks:
    mapper = Mapper(WALKER, [Attractor(np.zeros((1, 2)))], Integrator(1e-10), 10)
    return DisturbedWalks(mapper, np.zeros(4), np.array(deviations), 4, None)


def made_up_point(length, ray):
    return NearestPoint(np.array(ray, float), length, residual=0.0, flatness=1.0)


def test_a_longer_search_begins_with_the_shorter_sequence(monkeypatch):
    """One more stride without a disturbance comes before it or after it."""
    begun = []

    def search(fails, gradient, rays, count, known):
        begun.append((rays.tolist(), known))
        return rays, np.ones(len(rays))

    monkeypatch.setattr(probable_falls, "nearest_minima", search)
    monkeypatch.setattr(probable_falls, "solve_nearest", lambda *_: made_up_point(1.0, [1.0]))
    walks = made_up_walks(1.0, 0.0, 0.5)
    shorter = made_up_point(2.0, np.arange(1, 7) / np.sqrt(91))
    ray = shorter.ray.tolist()
    probable_falls.search(walks, shorter, 4, 12)
    (rays, (count, most)) = begun.pop()
    assert rays == [[0, 0, *ray], [*ray, 0, 0]]
    assert count == 2 and 2.0 < most < 2.2
    probable_falls.search(walks, made_up_point(2.0, [0.6, 0.8]), 2, 12)
    (rays, _) = begun.pop()
    assert rays[:2] == [[0, 0, 0.6, 0.8], [0.6, 0.8, 0, 0]] and len(rays) > 10


def test_actions_are_the_least_of_at_most_so_many_strides(monkeypatch):
    ends = lambda _, tried: SimpleNamespace(
        strides=np.zeros(len(tried), int), outcome=np.full(len(tried), Outcome.FORWARD)
    )
    monkeypatch.setattr(DisturbedWalks, "follow", ends)
    monkeypatch.setattr(DisturbedWalks, "falls", lambda _, ends: ends.strides == 0)
    found = [made_up_point(size, [1.0, 0.0, 0.0]) for size in (3.0, 4.0, 2.0, 2.5)]
    told = probable_falls.describe(made_up_walks(1.0, 0.0, 0.0), found, unit=0.5)
    assert told.actions.tolist() == [18.0, 18.0, 8.0, 8.0] and told.action == 8.0


@pytest.mark.slow
def test_margins_of_disturbed_strides_and_their_derivatives():
    mapper = mapper_of_gait(SPRING, None, 200, None)
    start = np.stack(SPRING.lift(jnp.asarray(mapper.attractors[0].states[0])))
    walks = DisturbedWalks(mapper, start, np.ones(3), 3, None)
    walker, integrator = walks.arrays()

    @jax.jit
    @jax.vmap
    def measure(row):
        given = walker, start, Disturbance(*row), integrator
        return follow_disturbed_margins(*given), follow_disturbed(*given)

    rows = np.array([[4e-3, 1e-3, 2e-3], [-5e-3, 2e-3, 1e-3], [1e-3, 1e-3, 0.2], [0.05, 0, 0]])
    found, plain = measure(rows)
    np.testing.assert_array_equal(found.stride.outcome, plain.outcome)
    assert [*plain.outcome] == [0, 0, Outcome.BACKWARD, Outcome.FORWARD]
    np.testing.assert_allclose(found.stride.state, plain.state, atol=1e-13)
    assert found.backward[2] < 0 < found.backward[0] and found.forward[3] < 0 < found.forward[0]
    none = np.zeros((2, 3, 3))
    slopes = walks.pull_back(np.concatenate([rows[2:, None], none], axis=1), np.zeros((2, 2)))
    assert not slopes[:, 1:].any()
    h = 1e-6
    moved = [rows[2:] + sign * h * np.eye(3)[:, None] for sign in (1, -1)]
    margins, _ = measure(np.concatenate(moved).reshape(-1, 3))
    for i, name in enumerate(("backward", "forward")):
        ahead, behind = np.asarray(getattr(margins, name)).reshape(2, 3, 2)[:, :, i]
        np.testing.assert_allclose(slopes[i, 0], (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("step", [1e-17, -1e-17, 1e-100, -1e-300])
@pytest.mark.parametrize(
    "walker",
    [
        WALKER,
        *(pytest.param(one, marks=pytest.mark.slow) for one in (SPRING, wj.RoundFootWalker(0.01))),
    ],
    ids=lambda one: type(one).__name__,
)
def test_a_step_within_rounding_is_as_good_as_none(walker, step):
    state = wj.find_gait(walker).states[0]
    rough = wj.walk(walker, state, 1, ground=np.array([step]))
    assert rough.outcomes[0] == Outcome.STRIDE
    even = wj.walk(walker, state, 1, ground=np.zeros(1))
    np.testing.assert_allclose(rough.states, even.states, atol=1e-12)


SHORT: Any = {"strides": 2, "directions": 12}


@pytest.fixture(scope="module")
def fall():
    return wj.most_probable_fall(WALKER, **SHORT)


def test_the_least_sequence_topples_and_shorter_ones_do_not(fall):
    assert fall.residual < 1e-10 and (np.diff(fall.actions) < 0).all()
    assert fall.action == pytest.approx(np.sum(fall.disturbances**2) / 2, rel=1e-12)
    assert fall.states.shape == (fall.strides + 1, 4) and np.isfinite(fall.states).all()
    x, n = wj.find_gait(WALKER).states[0], fall.strides + 1
    for share, outcome in ((1 + 1e-8, fall.outcome), (0.99, Outcome.STRIDE)):
        steps = share * np.append(fall.disturbances[:, 0], np.zeros(n))[:n]
        outcomes = np.asarray(wj.walk(WALKER, x, n, ground=steps).outcomes)
        assert outcomes[-1] == outcome and (outcomes[:-1] == Outcome.STRIDE).all()
    mapper = mapper_of_gait(WALKER, None, 200, None)
    start = np.asarray(fall.states[0])
    walks = DisturbedWalks(mapper, start, ONE, SHORT["strides"], None)
    rays = np.random.default_rng(0).normal(size=(5000, SHORT["strides"]))
    rays *= 0.99 * np.sqrt(2 * fall.action) / np.linalg.norm(rays, axis=1, keepdims=True)
    assert not walks.fails(rays).any()
    assert walks.fails(fall.disturbances[:, 0][None] * (1 + 1e-8)).all()


def test_the_action_changes_with_the_slope(fall):
    """By differences of actions that are searched for anew."""
    found = wj.measure(WALKER, "fall-action", ["slope"], **SHORT)
    assert found.value == pytest.approx(fall.action, rel=1e-12)
    step = 1e-3 * 0.004
    low, high = (
        wj.most_probable_fall(wj.SimplestWalker(0.004 + side), **SHORT).action
        for side in (-step, step)
    )
    assert found.gradient[0] == pytest.approx((high - low) / (2 * step), rel=1e-4)
    assert np.shape(wj.measure(WALKER, "fall-action", (), **SHORT).gradient) == (0,)


def test_the_law_is_that_of_a_half_space_that_bends(fall):
    scale = np.sqrt(fall.action / 20)
    chance = norm.sf(np.sqrt(40)) / np.sqrt(fall.flatness)
    assert fall.mean_strides(scale) == pytest.approx(1 / chance, rel=1e-10)
    assert fall.mean_strides(1e-9) == np.inf
    with pytest.raises(WrongUse, match="scale must be a number above 0, not 0"):
        fall.mean_strides(0.0)


def test_the_picture_has_the_sequence_the_path_and_the_law(fall):
    figure = figures.probable_fall(fall)
    sequence, actions, path, law = figure.axes
    bars: Any = sequence.patches
    np.testing.assert_allclose([bar.get_height() for bar in bars], fall.disturbances[:, 0])
    np.testing.assert_allclose(np.asarray(actions.lines[0].get_ydata()), fall.actions)
    assert path.get_xlabel() and law.get_yscale() == "log"
    assert not figures.probable_fall(fall, title=False).get_suptitle()
    named = figures.probable_fall(fall, WALKER).get_suptitle()
    assert named.startswith("SimplestWalker, slope 0.004 rad\n")
    assert sequence.get_ylabel() == "height of the step (l)"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"ground": -1.0}, "ground must be a standard deviation above 0, or three, not -1.0"),
        ({"ground": Disturbance()}, "ground must be a standard deviation above 0, or three"),
        ({"strides": 33}, "strides must be at most 32, not 33"),
        ({"outcome": Outcome.STRIDE}, "outcome must be a failure, not STRIDE"),
    ],
)
def test_wrong_arguments_are_refused(given: Any, message):
    with pytest.raises(ValueError, match=message):
        wj.most_probable_fall(WALKER, **given)
    if "outcome" in given:
        steep = wj.SimplestWalker(0.017)
        twice = wj.find_gait(steep, [[0.2254, -0.2255], [0.2498, -0.2431]], period=2)
        with pytest.raises(ValueError, match="gait must be of period one, not 2"):
            wj.most_probable_fall(steep, gait=twice)


def test_a_thin_finger_that_is_known_is_kept():
    """A failure where the shorter sequence fails, though the scan of the ray steps over it."""
    inside = lambda w: (w[:, 0] > 0.653) & (w[:, 0] < 0.65301)
    fails = lambda w: inside(w) | (w[:, 0] > 3)
    gradient = lambda w: np.tile([1.0, 0.0], (len(w), 1))
    rays = np.array([[1.0, 0.0]])
    _, lengths = nearest_minima(fails, gradient, rays, 4)
    assert lengths[0] == pytest.approx(3, rel=1e-4)
    _, lengths = nearest_minima(fails, gradient, rays, 4, (1, 0.653 * (1 + 1e-9)))
    assert lengths[0] == pytest.approx(0.653, rel=1e-4)


def test_falls_rarer_than_a_float_holds_have_a_logarithm():
    nothing = np.zeros((1, 3))
    fall = ProbableFall(900.0, nothing, nothing, Outcome.FORWARD, 1, np.ones(1), 1.0, 0.0)
    assert fall.mean_strides() == np.inf
    assert fall.log_mean_strides() == pytest.approx(900, abs=6)
    unknown = fall._replace(flatness=np.nan)
    assert np.isnan(unknown.mean_strides()) and np.isnan(fall._replace(flatness=-1).mean_strides())


@pytest.mark.slow
@pytest.mark.parametrize("ground", [Disturbance(push=1.0), Disturbance(step=1.0, push=3.0)])
def test_pushes_and_the_law_against_walks(ground):
    fall = wj.most_probable_fall(SPRING, ground, strides=8)
    scale = float(np.sqrt(fall.action / 4.5))
    draw = lambda key: Disturbance(
        *(
            scale * one * jax.random.normal(jax.random.fold_in(key, i))
            for i, one in enumerate(ground)
        )
    )
    walked = wj.steps_to_fall(SPRING, draw, 400)
    assert fall.residual < 1e-8
    assert fall.mean_strides(scale) == pytest.approx(walked.mean, rel=0.5)


@pytest.mark.slow
def test_backward_falls_take_more_than_others(fall):
    backward = wj.most_probable_fall(WALKER, strides=2, outcome=Outcome.BACKWARD)
    assert backward.outcome == Outcome.BACKWARD and backward.action > fall.actions[1]
