"""Metrics of disturbances, the measures of the way back, tipping, and the boundary's data set."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.legend import Legend

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import WrongUse
from walker_jax.gaits.cycles import Gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.boundaries import curves_of, summarise_boundary, touching_cells
from walker_jax.stability.descents import nearest_failure
from walker_jax.stability.metric import metric_of
from walker_jax.stability.sampling import draw_from_ball, draw_starts
from walker_jax.stability.tipping import assemble_tipping
from walker_jax.systems.outcomes import OUTCOMES

WALKER = wj.SimplestWalker(0.004)
MATRIX = np.array([[2.0, 1.5], [1.5, 3.0]])
NORMAL = np.array([0.6, 0.8])
STATE = np.array([0.15, -0.16])


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(WALKER)


def quadratic(state, d):
    return jnp.sqrt(d @ jnp.asarray(MATRIX) @ d)


def squared(state, d):
    return d @ jnp.asarray(MATRIX) @ d


def largest(state, d):
    return jnp.max(jnp.abs(d))


def uneven(state, d):
    """A norm that depends on the state, and is that of no matrix."""
    return jnp.sum(jnp.abs(d) ** 3 / jnp.abs(jnp.asarray(state))) ** (1 / 3)


SLOW = pytest.mark.slow
METRICS = [
    MATRIX,
    *(pytest.param(one, marks=SLOW) for one in (uneven, quadratic, squared, largest)),
]


@pytest.mark.parametrize("metric", METRICS)
def test_the_nearest_point_of_a_half_plane_in_a_metric(metric):
    """Of all d with n d = c the smallest: c over the dual norm of n, in closed form."""
    sizes, c = metric_of(WALKER, None, None, metric), 0.003
    y = nearest_failure(
        lambda y: sizes.disturbance(STATE, y) @ NORMAL > c,
        sizes.basis,
        lambda y: sizes.pull_back(STATE, y, np.broadcast_to(NORMAL, y.shape)),
    )
    inverse = np.linalg.inv(MATRIX)
    dual = np.sqrt(NORMAL @ inverse @ NORMAL)
    ellipse = c * inverse @ NORMAL / dual**2
    if metric is largest:
        expected, nearest = c / np.abs(NORMAL).sum(), np.full(2, c / np.abs(NORMAL).sum())
    elif metric is uneven:  # by Hölder's inequality, with weights
        weights = np.abs(STATE) ** 0.5
        power = (NORMAL**1.5 * weights).sum()
        expected, nearest = c / power ** (2 / 3), c * np.sqrt(NORMAL) * weights / power
    else:
        expected, nearest = c / dual, ellipse
        expected = expected**2 if metric is squared else expected
    assert np.linalg.norm(y) == pytest.approx(expected, rel=1e-9)
    d = sizes.disturbance(STATE, y[None])[0]
    assert d @ NORMAL == pytest.approx(c, rel=1e-9)
    np.testing.assert_allclose(d, nearest, rtol=0, atol=2e-5 * c)
    assert sizes.size(STATE, STATE + d[None])[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("metric", [MATRIX, squared, uneven])
def test_gradients_are_pulled_back_as_differences_say(metric):
    sizes = metric_of(WALKER, None, None, metric)
    y = np.array([[0.002, -0.001], [0.0005, 0.003]])
    found = sizes.pull_back(STATE, y, np.broadcast_to(NORMAL, y.shape))
    for i in range(2):
        step = 1e-7 * np.eye(2)[i]
        high, low = (sizes.disturbance(STATE, y + sign * step) @ NORMAL for sign in (1, -1))
        np.testing.assert_allclose(found[:, i], (high - low) / 2e-7, rtol=1e-6)


def test_a_matrix_along_directions_and_refused_metrics():
    sizes = metric_of(WALKER, None, [[0.0, 1.0]], MATRIX)
    d = sizes.disturbance(STATE, sizes.basis)
    assert abs(d[0, 0]) < 1e-15 and d[0] @ MATRIX @ d[0] == pytest.approx(1)
    for wrong in (np.eye(3), -np.eye(2), [[1.0, 0.5], [0.4, 1.0]], np.full((2, 2), np.nan)):
        with pytest.raises(ValueError, match="metric must be a symmetric positive definite"):
            metric_of(WALKER, None, None, wrong)
    with pytest.raises(ValueError, match="scale and metric exclude each other"):
        metric_of(WALKER, [1.0, 1.0], None, MATRIX)
    falling = metric_of(WALKER, None, None, lambda state, d: 1 / (1 + jnp.sum(d**2)))
    with pytest.raises(wj.ComputationFailed, match="must grow from zero along every ray"):
        falling.disturbance(STATE, np.ones((3, 2)))
    assert falling.disturbance(STATE, np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.slow
def test_the_least_disturbance_in_a_metric_of_the_walker(gait):
    by_matrix, by_function = (
        wj.least_disturbance(WALKER, gait, metric=one) for one in (MATRIX, quadratic)
    )
    assert by_matrix.size == pytest.approx(by_function.size, rel=1e-8)
    np.testing.assert_allclose(by_matrix.state, by_function.state, rtol=0, atol=1e-9)
    d = by_matrix.state - np.asarray(gait.states[0])
    assert d @ MATRIX @ d == pytest.approx(by_matrix.size**2)
    np.testing.assert_allclose(by_matrix.direction, d / by_matrix.size, rtol=1e-12)
    plain = wj.least_disturbance(WALKER, gait, scale=[0.5, 2.0])
    scaled = wj.least_disturbance(WALKER, gait, metric=np.diag([4.0, 0.25]))
    assert plain.size == scaled.size
    np.testing.assert_array_equal(plain.state, scaled.state)


def test_disturbances_in_a_ball_of_a_matrix_have_its_moments():
    sizes = metric_of(WALKER, None, None, MATRIX)
    y = draw_from_ball(np.random.default_rng(0), 200_000, 2)
    d = sizes.disturbance(STATE, y)
    np.testing.assert_allclose(np.cov(d.T), np.linalg.inv(MATRIX) / 4, atol=2e-3)
    assert sizes.size(STATE, STATE + d).max() <= 1 + 1e-12


def test_the_way_back_is_that_of_walks_one_by_one(gait):
    """Of starts from a sampler, a ring of two distances about the gait, each walked on its own."""
    state = np.asarray(gait.states[0])
    ring = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(ring), np.sin(ring)], axis=1)
    starts = np.concatenate([state + 1e-4 * ring, state + 0.02 * ring])
    found = wj.basin_stability(
        WALKER, lambda rng, n: starts, gait, within=1e-5, horizon=8, samples=24, metric=MATRIX
    )
    walks = [np.asarray(wj.walk(WALKER, x, 60).states) for x in starts]
    near = [np.abs(one - state).max(axis=1) < 1e-5 for one in walks]
    made = np.array([one.argmax() if one.any() else np.inf for one in near])
    back = np.isfinite(made)
    assert 12 <= back.sum() < 24
    shock = np.sqrt(np.einsum("ni,ij,nj->n", starts - state, MATRIX, starts - state))
    assert found.value == back.mean() and found.in_time == (made <= 8).mean() > 0
    assert found.mean == pytest.approx(made[back].mean())
    assert found.pace == pytest.approx((made / shock)[back].mean())
    middle = np.sort((made / shock)[back])[(back.sum() + 1) // 2 - 1]
    assert found.median_pace == pytest.approx(middle)
    assert found.mean_shock == pytest.approx(shock[back].mean())
    assert found.largest_shock == pytest.approx(shock[back].max())
    # a ball from which all return: sizes have the moments of a disc
    disc = wj.basin_stability(WALKER, 1e-3, gait, samples=4000)
    assert disc.value == 1 and disc.mean_shock == pytest.approx(2e-3 / 3, rel=0.02)
    assert 0.99e-3 < disc.largest_shock <= 1e-3
    with pytest.raises(ValueError, match="must return 24 finite starts"):
        wj.basin_stability(WALKER, lambda rng, n: np.zeros((n, 3)), gait, samples=24)
    with pytest.raises(ValueError, match="metric must be a matrix"):
        wj.basin_stability(WALKER, 0.01, gait, metric=quadratic)


def test_the_return_time_is_that_of_a_decay_with_a_derivative(gait):
    made_up = lambda value: Gait(
        jnp.zeros((3, 2)),
        jnp.stack([value, value / 2]).astype(complex),
        jnp.ones(3),
        jnp.asarray(True),
        jnp.asarray(0.0),
        jnp.asarray(True),
    )
    time = lambda value: made_up(value).return_strides
    assert time(jnp.asarray(np.exp(-0.5))) == pytest.approx(6)  # three strides shrink by sqrt(e)
    assert time(jnp.asarray(1.5)) == np.inf and np.isnan(time(jnp.asarray(np.nan)))
    rate = jax.jit(jax.grad(time))(jnp.asarray(0.4))
    assert rate == pytest.approx(3 / (0.4 * np.log(0.4) ** 2))
    assert jax.vmap(time)(jnp.array([0.4, 0.6])).shape == (2,)
    # the spiral of a walk into the long gait, d_2 = a d_1 + b d_0: what it shrinks by in a stride
    state = np.asarray(gait.states[0])
    d = np.asarray(wj.walk(WALKER, state + np.array([1e-7, 0]), 60).states)[:12] - state
    (a, b), *_ = np.linalg.lstsq(np.stack([d[1:-1], d[:-2]], -1).reshape(-1, 2), d[2:].ravel())
    assert a**2 + 4 * b < 0
    assert float(gait.return_strides) == pytest.approx(-1 / np.log(np.sqrt(-b)), rel=1e-4)


def test_walkers_with_arrays_for_parameters_are_refused_by_name():
    many, one = jax.vmap(wj.SimplestWalker)(jnp.array([0.004, 0.005])), np.array([0.2, -0.2])
    grid = wj.Grid.sheared(theta=(0, 0.4, 9), sum=(-0.04, 0.02, 9))
    for call in (
        lambda: wj.boundary(many, grid),
        lambda: wj.boundary_point(many, grid),
        lambda: wj.zoom(many, grid, 2, one),
        lambda: wj.edge_state(many, one, one / 2),
        lambda: wj.tipping_probability(many, "slope", 0.005, grid),
        lambda: wj.least_disturbance(many),
        lambda: wj.continue_basins(many, "slope", [0.004, 0.005], grid),
    ):
        with pytest.raises(WrongUse, match="slope must be one number, not of shape"):
            call()


def test_what_a_sampler_returns_is_refused_by_name():
    rng = np.random.default_rng(0)
    with pytest.raises(WrongUse, match="region must return 3 finite starts"):
        draw_starts(WALKER, "region", lambda rng, n: np.zeros((n, 3)), rng, 3)
    with pytest.raises(WrongUse, match="starts that region returns must be real numbers"):
        draw_starts(WALKER, "region", lambda rng, n: np.array("text"), rng, 3)


def test_transitions_of_a_map_whose_basins_are_known():
    """x -> x + (x - x^3 + p) / 10 on (-2, 2): two basins, on both sides of a root of the cubic."""
    step = lambda x, p: x + (x - x**3 + p) / 10
    cubic = wj.Map(step, ("x",), parameters={"p": 0.0})
    region = wj.Grid.plain(x=(-2, 2, 1))
    found = wj.tipping_probability(cubic, "p", 0.3, region, samples=10_000, strides=300)
    roots = [np.sort(np.roots([-1, 0, 1, p]).real)[1] for p in (0.0, 0.3)]
    stays = (roots[1] + 2) / (roots[0] + 2)
    np.testing.assert_allclose(found.probability, [[stays, 1 - stays], [0, 1]], atol=0.02)
    assert roots[1] < roots[0] and found.starts.sum() == 10_000


def test_a_gait_may_jump_to_an_end_that_no_start_has():
    """Of two starts near attractor 0, one ends at attractor 1 and one falls; the gait itself ends
    at attractor 2."""
    attractors = [Attractor(np.full((1, 2), 0.1 * number)) for number in range(3)]
    before, after = (Mapper(WALKER, attractors[:count], Integrator(1e-10), 10) for count in (1, 3))
    fallen, numbers = int(Outcome.FORWARD), OUTCOMES + np.arange(3)
    first = np.array([numbers[0], numbers[0], fallen])
    second = np.array([numbers[1], fallen, fallen])
    found = assemble_tipping(first, second, [numbers[2:]], before, after, 0.95)
    assert found.before == ("attractor 0", "FORWARD")
    assert found.after == ("attractor 1", "attractor 2", "FORWARD")
    np.testing.assert_array_equal(found.starts, [[1, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(found.on_attractor, [[0, 1, 0], [np.nan] * 3])


def test_tipping_is_the_overlap_of_two_basins(gait):
    """Counted again, from the same starts, by walks at both slopes."""
    region = wj.Grid.sheared(theta=(0.1, 0.35, 10), sum=(-0.03, 0.008, 10))
    found = wj.tipping_probability(WALKER, "slope", 0.012, region, samples=400, seed=3)
    starts = region.points_at(np.random.default_rng(3).uniform(size=(400, 2)))
    fates = []
    for slope in (0.004, 0.012):
        x, fate = starts, np.zeros(400, int)
        for _ in range(120):
            made = wj.strides(wj.SimplestWalker(slope), np.nan_to_num(x, nan=-1.0))
            fate = np.where(fate == 0, made.outcome, fate)
            x = np.asarray(made.state)
        fates.append(fate)
    ends = {"attractor 0": 0, **{name: Outcome[name] for name in ("FORWARD", "BACKWARD")}}
    assert found.before[0] == found.after[0] == "attractor 0"
    for i, before in enumerate(found.before):
        for j, after in enumerate(found.after):
            both = (fates[0] == ends[before]) & (fates[1] == ends[after])
            assert found.starts[i, j] == both.sum(), (before, after)
    np.testing.assert_allclose(found.probability.sum(axis=1), 1)
    assert (found.low <= found.probability).all() and (found.probability <= found.high).all()
    # a walker in its gait falls forward when the ground gets so steep, and not at a little more
    after = np.asarray(wj.walk(wj.SimplestWalker(0.012), gait.states[0], 60).outcomes)
    assert after[-1] == Outcome.FORWARD
    assert found.on_attractor[0, found.after.index("FORWARD")] == 1
    assert np.isnan(found.on_attractor[1:]).all()
    little = wj.tipping_probability(WALKER, "slope", 0.0045, region, samples=100)
    assert little.on_attractor[0, 0] == 1
    # no start of these falls, but the gait itself does
    steady = starts[(fates[0] == 0) & (fates[1] == 0)]
    sampler = lambda rng, n: steady[:n]
    found = wj.tipping_probability(WALKER, "slope", 0.012, sampler, samples=len(steady))
    assert (found.before, found.after) == (("attractor 0",), ("attractor 0", "FORWARD"))
    assert found.on_attractor.tolist() == [[0, 1]]
    assert found.starts.tolist() == [[len(steady), 0]]


def test_the_data_set_of_a_boundary_its_picture_and_its_answer(monkeypatch):
    from walker_jax import figures

    begin = partial(wj.stable_manifold, points=20)
    monkeypatch.setattr("walker_jax.stability.boundaries.stable_manifold", begin)
    grid = wj.Grid.sheared(theta=(0, 0.4, 60), sum=(-0.04, 0.02, 60))
    data = wj.boundary(WALKER, grid, strides=200)
    answer = summarise_boundary(data)
    assert answer["regions"] == ["STRIDE", "FORWARD", "BACKWARD"]
    first = answer["edges"][0]
    assert first["regions"] == ["STRIDE", "FORWARD"] and first["kind"] == "saddle"
    assert first["multipliers"][0][0] == pytest.approx(3.21276939, rel=1e-8)
    fate = data["fate"].values
    labels = np.where(fate == Outcome.OUTSIDE, -1, fate)
    found = wj.fractals.basin_entropy(labels)
    assert answer["basin_entropy"] == found.value
    assert answer["boundary_entropy"]["value"] == found.boundary
    assert not answer["boundary_entropy"]["fractal"]
    shares = [one["share"] for one in answer["wada"]]
    np.testing.assert_allclose(shares, wj.fractals.merge_regions(labels).share)
    axes = figures.boundary(data)
    legends = [
        *axes.figure.legends,
        *(one for one in axes.get_children() if isinstance(one, Legend)),
    ]
    words = [" ".join(text.get_text().split()) for one in legends for text in one.get_texts()]
    assert any("saddle of period 1, multipliers 3.21, 0.592" in one for one in words)
    with pytest.raises(ValueError, match="boundary"):
        figures.boundary(wj.basin(WALKER, grid))


def test_without_a_manifold_a_boundary_is_refused_or_drawn(gait):
    region = wj.Grid.sheared(theta=(0, 0.4, 60), sum=(-0.08, 0.04, 2))
    with pytest.raises(WrongUse, match=r"3 cells or more along each axis, not \(60, 2\)"):
        wj.boundary(WALKER, region, side=2)
    twice = gait._replace(multipliers=np.array([3.0, 2.0]))
    assert curves_of(WALKER, twice, None) == curves_of(WALKER, None, None) == []


def test_cells_that_touch_are_the_nearest_pair_of_neighbours():
    label = np.array([[0, 0, 1], [0, 1, 1], [2, 2, 1]])
    cells = touching_cells(label, (0, 1), np.array([0.0, 0.0]))
    assert cells is not None
    assert label[tuple(cells[0])] == 0 and label[tuple(cells[1])] == 1
    assert np.abs(cells[1] - cells[0]).sum() == 1
    assert touching_cells(label, (0, 3), np.zeros(2)) is None
    swapped = touching_cells(label, (1, 0), np.array([0.0, 2.0]))
    assert swapped is not None and swapped.tolist() == [[0, 2], [0, 1]]
