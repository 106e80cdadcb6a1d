"""The explorer's server, without a browser."""

import asyncio
import dataclasses
import html
import io
import json
import re
import signal
import subprocess
import sys
import threading
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import explorer_server
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from explorer_subjects import FIRST, GRID, SIMPLEST, WHOLE, few, joined, parts_and_result
from zarr.storage import ZipStore

import walker_jax as wj
from walker_jax.explorer import measures, offers, pictures, service, walks
from walker_jax.explorer.compile_times import SECONDS, CompileTimes
from walker_jax.explorer.family import describe_family
from walker_jax.explorer.lattice import HOME_CELLS, TILE, Rectangle
from walker_jax.explorer.offers import FAMILY, OTHERS
from walker_jax.explorer.server import listen
from walker_jax.explorer.subjects import Subject, read_subject
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.parameters import parameters


def subject(name="simplest", section="sheared", **values):
    return read_subject({"walker": name, "parameters": values, "section": section})


# ---------------------------------------------------------------------------- pictures


def test_a_picture_is_the_basin(client):
    attractors, tiles = client.tiles(SIMPLEST | {"tiles": WHOLE})
    label, strides = joined(tiles)
    basin = wj.basin(wj.SimplestWalker(0.004), GRID, "direct")
    fate = basin["fate"].values
    walks = label >= FIRST
    np.testing.assert_array_equal(walks, basin["attractor"].values >= 0)
    np.testing.assert_array_equal(label[~walks], fate[~walks])
    # attractors known to the last digit or the last but one: few are a stride sooner there
    off = np.abs(strides.astype(int) - np.minimum(basin["strides"].values, 255))
    assert off.max() <= 1 and (off > 0).mean() < 1e-3
    assert [one["period"] for one in attractors] == [1]
    np.testing.assert_allclose(attractors[0]["states"], basin["states"].values[0], atol=1e-9)
    assert (walks.sum() * GRID.cell_area) == pytest.approx(float(basin["area"].sum()), rel=1e-12)


@pytest.mark.parametrize("section", ["sheared", "plain"])
def test_far_in_a_picture_shows_what_strides_do(client, section):
    """2^14 times as close, where the boundary is fractal: cells followed stride by stride."""
    level = 14
    at = np.array([0.19313, 0.01085 - 0.02])
    home = service.home_of(FAMILY["simplest"], section)
    x = at if section == "sheared" else np.array([at[0], at[1] - at[0]])
    share = (x - home.lower) / (np.array(home.upper) - home.lower)
    first = np.floor(share * np.array(HOME_CELLS) * 2.0**level / TILE).astype(int)
    asked = {"tiles": [[level, *first.tolist()]], "section": section}
    _, (tile,) = client.tiles(SIMPLEST | asked)
    label, strides = np.frombuffer(tile, np.uint8).reshape(2, TILE, TILE)
    width = (np.array(home.upper) - home.lower) / HOME_CELLS / 2.0**level
    i, j = np.indices((TILE, TILE))
    places = home.lower + (first * TILE + np.stack([i, j], -1) + 0.5) * width
    theta = places[..., 0]
    rate = places[..., 1] - theta if section == "sheared" else places[..., 1]
    states = np.stack([theta, rate], -1).reshape(-1, 2)
    fate, count = explorer_server.follow(wj.SimplestWalker(0.004), states, 60)
    falls = fate > 0
    # where a rounding error decides, far out on its way, a cell in some hundreds differs
    same = (label.ravel()[falls] == fate[falls]) & (strides.ravel()[falls] == count[falls])
    assert same.mean() > 0.995
    assert (label.ravel()[~falls] >= FIRST).all()


