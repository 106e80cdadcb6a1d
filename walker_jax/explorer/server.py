"""The server of the page: its address, its link, and how it is started and ended."""

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
"""The environment variable that sets the token, so that links outlive the server; else random."""
LEAST_TOKEN = 22
"""Characters of a token, each one of 64: 128 bits, if they are random."""
TOKEN = re.compile(rf"[A-Za-z0-9_-]{{{LEAST_TOKEN},}}")
MAX_CONNECTIONS = 256
"""Connections at once; more are refused."""
CLOSING_SECONDS = 1
"""Seconds that answers under way have when the server ends."""


class Server(uvicorn.Server):
    """A server that ends without words: what it cancels then is nobody's error."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        await super().shutdown(sockets)


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens there; on a free port for 0."""
    try:
        (family, kind, protocol, _, address), *_ = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen()  # whoever comes before the server is ready waits
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise ComputationFailed(
            f"cannot listen on {host}, port {port}: {error.strerror}; give another --host or --port"
        ) from None
    return listener


def names_of(host: str, listener: socket.socket) -> tuple[str, ...]:
    """The names by which a page may call this machine, that of its link first.

    The host as it was given, and localhost; of all interfaces the machine's own name, too.
    """
    given = in_link(host)
    if ip_address(listener.getsockname()[0]).is_unspecified:
        own = (socket.gethostname(), socket.getfqdn())
        known = can_be_found(own[0])
        return (*own, "localhost", given) if known else ("localhost", *own, given)
    return given, "localhost"


def can_be_found(name: str) -> bool:
    """Whether a name has an address."""
    try:
        return bool(socket.getaddrinfo(name, None))
    except OSError:
        return False


def link_to(host: str, port: int, token: str, state: dict[str, Any]) -> str:
    """The link that opens the page, in a state."""
    fragment = f"#{urlencode(state)}" if state else ""
    return f"http://{host}:{port}/?{urlencode({'token': token})}{fragment}"


def make_server(
    listener: socket.socket,
    token: str,
    names: tuple[str, ...],
    offers: Offers = FAMILY,
    first: dict | None = None,
) -> Server:
    """The server of the page on a socket, to be run with it.

    See `names_of` for the names, and `make_app` for the rest.
    """
    guard = Guard(make_app(offers, first), token=token, names=names, port=listener.getsockname()[1])
    config = uvicorn.Config(
        guard,
        http=Connection,
        log_config=None,  # or handlers of other libraries would be closed, and streams with them
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="none",
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    return Server(config)


def read_token() -> str:
    """The token that the environment sets, or a random one."""
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

    The page shows a walker, or another system, with these parameters, and offers the package's
    beside it. It begins in the slice that the offer's axes fix.
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
    if browser:  # whose command line others may see: so it has a path that leads to the link once
        path = f"/open/{secrets.token_urlsafe(24)}"
        guard: Any = server.config.app
        guard.links[path] = link
        webbrowser.open(f"http://{names[0]}:{port}{path}")
    server.run(sockets=[listener])
    raise KeyboardInterrupt  # nothing else ends it; on its way out it may have been lost
