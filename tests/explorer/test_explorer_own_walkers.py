"""The explorer with a walker of a user's own."""

import asyncio
import sys
from typing import Any

import explorer_server
import jax.numpy as jnp
import numpy as np
import pytest
from networks import NetworkWalker

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.explorer import notebook, pictures, walks, workers
from walker_jax.explorer.family import describe_offer
from walker_jax.explorer.lattice import HOME_CELLS, TILE, Tile, home_of
from walker_jax.explorer.offers import FAMILY, offer
from walker_jax.explorer.subjects import read_subject
from walker_jax.walkers.kneed import LockedWalker
from walker_jax.walkers.references import find_walker, reference_of

TORQUE = '''
import jax

import walker_jax as wj


class Damped(wj.SimplestWalker):
    """A damper at the hip of the simplest walker."""

    damping: jax.Array
    unused: jax.Array = 0.5

    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - self.damping * state.phidot)


class Unlike(wj.SimplestWalker):
    damping: jax.Array = 0.0

    def clearance(self, state):
        return 0.0 * state.theta


class Viewed(wj.SimplestWalker):
    view: jax.Array = 0.0


def make():
    class Hidden(Damped):
        pass

    return Hidden


Hidden = make()
system = wj.Map(lambda x, a: a * x, ("x", "y"), parameters={"a": 0.5})
'''
TILES = [[-1, i, j] for i in range(2) for j in range(2)]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    with explorer_server.own_file(tmp_path_factory.mktemp("own"), "damped_walkers", TORQUE) as file:
        yield file


@pytest.fixture(scope="module")
def walker(file):
    kind: Any = find_walker(f"{file}:Damped")
    return kind(jnp.array(0.006), jnp.array(0.02), jnp.array(0.5))


@pytest.fixture(scope="module")
def client(walker):
    offered = offer(walker)
    with explorer_server.running(offers=FAMILY | {offered.name: offered}) as server:
        yield server.client()


def test_the_page_offers_it_beside_the_family_and_nothing_else(client, file, walker):
    told = client.ask("/api/about").json()["walkers"]
    assert [*told] == [*FAMILY, "Damped"]
    shown = told["Damped"]
    assert shown["about"] == "A damper at the hip of the simplest walker."
    values = {one["name"]: one["default"] for one in shown["parameters"]}
    assert values == {"slope": 0.006, "damping": 0.02, "unused": 0.5}
    for one in shown["parameters"]:
        assert one["low"] < one["default"] < one["high"]
    for name in (f"{file}:Damped", f"{file}:Unlike", "damped_walkers:Damped", "Unlike", "__main__"):
        answer = client.ask("/api/home", {"walker": name})
        assert answer.status == 400
        assert answer.json()["error"].startswith("walker must be one of simplest, ")
    assert not describe_offer(offer(sys.modules["damped_walkers"].Unlike(jnp.array(0.01))))["about"]


@pytest.mark.slow
def test_picture_walk_and_copies_are_those_of_the_library(client, file, walker, monkeypatch, run):
    asked = {"walker": "Damped", "parameters": {"slope": 0.007, "damping": 0.02, "unused": 0.5}}
    _, tiles = client.tiles(asked | {"tiles": TILES})
    label = np.stack([np.frombuffer(one, np.uint8).reshape(2, TILE, TILE)[0] for one in tiles])
    label = label.reshape(2, 2, TILE, TILE).transpose(0, 2, 1, 3).reshape(2 * TILE, 2 * TILE)
    words = client.ask("/api/words", asked | {"cells": [-1, 0, 0, 100, 100]}).json()
    names = {}
    exec(compile(words["python"], "copied", "exec"), names)
    basin = names["basin"]
    assert type(names["walker"]) is type(walker) and basin.attrs["walker_damping"] == 0.02
    walks_on = label >= pictures.FIRST_ATTRACTOR
    np.testing.assert_array_equal(walks_on, basin["attractor"] >= 0)
    np.testing.assert_array_equal(label[~walks_on], basin["fate"].values[~walks_on])
    assert 100 < walks_on.sum() < 2000

    start = basin["states"].values[0, 0]
    (one,) = client.ask("/api/walk", asked | {"start": start.tolist(), "strides": 1}).json()[
        "strides"
    ]
    times = np.linspace(0, one["duration"], len(one["frames"]))
    frames = np.stack(wj.trajectory(names["walker"], start, times), axis=1)
    np.testing.assert_allclose(one["frames"], frames, atol=1e-7)

    monkeypatch.setitem(sys.modules, "damped_walkers", sys.modules["damped_walkers"])  # as it is
    # in a folder where the file is not
    stored = explorer_server.run_copied(run, words["command"], basin, monkeypatch)
    assert stored["code"] == basin.attrs["code"]


