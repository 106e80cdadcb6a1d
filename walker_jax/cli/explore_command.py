"""`walker-jax explore`."""

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from walker_jax.basins.windows import grid_along
from walker_jax.checks import WrongUse
from walker_jax.cli.rewording import option_of
from walker_jax.cli.section import AXES, axes_from, check_ranges
from walker_jax.cli.walker_options import takes_walker
from walker_jax.systems.system import System, numbers_of
from walker_jax.walkers.model import is_planar
from walker_jax.walkers.parameters import chosen_options

PAGE: Any = {"rich_help_panel": "Page"}
"""The theme of the help."""


@dataclass(frozen=True)
class Shown:
    """Options for the window of a system's page."""

    theme = "Page"
    axis: list[str] | None = AXES


@takes_walker(systems=True, opening=True)
def explore(
    walker: System,
    shown: Shown,
    port: Annotated[
        int,
        typer.Option(
            min=0, max=65535, metavar="N", help="Port of the server; 0 for a free one.", **PAGE
        ),
    ] = 0,
    host: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="The interface; any but this machine's own lets others in.", **PAGE
        ),
    ] = "127.0.0.1",
    browser: Annotated[
        bool,
        typer.Option("--browser/--no-browser", help="Whether to open the page.", **PAGE),
    ] = True,
) -> None:
    """Explore basins in a browser: drag the slope, watch the basin; click a start, watch it walk.

    Prints the link to the page, and serves it until Ctrl-C. The page needs no network. Its address
    holds what it shows; buttons copy the command and the Python that give the same data. The spring
    walker opens with a stiffness of 1. Walkers in space and other systems have no film: a click
    shows their iterates. Their window has the axes of --axis, in cells of the page's own, by
    default over the gait_region. Walkers in space have no tab of bifurcations, nor have systems
    without a gait_region.
    """
    from walker_jax.explorer.offers import offer
    from walker_jax.explorer.server import run_server
    from walker_jax.walkers.references import reference_of

    check_host(host)
    axis = shown.axis
    if axis and is_planar(type(walker)):
        raise WrongUse("--axis is for systems: the page shows a walker in the plane about its gait")
    axes = axes_from(walker, axis) if axis else {}
    if axes:
        check_ranges(axes, len(axes))
        grid_along(axes)  # raises for wrong ends
    offered = offer(walker, axes)
    reference_of(offered.kind)  # raises for code that worker processes cannot import
    for option in chosen_options(walker):
        raise WrongUse(f"{option_of(option)} must be left out: the page knows parameters alone")
    own = numbers_of(walker)
    values = {one.name: float(own[one.name]) for one in offered.parameters}
    run_server(host, port, offered, values, browser=browser)


def check_host(host: str) -> None:
    """Refuse a host that cannot be the name of a machine."""
    try:
        encoded = host.encode("idna")  # the encoding of host names
    except UnicodeError:
        encoded = b""
    if not encoded.strip():
        shown = host.strip() or "''"
        raise WrongUse(f"--host must be a name or an address, such as 127.0.0.1, not {shown}")
