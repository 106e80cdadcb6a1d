"""The explorer's workers, and its server among strangers and many clients."""

import asyncio
import json
import math
import os
import random
import re
import signal
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import explorer_server
import numpy as np
import pytest
from explorer_subjects import FIRST, GRID, WHOLE, joined

import walker_jax as wj
from walker_jax.explorer import measures, programs, service, workers
from walker_jax.explorer.compile_times import SECONDS
from walker_jax.explorer.guard import MAX_BODY, Bucket
from walker_jax.explorer.subjects import read_subject

# ---------------------------------------------------------------------------- measures, copies


def roots_of(*numbers):
    """Yields the square root of each number; returns how many there are."""
    for one in numbers:
        yield math.sqrt(one)
    return len(numbers)


def long_job(part):
    """Yields one part, and goes on for a minute."""
    yield part
    time.sleep(60)


def test_a_worker_is_interrupted_and_stays(monkeypatch):
    answers, call = [], workers.Worker.call
    noted = lambda *given: answers.append(call(*given)) or answers[-1]
    monkeypatch.setattr(workers.Worker, "call", noted)
    monkeypatch.setattr(workers, "GRACE", 600.0)  # workers have a low priority: others go first

    async def use():
        crew, begun = workers.Workers(1), asyncio.Event()
        try:
            assert await crew.ask(math.sqrt, 4.0) == 2.0
            assert await crew.ask(math.exp, 4.0) == math.exp(4.0)
            pid = crew.all[0].process.pid
            ask = lambda part: crew.ask(long_job, part, told=lambda _: begun.set())
            first, second, third = (asyncio.create_task(ask(part)) for part in (1, 1, 2))
            await begun.wait()
            assert len(crew.waiting) == 1
            for task in (first, third):
                task.cancel()
                await asyncio.wait([task])
            assert crew.waiting == []  # the third one has not begun
            assert len(crew.jobs) == 1 and crew.idle == []  # the second one waits for the first
            second.cancel()
            assert await crew.ask(math.sqrt, 9.0) == 3.0
            assert answers[2:] == [("interrupted", None), ("done", 3.0)]
            assert crew.all[0].process.pid == pid
            begun.clear()
            ended = asyncio.create_task(ask(3))
            await begun.wait()
            while not ended.done():  # as Ctrl-C in a terminal; one may come between two jobs
                os.kill(pid, signal.SIGINT)
                await asyncio.wait([ended], timeout=0.1)
            assert ended.cancelled()
            with pytest.raises(workers.Failure, match="math domain error"):
                await crew.ask(math.sqrt, -1.0)
            told = []  # parts that come before the result, or before it fails
            assert await crew.ask(roots_of, 4.0, 9.0, told=told.append) == 2
            with pytest.raises(workers.Failure, match="math domain error"):
                await crew.ask(roots_of, 16.0, -1.0, told=told.append)
            assert told == [2.0, 3.0, 4.0]
            with pytest.raises(workers.Failure, match="has died"):
                await crew.ask(os._exit, 1)
            assert await crew.ask(math.sqrt, 16.0) == 4.0
        finally:
            crew.stop()

    asyncio.run(use())


@pytest.mark.parametrize(
    ("at_work", "helps", "wanted"),
    [(True, True, ["interrupted"]), (True, False, ["interrupted", "killed"]), (False, False, [])],
)
def test_a_process_is_killed_if_interrupts_do_not_help(monkeypatch, at_work, helps, wanted):
    """While it starts, it is not interrupted."""

    async def use():
        job, worker, happened = asyncio.get_running_loop().create_future(), workers.Worker(), []

        def interrupt(pid, how):
            assert (pid, how) == (1234, signal.SIGINT)
            happened.append("interrupted")
            if helps:
                job.set_result("interrupted")

        def kill():
            happened.append("killed")
            job.set_exception(EOFError())

        worker.process, worker.at_work = Mock(pid=1234), at_work
        if not at_work:
            loop = asyncio.get_running_loop()
            loop.call_soon(loop.call_soon, job.set_result, "done")  # one turn after `give_up` began
        monkeypatch.setattr(workers, "GRACE", 0.05)
        monkeypatch.setattr(workers.os, "kill", interrupt)
        monkeypatch.setattr(worker, "stop_process", kill)
        await asyncio.wait_for(worker.give_up(job), 60)
        assert happened == wanted

    asyncio.run(use())


