"""Pictures of walkers in motion show what was computed."""

from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.figure import Figure
from matplotlib.text import Text
from parts_of_pictures import legend
from PIL import Image, ImageSequence

import walker_jax as wj
from walker_jax import figures
from walker_jax.figures import films
from walker_jax.figures.poses import above_ground, draw_pose

SLOPE = 0.004


@pytest.fixture(scope="module")
def walk():
    return wj.motion(wj.SimplestWalker(SLOPE), np.array([0.2, -0.21645]), 9, step=0.4)


@pytest.fixture(scope="module")
def data():
    grid = wj.Grid.sheared(theta=(0, 0.4, 40), sum=(-0.04, 0.01, 50))
    return wj.basin(wj.SimplestWalker(SLOPE), grid, "direct")


def test_a_step_is_six_poses_with_hip_and_feet_where_they_are(walk):
    figure = figures.step(walk)
    assert len(figure.axes) == 6
    first = walk.isel(frame=0)
    c, s = np.cos(SLOPE), np.sin(SLOPE)
    seen = lambda place: [place[0] * c + place[1] * s, place[1] * c - place[0] * s]
    drawn = [np.asarray(line.get_xydata())[-1] for line in figure.axes[0].lines]
    for name in ("hip", "stance", "swing"):
        place = seen(first[name].values)
        assert min(np.abs(xy - place).max() for xy in drawn) < 1e-12
    names = [text.get_text() for text in figure.axes[1].texts]
    assert {r"$\theta$", r"$\phi$", "$g$"} <= set(names)
    figure.draw_without_rendering()


def test_round_feet_are_arcs_that_touch_the_ground(walk):
    """Of some radius, about the ends of the legs."""
    radius = 0.2
    round_ = walk.assign_attrs(foot_radius=radius, leg_length=0.8, walker_slope=0.0)
    lifted = round_.assign({name: round_[name] + [0, radius] for name in ("stance", "hip")})
    ax = figures.step(lifted).axes[0]
    arcs = [np.asarray(line.get_xydata()) for line in ax.lines]
    arcs = [line for line in arcs if len(line) == 40]
    assert len(arcs) == 2
    stance = lifted["stance"].values[0]
    away = np.linalg.norm(arcs[0] - stance, axis=1)
    np.testing.assert_allclose(away, radius, rtol=1e-12)
    assert abs(arcs[0][:, 1].min()) < 1e-3


@pytest.mark.parametrize("start", [[0.3, -0.335], [0.3, -0.1]])  # falls forward, backward
def test_nothing_is_drawn_below_the_ground(start):
    fall = wj.motion(wj.SimplestWalker(SLOPE), np.array(start), 2)
    assert fall["swing"][:, 1].min() < -0.5
    turn = np.array([[np.cos(SLOPE), -np.sin(SLOPE)], [np.sin(SLOPE), np.cos(SLOPE)]])
    ax = Figure().subplots()
    for k in range(fall.sizes["frame"]):
        drawn = [
            np.asarray(line.get_xydata()) @ turn.T for line in draw_pose(ax, fall.isel(frame=k))
        ]
        assert min(places[:, 1].min() for places in drawn) > -1e-12
        hip, foot = drawn[2][[0, -1]]
        assert np.linalg.norm(foot - hip) > 0.9 - 1e-9


def test_a_swing_leg_is_shortened_a_little_or_turned():
    leg = np.array([[0.0, 0.98], [0.1, 0.48], [0.2, -0.02]])
    shorter, turned = above_ground(leg, 0.0, 0.0)
    assert turned == 0
    np.testing.assert_allclose(shorter[-1], [0.196, 0], atol=1e-12)
    np.testing.assert_allclose(shorter[1], shorter[[0, 2]].mean(axis=0), atol=1e-12)
    low, turned = above_ground(leg - [0, 0.5], 0.0, 0.1)
    length = np.linalg.norm(leg[-1] - leg[0])
    assert low[-1, 1] == pytest.approx(0.1) and turned > 0
    assert np.linalg.norm(low[-1] - low[0]) == pytest.approx(0.9 * length)
    assert above_ground(leg, -0.1, 0.0)[0] is leg


def test_a_walk_that_has_no_length_is_drawn(walk):
    ax = figures.leg_angles(walk.isel(frame=[0]))
    low, high = ax.get_xlim()
    assert low < 0 < high and len(ax.lines) == 3


def test_a_step_that_fails_says_so():
    data = wj.motion(wj.SimplestWalker(SLOPE), np.array([0.2, -0.23]), 1, step=0.4)
    titles = [ax.get_title(loc="right") for ax in figures.step(data).axes]
    assert titles[0] == "just after heel strike" and titles[-1] == "falls forward"


def test_the_ground_goes_down_to_the_right(walk):
    figure = figures.step(walk)
    ground = np.asarray(figure.axes[0].lines[0].get_xydata())
    (x0, y0), (x1, y1) = ground
    assert x1 > x0 and (y1 - y0) / (x1 - x0) == pytest.approx(-np.tan(SLOPE))


