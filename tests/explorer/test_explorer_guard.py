"""Whom the explorer's server answers, by which names, and for how long it waits for anybody."""

import asyncio
import json
import re
import socket
import threading
from multiprocessing.connection import Connection
from unittest.mock import Mock

import explorer_server
import pytest
from starlette.responses import PlainTextResponse

from walker_jax.checks import WrongUse
from walker_jax.explorer import connection, pictures, server, service, workers
from walker_jax.explorer.family import describe_family
from walker_jax.explorer.guard import Bucket, Guard, in_link
from walker_jax.explorer.lattice import TILE
from walker_jax.explorer.subjects import FAMILY
from walker_jax.systems.outcomes import OUTCOMES, Outcome

TILES = {"walker": "simplest", "parameters": {"slope": 0.004}, "tiles": [[0, 0, 0]]}


def guarded(names=("localhost",)):
    return Guard(PlainTextResponse("in"), token="token", names=names, port=80)


def send(guard, path="/", query="", address="127.0.0.1", **headers: str):
    """Status and headers of the answer to a request, without a network."""
    told = {"host": "localhost", "x-walker-token": "token"}
    told |= {name.replace("_", "-"): value for name, value in headers.items()}
    scope = {
        "type": "http",
        "method": "GET",
        "path": path,
        "query_string": query.encode("latin-1"),
        "server": (address, 80),
        "headers": [(name.encode(), value.encode()) for name, value in told.items()],
    }
    got = []

    async def receive():
        return {"type": "http.request", "body": b""}

    async def keep(message):
        got.append(message)

    asyncio.run(guard(scope, receive, keep))
    return got[0]["status"], dict(got[0]["headers"])


def test_a_server_that_stops_says_so(monkeypatch):
    """503, upon which the page asks again and finds nobody; no error of the server's, 500."""
    asked, answers = threading.Event(), []

    async def hang(*_):
        asked.set()
        await asyncio.Event().wait()

    monkeypatch.setattr(service.Programs, "ready", hang)
    monkeypatch.setattr(server, "CLOSING_SECONDS", 0)
    with explorer_server.running() as found:
        client = explorer_server.Client(found.port)
        body = {"walker": "simplest", "start": [0.15, -0.16], "strides": 1}
        thread = threading.Thread(target=lambda: answers.append(client.ask("/api/walk", body)))
        thread.start()
        assert asked.wait(60)
    thread.join()
    client.connection.close()
    (answer,) = answers
    assert answer.status == 503 and answer.json() == {"error": "the server stops"}


def test_what_other_sites_send_takes_nothing_from_the_page():
    guard = guarded()
    guard.requests, guard.others = Bucket(0.0, 2.0), Bucket(0.0, 3.0)
    for site in ("cross-site", "same-site"):
        drawn = {"sec_fetch_site": site, "sec_fetch_mode": "no-cors"}
        assert send(guard, "/page/icon.svg", **drawn)[0] == 403
    assert send(guard, "/api/about", x_walker_token="wrong")[0] == 403
    link = {"sec_fetch_site": "cross-site", "sec_fetch_mode": "navigate"}
    assert [send(guard, **link)[0] for _ in range(4)] == [200, 200, 200, 429]
    assert [send(guard, "/api/about")[0] for _ in range(3)] == [200, 200, 429]


def test_requests_without_the_token_take_nothing_from_others(running):
    """Also of the files of the page, which it finds by the token."""
    guard = running.server.config.app
    client = running.client()
    page = client.send("/?token=" + explorer_server.TOKEN, x_walker_token="").body.decode()
    files = re.findall(r'"(/page/[^"]+)"', page)
    assert len(files) > 3 and len({*files}) == 3
    module = next(file for file in files if file.endswith("main.js"))
    imported = re.findall(r'from "\./(\w+\.js)"', client.send(module).body.decode())
    files += [f"{module.rpartition('/')[0]}/{name}" for name in imported]
    for others in (Bucket(0.0, 0.0), Bucket(0.0, 1e9)):
        guard.others = others
        answers = [client.send(file, x_walker_token="") for file in files]
        assert {answer.status for answer in answers} == {200}
        assert client.send(f"/?token={explorer_server.TOKEN}").status == 200
        refused = 200 if others.burst else 429
        for path in ("/", "/?token=wrong", "/page/main.js"):
            assert client.send(path).status == refused
        assert client.send("/page/wrong/main.js").status == (404 if others.burst else 429)
    assert 'src="/page/main.js"' in client.send("/").body.decode()