def test_a_cell_map_is_that_of_the_library(client):
    frames = client.frames(SIMPLEST | {"method": "cell-map", "rectangles": [[0, 0, 0, 200, 250]]})
    assert [one.kind for one in frames] == [0, 1]
    attractors = json.loads(frames[0].content)["attractors"]
    label, strides = np.frombuffer(frames[1].content[4:], np.uint8).reshape(2, 200, 250)
    basin = wj.basin(wj.SimplestWalker(0.004), GRID)
    assert [one["artefact"] for one in attractors] == basin["artefact"].values.tolist()
    number = np.where(label >= FIRST, label.astype(int) - FIRST, -1)
    np.testing.assert_array_equal(number, basin["attractor"].values)
    np.testing.assert_array_equal(label[label < FIRST], basin["fate"].values[label < FIRST])
    np.testing.assert_array_equal(strides, np.minimum(basin["strides"].values, 255))


@pytest.mark.parametrize(
    ("slope", "periods"), [(0.017, [2]), pytest.param(0.0189, [None], marks=pytest.mark.slow)]
)
def test_attractors_without_a_gait_of_period_one(slope, periods):
    """Past the first doubling, and past the cascade, where one takes all that remain."""
    about = subject(slope=slope)
    pictures.label_tiles(about, [pictures.Tile(-2, 0, 0)])
    assert [one.period for one in pictures.known[about].mapper.attractors] == periods


def test_a_picture_that_nobody_waits_for_is_not_computed(running, client, monkeypatch):
    """Beyond the batch that is being computed when the page goes."""
    asked, gone, computed = threading.Event(), threading.Event(), []

    def wait_for_the_page_to_go(about, tiles):
        computed.append(len(tiles))
        asked.set()
        assert gone.wait(60)
        return [bytes(2 * TILE * TILE)] * len(tiles)

    client.tiles(SIMPLEST | {"tiles": [[0, 0, 0]]})
    monkeypatch.setattr(pictures, "label_tiles", wait_for_the_page_to_go)
    many = SIMPLEST | {"tiles": [[4, i, 0] for i in range(600)]}
    running.client().give_up("/api/picture", many, lambda: asked.wait(60))
    running.settle()
    gone.set()
    client.tiles(SIMPLEST | {"tiles": [[0, 0, 0]]})  # by the same thread, so after all else
    assert computed == [service.FIRST_BATCH, 1]


def test_a_walk_that_nobody_waits_for_is_not_computed(running, client, monkeypatch):
    """Beyond the strides that are being computed when the page goes."""
    asked, gone, computed = threading.Event(), threading.Event(), []

    def wait_for_the_page_to_go(about, start, count):
        computed.append(count)
        asked.set()
        assert gone.wait(60)
        return {"strides": [{}] * count, "next": start.tolist(), "leg": {}}

    walk = SIMPLEST | {"start": [0.2, -0.2]}
    client.ask("/api/walk", walk | {"strides": 1})
    monkeypatch.setattr(walks, "follow", wait_for_the_page_to_go)
    running.client().give_up("/api/walk", walk | {"strides": 60}, lambda: asked.wait(60))
    running.settle()
    gone.set()
    assert client.ask("/api/walk", walk | {"strides": 1}).status == 200  # by the same thread
    assert computed == [walks.STRIDES_AT_ONCE, 1]


@pytest.mark.slow  # most walkers take long to compile
@pytest.mark.parametrize("name", PLANAR_WALKERS)
def test_every_walker_has_a_home(client, name):
    """At its default parameters, with its gait inside."""
    answer = client.ask("/api/home", {"walker": name})
    assert answer.status == 200, answer
    home = answer.json()
    x = np.array([home["gait"][0], home["gait"][0] + home["gait"][1]])
    assert (np.array(home["lower"]) < x).all() and (x < home["upper"]).all()


@pytest.mark.slow  # a worker starts, and compiles
def test_a_cell_map_of_many_cells_is_a_workers(running, client, monkeypatch):
    asked = SIMPLEST | {"method": "cell-map", "rectangles": [[0, 0, 0, 200, 250]]}
    quick = client.frames(asked)
    monkeypatch.setattr(service, "MANY_CELLS", 1000)
    assert client.frames(asked) == quick
    crew = running.server.config.app.app.state.service.workers
    assert crew.all[0].process is not None and crew.all[1].process is None