def test_jobs_are_shared_and_long_ones_are_the_first_workers(monkeypatch):
    at_work = {}

    async def run(self, function, name, told):
        """As a process that works until it is told to end."""
        at_work[name] = self, asyncio.get_running_loop().create_future()
        try:
            return await at_work[name][1]
        finally:
            del at_work[name]

    async def turns():
        for _ in range(9):
            await asyncio.sleep(0)

    async def use():
        crew = workers.Workers(2)
        ask = lambda name, **how: asyncio.create_task(crew.ask(str, name, **how))
        keys = lambda *names: [(str, (name,)) for name in names]
        where = lambda: {name: crew.all.index(worker) for name, (worker, _) in at_work.items()}

        async def end(name):
            at_work[name][1].set_result(name.upper())
            await turns()

        asked = {name: ask(name, long="long" in name) for name in ("a", "long", "longer", "b")}
        await turns()
        assert where() == {"a": 1, "long": 0} and len(crew.waiting) == 2
        refused, again = ask("c"), ask("long", long=True)
        await turns()
        assert isinstance(refused.exception(), workers.Busy)
        await end("a")
        assert where() == {"b": 1, "long": 0}  # the longer one waits for the first worker
        asked["long"].cancel()
        await turns()
        assert where() == {"b": 1, "long": 0}
        again.cancel()
        await turns()
        assert where() == {"b": 1, "longer": 0}
        await end("longer")
        await end("b")
        assert [asked[name].result() for name in ("a", "b", "longer")] == ["A", "B", "LONGER"]
        kept, passed = ask("longer"), ask("d", keep=False)
        await turns()
        assert where() == {"d": 1} and kept.result() == "LONGER"
        await end("d")
        assert passed.result() == "D" and [*crew.answers] == keys("b", "longer")
        last = ask("a")
        await turns()
        await end("a")
        assert last.result() == "A" and [*crew.answers] == keys("longer", "a")
        assert crew.jobs == {} and crew.idle == crew.all[::-1]

    monkeypatch.setattr(workers.Worker, "run", run)
    monkeypatch.setattr(workers, "MAX_WAITING", 2)
    monkeypatch.setattr(workers, "REMEMBERED", 2)
    asyncio.run(use())


def test_all_who_ask_are_told_of_the_last_part_and_the_next():
    async def use():
        crew, told = workers.Workers(1), []
        job = crew.jobs[roots_of, (25.0,)] = workers.Job(roots_of, (25.0,), long=True)
        job.tell(1.0)
        job.tell(1.5)
        later = asyncio.create_task(crew.ask(roots_of, 25.0, told=told.append))
        await asyncio.sleep(0)
        job.tell(2.0)
        job.result.set_result(1)
        assert await later == 1 and told == [1.5, 2.0] and job.told == []

    asyncio.run(use())


def test_a_measure_that_grows_is_lines(running, client, monkeypatch):
    crew = running.server.config.app.app.state.service.workers
    asked = {"walker": "simplest", "parameters": {"slope": 0.004}}
    endings = [{"branches": 2}, workers.Failure("OSError", "no space")]

    async def ask(function, *arguments, told, **options):
        told({"branches": 1})
        await asyncio.sleep(0)
        ending = endings.pop(0)
        if isinstance(ending, Exception):
            raise ending
        return ending

    monkeypatch.setattr(crew, "ask", ask)
    for last in ({"branches": 2}, {"error": "the computation failed (OSError)"}):
        answer = client.ask("/api/measure/bifurcation", asked)
        assert answer.status == 200
        assert list(map(json.loads, answer.body.splitlines())) == [{"branches": 1}, last]

    async def busy(*arguments, **options):
        raise workers.Busy

    monkeypatch.setattr(crew, "ask", busy)
    assert client.ask("/api/measure/bifurcation", asked).status == 503


def test_the_seconds_left_are_of_what_compiles_before(monkeypatch):
    begun, go = threading.Event(), threading.Event()
    monkeypatch.setattr(programs, "compile_programs", lambda _: begun.set() or go.wait())
    kinds = {
        name: read_subject({"walker": name}) for name in ("kneed", "spring", "spatial", "powered")
    }

    async def use():
        made = programs.Programs()
        left = lambda: [made.seconds_left(one) for one in kinds.values()]
        waiting = [asyncio.create_task(made.ready(kinds[name])) for name in ("kneed", "spring")]
        await asyncio.to_thread(begun.wait)
        made.begun[kinds["kneed"].offer] -= 10.0
        a, b, c, d = (SECONDS[name] for name in kinds)
        assert left() == pytest.approx(
            [t - 10.0 for t in (a, a + b, a + b + c, a + b + d)], abs=1.0
        )
        made.begun[kinds["kneed"].offer] -= 1000.0  # it takes longer than was estimated
        assert left()[:2] == [programs.LEAST_LEFT, programs.LEAST_LEFT + b]
        go.set()
        await asyncio.gather(*waiting)
        assert made.begun == {} and left() == [0.0, 0.0, c, d]
        begun.clear()
        go.clear()
        plain = read_subject({"walker": "kneed", "section": "plain"})
        waiting = asyncio.create_task(made.ready(plain))  # another plane of what is compiled
        await asyncio.to_thread(begun.wait)
        assert left() == [0.0, 0.0, c, d]
        go.set()
        await waiting

    asyncio.run(use())