def test_a_worker_loads_the_class_unless_its_file_has_changed(walker, tmp_path, monkeypatch):
    about = read_subject({"walker": "Damped"}, {"Damped": offer(walker)})
    made = offer(sys.modules["damped_walkers"].system, {"x": (0, 1, 9), "y": (0, 1, 9)})
    of_map = read_subject({"walker": made.name}, {made.name: made})
    other = tmp_path / "edited_walker.py"
    other.write_text(TORQUE)
    monkeypatch.syspath_prepend(tmp_path)
    kind: Any = find_walker(f"{other}:Damped")
    edited = read_subject(
        {"walker": "Damped"}, {"Damped": offer(kind(*jnp.array([0.006, 0.02, 0.5])))}
    )
    other.write_text(TORQUE.replace("- self.damping", "+ self.damping"))

    async def use():
        crew = workers.Workers(1)
        try:
            assert await crew.ask(walks.leg_of, about) == {"length": 1.0, "radius": 0.0}
            assert await crew.ask(walks.leg_of, of_map) is None
            with pytest.raises(workers.Failure, match="the code of Damped has changed"):
                await crew.ask(walks.leg_of, edited)
        finally:
            crew.stop()

    asyncio.run(use())
    del sys.modules["edited_walker"]


def test_what_is_not_known_of_a_walker_is_said_in_a_sentence(file):
    """A walker with legs of no length is not drawn, one without masses is not pushed."""
    flat = offer(sys.modules["damped_walkers"].Unlike(jnp.array(0.006)))
    subject = read_subject({"walker": "Unlike"}, {"Unlike": flat})
    with pytest.raises(WrongUse, match="Unlike cannot be drawn"):
        walks.follow(subject, np.array([0.2, -0.2]), 1)
    spatial, start = read_subject({"walker": "spatial"}, FAMILY), np.zeros(7)
    with pytest.raises(WrongUse, match="spatial cannot be pushed: it does not say where its mas"):
        walks.push(spatial, start, np.array([0.1, 0.0]))
    viewed = sys.modules["damped_walkers"].Viewed(jnp.array(0.006))
    with pytest.raises(WrongUse, match="address has a view of its own: rename the parameter"):
        offer(viewed)


def test_commands_and_notebooks_name_it_for_other_processes(file, walker, monkeypatch, run):
    assert reference_of(type(walker)) == f"{file}:Damped"
    assert reference_of(wj.SpringWalker) == "spring"
    assert reference_of(LockedWalker) == "walker_jax.walkers.kneed:LockedWalker"
    assert find_walker(reference_of(LockedWalker)) is LockedWalker

    monkeypatch.setitem(sys.modules, "damped_walkers", sys.modules["damped_walkers"])  # as it is
    served = []
    monkeypatch.setattr(
        "walker_jax.explorer.server.run_server", lambda *given, **_: served.append(given)
    )
    given = ["--slope", "0.007", "--damping", "0.02", "--no-browser"]
    assert run("explore", "--walker", f"{file}:Damped", *given)[0] == 0
    code, _, err = run("explore", "--walker", f"{file}:Hidden", *given)
    assert code == 2 and "--walker must be of a class that other processes can import" in err
    ((_, _, offered, values),) = served
    assert (offered.name, values) == ("Damped", {"slope": 0.007, "damping": 0.02, "unused": 0.5})

    class Server(notebook.PageServer):
        link, closed = "http://127.0.0.1:1/?token=x", False
        serves = property(lambda self: not self.closed)

        def __init__(self, options, code):
            self.options, self.code = options, code

        def close(self):
            self.closed = True

    monkeypatch.setattr(notebook, "PageServer", Server)
    monkeypatch.setattr(notebook, "started", {})
    kind: Any = find_walker(f"{file}:Damped")
    shown: Any = notebook.explore(kind(*jnp.array([0.006, 0.02, 0.5])))
    assert shown.server.options == [
        *("--walker", f"{file}:Damped", "--slope", "0.006"),
        *("--damping", "0.02", "--unused", "0.5"),
    ]
    assert shown.link.endswith("#walker=Damped&slope=0.006&damping=0.02&unused=0.5")
    assert notebook.explore(kind(*jnp.array([0.01, 0.02, 0.5]))).server is shown.server
    assert notebook.explore(wj.SimplestWalker(0.004)).server is not shown.server
    monkeypatch.setattr(shown.server, "code", "of before")  # as after a change of the file
    assert notebook.explore(kind(*jnp.array([0.01, 0.02, 0.5]))).server is not shown.server
    assert shown.server.closed


@pytest.mark.slow
def test_a_picture_of_a_walker_with_a_network_is_its_basin():
    """The page asks for its slope alone; the network is that of the class."""
    offered = offer(NetworkWalker(0.009))
    subject = read_subject(
        {"walker": "NetworkWalker", "parameters": {"slope": 0.01}, "section": "plain"},
        {"NetworkWalker": offered},
    )
    home = home_of(offered, "plain")
    width = (np.array(home.upper) - home.lower) / HOME_CELLS
    of_gait = np.array(np.subtract(home.gait, home.lower) / width / TILE, int)
    cells = pictures.label_tiles(subject, [Tile(0, *of_gait.tolist())])[0]
    label, _ = np.frombuffer(cells, np.uint8).reshape(2, TILE, TILE)
    within = np.indices((TILE, TILE)).reshape(2, -1).T
    places = home.lower + width * (TILE * of_gait + within + 0.5)
    fate, _ = explorer_server.follow(NetworkWalker(0.01), places, 60)
    falls = label.ravel() < pictures.FIRST_ATTRACTOR
    assert 0.01 < falls.mean() < 0.99
    np.testing.assert_array_equal(label.ravel()[falls], fate[falls])
    assert (fate[~falls] == wj.Outcome.STRIDE).all()
