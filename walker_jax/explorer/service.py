"""The answers to the page's requests, as an ASGI application (Starlette).

One thread computes pictures and walks, a batch of cells at a time, so that all pages take turns.
Workers compute longer measures. A request is cancelled if its page has gone or has sent a newer
one: between two batches, or by an interrupt of the worker.
"""

import asyncio
import json
import logging
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.explorer import copies, measures, pictures, walks
from walker_jax.explorer.family import describe_family
from walker_jax.explorer.guard import FILES, TooLong, refuse
from walker_jax.explorer.lattice import Rectangle, Tile, home_of, read_rectangle, read_tiles
from walker_jax.explorer.offers import FAMILY, Offers
from walker_jax.explorer.programs import Lane, Programs
from walker_jax.explorer.streams import (
    CELLS,
    FAILED,
    WORDS,
    chained,
    frame,
    line_of,
    reason_of,
    unless_gone,
)
from walker_jax.explorer.subjects import (
    METHODS,
    Subject,
    WrongParameter,
    choice,
    mapping,
    numbers,
    read_start,
    read_subject,
    whole,
)
from walker_jax.explorer.workers import Busy, Failure, Workers

BODY_SECONDS = 10.0
"""Seconds within which the body of a request must arrive."""
FIRST_BATCH, LARGEST_BATCH = 4, 24
"""Tiles in the first batch of a picture, and most tiles in any batch."""
BATCH_SECONDS = 0.06
"""Seconds that a batch should take. Other requests wait that long; larger batches use two cores
better."""
MAX_PICTURES = 64
"""Most pictures at once; more are refused."""
MAX_RECTANGLES = 4
"""Most grids of cell mapping in a request, coarse ones first."""
MANY_CELLS = 2**17
"""Cells above which a rectangle counts as long; one stride of all of these takes 0.15 s."""
TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}


