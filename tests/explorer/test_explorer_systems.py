"""The explorer with systems that are no walkers: maps and machines."""

import json
import pickle
import sys
from typing import Any

import explorer_server
import jax.numpy as jnp
import numpy as np
import pytest
from explorer_subjects import few, parts_and_result

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.explorer import measures, notebook, pictures
from walker_jax.explorer.copies import describe
from walker_jax.explorer.family import describe_family
from walker_jax.explorer.lattice import TILE, Rectangle, home_of
from walker_jax.explorer.offers import FAMILY, OTHERS, Offer, beside, offer, window_of
from walker_jax.explorer.subjects import read_subject
from walker_jax.systems.outcomes import OWN
from walker_jax.walkers.references import find_system, reference_of

HENON = '''
import jax.numpy as jnp

import walker_jax as wj


def own_henon(x, a, b):
    """The map of Hénon, once more."""
    return jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])


system = wj.Map(
    own_henon,
    ("x", "y"),
    parameters={"a": 1.02, "b": 0.3},
    feasible=lambda x, a, b: 100 - jnp.sum(x**2),
)
'''
AXES = {"x": (-2.0, 2.0, 9), "y": (-2.0, 2.0, 9)}
TILES = [[-2, 0, 0], [-2, 0, 1]]


class Drift(wj.System):
    """Three numbers, of which the first dies out where the second is large.

    The third halves.
    """

    rate: float = 0.5
    tilt: float = 0.0

    section = "here", "there", "rest"
    failures = ("dies_out",)

    def advance(self, x):
        outcome = jnp.where(x[1] > 1, self.failure("dies_out"), wj.Outcome.STRIDE)
        return jnp.stack([self.rate * x[0] + x[2], self.rate * x[1], x[2] / 2]), outcome, 1.0

    def gait_region(self):
        axes = {"here": (-1, 1, 4), "there": (-2, 2, 4), "rest": (-1, 1, 4)}
        return wj.Grid(axes, np.array([[1.0, 0, 1], [0, 1, 0], [0, 0, 1]]))


class Thrown(wj.SimplestWalker):
    failures = ("is_thrown",)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    with explorer_server.own_file(tmp_path_factory.mktemp("own"), "own_henon", HENON) as file:
        yield file


@pytest.fixture(scope="module")
def own(file):
    system: Any = find_system(f"{file}:system")
    return offer(system, AXES)


@pytest.fixture(scope="module")
def client(own):
    drift = offer(Drift())
    with explorer_server.running(offers=OTHERS | {drift.name: drift, own.name: own}) as server:
        yield server.client()


def subject(offered, **asked):
    return read_subject({"walker": offered.name} | asked, {offered.name: offered})


def test_the_page_knows_every_system_of_two_coordinates():
    assert {*OTHERS} == {
        *("henon", "duffing", "bouncing-ball", "impact-oscillator"),
        *("spring-biped", "quadruped", "hopper", "torso-wheel", "five-link-biped"),
    }  # the compass needs a slope, others have one coordinate
    told = describe_family(OTHERS)
    assert json.dumps(told, allow_nan=False)
    for name, shown in told["walkers"].items():
        kind = OTHERS[name].kind
        assert not shown["film"] and shown["about"] and "`" not in shown["about"]
        assert shown["section"] == kind.section
        assert {*shown["coordinates"]} == {*kind.section}
        for one, about in shown["coordinates"].items():
            assert about["label"] == about["symbol"] == one.replace("_", " ")
            assert about["low"] < about["high"] and not about["unit"]
        count = len(kind.section)
        assert len(shown["planes"]) == count * (count - 1) / 2
        assert {*shown["spans"]} == {one["name"] for one in shown["parameters"]}
        assert all(low < high for low, high in shown["spans"].values())
        for one, parameter in zip(shown["parameters"], OTHERS[name].parameters, strict=True):
            assert one["low"] <= one["default"] <= one["high"]
            parameter.convert(one["low"])
            parameter.convert(one["high"])  # also where the bound is not a value itself
    assert not {*OTHERS} & {*beside(FAMILY["spring"])} and "spring" not in beside(OTHERS["henon"])


def test_each_has_its_own_words_for_its_own_failures():
    drift, thrown = offer(Drift()), offer(Thrown(jnp.array(0.004)))
    told = describe_family({"Drift": drift, "Thrown": thrown, "simplest": FAMILY["simplest"]})
    assert {*told["fates"]} == {*range(1, OWN)}
    own = {name: shown["fates"] for name, shown in told["walkers"].items()}
    assert own["Drift"][12]["words"] == "dies out" and own["Drift"][12]["lost"]
    assert own["Drift"][wj.Outcome.OUTSIDE]["words"] == "infeasible"
    assert own["Thrown"][12]["words"] == "is thrown" and {*own["Thrown"]} == {12}
    assert own["simplest"] == {}
    assert own["Drift"][12]["colour"] == own["Thrown"][12]["colour"]


