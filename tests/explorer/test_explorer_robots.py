"""A robot from a file on the explorer's page."""

import json
import pickle
import re

import explorer_server
import numpy as np
import pytest
from explorer_server import run_copied
from robot_examples import FILES, as_robot

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.explorer import measures, pictures
from walker_jax.explorer.offers import beside, flag_of, offer
from walker_jax.explorer.subjects import read_subject

GAIT = as_robot((0.28809807504, -0.35705418063, -0.20285043033))
RECTANGLE = [-3, 8, 12, 5, 6]
"""Of 5 x 6 cells, around the gait."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """compass.xml with a keyframe at its gait, so that no search is needed."""
    qpos, qvel = "0 .95 -.28809807504 .28809807504", f"0 0 {GAIT[1]} {GAIT[2]}"
    key = f'<keyframe><key qpos="{qpos}" qvel="{qvel}"/></keyframe></mujoco>'
    path = tmp_path_factory.mktemp("robots") / "compass.xml"
    path.write_text((FILES / "compass.xml").read_text().replace("</mujoco>", key))
    return wj.robot(path)


@pytest.fixture(scope="module")
def client(robot):
    with explorer_server.running(offers=beside(offer(robot))) as server:
        yield server.client()


def asked(**more):
    return {"walker": "compass", "parameters": {"slope": 0.05}} | more


def test_a_robot_has_a_page_in_the_words_of_walkers(client):
    about = client.ask("/api/about").json()["walkers"]
    assert next(iter(about)) == "simplest" and {"compass", "kneed"} <= set(about)
    one = about["compass"]
    assert (one["walker"], one["film"], one["spans"]) == (True, False, {})
    assert next(iter(one["planes"])) == "stance_leg-stance_leg_rate"
    assert {"slope", "leg_mass", "gravity"} <= {each["name"] for each in one["parameters"]}
    home = client.ask("/api/home", asked()).json()
    assert np.abs(np.array(home["gait"]) - GAIT).max() < 1e-6
    assert home["lower"] == pytest.approx(GAIT[:2] - abs(GAIT[:2]) / 2, rel=1e-6)


def test_its_picture_and_its_walk_are_those_of_the_package(client, robot):
    attractors, (tile, *_) = client.tiles(asked(tiles=[[-3, 0, 0]]))
    assert np.abs(np.array(attractors[0]["states"][0]) - GAIT).max() < 1e-6
    labels = np.frombuffer(tile, np.uint8)[: len(tile) // 2]
    assert (labels >= pictures.FIRST_ATTRACTOR).any() and (labels == wj.Outcome.FORWARD).any()
    made = client.ask("/api/walk", asked(start=(1.01 * GAIT).tolist(), strides=3)).json()
    states = [one["start"] for one in made["strides"]]
    np.testing.assert_allclose(states, wj.walk(robot, 1.01 * GAIT, 2).states, rtol=1e-9)


def test_workers_get_it_whole_and_its_copies_give_the_data(
    client, robot, run, tmp_path, monkeypatch
):
    offered = offer(robot)
    again = pickle.loads(pickle.dumps(offered))
    assert again == offered and again.build(again.defaults).machine == robot.machine
    subject = read_subject(asked(), {"compass": again})
    (gait,) = (one for one in measures.gaits(subject) if one["period"] == 1 and one["stable"])
    assert np.abs(np.array(gait["states"][0]) - GAIT).max() < 1e-6
    words = client.ask("/api/words", asked(cells=RECTANGLE)).json()
    names = {}
    exec(compile(words["python"], "copied", "exec"), names)
    assert names["basin"].fate.shape[:2] == (5, 6)
    monkeypatch.chdir(tmp_path)
    assert re.match(r"walker-jax basin --walker \S+/compass\.xml --", words["command"])
    attributes = run_copied(run, words["command"], names["basin"], monkeypatch)
    assert json.loads(json.dumps(attributes["walker"])) == "compass"


def test_a_robot_with_a_controller_of_a_function_has_no_name():
    robot = wj.robot(FILES / "compass.xml", controller=lambda q, rates, p: {})
    with pytest.raises(WrongUse, match="where other processes can import it"):
        flag_of(offer(robot).kind)