def test_leg_angles_have_a_line_for_each_leg_and_mark_strikes(walk):
    late = figures.leg_angles(walk.isel(frame=walk["stride"].values > 1))
    assert legend(late) == ["stance leg", "swing leg"]
    ax = figures.leg_angles(walk)
    curves = [line for line in ax.lines if len(np.asarray(line.get_xdata())) > 2]
    assert len(curves) == 2 * 9
    own = walk.isel(frame=walk["stride"].values == 0)
    np.testing.assert_array_equal(curves[0].get_ydata(), own["theta"])
    np.testing.assert_array_equal(curves[1].get_ydata(), own["theta"] - own["phi"])
    assert len(ax.lines) == 1 + 8 + 2 * 9  # the normal, heel strikes but the last, curves
    assert "9 strides" in [text.get_text() for text in ax.texts]


def test_leg_angles_say_how_a_walk_ends():
    data = wj.motion(wj.SimplestWalker(SLOPE), np.array([0.2, -0.23]), 9, step=0.4)
    ax = figures.leg_angles(data)
    assert "0 strides, then falls forward" in [text.get_text() for text in ax.texts]


def test_the_trajectory_in_a_basin_is_that_of_the_walk(walk, data):
    figure = figures.steps_over_basin(data, walk)
    theta, thetadot = walk["states"].values.T
    for ax in figure.axes:
        lines = [np.asarray(line.get_xydata()) for line in ax.lines]
        trajectory = next(line for line in lines if len(line) == 10)
        np.testing.assert_allclose(trajectory, np.stack([theta, theta + thetadot], axis=1))
    numbers = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert [str(k) for k in range(1, 11)] == [text for text in numbers if text.isdigit()]


def test_a_film_has_all_frames_and_carries_its_signature(walk, data, tmp_path):
    path = tmp_path / "walk.gif"
    short = walk.isel(frame=slice(0, 20))
    figures.film(short, path, data, signature="of a request")
    with Image.open(path) as film:
        assert film.info["comment"] == b"of a request"
        assert film.info["duration"] == 50 and film.info["loop"] == 0
        frames = [np.asarray(one.convert("RGB"), int) for one in ImageSequence.Iterator(film)]
    first, *_, last = frames
    assert len(frames) == 20
    assert np.abs(first - last).max() > 100 and first.std() > 10
    assert [one.name for one in tmp_path.iterdir()] == ["walk.gif"]


def test_a_film_of_the_walker_alone(walk, tmp_path):
    path = tmp_path / "walk.gif"
    figures.film(walk.isel(frame=slice(0, 3)), path)
    with Image.open(path) as film:
        assert sum(1 for _ in ImageSequence.Iterator(film)) == 3


def test_a_film_dwells_on_a_stride(walk, tmp_path):
    path = tmp_path / "walk.gif"
    some = walk.isel(frame=np.flatnonzero(walk["stride"].values < 3)[::3])
    figures.film(some, path, slow=1)
    with Image.open(path) as film:
        times = [one.info["duration"] for one in ImageSequence.Iterator(film)]
    assert times == [200 if number == 1 else 50 for number in some["stride"].values.tolist()]


@pytest.mark.parametrize("beside", [False, True])
def test_a_long_title_of_a_film_stands_above_the_stride(walk, data, tmp_path, monkeypatch, beside):
    """Also at the film's own number of dots per inch, for which it is not laid out again."""
    drawn = []

    @contextmanager
    def writer(figure, *_):
        figure.set_dpi(films.DOTS)
        figure.draw_without_rendering()
        texts = {one.get_text().split(" ")[0]: one for one in figure.findobj(Text)}
        drawn.append((figure, texts["stride"], texts["SimplestWalker,"]))
        yield lambda: None

    monkeypatch.setattr(films, "film_writer", writer)
    about = {f"walker_parameter_number_{i}": 0.123456 for i in range(6)}
    long = walk.isel(frame=slice(0, 1)).assign_attrs(about)
    figures.film(long, tmp_path / "walk.gif", data if beside else None)
    ((figure, heading, title),) = drawn
    above, below = title.get_window_extent(), heading.get_window_extent()
    assert len(title.get_text().split("\n")) >= (2 if beside else 3)
    assert above.y0 > below.y1 and above.x1 <= figure.bbox.x1 and above.y1 <= figure.bbox.y1


def test_an_interrupted_film_leaves_what_was_there(walk, tmp_path, monkeypatch):
    path = tmp_path / "walk.gif"
    path.write_bytes(b"before")
    monkeypatch.setattr("walker_jax.figures.films.draw_pose", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        figures.film(walk, path)
    assert path.read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 1


def test_a_film_needs_an_ending_and_mp4_needs_ffmpeg(walk, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"walk.png must end in one of \.gif, \.mp4$"):
        figures.film(walk, tmp_path / "walk.png")
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ValueError, match="takes the program ffmpeg"):
        figures.film(walk, tmp_path / "walk.mp4")