# ---------------------------------------------------------------------------- strangers


def test_strangers_are_refused(running, client):
    host = f"127.0.0.1:{running.port}"
    refused = lambda **headers: client.ask("/api/about", **headers).status
    assert refused() == 200
    assert refused(x_walker_token="wrong") == refused(x_walker_token="") == 403
    assert refused(host="evil.example") == refused(host=f"evil.example:{running.port}") == 403
    assert refused(host="127.0.0.1:1") == refused(host="") == 403
    assert refused(origin="http://evil.example") == refused(origin="null") == 403
    assert refused(origin=f"https://{host}") == 403
    assert refused(origin=f"http://{host}") == refused(host=f"localhost:{running.port}") == 200
    assert client.ask("/", host="evil.example").status == 403
    assert client.ask("/", x_walker_token="").status == 200  # the page itself holds no secret
    long = json.dumps({"walker": "x" * MAX_BODY}).encode()
    assert client.send("/api/home", long).status == 413
    assert running.client().send("/api/home", b"{}", content_type="text/plain").status == 400
    for path in ("/page/../service.py", "/page/%2e%2e%2fservice.py", "/etc/passwd", "/api/x"):
        assert client.send(path).status == 404
    answer = client.ask("/api/home", {"walker": "simplest", "parameters": {"slope": -1.0}})
    assert answer.status == 400 and answer.json()["parameter"] == "slope"
    assert answer.json()["error"] == "slope must be above 0 and below 1.5708, not -1.0"
    crossed = {"walker": "round-foot", "parameters": {"foot_radius": 1.2}}
    assert client.ask("/api/home", crossed).json()["parameter"] == "foot_radius"
    for asked, named in (
        ({"parameters": {"slope": 1e7}}, "slope"),
        ({"parameters": {"foot_radius": "wide"}}, "foot_radius"),
        ({"at": {"phidot": 1e7}}, "at_phidot"),
    ):
        answer = client.ask("/api/home", {"walker": "round-foot"} | asked).json()
        assert answer["parameter"] == named and answer["error"].startswith(f"{named} must be ")
    assert "parameter" not in client.ask("/api/home", {"walker": "x"}).json()


def test_a_body_that_does_not_tell_its_length_is_bounded_too(running):
    client = running.client()
    chunks = iter([b" " * 40_000] * 3)
    headers = {
        "content-type": "application/json",
        explorer_server.TOKEN_HEADER: explorer_server.TOKEN,
    }
    client.connection.request("POST", "/api/home", chunks, headers, encode_chunked=True)
    assert client.connection.getresponse().status == 413


def test_the_rate_of_requests_is_bounded():
    now = [0.0]
    bucket = Bucket(10.0, 3.0, lambda: now[0])
    assert [bucket.take() for _ in range(4)] == [True, True, True, False]
    now[0] += 0.1
    assert [bucket.take() for _ in range(2)] == [True, False]
    now[0] += 1e9
    assert sum(bucket.take() for _ in range(10)) == 3


def test_every_file_of_the_page_names_no_other_host(client):
    files = service.page_files()
    assert {"index.html", "style.css", "main.js", "icon.svg"} <= set(files)
    for name, (content, _) in files.items():
        assert client.send(f"/page/{name}").body == content
        addresses = re.findall(rb"https?://[^\s\"'`)]+", content)
        assert set(addresses) <= {b"http://www.w3.org/2000/svg"}, name
        imported = re.findall(rb'(?:from|import) "\./([\w.]+)"', content)
        assert {one.decode() for one in imported} <= set(files)


# ---------------------------------------------------------------------------- fuzz and load

SENSELESS = [
    *(None, True, -1, 0, 1.5, 1e308, 2**70, float("nan"), float("inf")),
    *("", "simplest", "\ud800", "../x", "__import__('os')"),
    *([], [[]], {}, {"slope": "x"}, [1] * 50, [[0, 0, 0]], [[99, 0, 0]], [[0, 2**60, 0]]),
]
PATHS = [
    "home",
    "picture",
    "walk",
    "words",
    "data",
    "measure/area",
    "measure/gaits",
    "measure/disturbance",
    "measure/bifurcation",
    "measure/x",
    "about",
    "nothing",
]
ALLOWED = {200, 400, 403, 404, 405, 413, 422}


