"""Streams: parts of answers sent while the rest is computed, as frames or lines of JSON."""

import asyncio
import json
import struct
from collections.abc import AsyncIterator
from typing import Any

from starlette.requests import ClientDisconnect, Request

from walker_jax.explorer.workers import SAID, Busy, Failure

WORDS, CELLS, FAILED = 0, 1, 2
"""Kinds of frames in a picture: JSON, the bytes of a tile, the reason for a failure."""


async def unless_gone(request: Request, work: Any) -> Any:
    """Return the result of a coroutine, or cancel it when the client disconnects."""
    task = asyncio.ensure_future(work)

    async def gone() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass

    watch = asyncio.ensure_future(gone())
    try:
        await asyncio.wait([task, watch], return_when=asyncio.FIRST_COMPLETED)
        if not task.done():
            raise ClientDisconnect
        return task.result()
    finally:
        task.cancel()
        watch.cancel()


async def chained(first: bytes, others: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Yield the first part of a stream, then the others."""
    yield first
    async for one in others:
        yield one


def line_of(content: dict) -> bytes:
    """Return a line of JSON."""
    return json.dumps(content).encode() + b"\n"


def frame(kind: int, content: dict | bytes) -> bytes:
    """Return a frame: its length, its kind and its content."""
    body = content if isinstance(content, bytes) else json.dumps(content).encode()
    return struct.pack("<IB", len(body), kind) + body


def reason_of(error: Exception) -> str:
    """Return why a computation failed; for errors of other packages, only their kind."""
    if isinstance(error, Failure):
        kind, message = error.args
        return message if kind == SAID else f"the computation failed ({kind})"
    if isinstance(error, Busy):
        return "too much is waiting: try again in a moment"
    return str(error)