def test_the_window_is_that_of_gaits_or_of_the_command():
    assert home_of(OTHERS["henon"], "x-y")[:2] == ((-2.0, -2.0), (2.0, 2.0))
    drift = offer(Drift())  # whose region is sheared
    assert window_of(drift) == {"here": (-2, 2), "there": (-2, 2), "rest": (-1, 1)}
    assert [*drift.planes] == ["here-there", "here-rest", "there-rest"]
    axes = {"here": 0.1, "there": (-3.0, 1.0, 5), "rest": (0.0, 2.0, 5)}
    given = offer(Drift(0.25), axes)
    assert next(iter(given.planes)) == "there-rest"
    assert home_of(given, "there-rest")[:2] == ((-3.0, 0.0), (1.0, 2.0))
    assert window_of(given)["here"] == (-2, 2)
    assert given.defaults == (0.25, 0.0)
    far = offer(Drift(), axes | {"here": 9.0})
    assert window_of(far)["here"] == (8, 10)
    henon = offer(wj.systems.HenonMap(1.02), AXES)
    assert (henon.name, henon.defaults) == ("henon", (1.02, 0.3))
    assert offer(wj.systems.HenonMap(1.02)) is OTHERS["henon"]
    compass = offer(wj.systems.SwitchedCompass(0.04))
    assert compass.name == "switched-compass" and compass.defaults[0] == 0.04
    assert window_of(compass)["thetadot"] == (-1.2, pytest.approx(0.3))


def test_a_picture_is_the_basin(client):
    asked = {"walker": "henon", "parameters": {"a": 0.7}, "tiles": TILES}
    attractors, tiles = client.tiles(asked)
    label = np.concatenate(
        [np.frombuffer(one, np.uint8).reshape(2, TILE, TILE)[0] for one in tiles], axis=1
    )
    grid = wj.Grid.plain(x=(-2, 2, 50), y=(-2, 2 + 4 * 37.5 / 62.5, 100))
    basin = wj.basin(wj.systems.HenonMap(0.7), grid, "direct")
    walks_on = label >= pictures.FIRST_ATTRACTOR
    assert [one["period"] for one in attractors] == basin["period"].values.tolist() == [2]
    np.testing.assert_array_equal(walks_on, basin["attractor"].values >= 0)
    np.testing.assert_array_equal(label[~walks_on], basin["fate"].values[~walks_on])
    assert 1000 < walks_on.sum() < 4000


def test_a_slice_is_of_any_two_coordinates(client):
    asked = {"walker": "Drift", "section": "here-rest", "tiles": [[-2, 0, 0]]}
    for at, fate in (({}, pictures.FIRST_ATTRACTOR), ({"there": 1.5}, OWN)):
        frames = client.frames(asked | {"at": at})
        told = json.loads(frames[0].content)
        assert told["at"] == pytest.approx([at.get("there", 0.0)], abs=1e-9)
        labels = np.frombuffer(frames[1].content[4:], np.uint8).reshape(2, TILE, TILE)[0]
        assert (labels == fate).all()
    wrong = client.ask("/api/picture", asked | {"at": {"here": 0.5}})
    assert wrong.json()["error"] == "at must name coordinates among there, not 'here'"
    wrong = client.ask("/api/picture", asked | {"section": "sheared"})
    assert wrong.json()["error"].startswith("section must be one of here-there, here-rest, ")


def test_a_start_has_iterates_and_no_film(client):
    asked = {"walker": "Drift", "start": [0.5, 3.0, 0.2]}
    assert client.ask("/api/walk", asked).json() == {
        "strides": [{"start": [0.5, 3.0, 0.2], "outcome": 12, "duration": 0.0, "frames": []}],
        "next": None,
        "leg": None,
    }
    answer = client.ask("/api/walk", asked | {"start": [0.5, 0.9, 0.2], "strides": 9}).json()
    made = wj.walk(Drift(), jnp.array([0.5, 0.9, 0.2]), 9)
    starts = [one["start"] for one in answer["strides"]] + [answer["next"]]
    np.testing.assert_allclose(starts, made.states, rtol=1e-15)
    pushed = client.ask("/api/walk", asked | {"push": [0.1, 0.0]})
    assert pushed.json()["error"].startswith("Drift cannot be pushed")


