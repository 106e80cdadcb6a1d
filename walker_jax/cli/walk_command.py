"""`walker-jax walk`."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import description, print_json
from walker_jax.cli.app import app
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Json,
    Overwrite,
    finite,
    gait_of,
    start_of,
    takes_walker,
    window,
)
from walker_jax.walkers.model import Walker

FRAME = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""


@app.command()
@takes_walker
def walk(
    walker: Walker,
    theta: Annotated[
        float | None, typer.Option(help="Stance angle at the start, rad (default: see above).")
    ] = None,
    thetadot: Annotated[float | None, typer.Option(help="Its rate, rad per unit of time.")] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}.")] = None,
    strides: Annotated[int, typer.Option(min=1, max=1_000_000, help="Strides at most.")] = 9,
    animate: Annotated[
        Path | None,
        typer.Option(help="Where a film goes, .gif, or .mp4 where the program ffmpeg is there."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Walk from one start, stride by stride, until a failure.

    The simplest walker starts at theta 0.2, thetadot -0.21645 by default, any other in its gait. A
    film shows it walk, about as fast as one with legs of one metre, and its way over the basin.
    """
    given = {"theta": theta, "thetadot": thetadot, "phidot": phidot}
    given = {name: value for name, value in given.items() if value is not None}
    finite(**given)
    if isinstance(walker, wj.SimplestWalker):
        given = {"theta": 0.2, "thetadot": -0.21645} | given
    request = {
        "command": "walk",
        "walker": description(walker),
        "start": given,
        "strides": strides,
        "version": version("walker-jax"),
    }
    if animate is not None:
        from walker_jax import figures

        figures.check_film(animate)
        storage.check_picture(animate, request, overwrite=overwrite, argument="animate")
    start = start_of(walker, given) if given else gait_of(walker, walker.section).states[0]
    made = wj.walk(walker, start, strides)
    outcomes = np.asarray(made.outcomes)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, strides)
    names = [wj.Outcome(code).name for code in outcomes[:count].tolist()]
    states, times = np.asarray(made.states)[: completed + 1], np.asarray(made.times)[:count]
    if animate is not None and names[0] == "OUTSIDE":
        options = " and ".join(f"--{name}" for name in walker.section)
        raise WrongUse(f"{options} must be a feasible start for a film, not {states[0].tolist()}")
    if animate is not None:
        shown = wj.motion(walker, start, strides, step=FRAME)
        data = wj.basin(walker, window(walker, start), "direct", progress=True)
        signature = storage.signature(request)
        figures.film(shown, animate, data, signature=signature, progress=True)
    if as_json:
        print_json({"states": states, "outcomes": names, "times": times})
        return
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in walker.section)
    print(f"{'stride':>6}  {heads}  {'time':>8}  outcome")
    for i, (state, name, duration) in enumerate(zip(states, names, times, strict=False), start=1):
        print(f"{i:6}  {row(state)}  {duration:8.4f}  {name}")
    if len(states) > len(names):
        print(f"{'next':>6}  {row(states[-1])}")
    if animate is not None:
        print(f"film {animate}")
