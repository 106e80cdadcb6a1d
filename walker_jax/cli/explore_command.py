"""`walker-jax explore`."""

from typing import Annotated

import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.rewording import option_of
from walker_jax.cli.walker_options import takes_walker
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import chosen_options, parameters


@takes_walker()
def explore(
    walker: Walker,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where the server listens; 0 for a free port.")
    ] = 0,
    host: Annotated[
        str, typer.Option(help="The interface; any but this machine's own lets others in.")
    ] = "127.0.0.1",
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Whether to open the page.")
    ] = True,
) -> None:
    """Explore basins in a browser: drag the slope, watch the basin; click a start, watch it walk.

    Prints the link to the page, and serves it until Ctrl-C. The page needs no network. Its address
    holds what it shows; buttons copy the command and the Python that give the same data.
    """
    from walker_jax.explorer.server import run_server
    from walker_jax.explorer.subjects import offer
    from walker_jax.walkers.references import reference_of

    check_host(host)
    offered = offer(walker)
    reference_of(offered.kind)  # raises for what worker processes cannot import
    for option in chosen_options(walker):
        raise WrongUse(f"{option_of(option)} must be left out: the page knows parameters alone")
    values = {one.name: float(getattr(walker, one.name)) for one in parameters(walker)}
    run_server(host, port, offered, values, browser=browser)


def check_host(host: str) -> None:
    """Refuse what can be no name of a machine."""
    try:
        encoded = host.encode("idna")  # as the network does
    except UnicodeError:
        encoded = b""
    if not encoded.strip():
        shown = host.strip() or "''"
        raise WrongUse(f"--host must be a name or an address, such as 127.0.0.1, not {shown}")
