"""`walker-jax walk`."""

from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from jaxtyping import Float

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.windows import film_window
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import print_json, request_for
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Json,
    Overwrite,
    Seed,
    StartAt,
    check_finite,
    refuse_for_systems,
    start_from,
    state_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.gaits.selection import require_gait
from walker_jax.systems.outcomes import name_of_outcome
from walker_jax.systems.system import System
from walker_jax.walkers.model import State, Walker, moves_like
from walker_jax.walkers.parameters import describe_walker

PAPER_START = {"theta": 0.2, "thetadot": -0.21645}
"""The start of the walk in Table 1 of Schwab and Wisse (2001)."""
FRAME_INTERVAL = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""


@takes_walker(systems=True)
def walk(
    walker: System,
    theta: Annotated[
        float | None, typer.Option(help="Stance angle at the start, rad (default: see above).")
    ] = None,
    thetadot: Annotated[
        float | None, typer.Option(help="Its rate at the start, rad per unit of time.")
    ] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}.")] = None,
    start: StartAt = None,
    strides: Annotated[int, typer.Option(min=1, max=1_000_000, help="Strides at most.")] = 9,
    ground: Annotated[
        float | None,
        typer.Option(min=0, help="Standard deviation of the steps of rough ground."),
    ] = None,
    seed: Seed = 0,
    animate: Annotated[
        Path | None,
        typer.Option(help="Where a film goes, .gif, or .mp4 if the program ffmpeg is installed."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Walk from one start, stride by stride, until a failure.

    With --ground each foothold is higher or lower than the one before, at random. States are full
    ones then: the legs' angles and their rates.

    By default the simplest walker starts at theta 0.2, thetadot -0.21645, any other in its gait. A
    film shows the walker, about as fast as one with legs of one metre, and its trajectory in the
    basin.
    """
    given = {"theta": theta, "thetadot": thetadot, "phidot": phidot}
    given = {name: value for name, value in given.items() if value is not None}
    check_finite(**given, ground=0.0 if ground is None else ground)
    refuse_for_systems(walker, ground=ground, animate=animate)
    given = start_from(walker, start, given)
    if moves_like(walker, wj.SimplestWalker):
        given = PAPER_START | given
    rough = {} if ground is None else {"ground": ground, "seed": seed}
    request = request_for(
        "walk", walker, walker=describe_walker(walker), start=given, strides=strides, **rough
    )
    if animate is not None:
        from walker_jax import figures

        figures.check_film(animate)
        storage.check_picture(animate, request, overwrite=overwrite, argument="animate")
    instead = walker.section if isinstance(walker, Walker) else ["--start NAME=VALUE"]
    with bar("walk", True):
        begin = state_from(walker, given) if given else require_gait(walker, instead).states[0]
        heights = None
        if ground is not None:
            heights = ground * np.random.default_rng(seed).normal(size=strides)
        made = wj.walk(walker, begin, strides, ground=heights)
    outcomes = np.asarray(made.outcomes)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, strides)
    if outcomes[0] == wj.Outcome.OUTSIDE:
        refuse_start(walker, np.asarray(begin))
    names = [name_of_outcome(code, walker.failures) for code in outcomes[:count].tolist()]
    states, times = np.asarray(made.states)[: completed + 1], np.asarray(made.times)[:count]
    coordinates = walker.section if ground is None else State._fields
    if animate is not None and isinstance(walker, Walker):
        motion = wj.motion(walker, begin, strides, step=FRAME_INTERVAL, ground=heights)
        data = None
        if not isinstance(walker, wj.SpatialWalker):
            data = wj.basin(walker, film_window(walker, begin), "direct", progress=True)
        signature = storage.signature(request)
        figures.film(motion, animate, data, signature=signature, progress=True)
    if as_json:
        print_json({"states": states, "outcomes": names, "times": times})
        return
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in coordinates)
    print(f"{'stride':>6}  {heads}  {'time':>8}  outcome")
    for i, (state, name, duration) in enumerate(zip(states, names, times, strict=False), start=1):
        print(f"{i:6}  {row(state)}  {duration:8.4f}  {name}")
    if len(states) > len(names):
        print(f"{'next':>6}  {row(states[-1])}")
    if animate is not None:
        print(f"film {animate}")


def refuse_start(walker: System, start: Float[np.ndarray, " section"]) -> NoReturn:
    """Raises `WrongUse` for a start that is not feasible, with the condition for that."""
    form = "--{}" if isinstance(walker, Walker) else "--start {}=VALUE"
    options = " and ".join(map(form.format, walker.section))
    feasible = type(walker).feasible
    about = feasible.__doc__ if feasible is not System.feasible else None  # not one of above
    condition = (about or "").strip().partition("\n")[0].rstrip(".")
    why = f": {condition}" if condition else ""
    raise WrongUse(f"{options} must be a feasible start, not {start.tolist()}{why}")
