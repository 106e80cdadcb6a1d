"""`walker-jax explore`."""

from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.commands import command
from walker_jax.cli.options import option, option_of, shown
from walker_jax.cli.section import axis_option, window_on
from walker_jax.refusals import WrongUse


@command(
    examples=(
        "explore",
        "explore --walker spring --hip-stiffness 1",
        "explore --system henon --a 1.02",
        "explore --no-browser",
    ),
    time="A few seconds until the page opens.",
    opening=True,
)
def explore(
    walker: "wj.System",
    axes: dict[str, Any] = axis_option(),
    port: int = option(0, "Port of the server; 0 for a free one.", least=0, most=65535),
    host: str = option("127.0.0.1", "The interface; any but this machine's own lets others in."),
    browser: bool = option(True, "Whether to open the page.", "--browser/--no-browser"),
) -> None:
    """Explore basins in a browser: drag the slope, watch the basin; click a start, watch it walk.

    Prints the link to the page, and serves it until Ctrl-C. The page needs no network. Its address
    holds what it shows; buttons copy the command and the Python that give the same data. The spring
    walker opens with a stiffness of 1. Walkers in space and other systems have no film: a click
    shows their iterates. Their window has the axes of --axis, in cells of the page's own, by
    default over the gait_region. Walkers in space have no tab of bifurcations, nor have systems
    without a gait_region.
    """
    try:
        encoded = host.encode("idna")  # the encoding of host names
    except UnicodeError:
        encoded = b""
    if not encoded.strip():
        must = "--host must be a name or an address, such as 127.0.0.1"
        raise WrongUse(f"{must}, not {shown(host)}")
    if axes and lib.is_planar(walker):
        raise WrongUse("--axis is for systems: the page shows a walker in the plane about its gait")
    if axes:
        axes = window_on(walker, axes, most=len(walker.section))
    offered = lib.offer(walker, axes)
    lib.flag_of(offered.kind)  # raises for code that worker processes cannot import
    for name in lib.chosen_options(walker):
        raise WrongUse(f"{option_of(name)} must be left out: the page knows parameters alone")
    own = lib.numbers_of(walker)
    values = {one.name: float(own[one.name]) for one in offered.parameters}
    lib.server.run_server(host, port, offered, values, browser=browser)