@pytest.mark.parametrize("token", ["a", "x" * 21, "x" * 30 + " ", "ä" * 30, "x/" * 20, "%41" * 20])
def test_a_token_that_could_be_guessed_is_refused(monkeypatch, token):
    monkeypatch.setenv(server.TOKEN_VARIABLE, token)
    monkeypatch.setattr(server, "listen", lambda *_: 1 / 0)
    with pytest.raises(WrongUse) as refusal:
        server.run_server("127.0.0.1", 0, FAMILY["simplest"], {}, browser=False)
    said = str(refusal.value)
    assert said.startswith("WALKER_JAX_TOKEN must be 22 characters or more, ")
    assert said.endswith(f": this one has {len(token)}") and len(said) < 200
    for good in ("", "x" * 22, server.secrets.token_urlsafe(24)):
        monkeypatch.setenv(server.TOKEN_VARIABLE, good)
        assert server.read_token() == good or (not good and len(server.read_token()) == 32)


def test_only_who_has_the_token_frames_the_page():
    framed = lambda query: (
        b"frame-ancestors" not in send(guarded(), query=query)[1][b"content-security-policy"]
    )
    assert framed("token=token")
    for query in ("", "token=", "token=wrong", "token=%ff", "token=\xff", "x=token"):
        assert not framed(query)


def test_this_machine_goes_by_the_address_of_a_request():
    guard = guarded(("LocalHost", "vm"))
    for host in ("localhost", "vm", "VM:80", "10.0.0.7", "10.0.0.7:80"):
        assert send(guard, host=host, address="::ffff:10.0.0.7")[0] == 200
    assert send(guard, host="[fe80::1]", address="fe80:0::1")[0] == 200
    for host in ("10.0.0.8", "evil.example", "10.0.0.7:81", "10.0.0.7.evil.example"):
        assert send(guard, host=host, address="10.0.0.7")[0] == 403
    assert in_link("::1") == "[::1]" and in_link("127.0.0.2") == "127.0.0.2"


def test_a_link_of_the_command_line_leads_to_the_page_once():
    guard = guarded()
    guard.links["/open/x"] = "http://localhost/?token=token#walker=simplest&slope=0.004"
    status, headers = send(guard, "/open/x", x_walker_token="")
    assert (status, headers[b"location"].decode()) == (
        307,
        "http://localhost/?token=token#walker=simplest&slope=0.004",
    )
    assert b"location" not in send(guard, "/open/x")[1]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.0.0.2", "0.0.0.0"])
def test_every_host_has_a_link_that_is_answered(host, monkeypatch, capsys):
    """Also this machine's own name, where all interfaces are listened to."""
    opened = []
    monkeypatch.setenv(server.TOKEN_VARIABLE, token := "token-of-22-characters")
    monkeypatch.setattr(server.webbrowser, "open", opened.append)
    ran: list = []
    monkeypatch.setattr(server.Server, "run", lambda self, sockets: ran.append((self, sockets[0])))
    with pytest.raises(KeyboardInterrupt):  # that ended it
        server.run_server(host, 0, FAMILY["simplest"], {"slope": 0.004}, browser=True)
    printed = capsys.readouterr()
    ((found, listener),) = ran
    port = listener.getsockname()[1]
    listener.close()
    name = socket.gethostname() if host == "0.0.0.0" else host
    if not server.can_be_found(name):
        name = "localhost"
    assert printed.out == f"http://{name}:{port}/?token={token}#walker=simplest&slope=0.004\n"
    assert ("other machines" in printed.err) == (host == "0.0.0.0")
    assert opened[0].startswith(f"http://{name}:{port}/open/") and token not in opened[0]
    guard = found.config.app
    for host_header in (name, "localhost"):
        scope = {"server": ("127.0.0.1", port)}
        assert f"{host_header}:{port}".lower() in guard.hosts(scope)
    assert f"evil.example:{port}" not in guard.hosts({"server": ("127.0.0.1", port)})


