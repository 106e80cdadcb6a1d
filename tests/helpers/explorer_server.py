"""A server of the explorer's page in this process, and clients that ask it."""

import asyncio
import http.client
import json
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.explorer.guard import TOKEN_HEADER, Bucket
from walker_jax.explorer.offers import FAMILY, Offers
from walker_jax.explorer.server import Server, listen, make_server, names_of

TOKEN = "a-token-for-tests-alone"
DIAGRAM = {
    "range": [0.001, 0.022],
    "whole": True,
    "branches": [{"period": 1, "value": [0.001, 0.02], "state": [[0.1, 0.25]], "stable": [1, 0]}],
    "points": [[0.001 + 0.0001 * k, 0.1 + 0.001 * k] for k in range(150)],
    "lost": [0.0193, 0.0194],
    "events": [{"value": 0.015088, "fold": False, "state": 0.23, "cascade": True}],
}
"""A diagram of few points, in the form in which the server sends one."""


@contextmanager
def own_file(folder: Path, name: str, source: str) -> Iterator[Path]:
    """A user's own file, which is forgotten in the end, with the module that was loaded of it."""
    file = folder / f"{name}.py"
    file.write_text(source)
    yield file
    sys.path.remove(str(folder))
    del sys.modules[name]


class Answer(NamedTuple):
    status: int
    body: bytes

    def json(self) -> Any:
        return json.loads(self.body)


class Frame(NamedTuple):
    kind: int
    content: bytes


class Client:
    """One connection to the server, as of one page."""

    def __init__(self, port: int):
        self.port = port
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)

    def send(
        self, path: str, body: bytes | None = None, method: str = "", **headers: str
    ) -> Answer:
        """One request, with headers in the place of the page's own."""
        own = {"content-type": "application/json", TOKEN_HEADER: TOKEN} | {
            name.replace("_", "-"): value for name, value in headers.items()
        }
        method = method or ("GET" if body is None else "POST")
        try:
            self.connection.request(method, path, body, own)
            answer = self.connection.getresponse()
        except (ConnectionError, http.client.RemoteDisconnected):  # idle for long: once again
            self.connection.close()
            self.connection.request(method, path, body, own)
            answer = self.connection.getresponse()
        return Answer(answer.status, answer.read())

    def ask(self, path: str, asked: Any = None, **headers: str) -> Answer:
        return self.send(path, None if asked is None else json.dumps(asked).encode(), **headers)

    def give_up(self, path: str, asked: Any, wait: Callable[[], Any] = lambda: None) -> None:
        """Ask, wait for something else, and go."""
        headers = {"content-type": "application/json", TOKEN_HEADER: TOKEN}
        self.connection.request("POST", path, json.dumps(asked), headers)
        wait()
        self.connection.close()

    def frames(self, asked: dict) -> list[Frame]:
        """The frames of a picture."""
        answer = self.ask("/api/picture", asked)
        assert answer.status == 200, answer
        return split(answer.body)

    def tiles(self, asked: dict) -> tuple[list[dict], list[bytes]]:
        """The attractors of a picture that were told last, and its tiles in their order."""
        told, tiles = {}, {}
        for kind, content in self.frames(asked):
            if kind == 0:
                told = json.loads(content)
            else:
                tiles[struct.unpack("<I", content[:4])[0]] = content[4:]
        return told["attractors"], [tiles[i] for i in range(len(tiles))]


def split(stream: bytes) -> list[Frame]:
    """The frames of a stream."""
    found = []
    while stream:
        length, kind = struct.unpack("<IB", stream[:5])
        found.append(Frame(kind, stream[5 : 5 + length]))
        stream = stream[5 + length :]
    return found


def follow(walker: wj.Walker, states: np.ndarray, strides: int) -> tuple[np.ndarray, np.ndarray]:
    """Fates of starts, 0 where a walker makes all strides, and strides made."""
    states, fate, count = states.copy(), np.zeros(len(states), int), np.zeros(len(states), int)
    for _ in range(strides):
        active = np.flatnonzero(fate == 0)
        ends = wj.strides(walker, states[active])
        states[active], fate[active] = ends.state, ends.outcome
        count[active] += ends.outcome == 0
    return fate, count


def run_copied(
    run: Callable, command: str, basin: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> dict[str, Any]:
    """Run a copied command: it gives that basin. Returns the attributes of its own."""
    monkeypatch.setattr("walker_jax.cli.answers.draw", lambda *_: None)
    program, *arguments = command.split()
    code, _, err = run(*arguments)
    assert (program, code) == ("walker-jax", 0), err
    (store,) = Path().glob("basin-*.zarr")
    with xr.open_zarr(store, consolidated=False) as data:
        for name in ("fate", "attractor", "strides"):
            np.testing.assert_array_equal(data[name], basin[name])
        return dict(data.attrs)


class Running(NamedTuple):
    server: Server
    port: int
    clients: list[Client]

    def client(self) -> Client:
        """A new connection, which is closed with the server, or before."""
        self.clients.append(Client(self.port))
        return self.clients[-1]

    def settle(self, seconds: float = 60.0) -> None:
        """Wait until every request is answered or given up; raises `TimeoutError` if none is."""
        tasks = list(self.server.server_state.tasks)
        if tasks:
            asyncio.run_coroutine_threadsafe(asyncio.wait(tasks), tasks[0].get_loop()).result(
                seconds
            )


@contextmanager
def running(port: int = 0, host: str = "127.0.0.1", offers: Offers = FAMILY) -> Iterator[Running]:
    """A server on a free port, or on a given one, in a thread."""
    listener = listen(host, port)
    server = make_server(listener, TOKEN, names_of(host, listener), offers)
    guard: Any = server.config.app
    guard.requests = guard.files = guard.others = Bucket(1e9, 1e9)  # tests are faster than hands
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    found = Running(server, listener.getsockname()[1], [])
    try:
        yield found
    finally:
        for client in found.clients:
            client.connection.close()
        server.should_exit = True
        thread.join()
        listener.close()
