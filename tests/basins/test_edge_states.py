"""Edge tracking, stable manifolds and narrow windows."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins import edge_states
from walker_jax.basins.attractor_search import survey
from walker_jax.basins.edge_tracking import follow_edge
from walker_jax.basins.narrow_windows import follow_window
from walker_jax.basins.stable_manifolds import Image, follow_manifold
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import OUTCOMES

WALKER = wj.SimplestWalker(0.004)
GRID = wj.Grid.sheared(theta=(0.01, 0.4, 60), sum=(-0.05, 0.03, 60))
CENTRES = GRID.centres(np.arange(GRID.size))


@pytest.fixture(scope="module")
def mapper():
    return survey(WALKER, CENTRES, Integrator(1e-12), 300, boxes=True).mapper


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(WALKER)


@pytest.fixture(scope="module")
def short():
    """The short gait, as Newton's iteration finds it from its neighbourhood."""
    return wj.find_gait(WALKER, [0.1488, -0.1588])


def test_derivatives_of_an_image_are_nan_where_a_stride_fails():
    for strides in (1, 2):
        image, jacobian = Image(WALKER, strides, Integrator(1e-12))(np.array([0.3, -0.05]))
        assert np.isnan(image).all() and np.isnan(jacobian).all()


def bend(y):
    return 0.3 * np.sin(y)


def pitchfork(x):
    """u -> 1.8 u - 0.8 u^3, y -> y / 2, with u = x - 0.3 sin y: a saddle at 0, its manifold u = 0.

    Points with u > 0 go to u = 1, others to u = -1.
    """
    u, y = x[:, 0] - bend(x[:, 1]), x[:, 1]
    return np.stack([1.8 * u - 0.8 * u**3 + bend(y / 2), y / 2], axis=1)


def side(x):
    for _ in range(80):
        x = pitchfork(x)
    return (x[:, 0] > 0).astype(int)