def test_what_is_copied_gives_the_data_of_the_picture(own, monkeypatch, run):
    """Of a map in a file, and of a slice along coordinates that are not the first."""
    monkeypatch.setitem(sys.modules, "own_henon", sys.modules["own_henon"])  # as it is
    about = subject(own, parameters={"a": 0.5})
    words = describe(about, Rectangle(-3, (2, 3), (12, 10)), "direct")
    names = {}
    exec(compile(words["python"], "copied", "exec"), names)
    assert float(names["system"].a) == 0.5
    assert names["basin"].attrs["code"] == own.code
    explorer_server.run_copied(run, words["command"], names["basin"], monkeypatch)

    drift = offer(Drift())
    about = subject(drift, section="here-rest", at={"there": 0.25})
    words = describe(about, Rectangle(0, (0, 0), (200, 250)), "direct")
    command = f"walker-jax basin --system {reference_of(Drift)} --rate 0.5 --tilt 0.0 "
    axes = "--axis here=-2.0:2.0:200 --axis there=0.25 --axis rest=-1.0:1.0:250 "
    assert words["command"].startswith(command + axes)
    (line,) = (one for one in words["python"].split("\n") if one.startswith("grid = "))
    grid = eval(line.removeprefix("grid = "), {"wj": wj})
    assert grid.shape == (200, 250) and grid.centre(0)[1] == 0.25
    last = subject(drift, section="here-there", at={"rest": 0.5})
    assert "rest=0.5)" in describe(last, Rectangle(0, (0, 0), (2, 2)), "direct")["python"]


def test_cycles_and_their_bifurcations(own, monkeypatch):
    """Of a map without a region, in its window; over any parameter of one that has a region."""
    found = measures.gaits(subject(own))
    assert [one["period"] for one in found if one["stable"]] == [4]  # as of the attractor
    gaits = wj.find_gaits(wj.systems.HenonMap(1.02), 1)
    for one, gait in zip((one for one in found if one["period"] == 1), gaits, strict=True):
        assert np.abs(np.array(one["states"]) - np.array([g.states for g in gaits])).min() < 1e-9
        assert not gait.stable
    assert measures.disturbance(subject(own)) is None
    assert not own.spans
    for name, value in few(5, strides=200).items():
        monkeypatch.setattr(measures, name, value)
    _, diagram = parts_and_result(measures.bifurcation(subject(OTHERS["henon"]), "b"))
    assert diagram["range"] == OTHERS["henon"].spans["b"] == (0.15, pytest.approx(0.45))
    assert json.dumps(diagram, allow_nan=False) and len(diagram["branches"]) > 0


def test_a_map_goes_to_other_processes_by_its_name(own):
    again = pickle.loads(pickle.dumps(own))
    assert again == own and again.kind.f is own.kind.f  # though a function of it has no name


def test_commands_and_notebooks_name_it(file, own, monkeypatch, run):
    assert reference_of(own.kind) == f"{file}:system"
    assert reference_of(wj.systems.HenonMap) == "henon"
    monkeypatch.setitem(sys.modules, "own_henon", sys.modules["own_henon"])  # as it is
    served = []
    monkeypatch.setattr(
        "walker_jax.explorer.server.run_server", lambda *given, **_: served.append(given)
    )
    words = ["--system", f"{file}:system", "--b", "0.2", "--axis", "x=-1:1:9", "--axis", "y=0:1:9"]
    code, _, err = run("explore", *words, "--no-browser")
    assert code == 0, err
    ((_, _, offered, values),) = served
    assert values == {"a": 1.02, "b": 0.2} and offered.defaults == (1.02, 0.2)
    assert offered.name == "own_henon" and window_of(offered) == {"x": (-1, 1), "y": (0, 1)}

    class Server(notebook.PageServer):
        link, serves = "http://127.0.0.1:1/?token=x", property(lambda self: True)

        def __init__(self, options, code):
            self.options, self.code = options, code

    monkeypatch.setattr(notebook, "PageServer", Server)
    monkeypatch.setattr(notebook, "started", {})
    henon: Any = notebook.explore(wj.systems.HenonMap(1.02))
    duffing = notebook.explore(wj.systems.DuffingOscillator())
    assert henon.server is duffing.server and henon.server.options == ["--system", "henon"]
    assert henon.link.endswith("#walker=henon&a=1.02&b=0.3")
    assert notebook.explore(wj.SimplestWalker(0.004)).server is not henon.server
    compass: Any = notebook.explore(wj.systems.SwitchedCompass(0.04))
    assert compass.server.options[:4] == ["--system", "switched-compass", "--slope", "0.04"]
    with pytest.raises(WrongUse, match="has no gait_region"):
        notebook.explore(own.kind)


def test_a_map_of_a_function_has_that_as_what_it_is_about(own):
    told = describe_family({"own_henon": own})["walkers"]["own_henon"]
    assert told["about"] == "The map of Hénon, once more." and told["spans"] == {}
    assert [one["name"] for one in told["parameters"]] == ["a", "b"]
    assert isinstance(own, Offer) and own != OTHERS["henon"]