def page_files() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page by name, with their types; no other file is ever served."""
    folder = resources.files("walker_jax.explorer") / "page"
    return {
        file.name: (file.read_bytes(), TYPES[file.name.rpartition(".")[2]])
        for file in folder.iterdir()
    }


class Service:
    """The answers to requests, with the threads and workers that compute them."""

    def __init__(self, offers: Offers = FAMILY) -> None:
        self.offers = offers
        self.quick, self.programs = Lane("pictures"), Programs()
        self.workers = Workers()
        self.pictures = 0

    async def compile_time(self, request: Request) -> Response:
        """Answer the estimated seconds until a kind of walker is compiled; null if unknown."""
        subject = read_subject(await read_json(request), self.offers)
        return JSONResponse({"seconds": self.programs.seconds_left(subject)})

    async def about(self, request: Request) -> Response:
        """Answer all walkers and systems, with words and colours."""
        return JSONResponse(describe_family(self.offers) | {"version": version("walker-jax")})

    async def home(self, request: Request) -> Response:
        """Answer the home window of a walker on a section, and its default gait."""
        subject = read_subject(await read_json(request), self.offers)
        await self.programs.ready(subject)
        return JSONResponse(home_of(subject.offer, subject.section)._asdict())

    async def picture(self, request: Request) -> Response:
        """Answer a stream of frames: the attractors, then the tiles in the order of the request."""
        asked = mapping("request", await read_json(request))
        subject = read_subject(asked, self.offers)
        method = choice("method", asked.get("method", METHODS[0]), METHODS)
        if method == "direct":
            work = self.tiles(subject, read_tiles(asked.get("tiles")))
        else:
            if len(subject.offer.section) > 2:
                raise WrongUse("method must be direct for a slice, as walkers leave it")
            rectangles = asked.get("rectangles")
            if not isinstance(rectangles, list) or not 1 <= len(rectangles) <= MAX_RECTANGLES:
                raise WrongUse(f"rectangles must be a list of 1 to {MAX_RECTANGLES}")
            work = self.rectangles(subject, list(map(read_rectangle, rectangles)))
        await self.programs.ready(subject)
        if self.pictures >= MAX_PICTURES:
            raise Busy
        return Picture(self, work)

    async def tiles(self, subject: Subject, tiles: list[Tile]) -> AsyncIterator[bytes]:
        """Yield frames of a picture by direct iteration."""
        told, done, size = -1, 0, FIRST_BATCH
        while done < len(tiles):
            batch = tiles[done : done + size]
            start = time.monotonic()
            found = await self.quick.run(pictures.label_tiles, subject, batch)
            spent = max(time.monotonic() - start, 1e-3)
            known, made = pictures.known.get(subject), []
            if known is not None and len(known.mapper.attractors) != told:
                told = len(known.mapper.attractors)
                attractors = pictures.describe_attractors(known.mapper.attractors)
                made.append(frame(WORDS, {"attractors": attractors, "at": known.at}))
            made += [
                frame(CELLS, struct.pack("<I", i) + cells) for i, cells in enumerate(found, done)
            ]
            # In one write, as asyncio warns of several writes to a page that has gone.
            yield b"".join(made)
            done += len(batch)
            size = int(np.clip(len(batch) * BATCH_SECONDS / spent, 1, LARGEST_BATCH))

    async def rectangles(self, subject: Subject, rectangles: list) -> AsyncIterator[bytes]:
        """Yield frames of a picture by cell mapping."""
        for i, cells in enumerate(rectangles):
            asked = pictures.map_rectangle, subject, cells
            if is_long(cells):
                found, attractors = await self.workers.ask(*asked, long=True, keep=False)
            else:
                found, attractors = await self.quick.run(*asked)
            yield frame(WORDS, {"attractors": attractors, "at": []})
            yield frame(CELLS, struct.pack("<I", i) + found)

    async def walk(self, request: Request) -> Response:
        """Answer strides from a start, or from a state in mid-stride after a push."""
        asked = mapping("request", await read_json(request))
        subject = read_subject(asked, self.offers)
        start = read_start(subject, asked.get("start"))
        count = whole("strides", asked.get("strides", 20), 1, walks.MAX_STRIDES)
        impulse = asked.get("push")
        given = None if impulse is None else np.array(numbers("push", impulse, (2,)))
        await self.programs.ready(subject)
        work = self.follow(subject, start, given, count)
        return JSONResponse(await unless_gone(request, work))

    async def follow(
        self, subject: Subject, start: np.ndarray, impulse: np.ndarray | None, count: int
    ) -> dict:
        """Follow strides, after a push if one is given, some at a time."""
        if impulse is not None:
            start = await self.quick.run(walks.push, subject, start, impulse)
        made = []
        while True:
            some = min(walks.STRIDES_AT_ONCE, count - len(made))
            found = await self.quick.run(walks.follow, subject, start, some)
            made += found["strides"]
            if found["next"] is None or len(made) >= count:
                return found | {"strides": made}
            start = np.array(found["next"])

    async def measure(self, request: Request) -> Response:
        """Answer a measure that takes longer than a picture; see `measures`."""
        asked = mapping("request", await read_json(request))
        subject = read_subject(asked, self.offers)
        kind = request.path_params["kind"]
        if kind == "gaits":
            work = self.workers.ask(measures.gaits, subject)
        elif kind == "area":
            cells = read_rectangle(asked.get("cells"))
            work = self.workers.ask(measures.area, subject, cells, long=is_long(cells))
        elif kind == "disturbance":
            work = self.workers.ask(measures.disturbance, subject, long=True)
        elif kind == "bifurcation":
            spans = tuple(subject.offer.spans)
            over = choice("over", asked.get("over", spans[0] if spans else None), spans)
            lines = self.grow(measures.bifurcation, subject, over)
            first = await unless_gone(request, anext(lines))
            return StreamingResponse(chained(first, lines), media_type="application/x-ndjson")
        else:
            return refuse(404, "there is no such measure")
        return JSONResponse(await unless_gone(request, work))

    async def grow(self, function: Callable, *arguments: Any) -> AsyncIterator[bytes]:
        """Yield the parts of a long measure as they come, then its result, as lines of JSON."""
        found: asyncio.Queue = asyncio.Queue()
        asked = self.workers.ask(function, *arguments, long=True, told=found.put_nowait)
        task = asyncio.ensure_future(asked)
        task.add_done_callback(lambda _: found.put_nowait(None))
        begun = False
        try:
            while (part := await found.get()) is not None:
                yield line_of(part)
                begun = True
            yield line_of(await task)
        except (ComputationFailed, WrongUse, Failure, Busy) as error:
            if not begun:
                raise
            yield line_of({"error": reason_of(error)})
        finally:
            task.cancel()

    async def words(self, request: Request) -> Response:
        """Answer the command line and the program that give the data of a rectangle."""
        subject, cells, method = await self.wanted(request)
        make = partial(copies.describe, subject, cells, method)
        return JSONResponse(await self.quick.run(make))

    async def data(self, request: Request) -> Response:
        """Answer the data of a rectangle, a Zarr store in a zip archive."""
        subject, cells, method = await self.wanted(request)
        asked = measures.data, subject, cells, method
        work = self.workers.ask(*asked, long=is_long(cells), keep=False)
        return Response(await unless_gone(request, work), media_type="application/zip")

    async def wanted(self, request: Request) -> tuple[Subject, Any, str]:
        """Return the subject, the rectangle and the method of a request for a copy."""
        asked = mapping("request", await read_json(request))
        subject = read_subject(asked, self.offers)
        method = choice("method", asked.get("method", METHODS[0]), METHODS)
        cells = read_rectangle(asked.get("cells"))
        await self.programs.ready(subject)
        return subject, cells, method

    async def alive(self, request: Request) -> Response:
        """Answer that the server is there."""
        return JSONResponse({"alive": True})


def is_long(cells: Rectangle) -> bool:
    """Return whether a rectangle has so many cells that only the first worker takes it."""
    return cells.shape[0] * cells.shape[1] > MANY_CELLS


class Picture(StreamingResponse):
    """A stream of frames, which counts as a picture while it lasts; a failure becomes a frame."""

    def __init__(self, service: Service, frames: AsyncIterator[bytes]):
        super().__init__(self.whole(frames), media_type="application/octet-stream")
        self.service = service

    async def whole(self, frames: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
        try:
            async for one in frames:
                yield one
        except (ComputationFailed, WrongUse, Failure, Busy) as error:
            yield frame(FAILED, {"error": reason_of(error)})

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        self.service.pictures += 1
        try:
            await super().__call__(scope, receive, send)
        finally:
            self.service.pictures -= 1


async def read_json(request: Request) -> Any:
    """Return the JSON of a request."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
        raise WrongUse("a request must be of the type application/json")
    body = await asyncio.wait_for(request.body(), BODY_SECONDS)
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        raise WrongUse("a request must be JSON") from None


