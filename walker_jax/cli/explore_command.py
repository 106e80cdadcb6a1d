"""`walker-jax explore`."""

from typing import Annotated

import typer

from walker_jax.cli.walker_options import takes_walker
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import describe_walker


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

    values = describe_walker(walker)
    kind = values.pop("name")
    (name,) = (one for one, its in WALKERS.items() if its.__name__ == kind)
    run_server(host, port, name, values, browser=browser)