def test_labels_of_attractors_are_none_of_outcomes():
    assert OUTCOMES <= pictures.UNMATCHED < pictures.FIRST_ATTRACTOR
    assert pictures.FIRST_ATTRACTOR + pictures.MAX_ATTRACTORS <= 256
    lost = {code for code, one in describe_family(FAMILY)["fates"].items() if one["lost"]}
    assert {Outcome.FORWARD, Outcome.BACKWARD, Outcome.SCUFFED} < lost
    assert lost.isdisjoint({Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID})


# ---------------------------------------------------------------------------- who keeps it waiting


def closes(other, seconds=10.0):
    """Whether the server closes a connection within a time."""
    other.settimeout(seconds)
    try:
        while other.recv(2**16):
            pass
    except ConnectionError:
        pass
    except TimeoutError:
        return False
    return True


def test_a_request_that_does_not_come_is_not_waited_for(running, monkeypatch):
    monkeypatch.setattr(connection, "HEADER_SECONDS", 0.2)
    monkeypatch.setattr(service, "BODY_SECONDS", 0.2)
    with socket.create_connection(("127.0.0.1", running.port)) as silent:
        assert closes(silent)
    with socket.create_connection(("127.0.0.1", running.port)) as slow:
        slow.sendall(b"GET / HT")
        assert closes(slow)
    client = running.client()
    client.connection.putrequest("POST", "/api/home")
    for name, value in (
        ("content-type", "application/json"),
        ("content-length", "9"),
        (explorer_server.TOKEN_HEADER, explorer_server.TOKEN),
    ):
        client.connection.putheader(name, value)
    client.connection.endheaders()
    assert client.connection.getresponse().status == 408


def test_an_answer_that_nobody_reads_is_given_up(running, monkeypatch):
    client = running.client()
    client.tiles(TILES)
    counted = running.server.config.app.app.state.service
    asked, refused = threading.Event(), threading.Event()

    def wait_for_the_refusal(_, tiles):
        asked.set()
        assert refused.wait(60)
        return [bytes(200 * TILE * TILE)] * len(tiles)

    monkeypatch.setattr(connection, "READING_SECONDS", 0.3)
    monkeypatch.setattr(service, "MAX_PICTURES", 1)
    monkeypatch.setattr(pictures, "label_tiles", wait_for_the_refusal)
    body = json.dumps(TILES | {"tiles": [[4, i, 0] for i in range(600)]}).encode()
    lines = (
        "POST /api/picture HTTP/1.1",
        f"host: 127.0.0.1:{running.port}",
        "content-type: application/json",
        f"{explorer_server.TOKEN_HEADER}: {explorer_server.TOKEN}",
        f"content-length: {len(body)}",
    )
    with socket.create_connection(("127.0.0.1", running.port)) as other:
        other.sendall("\r\n".join((*lines, "", "")).encode() + body)
        assert asked.wait(60) and counted.pictures == 1
        answer = client.ask("/api/picture", TILES)
        assert answer.status == 503 and "too much is waiting" in answer.json()["error"]
        refused.set()
        running.settle()
        assert counted.pictures == 0
    assert len(client.tiles(TILES)[1]) == 1


def test_a_failure_is_told_in_the_packages_own_words_alone(monkeypatch):
    monkeypatch.setattr(workers.signal, "signal", lambda *_: None)
    assert workers.answer(int, ("secret",), Mock(spec=Connection))[0] == "ValueError"
    hidden = service.reason_of(workers.Failure("ValueError", "secret"))
    assert hidden == "the computation failed (ValueError)"

    def refuse():
        raise WrongUse("slope must be above 0")

    said = workers.answer(refuse, (), Mock(spec=Connection))
    assert service.reason_of(workers.Failure(*said)) == "slope must be above 0"
