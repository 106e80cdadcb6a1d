"""Who may ask: the guard before every request.

A page of another site that is open in the same browser can send requests to this machine, also
under a name of its own that it has made to lead here (DNS rebinding). So the guard checks the Host
and the Origin of each request, and a token that stands only in the link that the server printed. A
page may show this one in a frame only if it has the token. The guard also bounds the size and the
rate of requests: of those with the token, for answers and for files of the page apart, and of those
without, which so take nothing from a page. The page that is asked for with the token names its
files with the token, too.
"""

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
"""Where the files of the page are; those of a page with the token in a folder of that name."""
MAX_BODY = 2**16
"""Bytes of a request; a page's own have some thousand."""
RATE, BURST = 300.0, 600.0
"""Requests a second in the long run, and at once: ten pages in which a hand drags."""
POLICY = (
    b"default-src 'self'; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; "
    b"object-src 'none'"
)
"""Of what the page may load: nothing from other hosts."""
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
"""Of every answer: no word to other hosts."""


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
    """Refuses requests that are not of the page, and passes on the others.

    This machine goes by `names`, and by the address at which a request comes.
    """

    def __init__(self, app: Any, *, token: str, names: tuple[str, ...], port: int):
        self.app, self.token, self.port = app, token.encode(), port
        self.names = {name.lower() for name in names}
        self.requests, self.files, self.others = (Bucket(RATE, BURST) for _ in range(3))
        self.links: dict[str, str] = {}
        """By path, where each leads: once."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                policy = (b"content-security-policy", self.policy(scope))
                message["headers"] = [*message.get("headers", ()), *HEADERS, policy]
            await send(message)

        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        elif scope["type"] == "http":
            scope = self.without_token(scope)
            refusal = self.refusal(scope)
            answer = self.app if refusal is None else refusal
            await answer(scope, limited(receive), send_with_headers)
        else:  # WebSockets, which the page has none of
            await send({"type": "websocket.close", "code": 1008})

    def policy(self, scope: Scope) -> bytes:
        """The policy of an answer. A notebook, which may be anywhere, has the token."""
        return POLICY if self.is_linked(scope) else POLICY + b"; frame-ancestors 'none'"

    def is_linked(self, scope: Scope) -> bool:
        """Whether a request has the token as the printed link has it."""
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return self.is_token(given.encode())

    def without_token(self, scope: Scope) -> Scope:
        """The request for what it asks for; `files` is where the page finds its files."""
        folder, _, name = scope["path"].removeprefix(FILES).rpartition("/")
        named = scope["path"].startswith(FILES) and self.is_token(folder.encode())
        path = FILES + name if named else scope["path"]
        known = named or self.is_linked(scope)
        files = f"{FILES}{self.token.decode()}/" if known else FILES
        return {**scope, "path": path, "files": files}

    def is_token(self, given: bytes) -> bool:
        return secrets.compare_digest(given, self.token)

    def hosts(self, scope: Scope) -> set[str]:
        """The names by which a request may call this machine, as in Host."""
        names = self.names | {in_link(scope["server"][0])}
        return {f"{name}:{self.port}" for name in names} | (names if self.port == 80 else set())

    def refusal(self, scope: Scope) -> Response | None:
        """The answer to a request that is not passed on."""
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
        loaded = crossed and text(b"sec-fetch-mode") != "navigate"  # as by links and notebooks
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
    """A host as it stands in links and in Host: of addresses the shortest form."""
    try:
        address = ip_address(host)
    except ValueError:
        return host
    if isinstance(address, IPv6Address):
        return str(address.ipv4_mapped or f"[{address}]")
    return str(address)


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