def malformed(rng):
    """A request that is wrong in some way, or in none by chance."""
    asked = {
        "walker": "simplest",
        "parameters": {"slope": 0.004},
        "tiles": [[-3, 0, 0]],
        "start": [0.2, -0.21],
        "cells": [0, 0, 0, 3, 3],
    }
    for _ in range(rng.randint(1, 3)):
        name = rng.choice([*asked, "section", "method", "at", "push", "strides", "rectangles"])
        asked[name] = rng.choice(SENSELESS)
    body = json.dumps(asked).encode()
    kind = rng.random()
    if kind < 0.1:
        return body[: rng.randint(0, len(body))]
    if kind < 0.2:
        return bytes(rng.randrange(256) for _ in range(rng.randint(0, 200)))
    if kind < 0.25:
        return b"[" * 30_000
    return json.dumps(rng.choice(SENSELESS)).encode() if kind < 0.35 else body


HEADERS = ["origin", "host", "content_type", "sec_fetch_site", "x_walker_token", "accept", "range"]
VALUES = ["", "null", "x", "cross-site", "text/html", "http://[", "\xff", "a" * 9000, "bytes=-1"]


def fuzz(running, monkeypatch, count, seed):
    async def ask(function, *arguments, **options):  # right by chance: a worker would compute it
        return b"" if function is measures.data else {}

    crew = running.server.config.app.app.state.service.workers
    monkeypatch.setattr(crew, "ask", ask)
    client, rng = running.client(), random.Random(seed)
    statuses = {}
    for _ in range(count):
        path, body = rng.choice(PATHS), malformed(rng)
        headers = {rng.choice(HEADERS): rng.choice(VALUES)} if rng.random() < 0.2 else {}
        method = rng.choice(["POST", "POST", "POST", "PUT", "GET"])
        answer = client.send(f"/api/{path}", body, method, **headers)
        assert answer.status in ALLOWED, (path, body, answer)
        if answer.status != 200 and answer.status != 405:
            reason = answer.json()["error"]
            assert reason and "Traceback" not in reason and "\n" not in reason
        statuses[answer.status] = statuses.get(answer.status, 0) + 1
    assert client.ask("/api/alive").json() == {"alive": True}
    assert statuses[400] > count / 4
    return statuses


def test_malformed_requests_are_refused_in_one_sentence(running, caplog, monkeypatch):
    fuzz(running, monkeypatch, 500, 0)
    assert not caplog.records


@pytest.mark.slow
def test_thousands_of_malformed_requests(running, caplog, monkeypatch):
    fuzz(running, monkeypatch, 20_000, 1)
    assert not caplog.records


def drag(running, seconds, clients=8):
    """Clients that drag at once, walk and give up, each with a picture of its own at the end."""
    ends, failures, pictures_made = {}, [], []

    def hand(number):
        rng, client = random.Random(number), running.client()
        stop = time.monotonic() + seconds
        try:
            while time.monotonic() < stop:
                slope = round(rng.uniform(0.003, 0.012), 5)
                asked = {"walker": "simplest", "parameters": {"slope": slope}}
                client.tiles(asked | {"tiles": WHOLE[:4]})
                pictures_made.append(1)
                client.give_up("/api/picture", asked | {"tiles": WHOLE})
                answer = client.ask("/api/walk", asked | {"start": [0.2, -0.21], "strides": 20})
                assert answer.status == 200, answer
            slope = 0.004 + 0.0005 * number
            asked = {"walker": "simplest", "parameters": {"slope": slope}, "tiles": WHOLE}
            ends[slope] = client.tiles(asked)[1]
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=hand, args=(i,)) for i in range(clients)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert not failures and len(ends) == clients
    for slope, tiles in ends.items():
        fate = wj.basin(wj.SimplestWalker(slope), GRID, "direct")["fate"].values
        label, _ = joined(tiles)
        walks = label >= FIRST
        np.testing.assert_array_equal(np.where(walks, 0, label), fate)
    return len(pictures_made)


@pytest.mark.slow  # one thread computes all pictures, as other tests show
def test_clients_that_drag_at_once_all_get_their_pictures(running):
    assert drag(running, 0.5, clients=3) >= 3


def resident() -> int:
    """Bytes of memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory is read from /proc")
def test_eight_clients_drag_for_a_minute_in_flat_memory(running):
    drag(running, 10)
    before = resident()
    drag(running, 60)
    assert resident() - before < 60e6


def test_a_process_that_still_starts_is_not_interrupted(monkeypatch):
    sent = []
    monkeypatch.setattr(os, "kill", lambda *given: sent.append(given))

    async def give_up() -> None:
        worker, job = workers.Worker(), asyncio.get_running_loop().create_future()
        worker.process = Mock(pid=1234)
        asyncio.get_running_loop().call_later(0.05, job.set_result, None)
        await worker.give_up(job)

    asyncio.run(give_up())
    assert sent == []