def test_the_edge_of_a_map_with_a_known_saddle_leads_to_it():
    track = follow_edge(
        pitchfork, side, np.array([0.9, 1.3]), np.array([-0.8, 0.9]), rounds=60, longest=4
    )
    assert track.period == 1 and not track.torn and track.labels == (1, 0)
    np.testing.assert_allclose(track.path[:, 0], bend(track.path[:, 1]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diff(np.log(track.path[:, 1])), -np.log(2), atol=1e-6)
    np.testing.assert_allclose(track.path[-1], 0, atol=3e-6)


def test_the_edge_of_a_saddle_of_period_two_repeats_itself():
    """The same map, but its boundary point alternates between two that attract along it."""

    def flip(x):
        u, y = x[:, 0] - bend(x[:, 1]), x[:, 1]
        new = -y * (1.5 - 0.5 * y**2)  # y = 1 and -1 change places, and attract: slope 0
        return np.stack([1.8 * u - 0.8 * u**3 + bend(new), new], axis=1)

    label = lambda x: (x[:, 0] > bend(x[:, 1])).astype(int)
    follow = lambda longest: follow_edge(
        flip, label, np.array([0.9, 0.8]), np.array([-0.8, 0.7]), rounds=60, longest=longest
    )
    track = follow(2)
    assert track.period == follow(4).period == 2 and follow(1).period == 0
    np.testing.assert_allclose(np.abs(track.path[-2:, 1]), 1, atol=1e-6)


def test_an_edge_goes_on_to_a_cycle_that_attracts_slowly():
    """y -> 0.995 y: two points are 1e-6 apart at 2e-4 from the cycle, and 1e-7 at 2e-5."""
    image = lambda x: np.stack([2 * x[:, 0], 0.995 * x[:, 1]], axis=1)
    ends = np.array([0.9, 0.001]), np.array([-0.8, 0.001])
    label = lambda x: (x[:, 0] > 0).astype(int)
    follow = lambda **test: follow_edge(image, label, *ends, rounds=900, longest=4, **test)
    first, last = follow(), follow(is_cycle=lambda points: np.abs(points).max() < 1e-4)
    assert first.period == last.period == 1
    assert 1.5e-4 < first.path[-1, 1] < 2e-4 and 1.5e-5 < last.path[-1, 1] < 2e-5
    never = follow(is_cycle=lambda points: False)
    assert never.period == 0 and len(never.path) == 900


def test_an_edge_that_the_map_tears_ends_there():
    image = lambda x: np.where(x > 0, x + 1, x - 1)
    track = follow_edge(
        image, lambda x: (x[:, 0] > 0).astype(int), np.ones(1), -np.ones(1), rounds=9, longest=4
    )
    assert track.torn and len(track.path) == 1 and abs(track.path[0, 0]) < 1e-12


@pytest.mark.parametrize(("push", "fall"), [(-0.02, Outcome.FORWARD), (0.02, Outcome.BACKWARD)])
def test_on_a_gentle_slope_the_boundary_leads_to_the_short_gait(push, fall, gait, short):
    """From a push that lets it fall backward, too: there is a layer of falls forward between."""
    state = np.asarray(gait.states[0])
    assert fall in wj.walk(WALKER, state + np.array([0, push]), 30).outcomes
    found = wj.edge_state(WALKER, state, state + np.array([0, push]))
    assert found.kind == "saddle" and found.saddle is not None
    assert found.fates == (Outcome.STRIDE, Outcome.FORWARD)
    np.testing.assert_allclose(found.saddle.states, short.states, rtol=0, atol=1e-11)
    assert found.saddle.multipliers[0].real > 1 > abs(found.saddle.multipliers[1])
    # each point of the path is the image of the one before
    ends = wj.strides(WALKER, found.path[:-1]).state
    np.testing.assert_allclose(ends, found.path[1:], rtol=0, atol=1e-10)


def test_between_the_falls_is_a_stride_that_stops_upright():
    """On it the energy is that of the stance leg at rest at the top."""
    found = wj.edge_state(WALKER, np.array([0.09, -0.14]), np.array([0.09, -0.04]))
    assert found.kind == "backward" and found.saddle is None and found.margin < 1e-12
    theta, rate = found.path[-1]
    assert rate**2 / 2 + np.cos(theta - 0.004) == pytest.approx(1, abs=1e-12)
    assert found.fates == (Outcome.FORWARD, Outcome.BACKWARD)
    with pytest.raises(ValueError, match="different fates, not both BACKWARD"):
        wj.edge_state(WALKER, np.array([0.09, -0.04]), np.array([0.09, -0.03]))
    with pytest.raises(ValueError, match="b must be a feasible start"):
        wj.edge_state(WALKER, np.array([0.09, -0.04]), np.array([0.09, 0.01]))
    with pytest.raises(ValueError, match="a must be finite numbers on the section"):
        wj.edge_state(WALKER, np.array([0.09, np.nan]), np.array([0.09, -0.03]))


def test_starts_of_one_fate_are_told_what_it_hides():
    told = {Outcome.UNDECIDED: "no answer; try another tolerance", Outcome.FORWARD: "other side"}
    for fate, words in told.items():
        assert re.match(rf"{fate.name}: .*{words}", edge_states.explain_fate(fate))
    to_gait = edge_states.explain_fate(OUTCOMES)
    assert to_gait == "STRIDE, to the same gait: try a start on the other side of the boundary"


def test_of_all_margins_that_nearest_to_zero_is_named(monkeypatch):
    found = {"BENT_KNEE": [1e-12, np.nan], "FORWARD": [-0.3, 0.2], "SCUFFED": [np.nan] * 2}
    arrays = lambda found: {name: np.array(values) for name, values in found.items()}
    for own, name in (([0.1, 0.1], "landing"), ([1.0, -1e-13], "hits_the_wall")):
        made_up = SimpleNamespace(by_name=arrays(found | {"hits_the_wall": own}))
        monkeypatch.setattr(edge_states, "for_each_start", lambda *args, made=made_up: made)
        nearest = edge_states.failing_margin(WALKER, np.zeros((2, 2)), Integrator(1e-12))
        assert nearest == (name, 1e-12 if name == "landing" else 1e-13)


def test_the_manifold_of_a_saddle_is_followed_through_folds():
    """y -> (y - 0.3 y^3) / 2 folds at y = 1 / sqrt(0.9): u = 0 goes on beyond."""

    def image(x):
        u, y = x[0] - bend(x[1]), x[1]
        new = (y - 0.3 * y**3) / 2
        end = np.array([1.8 * u + bend(new), new])
        du, dy = np.array([1, -0.3 * np.cos(y)]), np.array([0, (1 - 0.9 * y**2) / 2])
        return end, np.stack([1.8 * du + 0.3 * np.cos(new) * dy, dy])

    direction = np.array([0.3, 1.0]) / np.hypot(0.3, 1)
    curve = follow_manifold(image, np.zeros(2), direction, 2e-3, 1200)
    # to where the map leads to the other half of the manifold, y < 0
    assert curve[-1, 1] == pytest.approx(1 / np.sqrt(0.3), abs=1e-5) and 1 / np.sqrt(0.9) < 1.1
    np.testing.assert_allclose(curve[:, 0], bend(curve[:, 1]), rtol=0, atol=1e-9)
    assert (np.diff(curve[:, 1]) > 0).all()
    assert np.linalg.norm(np.diff(curve, axis=0), axis=1).max() <= 2.01e-3


def test_the_manifold_of_the_short_gait_is_the_boundary(short, mapper):
    curves = wj.stable_manifold(WALKER, short, spacing=1e-3, points=120)
    assert len(curves) == 2
    for curve in curves:
        np.testing.assert_array_equal(curve[0], short.states[0])
        inner, along = curve[40:-1:8], curve[41::8] - curve[39:-2:8]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        across *= 2e-6 / np.linalg.norm(across, axis=1, keepdims=True)
        fates = np.stack([mapper(inner + across).fate, mapper(inner - across).fate])
        assert (np.sort(fates, axis=0).T == [Outcome.STRIDE, Outcome.FORWARD]).all()
        ends = inner
        for _ in range(7):
            ends = wj.strides(WALKER, ends).state
        assert np.abs(ends - short.states[0]).max() < 2e-3
    with pytest.raises(ValueError, match="gait must be a saddle"):
        wj.stable_manifold(WALKER, wj.find_gait(WALKER))
    for slope in (0.0045, 0.03):
        with pytest.raises(ValueError, match="gait must be one of this walker"):
            wj.stable_manifold(wj.SimplestWalker(slope), short)


@pytest.mark.slow
def test_the_whole_boundary_of_walking_leads_to_the_short_gait(short, mapper):
    """On gentle slopes: of points of it, to the last digits, anywhere on the section."""
    ends = [curve[-1, 0] for curve in wj.stable_manifold(WALKER, short)]
    assert max(ends) == pytest.approx(np.pi / 4, abs=1e-6)  # where the section ends
    n = 400
    grid = wj.Grid.sheared(theta=(0.01, 0.7, n), sum=(-0.05, 0.03, n))
    walks = (mapper(grid.centres(np.arange(grid.size))).fate == Outcome.STRIDE).reshape(n, n)
    first = np.argwhere(walks[:, :-1] != walks[:, 1:])[::7]
    share = (np.stack([first, first + np.array([0, 1])]) + 0.5) / n
    for _ in range(35):
        middle = share.mean(axis=0)
        same = (mapper(grid.points_at(middle)).fate == Outcome.STRIDE) == walks[tuple(first.T)]
        share = np.where(np.stack([same, ~same])[..., None], middle, share)
    x, nearest = grid.points_at(share[0]), np.full(len(first), np.inf)
    for _ in range(40):
        nearest = np.fmin(nearest, np.abs(x - short.states[0]).max(axis=1))
        x = wj.strides(WALKER, np.nan_to_num(x, nan=-1.0)).state
    assert len(first) > 100 and (nearest < 1e-3).all()


def test_a_boundary_point_is_one_rounding_from_another_fate(mapper, gait):
    state = np.asarray(gait.states[0])
    point = wj.boundary_point(WALKER, GRID, state, strides=300)
    beside = point + np.stack(np.meshgrid(*[[-1, 0, 1]] * 2), -1).reshape(-1, 2) * np.spacing(point)
    assert len(set(mapper(beside).fate)) > 1
    with pytest.raises(wj.ComputationFailed, match="one fate"):
        wj.boundary_point(WALKER, wj.Grid.sheared(theta=(0.05, 0.06, 3), sum=(-0.03, -0.02, 3)))


STEEP = wj.SimplestWalker(0.009)
CENTRE = np.array([0.20093538234311084, -0.21084184410879986])
"""Of the fractal boundary, to the last digit."""


def test_a_window_by_its_centre_has_the_fates_of_its_starts():
    """Where float64 still tells starts apart: 5e-10 wide, on the fractal boundary at 0.009."""
    window = wj.Grid.sheared(theta=(0, 0.4, 60), sum=(-0.03, 0.02, 60)).zoom(CENTRE, 8e8)
    steep = survey(STEEP, CENTRES, Integrator(1e-12), 300, boxes=True).mapper
    followed, made = follow_window(STEEP, window, Integrator(1e-12), 300)
    assert made >= 1 and followed.shape == window.shape
    cells = np.arange(window.size)
    plain = steep(window.centres(cells))
    moved = steep._replace(strides=300 - made)(followed.centres(cells))
    assert len(np.unique(plain.fate)) > 1
    assert (plain.fate != moved.fate).mean() < 2e-3
    same = (plain.fate == moved.fate) & (plain.fate != Outcome.STRIDE)
    # In 46 strides on a fractal boundary rounding grows to the size of a step, too.
    assert (plain.strides[same] != moved.strides[same] + made).mean() < 2e-3
    wide, none = follow_window(STEEP, GRID, Integrator(1e-12), 300)
    assert wide is GRID and none == 0


def test_a_window_in_the_basin_has_strides_that_converge():
    """It never becomes wide: the gait attracts all of it."""
    inside = np.add(wj.find_gait(WALKER).states[0], 1e-4)
    coarse = wj.Grid.sheared(theta=(0, 0.4, 3), sum=(-0.03, 0.02, 3))
    wide, narrow = (wj.basin(WALKER, coarse.zoom(inside, f), "direct") for f in (1e7, 1e10))
    assert wide["strides"].max() < 40 and not wide["attractor"].any()
    np.testing.assert_array_equal(narrow["strides"], wide["strides"])
    np.testing.assert_array_equal(narrow["attractor"], wide["attractor"])


def test_a_window_of_1e_12_is_the_same_whole_and_in_pieces(tmp_path, monkeypatch):
    window = wj.Grid.sheared(theta=(0, 0.4, 24), sum=(-0.03, 0.02, 24)).zoom(CENTRE, 1e12)
    whole = wj.basin(STEEP, window, "direct")
    monkeypatch.setattr("walker_jax.basins.methods.PIECE", 100)
    stored = wj.basin(STEEP, window, "direct", out=tmp_path / "w.zarr")
    for name in ("fate", "attractor", "strides"):
        np.testing.assert_array_equal(whole[name], stored[name])
    assert len(np.unique(whole["fate"])) > 1 and whole.attrs["origin"] == CENTRE.tolist()


def test_where_float64_ends_one_line_says_so():
    grid = wj.Grid.sheared(theta=(0, 0.4, 24), sum=(-0.03, 0.02, 24))
    with pytest.raises(
        ValueError, match="at least 9e-16 wide, not 4e-16: float64 holds its centre"
    ):
        wj.basin(STEEP, grid.zoom(CENTRE, 1e15), "direct")
    plain = wj.Grid.plain(theta=(0.2, 0.2 + 1e-14, 900), thetadot=(-0.21, -0.21 + 1e-14, 900))
    with pytest.raises(ValueError, match=r"wider than numbers near 0.2.* grid.zoom\(centre"):
        wj.basin(STEEP, plain, "direct")
    thin = wj.Grid({"theta": (-0.01, 0.01, 4), "sum": (-2e-16, 2e-16, 50)}, grid.shear, CENTRE)
    with pytest.raises(ValueError, match=r"cells along sum wider .*, not 8e-18, in a window so"):
        wj.basin(STEEP, thin, "direct")
    # the boundary of falling backward in this stride, to the last digit
    upright = np.array([0.15, -np.sqrt(2 * (1 - np.cos(0.15 - 0.009)))])
    with pytest.raises(wj.ComputationFailed, match="torn apart after 0 strides"):
        wj.basin(STEEP, grid.zoom(upright, 2e13), "direct")
    with pytest.raises(ValueError, match="factor=0"):
        grid.zoom(CENTRE, 0)


def test_a_zoom_has_every_window_and_makes_a_film(tmp_path):
    from walker_jax import figures

    grid = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.03, 0.02, 20))
    data = wj.zoom(STEEP, grid, 1e10, CENTRE, frames=2, strides=100)
    assert data["fate"].shape == (2, 20, 20)
    np.testing.assert_allclose(data["factor"], [1, 1e10])
    assert data["ahead"].values[0] == 0 < data["ahead"].values[-1]
    first = wj.basin(STEEP, grid.zoom(CENTRE, 1), "direct", strides=100)
    np.testing.assert_array_equal(data["fate"][0], first["fate"])
    figures.zoom_film(data, tmp_path / "z.gif", signature="s")
    from PIL import Image, ImageSequence

    with Image.open(tmp_path / "z.gif") as film:
        assert len(list(ImageSequence.Iterator(film))) == 2


def test_starts_of_a_zoom_make_no_more_strides_than_given():
    """Where float64 still tells starts apart a quarter of them fall in the stride after the last
    that is made, and those that their centre made for them count."""
    grid, strides = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.03, 0.02, 20)), 29
    data = wj.zoom(STEEP, grid, 8e8, CENTRE, frames=2, strides=strides)
    assert data["ahead"].values[1] > 0
    ends = [grid.zoom(CENTRE, 8e8).centres(np.arange(grid.size))]
    for _ in range(strides + 1):
        ends.append(np.asarray(wj.strides(STEEP, np.nan_to_num(ends[-1], nan=-1.0)).state))
    walks, longer = (~np.isnan(end[:, 0]).reshape(grid.shape) for end in ends[-2:])
    assert (walks & ~longer).sum() > 80
    np.testing.assert_array_equal(data["fate"][1] == Outcome.STRIDE, walks)
