"""The guard, which checks every request before it is answered.

A page of another site, open in the same browser, can send requests to this machine. It can even use
a host name of its own that resolves to this machine (DNS rebinding). So the guard checks the Host
and the Origin of each request, and a token that stands only in the link that the server printed.
Another page may show this one in a frame only if it has the token.

The guard also limits the size and the rate of requests. It counts requests for answers, requests
for files with the token, and requests for files without it apart, so that strangers cannot use up
the share of a page. A page that was opened with the token asks for its files with the token too.
"""

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable, MutableMapping
from ipaddress import IPv6Address, ip_address
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import JSONResponse, RedirectResponse, Response

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

TOKEN_HEADER = "x-walker-token"
FILES = "/page/"
"""Path of the page's files; a page with the token finds them in a folder named by the token."""
MAX_BODY = 2**16
"""Most bytes of a request; the page's own requests have about a thousand."""
RATE, BURST = 300.0, 600.0
"""Most requests per second in the long run, and most at once: enough to drag on ten pages."""
POLICY = (
    b"default-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; "
    b"object-src 'none'"
)
"""Policy for what the page may load: nothing from other hosts."""
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
"""Headers of every answer: other hosts learn nothing."""


class Bucket:
    """A rate limit: at most `burst` at once, and `rate` per second in the long run."""

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic):
        self.rate, self.burst, self.clock = rate, burst, clock
        self.left, self.last = burst, clock()

    def take(self) -> bool:
        """Return whether one more may pass now, and count it."""
        now = self.clock()
        self.left = min(self.burst, self.left + self.rate * (now - self.last))
        self.last = now
        if self.left < 1:
            return False
        self.left -= 1
        return True


class Guard:
    """Refuses requests that are not from the page, and passes on the others.

    Requests may call this machine by `names`, or by the address at which they arrive.
    """

    def __init__(self, app: Any, *, token: str, names: tuple[str, ...], port: int):
        self.app, self.token, self.port = app, token.encode(), port
        self.names = {name.lower() for name in names}
        self.requests, self.files, self.others = (Bucket(RATE, BURST) for _ in range(3))
        self.links: dict[str, str] = {}
        """Links that work once, by their paths."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun = False

        async def send_with_headers(message: MutableMapping[str, Any]) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                policy = (b"content-security-policy", self.policy(scope))
                message["headers"] = [*message.get("headers", ()), *HEADERS, policy]
            await send(message)

        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        elif scope["type"] == "http":
            scope = self.without_token(scope)
            refusal = self.refusal(scope)
            answer = self.app if refusal is None else refusal
            try:
                await answer(scope, limited(receive), send_with_headers)
            except asyncio.CancelledError:  # the server ends: the page asks again, and sees so
                if begun:
                    raise
                await refuse(503, "the server stops")(scope, receive, send_with_headers)
        else:  # a WebSocket, which the page does not use
            await send({"type": "websocket.close", "code": 1008})

    def policy(self, scope: Scope) -> bytes:
        """Return the policy of an answer; a link with the token may be framed, as in a notebook."""
        return POLICY if self.is_linked(scope) else POLICY + b"; frame-ancestors 'none'"

    def is_linked(self, scope: Scope) -> bool:
        """Return whether a request has the token in its query, as the printed link has."""
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return self.is_token(given.encode())

    def without_token(self, scope: Scope) -> Scope:
        """Return the request with the token removed from its path, and the folder of its files."""
        folder, _, name = scope["path"].removeprefix(FILES).rpartition("/")
        named = scope["path"].startswith(FILES) and self.is_token(folder.encode())
        path = FILES + name if named else scope["path"]
        known = named or self.is_linked(scope)
        files = f"{FILES}{self.token.decode()}/" if known else FILES
        return {**scope, "path": path, "files": files}

    def is_token(self, given: bytes) -> bool:
        return secrets.compare_digest(given, self.token)

    def hosts(self, scope: Scope) -> set[str]:
        """Return the names by which a request may call this machine in its header Host."""
        names = self.names | {in_link(scope["server"][0])}
        return {f"{name}:{self.port}" for name in names} | (names if self.port == 80 else set())

    def refusal(self, scope: Scope) -> Response | None:
        """Return the answer to a refused request; None if the request is passed on."""
        headers: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:
            if headers.setdefault(name, value) != value:
                return refuse(400, f"two headers {name.decode('latin-1')}")
        text = lambda name: headers.get(name, b"").decode("latin-1")
        hosts = self.hosts(scope)
        if text(b"host").lower() not in hosts:
            return refuse(403, "this server is not the Host that was asked for")
        origin = text(b"origin").lower()
        crossed = text(b"sec-fetch-site") in ("cross-site", "same-site")
        loaded = crossed and text(b"sec-fetch-mode") != "navigate"  # links and notebooks navigate
        if loaded or (origin and origin.removeprefix("http://") not in hosts):
            return refuse(403, "requests from other sites are refused")
        if scope["path"] in self.links:
            return RedirectResponse(self.links.pop(scope["path"]))
        asks = scope["path"].startswith("/api/")
        if asks and not self.is_token(headers.get(TOKEN_HEADER.encode(), b"")):
            return refuse(403, "the token is not that of this server: open the link it printed")
        length = text(b"content-length")
        if length and not (length.isascii() and length.isdigit() and int(length[:9]) <= MAX_BODY):
            return refuse(413, f"a request has at most {MAX_BODY} bytes")
        known = self.files if scope["files"] != FILES else self.others
        if not (self.requests if asks else known).take():
            return refuse(429, "too many requests: wait a moment", {"retry-after": "1"})
        return None


def in_link(host: str) -> str:
    """Return a host as it stands in links and in Host; an address in its shortest form."""
    try:
        address = ip_address(host)
    except ValueError:
        return host
    if isinstance(address, IPv6Address):
        return str(address.ipv4_mapped or f"[{address}]")
    return str(address)


class TooLong(Exception):
    """A request has more than `MAX_BODY` bytes."""


def limited(receive: Receive) -> Receive:
    """Limit a request to `MAX_BODY` bytes, even if it does not tell its length."""
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
    """Return an answer that gives the reason for a refusal."""
    return JSONResponse({"error": reason}, status, headers)