def refused(request: Request, error: Exception) -> Response:
    """Return the answer to a wrong request, or to one whose computation fails."""
    if isinstance(error, WrongParameter):
        return JSONResponse({"error": str(error), "parameter": error.args[1]}, 400)
    if isinstance(error, WrongUse):
        return refuse(400, str(error))
    if isinstance(error, (ComputationFailed, Failure)):
        return refuse(422, reason_of(error))
    if isinstance(error, Busy):
        return refuse(503, reason_of(error), {"retry-after": "1"})
    if isinstance(error, TooLong):
        return refuse(413, "the request is too long")
    if isinstance(error, TimeoutError):
        return refuse(408, "the request did not come")
    if isinstance(error, HTTPException):
        return refuse(error.status_code, error.detail.lower())
    return Response(status_code=499)  # the client has gone


HANDLED = (
    *(WrongUse, ComputationFailed, Failure, Busy),
    *(TooLong, TimeoutError, ClientDisconnect, HTTPException),
)


def make_app(offers: Offers = FAMILY, first: dict | None = None) -> Starlette:
    """Make the application, with the page and all answers, for the walkers that it offers.

    The programs for the likely `first` request are compiled while the browser opens.
    """
    service, files = Service(offers), page_files()

    async def prepare(asked: dict) -> None:
        try:
            await service.programs.ready(read_subject(asked, offers))
        except (WrongUse, ComputationFailed) as error:  # the page will report it too
            logging.getLogger("uvicorn.error").warning("walker-jax: %s", error)

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in files:
            return refuse(404, "there is no such page")
        content, kind = files[name]
        if name == "index.html":
            content = content.replace(FILES.encode(), request.scope["files"].encode())
        return Response(content, media_type=kind)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        if first is not None:
            app.state.preparing = asyncio.create_task(prepare(first))
        yield
        await run_in_threadpool(service.workers.stop)

    post = lambda path, answer: Route(path, answer, methods=["POST"])
    routes = [
        Route("/", page),
        Route("/page/{name}", page),
        Route("/api/alive", service.alive),
        Route("/api/about", service.about),
        post("/api/compiling", service.compile_time),
        post("/api/home", service.home),
        post("/api/picture", service.picture),
        post("/api/walk", service.walk),
        post("/api/measure/{kind}", service.measure),
        post("/api/words", service.words),
        post("/api/data", service.data),
    ]
    app = Starlette(
        routes=routes, lifespan=lifespan, exception_handlers=dict.fromkeys(HANDLED, refused)
    )
    app.state.service = service
    return app
