"""Connections with time limits: for a request to arrive, and for an answer to be read."""

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_SECONDS = 10.0
"""Seconds between checks. A connection closes if two checks in a row await the same request."""
READING_SECONDS = 30.0
"""Seconds within which a client must read some of a waiting answer."""


class Connection(H11Protocol):
    """A connection that is closed if the client keeps it waiting."""

    watching: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.loop.call_later(HEADER_SECONDS, self.watch_headers, self.awaited())

    def awaited(self) -> tuple[Any, bool]:
        """Return the last request, and whether the next one is awaited."""
        return self.cycle, self.conn.their_state is h11.IDLE

    def watch_headers(self, before: tuple[Any, bool]) -> None:
        """Close the connection if the same request was awaited at the last check already."""
        if self.transport.is_closing():
            return
        now = self.awaited()
        if now == before and now[1]:
            self.transport.abort()
        else:
            self.loop.call_later(HEADER_SECONDS, self.watch_headers, now)

    def pause_writing(self) -> None:
        super().pause_writing()
        self.watch_reader(None)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self.watching is not None:
            self.watching.cancel()

    def watch_reader(self, before: int | None) -> None:
        """Close the connection if the client has read nothing since the last check."""
        waiting = self.transport.get_write_buffer_size()
        if waiting == before:
            self.transport.abort()
        else:
            self.watching = self.loop.call_later(READING_SECONDS, self.watch_reader, waiting)
