"""Who may ask: the guard before every request.

A page of another site that is open in the same browser can send requests to this machine, also
under a name of its own that it has made to lead here (DNS rebinding). So the guard checks the Host
and the Origin of each request, and a token that only the link has which the server printed. It also
bounds the size and the rate of requests.
"""

import secrets
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.responses import JSONResponse

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

TOKEN_HEADER = "x-walker-token"
MAX_BODY = 2**16
"""Bytes of a request; a page's own have some thousand."""
RATE, BURST = 300.0, 600.0
"""Requests a second in the long run, and at once: ten pages in which a hand drags."""
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
HEADERS = (
    (b"cache-control", b"no-store"),
    (
        b"content-security-policy",
        b"default-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; "
        b"object-src 'none'",
    ),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
"""Of every answer: nothing from other hosts, and no word to them."""


class Bucket:
    """A bound on a rate: as many as `burst` at once, and `rate` a second."""

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic):
        self.rate, self.burst, self.clock = rate, burst, clock
        self.left, self.last = burst, clock()

    def take(self) -> bool:
        """Whether one more may pass now."""
        now = self.clock()
        self.left = min(self.burst, self.left + self.rate * (now - self.last))
        self.last = now
        if self.left < 1:
            return False
        self.left -= 1
        return True


class Guard:
    """Refuses requests that are not of the page, and passes on the others."""

    def __init__(self, app: Any, *, token: str, hosts: tuple[str, ...], port: int):
        self.app, self.token = app, token.encode()
        self.hosts = {f"{host}:{port}" for host in hosts} | (set(hosts) if port == 80 else set())
        self.bucket = Bucket(RATE, BURST)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            await send(message)

        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        elif scope["type"] == "http":
            refusal = self.refusal(scope)
            answer = self.app if refusal is None else refusal
            await answer(scope, limited(receive), send_with_headers)
        else:  # WebSockets, which the page has none of
            await send({"type": "websocket.close", "code": 1008})

    def refusal(self, scope: Scope) -> JSONResponse | None:
        """The answer to a request that is refused."""
        headers: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:
            if headers.setdefault(name, value) != value:
                return refuse(400, f"two headers {name.decode('latin-1')}")
        text = lambda name: headers.get(name, b"").decode("latin-1")
        if text(b"host").lower() not in self.hosts:
            return refuse(403, "this server is not the Host that was asked for")
        origin = text(b"origin").lower()
        if origin and origin.removeprefix("http://") not in self.hosts:
            return refuse(403, "requests from other sites are refused")
        if scope["path"].startswith("/api/"):
            given = headers.get(TOKEN_HEADER.encode(), b"")
            if not secrets.compare_digest(given, self.token):
                return refuse(403, "the token is not that of this server: open the link it printed")
        length = text(b"content-length")
        if length and not (length.isascii() and length.isdigit() and int(length[:9]) <= MAX_BODY):
            return refuse(413, f"a request has at most {MAX_BODY} bytes")
        if not self.bucket.take():
            return refuse(429, "too many requests: wait a moment", {"retry-after": "1"})
        return None


class TooLong(Exception):
    """A request has more bytes than may be."""


def limited(receive: Receive) -> Receive:
    """The same, up to `MAX_BODY` bytes: also of a request that does not tell its length."""
    total = 0

    async def receive_some() -> MutableMapping[str, Any]:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > MAX_BODY:
            raise TooLong
        return message

    return receive_some


def refuse(status: int, reason: str, headers: dict[str, str] | None = None) -> JSONResponse:
    """An answer that says why there is none."""
    return JSONResponse({"error": reason}, status, headers)