# ---------------------------------------------------------------------------- walks


def test_a_walk_is_that_of_the_library(client):
    answer = client.ask("/api/walk", SIMPLEST | {"start": [0.2, -0.21645], "strides": 9}).json()
    assert answer["leg"] == {"length": 1.0, "radius": 0.0}
    made = wj.walk(wj.SimplestWalker(0.004), jnp.array([0.2, -0.21645]), 9)
    assert [one["outcome"] for one in answer["strides"]] == [0] * 9
    starts = [one["start"] for one in answer["strides"]]
    np.testing.assert_allclose(starts, made.states[:-1], rtol=1e-12)
    np.testing.assert_allclose(answer["next"], made.states[-1], rtol=1e-12)
    one = answer["strides"][3]
    times = np.linspace(0, one["duration"], len(one["frames"]))
    whole = wj.trajectory(wj.SimplestWalker(0.004), jnp.array(one["start"]), times)
    np.testing.assert_allclose(one["frames"], np.stack(whole, axis=1), atol=1e-7)


def test_a_walk_ends_with_the_stride_that_fails():
    made = wj.walk(wj.SimplestWalker(0.004), (0.1911, -0.1946), 6)
    made_outcomes = np.asarray(made.outcomes).tolist()
    whole = made_outcomes.count(wj.Outcome.STRIDE)
    assert 0 < whole < 6
    found = walks.follow(subject(), np.array([0.1911, -0.1946]), 6)
    outcomes, starts, times = (
        [one[of] for one in found["strides"]] for of in ("outcome", "start", "duration")
    )
    assert outcomes == made_outcomes[: whole + 1]
    np.testing.assert_allclose(starts, made.states[: whole + 1], rtol=1e-12)
    np.testing.assert_allclose(times[:whole], made.times[:whole], rtol=1e-12)
    assert found["next"] is None and all(len(one["frames"]) > 8 for one in found["strides"])


@pytest.mark.parametrize(("x", "outcome"), [([0.3, -0.5], 1), ([0.3, -0.1], 2), ([-0.1, -0.1], 5)])
def test_a_fall_is_shown_as_it_happens(client, x, outcome):
    answer = client.ask("/api/walk", SIMPLEST | {"start": x}).json()
    last = answer["strides"][-1]
    assert last["outcome"] == outcome and answer["next"] is None
    if outcome == 1:
        assert last["frames"][-1][0] == pytest.approx(-np.pi / 2, abs=0.05)
    assert np.isfinite(np.array(last["frames"])).all()


def hip_velocity(walker, state):
    """By automatic differentiation of the hip's place."""
    _, length, radius = walker.picture()

    def hip(q):
        return jnp.stack([-radius * q[0] - length * jnp.sin(q[0]), length * jnp.cos(q[0]) + radius])

    q, rates = jnp.asarray(state[:2]), jnp.asarray(state[2:])
    return jax.jvp(hip, (q,), (rates,))[1]


@pytest.mark.parametrize("name", [pytest.param("point-foot", marks=pytest.mark.slow), "round-foot"])
def test_a_push_does_the_work_of_its_impulse(name):
    """The kinetic energy grows by the impulse times the mean of the hip's speeds."""
    walker: Any = subject(name, slope=0.01).walker
    state, impulse = np.array([0.11, -0.23, -0.2, 0.35]), np.array([0.03, -0.02])
    after = walks.push(subject(name, slope=0.01), state, impulse)
    np.testing.assert_array_equal(after[:2], state[:2])
    energy = lambda values: float(walker.energy(wj.State(*map(jnp.asarray, values))))
    mean = (hip_velocity(walker, state) + hip_velocity(walker, after)) / 2
    assert energy(after) - energy(state) == pytest.approx(
        float(impulse @ np.asarray(mean)), rel=1e-9
    )


