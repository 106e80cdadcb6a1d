"""The server of the page: its address, its link, its start and its end."""

import logging
import os
import re
import secrets
import socket
import sys
import webbrowser
from ipaddress import ip_address
from typing import Any, NoReturn
from urllib.parse import urlencode

import uvicorn

from walker_jax.checks import ComputationFailed, WrongUse, is_number
from walker_jax.explorer.connection import Connection
from walker_jax.explorer.guard import Guard, in_link
from walker_jax.explorer.offers import FAMILY, Offer, Offers, beside
from walker_jax.explorer.service import make_app

TOKEN_VARIABLE = "WALKER_JAX_TOKEN"
"""Environment variable that sets the token, so that links outlive the server; random by default."""
LEAST_TOKEN = 22
"""Fewest characters of a token, each one of 64: over 128 bits if they are random."""
TOKEN = re.compile(rf"[A-Za-z0-9_-]{{{LEAST_TOKEN},}}")
MAX_CONNECTIONS = 256
"""Most connections at once; more are refused."""
CLOSING_SECONDS = 1
"""Seconds left for unfinished answers when the server ends."""


class Server(uvicorn.Server):
    """A server that ends silently, as requests cancelled then are no errors."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        await super().shutdown(sockets)


def listen(host: str, port: int) -> socket.socket:
    """Open a socket that listens on a host and a port; on a free port if that is 0."""
    try:
        (family, kind, protocol, _, address), *_ = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen()  # early requests wait until the server is ready
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise ComputationFailed(
            f"cannot listen on {host}, port {port}: {error.strerror}; give another --host or --port"
        ) from None
    return listener


def names_of(host: str, listener: socket.socket) -> tuple[str, ...]:
    """Return the names by which a page may call this machine, the name in the link first.

    They are the given host and localhost. A server on all interfaces has the machine's names too.
    """
    given = in_link(host)
    if ip_address(listener.getsockname()[0]).is_unspecified:
        own = (socket.gethostname(), socket.getfqdn())
        known = can_be_found(own[0])
        return (*own, "localhost", given) if known else ("localhost", *own, given)
    return given, "localhost"


def can_be_found(name: str) -> bool:
    """Return whether a host name resolves to an address."""
    try:
        return bool(socket.getaddrinfo(name, None))
    except OSError:
        return False


def link_to(host: str, port: int, token: str, state: dict[str, Any]) -> str:
    """Return the link that opens the page in a state."""
    fragment = f"#{urlencode(state)}" if state else ""
    return f"http://{host}:{port}/?{urlencode({'token': token})}{fragment}"


def make_server(
    listener: socket.socket,
    token: str,
    names: tuple[str, ...],
    offers: Offers = FAMILY,
    first: dict | None = None,
) -> Server:
    """Make the server of the page on a socket; run it with that socket.

    See `names_of` for the names, and `make_app` for the offers and `first`.
    """
    guard = Guard(make_app(offers, first), token=token, names=names, port=listener.getsockname()[1])
    config = uvicorn.Config(
        guard,
        http=Connection,
        log_config=None,  # otherwise handlers and streams of other libraries would be closed
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="none",
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    return Server(config)


def read_token() -> str:
    """Return the token that the environment sets, or a random one."""
    token = os.environ.get(TOKEN_VARIABLE)
    if token and not TOKEN.fullmatch(token):
        raise WrongUse(
            f"{TOKEN_VARIABLE} must be {LEAST_TOKEN} characters or more, all letters, digits, - or "
            f"_, better random: this one has {len(token)}"
        )
    return token or secrets.token_urlsafe(24)


def run_server(
    host: str, port: int, offered: Offer, values: dict[str, float], *, browser: bool
) -> NoReturn:
    """Print the link and how to stop, open the browser, and serve the page until an interrupt.

    The page opens with these parameters, in the slice that the offer's axes fix. Beside this offer
    it has the package's walkers, or its other systems.
    """
    token = read_token()
    listener = listen(host, port)
    names = names_of(host, listener)
    at = {name: axis for name, axis in offered.axes if is_number(axis)}
    first = {"walker": offered.name, "parameters": values, "at": at}
    server = make_server(listener, token, names, beside(offered), first)
    address, port = listener.getsockname()[:2]
    if not ip_address(address).is_loopback:
        print(
            f"walker-jax: listening on {host}, which other machines may reach: "
            "whoever has the link can compute here, and the link is sent in the clear",
            file=sys.stderr,
        )
    sliced = {f"at_{name}": value for name, value in at.items()}
    link = link_to(names[0], port, token, {"walker": offered.name} | values | sliced)
    print(link, flush=True)
    print("walker-jax: Ctrl-C stops it", file=sys.stderr)
    if browser:  # others may see its command line, so it gets a path that works only once
        path = f"/open/{secrets.token_urlsafe(24)}"
        guard: Any = server.config.app
        guard.links[path] = link
        webbrowser.open(f"http://{names[0]}:{port}{path}")
    server.run(sockets=[listener])
    raise KeyboardInterrupt  # only an interrupt ends the server, which may have swallowed it
