"""The server of the page: its address, its link, and how it is started and ended."""

import logging
import os
import secrets
import socket
import sys
import webbrowser
from typing import Any
from urllib.parse import urlencode

import uvicorn

from walker_jax.checks import ComputationFailed
from walker_jax.explorer.guard import LOOPBACK, Guard
from walker_jax.explorer.service import make_app

TOKEN_VARIABLE = "WALKER_JAX_TOKEN"
"""The environment variable that sets the token, so that links outlive the server; else random."""
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
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()  # whoever comes before the server is ready waits
    except OSError as error:
        raise ComputationFailed(f"cannot listen on {host}, port {port}: {error.strerror}") from None
    return listener


def link_to(host: str, port: int, token: str, state: dict[str, Any]) -> str:
    """The link that opens the page, in a state."""
    shown = f"[{host}]" if ":" in host else host
    fragment = f"#{urlencode(state)}" if state else ""
    return f"http://{shown}:{port}/?{urlencode({'token': token})}{fragment}"


def make_server(listener: socket.socket, token: str, first: dict | None = None) -> Server:
    """The server of the page on a socket, to be run with it; see `make_app` for `first`."""
    host, port = listener.getsockname()[:2]
    names = (*LOOPBACK, f"[{host}]" if ":" in host else host)
    config = uvicorn.Config(
        Guard(make_app(first), token=token, hosts=names, port=port),
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="none",
        limit_concurrency=MAX_CONNECTIONS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    return Server(config)


def run_server(
    host: str, port: int, walker: str, values: dict[str, float], *, browser: bool
) -> None:
    """Print the link, open the browser, and serve the page until an interrupt.

    The page shows a walker, by its name on the command line, with these parameters.
    """
    listener = listen(host, port)
    token = os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(24)
    server = make_server(listener, token, {"walker": walker, "parameters": values})
    if host not in LOOPBACK:
        print(
            f"walker-jax: listening on {host}, which other machines may reach: "
            "whoever has the link can compute here, and the link is sent in the clear",
            file=sys.stderr,
        )
    link = link_to(host, listener.getsockname()[1], token, {"walker": walker} | values)
    print(link, flush=True)
    if browser:
        webbrowser.open(link)
    server.run(sockets=[listener])