def test_a_push_of_a_leg_without_mass_is_the_limit():
    state, impulse = np.array([0.11, -0.23, -0.2, 0.35]), np.array([0.03, -0.02])
    limit = walks.push(subject(), state, impulse)
    near = [walks.push(subject("point-foot", foot_mass=m), state, impulse) for m in (1e-5, 1e-6)]
    errors = [np.abs(one - limit).max() for one in near]
    assert errors[0] < 1e-5 and errors[1] == pytest.approx(errors[0] / 10, rel=0.01)


@pytest.mark.slow  # a walker with knees takes long to compile
def test_a_walker_with_knees_bends_them_and_is_pushed():
    about = subject("kneed", slope=0.05)
    kneed: Any = about.walker
    gait = np.asarray(wj.find_gait(kneed).states[0])
    (made,) = walks.follow(about, gait, 1)["strides"]
    motion = wj.motion(kneed, gait, 1)
    bent, frames = np.array(made["bent"]), np.array(made["frames"])
    assert made["outcome"] == 0 and len(bent) == len(frames)
    knee = (motion["swing_knee"] - motion["hip"]).values
    np.testing.assert_allclose(bent[[0, -1], :2], knee[[0, -1]], atol=1e-6)
    assert bent[:, 3].max() > -0.95 * motion.attrs["leg_length"]  # it is bent in between

    # A push of no size changes nothing, while the knee bends or once it is locked.
    locks, count = made["locks"], len(frames) - 1
    assert locks == pytest.approx(float(wj.phase_times(kneed, gait)[0]), rel=1e-12)
    for k, state in ((4, frames[4]), (count - 3, frames[count - 3][[0, 1, 3, 4]])):
        time = k * made["duration"] / count
        assert (time > locks) == (len(state) == 4)
        same = walks.push(about, state, np.zeros(2))
        np.testing.assert_allclose(same, state, rtol=0, atol=1e-15)
        first, second = walks.follow(about, same, 2)["strides"]
        assert first["duration"] == pytest.approx(made["duration"] - time, abs=1e-6)
        np.testing.assert_allclose(second["start"], gait, atol=1e-5)
        # Its work is the impulse times the mean of the hip's speeds.
        after, impulse = walks.push(about, state, np.array([0.03, -0.02])), np.array([0.03, -0.02])
        walker: Any = walks.walker_from(about, state)
        phase, kind = (walker, wj.State) if len(state) == 4 else (walker.phases()[0], wj.BentState)
        energy = lambda values, p=phase, k=kind: float(p.energy(k(*map(jnp.asarray, values))))
        legs = [
            values[[0, 1, -len(values) // 2, 1 - len(values) // 2]] for values in (state, after)
        ]
        mean = sum(hip_velocity(about.walker, values) for values in legs) / 2
        work = float(impulse @ np.asarray(mean))
        assert energy(after) - energy(state) == pytest.approx(work, rel=1e-9)


def test_a_pushed_walker_goes_on(client):
    asked = SIMPLEST | {"start": [0.05, -0.1, -0.15, -0.5], "push": [0.001, 0.0], "strides": 3}
    answer = client.ask("/api/walk", asked).json()
    pushed = walks.push(subject(), np.array(asked["start"]), np.array(asked["push"]))
    np.testing.assert_allclose(answer["strides"][0]["start"], pushed, rtol=1e-12)
    ends = wj.stride(wj.SimplestWalker(0.004), jnp.asarray(pushed))
    assert answer["strides"][0]["outcome"] == int(ends.outcome)


# ---------------------------------------------------------------------------- measures, copies


def test_gaits_and_area_for_the_page(monkeypatch):
    few = wj.Grid.sheared(theta=(0.1, 0.2, 10), sum=(-0.02, 0.01, 10))  # places to search from
    monkeypatch.setattr(wj.SimplestWalker, "gait_region", lambda _: few)
    found = measures.gaits(subject())
    stable = [one for one in found if one["stable"]]
    assert [one["period"] for one in stable] == [1]
    gait = wj.find_gait(wj.SimplestWalker(0.004))
    np.testing.assert_allclose(stable[0]["states"], gait.states, atol=1e-10)
    values = [complex(*one) for one in stable[0]["multipliers"]]
    np.testing.assert_allclose(values, gait.multipliers, atol=1e-7)
    area = measures.area(subject(), Rectangle(-1, (0, 0), (100, 125)))
    assert abs(area["area"] - 0.0012073) < 5 * area["error"] + 1e-6  # of every cell of 800 x 1000
    assert json.dumps([found, area], allow_nan=False)
    assert measures.disturbance(subject(slope=0.03)) is None  # its gait is not stable


def test_the_disturbance_for_the_page(monkeypatch):
    few = partial(wj.least_disturbance, directions=4)
    monkeypatch.setattr(measures, "least_disturbance", few)
    found = measures.disturbance(subject())
    exact = few(wj.SimplestWalker(0.004))
    assert found is not None and json.dumps(found, allow_nan=False)
    assert found["size"] == exact.size and found["failure"] == int(exact.failure)
    assert found["strides"] == exact.strides and found["state"] == exact.state.tolist()
    gait = wj.find_gait(wj.SimplestWalker(0.004))
    np.testing.assert_allclose(found["gait"], gait.states[0], atol=1e-10)


def test_the_diagram_for_the_page(monkeypatch):
    """Around the first doubling: branches are gaits, and points what walkers come to."""
    monkeypatch.setattr(offers, "span_of", lambda kind, name: (0.0148, 0.0154))
    for name, value in few(3, strides=400).items():
        monkeypatch.setattr(measures, name, value)
    parts, diagram = parts_and_result(measures.bifurcation(subject(), "slope"))
    counts = [len(one["branches"]) for one in parts]  # which come one by one
    assert counts == sorted({*counts}) and counts[0] < counts[-1] == len(diagram["branches"])
    assert not any(one["whole"] or one["points"] for one in parts) and diagram["whole"]
    assert json.dumps(diagram, allow_nan=False)
    for name, like in explorer_server.DIAGRAM.items():  # with which the page is tested
        assert len(diagram[name][0]) == len(like[0]) if name == "points" else diagram[name]
        assert all(name in one for one in parts)
        if name in ("branches", "events"):
            assert {*diagram[name][0]} == {*like[0]}
    assert {*diagram} == {*explorer_server.DIAGRAM}
    assert diagram["range"] == (0.0148, 0.0154)
    assert diagram["lost"] == [0.0154, None]  # not up to there
    (doubling,) = (one["value"] for one in diagram["events"] if not one["fold"])
    assert doubling == pytest.approx(0.01508843794, abs=1e-9)
    places = np.array(diagram["points"])
    come_to = {slope: places[places[:, 0] == slope, 1] for slope in (0.0148, 0.0154)}
    assert [len(one) for one in come_to.values()] == [1, 2]
    (doubled,) = (one for one in diagram["branches"] if one["period"] == 2)
    (last,) = np.flatnonzero(np.isclose(doubled["value"], 0.0154))
    ends = sorted(row[last] for row in doubled["state"])
    np.testing.assert_allclose(ends, np.sort(come_to[0.0154]), rtol=0, atol=1e-6)
    assert all(doubled["stable"][-5:])
    stays = wj.find_gait(wj.SimplestWalker(0.0148)).states[0, 0]
    assert come_to[0.0148][0] == pytest.approx(stays, abs=1e-6)
    single = [one for one in diagram["branches"] if one["period"] == 1]
    (long,) = (one for one in single if np.isclose(one["state"][0], stays, atol=1e-9).any())
    assert long["stable"] == [int(slope < doubling) for slope in long["value"]]


@pytest.mark.slow
def test_the_measures_that_take_long():
    found = measures.disturbance(subject())
    assert found is not None
    exact = wj.least_disturbance(wj.SimplestWalker(0.004))
    assert found["size"] == exact.size and found["failure"] == int(exact.failure)
    np.testing.assert_allclose(found["gait"], exact.state - exact.size * exact.direction)
    _, diagram = parts_and_result(measures.bifurcation(subject(), "slope"))
    assert json.dumps(diagram, allow_nan=False)
    cascade = [one["value"] for one in diagram["events"] if one["cascade"] and not one["fold"]]
    assert min(cascade) == pytest.approx(0.01508843794, abs=1e-9)
    assert diagram["lost"][0] == pytest.approx(
        0.01904, abs=1e-4
    )  # of walkers that make 600 strides


@pytest.mark.parametrize(
    ("name", "slopes"), [("simplest", (0.001, 0.022)), ("kneed", (0.03, 0.12))]
)
def test_a_diagram_is_of_the_walkers_own_slopes(monkeypatch, name, slopes):
    asked = []
    grow = lambda *words, **_: asked.extend(words) or [([], [])]
    monkeypatch.setattr(measures, "grow_branches", grow)
    monkeypatch.setattr(measures, "complete_diagram", lambda *words, **_: asked.extend(words))
    with pytest.raises(TypeError):  # of what is no diagram
        next(measures.bifurcation(subject(name), "slope"))
    assert asked[1:3] == asked[5:7] == ["slope", slopes]


@pytest.mark.parametrize("method", [pytest.param("direct", marks=pytest.mark.slow), "cell-map"])
def test_the_copied_words_give_the_data_of_the_picture(client, method, tmp_path, monkeypatch, run):
    """The command, the program and the download, of a window off the home one."""
    cells = [1, 130, 300, 60, 40]
    asked = SIMPLEST | {"method": method, "cells": cells}
    words = client.ask("/api/words", asked).json()
    names = {}
    exec(compile(words["python"], "copied", "exec"), names)
    basin = names["basin"]
    assert basin["fate"].shape == (60, 40)
    explorer_server.run_copied(run, words["command"], basin, monkeypatch)
    packed = measures.data(subject(), Rectangle(1, (130, 300), (60, 40)), method)
    (tmp_path / "data.zip").write_bytes(packed)
    with ZipStore(tmp_path / "data.zip", mode="r") as place:
        data = xr.open_zarr(place, consolidated=False).load()
    assert data.identical(basin.assign_attrs(data.attrs)) and data.attrs == basin.attrs
    # and the picture itself
    if method == "direct":
        _, tiles = client.tiles(SIMPLEST | {"tiles": [[1, i, j] for i in (2, 3) for j in (6,)]})
        label = np.concatenate([np.frombuffer(t, np.uint8).reshape(2, 50, 50)[0] for t in tiles])
        shown = label[30:90, 0:40]
    else:
        frames = client.frames(SIMPLEST | {"method": method, "rectangles": [cells]})
        shown = np.frombuffer(frames[1].content[4:], np.uint8).reshape(2, 60, 40)[0]
    number = np.where(shown >= FIRST, shown.astype(int) - FIRST, -1)
    np.testing.assert_array_equal(number >= 0, basin["attractor"] >= 0)
    np.testing.assert_array_equal(shown[number < 0], basin["fate"].values[number < 0])


@pytest.mark.slow  # the gait of a walker with heavy legs takes long to compile
def test_the_command_of_a_slice_names_its_plane():
    asked = {"walker": "round-foot", "at": {"phidot": -0.02}, "cells": [0, 0, 0, 20, 20]}
    about = read_subject(asked)
    words = service.copies.describe(about, Rectangle(0, (0, 0), (20, 20)), "direct")
    assert " --at-phidot -0.02 " in words["command"] and "phidot=-0.02" in words["python"]
    # that of the gait, whatever others have asked for
    about = read_subject({"walker": "round-foot"})
    (at,) = pictures.plane_of(about)
    gait = wj.find_gait(about.walker)
    assert at == pytest.approx(float(gait.states[0, 2]), rel=1e-9)
    pictures.plane_of(read_subject({"walker": "round-foot", "parameters": {"slope": 0.012}}))
    words = service.copies.describe(about, Rectangle(0, (0, 0), (20, 20)), "direct")
    assert f" --at-phidot {at!r} " in words["command"]


def test_the_page_knows_every_walker_and_parameter():
    told = describe_family(FAMILY)
    assert json.dumps(told, allow_nan=False)
    for name, kind in PLANAR_WALKERS.items():
        shown = told["walkers"][name]["parameters"]
        assert [one["name"] for one in shown] == [one.name for one in parameters(kind)]
        for one, parameter in zip(shown, parameters(kind), strict=True):
            assert one["low"] <= one["default"] <= one["high"] and one["low"] < one["high"]
            parameter.convert(one["low"])
            parameter.convert(one["high"])


# ---------------------------------------------------------------------------- workers


# ---------------------------------------------------------------------------- the command


def test_help_and_import_load_no_server():
    program = (
        "import sys, walker_jax\n"
        "from walker_jax.cli.app import app\n"
        "loaded = [name for name in ('starlette', 'uvicorn', 'jax') if name in sys.modules]\n"
        "assert not loaded, loaded\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_only_what_is_drawn_and_in_a_file_is_explored():
    class Own(wj.SimplestWalker):
        pass

    with pytest.raises(ValueError, match=r"that other processes can import: write Own into a file"):
        wj.explore(Own(0.004))
    with pytest.raises(ValueError, match="has a section of one coordinate, and pictures have two"):
        wj.explore(wj.systems.SpringMassRunner())
    with pytest.raises(ValueError, match="height must be at least 100"):
        wj.explore(wj.SimplestWalker(0.004), height=1)


@pytest.mark.slow
def test_a_notebook_shows_the_page_of_the_command_in_a_frame(monkeypatch):
    """The command prints its link, serves, and ends on an interrupt."""
    monkeypatch.setenv("WALKER_JAX_TOKEN", explorer_server.TOKEN)
    shown = wj.explore(wj.SpringWalker(0.005, 1.5), height=500)
    try:
        link = r"http://127\.0\.0\.1:(\d+)/\?token=(.*)#walker=spring&slope=0.005&hip_stiffness=1.5"
        found = re.fullmatch(link, shown.link)
        assert found and found[2] == explorer_server.TOKEN
        again = wj.explore(wj.SimplestWalker(0.006))  # by the same server
        assert (
            again.link
            == f"http://127.0.0.1:{found[1]}/?token={found[2]}#walker=simplest&slope=0.006"
        )
        frame = shown._repr_html_()
        assert 'height="500"' in frame and html.escape(shown.link) in frame
        client = explorer_server.Client(int(found[1]))
        assert client.ask("/api/alive").json() == {"alive": True}
        client.connection.close()
        shown.server.process.send_signal(signal.SIGINT)
        assert shown.server.process.wait(60) == 130
    finally:
        shown.close()
    with pytest.raises(ConnectionError):
        client.ask("/api/alive")
    # a server that does not start says why
    monkeypatch.setattr("sys.executable", "/bin/false" if Path("/bin/false").exists() else "false")
    with pytest.raises(wj.ComputationFailed, match="the server ended with code 1"):
        wj.explore(wj.SimplestWalker(0.004))


def test_a_port_that_is_taken_is_named():
    with listen("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        said = rf"cannot listen on 127\.0\.0\.1, port {port}: .+; give another --host or --port"
        with pytest.raises(wj.ComputationFailed, match=said):
            listen("127.0.0.1", port)


def test_a_walker_in_space_is_a_slice_of_its_section():
    """Along any two coordinates, without a film, in the words of walkers."""
    about = describe_family(FAMILY)["walkers"]["spatial"]
    assert about["walker"] and not about["film"] and about["spans"] == {}
    assert len(about["planes"]) == 21 and next(iter(about["planes"])) == "theta-thetadot"
    others = about["planes"]["theta-thetadot"]["others"]
    assert others == ("yaw", "phi", "yawdot", "leandot", "phidot")
    for name, one in about["coordinates"].items():
        assert one["low"] < one["high"] and one["label"], name
    assert offers.offer(wj.SpatialWalker()) is FAMILY["spatial"]


@pytest.mark.slow  # it takes a minute to compile
def test_the_slice_of_a_walker_in_space_goes_through_its_gait(client):
    asked = {"walker": "spatial", "tiles": [[-1, 1, 1]]}
    (attractor,), (tile,) = client.tiles(asked)
    walker = wj.SpatialWalker()
    gait = np.asarray(wj.find_gait(walker).states[0])
    np.testing.assert_allclose(attractor["states"][0], gait, atol=1e-6)
    for name, (low, high) in offers.window_of(FAMILY["spatial"]).items():
        assert low < gait[walker.section.index(name)] < high
    label = np.frombuffer(tile, np.uint8)[: TILE * TILE]
    assert (label >= FIRST).any() and (label < FIRST).any()
    walk = client.ask("/api/walk", asked | {"start": gait.tolist(), "strides": 3}).json()
    assert walk["leg"] is None and [one["outcome"] for one in walk["strides"]] == [0] * 3
    cells = {"cells": [-1, 50, 50, 20, 20]}
    words = client.ask("/api/words", asked | cells).json()
    assert words["command"].startswith("walker-jax basin --walker spatial --slope 0.0702 ")
    assert " --axis theta=" in words["command"] and "wj.SpatialWalker(slope=" in words["python"]


def test_what_compiles_is_told_with_its_seconds(client):
    told = lambda name: client.ask("/api/compiling", {"walker": name}).json()["seconds"]
    assert told("kneed") >= SECONDS["kneed"] and told("upper-body") > told("spring") > 0
    client.tiles(SIMPLEST | {"tiles": [[0, 0, 0]]})
    assert told("simplest") == 0
    assert {*SECONDS} == {*FAMILY, *OTHERS}


def test_seconds_to_compile_grow_on_a_slow_machine():
    times, simplest, kneed = CompileTimes(), FAMILY["simplest"], FAMILY["kneed"]
    assert times.estimate(kneed) == SECONDS["kneed"]
    times.record(simplest, 0.1)  # of programs in a cache
    assert times.estimate(kneed) == SECONDS["kneed"]
    times.record(simplest, 4.0 * SECONDS["simplest"])
    assert times.estimate(kneed) == pytest.approx(2.0 * SECONDS["kneed"], rel=0.02)
    own = dataclasses.replace(kneed, name="own", kind=type("Own", (wj.KneedWalker,), {}))
    assert times.estimate(own) == times.estimate(kneed)
    assert times.estimate(dataclasses.replace(kneed, name="own", kind=wj.System)) is None


def test_tiles_of_a_batch_are_written_at_once():
    """Of many writes to a page that has gone asyncio would warn."""

    async def read():
        tiles = [pictures.Tile(0, i, 0) for i in range(service.FIRST_BATCH)]
        return [piece async for piece in service.Service().tiles(subject(), tiles)]

    (piece,) = asyncio.run(read())
    assert [one.kind for one in explorer_server.split(piece)] == [0, *[1] * service.FIRST_BATCH]


def test_a_subject_is_one_key():
    assert subject(slope=0.004) == subject() and hash(subject()) == hash(subject())
    assert isinstance(subject(), Subject) and subject().parameters == {"slope": 0.004}
    assert zipfile.is_zipfile(io.BytesIO(measures.zipped(xr.Dataset({"x": 1}))))
